"""Rows summed at places that are found only in the run, as a loop where loops are cheap.

A primitive of its own, for a batch takes another way than one sample: there a loop over rows at places of each sample's own would
be a loop of scatters, and one scatter is cheaper.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from diffeed.base.one_kernel import loops_are_cheap


def add_at(count: int, index: Array, values: Array) -> Array:
    """(rows,) places below `count` and (rows, k) -> (count, k): at each place the sum of its rows."""
    return _add_at.bind(index, values, count=count)


def summed_at(count: int, index: Array, values: Array) -> Array:
    """(k, rows) and (rows,) places -> (k, count): the same, rows last."""
    if loops_are_cheap():
        return add_at(count, index, values.T).T
    return jnp.zeros((values.shape[0], count), values.dtype).at[:, index].add(values, mode="promise_in_bounds")


def _scattered(index: Array, values: Array, *, count: int) -> Array:
    nothing = jnp.zeros((count, *values.shape[1:]), values.dtype)
    return nothing.at[index].add(values, mode="promise_in_bounds")


def _in_a_loop(index: Array, values: Array, *, count: int) -> Array:
    def one(sums: Array, row: tuple[Array, Array]) -> tuple[Array, None]:
        place, value = row
        return lax.dynamic_update_index_in_dim(
            sums, lax.dynamic_index_in_dim(sums, place, keepdims=False) + value, place, 0
        ), None

    return lax.scan(one, jnp.zeros((count, *values.shape[1:]), values.dtype), (index, values))[0]


def _either(index: Array, values: Array, *, count: int) -> Array:
    return (_in_a_loop if loops_are_cheap() else _scattered)(index, values, count=count)


def _of_a_batch(given: tuple[Array, Array], axes: tuple[Any, Any], *, count: int) -> tuple[Array, int]:
    many = jax.vmap(lambda index, values: _scattered(index, values, count=count), in_axes=axes)
    return many(*given), 0


def _transposed(change: Any, index: Array, values: Any, *, count: int) -> tuple[None, Any]:
    return None, ad.Zero(values.aval) if isinstance(change, ad.Zero) else change[index]


_add_at = Primitive("add_at")
_add_at.def_impl(jax.jit(_either, static_argnames=("count",)))
_add_at.def_abstract_eval(lambda index, values, *, count: ShapedArray((count, *values.shape[1:]), values.dtype))
mlir.register_lowering(_add_at, mlir.lower_fun(_either, multiple_results=False))
ad.defjvp(_add_at, None, lambda change, index, values, *, count: add_at(count, index, change))
ad.primitive_transposes[_add_at] = _transposed
batching.primitive_batchers[_add_at] = _of_a_batch
