"""Classical explicit Runge-Kutta of order four: an independent check of the implicit steppers.

Stable only below the limits of the stiffest spring: see `diffeed.check`.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.base.records import replace
from diffeed.chain import solve as chain_solve
from diffeed.chain.state import State, mean_per_sheet
from diffeed.contact import stick
from diffeed.contact.bodies import spins
from diffeed.contact.kept import Kept
from diffeed.forces.assemble import assemble
from diffeed.forces.contacts import Contacts
from diffeed.forces.sheet import joint_stretch
from diffeed.forces.terms import Step
from diffeed.model.arrays import Model

NODES = (0.0, 0.5, 0.5, 1.0)
WEIGHTS = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)


def derivative(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts, Array]:
    """Time derivative of every entry of the state, the contacts, and what the joints pull: it is no sum over time."""
    system, at, touching = assemble(model, state, Step(h, False), kept)
    a = chain_solve.solve(system, model.layout)
    m, f = model.rollers.n_movable, model.rollers.n_free
    slope = State(
        time=jnp.ones_like(state.time),
        x=state.vx,
        y=state.vy,
        heading=state.rate,
        travel=state.travel_rate,
        angle=spins(model, state, state.time),
        vx=mean_per_sheet(model.layout, a.x),
        vy=mean_per_sheet(model.layout, a.y),
        rate=a.w,
        travel_rate=a.border[:m],
        spin=a.border[m : m + f],
        stretch=jnp.zeros_like(state.stretch),
        grip=stick.slope(model, state.grip, touching.sheets, h, kept),
    )
    return slope, touching, joint_stretch(model, at, *chain_solve.net_joint_force(system, a))


def _along(state: State, slope: State, h: Array | Any) -> State:
    return jax.tree.map(lambda x, v: x + h * v, state, slope)


def step(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """One step; also the contacts of the state it started from."""
    first, touching, stretch = derivative(model, state, h, kept)

    def stage(carry: tuple[State, State], node_weight: Array) -> tuple[tuple[State, State], None]:
        slope, total = carry
        node, weight = node_weight
        slope = derivative(model, _along(state, slope, node * h), h, kept)[0]
        return (slope, _along(total, slope, weight)), None

    total = _along(jax.tree.map(jnp.zeros_like, state), first, WEIGHTS[0])
    rest = jnp.array([NODES[1:], WEIGHTS[1:]]).T
    (_, total), _ = jax.lax.scan(stage, (first, total), rest)
    after = _along(state, total, h)
    return replace(after, time=state.time + h, stretch=stretch, grip=stick.bounded(after.grip)), touching
