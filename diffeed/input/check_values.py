"""One value of a record against the metadata of its field. Takes any Python object and never raises."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from diffeed.base.words import quoted, short
from diffeed.input.parts import Motion, Profile

Field = dataclasses.Field[Any]
Sizes = Mapping[str, int]
VARYING = ("angular_speed", "surface_speed")
"""Number fields that may be a profile."""

_BOUNDS = {"positive": "> 0", "nonnegative": ">= 0"}


class Numbers(NamedTuple):
    """The shape of what was given and its entries; entries are None where JAX is tracing."""

    shape: tuple[int, ...]
    entries: np.ndarray | None


def measure(value: Any, depth: int = 3) -> Numbers | None:
    """The numbers in a value (a number, an array, equal lists of them), or None if it is anything else."""
    if isinstance(value, (list, tuple)):
        return _measure_list(value, depth - 1) if depth else None
    if isinstance(value, (bool, np.bool_)):
        return None
    if isinstance(value, int):
        return Numbers((), np.asarray(_as_float(value)))
    if isinstance(value, float):
        return Numbers((), np.asarray(value))
    if not isinstance(value, (np.generic, np.ndarray, jax.Array)):
        return None
    if not (jnp.issubdtype(value.dtype, np.floating) or jnp.issubdtype(value.dtype, np.integer)):
        return None
    return Numbers(np.shape(value), None if isinstance(value, Tracer) else np.asarray(value, dtype=float))


def _measure_list(values: list[Any] | tuple[Any, ...], depth: int) -> Numbers | None:
    rows = [measure(v, depth) for v in values]
    if not rows:
        return Numbers((0,), np.zeros(0))
    entries, shape = [], (rows[0].shape if rows[0] else ())
    for row in rows:
        if row is None or row.shape != shape:
            return None
        entries.append(row.entries)
    traced = any(e is None for e in entries)
    return Numbers((len(rows), *shape), None if traced else np.stack(entries))


def _as_float(value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def show(value: Any) -> str:
    """A value as a sentence quotes it: short, and never an exception."""
    try:
        return _show(value)
    except Exception:
        return f"a {type(value).__name__} that cannot be shown"


def _show(value: Any) -> str:
    if value is None:
        return "missing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, Tracer):
        return "a value that JAX traces"
    if isinstance(value, (np.generic, np.ndarray, jax.Array)):
        return short(value.tolist())
    if isinstance(value, (dict, Profile, Motion)):
        return "a table" if isinstance(value, dict) else f"a {type(value).__name__.lower()}"
    return f"a {type(value).__name__}" if dataclasses.is_dataclass(value) else short(value)


def quote(choices: Any) -> str:
    return " or ".join(f'"{c}"' for c in choices)


def number_problem(path: str, value: Any, field: Field, sizes: Sizes) -> str | None:
    """What is wrong with a number field, as a sentence, or None."""
    if value is None:
        return None if field.metadata["optional"] else f"{path} is missing: it must be {_wanted(field, sizes)}"
    found = measure(value)
    if found is None or not _fits(found.shape, field.metadata["shape"], sizes):
        return f"{path} must be {_wanted(field, sizes)}, but is {show(value)}"
    return None if found.entries is None else _entries_problem(path, value, found.entries, field)


def _entries_problem(path: str, value: Any, entries: np.ndarray, field: Field) -> str | None:
    with np.errstate(over="ignore"):  # judge what the simulator will see: 1e300 is infinite in float32
        entries = entries.astype(jnp.result_type(float))
    if not np.isfinite(entries).all():
        return f"{path} must be finite, but is {show(value)}"
    bound = field.metadata["bound"]
    if (bound == "positive" and not (entries > 0).all()) or (bound == "nonnegative" and not (entries >= 0).all()):
        return f"{path} must be {_BOUNDS[bound]}{_unit(field, ' ')}, but is {show(value)}"
    return None


def _fits(shape: tuple[int, ...], wanted: tuple[int | str, ...], sizes: Sizes) -> bool:
    """Whether a shape is the wanted one; a length that is not known may be any but zero."""
    if len(shape) != len(wanted):
        return False
    lengths = [sizes.get(w) if isinstance(w, str) else w for w in wanted]
    return all(n > 0 if want is None else n == want for n, want in zip(shape, lengths, strict=True))


def _wanted(field: Field, sizes: Sizes) -> str:
    shape, bound = field.metadata["shape"], _BOUNDS.get(field.metadata["bound"])
    tail = (f" {bound}" if bound else "") + _unit(field, " in ")
    if not shape:
        profile = " or a profile {times = [...], values = [...]}" if field.name in VARYING else ""
        return f"a number{tail}{profile}"
    count = sizes.get(shape[0], "a list of one or more") if isinstance(shape[0], str) else shape[0]
    each = "numbers" if len(shape) == 1 else "pairs of numbers"
    why = ", one for each bar" if shape[0] == "bars" else ""
    return f"{count} {each}{tail}{why}"


def _unit(field: Field, before: str) -> str:
    unit = field.metadata["unit"]
    return "" if unit == "1" or unit.startswith("that of") else before + unit


def word_problem(path: str, value: Any, field: Field) -> str | None:
    """What is wrong with a static field, as a sentence, or None."""
    choices, kind = field.metadata["choices"], field.metadata["type"]
    if kind is object or (_is_kind(value, kind) and (not choices or value in choices)):
        return None
    named = {
        str: f"a word ({field.metadata['doc']})",
        int: "a whole number",
        float: "a plain number",
        bool: "true or false",
    }
    wanted = quote(choices) if choices else named[kind]
    return (
        f"{path} is missing: it must be {wanted}" if value is None else f"{path} must be {wanted}, but is {show(value)}"
    )


def _is_kind(value: Any, kind: type) -> bool:
    if kind is float:
        found = measure(value)
        return found is not None and found.shape == () and found.entries is not None
    if kind is int:
        return isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return isinstance(value, kind)


def sound(record: Any, name: str, sizes: Sizes | None = None) -> np.ndarray | None:
    """The entries of a number field that can be compared with others: given, right in itself, not traced."""
    field = next(f for f in dataclasses.fields(record) if f.name == name)
    value = getattr(record, name)
    if value is None or number_problem(name, value, field, sizes or {}):
        return None
    found = measure(value)
    return found.entries if found else None


def number_of(record: Any, name: str) -> float | None:
    """The same of a field of one number."""
    value = sound(record, name)
    return float(value) if value is not None and np.ndim(value) == 0 else None
