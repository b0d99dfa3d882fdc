"""Bars that lie across a guide: where a sheet must never be. A guide feels points of a sheet, so a bar can straddle it unfelt."""

import jax.numpy as jnp
from jax import Array

from diffeed.bodies import bodies
from diffeed.contact import DEEP_IN_GUIDES
from diffeed.kinematics import nodes, pose
from diffeed.model import Model
from diffeed.shapes import past_ends_of_arc
from diffeed.smooth import polar
from diffeed.state import State


def guides_crossed(model: Model, state: State) -> Array:
    """(lines + arcs,) bool: a bar has its ends on both sides of the guide, one of them deep behind.

    The sides alone would also show an end that is pressed in; beyond the guide's own ends a sheet may cross freely.
    """
    if not (model.lines.names or model.arcs.names):
        return jnp.zeros((0,), bool)
    x, y = nodes(model, pose(model, state))
    world = bodies(model, state, state.time, state.time)
    lines, arcs = world.lines, world.arcs
    found = []
    if model.lines.names:
        dx, dy = x[None, :] - lines.x[:, None], y[None, :] - lines.y[:, None]
        tx, ty = lines.tx[:, None], lines.ty[:, None]
        across, share = _sides(dy * tx - dx * ty, lines.faces.depth[:, None])
        along = dx * tx + dy * ty
        meets = along[:, :-1] + share * (along[:, 1:] - along[:, :-1])
        found.append(across & (meets > 0) & (meets < lines.length[:, None]))
    if model.arcs.names:
        dx, dy = x[None, :] - arcs.x[:, None], y[None, :] - arcs.y[:, None]
        distance = polar(dx, dy)[0]
        across, share = _sides(arcs.side[:, None] * (arcs.radius[:, None] - distance), arcs.faces.depth[:, None])
        px, py = (v[:, :-1] + share * (v[:, 1:] - v[:, :-1]) for v in (dx, dy))
        mid, quarter = (
            tuple(v[:, None] for v in pair) for pair in ((arcs.mid_x, arcs.mid_y), (arcs.cos_quarter, arcs.sin_quarter))
        )
        first, second = past_ends_of_arc(*polar(px, py)[1:], arcs.radius[:, None], mid, quarter)
        found.append(across & (first < 0) & (second < 0))
    return jnp.any(jnp.concatenate(found) & ~model.layout.tail[None, :-1], axis=1)


def _sides(height: Array, depth: Array) -> tuple[Array, Array]:
    """(guides, nodes) heights above faces -> per pair of neighbours: whether the face lies between them and one is deep
    behind it, and where between them."""
    a, b = height[:, :-1], height[:, 1:]
    apart = jnp.where(a == b, 1.0, a - b)
    return (a * b < 0) & (jnp.minimum(a, b) < -DEEP_IN_GUIDES * depth), a / apart
