"""Rollers that travel or turn freely: their own terms, and what sheets and other rollers do to them."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.batching import any_of_batch
from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.places import add_within
from diffeed.base.products import product
from diffeed.chain.state import State
from diffeed.chain.system import Border
from diffeed.contact.bodies import arm_spins
from diffeed.contact.features import shared, to_bars
from diffeed.contact.kept import Kept, by_circle
from diffeed.contact.roller_pairs import RollerPairs
from diffeed.contact.sweep import Pairs
from diffeed.forces.contacts import Contacts, felt
from diffeed.forces.terms import Step
from diffeed.model.arrays import Model


def border(model: Model, state: State, touching: Contacts, step: Step, kept: Kept) -> Border:
    """Travels and free spins: their own terms and their coupling to the bars."""
    rollers, n_bars = model.rollers, model.layout.n_bars
    m, f = rollers.n_movable, rollers.n_free
    travel_diag, travel_force = _travel_terms(model, state, step)
    spin_diag, spin_force = _spin_terms(model, state, step)
    travel, spin = _both(rollers.counts)
    twin = np.arange(m + f)
    twin[travel], twin[spin] = spin, travel
    own, mixed = jnp.concatenate([travel_diag, spin_diag]), jnp.zeros((m + f,))
    rhs, columns = jnp.concatenate([travel_force, spin_force]), jnp.zeros((m + f, 3, n_bars))
    beside = Border(columns, rhs, own, mixed, twin, lambda: jnp.zeros((m + f, m + f)), True)
    if touching.sheets is not None and m + f:
        beside = _sheet_on_rollers(model, touching.sheets, step, kept, beside)
    if touching.rollers is not None:
        beside = _rollers_on_rollers(model, touching.rollers, step, beside)
    return beside


def _travel_terms(model: Model, state: State, step: Step) -> tuple[Array, Array]:
    """Movable rollers along their travel: inertia, gravity, spring with preload, damper, stops."""
    r, u, v = model.rollers, state.travel, state.travel_rate
    over, under = jnp.maximum(u - r.stop_high, 0.0), jnp.maximum(r.stop_low - u, 0.0)
    stiffness = r.spring + jnp.where((over > 0) | (under > 0), r.stop_stiffness, 0.0)
    force = -(r.preload + r.spring * u) - r.damper * v - r.stop_stiffness * (over - under)
    force = force + r.mass * (model.gravity[0] * r.dir_x + model.gravity[1] * r.dir_y)
    if not step.implicit:
        return r.mass, force
    return r.mass + step.h * (r.damper + step.h * stiffness), force - step.h * stiffness * v


def _spin_terms(model: Model, state: State, step: Step) -> tuple[Array, Array]:
    """Freely turning rollers: inertia and bearing drag."""
    r = model.rollers
    drag = -r.drag * (state.spin - arm_spins(model, state.time + (step.h if step.implicit else 0.0)))
    return (r.inertia + step.h * r.drag if step.implicit else r.inertia), drag


def _sheet_on_rollers(model: Model, pairs: Pairs, step: Step, kept: Kept, beside: Border) -> Border:
    """Add the coupling of bars with travels and spins. A roller feels -n, -t along its travel and -R t in its spin."""
    rollers, m, n = model.rollers, model.rollers.n_movable, kept.n_circles
    roller = np.concatenate([np.arange(rollers.n)[rollers.movable], np.arange(rollers.n)[rollers.free]])
    kind = np.arange(model.n_border) >= m  # of each row of the border: travel, spin
    a_n, a_t, f_n, f_t = (v[:n] for v in felt(pairs, step).full())
    nx, ny = pairs.nx[:n], pairs.ny[:n]
    gn = -(kept.travel_x * nx + kept.travel_y * ny)
    gt = kept.travel_x * ny - kept.travel_y * nx
    gs = -kept.spin_lever
    own = [f_n * gn + f_t * gt, f_t * gs]
    if not step.implicit:  # no end of a step is felt: nothing is coupled
        rhs = jnp.sum(by_circle(model, kept, [own], roller, kind)[0], axis=1)
        return beside._replace(rhs=beside.rhs + rhs)
    an, at, asp = a_n * gn, a_t * gt, a_t * gs
    felt_by = []
    for lever in jax.tree.map(lambda v: v[:n], pairs.levers):
        rn, rt = lever.rn, lever.rt
        # What the bar couples (x, y, turning) to a travel and to a spin.
        coupled = [(an * nx - at * ny, -asp * ny), (an * ny + at * nx, asp * nx), (an * rn + at * rt, asp * rt)]
        felt_by += [[shared(lever, v) for v in both] for both in coupled]
    felt_by += [[an * gn + at * gt, asp * gs], own]
    rows = by_circle(model, kept, felt_by, roller, kind)
    columns = to_bars(model, jnp.split(rows[:-2], len(pairs.levers))).swapaxes(0, 1)
    diagonal, rhs = jnp.sum(rows[-2:], axis=2)
    mixed = beside.mixed
    if rollers.counts[1]:
        # A movable free roller has both: its travel and its spin couple through friction.
        travel = _both(rollers.counts)[0]
        mixed = mixed + _twice(rollers.counts, jnp.sum(by_circle(model, kept, [[at * gs]], roller[travel])[0], axis=1))
    return beside._replace(columns=columns, rhs=beside.rhs + rhs, own=beside.own + diagonal, mixed=mixed)


def _twice(counts: tuple[int, int, int, int], mixed: Array) -> Array:
    """(movable free rollers,) -> (border,): what couples travel and spin, at both."""
    before, after = jnp.zeros((counts[0],)), jnp.zeros((counts[2],))
    return jnp.concatenate([before, mixed, mixed, after])


def _both(counts: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Border rows (travel, spin) of the rollers that have both."""
    return counts[0] + np.arange(counts[1]), sum(counts[:2]) + np.arange(counts[1])


def _rollers_on_rollers(model: Model, pairs: RollerPairs, step: Step, beside: Border) -> Border:
    """Add rollers against each other. They are summed as rows of g_n and g_t in all unknowns where they are few. Where each
    movable roller has its own partners, partners without unknowns (driven, on fixed shafts) need no such rows, and others
    only while they touch."""
    if pairs.gap.ndim == 1:
        full, rhs = _of_all(model, pairs, step)
        return beside._replace(rhs=beside.rhs + rhs, rest=lambda: full, apart=None)
    flat, none = jax.tree.map(jnp.ravel, pairs), jnp.zeros((model.n_border,))
    coupled = any_of_batch(jnp.any((pairs.between[1] < sum(model.rollers.counts[:3])) & (pairs.gap < 0.0)))
    rhs, own, mixed = _on_partners(model, pairs, step)
    # Where any are coupled all come from the rows, and the sums are left out.
    alone = jnp.where(coupled, 0.0, 1.0)
    rhs = alone * rhs + lax.cond(coupled, lambda: _of_all(model, flat, step)[1], lambda: none)
    return beside._replace(
        rhs=beside.rhs + rhs,
        own=beside.own + alone * own,
        mixed=beside.mixed + alone * mixed,
        rest=lambda: lax.cond(coupled, lambda: _of_all(model, flat, step)[0], lambda: jnp.diag(none)),
        apart=~coupled,
    )


def _on_partners(model: Model, pairs: RollerPairs, step: Step) -> tuple[Array, Array, Array]:
    """Right-hand side, own and mixed terms of movable rollers, (border,) each, from their partners, (movable, partners)."""
    rollers, start = model.rollers, model.rollers.counts[0]
    a_n, a_t, f_n, f_t = felt(pairs, step).full()
    dx, dy = rollers.dir_x[:, None], rollers.dir_y[:, None]
    along, across = pairs.nx * dx + pairs.ny * dy, pairs.nx * dy - pairs.ny * dx
    turn, rest = -rollers.radius[start : rollers.n_movable, None], jnp.zeros((rollers.counts[2],))
    rhs = jnp.concatenate([jnp.sum(f_n * along + f_t * across, axis=1), jnp.sum(f_t[start:] * turn, axis=1), rest])
    if not step.implicit:
        return rhs, jnp.zeros_like(rhs), jnp.zeros_like(rhs)
    own = [jnp.sum(a_n * along**2 + a_t * across**2, axis=1), jnp.sum(a_t[start:] * turn**2, axis=1), rest]
    mixed = jnp.sum(a_t[start:] * across[start:] * turn, axis=1)
    return rhs, jnp.concatenate(own), _twice(rollers.counts, mixed)


def _of_all(model: Model, pairs: RollerPairs, step: Step) -> tuple[Array, Array]:
    """What all pairs add to the matrix, (border, border), and to the right-hand side."""
    return (_one_by_one if loops_are_cheap() else _as_product)(model, pairs, step)


def _one_by_one(model: Model, pairs: RollerPairs, step: Step) -> tuple[Array, Array]:
    """The same from the few unknowns of each pair: a travel and a spin of either roller. What has none is left out."""
    rollers, m, n = model.rollers, model.rollers.n_movable, model.n_border
    a_n, a_t, f_n, f_t = felt(pairs, step).full()
    xp = np if isinstance(pairs.between[0], np.ndarray) else jnp  # what is known beforehand stays so
    place, normal, tangent = [], [], []
    for side, index in ((1.0, pairs.between[0]), (-1.0, pairs.between[1])):
        spin = index - rollers.counts[0]
        way = [v[xp.clip(index, 0, m - 1)] for v in (rollers.dir_x, rollers.dir_y)]
        place += [xp.where((of >= 0) & (of < k), first + of, n) for of, k, first in ((index, m, 0), (spin, n - m, m))]
        normal += [side * (pairs.nx * way[0] + pairs.ny * way[1]), jnp.zeros_like(pairs.nx)]
        tangent += [side * (pairs.nx * way[1] - pairs.ny * way[0]), -rollers.radius[index]]
    forces = jnp.concatenate([f_n * gn + f_t * gt for gn, gt in zip(normal, tangent, strict=True)])
    rhs = add_within(n, xp.concatenate(place), forces)
    if not step.implicit:
        return jnp.zeros((n, n)), rhs
    # Of a pair every unknown meets itself and those before it: the lower triangle is enough.
    meet = [(i, k) for i in range(len(place)) for k in range(i + 1)]
    both = jnp.concatenate([a_n * normal[i] * normal[k] + a_t * tangent[i] * tangent[k] for i, k in meet])
    lower = xp.concatenate([xp.maximum(place[i], place[k]) * n + xp.minimum(place[i], place[k]) for i, k in meet])
    return add_within(n * n, lower, both).reshape(n, n), rhs


def _as_product(model: Model, pairs: RollerPairs, step: Step) -> tuple[Array, Array]:
    """The same as a product of g_n and g_t of all pairs in all unknowns, (border, 2 pairs)."""
    rollers, m, f = model.rollers, model.rollers.n_movable, model.rollers.n_free
    a_n, a_t, f_n, f_t = felt(pairs, step).full()
    start = rollers.counts[0]
    count = pairs.gap.shape[0]
    gn, gt = jnp.zeros((m, count)), jnp.zeros((m + f, count))
    for side, given in ((1.0, pairs.between[0]), (-1.0, pairs.between[1])):
        index = jnp.asarray(given, jnp.int32)
        at_travel = jax.nn.one_hot(index, m, dtype=gn.dtype, axis=0)
        at_spin = jax.nn.one_hot(index - start, f, dtype=gn.dtype, axis=0)
        along = pairs.nx[None, :] * rollers.dir_x[:, None] + pairs.ny[None, :] * rollers.dir_y[:, None]
        across = pairs.nx[None, :] * rollers.dir_y[:, None] - pairs.ny[None, :] * rollers.dir_x[:, None]
        gn = gn + side * at_travel * along
        gt = gt + jnp.concatenate([side * at_travel * across, -at_spin * rollers.radius[index][None, :]])
    both = jnp.concatenate([jnp.pad(gn, ((0, f), (0, 0))), gt], axis=1)
    force = jnp.concatenate([f_n, f_t])
    if not step.implicit:
        return jnp.zeros((m + f, m + f)), product(both, force)
    weighed = jnp.concatenate([a_n, a_t])[None, :] * both
    found = product(both, jnp.concatenate([weighed, force[None, :]]).T)
    return found[:, :-1], found[:, -1]
