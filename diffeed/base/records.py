"""Frozen dataclasses that JAX can walk through, with the unit and meaning of every field beside it.

A record holds numbers (leaves: traced, differentiable) and words (static: kinds, names, counts). It converts and checks
nothing: JAX rebuilds records with tracers in them. `diffeed.input.parts.normalise` and `diffeed.check` do both, at the door.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, TypeVar, dataclass_transform

import jax

from diffeed.base.record_html import record_table

T = TypeVar("T")
REQUIRED = dataclasses.MISSING


def number(
    default: Any = REQUIRED,
    *,
    unit: str,
    doc: str,
    shape: tuple[int | str, ...] = (),
    bound: str = "any",
    optional: bool = False,
) -> Any:
    """A leaf. `bound` is "any", "positive" or "nonnegative"; `optional` admits None (the part has no such thing).

    A string in `shape` stands for a length known only at run time ("bars", "points").
    """
    meta = {"role": "number", "unit": unit, "doc": doc, "shape": shape, "bound": bound, "optional": optional}
    return dataclasses.field(default=default, metadata=meta)


def word(default: Any = REQUIRED, *, doc: str, choices: tuple[Any, ...] = (), type: type = str) -> Any:
    """A static field: part of the structure, fixed at compile time."""
    meta = {"role": "word", "doc": doc, "choices": choices, "type": type}
    return dataclasses.field(default=default, metadata=meta)


def part(
    default: Any = REQUIRED,
    *,
    doc: str,
    kinds: tuple[type, ...] = (),
    many: bool = False,
    default_factory: Any = REQUIRED,
) -> Any:
    """A nested record, or (with `many`) a dictionary of named records."""
    meta = {"role": "part", "doc": doc, "kinds": kinds, "many": many}
    if many:
        return dataclasses.field(default_factory=default_factory, metadata=meta)
    return dataclasses.field(default=default, metadata=meta)


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False, field_specifiers=(number, word, part))
def record(cls: type[T]) -> type[T]:
    """Make `cls` a frozen, keyword-only dataclass and a JAX pytree whose `word` fields are static."""
    made = dataclasses.dataclass(frozen=True, eq=False, kw_only=True)(cls)
    if "_repr_html_" not in vars(cls):
        made._repr_html_ = record_table  # type: ignore[attr-defined]
    static = [f.name for f in dataclasses.fields(made) if f.metadata.get("role") == "word"]  # type: ignore[arg-type]
    leaves = [f.name for f in dataclasses.fields(made) if f.name not in static]  # type: ignore[arg-type]
    return jax.tree_util.register_dataclass(made, data_fields=leaves, meta_fields=static)


def fields(kind: type | object) -> Iterator[dataclasses.Field[Any]]:
    """The fields of a record or record class, in the order they were written."""
    return iter(dataclasses.fields(kind))  # type: ignore[arg-type]


def is_required(field: dataclasses.Field[Any]) -> bool:
    """Whether a field has no default: a file must give it."""
    return field.default is REQUIRED and field.default_factory is REQUIRED


def replace(instance: T, **changes: Any) -> T:
    """A copy of a record with some fields changed."""
    return dataclasses.replace(instance, **changes)  # type: ignore[type-var]
