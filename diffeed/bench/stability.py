"""The stability map: for each stepper, time step against one number of a scene, and what becomes of each run.

Each run is compared with a converged one of the same scene, and judged: right, inaccurate, failed and said so, refused
beforehand by `diffeed.check`, or plainly wrong and yet held for right, which must not be. Values of a number go in one batch, and
runs are cut into pieces of few lengths, so that few programs are compiled.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from diffeed.bench.stability_scene import AXES, BASE, vary
from diffeed.faults.causes import CAUSES
from diffeed.input.parts import Scene
from diffeed.input.stacking import stack
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.trajectory import Resume
from diffeed.run.examine import explicit_limit
from diffeed.run.progress import begin
from diffeed.run.rollout import go_on, simulate
from diffeed.steppers import DEFAULT, EXPLICIT, METHODS

RIGHT, WRONG = 0.1, 5.0
"""mm: largest distance of a node from the reference, over the frames: of a run that is right, of one that is plainly wrong."""
CLASSES = ("right", "inaccurate", "wrong", "failed", "unclear")
"""What becomes of a run; unclear: the reference is not known well enough to tell."""
FRAME, FRAMES = 0.01, 5  # s, and how many
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6)
QUICK_STEPS = (1e-2, 1e-3, 1e-4)
SMALLEST = {"runge_kutta": STEPS[-1], "midpoint": 2e-5}
"""s: of steppers that need smaller steps than others, or that cost more."""
USUAL = 1e-5
FINE, QUICK_FINE = 5e-6, 2e-5
"""s: step of the reference, a run of `REFERENCE`; how well it is known says a run at twice that."""
REFERENCE = "extrapolated_euler"
PIECES = (1, 50)
"""Steps of the pieces that runs are cut into: a frame holds a whole number of the one or the other."""
TOLERANCES = (1.0, 0.3, 0.1, 0.03, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
QUICK_TOLERANCES = (1.0, 1e-2)
MOST_STEPS = 20_000
CONTROLLED = f"{DEFAULT}, by tolerance"

Show = Callable[[int, int, str], None]


class Case(NamedTuple):
    """One column of a panel."""

    axis: str
    value: float


class Paths(NamedTuple):
    """What a batch of runs came to: nodes (cases, frames, nodes, 2), causes of failure (0: none), and errors that the runs
    tell of themselves (mm)."""

    nodes: np.ndarray
    cause: np.ndarray
    told: np.ndarray


class Doubted(NamedTuple):
    """Paths that others are compared with, and by how much they are uncertain, (cases,) mm; infinite: not known."""

    nodes: np.ndarray
    doubt: np.ndarray


def stability(quick: bool = False, show: Show = lambda done, total, text: None) -> list[dict[str, Any]]:
    """One row per stepper, number, value and step: what became of the run, its error, and why it failed."""
    steps = {m: _steps(m, quick) for m in METHODS}
    tolerances = QUICK_TOLERANCES if quick else TOLERANCES
    groups = _groups(quick)
    total = len(groups) * (1 + sum(map(len, steps.values())) + len(tolerances))
    done, rows = 0, []

    def tell(text: str) -> None:
        nonlocal done
        show(done, total, text)
        done += 1

    for cases in groups:
        batch = Batch(cases)
        tell(f"{batch.name}: reference")
        reference = batch.reference(QUICK_FINE if quick else FINE)
        for method, chosen in steps.items():
            for dt in chosen:
                tell(f"{batch.name}: {method}, {dt:g} s")
                limits = batch.limits if method in EXPLICIT else None
                rows += batch.rows(method, dt, batch.run(method, dt), reference, limits)
        for tolerance in tolerances:
            tell(f"{batch.name}: tolerance {tolerance:g} mm")
            rows += batch.rows(CONTROLLED, tolerance, batch.run_to(tolerance), reference)
    show(total, total, "done")
    return rows


def _steps(method: str, quick: bool) -> list[float]:
    if quick:
        return [*QUICK_STEPS, *((1e-5,) if method in EXPLICIT else ())]
    return [dt for dt in STEPS if dt >= SMALLEST.get(method, USUAL)]


def _groups(quick: bool) -> list[list[Case]]:
    """Cases of one structure each, that of the base scene first."""
    cases = [Case(name, v) for name, axis in AXES.items() for v in (axis.values[:: 3 if quick else 1])]
    if quick:
        cases = [c for c in cases if c.axis != "bars"] + [Case("bars", BASE["bars"])]
    counts = [c.value if c.axis == "bars" else BASE["bars"] for c in cases]
    return [
        [c for c, n in zip(cases, counts, strict=True) if n == count]
        for count in sorted(set(counts), key=lambda n: (n != BASE["bars"], n))
    ]


class Batch:
    """Scenes of one structure, settled, and runs of all of them at once."""

    def __init__(self, cases: Sequence[Case]) -> None:
        self.cases = list(cases)
        self.scenes = stack([vary(c.axis, c.value) for c in self.cases])
        self.starts = _start(self.scenes)

    @functools.cached_property
    def limits(self) -> list[float]:
        """s, of explicit steps: what `diffeed.check` goes by."""
        models, states = _models(self.scenes), self.starts.state
        each = (jax.tree.map(lambda v, k=k: v[k], (models, states)) for k in range(len(self.cases)))
        return [explicit_limit(model, state)[0] for model, state in each]

    @property
    def name(self) -> str:
        bars = {c.value if c.axis == "bars" else BASE["bars"] for c in self.cases}
        return f"{', '.join(f'{n:g}' for n in bars)} bars"

    def run(self, method: str, dt: float) -> Paths:
        """All cases by equal steps."""
        per_frame = round(FRAME / dt)
        piece = max(p for p in PIECES if per_frame % p == 0)
        now, nodes, found = self.starts, None, []
        for _ in range(FRAMES):
            for _ in range(per_frame // piece):
                now, nodes = _piece(self.scenes, now, dt, piece, method)
            found.append(np.asarray(nodes))
        return Paths(np.stack(found, axis=1), np.asarray(now.cause), np.asarray(now.error))

    def run_to(self, tolerance: float) -> Paths:
        """All cases by steps of an error."""
        return Paths(*map(np.asarray, _controlled(self.scenes, self.starts, tolerance)))

    def reference(self, dt: float) -> Doubted:
        """The finest run."""
        fine, coarse = self.run(REFERENCE, dt), self.run(REFERENCE, 2.0 * dt)
        known = (fine.cause == 0) & (coarse.cause == 0)
        return Doubted(fine.nodes, np.where(known, apart(fine.nodes, coarse.nodes), np.inf))

    def rows(
        self, method: str, size: float, found: Paths, reference: Doubted, limits: Sequence[float] | None = None
    ) -> Iterator[dict[str, Any]]:
        """The judged cases, as a file holds them."""
        errors = apart(found.nodes, reference.nodes)
        for k, case in enumerate(self.cases):
            cause, error, doubt = int(found.cause[k]), float(errors[k]), float(reference.doubt[k])
            told = float(found.told[k])
            limit = None if limits is None else limits[k]
            yield {
                "method": method,
                "axis": case.axis,
                "value": case.value,
                "size": size,
                "became": judge(cause == 0, error, doubt),
                "refused": limit is not None and size > limit,
                "error_mm": error if np.isfinite(error) and cause == 0 else None,
                "told_mm": told if np.isfinite(told) and cause == 0 else None,
                "doubt_mm": doubt if np.isfinite(doubt) else None,
                "cause": CAUSES[cause],
                "limit_s": limit,
            }


def judge(ok: bool, error: float, doubt: float) -> str:
    """What became of a run: by whether it says that it holds, by its error, and by how well the reference is known (mm)."""
    if not ok:
        return "failed"
    if not np.isfinite(error):
        return "wrong"
    if error + doubt <= RIGHT:
        return "right"
    if error - doubt <= RIGHT:
        return "unclear"
    return "wrong" if error - doubt > WRONG else "inaccurate"


def apart(found: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(cases,) mm: largest distance of a node over the frames; NaN where a number is not finite."""
    return np.max(np.linalg.norm(found - reference, axis=-1), axis=(1, 2))


@jax.jit
@jax.vmap
def _start(scene: Scene) -> Resume:
    """Where a run begins."""
    return begin(build(scene), scene, None, ())


@jax.jit
@jax.vmap
def _models(scene: Scene) -> Model:
    return build(scene)


@functools.partial(jax.jit, static_argnames=("steps", "method"))
def _piece(scenes: Scene, starts: Resume, dt: Any, steps: int, method: str) -> tuple[Resume, Any]:
    def one(scene: Scene, start: Resume) -> tuple[Resume, Any]:
        run = go_on(scene, start, dt, steps, method)
        return run.final, run.sheets["sheet"].nodes[-1]

    return jax.vmap(one)(scenes, starts)


@jax.jit
def _controlled(scenes: Scene, starts: Resume, tolerance: Any) -> tuple[Any, Any, Any]:
    def one(scene: Scene, start: Resume) -> tuple[Any, Any, Any]:
        run = simulate(
            scene, FRAME * FRAMES, frames=FRAMES + 1, initial=start, tolerance=tolerance, most_steps=MOST_STEPS
        )
        return run.sheets["sheet"].nodes[1:], run.failure.cause, run.error

    return jax.vmap(one)(scenes, starts)
