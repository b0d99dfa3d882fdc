"""How operations on arrays are computed for samples abreast. `Rule`s by the name of JAX's operation; what has none goes by
`jax.vmap`, right but slow (`by_vmap`)."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.extend.core import Primitive

from diffeed.abreast.values import Abreast, Value, alike, differs, of_all, repeated, shape_of
from diffeed.base.places import PLACE, rows_at

Rule = Callable[..., list[Value]]
"""From the operation, how many samples there are, its operands (one at least an `Abreast`) and its parameters to its results."""

RULES: dict[str, Rule] = {}

BY_ELEMENT = """
    abs acos acosh add and asin asinh atan atan2 atanh bitcast_convert_type cbrt ceil clamp convert_element_type copy cos
    cosh div eq eq_to erf erf_inv erfc exp exp2 expm1 floor ge gt integer_pow is_finite le le_to log log1p logistic lt
    lt_to max min mul name ne neg nextafter not or population_count pow rem round rsqrt shift_left
    shift_right_arithmetic shift_right_logical sign sin sinh sqrt square stop_gradient sub tan tanh xor
"""
JOINED: dict[str, Callable[[Array, Array], Array]] = {
    "reduce_sum": lax.add,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_and": lax.bitwise_and,
    "reduce_or": lax.bitwise_or,
}
ROW_BY_ROW = 200
"""Rows that are summed one after the other, all samples at once: XLA sums more for one sample after the other, but so few slower
(film feeder, 0 to 600 rows: script)."""


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Enter a rule for operations."""

    def enter(of: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, of))
        return of

    return enter


def by_vmap(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    """Samples first, and back."""
    axes = [0 if differs(v) else None for v in given]
    moved = [jnp.moveaxis(v.values, -1, 0) if isinstance(v, Abreast) else v for v in given]
    found = jax.vmap(lambda *one: primitive.bind(*one, **params), in_axes=axes)(*moved)
    return [Abreast(jnp.moveaxis(v, 0, -1)) for v in (found if primitive.multiple_results else [found])]


@rule(*BY_ELEMENT.split())
def _by_element(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    return [Abreast(primitive.bind(*alike(given, size), **params))]


@rule("select_n")
def _select(primitive: Primitive, size: int, given: list[Value]) -> list[Value]:
    which, *cases = given
    cases = alike(cases, size)
    if differs(which) or shape_of(which):
        which = repeated(of_all(which, size), cases[0].shape)
    return [Abreast(primitive.bind(which, *cases))]


@rule("broadcast_in_dim")
def _broadcast(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    shape, axes = params["shape"], params["broadcast_dimensions"]
    return [Abreast(lax.broadcast_in_dim(given[0].values, (*shape, size), (*axes, len(shape))))]


@rule("reshape")
def _reshape(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    if params["dimensions"] is not None:
        return by_vmap(primitive, size, given, **params)
    return [Abreast(lax.reshape(given[0].values, (*params["new_sizes"], size)))]


@rule("squeeze")
def _squeeze(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    return [Abreast(lax.squeeze(given[0].values, params["dimensions"]))]


@rule("transpose")
def _transpose(primitive: Primitive, size: int, given: list[Value], *, permutation: tuple[int, ...]) -> list[Value]:
    return [Abreast(lax.transpose(given[0].values, (*permutation, len(permutation))))]


@rule("slice")
def _slice(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    start, limit, strides = (params[k] for k in ("start_indices", "limit_indices", "strides"))
    return [Abreast(lax.slice(given[0].values, (*start, 0), (*limit, size), strides and (*strides, 1)))]


@rule("split")
def _split(primitive: Primitive, size: int, given: list[Value], *, sizes: Any, axis: int) -> list[Value]:
    return [Abreast(v) for v in lax.split(given[0].values, sizes, axis)]


@rule("concatenate")
def _concatenate(primitive: Primitive, size: int, given: list[Value], *, dimension: int) -> list[Value]:
    return [Abreast(lax.concatenate([of_all(v, size) for v in given], dimension))]


@rule("stack")
def _stack(primitive: Primitive, size: int, given: list[Value], *, axis: int) -> list[Value]:
    return [Abreast(jnp.stack([of_all(v, size) for v in given], axis))]


@rule("pad")
def _pad(primitive: Primitive, size: int, given: list[Value], *, padding_config: Any) -> list[Value]:
    values, filling = given
    if differs(filling):
        return by_vmap(primitive, size, given, padding_config=padding_config)
    return [Abreast(lax.pad(values.values, filling, (*padding_config, (0, 0, 0))))]


@rule("argmax", "argmin", "cumsum", "cummax", "cummin", "cumprod", "cumlogsumexp", "rev", "reduce_prod")
def _along_axes(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    return [Abreast(primitive.bind(given[0].values, **params))]


@rule(*JOINED)
def _joined(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    rows = _in_rows(given[0].values, params["axes"])
    if not 0 < rows.shape[0] <= ROW_BY_ROW:
        return [Abreast(primitive.bind(given[0].values, **params))]
    join = JOINED[primitive.name]
    return [Abreast(lax.scan(lambda so_far, row: (join(so_far, row), None), rows[0], rows[1:])[0])]


@rule("reduce")
def _reduced(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    count, join = len(given) // 2, params["computation"]
    if any(differs(start) for start in given[count:]):
        return by_vmap(primitive, size, given, **params)
    rows = tuple(_in_rows(of_all(v, size), params["dimensions"]) for v in given[:count])
    start = tuple(jnp.full(v.shape[1:], first, v.dtype) for v, first in zip(rows, given[count:], strict=True))
    found = lax.scan(lambda so_far, row: (tuple(join(so_far, row)), None), start, rows)[0]
    return [Abreast(v) for v in found]


def _in_rows(values: Array, axes: tuple[int, ...]) -> Array:
    """What is to be joined along the first axis."""
    others = tuple(k for k in range(values.ndim) if k not in axes)
    moved = lax.transpose(values, (*axes, *others)) if axes != tuple(range(len(axes))) else values
    count = math.prod(values.shape[k] for k in axes)
    return lax.reshape(moved, (count, *(values.shape[k] for k in others)))


@rule("gather")
def _gather(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    values, places = given
    numbers = params.pop("dimension_numbers")
    if isinstance(places, Abreast):
        return [Abreast(_each_its_own(primitive, of_all(values, size), places.values, numbers, **params))]
    last = len(numbers.offset_dims) + jnp.ndim(places) - 1
    numbers = numbers._replace(offset_dims=(*numbers.offset_dims, last))
    sizes = (*params.pop("slice_sizes"), size)
    return [Abreast(primitive.bind(values.values, places, dimension_numbers=numbers, slice_sizes=sizes, **params))]


def _each_its_own(primitive: Primitive, values: Array, places: Array, numbers: Any, **params: Any) -> Array:
    """Where each sample asks for other places, (..., 1, samples)."""
    shape = (*places.shape[:-2], places.shape[-1])
    offset = numbers.offset_dims
    # Samples come last of the axes of places, with those of slices before and behind.
    axes = [k for k in range(len(offset) + len(shape) - 1) if k not in offset]
    at = axes[-1] + 1 if axes else 0
    numbers = numbers._replace(
        offset_dims=tuple(k + (k >= at) for k in offset),
        operand_batching_dims=(*numbers.operand_batching_dims, values.ndim - 1),
        start_indices_batching_dims=(*numbers.start_indices_batching_dims, len(shape) - 1),
    )
    sizes, places = (*params.pop("slice_sizes"), 1), jnp.swapaxes(places, -1, -2)
    return jnp.moveaxis(primitive.bind(values, places, dimension_numbers=numbers, slice_sizes=sizes, **params), at, -1)


@rule("scatter", "scatter-add", "scatter-max", "scatter-min", "scatter-mul", "scatter-sub")
def _scatter(primitive: Primitive, size: int, given: list[Value], **params: Any) -> list[Value]:
    values, places, more = given
    if differs(places):
        return by_vmap(primitive, size, given, **params)
    numbers, more = params.pop("dimension_numbers"), of_all(more, size)
    numbers = numbers._replace(update_window_dims=(*numbers.update_window_dims, more.ndim - 1))
    return [Abreast(primitive.bind(of_all(values, size), places, more, dimension_numbers=numbers, **params))]


@rule("dynamic_slice")
def _dynamic_slice(primitive: Primitive, size: int, given: list[Value], *, slice_sizes: Any) -> list[Value]:
    values, *start = given
    if any(differs(k) for k in start):
        return by_vmap(primitive, size, given, slice_sizes=slice_sizes)
    return [Abreast(lax.dynamic_slice(values.values, _and_all(start), (*slice_sizes, size)))]


@rule("dynamic_update_slice")
def _dynamic_update(primitive: Primitive, size: int, given: list[Value]) -> list[Value]:
    values, part, *start = given
    if any(differs(k) for k in start):
        return by_vmap(primitive, size, given)
    return [Abreast(lax.dynamic_update_slice(of_all(values, size), of_all(part, size), _and_all(start)))]


def _and_all(start: list[Any]) -> tuple[Any, ...]:
    """Where a slice starts, and that it holds all samples."""
    return (*start, lax.convert_element_type(0, jnp.asarray(start[0]).dtype if start else jnp.int32))


@rule("add_at")
def _add_at(primitive: Primitive, size: int, given: list[Value], *, count: int, apart: bool) -> list[Value]:
    """All samples of a row at once; at places of their own, one sample after the other."""
    index, *values = given
    if differs(index):
        place = index.values * PLACE(size) + jnp.arange(size, dtype=PLACE)[None]
        whole = [of_all(v, size).ravel() for v in values]
        found = primitive.bind(place.ravel(), *whole, count=count * size, apart=False)
        return [Abreast(v.reshape(count, size)) for v in found]
    if apart:
        row = rows_at(count, jnp.asarray(index))
        return [Abreast(_rows(jnp.pad(of_all(v, size), ((1, 0), (0, 0))), row)) for v in values]
    rows, first = [of_all(v, size) for v in values], PLACE(0)

    def one(sums: list[Array], at: tuple[list[Array], Array]) -> tuple[list[Array], None]:
        row, place = at
        so_far = [lax.dynamic_slice(v, (place, first), (1, size)) for v in sums]
        return [
            lax.dynamic_update_slice(v, old + new[None], (place, first))
            for v, old, new in zip(sums, so_far, row, strict=True)
        ], None

    sums = lax.scan(one, [jnp.zeros((count, size), v.dtype) for v in rows], (rows, jnp.asarray(index)))[0]
    return [Abreast(v) for v in sums]


def _rows(values: Array, index: Array) -> Array:
    """(n, samples) and (k,) places below n -> (k, samples)."""
    numbers = lax.GatherDimensionNumbers((1,), collapsed_slice_dims=(0,), start_index_map=(0,))
    mode = lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return lax.gather(values, index[:, None], numbers, (1, values.shape[1]), mode=mode)


@rule("least_of_group")
def _least(primitive: Primitive, size: int, given: list[Value]) -> list[Value]:
    return [jnp.min(given[0].values, axis=-1)]


@rule("any_of_batch")
def _any(primitive: Primitive, size: int, given: list[Value]) -> list[Value]:
    return [jnp.any(given[0].values, axis=-1)]
