"""Gradients of a measure of a run: one switch between forward and reverse mode, chosen from the counts if not given.

Forward mode costs about one run per number and no memory; reverse mode some runs for all numbers together and one stored
state per step (the scan is checkpointed: a step is computed again when it is pulled back), or, in a long run, one per
block of steps.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.check_records import checked
from diffeed.input.check_values import show
from diffeed.input.parts import Scene
from diffeed.input.paths import listed_paths, numbers_at, put
from diffeed.model.build import build
from diffeed.readings.trajectory import Trajectory
from diffeed.run import error_control
from diffeed.run.progress import begin
from diffeed.run.rollout import MANY, MOST_STEPS, STEP, Plan, plan, refuse_control, simulate
from diffeed.steppers import DEFAULT

Measure = Callable[[Scene, Trajectory], Array]
MODES = ("auto", "forward", "reverse")
FEW = 4
"""Numbers up to which forward mode is the cheaper one (measured: reverse mode costs some five runs)."""
FIELDS = 90
"""Arrays per contact pair that one step keeps for its derivative (measured on the shipped scenes)."""


KEPT = 8
"""Arrays per contact pair that a search keeps for the steps that follow (measured likewise)."""


class GradientPlan(NamedTuple):
    """How a gradient will be taken."""

    mode: str
    numbers: int
    steps: int
    stored: int  # states kept as checkpoints: one per step, or one per block of steps in a long run
    memory: int  # bytes, an estimate

    def sentence(self) -> str:
        kept = f"{self.stored} stored states" if self.mode == "reverse" else "no stored states"
        return (
            f"{self.mode} mode for {self.numbers} numbers through {self.steps} steps: {kept}, "
            f"about {self.memory / 1e6:.3g} MB"
        )


def gradient_plan(
    scene: Scene,
    count: int,
    duration: float | None = None,
    dt: float | None = None,
    frames: int = 2,
    mode: str = "auto",
    tolerance: float | None = None,
    most_steps: int = MOST_STEPS,
) -> GradientPlan:
    """Mode, checkpoints and memory for the gradient of a run with respect to `count` numbers.

    With a `tolerance`, of a run that takes `most_steps`: room for all of them is held.
    """
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, but is {mode!r}")
    scene = checked(scene)
    if tolerance is None:
        duration, dt = scene.duration if duration is None else duration, STEP if dt is None else dt
        counts = plan(duration, dt, frames, scene.crowded)
    else:
        counts = Plan(2, error_control.blocks(most_steps, frames - 1), error_control.BLOCK)
    chosen = mode if mode != "auto" else "forward" if count <= FEW else "reverse"
    carry = jax.eval_shape(lambda s: begin(build(s), s, None, ()), scene)
    state = sum(int(np.prod(v.shape)) * v.dtype.itemsize for v in jax.tree.leaves(carry))
    bars = sum(s.bars for s in scene.sheets.values())
    pairs = (bars + len(scene.sheets)) * min(24, len(scene.rollers) + 3 * len(scene.guides))
    step = 8 * (FIELDS * pairs + 3 * (bars + 2 * len(scene.rollers)) ** 2)
    searches = (counts.frames - 1) * counts.blocks
    short = tolerance is not None or counts.total <= MANY
    stored = counts.total if short else searches
    # A block computed again holds the states of its steps; each search keeps its candidates.
    memory = stored * state + (searches if short else 1) * 8 * KEPT * pairs + counts.steps * state + step
    if chosen == "forward":
        stored, memory = 0, (1 + count) * (state + step)
    return GradientPlan(chosen, count, counts.total, stored, memory)


def value_and_gradient(
    measure: Measure,
    scene: Scene,
    paths: Sequence[str] | None = None,
    mode: str = "auto",
    duration: float | None = None,
    dt: float | None = None,
    frames: int = 101,
    method: str = DEFAULT,
    observe: tuple[str, ...] = (),
    tolerance: float | None = None,
    most_steps: int = MOST_STEPS,
) -> tuple[Array, Any]:
    """A measure(scene, trajectory) of a run, a scalar, and its derivatives.

    With `paths`, derivatives come as a dictionary by path; without, as a scene (every number; reverse mode only). Units
    are those of the measure per unit of the number.

    Called again with the same measure and settings, nothing is compiled; as with `jax.jit`, what the measure takes from
    outside itself then stays as it was in the first call.

    Raises SceneError for numbers that no scene can have, PathError for a path without a number, ValueError for a mode
    that does not exist or does not fit.
    """
    scene = checked(scene)
    if tolerance is not None:
        refuse_control(tolerance, most_steps, frames, method)
    how = (duration, dt, frames, method, tuple(sorted(observe)), most_steps)
    if paths is None:
        if mode == "forward":
            raise ValueError("the gradient with respect to every number needs mode='reverse'; or name some paths")
        return _program(measure, how, "whole")(scene, {}, tolerance)
    values = {p: jnp.asarray(numbers_at(scene, p)) for p in listed_paths(paths)}
    count = sum(v.size for v in values.values())
    chosen = gradient_plan(scene, count, duration, dt, frames, mode, tolerance, most_steps).mode
    return _program(measure, how, chosen)(scene, values, tolerance)


def _scalar(found: Any, measure: Measure) -> Array:
    """What a measure gives, if it is one number that can have a derivative."""
    if found is None:
        what = "nothing: is its return missing?"
    elif isinstance(found, (float, np.floating)):
        return jnp.asarray(found)
    elif not isinstance(found, (jax.Array, np.ndarray)):
        what = show(found)
    elif found.shape == () and jnp.issubdtype(found.dtype, jnp.floating):
        return jnp.asarray(found)
    else:
        what = f"{' x '.join(map(str, found.shape)) or 'one'} of {found.dtype}"
    name = getattr(measure, "__name__", "the measure")
    raise TypeError(f"a measure must give one number with a fraction, but {name} gives {what}")


@functools.lru_cache(maxsize=16)
def _program(measure: Measure, how: tuple[Any, ...], mode: str) -> Callable[..., tuple[Array, Any]]:
    """From a scene, values by path and a tolerance to the measure and its derivatives: by the values, or by the whole scene."""
    duration, dt, frames, method, observe, most_steps = how

    def value(scene: Scene, tolerance: Any) -> Array:
        run = simulate(scene, duration, dt, frames, method, observe=observe, tolerance=tolerance, most_steps=most_steps)
        return _scalar(measure(scene, run), measure)

    if mode == "whole":
        return jax.jit(lambda scene, values, tolerance: jax.value_and_grad(value)(scene, tolerance))

    def some(scene: Scene, values: dict[str, Array], tolerance: Any) -> tuple[Array, dict[str, Array]]:
        def at(values: dict[str, Array]) -> tuple[Array, Array]:
            changed = scene
            for path, new in values.items():
                changed = put(changed, path, new)
            found = value(changed, tolerance)
            return found, found

        take = jax.jacfwd if mode == "forward" else jax.jacrev
        gradient, found = take(at, has_aux=True)(values)
        return found, gradient

    return jax.jit(some)
