"""Whether two ways through the same step, which should come together, are far apart: a hit that the step does not resolve."""

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.base.smooth import polar, step_down
from diffeed.chain.state import State
from diffeed.model.arrays import Model

NEGLIGIBLE = 1e-3
"""mm/s: what differs by less needs no care; and the derivative of a share of nothing would not be finite."""
RATES = ("vx", "vy", "rate", "travel_rate", "spin")


def astray(model: Model, start: State, one: State, other: State, h: Array, unnoticed: float, plain: float) -> Array:
    """0 to 1: by what share of the whole change from `start` to `one`, in a time h, the two are apart: 0 up to `unnoticed`, 1
    from `plain` on, smooth between."""
    return of_change(model, start, one, _apart(model, one, other), h, unnoticed, plain)


def of_change(model: Model, start: State, end: State, wrong: Array, h: Array, unnoticed: float, plain: float) -> Array:
    """0 to 1: what share a speed, mm/s, is of the whole change from `start` to `end` in a time h."""
    whole = _apart(model, end, start)
    # Of a sheet at rest all change is rounding.
    whole = whole + h * polar(model.gravity[0], model.gravity[1])[0] + NEGLIGIBLE
    return step_down(0.5 * (unnoticed + plain) - wrong / whole, 0.5 * (plain - unnoticed))


def mixed(part: Array, here: State, there: State) -> State:
    """`here`, or as much of `there` as `part` says. Of a batch in which another goes astray, this one keeps its bits."""
    return jax.tree.map(lambda a, b: jnp.where(part > 0, a + part * (b - a), a), here, there)


def _apart(model: Model, one: State, other: State) -> Array:
    """mm/s: the largest difference of any speed."""
    reach = {"rate": jnp.max(model.bars.half_length), "spin": model.rollers.radius[model.rollers.free]}
    return jnp.max(jnp.concatenate([jnp.abs(getattr(one, n) - getattr(other, n)) * reach.get(n, 1.0) for n in RATES]))
