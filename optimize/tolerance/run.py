"""Samples through the simulator: each one's run, and what is known of it."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from diffeed import measures
from diffeed.faults.causes import TOO_MANY_NEAR
from optimize.asked import Asked, values_of, violations
from optimize.tolerance.moves import sampled
from optimize.tolerance.problem import ToleranceProblem, rest_of
from optimize.tolerance.spread import Spread


class Rows(NamedTuple):
    """What is known of samples, (samples, ...)."""

    sample: np.ndarray  # index
    deviation: np.ndarray  # (samples, inputs)
    status: np.ndarray  # index into measures.STATUSES
    reason: np.ndarray
    time: np.ndarray  # s, of the verdict: as `measures.outcome` has it
    values: np.ndarray  # (samples, asked) measures, then limits; NaN in a run that failed
    broken: np.ndarray  # (samples, limits) bool

    @property
    def passed(self) -> np.ndarray:
        """(samples,) passed its verdict and all limits."""
        return (self.status == 0) & ~self.broken.any(axis=1)


def run_of(
    problem: ToleranceProblem, scene: diffeed.Scene, rest: Any, extra: tuple[str, ...] = ()
) -> diffeed.Trajectory:
    """One run as the study asks for it. A settled scene settles with its own parts, searching from the nominal rest."""
    study = problem.study
    initial = None if rest is None else diffeed.settle(scene, near=rest)
    return diffeed.simulate(
        scene, study.duration, frames=study.frames, **study.stepping, initial=initial,
        observe=tuple(sorted({*problem.observe, *extra})),
    )  # fmt: skip


def one(problem: ToleranceProblem, rest: Any, deviation: Array) -> tuple[tuple[Array, ...], Array]:
    """Status, reason, time, values and broken limits of one sample, as in `Rows`; and whether it found its list of pairs too
    short, which it may be only for being shared."""
    scene = sampled(problem.inputs, problem.scene, deviation)
    run = run_of(problem, scene, rest)
    found = measures.outcome(scene, run)
    values = values_of(problem.asked, scene, run, found=True)
    row = (
        found.status,
        found.reason,
        found.time,
        jnp.where(run.ok, values, jnp.nan),
        broken_limits(problem.limits, values[len(problem.measures) :]),
    )
    return row, run.failure.cause == TOO_MANY_NEAR


def broken_limits(limits: tuple[Asked, ...], values: Array) -> Array:
    """(limits,) which of them are broken by their values; one without a value is."""
    broken = [jnp.any(~(violations((asked,), value[None]) <= 0.0)) for asked, value in zip(limits, values, strict=True)]
    return jnp.stack(broken) if broken else jnp.zeros((0,), bool)


class Evaluator:
    """Compiles once and runs chunks of so many samples."""

    def __init__(self, problem: ToleranceProblem, chunk: int) -> None:
        self._rest = rest_of(problem)
        # Where steps are chosen, all abreast would wait for the one that chooses the shortest.
        abreast = problem.study.step_tolerance is None

        def function(deviation: Array, rest: Any) -> Any:
            row, shared_too_much = one(problem, rest, deviation)
            return (row, shared_too_much) if abreast else row

        self._spread = Spread(function, chunk, abreast)

    @property
    def chunk(self) -> int:
        return self._spread.chunk

    def __call__(self, sample: np.ndarray, deviation: np.ndarray) -> Rows:
        """At most `chunk` samples: indices (n,) and deviations (n, inputs)."""
        return Rows(sample, deviation, *self._spread.chunk_of(deviation, self._rest))


def bytes_of(problem: ToleranceProblem) -> int:
    """Memory of one sample's run, roughly."""
    run = jax.eval_shape(lambda s: run_of(problem, s, None), problem.scene)
    return 4 * sum(int(np.prod(v.shape)) * v.dtype.itemsize for v in jax.tree.leaves(run))


def chunks(samples: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Indices that are still to be run, chunk by chunk."""
    for k in range(0, len(samples), size):
        yield samples[k : k + size]


def joined(parts: list[Rows]) -> Rows:
    """Several sets of rows as one, in the order of the samples."""
    whole = Rows(*(np.concatenate(v) for v in zip(*parts, strict=True)))
    return chosen(whole, np.argsort(whole.sample))


def chosen(rows: Rows, which: np.ndarray) -> Rows:
    """Some of the rows, by mask or index."""
    return Rows(*(v[which] for v in rows))
