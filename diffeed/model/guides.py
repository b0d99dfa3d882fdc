"""Lines and arcs as faces with rounded ends, where they join, and all that is a circle."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.packing import stacked
from diffeed.input.parts import ArcGuide, CircleGuide, LineGuide
from diffeed.model.arrays import Circles, Guides, Movements, Rollers
from diffeed.model.movements import move_alike
from diffeed.model.rows import columns
from diffeed.pair.shapes import Bend, Face

JOIN_TOLERANCE = 1e-3
"""mm: guide ends closer than this are one end."""


def guides_of(lines: list[tuple[str, LineGuide]], arcs: list[tuple[str, ArcGuide]], movements: Movements) -> Guides:
    """Lines, then arcs. A diverter that only starts flush with its neighbour leaves an end open."""
    parts = [part for _, part in (*lines, *arcs)]
    of_lines, of_arcs = _line_faces([g for _, g in lines]), _arc_faces([g for _, g in arcs])
    x, y, tx, ty, reach, curvature, cos_quarter = (
        jnp.concatenate(v) for v in zip(of_lines[0], of_arcs[0], strict=True)
    )
    ends = [
        [jnp.concatenate(v) for v in zip(a, b, strict=True)] for a, b in zip(of_lines[1:], of_arcs[1:], strict=True)
    ]
    joined = _joined([(e[0], e[1]) for e in ends], movements, cos_quarter > 0)
    tip, depth = stacked([g.tip_radius for g in parts]), stacked([g.depth for g in parts])
    # A tip circle is set back behind the face by its radius, so that it is tangent to the face at the end.
    (ax, bx), (ay, by) = ([e[k] - tip * e[k + 2] for e in ends] for k in (0, 1))
    return Guides(
        x=x,
        y=y,
        tx=tx,
        ty=ty,
        reach=reach,
        bend=Bend(curvature, cos_quarter) if arcs else None,
        faces=Face(depth, tip, (ax, bx), (ay, by), joined),
        names=tuple(name for name, _ in (*lines, *arcs)),
    )


Columns = tuple[Array, ...]


def _line_faces(lines: list[LineGuide]) -> tuple[Columns, Columns, Columns]:
    """Middle, tangent, reach, curvature and cosine of a quarter of the sweep; of either end its place and the normal there."""
    (sx, sy), (ex, ey) = columns([g.start for g in lines]), columns([g.end for g in lines])
    length = jnp.sqrt((ex - sx) ** 2 + (ey - sy) ** 2)
    tx, ty = (ex - sx) / length, (ey - sy) / length
    nothing = jnp.zeros_like(length)
    faces = 0.5 * (sx + ex), 0.5 * (sy + ey), tx, ty, 0.5 * length, nothing, nothing + 1.0
    return faces, (sx, sy, -ty, tx), (ex, ey, -ty, tx)


def _arc_faces(arcs: list[ArcGuide]) -> tuple[Columns, Columns, Columns]:
    """The same of arcs."""
    cx, cy = columns([g.center for g in arcs])
    radius = stacked([g.radius for g in arcs])
    start, sweep = (jnp.deg2rad(stacked([getattr(g, f) for g in arcs])) for f in ("start_angle", "sweep"))
    side = stacked([1.0 if g.side == "inside" else -1.0 for g in arcs])
    # The bearing side lies on the left from the first end to the second, however the arc was given.
    middle, quarter = start + 0.5 * sweep, 0.25 * jnp.abs(sweep)
    # A full turn has no ends: nothing is fitted to them, and nothing fades there.
    closed = 4.0 * quarter > 2.0 * jnp.pi - JOIN_TOLERANCE / radius
    cos_quarter, sin_quarter = jnp.where(closed, 0.0, jnp.cos(quarter)), jnp.where(closed, 1.0, jnp.sin(quarter))

    def at(angle: Array) -> Columns:
        """Place and normal."""
        c, s = jnp.cos(angle), jnp.sin(angle)
        return cx + radius * c, cy + radius * s, -side * c, -side * s

    x, y, nx, ny = at(middle)
    turn = 2.0 * side * quarter
    return (x, y, ny, -nx, 2.0 * radius * sin_quarter, side / radius, cos_quarter), at(middle - turn), at(middle + turn)


def _joined(ends: list[tuple[Array, Array]], movements: Movements, has_ends: Array) -> tuple[Array, Array]:
    """1 for each first and each second end that coincides with one of a guide that moves alike. A yes or no: no gradient."""
    n = has_ends.shape[0]
    x, y = jnp.concatenate([e[0] for e in ends]), jnp.concatenate([e[1] for e in ends])
    near = (x[:, None] - x[None, :]) ** 2 + (y[:, None] - y[None, :]) ** 2 < JOIN_TOLERANCE**2
    is_end = jnp.concatenate([has_ends, has_ends])
    near &= move_alike(movements, [("guides", k) for k in range(n)] * 2) & is_end[:, None] & is_end[None, :]
    flags = jnp.any(near & ~np.eye(2 * n, dtype=bool), axis=1).astype(x.dtype)
    return flags[:n], flags[n:]


def circles_of(
    roller_set: Rollers,
    rollers: list[tuple[str, Any]],
    circle_guides: list[tuple[str, CircleGuide]],
    guides: Guides,
    parts: list[tuple[str, Any]],
) -> tuple[Circles, list[tuple[str, Any]]]:
    """Rollers, circle guides and the tips of other guides (`parts`) in one row, and the part behind each."""
    faces, ends = guides.faces, (0, 1) if parts else ()
    has_ends = 1.0 if guides.bend is None else (guides.bend.cos_quarter > 0).astype(guides.x.dtype)
    zeros = jnp.zeros((len(rollers),))
    x, y = columns([g.center for _, g in circle_guides])
    radii = [roller_set.radius, stacked([p.radius for _, p in circle_guides]), *[faces.tip_radius for _ in ends]]
    there = [jnp.ones((len(rollers) + len(circle_guides),)), *[(1.0 - faces.joined[e]) * has_ends for e in ends]]
    circles = Circles(
        x=jnp.concatenate([zeros, x, *[faces.tip_x[e] for e in ends]]),
        y=jnp.concatenate([zeros, y, *[faces.tip_y[e] for e in ends]]),
        radius=jnp.concatenate(radii),
        active=jnp.concatenate(there),
    )
    return circles, rollers + circle_guides + parts * 2
