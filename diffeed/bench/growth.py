"""How the cost of a step and of compiling grows with bars, parts, samples and length of the run."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from diffeed.bench.batch import SIZES, batch
from diffeed.bench.memory import peak_of_a_run
from diffeed.bench.timing import timed
from diffeed.bench.transport import transport
from diffeed.parts import Scene
from diffeed.rollout import simulate

BARS = (20, 50, 100, 200, 500)
PARTS = (10, 30, 100, 300, 1000)
SECONDS = (1.0, 3.0, 10.0)
PATIENCE = 120.0
"""s: a series ends before the size that would take longer than this, compiling included, by the two sizes before it."""
DT = 1e-4

Show = Callable[[int, int, str], None]

PARTS_SERIES: dict[str, Callable[[int], Scene]] = {
    "line guides": lambda n: transport(guides=n),
    "driven rollers": lambda n: transport(driven=n),
    "drives with movable pinches": lambda n: transport(driven=4, nips=max(1, (n - 4) // 2)),
}
"""What is counted -> the scene with so many of it."""
TITLES = {"bars": "bars", "samples": "samples", "length": "s simulated"} | {name: name for name in PARTS_SERIES}


def growth(quick: bool = False, show: Show = lambda done, total, text: None) -> list[dict[str, Any]]:
    """One row per series and size: compile time, time per step (and sample), peak memory of the runs by length."""
    last = -2 if quick else None
    series: list[tuple[str, Sequence[float], Callable[[Any], dict[str, Any]]]] = [
        ("bars", BARS[:last], lambda n: measure(transport(bars=n))),
        *((name, PARTS[:last], _of(make)) for name, make in PARTS_SERIES.items()),
        ("samples", SIZES[:last], lambda n: _batch(n)),
        ("length", SECONDS[: -1 if quick else None], peak_of_a_run),
    ]
    rows, total = [], sum(len(sizes) for _, sizes, _ in series)
    for name, sizes, run in series:
        rows += one_series(name, sizes, run, lambda k, text, before=len(rows): show(before + k, total, text))
    return rows


def one_series(
    name: str,
    sizes: Sequence[float],
    run: Callable[[Any], dict[str, Any]],
    show: Callable[[int, str], None] = lambda done, text: None,
    patience: float = PATIENCE,
) -> list[dict[str, Any]]:
    """Rows of one series; what fails or would take too long says so."""
    rows: list[dict[str, Any]] = []
    took: list[float] = []
    for k, size in enumerate(sizes):
        row: dict[str, Any] = {"series": name, "size": size}
        show(k, f"{size:g} {TITLES.get(name, name)}")
        begun = time.perf_counter()
        expected = expect(sizes[:k], took, size)
        if expected > patience:
            row["reason"] = f"not run: would take {expected:.0f} s or so"
        else:
            try:
                row |= run(size)
            except Exception as error:  # too large for the machine: an answer, not an end
                row["reason"] = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
        took.append(max(time.perf_counter() - begun, expected if expected > patience else 0.0))
        rows.append(row)
    return rows


def expect(sizes: Sequence[float], took: Sequence[float], size: float) -> float:
    """Seconds that a size will take: the growth of the last two, and one power more, for the worst is to come."""
    if not took:
        return 0.0
    power = 1.0
    if len(took) > 1 and took[-1] > took[-2] > 0.0:
        power += float(np.log(took[-1] / took[-2]) / np.log(sizes[-1] / sizes[-2]))
    return took[-1] * (size / sizes[-1]) ** power


def _of(make: Callable[[int], Scene]) -> Callable[[int], dict[str, Any]]:
    return lambda n: measure(make(n))


def measure(scene: Scene, dt: float = DT) -> dict[str, Any]:
    """Compile time and time per step."""
    made = timed(lambda s: simulate(s, dt=dt, frames=2), scene)
    row = {
        "compile_seconds": made.compile,
        "us_per_step": 1e6 * made.run / round(scene.duration / float(made.value.dt)),
    }
    return row if bool(made.value.ok) else row | {"reason": f"the run failed {made.value.failure.describe()}"}


def _batch(size: int) -> dict[str, Any]:
    found = batch(transport(), (size,), ("float64",))[0]
    kept = {"compile_seconds": "compile_seconds", "us_per_sample_step": "us_per_step", "reason": "reason"}
    return {new: found[old] for old, new in kept.items() if old in found}


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
