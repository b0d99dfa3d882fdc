"""Linearly implicit Euler on the whole system: order one, stiff terms damped, one linear solve per step."""

from jax import Array

from diffeed.base.records import replace
from diffeed.chain import solve as chain_solve
from diffeed.chain.state import State
from diffeed.contact import stick
from diffeed.contact.kept import Kept
from diffeed.forces.assemble import assemble
from diffeed.forces.contacts import Contacts
from diffeed.forces.sheet import joint_stretch
from diffeed.forces.terms import Step
from diffeed.model.arrays import Model
from diffeed.steppers.advance import advance_positions, advance_velocities


def step(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """One step; also the contacts of the state it started from."""
    system, at, touching = assemble(model, state, Step(h, True), kept)
    a = chain_solve.solve(system, model.layout)
    moving = replace(
        advance_velocities(model, state, a, h),
        stretch=joint_stretch(model, at, *chain_solve.net_joint_force(system, a)),
        grip=stick.advance(model, state.grip, touching.sheets, a, h, kept),
    )
    return advance_positions(model, moving, h), touching
