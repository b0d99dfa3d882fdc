"""What of the sheets can touch, laid out along the bars that carry it.

What touches is the scene's `skin`. "bars": a bar and its front end circle are one feature, the tail's end circle is another.
"smooth": the piece of curve at each node is a feature, and hangs on two bars. A sheet has one more feature than bars in
either case.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose, from_nodes, pieces_to_bars, to_nodes, to_nodes_behind
from diffeed.model.arrays import Model


class Features(NamedTuple):
    """A bar for each feature of the sheets, (1, features): its own, or one of the two that it hangs on."""

    x: Array
    y: Array
    c: Array
    s: Array
    vx: Array
    vy: Array
    w: Array
    half_length: Array
    half_thickness: Array
    friction_factor: Array
    end: Array  # +1: its point is the bar's front node; -1: the rear node (tails)


def features(model: Model, at: Pose) -> tuple[Features, ...]:
    """Bars laid out as features, sheet after sheet: each feature's own, or the one in front of it and the one behind it."""
    bars = model.bars
    end = jnp.asarray(1.0 - 2.0 * model.layout.tail, at.x.dtype)[None, :]
    rows = laid_out(model, (*at, bars.half_length, bars.half_thickness, bars.friction_factor))
    return tuple(Features._make([*row, end]) for row in rows)


def laid_out(model: Model, values: Sequence[Array]) -> list[list[Array]]:
    """Values of bars, (bars,) each -> (1, features) each: for every bar that a feature hangs on."""
    rows = [[to_nodes(model.layout, v, v)[None, :] for v in values]]
    if model.skin == "smooth":
        rows.insert(0, [to_nodes_behind(model.layout, v)[None, :] for v in values])
    return rows


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
