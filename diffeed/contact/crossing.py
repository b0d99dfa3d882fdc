"""Bars where a sheet must never be: across a guide, or behind its face past an end of it.

A guide feels points of a sheet, so a bar can straddle it unfelt. And it feels whatever stands behind its face less than its
depth as pressed in: what comes there past the guide's end, where nothing stops it, is thrown out with energy from nowhere.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.sweeps import totals
from diffeed.chain.kinematics import Pose, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import Bodies, bodies
from diffeed.contact.kept import DEEP_IN_GUIDES, kept_guides
from diffeed.model.arrays import Guides, Model
from diffeed.pair.shapes import Face, point_face, where_met

CLEARLY = 0.2
"""mm below the centre of a guide's rounded end, from where on that end holds a sheet off on the wrong side."""


class _Seen(NamedTuple):
    """Nodes as guides see them, (guides, nodes), and where between neighbours a bar meets the face's line or circle."""

    height: Array  # mm above the face
    beyond: tuple[Array, Array]  # mm past the first end and past the second
    meets: tuple[Array, Array]  # the same of the point where a bar meets the face, (guides, nodes - 1)
    across: Array  # bool: it does, and one end is deep behind


class Misplaced(NamedTuple):
    """Bool, of guides (guides,) or of all together."""

    across: Array  # a bar has its ends on both sides, one of them deep behind
    behind: Array  # a bar reaches past a free end behind the face, less than its depth


def misplaced(model: Model, state: State) -> Misplaced:
    """Which guides, at a state."""
    found = _by_bars(model, pose(model, state), bodies(model, state, state.time, state.time))
    return Misplaced(*[jnp.zeros((0,), bool)] * 2) if found is None else Misplaced(*(jnp.any(v, axis=1) for v in found))


def any_misplaced(model: Model, at: Pose, world: Bodies) -> Misplaced:
    """Whether at any guide."""
    found = _by_bars(model, at, world)
    return Misplaced(*[jnp.zeros((), bool)] * 2) if found is None else Misplaced(*totals(*found))


def _by_bars(model: Model, at: Pose, world: Bodies) -> Misplaced | None:
    """(guides, nodes - 1); None: there are no guides. The sides of a bar's ends alone would also show an end that is pressed in;
    beyond a guide's own ends a sheet may cross freely."""
    if not model.guides.names:
        return None
    seen, bar = _seen(world.guides, *nodes(model, at)), ~model.layout.tail[None, :-1]
    across = seen.across & (seen.meets[0] <= 0) & (seen.meets[1] <= 0)  # 0 everywhere on a full turn
    return Misplaced(across & bar, _behind(seen, world.guides.faces) & bar)


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


def _seen(guides: Guides, x: Array, y: Array) -> _Seen:
    rows = kept_guides(guides, None)
    faced = point_face(x[None, :], y[None, :], *rows.shape)
    a, b = faced.gap[:, :-1], faced.gap[:, 1:]
    across = (a * b < 0) & (jnp.minimum(a, b) < -DEEP_IN_GUIDES * rows.faces.depth)
    share = where_met(x[None, :], y[None, :], *rows.shape)
    px, py = (v[None, :-1] + share * jnp.diff(v)[None] for v in (x, y))
    return _Seen(faced.gap, faced.beyond, point_face(px, py, *rows.shape).beyond, across)
