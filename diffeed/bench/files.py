"""The files of a benchmark."""

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diffeed.base.files import plain
from diffeed.base.folders import write_all
from diffeed.bench.outcome import MEASURES
from diffeed.bench.records import BenchError, Front, read_front
from diffeed.command.outputs import picture

DATA = "bench.json"
FRONT = ("front.png", "bench.csv", DATA)
"""Data comes last: a folder that holds it is complete."""


def write_front(draft: Path, folder: Path, front: Front) -> list[str]:
    """Picture, table and data of a sweep; the names written."""
    from diffeed.bench import charts

    writers = {
        "front.png": picture(lambda: charts.front(front)),
        "bench.csv": lambda path: path.write_text(front_table(front), "utf-8", newline=""),
        DATA: _data(front.plain()),
    }
    return write_all(draft, folder, writers, FRONT)


def write_rows(draft: Path, folder: Path, name: str, data: dict[str, Any], draw: Callable[[], Any]) -> list[str]:
    """Picture and data of any other benchmark: NAME.png and NAME.json."""
    writers = {f"{name}.png": picture(draw), f"{name}.json": _data(data)}
    return write_all(draft, folder, writers, names_of(name))


def names_of(name: str) -> tuple[str, ...]:
    """The files of a benchmark other than the front."""
    return (f"{name}.png", f"{name}.json")


def load_front(folder: Path) -> Front:
    """The sweep in a folder (or in a file). Raises BenchError."""
    path = folder / DATA if folder.is_dir() else folder
    try:
        data = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise BenchError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise BenchError(f"{path} is not a benchmark's file: {error}") from error
    try:
        return read_front(data)
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error


def front_table(front: Front) -> str:
    """One line per setting."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    cost = ["compile (s)", "run (s)", "runs", "steps", "us per step", "run s per simulated s"]
    errors = [f"{title} error ({unit})" for title, unit, _ in MEASURES.values()]
    places = [f"{title} where" for title, _, _ in MEASURES.values()]
    words = ["group", "setting", "method", "dt (s)", "tolerance (mm)", "precision", "changes", "status", "reason"]
    writer.writerow([*words, *cost, *errors, *places])
    for row in front.rows:
        s = row.setting
        words = [s.group, s.name, s.method, s.dt, s.tolerance, s.precision, " ".join(s.changes), row.status, row.reason]
        numbers = [row.compile_seconds, row.run_seconds, row.repeats, row.steps, row.microseconds()]
        numbers += [row.cost(front.duration), *(row.errors.get(m) for m in MEASURES)]
        writer.writerow(["" if v is None else v for v in [*words, *numbers, *(row.where.get(m, "") for m in MEASURES)]])
    return stream.getvalue()


def _data(data: dict[str, Any]) -> Callable[[Path], Any]:
    return lambda path: path.write_text(json.dumps(plain(data), indent=1, allow_nan=False) + "\n", "utf-8")
