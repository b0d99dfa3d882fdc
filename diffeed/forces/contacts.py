"""Contacts of sheets: evaluated at a state, and as a step feels them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State
from diffeed.chain.system import BarTerms
from diffeed.contact import stick
from diffeed.contact.bodies import Bodies, spins
from diffeed.contact.features import Lever, by_feature, shared, to_bars
from diffeed.contact.kept import Kept, pick
from diffeed.contact.roller_pairs import RollerPairs, roller_contacts
from diffeed.contact.sweep import Pairs, sheet_contacts
from diffeed.forces.terms import Step, bar_terms
from diffeed.model.arrays import Model
from diffeed.pair.law import with_friction


class Contacts(NamedTuple):
    """All evaluated contacts of one state, None where a scene has no such part, and the pose and the shafts that they saw."""

    sheets: Pairs | None
    rollers: RollerPairs | None
    at: Pose
    spin: Array  # (rollers,) rad/s


def contacts(
    model: Model,
    at: Pose,
    world: Bodies,
    kept: Kept,
    grip: Array | None,
    ahead: Array | float = 0.0,
    pressed: Array | None = None,
) -> Contacts:
    """Sweep the kept bodies. `grip` are the state's deflections; sticking friction is that of `ahead` seconds later, by the
    normal forces `pressed` if given."""
    held = stick.of_pairs(model, grip, kept, ahead, pressed)
    return Contacts(
        sheets=sheet_contacts(model, at, world, kept, held) if model.has_bodies else None,
        rollers=roller_contacts(model, world, kept) if model.pairs else None,
        at=at,
        spin=world.spin,
    )


def at_own_time(model: Model, state: State, touching: Contacts, kept: Kept) -> Contacts:
    """Contacts of a state as a step saw them, with the shafts of its end -> with those of the state's own time, and the friction
    of its present deflections. Geometry and normal forces are the same, and are not computed again."""
    spin, radius, (sheets, rollers) = spins(model, state, state.time), model.rollers.radius, touching[:2]
    gained = (spin - touching.spin) * radius  # mm/s, of the surfaces
    if sheets is not None and kept.n_circles:
        on_circles = jnp.pad(gained, (0, len(model.circle_names) - model.rollers.n))
        shape = sheets.v_t[: kept.n_circles].shape
        faster = jnp.broadcast_to(pick(on_circles, kept.circle_index), shape)
        faster = jnp.concatenate([faster, jnp.zeros_like(sheets.v_t[kept.n_circles :])])
        v_t, grip = sheets.v_t - faster, stick.of_pairs(model, state.grip, kept, 0.0)
        touch = with_friction(kept.surface, sheets.touch, v_t, kept.own.friction_factor, grip)
        sheets = sheets._replace(touch=touch, v_t=v_t, u_t=sheets.u_t + faster)
    if rollers is not None:
        i, j = rollers.between
        v_t = rollers.v_t - gained[i] - gained[j]
        rollers = rollers._replace(touch=with_friction(rollers.surface, rollers.touch, v_t, 1.0, None), v_t=v_t)
    return Contacts(sheets, rollers, touching.at, spin)


class Felt(NamedTuple):
    """A contact as the step feels it; along the tangent None where nothing has friction."""

    a_n: Array  # added to the matrix along the normal, kg
    a_t: Array | None  # and along the tangent
    f_n: Array  # force along the normal, kg mm/s2
    f_t: Array | None

    def full(self) -> tuple[Array, Array, Array, Array]:
        """The same with zeros."""
        zero = jnp.zeros_like(self.f_n)
        return self.a_n, zero if self.a_t is None else self.a_t, self.f_n, zero if self.f_t is None else self.f_t


def felt(pairs: Pairs | RollerPairs, step: Step) -> Felt:
    """Implicit parts of contacts: (h^2 K + h C), h times the secant of friction, F - h K v_n, and minus friction."""
    touch, h = pairs.touch, step.h
    f_t = None if touch.secant is None else -touch.friction
    if not step.implicit:
        zero = jnp.zeros_like(touch.force)
        return Felt(zero, None if f_t is None else zero, touch.force, f_t)
    lagged = h * touch.stiffness
    a_n = h * (lagged if touch.damping is None else lagged + touch.damping)
    a_t = None if touch.secant is None else h * touch.secant
    return Felt(a_n, a_t, touch.force - lagged * pairs.v_n, f_t)


def pair_terms(model: Model, pairs: Pairs, at: Pose, step: Step, kept: Kept) -> BarTerms:
    """Contacts summed over bodies, features given back to their bars.

    A contact on two bars with shares s_j feels g.v = sum s_j g_j.v. Its own matrix g g' has a block between the two bars, for
    which the chain has no place. In it stands sum s_j g_j g_j', which is at least g g' because a square is convex: symmetric,
    positive, so that the step stays stable, and the force is the exact one; the difference resists changes of the two bars'
    relative speed and vanishes with the step.
    """
    e = felt(pairs, step)
    entries = [_entries(pairs, lever, e, step) for lever in pairs.levers]
    # Summed at once: one by one, each would compute the contact law again.
    sums = by_feature(model, [entry for each in entries for entry in each], kept.pairs)
    fx, fy, fw, *matrix = to_bars(model, jnp.split(sums, len(entries)))
    if not step.implicit:
        return bar_terms(model, fx=fx, fy=fy, fw=fw)
    xx, xy, yy, xw, yw, ww, turning = matrix
    return BarTerms(xx, xy, yy, xw, yw, ww + step.h * turning, fx, fy, fw - turning * at.w)


def _entries(pairs: Pairs, lever: Lever, pair: Felt, step: Step) -> list[Array]:
    """What pairs add to one of their bars: force, and if implicit matrix and geometric stiffness; of the shape of the pairs."""
    e, nx, ny = jax.tree.map(lambda v: shared(lever, v), pair), pairs.nx, pairs.ny
    entries = _along(e.f_n, e.a_n, nx, ny, lever.rn, step)
    if e.a_t is not None and e.f_t is not None:
        entries = [n + t for n, t in zip(entries, _along(e.f_t, e.a_t, -ny, nx, lever.rt, step), strict=True)]
    return entries + ([step.h * shared(lever, pairs.turning)] if step.implicit else [])


def _along(f: Array, a: Array, x: Array, y: Array, r: Array, step: Step) -> list[Array]:
    """A force f along g = (x, y, r) of a bar, and if implicit the entries xx, xy, yy, xw, yw, ww of a g g'."""
    force = [f * x, f * y, f * r]
    if not step.implicit:
        return force
    ax, ay = a * x, a * y
    return [*force, ax * x, ax * y, ay * y, ax * r, ay * r, a * r * r]
