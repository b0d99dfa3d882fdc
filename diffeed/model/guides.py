"""Lines and arcs with their rounded ends, where they join, and all that is a circle."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.packing import stacked
from diffeed.input.parts import ArcGuide, CircleGuide, LineGuide
from diffeed.model.arrays import Arcs, Circles, Lines, Movements, Rollers
from diffeed.model.movements import move_alike
from diffeed.model.rows import columns
from diffeed.pair.shapes import Face

JOIN_TOLERANCE = 1e-3
"""mm: guide ends closer than this are one end."""


def lines_and_arcs(
    lines: list[tuple[str, LineGuide]], arcs: list[tuple[str, ArcGuide]], movements: Movements
) -> tuple[Lines, Arcs]:
    """Both families at once, for the end of a line may be that of an arc. A diverter that only starts flush with its neighbour
    leaves an end open."""
    (sx, sy), (ex, ey) = columns([g.start for _, g in lines]), columns([g.end for _, g in lines])
    length = jnp.sqrt((ex - sx) ** 2 + (ey - sy) ** 2)
    tx, ty = (ex - sx) / length, (ey - sy) / length
    cx, cy = columns([g.center for _, g in arcs])
    radius = stacked([g.radius for _, g in arcs])
    start, sweep = (jnp.deg2rad(stacked([getattr(g, f) for _, g in arcs])) for f in ("start_angle", "sweep"))
    side = stacked([1.0 if g.side == "inside" else -1.0 for _, g in arcs])
    # The ends of an arc in the order of increasing angle, so that a clockwise sweep is the same arc.
    low, high = start + jnp.minimum(sweep, 0.0), start + jnp.maximum(sweep, 0.0)
    ends = [(sx, sy), (ex, ey)] + [(cx + radius * jnp.cos(a), cy + radius * jnp.sin(a)) for a in (low, high)]
    # A full turn has no ends: nothing is fitted to them, and nothing fades there.
    closed = high - low > 2.0 * jnp.pi - JOIN_TOLERANCE / radius
    owners = [("lines", k) for k in range(len(lines))] * 2 + [("arcs", k) for k in range(len(arcs))] * 2
    is_end = jnp.concatenate([jnp.ones((2 * len(lines),), bool), ~closed, ~closed])
    joined = _joined(ends, move_alike(movements, owners) & is_end[:, None] & is_end[None, :])
    line_tip, arc_tip = (stacked([g.tip_radius for _, g in guides]) for guides in (lines, arcs))
    normals = [(-ty, tx)] * 2 + [(-side * jnp.cos(a), -side * jnp.sin(a)) for a in (low, high)]

    def face(guides: list[Any], tip: Array, k: int) -> Face:
        depth = stacked([g.depth for _, g in guides])
        # A tip circle is set back behind the face by its radius, so that it is tangent to the face at the end.
        tips = [(ends[j][0] - tip * normals[j][0], ends[j][1] - tip * normals[j][1]) for j in (k, k + 1)]
        return Face(depth, tip, (tips[0][0], tips[1][0]), (tips[0][1], tips[1][1]), (joined[k], joined[k + 1]))

    mid = 0.5 * (low + high)
    quarter = 0.25 * (high - low)
    cos_quarter, sin_quarter = jnp.where(closed, 0.0, jnp.cos(quarter)), jnp.where(closed, 1.0, jnp.sin(quarter))
    line_set = Lines(
        x=sx, y=sy, tx=tx, ty=ty, length=length, faces=face(lines, line_tip, 0), names=tuple(n for n, _ in lines)
    )
    arc_set = Arcs(
        x=cx, y=cy, radius=radius, mid_x=jnp.cos(mid), mid_y=jnp.sin(mid), cos_quarter=cos_quarter,
        sin_quarter=sin_quarter, side=side, faces=face(arcs, arc_tip, 2), names=tuple(n for n, _ in arcs),
    )  # fmt: skip
    return line_set, arc_set


def _joined(ends: list[tuple[Array, Array]], may: Array) -> list[Array]:
    """1 for each end that coincides with another one to which it `may` be joined. A yes or no: no gradient."""
    counts = [x.shape[0] for x, _ in ends]
    x, y = jnp.concatenate([e[0] for e in ends]), jnp.concatenate([e[1] for e in ends])
    n = sum(counts)
    near = (x[:, None] - x[None, :]) ** 2 + (y[:, None] - y[None, :]) ** 2 < JOIN_TOLERANCE**2
    flags = jnp.any(near & may & ~np.eye(n, dtype=bool), axis=1).astype(x.dtype)
    return jnp.split(flags, np.cumsum(counts)[:-1].tolist())


def circles_of(
    roller_set: Rollers,
    rollers: list[tuple[str, Any]],
    guides: list[tuple[str, CircleGuide]],
    lines: tuple[list[tuple[str, Any]], Lines],
    arcs: tuple[list[tuple[str, Any]], Arcs],
) -> tuple[Circles, list[tuple[str, Any]]]:
    """Rollers, circle guides and the tips of lines and arcs in one row, and the part behind each."""
    tips = [
        (family, parts, faces.faces, end)
        for family, (parts, faces) in (("lines", lines), ("arcs", arcs))
        for end in (0, 1)
        if parts
    ]
    of_arcs = arcs[1].cos_quarter
    has_ends = {"lines": jnp.ones(()), "arcs": (of_arcs > 0).astype(of_arcs.dtype)}
    zeros = jnp.zeros((len(rollers),))
    owners = rollers + guides + [p for _, parts, _, _ in tips for p in parts]
    x, y = columns([g.center for _, g in guides])
    circles = Circles(
        x=jnp.concatenate([zeros, x, *[f.tip_x[e] for _, _, f, e in tips]]),
        y=jnp.concatenate([zeros, y, *[f.tip_y[e] for _, _, f, e in tips]]),
        radius=jnp.concatenate(
            [roller_set.radius, stacked([p.radius for _, p in guides]), *[f.tip_radius for _, _, f, _ in tips]]
        ),
        active=jnp.concatenate(
            [jnp.ones((len(rollers) + len(guides),)), *[(1.0 - f.joined[e]) * has_ends[k] for k, _, f, e in tips]]
        ),
        tip_of=tuple((family, k, end) for family, parts, _, end in tips for k in range(len(parts))),
    )
    return circles, owners
