"""Where the face of a guide ends and its rounded tip begins: which of the two feels a corner of a sheet."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.model.arrays import Arcs, Lines, Model
from diffeed.pair.shapes import felt_before_end


class Tips(NamedTuple):
    """Of circles, (circles,), or as they are kept; all zero for what is no tip of a line or arc."""

    out_x: Array  # unit vector along the face, out over its end
    out_y: Array
    hand: Array  # +1: the face bears on the left of that; -1: on the right
    depth: Array


def tips_of(model: Model, lines: Lines, arcs: Arcs) -> Tips | None:
    """Of all circles, from the guides as they are posed, in the order of `model.circles.tip_of`. None: there are no tips."""
    if not model.circles.tip_of:
        return None
    half = (arcs.cos_quarter**2 - arcs.sin_quarter**2, 2.0 * arcs.sin_quarter * arcs.cos_quarter)  # of half the sweep
    line, arc = jnp.ones_like(lines.length), jnp.ones_like(arcs.radius)
    ends = []
    for way in (-1.0, 1.0) if lines.names else ():
        ends.append((way * lines.tx, way * lines.ty, way * line, lines.faces.depth))
    for way in (-1.0, 1.0) if arcs.names else ():
        ux, uy = arcs.mid_x * half[0] - way * arcs.mid_y * half[1], arcs.mid_y * half[0] + way * arcs.mid_x * half[1]
        ends.append((-way * uy, way * ux, way * arc * arcs.side, arcs.faces.depth))
    others = len(model.circle_names) - len(model.circles.tip_of)
    return Tips(*(jnp.pad(jnp.concatenate(v), (others, 0)) for v in zip(*ends, strict=True)))


def felt_by_face(tips: Tips, gap: Array, nx: Array, ny: Array, radius: Array, half_thickness: Array) -> Array:
    """0 to 1, how much of a corner of a sheet, at a gap (to its axis) and normal from circles, the face feels that ends there:
    all of it before the end, nothing past it, as `round_ends` has it.
    """
    distance, along = gap + radius, nx * tips.out_x + ny * tips.out_y
    height = distance * tips.hand * (ny * tips.out_x - nx * tips.out_y) - radius
    return jnp.where(height > -tips.depth, felt_before_end(distance * along, radius + half_thickness), 0.0)
