"""The places of the smallest values: by the library, or in loops where those are cheap."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.custom_batching import custom_vmap

from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.places import PLACE, at_places

BITS = 16
"""The first of single precision: its sign, its exponent and two digits."""
LAST = (1 << BITS) - 1
"""Of these bits the largest number: that of no value, infinity is less."""
WINDOW = 32
"""The compiler sums so many values at a time. Where the last few are fewer, it asks of each value of all whether it is there.
And so many bits has a word."""


def smallest(values: Array, count: int) -> Array:
    """(n,) -> (count,) places of the smallest, in any order. Which of two about equal ones is taken, alike in their first two
    digits, is left open. For what has no derivative."""
    single = values.astype(jnp.float32)
    return _in_loops(count)(single) if loops_are_cheap() else _by_the_library(single, count)


def _by_the_library(values: Array, count: int) -> Array:
    return lax.top_k(-values, count)[1].astype(PLACE)  # of single precision, for in double the compiler sorts all


def _in_loops(count: int) -> Any:
    """The count-th smallest is found bit by bit, then the places of what is not above it are read from a mask of them."""

    @custom_vmap
    def found(values: Array) -> Array:
        key = _in_order(values)
        whole = jnp.pad(key, (0, -key.shape[0] % WINDOW), constant_values=LAST)

        def below(limit: Array) -> Array:
            return jnp.sum(whole < limit, dtype=jnp.int32)

        def one_bit(k: Array, last: Array) -> Array:
            more = last | jnp.left_shift(jnp.asarray(1, jnp.int32), BITS - 1 - k.astype(jnp.int32))
            return jnp.where(below(more) < count, more, last)

        last = lax.fori_loop(0, BITS, one_bit, jnp.zeros((), jnp.int32))

        # Of those alike to the last one so many are taken as are missing: they come after what is below it.
        return _set_bits(jnp.concatenate([whole < last, whole == last]), count) % PLACE(whole.shape[0])

    @found.def_vmap
    def _(size: int, batched: list[bool], values: Array) -> tuple[Array, bool]:
        return jax.vmap(lambda v: _by_the_library(v, count))(values), True

    return found


def _set_bits(mask: Array, count: int) -> Array:
    """(n,) bools in whole windows, `count` of them true at least -> (count,) places of the first ones that are.

    A window is one word. So each place is found alone, by counting: of windows, then of bits, up to which no more are true."""
    bits, wanted = jnp.arange(WINDOW, dtype=PLACE), jnp.arange(count, dtype=PLACE)
    words = jnp.sum(jnp.where(mask.reshape(-1, WINDOW), (PLACE(1) << bits)[None], 0), axis=1, dtype=PLACE)
    each = lax.population_count(words)

    def counted(so_far: Array, more: Array) -> tuple[Array, Array]:
        return so_far + more, so_far + more

    # In a loop: a table of words by words would be far larger than a long list itself.
    upto = lax.scan(counted, jnp.zeros((), PLACE), each)[1]
    window = jnp.sum(upto[None] <= wanted[:, None], axis=1, dtype=PLACE)
    word, rank = at_places(words, window), wanted - at_places(upto - each, window)
    upto_bit = lax.population_count(word[:, None] & ((PLACE(2) << bits) - 1)[None])
    return window * PLACE(WINDOW) + jnp.sum(upto_bit <= rank[:, None], axis=1, dtype=PLACE)


def _in_order(values: Array) -> Array:
    """Whole numbers from 0 in the order of single-precision ones, by their first bits; what is no number comes last."""
    bits = lax.bitcast_convert_type(jnp.where(jnp.isnan(values), jnp.inf, values), jnp.int32)
    return jnp.where(bits < 0, ~bits, bits ^ (-1 << 31)) >> (32 - BITS) & LAST
