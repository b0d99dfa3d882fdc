"""Steppers: one step per method, one method per file, all with the signature step(model, state, h, kept)."""

from collections.abc import Callable

from jax import Array

from diffeed.contact import Kept
from diffeed.forces import Contacts
from diffeed.model import Model
from diffeed.state import State
from diffeed.steppers import extrapolated_euler, linear_euler, midpoint, runge_kutta

Stepper = Callable[[Model, State, Array, Kept], tuple[State, Contacts]]

STEPPERS: dict[str, Stepper] = {
    "linear_euler": linear_euler.step,
    "extrapolated_euler": extrapolated_euler.step,
    "midpoint": midpoint.step,
    "runge_kutta": runge_kutta.step,
}
EXPLICIT = ("runge_kutta",)
ESTIMATING = ("linear_euler", "extrapolated_euler")
"""Steppers whose error can be had from one step against two halves, as error control needs it."""
DEFAULT = "linear_euler"
METHODS = tuple(STEPPERS)
"""Names of the steppers that `simulate(method=...)` takes."""
