"""Figures: the data of any benchmark as lines of one form, each with what it is of, its unit and the machine."""

import json
from collections.abc import Iterator
from typing import Any

from diffeed.bench.outcome import MEASURES

UNITS = {
    "compile_seconds": "s",
    "trace_seconds": "s",
    "run_seconds": "s",
    "us_per_step": "us",
    "us_per_sample_step": "us",
    "steps_per_second": "1/s",
    "equations": "1",
    "runs": "1",
    "steps": "1",
    "failed": "1",
    "peak_mb": "MB",
    "temporary_mb": "MB",
    "planned_mb": "MB",
    "error_mm": "mm",
    "told_mm": "mm",
    "lead_error_mm": "mm",
    "lead_mm": "mm",
    "force_n": "N",
    "force_error_n": "N",
    "force_ripple_n": "N",
    "slip_mm_s": "mm/s",
    "slip_ripple_mm_s": "mm/s",
    "trend_mm_per_unit": "mm per unit of the number",
    "scatter_um": "um",
}
"""What counts as a figure in a row of a benchmark -> its unit; everything else in the row says what it is of."""


def lines(benchmark: str, data: dict[str, Any]) -> Iterator[str]:
    """A line of JSON for each figure in the data of a benchmark's file; a row without any is a line that says why."""
    for of, figures in _front(data) if "reference" in data else _rows(data):
        for name, value, unit in figures or [(None, None, None)]:
            found = {"benchmark": benchmark, "of": of, "figure": name, "value": value, "unit": unit}
            yield json.dumps({**found, "machine": data["machine"]}, allow_nan=False)


Figures = list[tuple[str, Any, str]]


def _rows(data: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Figures]]:
    common = {k: v for k, v in data.items() if not isinstance(v, (dict, list))}
    for row in data["rows"]:
        figures = _known(row)
        taken = {name for name, *_ in figures}
        yield common | {k: v for k, v in row.items() if k not in taken and v is not None}, figures
    for row in data.get("exponents", []):
        found = [(f"power of {name}", value, "1") for name, value, _ in _known(row)]
        yield common | {"series": row["series"]}, found


def _known(row: dict[str, Any]) -> Figures:
    """Numbers: a word of that name, such as the `steps` that a row is of, says what the others are of."""
    return [(name, row[name], unit) for name, unit in UNITS.items() if isinstance(row.get(name), (int, float))]


def _front(data: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Figures]]:
    common = {"scene": data["scene"], "duration": data["duration"], "assignments": data["assignments"]}
    for row in data["rows"]:
        of = common | {"setting": row["setting"]} | ({"reason": row["reason"]} if row["reason"] else {})
        yield of, _known(row) + _errors("error", row["errors"])
    if data["reference"] is not None:
        yield (
            common | {"setting": data["reference"]["setting"]},
            _errors("uncertainty", data["reference"]["uncertainty"]),
        )


def _errors(word: str, found: dict[str, Any]) -> Figures:
    return [(f"{MEASURES[m][0]} {word}", value, MEASURES[m][1]) for m, value in found.items() if value is not None]
