"""What one state shows: forces, slips and gaps of every part, in newtons. Frames and observers both look through this."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.smooth import divide
from diffeed.chain.kinematics import Pose, node_velocities, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import Bodies, bodies, spins
from diffeed.contact.features import shared, to_bars
from diffeed.contact.kept import Kept, by_roller, keep_all
from diffeed.contact.movement import shift_at
from diffeed.contact.sweep import Pairs, heading
from diffeed.forces.contacts import Contacts, contacts
from diffeed.model.arrays import Model
from diffeed.pair.law import NEWTON
from diffeed.readings.trajectory import GuideTrack, Parts, RollerTrack, SheetTrack


class Felt(NamedTuple):
    """What pairs feel, or sums of it over a sheet's features, one entry per body."""

    force: Array  # N
    friction: Array  # N on the sheet along its heading
    moment: Array  # N: friction on the body along its own tangent (times radius: torque)
    slide: Array  # N mm/s: normal force times (body - sheet) speed along the heading


def felt_by_pairs(model: Model, pairs: Pairs, at: Pose, kept: Kept) -> Felt:
    """Each pair by itself, (bodies, features) or (pairs,)."""
    c, s = heading(model, at, pairs, kept.pairs)
    touch, along = pairs.touch, pairs.nx * s - pairs.ny * c  # tangent (-ny, nx) along the heading
    found = Felt(touch.force, -touch.friction * along, touch.friction, -touch.force * pairs.v_t * along)
    return Felt(*(v / NEWTON for v in found))


def felt_by_rollers(model: Model, pairs: Pairs, at: Pose, kept: Kept) -> Felt:
    """Sums over features, (rollers,)."""
    return Felt(*by_roller(model, kept, jnp.stack(felt_by_pairs(model, pairs, at, kept))))


def felt_by_bodies(model: Model, pairs: Pairs, at: Pose) -> Felt:
    """Sums over features, (bodies,), of contacts that hold every body."""
    return jax.tree.map(lambda v: jnp.sum(v, axis=1), felt_by_pairs(model, pairs, at, keep_all(model)))


def gaps_of_pairs(model: Model, pairs: Pairs) -> Array:
    """(bodies, features) mm, of contacts that hold every body. A joined tip touches nothing: its gap is infinite."""
    n, tips = len(model.circle_names), model.circles.active[:, None] > 0
    return pairs.gap.at[:n].set(jnp.where(tips, pairs.gap[:n], jnp.inf))


def gaps_to_bodies(model: Model, pairs: Pairs) -> Array:
    """(bodies,) mm, the smallest of `gaps_of_pairs`."""
    return jnp.min(gaps_of_pairs(model, pairs), axis=1)


def guide_names(model: Model) -> tuple[str, ...]:
    circles = model.circle_names[model.rollers.n : model.rollers.n + model.n_circle_guides]
    return tuple(sorted((*model.guides.names, *circles)))


def part_names(model: Model) -> tuple[str, ...]:
    """Names of everything that can be pressed, with the section: rollers, then guides, then sheets."""
    rollers, guides = sorted(model.rollers.names), guide_names(model)
    return (
        *(f"rollers.{n}" for n in rollers),
        *(f"guides.{n}" for n in guides),
        *(f"sheets.{n}" for n in model.layout.names),
    )


def roller_order(model: Model) -> np.ndarray:
    """Positions of the sorted names in the model's own order."""
    return np.array([model.rollers.names.index(n) for n in sorted(model.rollers.names)], dtype=int)


class Pressed(NamedTuple):
    """What contacts do on rollers, (rollers,) in sorted order."""

    force: Array  # N
    friction: Array  # N on the sheet along its heading
    torque: Array  # N mm
    slip: Array  # mm/s, roller minus sheet along the heading


def on_rollers(model: Model, touching: Contacts, kept: Kept) -> Pressed:
    """Of all rollers, from the kept pairs."""
    if touching.sheets is None or model.rollers.n == 0:
        return Pressed(*[jnp.zeros((0,))] * 4)
    felt = felt_by_rollers(model, touching.sheets, touching.at, kept)
    torque = felt.moment * model.rollers.radius
    if touching.rollers is not None:
        torque = torque + _pair_torque(model, touching)
    found = Pressed(felt.force, felt.friction, torque, divide(felt.slide, felt.force))
    return jax.tree.map(lambda v: v[roller_order(model)], found)


def roller_track(model: Model, state: State, world: Bodies, touching: Contacts) -> RollerTrack:
    """Rollers in sorted order, from contacts that hold every body."""
    order, n = roller_order(model), model.rollers.n
    if touching.sheets is None or n == 0:
        empty = jnp.zeros((0,))
        return RollerTrack(center=jnp.zeros((0, 2)), travel=empty, angle=empty, angular_velocity=empty, force=empty,
                           friction=empty, torque=empty, slip=empty, gap=empty)  # fmt: skip
    travel = jnp.concatenate([state.travel, jnp.zeros((n - model.rollers.n_movable,))])
    return RollerTrack(
        center=jnp.stack([world.circles.x[:n], world.circles.y[:n]], axis=1)[order],
        travel=travel[order],
        angle=state.angle[order],
        angular_velocity=spins(model, state, state.time)[order],
        **on_rollers(model, touching, keep_all(model))._asdict(),
        gap=gaps_to_bodies(model, touching.sheets)[:n][order],
    )


def _pair_torque(model: Model, touching: Contacts) -> Array:
    assert touching.rollers is not None
    radius = model.rollers.radius
    i, j = touching.rollers.between
    pull = touching.rollers.touch.friction / NEWTON
    torque = jnp.zeros_like(radius).at[i].add(pull * radius[i])
    return torque.at[j].add(pull * radius[j])


def _guide_of_body(model: Model) -> tuple[np.ndarray, int]:
    """Of each body that is no roller the place in `guide_names`, and how many names there are. A guide's tips are its own."""
    names = guide_names(model)
    owners = (*model.circle_names[model.rollers.n :], *model.guides.names)
    return np.array([names.index(n) for n in owners], dtype=int), len(names)


def gaps_to_guides(model: Model, gap: Array) -> Array:
    """(bodies,) -> (guides,) in sorted order, mm."""
    return jax.ops.segment_min(gap[model.rollers.n :], *_guide_of_body(model))


def by_guide(model: Model, values: Array) -> Array:
    """(bodies,) -> (guides,) in sorted order: summed over a guide's face and tips."""
    return jax.ops.segment_sum(values[model.rollers.n :], *_guide_of_body(model))


def guide_track(model: Model, state: State, touching: Contacts) -> GuideTrack:
    names = guide_names(model)
    force = friction = gap = jnp.zeros((0,))
    if touching.sheets is not None:
        felt = felt_by_bodies(model, touching.sheets, touching.at)
        force, friction = (by_guide(model, v) for v in (felt.force, felt.friction))
        gap = gaps_to_guides(model, gaps_to_bodies(model, touching.sheets))
    shift, turn = jnp.zeros((len(names), 2)), jnp.zeros((len(names),))
    owners = {"guides": model.guides.names, "circles": model.circle_names}
    moving = {
        names.index(owners[family][k]): m
        for m, (family, k) in enumerate(model.movements.parts)
        if family != "circles" or k >= model.rollers.n
    }
    if moving:
        rows, which, now = np.array([*moving]), np.array([*moving.values()]), shift_at(model.movements.path, state.time)
        shift = shift.at[rows].set(jnp.stack([now.dx, now.dy], axis=1)[which])
        turn = turn.at[rows].set(now.angle[which])
    return GuideTrack(displacement=shift, rotation=turn, force=force, friction=friction, gap=gap)


def contact_on_bars(model: Model, touching: Contacts) -> tuple[Array, Array, Array]:
    """Normal force sums and contact force vectors on each bar, N: (bars,) each."""
    if touching.sheets is None:
        zero = jnp.zeros((model.layout.n_bars,))
        return zero, zero, zero
    pairs = touching.sheets
    f, t = pairs.touch.force, -pairs.touch.friction
    values = (f, f * pairs.nx - t * pairs.ny, f * pairs.ny + t * pairs.nx)
    sums = [jnp.stack([jnp.sum(shared(lever, v), axis=0) for v in values]) for lever in pairs.levers]
    force, x, y = to_bars(model, sums) / NEWTON
    return force, x, y


def sheet_tracks(model: Model, state: State, at: Pose, touching: Contacts) -> dict[str, SheetTrack]:
    x, y = nodes(model, at)
    vx, vy = node_velocities(model, at)
    force, push_x, push_y = contact_on_bars(model, touching)
    tracks = {}
    for k, (name, s) in enumerate(zip(model.layout.names, model.layout.slices(), strict=True)):
        at_nodes = slice(s.start + k, s.stop + k + 1)
        tracks[name] = SheetTrack(
            nodes=jnp.stack([x[at_nodes], y[at_nodes]], axis=1),
            velocities=jnp.stack([vx[at_nodes], vy[at_nodes]], axis=1),
            headings=state.heading[s],
            rates=state.rate[s],
            force=force[s],
            push=jnp.stack([push_x[s], push_y[s]], axis=1),
        )
    return tracks


def look(model: Model, state: State) -> tuple[Pose, Bodies, Contacts]:
    """Pose, bodies and contacts of all pairs at a state itself (shafts as prescribed at its own time)."""
    at = pose(model, state)
    world = bodies(model, state, state.time, state.time)
    return at, world, contacts(model, at, world, keep_all(model), state.grip)


def snapshot(model: Model, state: State) -> tuple[dict[str, SheetTrack], Parts[RollerTrack], Parts[GuideTrack]]:
    """Everything that a frame of a trajectory holds."""
    at, world, touching = look(model, state)
    rollers = Parts(block=roller_track(model, state, world, touching), names=tuple(sorted(model.rollers.names)))
    guides = Parts(block=guide_track(model, state, touching), names=guide_names(model))
    return sheet_tracks(model, state, at, touching), rollers, guides
