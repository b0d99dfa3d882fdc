"""What of the sheets can touch, laid out along the bars that carry it.

What touches is the scene's `skin`. "bars": a bar and its front end circle are one feature, the tail's end circle is another.
"smooth": the piece of curve at each node is a feature, and hangs on two bars. A sheet has one more feature than bars in
either case.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.places import PLACE, add_at, at_places
from diffeed.chain.kinematics import Pose, from_nodes, pieces_to_bars
from diffeed.model.arrays import Model


class Own(NamedTuple):
    """What a feature has of its bar and of its place in the sheet, whatever moves; (1, features) or (pairs,)."""

    half_length: Array
    half_thickness: Array
    friction_factor: Array
    end: Array  # +1: its point is the bar's front node; -1: the rear node (tails)
    first: Array  # bool: the first feature of its sheet
    last: Array  # bool: the last bar
    tail: Array  # bool: the tail


class Features(NamedTuple):
    """A bar for each feature of the sheets, (1, features) or (pairs,): its own, or one of the two that it hangs on."""

    x: Array
    y: Array
    c: Array
    s: Array
    vx: Array
    vy: Array
    w: Array
    # Axis (cos, sin) of the bar in front; of no meaning at the first, and empty on the smooth skin.
    ahead: tuple[Array, ...]
    behind: tuple[Array, ...]  # and of the bar behind; of no meaning at the last and at tails
    own: Own


class Listed(NamedTuple):
    """Pairs one after the other instead of every body against every feature: which feature each is of, which bars that hangs
    on, and what it has."""

    feature: Array  # (pairs,)
    bars: tuple[Array, ...]  # (pairs,) each: its own, or the one in front of it and the one behind it
    own: tuple[Own, ...]


def own(model: Model) -> tuple[Own, ...]:
    """What every feature has, (1, features): of its bar, or of the one in front of it and of the one behind it."""
    bars, layout = model.bars, model.layout
    end = jnp.asarray(1.0 - 2.0 * layout.tail, bars.half_length.dtype)[None, :]
    place = [jnp.asarray(v)[None, :] for v in (layout.first_feature, layout.last_feature, layout.tail)]
    rows = laid_out(model, jnp.stack([bars.half_length, bars.half_thickness, bars.friction_factor]))
    return tuple(Own._make([*row, end, *place]) for row in rows)


def listed(model: Model, feature: Array) -> Listed:
    """Pairs of the given features."""
    bars = tuple(at_places(jnp.asarray(of_feature, PLACE), feature) for of_feature in _bars_of_features(model))
    return Listed(feature, bars, jax.tree.map(lambda v: v[0, feature], own(model)))


def _bars_of_features(model: Model) -> list[np.ndarray]:
    """(features,) for every bar that a feature hangs on: which one that is."""
    layout = model.layout
    return [layout.bar_of_feature] if model.skin == "bars" else [layout.bar_before_feature, layout.bar_of_feature]


def features(model: Model, at: Pose, pairs: Listed | None = None) -> tuple[Features, ...]:
    """Bars laid out as features, sheet after sheet: each feature's own, or the one in front of it and the one behind it.

    All of them, (1, features), or those of listed pairs, (pairs,).
    """
    rows = laid_out(model, _with_neighbours(at) if model.skin == "bars" else jnp.stack(at), pairs)
    return tuple(
        Features._make([*row[:7], tuple(row[7:9]), tuple(row[9:11]), one])
        for row, one in zip(rows, own(model) if pairs is None else pairs.own, strict=True)
    )


def _with_neighbours(at: Pose) -> Array:
    """(11, bars): of every bar the pose, and the axes of the bar in front of it and of the one behind it in the row.

    Joined once: rows that are joined one by one, and then stacked, are a call of the compiled program each.
    """
    c, s = at.c, at.s
    ahead, behind = (c[-1:], c[:-1], s[-1:], s[:-1]), (c[1:], c[:1], s[1:], s[:1])
    return jnp.concatenate([*at, *ahead, *behind]).reshape(-1, c.shape[0])


def laid_out(model: Model, values: Array, pairs: Listed | None = None) -> list[list[Array]]:
    """Values of bars, (k, bars) -> k of (1, features), or (pairs,): for every bar that a feature hangs on."""
    if pairs is not None:
        return [list(at_places(values, bar)) for bar in pairs.bars]
    return [[v[None, :] for v in values[:, bar]] for bar in _bars_of_features(model)]


def by_feature(model: Model, values: Sequence[Array], pairs: Listed | None) -> Array:
    """(bodies, features) or (pairs,) each -> (values, features): summed over what each feature touches."""
    if pairs is None:
        return jnp.sum(jnp.stack(list(values)), axis=1)
    return jnp.stack(add_at(model.layout.tail.shape[0], pairs.feature, values))


class Place(NamedTuple):
    """The touched point as seen from one bar, (bodies, features)."""

    share: Array | None  # 0..1 of the force that this bar takes; None: all of it
    arm_x: Array  # mm, from the bar's centre to the point of its axis
    arm_y: Array


class Lever(NamedTuple):
    """How a pair pushes one bar, (bodies, features): g_n = (n, r x n) and g_t = (t, r x t) of that bar."""

    share: Array | None  # 0..1 of the pair's force; None: all of it
    rn: Array  # r x n, mm
    rt: Array  # r x t, mm


def shared(bar: Place | Lever, value: Array) -> Array:
    """The bar's part of something of the pair."""
    return value if bar.share is None else bar.share * value


def to_bars(model: Model, parts: Sequence[Array]) -> Array:
    """(..., features) for each lever of the pairs -> (..., bars)."""
    if model.skin == "smooth":
        return pieces_to_bars(model.layout, *parts)
    return from_nodes(model.layout, *parts)


def blend(bars: Sequence[Place | Lever], values: Sequence[Array]) -> Array:
    """Values of the bars summed by their shares."""
    return functools.reduce(jnp.add, [shared(bar, value) for bar, value in zip(bars, values, strict=True)])
