"""The blame map: which part to move which way for how much gain, and when the sensitivity arises.

The gradient of the objective with respect to every place of every roller and guide comes from one reverse pass. To see
when it arises, the run is cut into spans of time, each with a copy of the scene of its own: the derivative with respect to
the copy of a span is what moving the part during that span would do. The spans add up to the whole.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from diffeed.base.records import replace
from diffeed.readings.trajectory import FRAMED
from diffeed.run.rollout import at_start
from optimize.asked import values_of
from optimize.problem import Problem, objective_of, simulate
from optimize.programs import kept
from optimize.variables import PLACES


class Blame(NamedTuple):
    """Derivatives of the objective per mm: `places` path -> (2,), `sizes` path -> one number (radii)."""

    objective: float
    places: dict[str, np.ndarray]
    sizes: dict[str, float]


class Arising(NamedTuple):
    """(parts, spans) magnitude of the sensitivity to each part's place by span of time."""

    parts: tuple[str, ...]
    edges: np.ndarray  # (spans + 1,) s
    share: np.ndarray


def blame(problem: Problem, unit: np.ndarray, medium: int = 0) -> Blame:
    """Where the objective would fall if parts were moved."""
    scene = problem.scene(unit, medium)

    def of(scene: diffeed.Scene) -> Array:
        return objective_of(problem, values_of(problem.goals, scene, simulate(problem, scene)))

    value, slope = kept(("blame", problem.key), lambda: jax.jit(jax.value_and_grad(of)))(scene)
    places, sizes = {}, {}
    for part in parts_of(scene):
        held = diffeed.get(slope, part)
        for name in PLACES:
            if hasattr(held, name):
                places[f"{part}.{name}"] = np.asarray(getattr(held, name))
        if hasattr(held, "radius"):
            sizes[f"{part}.radius"] = float(held.radius)
    return Blame(float(value), places, sizes)


def parts_of(scene: diffeed.Scene) -> list[str]:
    """Paths of all rollers and guides."""
    return [f"{section}.{name}" for section in ("rollers", "guides") for name in sorted(getattr(scene, section))]


def arising(problem: Problem, unit: np.ndarray, spans: int = 12, medium: int = 0) -> Arising:
    """When the sensitivity to each part arises."""
    scene = problem.scene(unit, medium)
    study = problem.study
    duration = study.duration or scene.duration
    piece, frames = duration / spans, 2 + max(0, study.frames - 2) // spans

    def of(copies: diffeed.Scene) -> Array:
        begun = at_start(jax.tree.map(lambda v: v[0], copies), problem.observe)

        def go_on(resume: Any, copy: diffeed.Scene) -> tuple[Any, diffeed.Trajectory]:
            run = diffeed.simulate(
                copy, piece, frames=frames, **study.stepping, initial=resume, observe=problem.observe
            )
            return run.final, run

        _, runs = jax.lax.scan(jax.checkpoint(go_on), begun, copies)
        return objective_of(problem, values_of(problem.goals, jax.tree.map(lambda v: v[-1], copies), _joined(runs)))

    copies = jax.tree.map(lambda v: jnp.broadcast_to(v, (spans, *v.shape)), scene)
    slope = kept(("arising", problem.key, spans), lambda: jax.jit(jax.grad(of)))(copies)
    parts = tuple(parts_of(scene))
    share = np.reshape([_size(diffeed.get(slope, part)) for part in parts], (len(parts), spans))
    return Arising(parts, np.linspace(0.0, duration, spans + 1), share)


def _joined(runs: diffeed.Trajectory) -> diffeed.Trajectory:
    """The whole run of consecutive ones, (runs, ...) each, as `readings.trajectory.join` makes it, inside a trace."""

    def along(v: Array) -> Array:
        return jnp.concatenate([v[0, :1], v[:, 1:].reshape(v.shape[0] * (v.shape[1] - 1), *v.shape[2:])])

    frames = {name: jax.tree.map(along, getattr(runs, name)) for name in FRAMED}
    return replace(jax.tree.map(lambda v: v[-1], runs), **frames)


def _size(held: Any) -> np.ndarray:
    """(spans,) length of the derivative with respect to a part's places."""
    found = [np.asarray(getattr(held, n)) for n in PLACES if hasattr(held, n)]
    total = sum(np.sum(v**2, axis=-1) for v in found)
    return np.sqrt(total)


def gain_of(found: Blame, step: float = 0.1) -> list[tuple[str, np.ndarray, float]]:
    """(path, unit direction that lowers the objective, gain of a step of that many mm), the largest first."""
    rows = []
    for path, slope in found.places.items():
        size = float(np.linalg.norm(slope))
        if size > 0 and np.isfinite(size):
            rows.append((path, -slope / size, size * step))
    return sorted(rows, key=lambda r: -r[2])
