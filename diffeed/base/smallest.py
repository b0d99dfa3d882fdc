"""The places of the smallest values: by the library, or in loops where those are cheap."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
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

        return _set_bits(whole < last, whole == last, count)

    @found.def_vmap
    def _(size: int, batched: list[bool], values: Array) -> tuple[Array, bool]:
        return jax.vmap(lambda v: _by_the_library(v, count))(values), True

    return found


def _set_bits(first: Array, then: Array, count: int) -> Array:
    """Two (n,) of bools in whole windows, together `count` of them true at least -> (count,) places in ascending order: of all
    of the first, and of so many of the others as are missing. So where one stands does not depend on how urgent others are.

    A window is one word. So each place is found alone, by counting: of windows, then of bits, up to which no more are true."""
    first, then = first.reshape(-1, WINDOW), then.reshape(-1, WINDOW)
    spare = _words(then)
    missing = PLACE(count) - jnp.sum(lax.population_count(_words(first)), dtype=PLACE)
    rank = (_up_to(spare) - lax.population_count(spare))[:, None] + lax.population_count(spare[:, None] & _UP_TO_BIT)
    words = _words(first | (then & (rank <= missing)))

    wanted, upto = jnp.arange(count, dtype=PLACE), _up_to(words)
    window = jnp.sum(upto[None] <= wanted[:, None], axis=1, dtype=PLACE)
    word, before = at_places(words, window), at_places(upto - lax.population_count(words), window)
    upto_bit = lax.population_count(word[:, None] & _UP_TO_BIT)
    return window * PLACE(WINDOW) + jnp.sum(upto_bit <= (wanted - before)[:, None], axis=1, dtype=PLACE)


_UP_TO_BIT = ((np.uint64(2) << np.arange(WINDOW, dtype=np.uint64)) - np.uint64(1)).astype(PLACE)[None]


def _words(mask: Array) -> Array:
    """(windows, WINDOW) bools -> (windows,) bits."""
    bits = np.left_shift(PLACE(1), np.arange(WINDOW, dtype=PLACE))
    return jnp.sum(jnp.where(mask, bits[None], PLACE(0)), axis=1, dtype=PLACE)


def _up_to(words: Array) -> Array:
    """(windows,) how many bits are set in each and before. In a loop: a table of words by words would be far larger than a long
    list itself."""

    def counted(so_far: Array, more: Array) -> tuple[Array, Array]:
        return so_far + more, so_far + more

    return lax.scan(counted, jnp.zeros((), PLACE), lax.population_count(words))[1]


def _in_order(values: Array) -> Array:
    """Whole numbers from 0 in the order of single-precision ones, by their first bits; what is no number comes last."""
    bits = lax.bitcast_convert_type(jnp.where(jnp.isnan(values), jnp.inf, values), jnp.int32)
    return jnp.where(bits < 0, ~bits, bits ^ (-1 << 31)) >> (32 - BITS) & LAST
