"""May the gradients of a study be believed over the steps that its search would make? `diffeed.gradient_check` on the
study's own variables and objective."""

import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from optimize import variables as free
from optimize.problem import Problem, Settings, look, over_media

FILES = ("gradients.txt", "gradients.json")
"""The last is written last."""


def check_study(problem: Problem, samples: int = 64) -> diffeed.GradientCheck:
    """Derivatives of the objective with respect to each variable, in the variable's unit, at the study's start."""
    start = np.asarray(free.physical(problem.variables, jnp.asarray(problem.start)))
    moved = np.asarray(free.physical(problem.variables, jnp.asarray(np.clip(problem.start + problem.tolerance, 0, 1))))
    back = np.asarray(free.physical(problem.variables, jnp.asarray(np.clip(problem.start - problem.tolerance, 0, 1))))
    spans = np.minimum(np.where(moved > start, moved - start, np.inf), np.where(back < start, start - back, np.inf))

    def of(values: Array) -> Array:
        seen = look(problem, free.unit(problem.variables, values), Settings())
        return over_media(problem, seen.objective)[None]

    duration = problem.study.duration or problem.scenes[0].duration
    return diffeed.check_function(of, start, problem.names, problem.units, spans, np.array([duration]), samples=samples)


def write_check(folder: Path, found: diffeed.GradientCheck) -> list[str]:
    """The table as text and as numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "gradients.txt").write_text(str(found) + "\n", "utf-8")
    rows: list[dict[str, Any]] = [
        {k: v if isinstance(v, str) or np.isfinite(v) else None for k, v in r._asdict().items()} for r in found.rows
    ]
    (folder / "gradients.json").write_text(json.dumps(rows, indent=2) + "\n", "utf-8")
    return list(FILES)
