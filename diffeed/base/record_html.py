"""A record as an HTML table, for a notebook: every field with its value, unit and meaning."""

import dataclasses
from html import escape
from typing import Any

import numpy as np
from jax.core import Tracer

MOST_NAMES = 12


def record_table(record: Any) -> str:
    """The table of one record; values that JAX traces are shown by their kind."""
    rows = [_row(f, getattr(record, f.name)) for f in dataclasses.fields(record)]
    return table(type(record).__name__, ("field", "value", "unit", "meaning"), rows)


def table(title: str, heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Plain cells, escaped, aligned to the left."""
    left = ' style="text-align:left"'
    head = "".join(f"<th{left}>{escape(h)}</th>" for h in heads)
    body = "".join("<tr>" + "".join(f"<td{left}>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<b>{escape(title)}</b><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _row(field: dataclasses.Field[Any], value: Any) -> tuple[str, ...]:
    meta = field.metadata
    unit = meta.get("unit", "")
    return field.name, value_text(value), "" if unit == "1" else unit, meta.get("doc", "")


def value_text(value: Any) -> str:
    """A value in one line: numbers as they are, long arrays by shape and range, parts by name."""
    if value is None:
        return "none"
    if isinstance(value, Tracer):
        return f"traced {value.dtype}{list(value.shape)}"
    if callable(getattr(value, "describe", None)):
        return _described(value)
    if isinstance(value, str):
        return value or "none"
    if callable(getattr(value, "keys", None)):
        return _names(tuple(iter(value)))
    if isinstance(value, tuple) and all(isinstance(v, str) for v in value):
        return _names(value)
    if dataclasses.is_dataclass(value):
        return type(value).__name__
    try:
        return _numbers(np.asarray(value))
    except (TypeError, ValueError):  # not numbers
        return repr(value)


def _described(value: Any) -> str:
    try:
        return value.describe() or "none"
    except (TypeError, ValueError):  # of many runs, or traced
        return type(value).__name__


def _names(names: tuple[Any, ...]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(map(str, names[:MOST_NAMES])) + more or "none"


def _numbers(array: np.ndarray) -> str:
    if array.dtype == bool and array.ndim:
        return f"{array.sum()} of {array.size} true"
    if array.ndim == 0 or array.dtype == object or array.size <= 4:
        return str(array.tolist()) if array.dtype.kind not in "fiu" else _short(array)
    return f"{' × '.join(map(str, array.shape))}, from {np.min(array):.4g} to {np.max(array):.4g}"


def _short(array: np.ndarray) -> str:
    if array.ndim == 0:
        return f"{array.item():.6g}"
    return "[" + ", ".join(_short(part) for part in array) + "]"
