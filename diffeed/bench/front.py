"""A scene under many settings: cost and errors of each, against a converged run of the same scene."""

import hashlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from diffeed.bench.machine import machine
from diffeed.bench.outcome import OBSERVE, Outcome, differences, outcome
from diffeed.bench.records import Front, Reference, Row
from diffeed.bench.settings import STEPS, Setting, knobs, power, sweep
from diffeed.bench.timing import Timed, in_turns, once, precision
from diffeed.input.parts import Scene, SinglePrecision, normalise
from diffeed.input.paths import assign
from diffeed.input.scene_file import scene_text
from diffeed.run.examine import check, prepare
from diffeed.run.rollout import simulate
from diffeed.steppers import DEFAULT, EXPLICIT

FINER = 5.0
"""How many times smaller than the smallest step of the sweep the reference's is."""
GAPS = 100
"""Most intervals between frames."""

Show = Callable[[int, int, str], None]
"""Told of every run: how many are done, of how many, and what comes now."""


class Finished(NamedTuple):
    """A row, still without errors, and what the run came to."""

    row: Row
    result: Outcome | None
    made: Timed | None = None
    """Of a run that holds."""


def front(
    scene: Scene,
    name: str = "scene",
    *,
    steps: Sequence[float] = STEPS,
    settings: Sequence[Setting] | None = None,
    reference_step: float | None = None,
    frames: int | None = None,
    fewest: int = 3,
    assignments: tuple[str, ...] = (),
    show: Show = lambda done, total, text: None,
) -> Front:
    """Run `settings` (the sweep over methods and `steps`, then the knobs) and compare each with a finer reference.

    The scene's own `duration` is what is run. A run that fails is a row that says so.
    """
    scene, steps, host = normalise(scene), tuple(steps), machine()
    asked = [*sweep(steps), *knobs(scene, steps)] if settings is None else list(settings)
    frames = frames or frames_for(scene.duration, max(s.dt for s in asked))
    total = len(asked) + 3
    finished = []
    for done, setting in enumerate(asked):
        show(done, total, setting.name)
        finished.append(run_setting(scene, setting, frames))
    show(len(asked), total, "timing, all in turns")
    finished = _in_turns(finished, fewest)
    smallest = min(s.dt for s in asked)
    fine, why = _reference(scene, finished, reference_step or smallest / FINER, frames, show, total)
    show(total, total, "done")
    return Front(
        scene=name,
        key=scene_key(scene),
        duration=float(scene.duration),
        assignments=assignments,
        rows=[compared(f, None if fine is None else fine[1]) for f in finished],
        reference=None if fine is None else fine[0],
        no_reference=why,
        machine=host,
    )


def frames_for(duration: float, largest: float) -> int:
    """As many frames as leave the largest step as long as it is: `simulate` shortens a step to fit between two frames."""
    return 1 + max(1, min(GAPS, int(duration / largest + 1e-9)))


def scene_key(scene: Scene) -> str:
    """Names a scene and its duration: a benchmark of another one does not fit."""
    return hashlib.sha256(scene_text(scene).encode()).hexdigest()[:16]


def run_setting(scene: Scene, setting: Setting, frames: int) -> Finished:
    """Check, settle, compile and run once; what goes wrong is told in the row."""
    try:
        with precision(setting.precision), warnings.catch_warnings():
            warnings.simplefilter("ignore", SinglePrecision)
            return _run(normalise(assign(scene, setting.changes)), setting, frames)
    except Exception as error:  # one setting that the machine or the compiler cannot bear must not end the others
        return Finished(Row(setting, "failed", _one_line(error)), None)


def _run(scene: Scene, setting: Setting, frames: int) -> Finished:
    problems = check(scene, setting.dt, setting.method, setting.tolerance)
    if problems:
        return Finished(Row(setting, "not run", "; ".join(problems)), None)
    state = prepare(scene).state

    def program(scene: Scene, state: Any) -> Any:
        return simulate(scene, frames=frames, initial=state, observe=OBSERVE, **setting.options())

    made = once(program, scene, state)
    row = Row(
        setting,
        "ok" if bool(made.value.ok) else "failed",
        made.value.failure.describe(),
        made.compile,
        made.run,
        made.repeats,
        int(made.value.steps) if made.value.ok else None,  # the time is that of all steps, of which it took a part
    )
    return Finished(row, outcome(scene, made.value), made) if row.ok else Finished(row, None)


def _in_turns(finished: list[Finished], fewest: int) -> list[Finished]:
    """The same, those that hold timed."""
    made = {k: f.made for k, f in enumerate(finished) if f.made is not None}
    times = dict(zip(made, in_turns(list(made.values()), fewest), strict=True))
    rows = {k: replace(finished[k].row, run_seconds=t.run, repeats=t.repeats) for k, t in times.items()}
    return [f._replace(row=rows.get(k, f.row)) for k, f in enumerate(finished)]


def compared(finished: Finished, reference: Outcome | None) -> Row:
    """The row with its errors."""
    if finished.result is None or reference is None:
        return finished.row
    found = differences(finished.result, reference)
    return replace(
        finished.row,
        errors={k: None if d is None else d.value for k, d in found.items()},
        where={k: d.where for k, d in found.items() if d is not None},
    )


def _reference(
    scene: Scene, finished: list[Finished], dt: float, frames: int, show: Show, total: int
) -> tuple[tuple[Reference, Outcome] | None, str]:
    """The best method at a small step, with its distance from twice that step; or why there is none."""
    causes = []
    for method in _best_first(finished):
        runs = []
        for k, step in enumerate((2.0 * dt, dt)):
            show(total - 2 + k, total, f"reference, {method}, {power(step)} s")
            runs.append(run_setting(scene, Setting("step", method, step), frames))
        coarse, fine = runs
        if coarse.result is None or fine.result is None:
            broken = coarse if coarse.result is None else fine
            causes.append(f"{broken.row.setting.name}: {broken.row.reason}")
            continue
        apart = differences(coarse.result, fine.result)
        made = Reference(
            fine.row.setting,
            fine.row.run_seconds or 0.0,
            {k: None if d is None else d.value for k, d in apart.items()},
            {k: d.where for k, d in apart.items() if d is not None},
        )
        return (made, fine.result), ""
    return None, "; ".join(causes)


def _best_first(finished: list[Finished]) -> list[str]:
    """Implicit methods by how little the lead edge moves between their two smallest steps; the default among equals."""
    apart: dict[str, float] = {DEFAULT: np.inf}
    for method in dict.fromkeys(f.row.setting.method for f in finished):
        own = [f for f in finished if f.row.setting.group == "step" and f.row.setting.method == method]
        held = [f.result for f in sorted(own, key=lambda f: f.row.setting.dt) if f.result is not None]
        if method not in EXPLICIT and len(held) > 1:
            lead = differences(held[1], held[0])["lead"]
            apart[method] = np.inf if lead is None else lead.value
    return sorted(apart, key=lambda m: (apart[m], m != DEFAULT))


def _one_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0][:200]}" if text else type(error).__name__
