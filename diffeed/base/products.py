"""Products of matrices in all digits, on every device."""

import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.one_kernel import loops_are_cheap

ALL_DIGITS = lax.Precision.HIGHEST
"""Left to themselves, accelerators take float32 products in a third of their digits: seen on a GPU, it puts a sheet 2.6e-3 mm off
after 10 ms of the film feeder, where all digits leave 1.5e-5."""
SMALL = 1 << 15
"""Products of numbers up to which they are summed in loops, where those are cheap: a call of the library, which no kernel of a
whole run may have, takes as long (`diffeed bench growth`: bars)."""
SIDE_BY_SIDE = 4
"""Numbers that a processor takes at once. From so many columns on a sum of outer products beats sums of products; where they are
no multiple of it, it asks of each number whether it is there."""


def product(a: Array, b: Array) -> Array:
    """(..., n, k) times (..., k, m), or vectors, as `@` has it."""
    if b.ndim <= 2 and loops_are_cheap() and a.size * (b.shape[1] if b.ndim == 2 else 1) <= SMALL:
        return _summed(a, b)
    return jnp.matmul(a, b, precision=ALL_DIGITS)


def _summed(a: Array, b: Array) -> Array:
    """The same as a sum, (..., n, k) times (k, m) or (k,)."""
    if a.ndim == 2 and b.ndim == 2 and b.shape[1] >= SIDE_BY_SIDE:
        nothing = jnp.zeros((a.shape[0], b.shape[1]), jnp.result_type(a, b))
        return lax.scan(lambda sum_, row: (sum_ + row[0][:, None] * row[1][None, :], None), nothing, (a.T, b))[0]
    over = b.reshape((1,) * (a.ndim - 1) + b.shape)
    return jnp.sum((a if b.ndim == 1 else a[..., None]) * over, axis=a.ndim - 1)
