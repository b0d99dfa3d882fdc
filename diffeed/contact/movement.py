"""Prescribed movements of parts at one time, and what they do to points."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.angles import cos_sin
from diffeed.contact.profile import interpolate
from diffeed.model.arrays import Path


class Shift(NamedTuple):
    """Rigid movements at one time; of one part, (), or of several, (moved,)."""

    dx: Array
    dy: Array
    angle: Array
    vx: Array
    vy: Array
    w: Array
    pivot_x: Array
    pivot_y: Array


def shift_at(path: Path, time: Array) -> Shift:
    """Displacement and turn of prescribed movements, and their rates."""
    (dx, vx), (dy, vy), (a, w) = (interpolate(path.times, v, time) for v in (path.x, path.y, path.angle))
    return Shift(dx, dy, a, vx, vy, w, path.pivot_x, path.pivot_y)


class Carried(NamedTuple):
    """Which bodies of a family are moved, and how each is."""

    mask: np.ndarray  # (bodies,) bool
    shift: Shift  # (bodies,); of no meaning where nothing moves
    c: Array  # of its angle
    s: Array


def carried(shift: Shift, which: np.ndarray) -> Carried:
    """Movements (moved,), and which of them each body has, -1: none. All at once: one after the other, twelve swinging guides
    compiled for a minute."""
    rows = [*shift, *cos_sin(shift.angle)]
    if len(shift.dx) > 1:  # the only one is handed to all as it is
        rows = list(jnp.stack(rows)[:, np.maximum(which, 0)])
    return Carried(which >= 0, Shift(*rows[:-2]), *rows[-2:])


def moved(by: Carried, x: Array, y: Array) -> tuple[Array, Array]:
    """Places of points of the bodies, (bodies,)."""
    shift = by.shift
    rx, ry = x - shift.pivot_x, y - shift.pivot_y
    place = shift.pivot_x + shift.dx + by.c * rx - by.s * ry, shift.pivot_y + shift.dy + by.s * rx + by.c * ry
    return _chosen(by, place, (x, y))


def turned(by: Carried, x: Array, y: Array) -> tuple[Array, Array]:
    """Directions of the bodies, (bodies,)."""
    return _chosen(by, (by.c * x - by.s * y, by.s * x + by.c * y), (x, y))


def velocity(by: Carried, x: Array, y: Array, still: tuple[Array, Array]) -> tuple[Array, Array]:
    """Velocities of the moved points (x, y), and of those of bodies that are not moved."""
    shift = by.shift
    rx, ry = x - shift.pivot_x - shift.dx, y - shift.pivot_y - shift.dy
    return _chosen(by, (shift.vx - shift.w * ry, shift.vy + shift.w * rx), still)


# All entries are moved and a mask keeps the others: writing single entries would chain copies, which the compiler unrolls.
def _chosen(by: Carried, new: tuple[Array, Array], old: tuple[Array, Array]) -> tuple[Array, Array]:
    return jnp.where(by.mask, new[0], old[0]), jnp.where(by.mask, new[1], old[1])
