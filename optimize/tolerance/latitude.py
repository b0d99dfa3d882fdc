"""The media latitude: which sheets pass, over two quantities, and by what margin."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from diffeed import measures
from optimize.asked import number_at, values_of
from optimize.programs import kept
from optimize.tolerance.problem import ToleranceProblem, at_axes, rest_of
from optimize.tolerance.records import Axis, Latitude
from optimize.tolerance.run import broken_limits, bytes_of, run_of
from optimize.tolerance.spread import Spread, chunk_size


class Map(NamedTuple):
    """What was found over x (nx,) and y (ny,)."""

    x: np.ndarray
    y: np.ndarray
    margin: np.ndarray  # (ny, nx) jam margin; NaN where the run failed
    passed: np.ndarray  # (ny, nx) bool: the verdict and all limits
    labels: tuple[str, str]
    nominal: tuple[float, float]


def latitude(problem: ToleranceProblem, scene: diffeed.Scene | None = None) -> Map:
    """Run the scene of a study (or another of the same parts) over the two axes of its latitude, all by one compiled program.

    A sheet passes as a sample of the study does: its run passes, and keeps the study's limits."""
    asked = problem.study.latitude
    if asked is None:
        raise ValueError("the study has no [latitude.x] and [latitude.y]")
    scene = problem.scene if scene is None else scene
    x, y = (np.linspace(*axis.range, axis.points) for axis in (asked.x, asked.y))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    chunk = min(len(grid), chunk_size(lambda: bytes_of(problem), len(grid)))
    mark = ("latitude", problem.key, asked.model_dump_json(), chunk)
    margin, passed = kept(mark, lambda: Spread(_outcome_at(problem, asked), chunk)).all_of(
        grid, (scene, rest_of(problem))
    )
    shape = (len(y), len(x))
    labels = (_label(problem, asked.x), _label(problem, asked.y))
    nominal = (_nominal(problem, asked.x), _nominal(problem, asked.y))
    return Map(x, y, margin.reshape(shape), passed.reshape(shape), labels, nominal)


def _outcome_at(problem: ToleranceProblem, asked: Latitude) -> Callable[[Array, Any], tuple[Array, Array]]:
    """Margin of a scene at a point of its latitude, and whether it passes."""

    def outcome(point: Array, given: tuple[diffeed.Scene, Any]) -> tuple[Array, Array]:
        scene, rest = given
        moved = at_axes(problem, scene, asked, point)
        run = run_of(problem, moved, rest, ("feed", "spans"))
        margin = jnp.where(run.ok, measures.jam_margin(moved, run), jnp.nan)
        broken = broken_limits(problem.limits, values_of(problem.limits, moved, run, found=True))
        return margin, (measures.outcome(moved, run).status == 0) & ~jnp.any(broken)

    return outcome


def _label(problem: ToleranceProblem, axis: Axis) -> str:
    if axis.climate is not None:
        return f"climate of {axis.climate}: dry -1, normal 0, humid 1"
    unit = diffeed.unit(problem.scene, axis.paths[0])
    return f"{axis.paths[0]}, {unit}" if unit != "1" else axis.paths[0]


def _nominal(problem: ToleranceProblem, axis: Axis) -> float:
    if axis.climate is not None:
        return problem.cards[axis.climate][1]
    return number_at(problem.scene, axis.paths[0])
