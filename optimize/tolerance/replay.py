"""A sample again, by its number: as an animation, in the machine with the parts that it drew."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

import diffeed
from diffeed import measures, player
from optimize.asked import values_of
from optimize.tolerance.folder import Folder, names_of
from optimize.tolerance.moves import sampled
from optimize.tolerance.problem import ToleranceProblem, rest_of
from optimize.tolerance.run import broken_limits, run_of
from optimize.tolerance.study import drawn
from optimize.tolerance.summary import limit_words


def sample_scene(problem: ToleranceProblem, sample: int) -> diffeed.Scene:
    """The scene of sample i of a study. ValueError for a number that the study does not have."""
    study = problem.study
    if not 0 <= sample < study.samples:
        raise ValueError(f"the study has samples 0 to {study.samples - 1}, but {sample} is asked for")
    return sampled(problem.inputs, problem.scene, jnp.asarray(drawn(problem)[sample]))


def judged(problem: ToleranceProblem, scene: diffeed.Scene, run: diffeed.Trajectory) -> str:
    """The verdict of a run, and the limits that it breaks; those of a run that failed mean nothing."""
    verdict = measures.verdict(scene, run).sentence()
    values = values_of(problem.limits, scene, run, found=True)
    broken = broken_limits(problem.limits, values)
    named = [
        f"{a.name} {limit_words(a)} ({_value(float(value), a.term.unit)})"
        for a, value, is_broken in zip(problem.limits, values, broken, strict=True)
        if is_broken
    ]
    return f"{verdict}, but breaks its limits: {'; '.join(named)}" if named and bool(run.ok) else verdict


def _value(value: float, unit: str) -> str:
    return "never" if np.isinf(value) else f"it is {value:.4g}{'' if unit == '1' else f' {unit}'}"


def replay(problem: ToleranceProblem, sample: int, folder: Path) -> tuple[Path, str]:
    """Write `sample_<i>.html` (its animation) and `sample_<i>.toml` (its scene); the path of the first, and the verdict with the
    limits that are broken.

    FolderError, before anything is run, where the folder holds another study: its sample of that number is another machine.
    """
    Folder(folder, problem).refuse_another()
    scene = sample_scene(problem, sample)
    run = run_of(problem, scene, rest_of(problem))
    folder.mkdir(parents=True, exist_ok=True)
    written, path = (folder / name for name in names_of(sample))
    diffeed.save_scene(scene, written)
    player.write_player(path, scene, run)
    return path, judged(problem, scene, run)
