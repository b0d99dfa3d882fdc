"""The search: an optimiser of optax on the unit vectors of several starts, with roll-back, limits, stages and resume.

Everything that the next iteration needs is in `Progress`, which is written whole after each one: a search that was killed
goes on with the same iterates. Limits are kept by an augmented Lagrangian (multipliers per start, medium and side).
"""

import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from optimize import variables as free
from optimize.evaluate import Counts, Evaluated, Evaluator
from optimize.optimisers import make_optimiser
from optimize.problem import SLACK, Problem, Settings, loss, over_media
from optimize.study import Stage

INNER = 8
"""Iterations between two updates of the multipliers."""
MOST_PENALTY = 1e6
ROLLBACKS = 8
"""Halvings of the step after which a start is given up."""


@dataclasses.dataclass
class Progress:
    """State of a search after `iteration` iterations. Arrays have one row per start."""

    iteration: int
    stage: int
    unit: np.ndarray  # (starts, n) where the next evaluation is
    good: np.ndarray  # (starts, n) last point that could be evaluated
    slope: np.ndarray  # (starts, n) its gradient
    level: np.ndarray  # (starts,) and its loss
    state: Any  # optimiser's state at the good point
    pace: np.ndarray  # (starts,) factor on the step, halved at each roll-back
    falls: np.ndarray  # (starts,) roll-backs in a row
    multipliers: np.ndarray  # (starts, media, sides)
    penalty: np.ndarray  # (starts,)
    broken: np.ndarray  # (starts,) largest violation at the last update of the multipliers
    best: np.ndarray  # (starts, n)
    merit: np.ndarray  # (starts,) objective of the best point that keeps the limits, else inf
    closest: np.ndarray  # (starts,) smallest violation seen, where none kept them
    counts: Counts
    seconds: float
    since: int  # iteration of the last gain
    reason: str = ""


class Line(NamedTuple):
    """One iteration in words: what the history file holds. Objective, violation and values are those of the point that the start
    which is best so far was at."""

    iteration: int
    stage: int
    start: int  # the start that is best so far
    objective: float
    violation: float
    best: float
    gradient: float
    alive: int
    simulations: int
    gradients: int
    seconds: float
    values: dict[str, float]
    loss: float = np.nan  # what the optimiser sees, with its penalties; not a number where the run failed
    promised: float = np.nan  # by how much the gradient says that the step from here changes it


def stages_of(problem: Problem) -> list[Stage]:
    """The study's stages, or one with its own settings."""
    search = problem.study.search
    return list(search.stages) or [Stage(iterations=search.iterations)]


def settings_of(stage: Stage) -> Settings:
    return Settings(stage.smoothing, stage.duration)


def first_points(problem: Problem) -> np.ndarray:
    """(starts, n): the study's own start, then points spread about it by a Sobol sequence."""
    search, n = problem.study.search, len(problem.names)
    if search.starts == 1:
        return problem.start[None].copy()
    from scipy.stats import qmc

    drawn = qmc.Sobol(n, rng=search.seed).random(search.starts - 1)
    around = problem.start[None] + search.spread * (2.0 * drawn - 1.0)
    return np.clip(np.concatenate([problem.start[None], around]), 0.0, 1.0)


def begin(problem: Problem) -> Progress:
    """A search that has not taken a step."""
    unit = first_points(problem)
    k, media, sides = len(unit), len(problem.media), problem.sides
    nothing = np.zeros(k)
    return Progress(
        iteration=0, stage=0, unit=unit, good=unit.copy(), slope=np.zeros_like(unit), level=nothing + np.inf,
        state=_fresh(problem, unit, 0), pace=nothing + 1.0, falls=np.zeros(k, int),
        multipliers=np.zeros((k, media, sides)), penalty=nothing + problem.study.search.penalty,
        broken=nothing + np.inf, best=unit.copy(), merit=nothing + np.inf, closest=nothing + np.inf, counts=Counts(),
        seconds=0.0, since=0,
    )  # fmt: skip


def search(
    problem: Problem, progress: Progress, save: Callable[[Progress, Line], None] = lambda p, line: None
) -> Iterator[tuple[Progress, Line]]:
    """Go on until a stop rule holds; `save` is called after every iteration. The reason is in `progress.reason`."""
    evaluator = Evaluator(problem)
    evaluator.counts = progress.counts
    move = _mover(problem)
    while not progress.reason:
        begun = time.monotonic()
        stage = stages_of(problem)[progress.stage]
        settings = settings_of(stage)._replace(deviations=problem.deviations(progress.iteration))
        at = progress.unit.copy()
        found = evaluator.gradients(at, progress.multipliers, progress.penalty, settings)
        _judge(problem, progress, found)
        _step(problem, progress, move, evaluator)
        progress.iteration += 1
        if raises(problem, progress.iteration):
            _raise_multipliers(problem, progress, found)
        progress.counts = evaluator.counts
        progress.seconds += time.monotonic() - begun
        line = _line(problem, progress, at, found)
        stop(problem, progress)
        save(progress, line)
        yield progress, line


def raises(problem: Problem, iteration: int) -> bool:
    """Whether the multipliers are updated after an iteration: what follows is another loss."""
    return bool(problem.sides) and iteration % INNER == 0


def chosen(progress: Progress) -> int:
    """The start with the best point."""
    if np.isfinite(progress.merit).any():
        return int(np.argmin(progress.merit))
    return int(np.argmin(progress.closest))


# --- the parts of an iteration -------------------------------------------------------------------------------------------


def _judge(problem: Problem, progress: Progress, found: Evaluated) -> None:
    """Good points move the anchor and may be the best so far; bad ones fall back."""
    objective = np.array([float(over_media(problem, jnp.asarray(o))) for o in found.seen.objective])
    worst = found.seen.violation.reshape(len(objective), -1).max(axis=1, initial=-np.inf)
    for i in np.flatnonzero(progress.falls < ROLLBACKS):  # what was given up stays where it could last be evaluated
        fine = np.isfinite(found.value[i]) and np.isfinite(found.gradient[i]).all() and found.seen.ok[i].all()
        if not fine:
            progress.falls[i] += 1
            continue
        progress.good[i], progress.slope[i], progress.level[i] = progress.unit[i], found.gradient[i], found.value[i]
        progress.falls[i] = 0
        last = progress.stage == len(stages_of(problem)) - 1
        if not last:
            progress.best[i] = progress.unit[i]  # the score of an easier problem does not count
        elif worst[i] <= SLACK and objective[i] < progress.merit[i]:
            if objective[i] < _gained(progress.merit.min(), problem.study.search.gain):
                progress.since = progress.iteration + 1
            progress.merit[i], progress.best[i] = objective[i], progress.unit[i]
        elif not np.isfinite(progress.merit[i]) and worst[i] < progress.closest[i]:
            progress.closest[i], progress.best[i], progress.since = worst[i], progress.unit[i], progress.iteration + 1


def _gained(best: float, gain: float) -> float:
    """What the objective must fall below to count as a gain."""
    return best - gain * max(1e-12, abs(best)) if np.isfinite(best) else np.inf


def _step(problem: Problem, progress: Progress, move: Any, evaluator: Evaluator) -> None:
    """Where each start goes next. A start that fell goes back half as far as before, with the gradient it had there."""
    fell = progress.falls > 0
    progress.pace = np.where(fell, 0.5 * progress.pace, np.minimum(1.0, 1.2 * progress.pace))
    after, state, runs = move(progress, settings_of(stages_of(problem)[progress.stage]))
    if runs:
        evaluator.counts = evaluator.counts.plus(runs, runs)
    alive = (progress.falls < ROLLBACKS) & np.isfinite(progress.level)
    step = np.clip(np.nan_to_num(after), 0.0, 1.0)
    progress.unit = np.where(alive[:, None], step, progress.good)
    keep = fell | ~alive
    progress.state = jax.tree.map(
        lambda a, b: np.where(keep.reshape(-1, *[1] * (np.ndim(a) - 1)), b, a),
        state,
        progress.state,
    )


def _mover(problem: Problem) -> Any:
    """(progress, settings) -> next points, next optimiser state, extra runs."""
    search = problem.study.search
    if search.name == "lbfgs":
        return _newton_like(problem)
    transforms = [make_optimiser(search, s.iterations) for s in stages_of(problem)]
    updates = [jax.jit(jax.vmap(t.update)) for t in transforms]

    def move(progress: Progress, settings: Settings) -> tuple[np.ndarray, Any, int]:
        update, state = updates[progress.stage](jnp.asarray(progress.slope), progress.state, jnp.asarray(progress.good))
        return progress.good + progress.pace[:, None] * np.asarray(update), jax.device_get(state), 0

    return move


def _fresh(problem: Problem, unit: np.ndarray, stage: int) -> Any:
    """The optimiser's state at the start of a stage."""
    search = problem.study.search
    if search.name == "lbfgs":
        return jax.device_get(jax.vmap(optax.lbfgs().init)(free.opened(jnp.asarray(unit))))
    transform = make_optimiser(search, stages_of(problem)[stage].iterations)
    return jax.device_get(jax.vmap(transform.init)(jnp.asarray(unit)))


def _newton_like(problem: Problem) -> Any:
    """L-BFGS with optax's zoom line search, in the open variables z."""
    optimiser = optax.lbfgs()
    compiled: dict[float | None, Any] = {}

    def make(duration: float | None) -> Any:
        def one(
            unit: Any, level: Any, slope: Any, pace: Any, state: Any, multipliers: Any, penalty: Any, smoothing: Any
        ) -> Any:
            def of(z: Any) -> Any:
                value, seen = loss(problem, free.closed(z), multipliers, penalty, Settings(smoothing, duration))
                return jnp.where(jnp.all(seen.ok), value, jnp.inf)  # a point whose run fails is never taken

            z = free.opened(unit)
            gradient = slope * jax.grad(lambda y: jnp.sum(free.closed(y)))(z)
            update, state = optimiser.update(gradient, state, z, value=level, grad=gradient, value_fn=of)
            taken = optax.tree.get(state, "num_linesearch_steps")
            return free.closed(z + pace * update), state, taken

        return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, 0, 0, 0, None)))

    def move(progress: Progress, settings: Settings) -> tuple[np.ndarray, Any, int]:
        if settings.duration not in compiled:
            compiled[settings.duration] = make(settings.duration)
        after, state, taken = compiled[settings.duration](
            jnp.asarray(progress.good), jnp.asarray(progress.level), jnp.asarray(progress.slope),
            jnp.asarray(progress.pace), progress.state, jnp.asarray(progress.multipliers),
            jnp.asarray(progress.penalty), jnp.asarray(settings.smoothing),
        )  # fmt: skip
        return (
            np.asarray(after),
            jax.device_get(state),
            int(np.sum(taken)) * len(problem.media) * len(problem.deviations()),
        )

    return move


def _raise_multipliers(problem: Problem, progress: Progress, found: Evaluated) -> None:
    """First-order update; where the violation did not halve, the penalty doubles. The old loss is then another's."""
    worst = found.seen.violation.reshape(len(progress.unit), -1).max(axis=1, initial=0.0)
    fine = np.isfinite(worst) & (progress.falls == 0)
    raised = np.maximum(progress.multipliers + progress.penalty[:, None, None] * found.seen.violation, 0.0)
    progress.multipliers = np.where(fine[:, None, None], raised, progress.multipliers)
    slow = fine & (worst > SLACK) & (worst > 0.5 * progress.broken)
    progress.penalty = np.where(slow, np.minimum(2.0 * progress.penalty, MOST_PENALTY), progress.penalty)
    progress.broken = np.where(fine, worst, progress.broken)
    if problem.study.search.name == "lbfgs":
        progress.state = _fresh(problem, progress.unit, progress.stage)


def _line(problem: Problem, progress: Progress, at: np.ndarray, found: Evaluated) -> Line:
    i = chosen(progress)
    values = free.physical(problem.variables, jnp.asarray(at[i]))
    worst = found.seen.violation.reshape(len(progress.unit), -1).max(axis=1, initial=0.0)
    return Line(
        iteration=progress.iteration, stage=progress.stage, start=i,
        objective=float(over_media(problem, jnp.asarray(found.seen.objective[i]))), violation=float(max(worst[i], 0.0)),
        best=float(progress.merit[i]), gradient=float(np.linalg.norm(progress.slope[i])),
        alive=int(np.sum(progress.falls < ROLLBACKS)), simulations=progress.counts.simulations,
        gradients=progress.counts.gradients, seconds=progress.seconds,
        values=dict(zip(problem.names, map(float, values), strict=True)),
        loss=float(found.value[i]) if progress.falls[i] == 0 else np.nan,
        promised=float(progress.slope[i] @ (progress.unit[i] - progress.good[i])),
    )  # fmt: skip


def stop(problem: Problem, progress: Progress) -> None:
    """Set the reason, or move on to the next stage."""
    search, stages = problem.study.search, stages_of(problem)
    done = progress.iteration >= sum(s.iterations for s in stages[: progress.stage + 1])
    last = progress.stage == len(stages) - 1
    if (progress.falls >= ROLLBACKS).all() or not np.isfinite(progress.level).any():
        progress.reason = "every start failed: no step from them gives a run that holds"
        return
    if done and not last:  # even if the time is used up just now: a search that goes on begins with the next stage
        _next_stage(problem, progress)
    if search.goal is not None and progress.merit.min() <= search.goal:
        progress.reason = f"the objective reached the goal {search.goal:g}"
    elif search.seconds is not None and progress.seconds >= search.seconds:
        progress.reason = f"the time of {search.seconds:g} s is used up"
    elif last and progress.iteration - progress.since >= search.patience and np.isfinite(progress.merit).any():
        progress.reason = f"no gain of more than {search.gain:g} in {search.patience} iterations"
    elif last and done:
        progress.reason = f"{progress.iteration} iterations are done"


def _next_stage(problem: Problem, progress: Progress) -> None:
    """From the best points so far, with a fresh optimiser."""
    progress.stage += 1
    progress.since = progress.iteration
    progress.unit = progress.best.copy()
    progress.state = _fresh(problem, progress.unit, progress.stage)
    progress.level = np.where(progress.falls < ROLLBACKS, progress.level, np.inf)
    progress.falls[:] = 0
