"""How the cost of a step and of compiling grows with bars, parts, samples and length of the run."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from diffeed.bench.batch import SIZES
from diffeed.bench.point import TooLong, run_apart

PARTS = (10, 30, 100, 300, 1000)
SWEEP: dict[str, Sequence[float]] = {
    "bars": (20, 50, 100, 200, 500),
    "line guides": PARTS,
    "moving guides": PARTS,
    "driven rollers": PARTS,
    "drives with movable pinches": PARTS,
    "samples": SIZES,
    "length": (1.0, 3.0, 10.0),  # s
}
"""What grows -> its sizes."""
PATIENCE = 300.0
"""s for one size, compiling included; the first that takes longer is the last of its series."""

Show = Callable[[int, int, str], None]


def growth(
    quick: bool = False, patience: float = PATIENCE, show: Show = lambda done, total, text: None
) -> list[dict[str, Any]]:
    """One row per series and size: compile time, time per step (and sample) and peak memory, or why there are none."""
    sweep = {name: sizes[:3] if quick else sizes for name, sizes in SWEEP.items()}
    total = sum(len(sizes) for sizes in sweep.values())
    rows: list[dict[str, Any]] = []
    for name, sizes in sweep.items():
        begun = len(rows)

        def run(size: float, name: str = name) -> dict[str, Any]:
            return run_apart(name, size, patience)

        def tell(done: int, text: str, begun: int = begun) -> None:
            show(begun + done, total, text)

        rows += one_series(name, sizes, run, tell)
    return rows


def one_series(
    name: str,
    sizes: Sequence[float],
    run: Callable[[float], dict[str, Any]],
    show: Callable[[int, str], None] = lambda done, text: None,
) -> list[dict[str, Any]]:
    """Rows of one series; what fails says so, and nothing larger is tried than the first that takes too long."""
    rows: list[dict[str, Any]] = []
    late = ""
    for size in sizes:
        show(len(rows), f"{name}, {size:g}")
        row: dict[str, Any] = {"series": name, "size": size}
        try:
            row |= {"reason": late} if late else run(size)
        except TooLong as error:
            row["reason"], late = str(error), f"not run: {size:g} took too long"
        except Exception as error:  # too large for the machine: an answer, not an end
            row["reason"] = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
        rows.append(row)
    return rows


def exponent(sizes: Sequence[float], costs: Sequence[float | None]) -> float | None:
    """Power with which a cost grows at the large end: the slope of the last three known points in logarithms."""
    known = [(n, c) for n, c in zip(sizes, costs, strict=True) if c is not None and c > 0.0]
    if len(known) < 2:
        return None
    x, y = np.log(np.array(known[-3:], float)).T
    return float(np.polyfit(x, y, 1)[0])


def exponents(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """By series: powers of compile time, time per step and peak memory."""
    found = []
    for name in dict.fromkeys(r["series"] for r in rows):
        own = [r for r in rows if r["series"] == name]
        sizes = [r["size"] for r in own]
        found.append(
            {"series": name}
            | {k: exponent(sizes, [r.get(k) for r in own]) for k in ("compile_seconds", "us_per_step", "peak_mb")}
        )
    return found
