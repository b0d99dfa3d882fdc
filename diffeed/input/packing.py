"""A scene as few arrays: what is compiled, and what a call costs, must not grow with the number of parts.

A compiled function has an argument for every array that goes into it, and is compiled for every one of them. So known
numbers of rollers and guides go in as two tables, one of scalars and one of vectors. Traced numbers (of a derivative, of a
batch) stay what they are, beside the tables.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from diffeed.base.records import record, replace, word
from diffeed.input.parts import Motion, Profile, Scene

SHAPES = ((), (2,))
"""Of the numbers in each table."""
LOOSE = len(SHAPES)


class Row:
    """A number or vector that lies in a table, not taken out: only `stacked` may use it."""

    __slots__ = ("index", "table")

    def __init__(self, table: Array, index: int) -> None:
        self.table, self.index = table, index


@record
class Packed:
    """A scene without its rollers and guides, and these as tables and loose leaves."""

    rest: Scene
    tables: tuple[Any, ...]  # (n,) and (n, 2)
    loose: tuple[Any, ...]
    places: bytes = word(doc="the table of each leaf, or LOOSE", type=bytes)
    tree: Any = word(doc="structure of the rollers and guides", type=object)


def jit_of_scene(function: Callable[..., Any] | None = None, *, static_argnames: Sequence[str] = ()) -> Any:
    """`jax.jit` of a function whose first argument is a normalised scene.

    Within the function, numbers of rollers and guides may be rows of tables: `build` and `stacked` know them, nothing else
    does, so that `bare(scene)` is what may be handed on. What JAX compiles is the attribute `program`, a function of
    `pack(scene)` and the other arguments.
    """
    if function is None:
        return functools.partial(jit_of_scene, static_argnames=static_argnames)

    @functools.partial(jax.jit, static_argnames=static_argnames)
    @functools.wraps(function)
    def program(packed: Packed, *more: Any, **named: Any) -> Any:
        return function(_unpack(packed), *more, **named)

    @functools.wraps(function)
    def call(scene: Scene, *more: Any, **named: Any) -> Any:
        return program(pack(scene), *more, **named)

    call.program = program  # type: ignore[attr-defined]
    return call


def pack(scene: Scene) -> Packed:
    """A normalised scene as few arrays."""
    leaves, tree = jax.tree.flatten((scene.rollers, scene.guides), is_leaf=_is_record)
    places = bytes(_place(leaf) for leaf in leaves)
    chosen: list[list[Any]] = [[] for _ in range(LOOSE + 1)]
    for place, leaf in zip(places, leaves, strict=True):
        chosen[place].append(leaf)
    dtype = scene.gravity.dtype
    tables = (
        np.array([np.asarray(leaf) for leaf in chosen[place]], dtype).reshape(-1, *shape)
        for place, shape in enumerate(SHAPES)
    )
    return Packed(rest=bare(scene), tables=tuple(tables), loose=tuple(chosen[LOOSE]), places=places, tree=tree)


def bare(scene: Scene) -> Scene:
    """A scene without rollers and guides."""
    return replace(scene, rollers={}, guides={})


def _is_record(value: Any) -> bool:
    """What holds arrays of its own stays together."""
    return isinstance(value, (Profile, Motion))


def _place(leaf: Any) -> int:
    known = isinstance(leaf, (jax.Array, np.ndarray)) and not isinstance(leaf, Tracer)
    return SHAPES.index(leaf.shape) if known and leaf.shape in SHAPES else LOOSE


def _unpack(packed: Packed) -> Scene:
    each = [*(map(functools.partial(Row, table), range(len(table))) for table in packed.tables), iter(packed.loose)]
    rollers, guides = jax.tree.unflatten(packed.tree, [next(each[place]) for place in packed.places])
    return replace(packed.rest, rollers=rollers, guides=guides)


def stacked(values: Sequence[Any], shape: tuple[int, ...] = ()) -> Array:
    """(n, *shape) array of numbers of one shape, rows of tables among them or not; an empty one for none."""
    if not values:
        return jnp.zeros((0, *shape))
    rows = [v for v in values if isinstance(v, Row)]
    loose = [v for v in values if not isinstance(v, Row)]
    if not rows:
        return _joined(loose)
    known = rows[0].table[np.array([row.index for row in rows])]
    if not loose:
        return known
    is_loose = np.array([not isinstance(v, Row) for v in values])
    place = np.where(is_loose, len(rows) + np.cumsum(is_loose), np.cumsum(~is_loose)) - 1
    return jnp.concatenate([known, _joined(loose)])[place]


def _joined(values: list[Any]) -> Array:
    dtype = jnp.result_type(float)
    if all(isinstance(v, float) for v in values):
        return jnp.asarray(np.array(values), dtype)
    return jnp.stack([jnp.asarray(v, dtype) for v in values])
