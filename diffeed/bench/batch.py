"""How fast batches step, on whatever device JAX has."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from diffeed.abreast import for_many
from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.records import replace
from diffeed.bench.timing import precision, timed
from diffeed.input.parts import Scene, SinglePrecision, normalise
from diffeed.run.examine import prepare
from diffeed.run.rollout import simulate

SIZES = (1, 4, 16, 64, 256, 1024, 4096)
ON_ACCELERATORS = (16384, 65536)
"""Beyond those: what it takes to keep an accelerator busy."""
QUICK_SIZES = (1, 4, 16, 64)
STEPS, IN_ALL, ABREAST = 200, 2000, 640_000
"""Steps of every run at least, and of all together, where a run is one kernel too: so many that starting them (0.7 ms for twenty
parts) hardly counts. But no run is longer than its scene."""
SPREAD = 0.01
"""Share by which the samples' moduli differ: they are not one sample many times."""

Show = Callable[[int, int, str], None]


def batch(
    scene: Scene,
    sizes: Sequence[int] = (),
    precisions: Sequence[str] = ("float64", "float32"),
    dt: float = 1e-4,
    steps: int | None = None,
    fewest: int = 3,
    show: Show = lambda done, total, text: None,
) -> list[dict[str, Any]]:
    """One row per precision and size: compile and run time, steps of all samples per second, time per sample and step. `steps`
    of each run are as many as the size of the batch needs, at most those of the scene's duration, unless given, `sizes` those
    that tell something on the device."""
    rows, in_all = [], ABREAST if loops_are_cheap() else IN_ALL
    longest = round(float(scene.duration) / dt)
    sizes = sizes or (SIZES if jax.default_backend() == "cpu" else SIZES + ON_ACCELERATORS)
    for name in precisions:
        for size in sizes:
            show(len(rows), len(precisions) * len(sizes), f"{size} samples, {name}")
            row = {"precision": name, "samples": size}
            chosen = steps or max(STEPS, min(in_all // size, longest))
            try:
                with precision(name), warnings.catch_warnings():
                    warnings.simplefilter("ignore", SinglePrecision)
                    row |= _measure(normalise(scene), size, dt, chosen, fewest)
            except Exception as error:  # a batch that does not fit into memory is an answer too
                row["reason"] = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
            rows.append(row)
    return rows


def _measure(scene: Scene, size: int, dt: float, steps: int, fewest: int) -> dict[str, Any]:
    state = prepare(scene).state

    def program(scenes: Scene, state: Any) -> Any:
        def one(scene: Scene) -> Any:
            done = simulate(scene, duration=dt * steps, dt=dt, frames=2, initial=state)
            return done.ok, done.final.state

        return for_many(one)(scenes)

    made = timed(program, samples(scene, size), state, fewest=fewest)
    return {
        "compile_seconds": made.compile,
        "run_seconds": made.run,
        "steps": steps,
        "steps_per_second": size * steps / made.run,
        "us_per_sample_step": 1e6 * made.run / (size * steps),
        "failed": int(size - jnp.sum(made.value[0])),
    }


def samples(scene: Scene, size: int) -> Scene:
    """A batch of scenes that differ a little in their sheets' moduli."""
    many = jax.tree.map(lambda v: jnp.broadcast_to(v, (size, *v.shape)), normalise(scene))
    factor = 1.0 + SPREAD * jnp.linspace(-1.0, 1.0, size, dtype=many.gravity.dtype)
    sheets = {name: replace(s, youngs_modulus=s.youngs_modulus * factor) for name, s in many.sheets.items()}
    return replace(many, sheets=sheets)
