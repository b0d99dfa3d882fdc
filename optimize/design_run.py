"""The design loop from end to end: search, score at the study's own settings, pick, and say what changed."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import diffeed
from diffeed import measures
from optimize import variables as free
from optimize.asked import by_limit
from optimize.descent import Line, Progress, begin, search
from optimize.evaluate import seen_at
from optimize.journal import Journal
from optimize.problem import SLACK, Problem, make_problem, over_media, simulate
from optimize.study import Study
from optimize.terms import TERMS

Margins = dict[str, dict[str, float]]
"""The parts of the jam margin of each sheet for which it is asked: the smallest is what binds."""
VERDICT = ("arrivals", "feed", "nips", "energy", "gaps", "curvature")
"""Observed in the runs before and after, for verdict and tables."""


@dataclass(frozen=True)
class Scored:
    """A point at the study's own settings: no easing, full length, no noise."""

    unit: np.ndarray
    values: dict[str, float]
    goals: np.ndarray  # (media, goals)
    limits: np.ndarray  # (media, limits)
    objective: float
    violation: float  # largest, in the limits' scales; <= 0: kept
    verdicts: tuple[measures.Verdict, ...]  # per medium
    missed: np.ndarray  # (media, limits) how far each is broken, in its scale; `violation` is the largest
    margins: tuple[Margins, ...]  # per medium

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Sorts the better first: passes, keeps the limits, low objective. What has no value comes last."""
        kept = self.violation <= SLACK
        worth = self.objective if kept else self.violation
        known = bool(np.isfinite(worth))
        passed = known and all(v.status == "passed" for v in self.verdicts)
        return (not passed, not kept, worth if known else np.inf)


@dataclass(frozen=True)
class Result:
    """What a search gave."""

    problem: Problem
    before: Scored
    after: Scored
    progress: Progress
    history: list[dict[str, Any]]
    reason: str

    @property
    def scene(self) -> diffeed.Scene:
        """The improved scene (of the first medium)."""
        return self.problem.scene(self.after.unit)

    @property
    def size(self) -> float:
        """The largest objective that was met, of either sign: near its least an objective may be as small as it likes, and
        nothing can be held against it."""
        met = [line["objective"] for line in self.history] + [self.before.objective, self.after.objective]
        return max((abs(v) for v in met if v is not None and np.isfinite(v)), default=0.0)

    @property
    def improved(self) -> bool:
        return self.after.rank < self.before.rank


def design(
    study: Study | Problem | dict[str, Any],
    folder: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    watch: Callable[[Problem, Progress, Line], None] = lambda problem, progress, line: None,
    scene: diffeed.Scene | None = None,
) -> Result:
    """Improve a machine as a study asks. With a `folder` every iteration is kept there and `resume` goes on with it.

    The folder then holds the search alone, `history.jsonl` and `state.npz`; `write_result(folder, result)` of
    `optimize.report` adds the improved scene, the pictures and the numbers, as the command does.

    Ctrl-C ends the search, not the result: the best point so far is scored and returned. `scene` replaces the study's.
    Raises StudyError for a study that cannot be used, JournalError for a folder that cannot.
    """
    problem = study if isinstance(study, Problem) else make_problem(study, scene=scene)
    journal = Journal(Path(folder), problem) if folder is not None else None
    progress = journal.start(resume, force) if journal else begin(problem)
    history: list[dict[str, Any]] = list(journal.earlier) if journal else []
    try:
        for _, line in search(problem, progress, journal.save if journal else lambda p, line: None):
            history.append(line._asdict())
            watch(problem, progress, line)
    except KeyboardInterrupt:
        progress.reason = f"stopped by hand after {progress.iteration} iterations"
    finally:
        if journal:
            journal.close()
    return finish(problem, progress, history)


def finish(problem: Problem, progress: Progress, history: list[dict[str, Any]]) -> Result:
    """Score the start and the best point of every start, and take the best of them."""
    points = np.unique(np.concatenate([problem.start[None], progress.best]), axis=0)
    scored = [score(problem, point) for point in points]
    before = next(s for s in scored if np.array_equal(s.unit, problem.start))
    after = min(scored, key=lambda s: s.rank)
    return Result(problem, before, after, progress, history, progress.reason)


def score(problem: Problem, unit: np.ndarray) -> Scored:
    """A point with its verdicts, from runs of the machine as drawn."""
    media = range(len(problem.media))
    scenes, runs = [problem.scene(unit, k) for k in media], [run_of(problem, unit, k) for k in media]
    seen = seen_at(problem, unit, scenes, runs)
    values = free.physical(problem.variables, jnp.asarray(unit))
    return Scored(
        unit=np.asarray(unit),
        values=dict(zip(problem.names, map(float, values), strict=True)),
        goals=np.asarray(seen.goals),
        limits=np.asarray(seen.limits),
        # Where machines scatter, one whose run fails has no objective to take part in the mean or the worst.
        objective=float(over_media(problem, jnp.asarray(seen.objective))) if np.all(seen.ok) else np.nan,
        violation=float(seen.violation.max(initial=-1.0)),
        verdicts=tuple(measures.verdict(*of) for of in zip(scenes, runs, strict=True)),
        missed=by_limit(problem.limits, np.asarray(seen.violation)),
        margins=tuple(_margins(problem, *of) for of in zip(scenes, runs, strict=True)),
    )


def _margins(problem: Problem, scene: diffeed.Scene, run: Any) -> Margins:
    """None where machines scatter: a run is of the one as drawn, and which part binds differs."""
    asked = [] if problem.inputs else [a for a in (*problem.goals, *problem.limits) if a.term is TERMS["jam_margin"]]
    sheets = sorted({part for a in asked for part in a.parts})
    return {s: {k: float(v) for k, v in measures.jam_margins(scene, run, s).items()} for s in sheets}


def run_of(problem: Problem, unit: np.ndarray, medium: int = 0) -> Any:
    """The run of a point, for pictures and verdict."""
    return simulate(problem, problem.scene(unit, medium), None, VERDICT)
