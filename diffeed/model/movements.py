"""Prescribed movements of guides, rollers and clamps."""

from typing import Any

import jax.numpy as jnp

from diffeed.input.parts import Motion
from diffeed.model.arrays import Path


def path_of(motion: Motion) -> Path:
    """A movement in mm and rad."""
    return Path(
        times=motion.times,
        x=motion.displacement[:, 0],
        y=motion.displacement[:, 1],
        angle=jnp.deg2rad(motion.rotation),
        pivot_x=motion.pivot[0],
        pivot_y=motion.pivot[1],
    )


def paths_of(rollers: list[Any], circles: list[Any], lines: list[Any], arcs: list[Any]) -> dict[str, Path]:
    """Movements by "family.index"; a circle's index counts rollers first."""
    families = {"circles": rollers + circles, "lines": lines, "arcs": arcs}
    return {
        f"{family}.{k}": path_of(p.motion)
        for family, parts in families.items()
        for k, (_, p) in enumerate(parts)
        if getattr(p, "motion", None) is not None
    }
