"""Bars where a sheet must never be: across a guide, or behind its face past an end of it.

A guide feels points of a sheet, so a bar can straddle it unfelt. And it feels whatever stands behind its face less than its
depth as pressed in: what comes there past the guide's end, where nothing stops it, is thrown out with energy from nowhere.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.batching import any_of_batch
from diffeed.base.sweeps import totals
from diffeed.chain.kinematics import Pose, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import Bodies, bodies
from diffeed.contact.kept import DEEP_IN_GUIDES, kept_guides
from diffeed.model.arrays import Guides, Model
from diffeed.pair.shapes import Face, Faced, point_face, where_met

CLEARLY = 0.2
"""mm below the centre of a guide's rounded end, from where on that end holds a sheet off on the wrong side."""


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
    guides, (x, y) = kept_guides(world.guides, None), nodes(model, at)
    seen, bar = point_face(x[None], y[None], *guides.shape), jnp.asarray(~model.layout.tail[None, :-1])
    return Misplaced(_across(guides, x, y, seen, bar), _behind(seen, world.guides.faces) & bar)


def _across(guides: Guides, x: Array, y: Array, seen: Faced, bar: Array) -> Array:
    """Where one end is deep behind, and the bar meets the face's line or circle between the ends of the face."""
    a, b = seen.gap[:, :-1], seen.gap[:, 1:]
    may = bar & (a * b < 0) & (jnp.minimum(a, b) < -DEEP_IN_GUIDES * guides.faces.depth)
    # A bar that is past an end with both of its own meets it there, if at all.
    for past in seen.beyond:
        may &= ~((past[:, :-1] > 0) & (past[:, 1:] > 0))

    def does() -> Array:
        share = where_met(x[None], y[None], *guides.shape)
        px, py = (v[None, :-1] + share * jnp.diff(v)[None] for v in (x, y))
        first, second = point_face(px, py, *guides.shape).beyond
        return may & (first <= 0) & (second <= 0)  # 0 everywhere on a full turn

    # Hardly ever may any.
    return lax.cond(any_of_batch(jnp.any(may)), does, lambda: may)


def _behind(seen: Faced, face: Face) -> Array:
    height, back = seen.gap, -(face.tip_radius + CLEARLY)
    behind = jnp.zeros((height.shape[0], height.shape[1] - 1), bool)
    for past, joined in zip(seen.beyond, face.joined, strict=True):
        a, b = past[:, :-1], past[:, 1:]
        reaches = (a * b < 0) & (joined[:, None] == 0)
        share = a / jnp.where(reaches, a - b, 1.0)
        there = height[:, :-1] + share * (height[:, 1:] - height[:, :-1])
        behind |= reaches & (there < back[:, None]) & (there > -face.depth[:, None])
    return behind
