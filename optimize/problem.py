"""A study made ready: scene, media and terms looked up and checked, and the loss as a pure function of the unit vector."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from diffeed.base.batching import for_each
from diffeed.base.names import nearest
from diffeed.base.products import ALL_DIGITS
from diffeed.base.words import quoted
from diffeed.input.stacking import misfit
from optimize import variables as free
from optimize.asked import Asked, StudyError, changed, number_at, resolved, run_problems, values_of, violations
from optimize.study import Goal, Study, Variable
from optimize.study_file import make_study
from optimize.tolerance.draws import Input, deviations, inputs_of, key_of, uniforms
from optimize.tolerance.moves import sampled

GIVEN = "given"
"""In place of the name of a scene that was built in Python."""
SLACK = 1e-2
"""A limit counts as kept when it is missed by less than this share of its scale."""


class Seen(NamedTuple):
    """What one evaluation saw, (media, ...) each."""

    goals: Array  # (media, goals) values of the measures
    limits: Array  # (media, limits) values of the measures
    violation: Array  # (media, sides) > 0 where a limit is broken, in its scale
    objective: Array  # (media,)
    ok: Array  # (media,) the run holds


@dataclass(frozen=True)
class Problem:
    """A checked study. `scenes`: one per medium, normalised."""

    study: Study
    scenes: tuple[diffeed.Scene, ...]
    media: tuple[str, ...]
    weights: np.ndarray
    goals: tuple[Asked, ...]
    limits: tuple[Asked, ...]
    start: np.ndarray  # (n,) unit values
    inputs: tuple[Input, ...] = ()  # what scatters

    @property
    def variables(self) -> tuple[Any, ...]:
        return tuple(self.study.variables.values())

    @functools.cached_property
    def key(self) -> str:
        """Equal for problems whose runs and terms are the same, however they are searched."""
        return key_of(self.study.as_run({"search", "title", "scene"}), self.inputs, self.scenes)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.study.variables)

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(free.unit_text(self.scenes[0], v) for v in self.variables)

    @property
    def observe(self) -> tuple[str, ...]:
        found = {o for asked in (*self.goals, *self.limits) for o in asked.term.observe}
        return tuple(sorted(found))

    @property
    def sides(self) -> int:
        """Number of one-sided limits."""
        return sum((a.spec.at_least is not None) + (a.spec.at_most is not None) for a in self.limits)  # type: ignore[union-attr]

    @property
    def tolerance(self) -> np.ndarray:
        """(n,) unit size of a designer's step: the variable's `tolerance`, or 1 % of its range."""
        start = free.physical(self.variables, jnp.asarray(self.start))
        sizes = [v.tolerance or 0.01 * (v.bounds[1] - v.bounds[0]) for v in self.variables]
        moved = np.clip(np.asarray(start) + sizes, *np.array([v.bounds for v in self.variables]).T)
        back = np.clip(np.asarray(start) - sizes, *np.array([v.bounds for v in self.variables]).T)
        ahead, behind = moved - np.asarray(start), np.asarray(start) - back
        ends = np.where((ahead < 0.5 * np.array(sizes)) & (behind > ahead), back, moved)
        return np.abs(np.asarray(free.unit(self.variables, ends)) - self.start)

    def deviations(self, iteration: int = 0) -> np.ndarray:
        """(samples, inputs) what scatters in the machines of an iteration; (1, 0) for a study without tolerances."""
        robust = self.study.robust
        if not self.inputs:
            return np.zeros((1, 0))
        seed = robust.seed + (iteration if robust.redraw else 0)
        return deviations(self.inputs, uniforms(self.inputs, "latin_hypercube", robust.samples, seed))

    def plan(self, duration: float | None = None) -> diffeed.GradientPlan:
        """How the gradient of one run is taken, and what it needs."""
        study = self.study
        return diffeed.gradient_plan(
            self.scenes[0], len(self.names), duration or study.duration, study.dt, study.frames,
            tolerance=study.step_tolerance, most_steps=study.most_steps,
        )  # fmt: skip

    def scene(self, unit: Any, medium: int = 0) -> diffeed.Scene:
        """The scene of a point."""
        return free.applied(self.scenes[medium], self.variables, free.physical(self.variables, jnp.asarray(unit)))


class Settings(NamedTuple):
    """What a stage changes: easier contact (traced), run length (static); and the machines of an iteration (traced),
    the problem's fixed ones if not given."""

    smoothing: Any = 1.0
    duration: float | None = None
    deviations: Any = None


def simulate(problem: Problem, scene: diffeed.Scene, duration: float | None = None, extra: tuple[str, ...] = ()) -> Any:
    """One run as the study asks for it."""
    study = problem.study
    return diffeed.simulate(
        scene,
        duration or study.duration,
        frames=study.frames,
        **study.stepping,
        observe=tuple(sorted({*problem.observe, *extra})),
    )


def eased(scene: diffeed.Scene, factor: Any) -> diffeed.Scene:
    """Smoothing lengths, stick speeds and displacements times a factor: rounder corners in the landscape, at a bias."""
    for name in scene.contacts:
        for field in ("smoothing", "stick_speed", "stick_displacement"):
            path = f"contacts.{name}.{field}"
            scene = diffeed.put(scene, path, diffeed.get(scene, path) * factor)
    return scene


def objective_of(problem: Problem, values: Array) -> Array:
    """The weighted sum of the goals."""
    total = jnp.zeros(())
    for value, asked in zip(values, problem.goals, strict=True):
        spec = asked.spec
        assert isinstance(spec, Goal)
        scaled = value / spec.scale if spec.target is None else ((value - spec.target) / spec.scale) ** 2
        total = total + spec.weight * scaled
    return total


def seen_in(problem: Problem, scene: diffeed.Scene, run: diffeed.Trajectory) -> Seen:
    """What a study sees in one run: of one medium and one machine."""
    goals, limits = values_of(problem.goals, scene, run), values_of(problem.limits, scene, run)
    return Seen(goals, limits, violations(problem.limits, limits), objective_of(problem, goals), run.ok)


def look(problem: Problem, unit: Array, settings: Settings) -> Seen:
    """Run all media at a point."""
    factor = jnp.asarray(settings.smoothing)
    made = problem.deviations() if settings.deviations is None else settings.deviations

    def one(scene: diffeed.Scene, deviation: Array) -> Seen:
        moved = free.applied(scene, problem.variables, free.physical(problem.variables, unit))
        moved = eased(sampled(problem.inputs, moved, deviation), factor)
        return seen_in(problem, moved, simulate(problem, moved, settings.duration))

    made = jnp.asarray(made)
    if len(problem.scenes) == 1 and made.shape[0] == 1:
        return jax.tree.map(lambda v: v[None], one(problem.scenes[0], made[0]))
    scenes = diffeed.stack(list(problem.scenes))
    if made.shape[0] == 1:
        return for_each(lambda scene: one(scene, made[0]))(scenes)
    every = for_each(lambda scene: for_each(lambda deviation: one(scene, deviation))(made))(scenes)
    return _over_samples(problem, every)


def _over_samples(problem: Problem, every: Seen) -> Seen:
    """(media, samples, ...) -> (media, ...): of objectives and violations the risk that the study names, of measures the
    mean. A point holds when all its machines run."""
    robust = problem.study.robust

    def risk(values: Array) -> Array:
        """Over axis 1."""
        if robust.over == "mean":
            return jnp.mean(values, axis=1)
        if robust.over == "worst":
            return jnp.max(values, axis=1)
        count = values.shape[1]
        left = np.clip(robust.tail * count - np.arange(count), 0.0, 1.0) / (robust.tail * count)
        worst = -jnp.sort(-values, axis=1)
        return jnp.einsum("ms...,s->m...", worst, jnp.asarray(left, values.dtype), precision=ALL_DIGITS)

    return Seen(
        goals=jnp.mean(every.goals, axis=1),
        limits=jnp.mean(every.limits, axis=1),
        violation=risk(every.violation),
        objective=risk(every.objective),
        ok=jnp.all(every.ok, axis=1),
    )


def over_media(problem: Problem, objective: Array) -> Array:
    """(media,) objectives as one number: mean, worst, or the mean of the worst `tail` share (CVaR)."""
    weights = jnp.asarray(problem.weights / problem.weights.sum())
    if problem.study.over == "mean" or len(problem.media) == 1:
        return jnp.sum(weights * objective)
    if problem.study.over == "worst":
        return jnp.max(objective)
    order = jnp.argsort(-objective)
    left = jnp.clip(problem.study.tail - (jnp.cumsum(weights[order]) - weights[order]), 0.0, weights[order])
    return jnp.sum(left * objective[order]) / problem.study.tail


def loss(problem: Problem, unit: Array, multipliers: Array, penalty: Array, settings: Settings) -> tuple[Array, Seen]:
    """The augmented Lagrangian at a point: objective + sum (max(0, m + p g)^2 - m^2)/(2 p) over media and limits g <= 0."""
    seen = look(problem, unit, settings)
    pushed = jnp.maximum(multipliers + penalty * seen.violation, 0.0)
    return over_media(problem, seen.objective) + jnp.sum(pushed**2 - multipliers**2) / (2.0 * penalty), seen


# --- from a study to a problem ----------------------------------------------------------------------------------------


def make_problem(
    study: Study | dict[str, Any],
    where: str = "study",
    scene: diffeed.Scene | None = None,
    folder: Path | None = None,
) -> Problem:
    """Look everything up. StudyError lists all that does not fit. `scene` replaces the one that the study names, and a table
    (of `make_study`) then need not name any; files of measured values count from `folder` (where Python runs, if not given)."""
    if isinstance(study, dict):
        study = make_study(study if scene is None else {"scene": GIVEN} | study, where)
    try:
        base = diffeed.load_scene(study.scene) if scene is None else scene
    except diffeed.SceneError as error:
        raise StudyError([f"scene {quoted(study.scene)}: {p}" for p in error.problems], where) from None
    problems: list[str] = []
    base = changed(base, study.set, "set", problems)
    scenes = {name: changed(base, m.set, f"media.{name}.set", problems) for name, m in study.media.items()}
    scenes = scenes or {"": base}
    problems += list(_variable_problems(study, base)) or list(_bound_problems(study, base))
    moving = [name for name, tolerance in study.tolerances.items() if tolerance.climate is not None]
    problems += [f"tolerances.{n}.climate belongs to tolerance studies, whose media are cards" for n in moving]
    tolerances = {name: t for name, t in study.tolerances.items() if name not in moving}
    inputs = inputs_of(tolerances, {}, base, folder or Path(), problems)
    goals = tuple(resolved("objective", n, g, base, problems) for n, g in study.objective.items())
    limits = tuple(resolved("limits", n, g, base, problems) for n, g in study.limits.items())
    problems += _setting_problems(study)
    if not problems:
        for name, medium in scenes.items():
            run_problems(study, medium, f"media.{name}" if name else "", problems, _at_once(study))
        problems += _media_problems(scenes)
    if problems:
        raise StudyError(problems, where)
    variables = tuple(study.variables.values())
    start = np.asarray(free.unit(variables, [free.start_of(v, base) for v in variables]))
    weights = np.array([m.weight for m in study.media.values()] or [1.0])
    return Problem(
        study,
        tuple(scenes.values()),
        tuple(scenes),
        weights,
        tuple(filter(None, goals)),
        tuple(filter(None, limits)),
        start,
        inputs,
    )


def _media_problems(scenes: dict[str, diffeed.Scene]) -> Iterator[str]:
    """Media run as one batch of scenes."""
    (first, base), *others = scenes.items()
    for name, scene in others:
        if found := misfit(base, scene):
            yield f"media.{name} must differ from media.{first} in numbers alone, but {found}"


def _at_once(study: Study) -> int:
    """Runs of one iteration."""
    search, machines = study.search, study.robust.samples if study.tolerances else 1
    return (
        search.starts * max(1, len(study.media)) * machines * (search.samples if search.gradient == "expected" else 1)
    )


def _variable_problems(study: Study, scene: diffeed.Scene) -> Iterator[str]:
    owners: dict[str, str] = {}
    for name, variable in study.variables.items():
        where = f"variables.{name}"
        found = []
        for path in variable.paths:
            if owners.setdefault(path, name) != name:
                found.append(
                    f"{where}.path must name other numbers than variables.{owners[path]}, but names {path} again"
                )
            try:
                number_at(scene, path)
            except ValueError as error:
                found.append(f"{where}.path: {error}")
        try:
            free.refuse_moves(scene, variable)
        except ValueError as error:
            found.append(f"{where}: {error}")
        yield from found
        if not found:
            start, (low, high) = free.start_of(variable, scene), variable.bounds
            if not low <= start <= high:
                yield f"{where}.bounds must hold the start, {start:g}, but are [{low:g}, {high:g}]"
    for name, variable in study.variables.items():
        for path in variable.delay or ():
            for own, owner in owners.items():
                if own == path or own.startswith(f"{path}["):
                    yield f"variables.{name}.delay must name other times than variables.{owner}.path, but names {path}"


def _bound_problems(study: Study, scene: diffeed.Scene) -> Iterator[str]:
    """What no scene can have where the search begins, and where one variable is at a bound and the others are there."""
    names, variables = list(study.variables), tuple(study.variables.values())
    start = [free.start_of(v, scene) for v in variables]
    begins = list(_number_problems(scene, variables, start))
    yield from (f"variables, where the search begins: {problem}" for problem in begins)
    for i, variable in enumerate(variables if not begins else ()):
        for bound in variable.bounds:
            for problem in _number_problems(scene, variables, [*start[:i], bound, *start[i + 1 :]]):
                yield f"variables.{names[i]}.bounds: at {bound:g}, {problem}"


def _number_problems(scene: diffeed.Scene, variables: tuple[Variable, ...], values: list[float]) -> Iterator[str]:
    try:
        diffeed.scene(**vars(free.applied(scene, variables, jnp.asarray(values))))
    except diffeed.SceneError as error:
        yield from error.problems


def _setting_problems(study: Study) -> Iterator[str]:
    from optimize.optimisers import OPTIMISERS, UNSCHEDULED

    if study.method not in diffeed.METHODS:
        known, near = ", ".join(diffeed.METHODS), nearest(study.method, diffeed.METHODS)
        yield f'method must be one of {known}, but is "{study.method}"{near}'
    if study.robust.redraw and study.search.name == "lbfgs":
        yield 'robust.redraw must be false for "lbfgs": its line search compares points'
    if study.search.gradient == "expected" and study.search.name == "lbfgs":
        yield 'search.gradient must be "exact" for "lbfgs", whose line search compares single points, but is "expected"'
    if study.search.name in UNSCHEDULED and study.search.schedule != "constant":
        yield f'search.schedule must be "constant" for "{study.search.name}", but is "{study.search.schedule}"'
    if study.search.name not in OPTIMISERS:
        known, near = ", ".join(OPTIMISERS), nearest(study.search.name, OPTIMISERS)
        yield f'search.name must be an optimiser of optax ({known}), but is "{study.search.name}"{near}'
