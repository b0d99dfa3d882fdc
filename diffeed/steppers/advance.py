"""Velocities from accelerations, positions from velocities: shared by the steppers."""

from jax import Array

from diffeed.base.records import replace
from diffeed.chain.state import State, mean_per_sheet
from diffeed.chain.system import Solution
from diffeed.contact.bodies import spins
from diffeed.model.arrays import Model


def advance_velocities(model: Model, state: State, a: Solution, h: Array) -> State:
    """Add h times the accelerations of bars and border to the velocities; positions and time stay."""
    m, f = model.rollers.n_movable, model.rollers.n_free
    return replace(
        state,
        vx=state.vx + h * mean_per_sheet(model.layout, a.x),
        vy=state.vy + h * mean_per_sheet(model.layout, a.y),
        rate=state.rate + h * a.w,
        travel_rate=state.travel_rate + h * a.border[:m],
        spin=state.spin + h * a.border[m : m + f],
    )


def advance_positions(model: Model, state: State, h: Array) -> State:
    """Move positions by h times the velocities that the state carries; time moves on."""
    return replace(
        state,
        time=state.time + h,
        x=state.x + h * state.vx,
        y=state.y + h * state.vy,
        heading=state.heading + h * state.rate,
        travel=state.travel + h * state.travel_rate,
        angle=state.angle + h * spins(model, state, state.time + h),
    )
