"""Generalised coordinates: mass centres, headings, travels, free angles; forces and inertia in them."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.base.products import product
from diffeed.base.records import replace
from diffeed.chain.kinematics import pose
from diffeed.chain.state import State, total_per_sheet
from diffeed.contact.bodies import bodies
from diffeed.contact.kept import Kept
from diffeed.forces.clamps import by_direction, hold_target, walls
from diffeed.forces.contacts import Contacts, contacts, pair_terms
from diffeed.forces.loads import pushes
from diffeed.forces.rollers import border
from diffeed.forces.sheet import joints, weight
from diffeed.forces.terms import Step
from diffeed.model.arrays import Hold, Model


def positions(model: Model, state: State) -> Array:
    """q: (2 sheets + bars + movable + free,)."""
    return jnp.concatenate([state.x, state.y, state.heading, state.travel, state.angle[model.rollers.free]])


def velocities(state: State) -> Array:
    """Rates of q."""
    return jnp.concatenate([state.vx, state.vy, state.rate, state.travel_rate, state.spin])


def with_positions(model: Model, state: State, q: Array, v: Array) -> State:
    """The state with positions q and rates v."""
    s, n, m = len(model.layout.bars), model.layout.n_bars, model.rollers.n_movable
    cuts = [s, 2 * s, 2 * s + n, 2 * s + n + m]
    x, y, heading, travel, angle = jnp.split(q, cuts)
    vx, vy, rate, travel_rate, spin = jnp.split(v, cuts)
    return replace(
        state, x=x, y=y, heading=heading, travel=travel, angle=state.angle.at[model.rollers.free].set(angle),
        vx=vx, vy=vy, rate=rate, travel_rate=travel_rate, spin=spin,
    )  # fmt: skip


def generalised_force(model: Model, state: State, kept: Kept, pressed: Array | None = None) -> Array:
    """Force on each entry of q at a state (no inertia, no clamps), kg mm/s2 and kg mm2/s2: of contacts, that of the kept pairs.

    Friction sticks as the state's deflections say, by the normal forces `pressed` (the present ones if None); in a state
    without deflections it is regularised.
    """
    at = pose(model, state)
    world = bodies(model, state, state.time, state.time)
    touching = contacts(model, at, world, kept, state.grip, pressed=pressed)
    plain = Step(jnp.ones(()), False)
    terms = [weight(model), joints(model, state, plain), pushes(model, at), walls(model, state, plain)]
    terms += [pair_terms(model, touching.sheets, at, plain, kept)] if touching.sheets is not None else []
    total = [sum((getattr(t, f) for t in terms if t is not None), jnp.zeros_like(at.x)) for f in ("fx", "fy", "fw")]
    on_rollers = _force_on_rollers(model, state, touching, plain, kept)
    _, pull_back = jax.vjp(lambda q: centres(model, state, q), positions(model, state))
    (on_sheets,) = pull_back((total[0], total[1], total[2]))
    n = on_sheets.shape[0] - on_rollers.shape[0]
    return on_sheets.at[n:].add(on_rollers)


def centres(model: Model, state: State, q: Array) -> tuple[Array, Array, Array]:
    """x, y and heading of every bar, (bars,) each, at positions q."""
    moved = with_positions(model, state, q, jnp.zeros_like(q))
    at = pose(model, moved)
    return at.x, at.y, moved.heading


def _force_on_rollers(model: Model, state: State, touching: Contacts, plain: Step, kept: Kept) -> Array:
    free = model.rollers.n_movable + model.rollers.n_free
    return border(model, state, touching, plain, kept).rhs if free else jnp.zeros((0,))


def held_places(model: Model, state: State) -> tuple[Array, Array]:
    """Where the clamps' rows are and where they belong, each (rows,)."""
    at = pose(model, state)
    is_at, belongs = [jnp.zeros((0,))], [jnp.zeros((0,))]
    for hold in model.holds:
        place = _place(model, state, at, hold)
        target = by_direction(hold_target(hold, state.time))
        is_at += [place[d][None] for d in hold.rows]
        belongs += [target[d][None] for d in hold.rows]
    return jnp.concatenate(is_at), jnp.concatenate(belongs)


def _place(model: Model, state: State, at: Any, hold: Hold) -> dict[str, Array]:
    arm = hold.end * model.bars.half_length[hold.bar]
    k = hold.bar
    return by_direction((at.x[k] + arm * at.c[k], at.y[k] + arm * at.s[k], state.heading[k]))


def generalised_inertia(model: Model, state: State) -> Array:
    """Diagonal of the mass matrix in q."""
    bars, layout = model.bars, model.layout
    moved = jax.jacfwd(lambda h: pose(model, replace(state, heading=h))[:2])(state.heading)
    turning = bars.inertia + sum(jnp.sum(bars.mass[:, None] * j * j, axis=0) for j in moved)
    total = total_per_sheet(layout, bars.mass)
    return jnp.concatenate([total, total, turning, model.rollers.mass, model.rollers.inertia])


def mass_matrix(model: Model, state: State) -> Array:
    """Mass matrix in q, exact at this pose."""
    q = positions(model, state)
    moved = jax.jacfwd(lambda q: centres(model, state, q))(q)
    bars = model.bars
    weights = (bars.mass, bars.mass, bars.inertia)
    sheets = sum(product(j.T, w[:, None] * j) for j, w in zip(moved, weights, strict=True))
    n = q.shape[0] - model.rollers.n_movable - model.rollers.n_free
    extra = jnp.concatenate([jnp.zeros((n,)), model.rollers.mass, model.rollers.inertia])
    return sheets + jnp.diag(extra)
