"""Several results of one sweep over arrays: what they are made of is computed once, and the compiler makes one call of it.

XLA on the processor takes each sum or maximum by itself, computes for each again what they share, and makes two calls of one
over more than 32 values; rows stacked for one product are written out first. A reduction of several arrays at once is one loop.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax


def totals(*values: Array) -> tuple[Array, ...]:
    """Of arrays of one shape: of numbers the sum, of booleans whether any is true. Without derivatives."""
    starts = tuple(np.zeros((), v.dtype) for v in values)
    return _reduced(lambda a, b: a | b if a.dtype == bool else a + b, values, starts)


def largest(*values: Array) -> tuple[Array, ...]:
    """Of arrays of one shape, numbers, not empty, the greatest size; a NaN where one is. Without derivatives.

    As whole numbers: of numbers without a sign the greater one has the greater bits, and a NaN greater ones still. Those are
    compared side by side; what may be no number only one after the other (`python -m tests.checks_cost long_path`).
    """
    sizes = tuple(lax.bitcast_convert_type(jnp.abs(v), f"int{8 * v.dtype.itemsize}") for v in values)
    found = _reduced(lax.max, sizes, tuple(np.zeros((), v.dtype) for v in sizes))
    return tuple(lax.bitcast_convert_type(of, v.dtype) for of, v in zip(found, values, strict=True))


@jax.custom_jvp
def sums(*values: Array) -> tuple[Array, ...]:
    """Of arrays of one shape, numbers. With derivatives."""
    return totals(*values)


@sums.defjvp
def _sums_jvp(values: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    return sums(*values), tuple(jnp.sum(t) for t in tangents)


def _reduced(
    one: Callable[[Array, Array], Array], values: tuple[Array, ...], starts: tuple[np.ndarray, ...]
) -> tuple[Array, ...]:
    def of_each(a: tuple[Array, ...], b: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(one(x, y) for x, y in zip(a, b, strict=True))

    return tuple(lax.reduce(values, starts, of_each, tuple(range(values[0].ndim))))
