"""What gradients cost beside the run that they are of: tracing, compilation, time, memory."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.bench.timing import Timed, in_turns, once
from diffeed.gradients.modes import GradientPlan, gradient_plan, value_and_gradient
from diffeed.input.parts import Scene, normalise
from diffeed.readings.trajectory import Trajectory
from diffeed.run.rollout import simulate

RUN, FORWARD, REVERSE = "run", "by one number, forward", "by every number, reverse"
FRAMES = 2

Show = Callable[[int, int, str], None]


def gradient(
    scene: Scene,
    duration: float | None = None,
    dt: float = 1e-4,
    fewest: int = 3,
    show: Show = lambda done, total, text: None,
) -> list[dict[str, Any]]:
    """One row for the run, for the derivative of where a lead edge ends by a sheet's modulus, and by every number of the scene.

    A scene that says so is settled first, in the run and in the gradients. `runs` is the time in runs of the first row.
    """
    scene = normalise(scene)
    name = next(iter(scene.sheets))
    every = sum(int(np.size(v)) for v in jax.tree.leaves(scene))

    def lead(scene: Scene, run: Trajectory) -> Array:
        """NaN in a run that fails."""
        return jnp.where(run.ok, jnp.sum(run.sheets[name].nodes[-1, 0]), jnp.nan)

    def slopes(paths: tuple[str, ...] | None, mode: str) -> Callable[[Scene], Any]:
        return lambda scene: value_and_gradient(lead, scene, paths, mode, duration, dt, FRAMES)

    programs = {
        RUN: (lambda scene: (lead(scene, simulate(scene, duration, dt, FRAMES)), None), None),
        FORWARD: (
            slopes((f"sheets.{name}.youngs_modulus",), "forward"),
            gradient_plan(scene, 1, duration, dt, FRAMES, "forward"),
        ),
        REVERSE: (slopes(None, "reverse"), gradient_plan(scene, every, duration, dt, FRAMES, "reverse")),
    }
    made = []
    for what, (program, _) in programs.items():
        show(len(made), len(programs), what)
        made.append(once(program, scene))
    made = in_turns(made, fewest)
    return [
        _row(what, each, planned, made[0].run)
        for (what, (_, planned)), each in zip(programs.items(), made, strict=True)
    ]


def _row(what: str, made: Timed, planned: GradientPlan | None, one_run: float) -> dict[str, Any]:
    value, slopes = made.value
    reason = None
    if not np.isfinite(value):
        reason = "the run fails: diffeed run tells where and why"
    elif not all(np.all(np.isfinite(v)) for v in jax.tree.leaves(slopes)):
        reason = "not finite: diffeed.explain_gradient names the first step, pair and term"
    return {
        "what": what,
        "numbers": planned.numbers if planned else 0,
        "trace_seconds": made.trace,
        "compile_seconds": made.compile - made.trace,
        "run_seconds": made.run,
        "runs": made.run / one_run,
        "temporary_mb": None if made.temporary is None else made.temporary / 1e6,
        "planned_mb": planned.memory / 1e6 if planned else None,
        "reason": reason,
    }
