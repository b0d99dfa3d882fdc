"""How smoothly a run follows a number of its scene: how far the lead edge scatters about a parabola over a few micrometres.

An impact that the step does not resolve turns a change of nanometres into one of micrometres, and a gradient follows that.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.records import replace
from diffeed.bench.settings import Setting
from diffeed.gradients.trust import fit, lead_edge_from
from diffeed.input.parts import Profile, Scene, normalise
from diffeed.input.paths import get, put
from diffeed.run.rollout import LONGEST, simulate
from diffeed.steppers import DEFAULT

STEPS = (2e-4, 1e-4)
TOLERANCES = (1e-2, 1e-3)
SAMPLES, QUICK_SAMPLES = 32, 12
FRAMES = 11
MOST_STEPS = 8000
RAMP = 0.02
"""s in which shafts that turn steadily come up to speed, in a start that is ramped."""

Show = Callable[[int, int, str], None]


def roughness(
    scene: Scene,
    path: str,
    span: float,
    settings: Sequence[Setting],
    samples: int = SAMPLES,
    show: Show = lambda done, total, text: None,
) -> list[dict[str, Any]]:
    """One row per start (as the scene has it, with shafts that ramp up), way of stepping and frame: `trend` mm per unit of the
    number at `path` and `scatter_um` about it, over `samples` runs within plus-minus `span`."""
    starts: dict[str, Callable[[Scene], Scene]] = {"as given": normalise, "ramped": ramped}
    asked = [(name, start, setting) for name, start in starts.items() for setting in settings]
    rows = []
    for done, (name, start, setting) in enumerate(asked):
        label = {"start": name, "steps": setting.size}
        show(done, len(asked), f"{name}, {setting.short}")
        rows += [label | found for found in _rows(normalise(scene), start, path, span, setting, samples)]
    return rows


def ways(quick: bool) -> list[Setting]:
    """Equal steps and chosen ones."""
    equal = [Setting("step", DEFAULT, dt) for dt in STEPS]
    chosen = [Setting("tolerance", DEFAULT, LONGEST, tolerance=t) for t in TOLERANCES]
    return [equal[0], chosen[0]] if quick else [*equal, *chosen]


def ramped(scene: Scene) -> Scene:
    """The scene with shafts that come up to their speeds in `RAMP`; those with a profile keep it."""
    scene = normalise(scene)

    def slowly(roller: Any) -> Any:
        given = {name: getattr(roller, name) for name in ("angular_speed", "surface_speed")}
        steady = {name: v for name, v in given.items() if v is not None and not isinstance(v, Profile)}
        profiles = {name: Profile(times=[0.0, RAMP], values=jnp.stack([0.0 * v, v])) for name, v in steady.items()}
        return replace(roller, **profiles)

    return normalise(replace(scene, rollers={name: slowly(r) for name, r in scene.rollers.items()}))


def _rows(
    scene: Scene, start: Callable[[Scene], Scene], path: str, span: float, setting: Setting, samples: int
) -> list[dict[str, Any]]:
    offsets = np.linspace(-1.0, 1.0, samples)

    def run(value: Array) -> Any:
        return simulate(start(put(scene, path, value)), frames=FRAMES, most_steps=MOST_STEPS, **setting.options())

    middle = jnp.asarray(get(scene, path))
    nominal = jax.jit(run)(middle)

    def moved(value: Array) -> tuple[Array, Array]:
        found = run(value)
        return lead_edge_from(nominal, found), found.ok

    values, ok = jax.jit(jax.vmap(moved))(middle + span * offsets)
    failed = int(np.sum(~np.asarray(ok)))
    if failed:
        return [{"reason": f"{failed} of {samples} runs failed"}]
    slope, _, scatter = fit(offsets, np.asarray(values)[:, None])
    return [
        {
            "time": float(f"{t:.6g}"),
            "trend_mm_per_unit": float(slope[0, k]) / span,
            "scatter_um": 1e3 * float(scatter[0, k]),
        }
        for k, t in enumerate(np.asarray(nominal.time))
        if k
    ]
