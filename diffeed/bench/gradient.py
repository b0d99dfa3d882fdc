"""What gradients cost beside the run that they are of: tracing, compilation, time, memory."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.bench.timing import timed
from diffeed.gradients import gradient_plan
from diffeed.parts import Scene, normalise
from diffeed.paths import get, put
from diffeed.rollout import simulate

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
    path = f"sheets.{name}.youngs_modulus"

    def lead(scene: Scene) -> tuple[Array, Array]:
        run = simulate(scene, duration, dt, FRAMES)
        return jnp.sum(run.sheets[name].nodes[-1, 0]), run.ok

    def forward(scene: Scene) -> tuple[Any, Any]:
        modulus = jnp.asarray(get(scene, path))
        value, slope, ok = jax.jvp(
            lambda e: lead(put(scene, path, e)), (modulus,), (jnp.ones_like(modulus),), has_aux=True
        )
        return (value, ok), slope

    programs = {
        RUN: lambda scene: (lead(scene), jnp.zeros(())),
        FORWARD: forward,
        REVERSE: lambda scene: jax.value_and_grad(lead, has_aux=True)(scene),
    }
    numbers = {RUN: 0, FORWARD: 1, REVERSE: sum(int(np.size(v)) for v in jax.tree.leaves(scene))}
    rows = []
    for what, program in programs.items():
        show(len(rows), len(programs), what)
        made = timed(program, scene, fewest=fewest)
        (_, ok), slopes = made.value
        row = {
            "what": what,
            "numbers": numbers[what],
            "trace_seconds": made.trace,
            "compile_seconds": made.compile - made.trace,
            "run_seconds": made.run,
            "runs": made.run / (rows[0]["run_seconds"] if rows else made.run),
            "temporary_mb": None if made.temporary is None else made.temporary / 1e6,
            "planned_mb": None,
            "reason": None,
        }
        if numbers[what]:
            mode = "forward" if what == FORWARD else "reverse"
            row["planned_mb"] = gradient_plan(scene, numbers[what], duration, dt, FRAMES, mode).memory / 1e6
        if not bool(ok):
            row["reason"] = "the run fails: diffeed run tells where and why"
        elif not all(np.all(np.isfinite(v)) for v in jax.tree.leaves(slopes)):
            row["reason"] = "not finite: diffeed.explain_gradient names the first step, pair and term"
        rows.append(row)
    return rows
