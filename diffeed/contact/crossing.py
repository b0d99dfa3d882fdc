"""Bars that lie across a guide: where a sheet must never be. A guide feels points of a sheet, so a bar can straddle it unfelt."""

import jax.numpy as jnp
from jax import Array

from diffeed.base.smooth import polar
from diffeed.chain.kinematics import nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import bodies
from diffeed.contact.kept import DEEP_IN_GUIDES
from diffeed.model.arrays import Model
from diffeed.pair.shapes import past_ends_of_arc


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
        height, along = dy * tx - dx * ty, dx * tx + dy * ty
        across, fall = _across(height, lines.faces.depth[:, None]), height[:, :-1] - height[:, 1:]
        share = height[:, :-1] / jnp.where(across, fall, 1.0)
        meets = along[:, :-1] + share * (along[:, 1:] - along[:, :-1])
        found.append(across & (meets > 0) & (meets < lines.length[:, None]))
    if model.arcs.names:
        dx, dy = x[None, :] - arcs.x[:, None], y[None, :] - arcs.y[:, None]
        height = arcs.side[:, None] * (arcs.radius[:, None] - polar(dx, dy)[0])
        across = _across(height, arcs.faces.depth[:, None])
        share = _meets_circle(dx, dy, arcs.radius[:, None])
        px, py = (v[:, :-1] + share * (v[:, 1:] - v[:, :-1]) for v in (dx, dy))
        mid, quarter = (
            tuple(v[:, None] for v in pair) for pair in ((arcs.mid_x, arcs.mid_y), (arcs.cos_quarter, arcs.sin_quarter))
        )
        first, second = past_ends_of_arc(*polar(px, py)[1:], arcs.radius[:, None], mid, quarter)
        found.append(across & (first < 0) & (second < 0))
    return jnp.any(jnp.concatenate(found) & ~model.layout.tail[None, :-1], axis=1)


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
