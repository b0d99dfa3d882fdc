"""The compiled evaluation of a problem: values and gradients of many points at once."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from optimize.problem import Problem, Seen, Settings, look, loss, seen_in
from optimize.programs import kept

TOGETHER = 16
"""Points that are computed at once: more fall out of the processor's cache."""


class Evaluated(NamedTuple):
    """Points (points, n): loss (points,), gradient (points, n), what was seen (points, media, ...)."""

    value: np.ndarray
    gradient: np.ndarray
    seen: Seen


class Counts(NamedTuple):
    """What was spent: simulations (one medium, forward) and gradients (one medium)."""

    simulations: int = 0
    gradients: int = 0

    def plus(self, simulations: int, gradients: int) -> "Counts":
        return Counts(self.simulations + simulations, self.gradients + gradients)


OUTLIER = 3.0
"""Times the median length of the samples' gradients beyond which one is shortened to that length."""


def _without_outliers(gradient: Array, fine: Array) -> Array:
    """(points, samples, n) gradients with the longest ones shortened: near an impact one sample in ten has a derivative a
    thousand times that of the others, and a plain mean would follow it alone. A single sample stays as it is."""
    length = jnp.sqrt(jnp.sum(gradient**2, axis=2))
    # Of those that have a slope: a measure may be flat in most of the neighbourhood.
    limit = OUTLIER * jnp.nanmedian(jnp.where(fine & (length > 0), length, jnp.nan), axis=1, keepdims=True)
    return gradient * jnp.where(length > limit, limit / jnp.where(length > 0, length, 1.0), 1.0)[:, :, None]


class Evaluator:
    """Compiled functions of one problem, one per run length. With `samples`, the expected gradient: the mean over
    points drawn around each (the same draws for all points and iterations), outliers shortened."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.counts = Counts()
        search = problem.study.search
        self.draws = np.zeros((1, len(problem.names)))
        if search.gradient == "expected":
            rng = np.random.default_rng(search.seed)
            half = rng.normal(size=((search.samples + 1) // 2, len(problem.names)))
            self.draws = np.concatenate([half, -half])[: search.samples] * problem.tolerance  # antithetic

    def gradients(
        self, unit: np.ndarray, multipliers: np.ndarray, penalty: np.ndarray, settings: Settings
    ) -> Evaluated:
        """Values and gradients at points (points, n), each with its own multipliers and penalty."""
        mark = ("gradients", self.problem.key, self.draws.tobytes(), settings.duration)
        function = kept(mark, lambda: jax.jit(self._make(settings.duration)))
        made = self.problem.deviations() if settings.deviations is None else settings.deviations
        out = function(
            jnp.asarray(unit), jnp.asarray(multipliers), jnp.asarray(penalty), jnp.asarray(settings.smoothing),
            jnp.asarray(made),
        )  # fmt: skip
        runs = len(unit) * len(self.draws) * len(self.problem.media) * len(made)
        self.counts = self.counts.plus(runs, runs)
        return Evaluated(np.array(out[0]), np.array(out[1]), jax.device_get(out[2]))

    def _make(self, duration: float | None):
        problem, draws = self.problem, jnp.asarray(self.draws)
        mode = problem.plan(duration).mode

        def one(point: tuple[Array, Array, Array, Array], made: Array) -> tuple[Array, Array, Seen]:
            unit, multipliers, penalty, smoothing = point

            def of(u: Array) -> tuple[Array, tuple[Array, Seen]]:
                value, seen = loss(problem, u, multipliers, penalty, Settings(smoothing, duration, made))
                return value, (value, seen)

            take = jax.jacfwd if mode == "forward" else jax.jacrev
            gradient, (value, seen) = take(of, has_aux=True)(unit)
            return value, gradient, seen

        def many(
            unit: Array, multipliers: Array, penalty: Array, smoothing: Array, made: Array
        ) -> tuple[Array, Array, Seen]:
            count, samples = unit.shape[0], draws.shape[0]
            around = jnp.clip(unit[:, None] + draws[None], 0.0, 1.0).reshape(count * samples, -1)
            spread = lambda v: jnp.repeat(v, samples, axis=0)  # noqa: E731
            points = (around, spread(multipliers), spread(penalty), jnp.broadcast_to(smoothing, (count * samples,)))
            if count * samples == 1:
                value, gradient, seen = jax.tree.map(lambda v: v[None], one(jax.tree.map(lambda v: v[0], points), made))
            else:
                value, gradient, seen = jax.lax.map(lambda p: one(p, made), points, batch_size=TOGETHER)
            value, gradient = value.reshape(count, samples), gradient.reshape(count, samples, -1)
            seen = jax.tree.map(lambda v: v.reshape(count, samples, *v.shape[1:]), seen)
            # A sample that failed says nothing about the mean; a point fails when most of its samples do.
            fine = jnp.all(seen.ok, axis=2) & jnp.isfinite(value) & jnp.all(jnp.isfinite(gradient), axis=2)
            enough = jnp.mean(fine.astype(value.dtype), axis=1) > 0.5

            def average(values: Array) -> Array:
                mask = fine.reshape(count, samples, *[1] * (values.ndim - 2))
                return jnp.mean(values, axis=1, where=mask)

            ok = jnp.broadcast_to(enough[:, None], (count, seen.ok.shape[2]))
            told = Seen._make([*(average(v) for v in seen[:-1]), ok])
            return jnp.where(enough, average(value), jnp.nan), average(_without_outliers(gradient, fine)), told

        return many


def seen_at(problem: Problem, unit: np.ndarray, scenes: list[diffeed.Scene], runs: list[diffeed.Trajectory]) -> Seen:
    """What the study sees at a point (n,), at its own settings: in the run of each medium's machine as drawn, or, where
    machines scatter, in runs of its own."""
    if problem.inputs:
        see = kept(("seen", problem.key), lambda: jax.jit(lambda u: look(problem, u, Settings())))
        return jax.device_get(see(jnp.asarray(unit)))
    see = kept(("seen in", problem.key), lambda: jax.jit(functools.partial(seen_in, problem)))
    each = [jax.device_get(see(scene, run)) for scene, run in zip(scenes, runs, strict=True)]
    return jax.tree.map(lambda *v: np.stack(v), *each)
