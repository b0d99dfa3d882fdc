"""Steppers: one step per method, one method per file, all with the signature step(model, state, h, kept)."""

from collections.abc import Callable
from typing import NamedTuple

from jax import Array

from diffeed.chain.state import State
from diffeed.contact.kept import Kept
from diffeed.forces.contacts import Contacts
from diffeed.model.arrays import Model
from diffeed.steppers import extrapolated_euler, linear_euler, midpoint, runge_kutta
from diffeed.steppers.extrapolated_euler import Ways

Stepper = Callable[[Model, State, Array, Kept], tuple[State, Contacts]]


class Estimated(NamedTuple):
    """What error control goes on with of the `Ways` of a step, and the stepper that gives the same without the estimate."""

    chosen: Callable[[Ways], State]
    step: Stepper


STEPPERS: dict[str, Stepper] = {
    "linear_euler": linear_euler.step,
    "extrapolated_euler": extrapolated_euler.step,
    "midpoint": midpoint.step,
    "runge_kutta": runge_kutta.step,
}
EXPLICIT = ("runge_kutta",)
ORDERS = {"linear_euler": 1, "extrapolated_euler": 2, "midpoint": 2, "runge_kutta": 4}
"""With what power of their length steps take a rebound away."""
ESTIMATING = {
    "linear_euler": Estimated(lambda ways: ways.halves, extrapolated_euler.two_halves),
    "extrapolated_euler": Estimated(Ways.best, extrapolated_euler.step),
}
"""Steppers whose error can be had from one step against two halves, as error control needs it."""
DEFAULT = "linear_euler"
METHODS = tuple(STEPPERS)
"""Names of the steppers that `simulate(method=...)` takes."""
