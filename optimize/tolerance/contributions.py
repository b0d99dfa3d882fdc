"""How much each tolerance moves a measure: by gradients at the samples, and by Sobol indices from runs of their own."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from optimize.asked import values_of
from optimize.programs import kept
from optimize.tolerance.draws import deviations, groups
from optimize.tolerance.moves import sampled
from optimize.tolerance.problem import ToleranceProblem, rest_of
from optimize.tolerance.run import run_of
from optimize.tolerance.spread import TOGETHER, Spread
from optimize.tolerance.statistics import Indices, saltelli, sobol
from optimize.tolerance.study import Runner, run_rows


class Slopes(NamedTuple):
    """d measure / d deviation: at the nominal scene (asked, inputs), and at samples (samples, asked, inputs)."""

    nominal: np.ndarray
    samples: np.ndarray


def slopes(problem: ToleranceProblem, deviation: np.ndarray) -> Slopes:
    """One gradient of every measure and limit at each of the given samples, (n, inputs), and at the nominal scene.

    NaN where a run fails, or where a measure has no slope (a sheet that never arrives).
    """
    each = kept(("slopes", problem.key), lambda: Spread(_gradient_of(problem), TOGETHER))
    points, rest = np.concatenate([np.zeros((1, deviation.shape[1])), deviation]), rest_of(problem)
    asked = range(len(problem.asked))
    rows = [np.column_stack([points, np.full(len(points), k)]) for k in asked]
    # (asked, samples, inputs), also for a study that asks for nothing
    whole = np.reshape([each.all_of(r, rest) for r in rows], (len(rows), *points.shape)).swapaxes(0, 1)
    return Slopes(whole[0], whole[1:])


def _gradient_of(problem: ToleranceProblem) -> Callable[[Array, Any], Array]:
    def values(d: Array, rest: Any) -> Array:
        scene = sampled(problem.inputs, problem.scene, d)
        run = run_of(problem, scene, rest)
        return jnp.where(run.ok, values_of(problem.asked, scene, run, found=True), jnp.nan)

    def gradient(row: Array, rest: Any) -> Array:
        """Of one measure; which one is the row's last number, so that a single program serves all of them."""
        value, slope = jax.value_and_grad(lambda d: values(d, rest)[row[-1].astype(int)])(row[:-1])
        return jnp.where(jnp.isfinite(value), slope, jnp.nan)

    return gradient


def refuse_groups(problem: ToleranceProblem) -> None:
    """ValueError for a study whose Sobol indices mean nothing: numbers of a group are not independent."""
    if named := groups(problem.inputs):
        raise ValueError(
            f"Sobol indices need independent inputs, but this study draws groups together: {', '.join(named)}"
        )


def indices(problem: ToleranceProblem, count: int, runner: Runner | None, folder: Any, **how: Any) -> list[Indices]:
    """Sobol indices of every measure and limit, with intervals: count * (inputs + 2) runs of their own.

    The inputs must be independent (`refuse_groups`). A failed run has no value, and none of the runs that it belongs with counts:
    the indices are those of the machines that work (`Indices.points` says of how many).
    """
    refuse_groups(problem)
    d = len(problem.inputs)
    a, b, ab = saltelli(count, d, problem.study.seed)
    u = np.concatenate([a, b, ab.reshape(-1, d)])
    rows = run_rows(problem, deviations(problem.inputs, u), runner, folder, **how)
    found = []
    for k in range(len(problem.asked)):
        values = rows.values[:, k]
        f_a, f_b, f_ab = values[:count], values[count : 2 * count], values[2 * count :].reshape(d, count)
        found.append(sobol(f_a, f_b, f_ab, problem.study.seed))
    return found
