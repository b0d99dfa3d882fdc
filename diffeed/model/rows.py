"""Parts of one kind in a row, sorted by name."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import Array

from diffeed.input.packing import stacked


def named(parts: dict[str, Any], kind: type) -> list[tuple[str, Any]]:
    """Names and parts of one kind."""
    return [(name, parts[name]) for name in sorted(parts) if isinstance(parts[name], kind)]


def columns(values: Sequence[Any]) -> tuple[Array, Array]:
    """x and y, (n,) each, of points."""
    points = stacked(values, (2,))
    return points[:, 0], points[:, 1]


def padded(values: Array, points: int) -> Array:
    """A profile that repeats its last point, (points, ...): with others in one table."""
    more = points - values.shape[0]
    return values if more == 0 else jnp.concatenate([values, jnp.repeat(values[-1:], more, axis=0)])
