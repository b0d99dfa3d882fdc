"""One size of a growth series in a process of its own: its peak memory is its own, and it can be stopped.

`python -m diffeed.bench.point SERIES SIZE` prints the row.
"""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from diffeed.bench.batch import batch
from diffeed.bench.timing import timed
from diffeed.bench.transport import transport
from diffeed.command.session import set_up
from diffeed.input.packing import Packed, pack
from diffeed.input.parts import Scene, normalise
from diffeed.readings.trajectory import Trajectory
from diffeed.run.rollout import _simulate, plan
from diffeed.steppers import DEFAULT

DT = 1e-4
LONG_DT, FRAMES = 5e-4, 11
"""Of the runs by length."""


class TooLong(Exception):
    """A size that took longer than there is patience for."""


def run_apart(series: str, size: float, patience: float) -> dict[str, Any]:
    """The row of one size. Raises TooLong, and RuntimeError with the cause where it fails."""
    words = [sys.executable, "-m", __name__, series, repr(size)]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=patience)
    except subprocess.TimeoutExpired:
        raise TooLong(f"stopped after {patience:.0f} s") from None
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise RuntimeError(said[-1] if said else f"the process ended with status {done.returncode}")
    return json.loads(done.stdout.splitlines()[-1])


def measure(series: str, size: float) -> dict[str, Any]:
    """Compile time and time per step (and sample) of one size."""
    return SERIES[series](size)


def _steps(make: Callable[[int], Scene]) -> Callable[[float], dict[str, Any]]:
    """What a scene with so many of something costs."""
    return lambda size: _run(make(round(size)), DT, 2, fewest=3)


def _run(scene: Scene, dt: float, frames: int, fewest: int) -> dict[str, Any]:
    scene = normalise(scene)
    counts = plan(float(scene.duration), dt, frames, scene.crowded)

    def program(packed: Packed) -> Trajectory:  # as `simulate` calls it
        return _simulate.program(packed, float(scene.duration) / counts.total, None, counts, DEFAULT, ())

    made = timed(program, pack(scene), fewest=fewest)
    row: dict[str, Any] = {"compile_seconds": made.compile, "us_per_step": 1e6 * made.run / int(made.value.steps)}
    return row if bool(made.value.ok) else row | {"reason": f"the run failed {made.value.failure.describe()}"}


def _samples(size: float) -> dict[str, Any]:
    found = batch(transport(), (round(size),), ("float64",))[0]
    kept = {"compile_seconds": "compile_seconds", "us_per_sample_step": "us_per_step", "reason": "reason"}
    return {new: found[old] for old, new in kept.items() if old in found}


def _length(seconds: float) -> dict[str, Any]:
    return _run(transport(driven=26, guides=12, duration=seconds), LONG_DT, FRAMES, fewest=1)


SERIES: dict[str, Callable[[float], dict[str, Any]]] = {
    "bars": _steps(lambda n: transport(bars=n)),
    "line guides": _steps(lambda n: transport(guides=n)),
    "moving guides": _steps(lambda n: transport(guides=n, moving=True)),
    "driven rollers": _steps(lambda n: transport(driven=n)),
    "drives with movable pinches": _steps(lambda n: transport(driven=4, nips=max(1, (n - 4) // 2))),
    "samples": _samples,
    "length": _length,
}
"""What grows -> what so much of it costs."""


def _peak() -> float | None:
    """Largest memory (MB) that this process has taken so far; none where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # bytes there, kilobytes elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _end_with(parent: int) -> None:
    """End when the process that asked is gone: nobody wants the answer."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _main(series: str, size: float) -> None:
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    set_up(keep=False, alone=series != "samples")
    row = measure(series, size)
    print(json.dumps(row | {"peak_mb": _peak()}))


if __name__ == "__main__":
    _main(sys.argv[1], float(sys.argv[2]))
