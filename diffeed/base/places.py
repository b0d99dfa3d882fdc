"""Values taken from and summed at places that are found only in the run.

They are summed in a loop where loops are cheap: a primitive of its own, for a batch takes another way than one sample. There a
loop over values at places of each sample's own would be a loop of scatters, and one scatter is cheaper.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from diffeed.base.one_kernel import loops_are_cheap

PLACE = np.uint32
"""What places are counted in: without a sign, so that the compiler need not ask of each whether it lies below 0."""


def at_places(values: Array, index: Array | np.ndarray) -> Array:
    """(..., n) and places below n of any shape -> (..., *shape). By `values[..., index]` places would get a sign."""
    before, count = values.shape[:-1], values.ndim - 1
    of_last = lax.GatherDimensionNumbers(tuple(range(count)), collapsed_slice_dims=(count,), start_index_map=(count,))
    start, mode = jnp.asarray(index, PLACE)[..., None], lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return lax.gather(values, start, of_last, (*before, 1), mode=mode)


def add_at(count: int, index: Array | np.ndarray, values: Sequence[Array]) -> list[Array]:
    """(rows,) places below `count` and several (rows,) -> (count,) of each: at each place the sum of its rows."""
    return _add_at.bind(jnp.asarray(index, PLACE), *values, count=count, apart=False)


def put_at(count: int, index: Array | np.ndarray, values: Sequence[Array]) -> list[Array]:
    """The same where no two rows have one place, but for a place of `count` for what is not asked for: it is left out."""
    return [v[:-1] for v in _add_at.bind(jnp.asarray(index, PLACE), *values, count=count + 1, apart=True)]


def rows_at(count: int, index: Array) -> Array:
    """(rows,) places, each of one row but for the last place -> (count,): 1 and up the row of each, 0 where there is none; of the
    last one any."""
    rows = index.shape[0]
    (found,) = _in_a_loop(index, jnp.arange(1, rows + 1, dtype=PLACE), count=count)
    return jnp.minimum(found, PLACE(rows))


def add_within(count: int, index: Array | np.ndarray, values: Array) -> Array:
    """(rows,) places and (rows,) -> (count,): the same of one array, without rows whose place is not below `count`. Each place
    takes its rows where it is known beforehand which those are."""
    if not isinstance(index, np.ndarray):
        return add_at(count + 1, jnp.minimum(index, count), [values])[0][:-1]
    nothing, times = values.shape[0], np.bincount(index, minlength=count)[:count]
    width = 1 << np.ceil(np.log2(np.maximum(times, 1))).astype(int)  # those of about as many rows together
    rows, sums, slot, filled = jnp.pad(values, (0, 1)), [jnp.zeros((1,), values.dtype)], np.zeros(count, PLACE), 1
    for most in np.unique(width[times > 0]):
        alike = np.flatnonzero((width == most) & (times > 0))
        table = np.full((most, len(alike)), nothing)
        for column, place in enumerate(alike):
            table[: times[place], column] = np.flatnonzero(index == place)
        sums.append(jnp.sum(at_places(rows, table), axis=0))
        slot[alike], filled = filled + np.arange(len(alike)), filled + len(alike)
    return at_places(jnp.concatenate(sums), slot)


def summed_at(count: int, index: Array, values: Array) -> Array:
    """(k, rows) and (rows,) places -> (k, count): the same of rows of one array."""
    if loops_are_cheap():
        return jnp.stack(add_at(count, index, list(values)))
    return jnp.zeros((values.shape[0], count), values.dtype).at[:, index].add(values, mode="promise_in_bounds")


def _scattered(index: Array, *values: Array, count: int) -> list[Array]:
    """What is of one row stands side by side, as a scatter wants it: else all is copied first."""
    nothing = jnp.zeros((count, len(values)), values[0].dtype)
    return list(nothing.at[index].add(jnp.stack(values, axis=-1), mode="promise_in_bounds").T)


def _in_a_loop(index: Array, *values: Array, count: int) -> list[Array]:
    """Of two arrays, though they are joined before: every turn of a loop sets down where each array is that it carries."""
    rows = jnp.stack(values)

    def one(sums: Array, at: tuple[Array, Array]) -> tuple[Array, None]:
        row, place = at
        for k in map(PLACE, range(len(values))):
            more = lax.dynamic_slice(sums, (k, place), (1, 1)) + lax.dynamic_slice(rows, (k, row), (1, 1))
            sums = lax.dynamic_update_slice(sums, more, (k, place))
        return sums, None

    nothing = jnp.zeros((len(values), count), values[0].dtype)
    return list(lax.scan(one, nothing, (jnp.arange(index.shape[0], dtype=PLACE), index))[0])


def _from_rows(index: Array, *values: Array, count: int) -> list[Array]:
    """Each place takes its row, for fewer are written than there are places."""
    rows = jnp.pad(jnp.stack(values), ((0, 0), (1, 0)))
    return list(at_places(rows, rows_at(count, index)))


def _either(index: Array, *values: Array, count: int, apart: bool) -> list[Array]:
    if not loops_are_cheap():
        return _scattered(index, *values, count=count)
    return (_from_rows if apart else _in_a_loop)(index, *values, count=count)


def _of_a_batch(
    given: Sequence[Array], axes: Sequence[Any], *, count: int, apart: bool
) -> tuple[list[Array], list[int]]:
    many = jax.vmap(lambda index, *values: _scattered(index, *values, count=count), in_axes=tuple(axes))
    return many(*given), [0] * (len(given) - 1)


def _moved(given: Sequence[Array], changes: Sequence[Any], *, count: int, apart: bool) -> tuple[list[Array], list[Any]]:
    index, *values = given
    # What does not change is not summed.
    moving = [change for change in changes[1:] if not isinstance(change, ad.Zero)]
    both = functools.partial(_add_at.bind, index, count=count, apart=apart)
    sums, moved = both(*values), iter(both(*moving) if moving else [])
    return sums, [
        ad.Zero(ShapedArray((count,), value.dtype)) if isinstance(change, ad.Zero) else next(moved)
        for value, change in zip(values, changes[1:], strict=True)
    ]


def _transposed(changes: Sequence[Any], index: Array, *values: Any, count: int, apart: bool) -> list[Any]:
    of_each = [
        ad.Zero(value.aval) if isinstance(change, ad.Zero) else change[index]
        for change, value in zip(changes, values, strict=True)
    ]
    return [None, *of_each]


_add_at = Primitive("add_at")
_add_at.multiple_results = True
_add_at.def_impl(jax.jit(_either, static_argnames=("count", "apart")))
_add_at.def_abstract_eval(lambda index, *values, count, apart: [ShapedArray((count,), v.dtype) for v in values])
mlir.register_lowering(_add_at, mlir.lower_fun(_either, multiple_results=True))
ad.primitive_jvps[_add_at] = _moved
ad.primitive_transposes[_add_at] = _transposed
batching.primitive_batchers[_add_at] = _of_a_batch
