"""Pose of the chain: from mass centres and headings to bars and nodes, positions and velocities."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.angles import cos_sin
from diffeed.base.once import computed_once
from diffeed.chain.state import State, spread
from diffeed.chain.sums import from_mean
from diffeed.model.arrays import Model
from diffeed.model.layout import Layout


class Pose(NamedTuple):
    """Bars in the plane, all (bars,)."""

    x: Array  # bar centres, mm
    y: Array
    c: Array  # cosine and sine of the heading; the axis points towards the leading edge
    s: Array
    vx: Array  # velocities of the bar centres, mm/s
    vy: Array
    w: Array  # rad/s


def pose(model: Model, state: State) -> Pose:
    """Place every bar so that the joints are closed and the mass centre is where the state says."""
    # Left to itself the compiler computes both again in every loop that reads them (`tests/test_once.py` counts).
    c, s = computed_once(cos_sin(state.heading))
    bar = 2.0 * model.bars.half_length
    turn = bar * state.rate
    dx, dy, du, dv = from_mean(model.layout, jnp.stack([-bar * c, -bar * s, turn * s, -turn * c]))
    here = [spread(model.layout, v) for v in (state.x, state.y, state.vx, state.vy)]
    return Pose(here[0] + dx, here[1] + dy, c, s, here[2] + du, here[3] + dv, state.rate)


def to_nodes(layout: Layout, at_front: Array, at_rear: Array) -> Array:
    """(..., bars) values at both ends of each bar -> (..., nodes), sheet after sheet, lead to tail."""
    pieces = []
    for s in layout.slices():
        pieces += [at_front[..., s], at_rear[..., s.stop - 1 : s.stop]]
    return jnp.concatenate(pieces, axis=-1)


def from_nodes(layout: Layout, values: Array) -> Array:
    """(..., nodes) -> (..., bars): each node's value to the bar that it leads, the tail's to the last bar."""
    pieces = []
    for k, s in enumerate(layout.slices()):
        a, b = s.start + k, s.stop + k
        pieces += [values[..., a : b - 1], values[..., b - 1 : b] + values[..., b : b + 1]]
    return jnp.concatenate(pieces, axis=-1)


def pieces_to_bars(layout: Layout, in_front: Array, behind: Array) -> Array:
    """(..., nodes) twice -> (..., bars): what each node has for the bar in front of it and for the bar behind it."""
    pieces = []
    for k, s in enumerate(layout.slices()):
        a, b = s.start + k, s.stop + k
        pieces.append(behind[..., a:b] + in_front[..., a + 1 : b + 1])
    return jnp.concatenate(pieces, axis=-1)


def nodes(model: Model, at: Pose) -> tuple[Array, Array]:
    """Node positions x, y, each (nodes,), mm."""
    half = model.bars.half_length
    x = to_nodes(model.layout, at.x + half * at.c, at.x - half * at.c)
    return x, to_nodes(model.layout, at.y + half * at.s, at.y - half * at.s)


def node_velocities(model: Model, at: Pose) -> tuple[Array, Array]:
    """Node velocities, each (nodes,), mm/s."""
    half = model.bars.half_length
    vx = to_nodes(model.layout, at.vx - half * at.w * at.s, at.vx + half * at.w * at.s)
    return vx, to_nodes(model.layout, at.vy + half * at.w * at.c, at.vy - half * at.w * at.c)
