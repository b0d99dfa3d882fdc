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
from jax import Array

from diffeed.base.smooth import polar, step_down

HAND_OVER = 0.1
"""Half-width, in bar lengths, over which two pieces hand a contact over to each other at a bar's middle."""
BEYOND = 0.1
"""How far past its ends, in bar lengths, a piece is followed for that."""
CONFORMING = 0.5
"""Least rate, as a share of a straight bar's, at which the foot of a circle's centre is taken to settle along the curve. Where a
sheet is wrapped around a roller every point is about equally near and the foot undetermined."""
STEPS = 3
"""Steps of Newton's method for the foot, from the middle of a piece: exact on a straight one after the first."""


class Pieces(NamedTuple):
    """Pieces of the skin as quadratic curves, (1, features) or (pairs,); positions in mm."""

    x: Array  # of u = 0
    y: Array
    first_x: Array  # from there to the middle control point
    first_y: Array
    second_x: Array  # and from that to u = 1
    second_y: Array
    lead: Array  # bool
    tail: Array


class Touched(NamedTuple):
    """Share and place of a pair's point on the bar in front and on the bar behind."""

    share: Array  # 0..1
    arm: Array  # mm from the bar's centre along its axis


class PieceNear(NamedTuple):
    """Closest approach of circles to pieces, (circles, features) or (pairs,)."""

    gap: Array  # mm, to the curve
    nx: Array
    ny: Array
    weight: Array  # 0..1: share of the contact that this piece carries
    u: Array
    run: Array  # mm that the foot runs per radian of turning, over the distance to the centre; 0 at a round end


def piece_circle(piece: Pieces, cx: Array, cy: Array, radius: Array) -> PieceNear:
    """Circles, (circles, 1) or (pairs,), against pieces.

    The foot of the centre C is where (c(u) - C).c'(u), a cubic in u, goes from negative to positive. A piece carries a contact
    where the foot lies behind the middle of its first bar and before that of its second, counted on these bars, each from 0 to
    1 over the hand-over: so along a chain the weights add up to one. Where a sheet lies around a roller many pieces
    carry a part each.
    """
    rx, ry = piece.x - cx, piece.y - cy
    ax, ay, bx, by = piece.first_x, piece.first_y, piece.second_x, piece.second_y
    kx, ky = bx - ax, by - ay
    size = ax * ax + ay * ay
    at_start = rx * ax + ry * ay
    at_end = (rx + ax + bx) * bx + (ry + ay + by) * by
    linear, square, cube = 2.0 * size + rx * kx + ry * ky, 3.0 * (ax * kx + ay * ky), kx * kx + ky * ky
    # The ends of a sheet are round: whatever lies beyond them is theirs.
    bars = jnp.where(piece.lead | piece.tail, 2.0, 1.0)  # pieces in a bar: at the ends they are half as long
    bar = 2.0 * HAND_OVER * bars * size
    begun = jnp.where(piece.lead, 1.0, step_down(at_start / bar, 1.0))
    ended = jnp.where(piece.tail, 0.0, step_down(at_end / bar, 1.0))
    weight = begun * (1.0 - ended)
    beyond = jnp.where(weight > 0, BEYOND * bars, 0.0)
    first, last = jnp.where(piece.lead, 0.0, -beyond), jnp.where(piece.tail, 1.0, 1.0 + beyond)
    u, slope = jnp.full_like(size, 0.5), size
    for _ in range(STEPS):
        value = at_start + u * (linear + u * (square + u * cube))
        slope = jnp.maximum(linear + u * (2.0 * square + u * 3.0 * cube), 2.0 * CONFORMING * size)
        u = jnp.clip(u - value / slope, first, last)
    distance, nx, ny = polar(rx + u * (2.0 * ax + u * kx), ry + u * (2.0 * ay + u * ky))
    round_end = (piece.lead & (at_start > 0)) | (piece.tail & (at_end < 0))
    run = jnp.where(round_end, 0.0, 2.0 * size / slope)
    return PieceNear(distance - radius, nx, ny, weight, u, run)


def hull_circle(piece: Pieces, cx: Array, cy: Array, radius: Array) -> tuple[Array, Array, Array]:
    """Gap and normal from circles to the triangles of the control points, in which the pieces lie as far as they are followed:
    never further than these.

    Newton's method finds the foot of a circle that is near; of one further away it may find a point that is not the nearest.
    """
    beyond = 2.2 * BEYOND * jnp.where(piece.lead | piece.tail, 2.0, 1.0)  # of a tangent: a tenth more for the bend
    out, on = jnp.where(piece.lead, 0.0, beyond), jnp.where(piece.tail, 0.0, beyond)
    bx, by = piece.x + piece.first_x - cx, piece.y + piece.first_y - cy
    ax, ay = bx - (1.0 + out) * piece.first_x, by - (1.0 + out) * piece.first_y
    x, y = bx + (1.0 + on) * piece.second_x, by + (1.0 + on) * piece.second_y
    near = _segment(ax, ay, bx, by)
    for other in (_segment(bx, by, x, y), _segment(ax, ay, x, y)):
        near = [jnp.where(other[0] < near[0], a, b) for a, b in zip(other, near, strict=True)]
    distance, nx, ny = near
    return distance - radius, nx, ny


def _segment(ax: Array, ay: Array, bx: Array, by: Array) -> list[Array]:
    """Distance and direction from the origin to the nearest point between a and b."""
    dx, dy = bx - ax, by - ay
    size = dx * dx + dy * dy
    share = jnp.clip(-(ax * dx + ay * dy) / jnp.where(size > 0, size, 1.0), 0.0, 1.0)
    return list(polar(ax + share * dx, ay + share * dy))


def touched(u: Array, half_front: Array, half_behind: Array, lead: Array, tail: Array) -> tuple[Touched, Touched]:
    """How c(u) hangs on the bar in front and on the bar behind. Lead and tail have only one of them."""
    share = jnp.where(lead, 1.0, jnp.where(tail, 0.0, u))
    return Touched(1.0 - share, -u * half_front), Touched(share, (1.0 - u) * half_behind)
