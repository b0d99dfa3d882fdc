"""Geometry of the smooth skin: the uniform quadratic B-spline whose control polygon is the chain of nodes.

It touches every bar at its middle, along the bar, and has no corner. Piece i belongs to node i: with u from 0 to 1 it
runs from the middle of the bar in front to the middle of the bar behind,

    c(u) = (1 - u) A(u) + u B(u),

where A(u) is a point of the bar in front, u half lengths behind its middle, and B(u) a point of the bar behind, 1 - u half
lengths before its middle (de Casteljau). So a force at c(u) is exactly 1 - u of it at A on one bar and u of it at B on the other,
and the tangent is along B - A. Lead and tail are straight halves of their only bar.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.smooth import cubic_root, polar

HAND_OVER = 1e-6
"""mm: half-width over which two pieces hand a contact over at a bar's middle. Wider than round-off, which could otherwise
count a contact twice or not at all; the curve is the same on both sides."""


class Pieces(NamedTuple):
    """Pieces of the skin as quadratic curves, (1, features); positions in mm."""

    x: Array  # of u = 0
    y: Array
    first_x: Array  # from there to the middle control point
    first_y: Array
    second_x: Array  # and from that to u = 1
    second_y: Array
    lead: np.ndarray  # bool
    tail: np.ndarray


class Touched(NamedTuple):
    """Share and place of a pair's point on the bar in front and on the bar behind."""

    share: Array  # 0..1
    arm: Array  # mm from the bar's centre along its axis


class PieceNear(NamedTuple):
    """Closest approach of circles to pieces, (circles, features)."""

    gap: Array
    nx: Array
    ny: Array
    weight: Array  # 1 where the closest point lies on the piece itself
    u: Array
    rolls: Array  # bool: the curve lies on the circle, not its rounded end


def piece_circle(piece: Pieces, cx: Array, cy: Array, radius: Array) -> PieceNear:
    """Circles, (circles, 1) or (slots, features), against pieces.

    The closest point is where (c(u) - C).c'(u), a cubic in u, goes from negative to positive. A pair counts only where it does so
    on the piece: seen from the bars' middles, where the signs of two pieces are one, so that a chain hands a contact on
    without a gap and counts it once.
    """
    rx, ry = piece.x - cx, piece.y - cy
    ax, ay, bx, by = piece.first_x, piece.first_y, piece.second_x, piece.second_y
    kx, ky = bx - ax, by - ay
    at_start = rx * ax + ry * ay
    at_end = (rx + ax + bx) * bx + (ry + ay + by) * by
    linear, square, cube = 2.0 * (ax * ax + ay * ay) + rx * kx + ry * ky, 3.0 * (ax * kx + ay * ky), kx * kx + ky * ky
    u = cubic_root(at_start, linear, square, cube)
    distance, nx, ny = polar(rx + u * (2.0 * ax + u * kx), ry + u * (2.0 * ay + u * ky))
    # The ends of a sheet are round: whatever lies beyond them is theirs.
    begun = jnp.where(piece.lead, 1.0, _passed(at_start, ax, ay))
    ended = jnp.where(piece.tail, 0.0, _passed(at_end, bx, by))
    round_end = (piece.lead & (at_start > 0)) | (piece.tail & (at_end < 0))
    weight = lax.stop_gradient(begun * (1.0 - ended))
    return PieceNear(distance - radius, nx, ny, weight, u, jnp.logical_not(round_end))


def _passed(product: Array, x: Array, y: Array) -> Array:
    """0..1: whether the foot of a circle's centre lies behind a bar's middle; (x, y) points backwards along the bar."""
    behind = -product / jnp.sqrt(x * x + y * y)
    return jnp.clip(0.5 + behind * (0.5 / HAND_OVER), 0.0, 1.0)


def touched(
    u: Array, half_front: Array, half_behind: Array, lead: np.ndarray, tail: np.ndarray
) -> tuple[Touched, Touched]:
    """How c(u) hangs on the bar in front and on the bar behind. Lead and tail have only one of them."""
    share = jnp.where(lead, 1.0, jnp.where(tail, 0.0, u))
    return Touched(1.0 - share, -u * half_front), Touched(share, (1.0 - u) * half_behind)
