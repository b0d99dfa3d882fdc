"""Positions from velocities: shared by the steppers."""

from jax import Array

from diffeed.bodies import spins
from diffeed.model import Model
from diffeed.records import replace
from diffeed.state import State


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
