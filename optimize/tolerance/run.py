"""Samples through the simulator: one compiled program for a chunk of them, spread over all local devices."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import diffeed
from diffeed import measures, tuning
from optimize.asked import values_of, violations
from optimize.tolerance.moves import sampled
from optimize.tolerance.problem import ToleranceProblem, rest_of

TOGETHER = 8
"""Samples that a processor core computes at once: with 4, 8 and 16 the film feeder's study made 2.8, 2.9 and 2.2 samples a
second on two cores; more fall out of the cache."""
SHARE = 0.25
"""Share of an accelerator's memory that a chunk may take."""


class Rows(NamedTuple):
    """What is known of samples, (samples, ...)."""

    sample: np.ndarray  # index
    deviation: np.ndarray  # (samples, inputs)
    status: np.ndarray  # index into measures.STATUSES
    reason: np.ndarray
    time: np.ndarray  # s, of the verdict; infinite for a sheet that was still moving at the end
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


def one(problem: ToleranceProblem, rest: Any, deviation: Array) -> tuple[Array, ...]:
    """Status, reason, time, values and broken limits of one sample, as in `Rows`."""
    scene = sampled(problem.inputs, problem.scene, deviation)
    run = run_of(problem, scene, rest)
    found = measures.outcome(scene, run)
    values = values_of(problem.asked, scene, run)
    limits = zip(problem.limits, values[len(problem.measures) :], strict=True)
    broken = [jnp.any(~(violations((asked,), value[None]) <= 0.0)) for asked, value in limits]
    return (
        found.status,
        found.reason,
        found.time,
        jnp.where(run.ok, values, jnp.nan),
        jnp.stack(broken) if broken else jnp.zeros((0,), bool),
    )


def chunk_size(problem: ToleranceProblem) -> int:
    """Samples computed at once: for each core what fits its cache, for an accelerator what fits its memory."""
    devices = tuning.safe_devices(jax.local_devices())
    if devices[0].platform == "cpu":
        return TOGETHER * len(devices)
    limit = (devices[0].memory_stats() or {}).get("bytes_limit", 8e9)
    run = jax.eval_shape(lambda s: run_of(problem, s, None), problem.scene)
    each = 4 * sum(int(np.prod(v.shape)) * v.dtype.itemsize for v in jax.tree.leaves(run))
    return len(devices) * int(2 ** np.clip(np.floor(np.log2(SHARE * limit / each)), 4, 16))


class Evaluator:
    """Compiles once and runs chunks: every chunk has the same shape, the last one is filled up with its first row."""

    def __init__(self, problem: ToleranceProblem, chunk: int | None = None) -> None:
        devices = np.array(tuning.safe_devices(jax.local_devices()))
        wanted = chunk_size(problem) if chunk is None else chunk
        # A chunk is spread evenly; one that is too small for all devices takes fewer.
        devices = devices[: max(n for n in range(1, len(devices) + 1) if wanted % n == 0)]
        self.problem, self.chunk = problem, wanted
        self._rest = rest_of(problem)
        self._place = NamedSharding(Mesh(devices, ("samples",)), PartitionSpec("samples"))

        def many(deviations: Array) -> tuple[Array, ...]:
            return jax.vmap(lambda d: one(problem, self._rest, d))(deviations)

        if len(devices) > 1:
            spec = PartitionSpec("samples")
            many = jax.shard_map(many, mesh=self._place.mesh, in_specs=spec, out_specs=spec, check_vma=False)
        self._run = jax.jit(many)

    def __call__(self, sample: np.ndarray, deviation: np.ndarray) -> Rows:
        """At most `chunk` samples: indices (n,) and deviations (n, inputs)."""
        n = len(sample)
        filled = np.concatenate([deviation, np.repeat(deviation[:1], self.chunk - n, axis=0)])
        out = self._run(jax.device_put(jnp.asarray(filled), self._place))
        status, reason, time, values, broken = (np.asarray(v)[:n] for v in jax.device_get(out))
        return Rows(sample, deviation, status, reason, time, values, broken)


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
