"""Geometry of one point or one bar against one circle, line or arc: gap, normal, place. Nothing about forces.

Everything is elementwise in components and broadcasts: bodies along one axis, bars or nodes along the next.
A normal (nx, ny) points from the body into the sheet, the way in which the sheet is pushed. Gaps count to the bar axis.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.smooth import divide, polar, step_down

EVENLY = {"float64": 1e-6, "float32": 1e-2}
"""mm from a joint within which one bar hands a circle over to the next: far above what rounding makes of where a joint is, for
each bar finds it by itself."""

JOIN_WINDOW = 0.25
"""Half-width (mm) over which two guides with a common end hand a node over to each other."""


class Near(NamedTuple):
    """Closest approach of a body to a point of the sheet's axis."""

    gap: Array  # mm, body surface to bar axis, negative inside
    nx: Array
    ny: Array
    weight: Array  # 0..1: share of the contact that this pair carries


def point_circle(px: Array, py: Array, cx: Array, cy: Array, radius: Array) -> Near:
    """A point against a circle. At the very centre the normal is (0, 1): finite value, zero gradient of the direction."""
    distance, nx, ny = polar(px - cx, py - cy)
    return Near(distance - radius, nx, ny, jnp.ones(()))


class Face(NamedTuple):
    """The straight or round bearing face of guides, posed: arrays (guides, 1)."""

    depth: Array
    tip_radius: Array
    tip_x: tuple[Array, Array]  # centres of the rounded ends: (first, second)
    tip_y: tuple[Array, Array]
    joined: tuple[Array, Array]  # 1 where the end coincides with another guide's end


class Faced(NamedTuple):
    """A point against a bearing face that goes on beyond its ends."""

    gap: Array
    nx: Array
    ny: Array
    beyond: tuple[Array, Array]  # mm that the point lies past the first end and past the second


def point_line(px: Array, py: Array, x: Array, y: Array, tx: Array, ty: Array, length: Array) -> Faced:
    """A point against a line from (x, y) along (tx, ty) that bears on its left."""
    dx, dy = px - x, py - y
    along, height = dx * tx + dy * ty, dy * tx - dx * ty
    return Faced(height, -ty + 0.0 * along, tx + 0.0 * along, (-along, along - length))


def point_arc(
    px: Array,
    py: Array,
    cx: Array,
    cy: Array,
    radius: Array,
    mid: tuple[Array, Array],
    quarter: tuple[Array, Array],
    side: Array,
) -> Faced:
    """A point against an arc. `mid` is the unit vector to its middle, `quarter` (cos, sin) of a quarter of its sweep,
    `side` +1 where the sheet runs inside, -1 outside.

    The end coordinates use tan(angle/2) = cross/(1 + dot): monotone over the full turn, exact to first order at the
    ends, and free of atan2.
    """
    distance, ux, uy = polar(px - cx, py - cy)
    beyond = past_ends_of_arc(ux, uy, radius, mid, quarter)
    return Faced(side * (radius - distance), -side * ux, -side * uy, beyond)


def past_ends_of_arc(
    ux: Array, uy: Array, radius: Array, mid: tuple[Array, Array], quarter: tuple[Array, Array]
) -> tuple[Array, Array]:
    """How far (mm) the direction (ux, uy) from an arc's centre lies past its first end and past its second."""
    half_tangent = divide(mid[0] * uy - mid[1] * ux, 1.0 + mid[0] * ux + mid[1] * uy)
    cos_q, sin_q = quarter
    scale = 2.0 * radius * cos_q
    return scale * (-cos_q * half_tangent - sin_q), scale * (cos_q * half_tangent - sin_q)


def round_ends(px: Array, py: Array, faced: Faced, face: Face) -> Near:
    """Replace the bearing face past a free end by the tip circle, and fade it across a joined end."""
    behind = faced.gap <= -face.depth  # on the far side of a thin guide: untouched, its distance counts from there
    gap, weight = jnp.where(behind, -faced.gap, faced.gap), jnp.where(behind, 0.0, 1.0)
    nx, ny = faced.nx, faced.ny
    # Both ends at once: (2, guides, points).
    joined, beyond = jnp.stack(face.joined) > 0, jnp.stack(faced.beyond)
    past, fading = beyond > jnp.where(joined, JOIN_WINDOW, 0.0), step_down(beyond, JOIN_WINDOW)
    tip = point_circle(px[None], py[None], jnp.stack(face.tip_x), jnp.stack(face.tip_y), face.tip_radius[None])
    for end in (0, 1):
        gap = jnp.where(past[end], tip.gap[end], gap)
        nx, ny = jnp.where(past[end], tip.nx[end], nx), jnp.where(past[end], tip.ny[end], ny)
        weight = jnp.where(joined[end], weight * fading[end], jnp.where(past[end], 1.0, weight))
    return Near(gap, nx, ny, weight)


class BarNear(NamedTuple):
    """Closest approach of a circle to a chain, counted at each bar."""

    gap: Array
    nx: Array
    ny: Array
    weight: Array
    arm: Array  # mm from the bar's centre along its axis to the touched point
    on_face: Array  # bool: the circle stands over the bar's face


class Chain(NamedTuple):
    """Bars with their front end circles, and tails, as chain_circle wants them; (1, features) or (pairs,)."""

    x: Array  # bar centre (a tail has its last bar's values)
    y: Array
    c: Array
    s: Array
    half_length: Array
    ahead: tuple[Array, ...]  # axis (cos, sin) of the bar in front
    behind: tuple[Array, ...]  # and of the bar behind
    first: Array  # bool: the first bar of its sheet
    last: Array  # bool: the last bar
    tail: Array  # bool: the tail


def chain_circle(chain: Chain, cx: Array, cy: Array, radius: Array) -> BarNear:
    """Circles, (circles, 1) or (pairs,), against the features of chains.

    A bar is touched on its face when the circle's foot lies on it. A joint's end circle counts once, with the bar that
    it leads, and only in the wedge that both faces leave open (no hole where the joint bends away). Where a joint bends
    towards the circle both faces see it: each carries the share that its foot lies inside. All shares add up to one, within
    the rounding of a joint's place too: one contact is never counted twice, nor lost.
    """
    dx, dy, c, s, half = cx - chain.x, cy - chain.y, chain.c, chain.s, chain.half_length
    foot = dx * c + dy * s
    front, rear = foot - half, -foot - half  # > 0: past that end of the bar
    # The same for the neighbours, whose nearer ends are this bar's own nodes.
    rear_ahead = -((dx - half * c) * chain.ahead[0] + (dy - half * s) * chain.ahead[1])
    front_behind = (dx + half * c) * chain.behind[0] + (dy + half * s) * chain.behind[1]
    rear_ahead = jnp.where(chain.first, 1.0, rear_ahead)
    front_behind = jnp.where(chain.last, 1.0, front_behind)
    on_face = (front <= 0) & (rear <= 0) & ~chain.tail
    face = _on_face(front, rear_ahead) * _on_face(rear, front_behind)
    node = (1.0 - _inside(front)) * (1.0 - _inside(rear_ahead))
    weight = jnp.where(chain.tail, 1.0 - _inside(rear), face + node)
    arm = jnp.clip(foot, -half, half)
    near = point_circle(chain.x + arm * c, chain.y + arm * s, cx, cy, radius)
    return BarNear(near.gap, near.nx, near.ny, weight, arm, on_face)


def _inside(past: Array) -> Array:
    """1 inside an end of a bar, 0 past it, handed over within `EVENLY`; without a slope right at the end, where a circle that
    stands over a joint at the start shall not make one."""
    u = jnp.clip(past / EVENLY[past.dtype.name], -1.0, 1.0)
    return 0.5 - 0.5 * u * u * u


def _on_face(mine: Array, other: Array) -> Array:
    """Share of a face whose end is passed by `mine`, when the neighbour's is by `other`.

    Where both see the circle that is mine / (mine + other), but even right over the joint.
    """
    sum_, even = mine + other, EVENLY[mine.dtype.name] ** 2
    share = (mine * sum_ + 0.5 * even) / (sum_ * sum_ + even)
    return _inside(mine) * (1.0 - _inside(other) * (1.0 - share))
