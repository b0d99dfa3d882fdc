"""Rollers against rollers."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.places import at_places
from diffeed.contact.bodies import Bodies, Rigid
from diffeed.contact.kept import Kept
from diffeed.model.arrays import Model
from diffeed.pair.law import Surface, Touch, contact_law
from diffeed.pair.shapes import Near, point_circle


class RollerPairs(NamedTuple):
    """Roller against roller, (pairs,) or (movable, partners): the normal pushes the first away from the second."""

    between: tuple[Any, Any]  # index of the first and of the second
    surface: Surface
    touch: Touch
    gap: Array
    nx: Array
    ny: Array
    v_n: Array
    v_t: Array


def roller_gaps(model: Model, world: Bodies, index: tuple[Any, Any]) -> tuple[Rigid, Rigid, Near, Array]:
    """Motions of the two rollers of pairs, where they are nearest, and their gap: of the shape of the index."""
    i, j = index
    radius, count = model.rollers.radius, i.shape[0]
    both = at_places(jnp.stack([v[: model.rollers.n] for v in world.circles]), _joined(i, j))
    a, b = Rigid(*both[:, :count]), Rigid(*both[:, count:])
    near = point_circle(a.x, a.y, b.x, b.y, radius[j])
    return a, b, near, near.gap - radius[i]


def _joined(i: Any, j: Any) -> Any:
    return np.concatenate([i, j]) if isinstance(i, np.ndarray) else jnp.concatenate([i, j])


def roller_contacts(model: Model, world: Bodies, kept: Kept) -> RollerPairs:
    """Rollers against each other: a pinch rests on its drive when no sheet is there. Their friction is regularised."""
    (i, j), radius = kept.pair_index, model.rollers.radius
    a, b, near, gap = roller_gaps(model, world, kept.pair_index)
    dvx, dvy = a.vx - b.vx, a.vy - b.vy
    v_n = near.nx * dvx + near.ny * dvy
    v_t = near.nx * dvy - near.ny * dvx - a.w * radius[i] - b.w * radius[j]
    touch = contact_law(kept.pair_surface, -gap, v_n, v_t, 1.0)
    return RollerPairs(kept.pair_index, kept.pair_surface, touch, gap, near.nx, near.ny, v_n, v_t)
