"""Bars where a sheet must never be: across a guide, or behind its face past an end of it.

A guide feels points of a sheet, so a bar can straddle it unfelt. And it feels whatever stands behind its face less than its
depth as pressed in: what comes there past the guide's end, where nothing stops it, is thrown out with energy from nowhere.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.smooth import polar
from diffeed.base.sweeps import totals
from diffeed.chain.kinematics import Pose, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import Bodies, bodies
from diffeed.contact.kept import DEEP_IN_GUIDES
from diffeed.model.arrays import Model
from diffeed.pair.shapes import Face, past_ends_of_arc

CLEARLY = 0.2
"""mm below the centre of a guide's rounded end, from where on that end holds a sheet off on the wrong side."""


class _Seen(NamedTuple):
    """Nodes as a family of guides sees them, (guides, nodes), and where between neighbours a bar meets the face's line."""

    height: Array  # mm above the face
    beyond: tuple[Array, Array]  # mm past the first end and past the second
    meets: tuple[Array, Array]  # the same of the point where a bar meets the face, (guides, nodes - 1)
    across: Array  # bool: it does, and one end is deep behind


class Misplaced(NamedTuple):
    """Bool, of guides (lines + arcs,) or of all together."""

    across: Array  # a bar has its ends on both sides, one of them deep behind
    behind: Array  # a bar reaches past a free end behind the face, less than its depth


def misplaced(model: Model, state: State) -> Misplaced:
    """Which guides, at a state."""
    found = _by_bars(model, pose(model, state), bodies(model, state, state.time, state.time))
    if not found:
        return Misplaced(*[jnp.zeros((0,), bool)] * 2)
    return Misplaced(*(jnp.any(jnp.concatenate(each), axis=1) for each in zip(*found, strict=True)))


def any_misplaced(model: Model, at: Pose, world: Bodies) -> Misplaced:
    """Whether at any guide."""
    found = [totals(*each) for each in _by_bars(model, at, world)]
    return Misplaced(*(functools.reduce(jnp.logical_or, each) for each in zip(*found, (False, False), strict=True)))


def _by_bars(model: Model, at: Pose, world: Bodies) -> list[Misplaced]:
    """Of each family (guides, nodes - 1). The sides of a bar's ends alone would also show an end that is pressed in; beyond a
    guide's own ends a sheet may cross freely."""
    bar = ~model.layout.tail[None, :-1]
    return [
        # 0 everywhere on a full turn
        Misplaced(seen.across & (seen.meets[0] <= 0) & (seen.meets[1] <= 0) & bar, _behind(seen, face) & bar)
        for seen, face in _families(model, at, world)
    ]


def _behind(seen: _Seen, face: Face) -> Array:
    height, back = seen.height, -(face.tip_radius + CLEARLY)
    behind = jnp.zeros((height.shape[0], height.shape[1] - 1), bool)
    for past, joined in zip(seen.beyond, face.joined, strict=True):
        a, b = past[:, :-1], past[:, 1:]
        reaches = (a * b < 0) & (joined[:, None] == 0)
        share = a / jnp.where(reaches, a - b, 1.0)
        there = height[:, :-1] + share * (height[:, 1:] - height[:, :-1])
        behind |= reaches & (there < back[:, None]) & (there > -face.depth[:, None])
    return behind


def _families(model: Model, at: Pose, world: Bodies) -> list[tuple[_Seen, Face]]:
    if not (model.lines.names or model.arcs.names):
        return []
    x, y = nodes(model, at)
    found = [(_by_lines(world, x, y), world.lines.faces)] if model.lines.names else []
    return found + ([(_by_arcs(world, x, y), world.arcs.faces)] if model.arcs.names else [])


def _by_lines(world: Bodies, x: Array, y: Array) -> _Seen:
    lines = world.lines
    dx, dy = x[None, :] - lines.x[:, None], y[None, :] - lines.y[:, None]
    tx, ty, length = lines.tx[:, None], lines.ty[:, None], lines.length[:, None]
    height, along = dy * tx - dx * ty, dx * tx + dy * ty
    across, fall = _across(height, lines.faces.depth[:, None]), height[:, :-1] - height[:, 1:]
    share = height[:, :-1] / jnp.where(across, fall, 1.0)
    meets = along[:, :-1] + share * (along[:, 1:] - along[:, :-1])
    return _Seen(height, (-along, along - length), (-meets, meets - length), across)


def _by_arcs(world: Bodies, x: Array, y: Array) -> _Seen:
    arcs, radius = world.arcs, world.arcs.radius[:, None]
    dx, dy = x[None, :] - arcs.x[:, None], y[None, :] - arcs.y[:, None]
    distance, ux, uy = polar(dx, dy)
    height = arcs.side[:, None] * (radius - distance)
    across = _across(height, arcs.faces.depth[:, None])
    share = _meets_circle(dx, dy, radius)
    px, py = (v[:, :-1] + share * (v[:, 1:] - v[:, :-1]) for v in (dx, dy))
    mid, quarter = (
        tuple(v[:, None] for v in pair) for pair in ((arcs.mid_x, arcs.mid_y), (arcs.cos_quarter, arcs.sin_quarter))
    )
    meets = past_ends_of_arc(*polar(px, py)[1:], radius, mid, quarter)
    return _Seen(height, past_ends_of_arc(ux, uy, radius, mid, quarter), meets, across)


def _across(height: Array, depth: Array) -> Array:
    """(guides, nodes) heights above faces -> whether the face lies between neighbours and one of them is deep behind it."""
    a, b = height[:, :-1], height[:, 1:]
    return (a * b < 0) & (jnp.minimum(a, b) < -DEEP_IN_GUIDES * depth)


def _meets_circle(x: Array, y: Array, radius: Array) -> Array:
    """(guides, nodes) about circles' centres -> where between neighbours on both sides of a circle they meet it, 0 to 1.

    The root of a quadratic: heights do not change evenly along a bar, and a long one that enters an arc meets its circle well
    before the arc begins.
    """
    x0, y0 = x[:, :-1], y[:, :-1]
    dx, dy = x[:, 1:] - x0, y[:, 1:] - y0
    a, b, c = dx * dx + dy * dy, x0 * dx + y0 * dy, x0 * x0 + y0 * y0 - radius**2
    root = jnp.sqrt(jnp.maximum(b * b - a * c, 0.0))
    return jnp.clip((jnp.where(c < 0, root, -root) - b) / jnp.where(a > 0, a, 1.0), 0.0, 1.0)
