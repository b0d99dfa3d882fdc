"""Piecewise linear profiles over time, and their derivative where steps end at their corners."""

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.model.arrays import Model

AT_CORNER = 256
"""Roundings of a time by which a step that ends at a corner may miss it: the time is a sum over thousands of steps."""


def interpolate(times: Array, values: Array, time: Array) -> tuple[Array, Array]:
    """Value and slope of a profile, (points,), at a time, or of each of several, (profiles, points); constant outside. At a
    corner the slope is that after it.

    The derivative of the value is there the mean of both sides: a step that ends at a corner stands for the time on either side
    of it, and that of one side alone would count for both.
    """
    if times.shape[-1] == 1:
        return values[..., 0], jnp.zeros_like(values[..., 0])
    if times.ndim > 1:
        return jax.vmap(interpolate, in_axes=(0, 0, None))(times, values, time)
    return _value(times, values, time), _piece(times, values, time)[1]


def all_times(model: Model) -> list[Array]:
    """(parts, points) s of the drives and of every movement. Shorter profiles among several repeat their last point."""
    several = [*(drives.times for drives in model.rollers.drives), model.movements.path.times]
    held = [hold.path.times[None] for hold in model.holds if hold.path is not None]
    return [times for times in (*several, *held) if times.shape[0] and times.shape[1] > 1]


def in_order(model: Model) -> Array:
    """Whether no time comes before the one that it follows; scenes that are not traced are refused before they run."""
    falls = [jnp.any(jnp.diff(times, axis=-1) < 0.0) for times in all_times(model)]
    return ~jnp.any(jnp.stack(falls)) if falls else jnp.asarray(True)


def _piece(times: Array, values: Array, time: Array) -> tuple[Array, Array]:
    """Of the piece that holds at `time`: its first corner, and its slope, 0 outside."""
    k = jnp.clip(jnp.searchsorted(times, time, side="right") - 1, 0, times.shape[0] - 2)
    span = times[k + 1] - times[k]
    inside = (span > 0) & (time >= times[0]) & (time < times[-1])
    return k, jnp.where(inside, (values[k + 1] - values[k]) / jnp.where(span > 0, span, 1.0), 0.0)


@jax.custom_jvp
def _value(times: Array, values: Array, time: Array) -> Array:
    k, slope = _piece(times, values, time)
    return jnp.where(time < times[-1], values[k] + slope * (time - times[k]), values[-1])


@_value.defjvp
def _value_jvp(given: tuple[Array, Array, Array], moved: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    (times, values, time), (dtimes, dvalues, dtime) = given, moved
    near = AT_CORNER * jnp.finfo(times.dtype).eps * jnp.abs(time)
    before, after = (
        _value_moves(times, dtimes, dvalues, time, dtime, *_piece(times, values, beside))
        for beside in (time - near, time + near)
    )
    return _value(times, values, time), 0.5 * (before + after)


def _value_moves(
    times: Array, dtimes: Array, dvalues: Array, time: Array, dtime: Array, k: Array, slope: Array
) -> Array:
    """Change of the value on the k-th piece."""
    span = times[k + 1] - times[k]
    share = jnp.clip((time - times[k]) / jnp.where(span > 0, span, 1.0), 0.0, 1.0)
    from_first, from_last = dvalues[k] - slope * dtimes[k], dvalues[k + 1] - slope * dtimes[k + 1]
    return (1.0 - share) * from_first + share * from_last + slope * dtime
