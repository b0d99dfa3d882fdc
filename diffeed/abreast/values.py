"""What a walk through a function hands on: arrays that are the same for all samples, and such as differ."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax


class Abreast(NamedTuple):
    """One array for each sample, (..., samples)."""

    values: Array


Value = Any
"""An `Abreast`, or an array that all samples share."""


def differs(value: Value) -> bool:
    """Whether samples may have different ones."""
    return isinstance(value, Abreast)


def shape_of(value: Value) -> tuple[int, ...]:
    """Of one sample."""
    return value.values.shape[:-1] if isinstance(value, Abreast) else jnp.shape(value)


def of_all(value: Value, size: int) -> Array:
    """(..., samples): one that all share is repeated."""
    if isinstance(value, Abreast):
        return value.values
    shared = jnp.asarray(value)
    return lax.broadcast_in_dim(shared, (*shared.shape, size), tuple(range(shared.ndim)))


def alike(values: list[Value], size: int) -> list[Array]:
    """Of one shape with samples last: numbers and axes of length one are repeated."""
    shape = max((shape_of(v) for v in values), key=len)
    for value in values:
        if len(shape_of(value)) == len(shape):
            shape = tuple(max(a, b) if 0 not in (a, b) else 0 for a, b in zip(shape, shape_of(value), strict=True))
    return [repeated(of_all(v, size), (*shape, size)) for v in values]


def repeated(values: Array, shape: tuple[int, ...]) -> Array:
    """(..., samples) of as many axes or none, to a shape with samples last."""
    if values.shape == shape:
        return values
    whole = (1,) * (len(shape) - values.ndim) + values.shape
    kept = tuple(k for k, n in enumerate(whole) if n == shape[k])
    return lax.broadcast_in_dim(lax.reshape(values, [whole[k] for k in kept]), shape, kept)
