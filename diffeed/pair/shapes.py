"""Geometry of one point or one bar against one circle or guide: gap, normal, place. Nothing about forces.

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
    """How the bearing face of guides ends, posed: arrays (guides, 1)."""

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


class Bend(NamedTuple):
    """What makes arcs of faces; arrays like the guides. A line has 0 and 1."""

    curvature: Array  # 1/mm, > 0 where the face is hollow
    cos_quarter: Array  # of a quarter of the sweep; 0 for a full turn, which has no ends


def point_face(
    px: Array, py: Array, x: Array, y: Array, tx: Array, ty: Array, reach: Array, bend: Bend | None
) -> Faced:
    """A point against faces with the middle (x, y) and there the tangent (tx, ty), that bear on its left; `reach` mm from the
    middle to an end.

    With u along the tangent and v across it, the point is (2 v - k (u^2 + v^2))/(1 + rho) above a face of curvature k, where
    rho = sqrt((k u)^2 + (1 - k v)^2): R minus its distance from the centre of an arc, and v of a line. In the same way
    2 u/(1 - k v + rho) is u of a line, and of an arc 2 R tan(angle/2): monotone over the full turn, by a factor that is made
    up for exact to first order at the ends, and free of atan2.
    """
    u, v = _along_and_across(px - x, py - y, tx, ty)
    if bend is None:
        return Faced(v, -ty + 0.0 * u, tx + 0.0 * u, (-u - reach, u - reach))
    k, c = bend.curvature, bend.cos_quarter
    straight = 1.0 - k * v
    rho, along, across = polar(-k * u, straight)
    height = (2.0 * v - k * (u * u + v * v)) / (1.0 + rho)
    past = c * divide(2.0 * u, straight + rho)
    return Faced(height, along * tx - across * ty, along * ty + across * tx, (c * (-past - reach), c * (past - reach)))


def where_met(px: Array, py: Array, x: Array, y: Array, tx: Array, ty: Array, reach: Array, bend: Bend | None) -> Array:
    """Where between neighbouring points on both sides of a face, (guides, points), they meet its line or circle, 0 to 1; (guides,
    points - 1). No derivatives.

    The root of a quadratic: heights do not change evenly along a bar, and a long one that enters an arc meets its circle well
    before the arc begins.
    """
    u, v = _along_and_across(px - x, py - y, tx, ty)
    k = 0.0 if bend is None else bend.curvature
    above = 2.0 * v - k * (u * u + v * v)  # of the sign of the height
    start, square = above[:, :-1], -k * (jnp.diff(u) ** 2 + jnp.diff(v) ** 2)
    slope = jnp.sign(start) * (jnp.diff(above) - square)
    root = jnp.sqrt(jnp.maximum(slope * slope - 4.0 * square * start, 0.0))
    return jnp.clip(divide(2.0 * jnp.abs(start), root - slope), 0.0, 1.0)


def _along_and_across(dx: Array, dy: Array, tx: Array, ty: Array) -> tuple[Array, Array]:
    """Components along a tangent and to its left."""
    return dx * tx + dy * ty, dy * tx - dx * ty


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
