"""Prescribed movements of guides, rollers and clamps."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.packing import stacked
from diffeed.input.parts import Motion
from diffeed.model.arrays import Movements, Path
from diffeed.model.rows import padded


def path_of(motion: Motion) -> Path:
    """A movement in mm and rad."""
    return _path(motion.times, motion.displacement, motion.rotation, motion.pivot)


def movements_of(circles: list[Any], guides: list[Any]) -> Movements:
    """Those of all parts that move, in one table."""
    families = {"circles": circles, "guides": guides}
    moving: dict[tuple[str, int], Motion] = {
        (family, k): part.motion
        for family, parts in families.items()
        for k, (_, part) in enumerate(parts)
        if getattr(part, "motion", None) is not None
    }
    points = max((motion.times.shape[0] for motion in moving.values()), default=1)

    def table(field: str, shape: tuple[int, ...]) -> Array:
        return stacked([padded(getattr(motion, field), points) for motion in moving.values()], shape)

    pivot = stacked([motion.pivot for motion in moving.values()], (2,))
    profiles = table("times", (points,)), table("displacement", (points, 2)), table("rotation", (points,))
    return Movements(path=_path(*profiles, pivot), parts=tuple(moving))


def move_alike(movements: Movements, parts: list[tuple[str, int]]) -> Array:
    """(parts, parts) bool: whether two stay together, at rest or by the same movement, number for number."""
    which = movements.of(parts)
    still = which < 0
    if np.all(still):
        return jnp.ones((len(parts), len(parts)), bool)
    # All of them at once: pair by pair, twelve swinging guides compiled for a minute.
    rows = jnp.concatenate([v.reshape(len(v), -1) for v in jax.tree.leaves(movements)], axis=1)[np.maximum(which, 0)]
    same = jnp.all(rows[:, None] == rows[None, :], axis=2)
    return jnp.where(still[:, None] | still[None, :], still[:, None] & still[None, :], same)


def _path(times: Array, displacement: Array, rotation: Array, pivot: Array) -> Path:
    return Path(
        times=times,
        x=displacement[..., 0],
        y=displacement[..., 1],
        angle=jnp.deg2rad(rotation),
        pivot_x=pivot[..., 0],
        pivot_y=pivot[..., 1],
    )
