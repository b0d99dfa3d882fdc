"""Derivatives of the shared run: one forward and one reverse program per structure and method serve all tests."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cases.scenes import DT, DURATION, FRAMES
from cases.transforms import Outputs, map_numbers, outputs
from diffeed.input.parts import Scene
from diffeed.run.rollout import _simulate, plan


def shown(scene: Scene, dt: Any, method: str) -> Outputs:
    """All that a run shows. `simulate` takes dt as a plain float; a change of the unit of time needs it traced."""
    return outputs(_simulate(scene, dt, None, plan(DURATION, DT, FRAMES), method, ()))


@functools.partial(jax.jit, static_argnames="method")
def forward(scene: Scene, scene_change: Scene, dt_change: Any, method: str) -> tuple[Outputs, Outputs]:
    """Outputs and their change for a change of scene and step."""
    dt = jnp.asarray(DT)
    return jax.jvp(lambda s, h: shown(s, h, method), (scene, dt), (scene_change, dt_change))


@functools.partial(jax.jit, static_argnames="method")
def backward(scene: Scene, weights: Outputs, method: str) -> Scene:
    """Gradient of the weighted sum of all outputs."""
    _, pull_back = jax.vjp(lambda s: shown(s, jnp.asarray(DT), method), scene)
    return pull_back(weights)[0]


def change_of(scene: Scene, other: Scene) -> Scene:
    """other - scene, number by number."""
    return jax.tree.map(lambda a, b: jnp.asarray(b) - a, scene, other)


def random_change(scene: Scene, rng: np.random.Generator, relative: float) -> Scene:
    """A random direction in which every number changes by about `relative` of itself, entries of vectors by as many mm
    (or of what they are in)."""

    def change(owner: Any, name: str, value: Any) -> Any:
        size = np.abs(value) if np.ndim(value) == 0 else 1.0
        return relative * size * rng.uniform(-1.0, 1.0, np.shape(value))

    return map_numbers(scene, change)


def inner(a: Any, b: Any) -> float:
    """Sum of products over two equal trees."""
    return float(
        sum(np.sum(np.asarray(x) * np.asarray(y)) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))
    )
