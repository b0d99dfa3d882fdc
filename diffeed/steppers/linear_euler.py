"""Linearly implicit Euler on the whole system: order one, stiff terms damped, one linear solve per step."""

from jax import Array

from diffeed import chain_solve, stick
from diffeed.contact import Kept
from diffeed.forces import Contacts, Step, assemble, joint_stretch
from diffeed.model import Model
from diffeed.records import replace
from diffeed.state import State, mean_per_sheet
from diffeed.steppers.advance import advance_positions


def step(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """One step; also the contacts of the state it started from."""
    system, at, touching = assemble(model, state, Step(h, True), kept)
    a = chain_solve.solve(system, model.layout)
    m, f = model.rollers.n_movable, model.rollers.n_free
    moving = replace(
        state,
        vx=state.vx + h * mean_per_sheet(model.layout, a.x),
        vy=state.vy + h * mean_per_sheet(model.layout, a.y),
        rate=state.rate + h * a.w,
        travel_rate=state.travel_rate + h * a.border[:m],
        spin=state.spin + h * a.border[m : m + f],
        stretch=joint_stretch(model, at, *chain_solve.net_joint_force(system, a)),
        grip=stick.advance(model, state.grip, touching.sheets, a, h, kept),
    )
    return advance_positions(model, moving, h), touching
