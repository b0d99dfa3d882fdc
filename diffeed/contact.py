"""Contact sweep: which pairs are near, what the law says of them. Geometry from `shapes`, forces from `contact_law`.

Bodies stand along one axis (rollers, circle guides, tips, then line guides, then arc guides), features of the sheets
along the next: (bodies, features). What touches is the scene's `skin`. "bars": a bar and its front end circle are one
feature, the tail's end circle is another. "smooth": the piece of curve at each node is a feature, and hangs on two bars. A
sheet has one more feature than bars in either case.
To add a guide shape: give it a point-to-shape function in `shapes`, posed arrays in `model` and `bodies`, and one more
entry in `guides_near` and `keep`; law, sums and solver do not change.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.bodies import Bodies, Rigid
from diffeed.contact_law import Grip, Surface, Touch, contact_law
from diffeed.kinematics import Pose, from_nodes, pieces_to_bars, to_nodes, to_nodes_behind
from diffeed.model import Arcs, Lines, Model
from diffeed.once import computed_once, derived_once
from diffeed.shapes import Chain, Near, chain_circle, point_arc, point_circle, point_line, round_ends
from diffeed.skin import Pieces, piece_circle, touched
from diffeed.smooth import polar

DEEPEST = 3.0
"""mm: a bar axis further inside a roller or circle guide than this (or than half its radius) went through it."""
SHALLOWEST = 0.25
"""mm that a bar axis may always lie in a circle, a tip of radius 0 too."""
DEEP_IN_GUIDES = 0.75
"""Of the depth of a guide, behind which it lets go: a bar axis further behind its face is on the way through."""


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


class Closest(NamedTuple):
    """Geometry of pairs, (bodies, features)."""

    gap: Array  # mm, surface to surface, negative in contact
    nx: Array  # normal into the sheet; the tangent is (-ny, nx)
    ny: Array
    weight: Array  # 0..1: share of the contact that this pair carries
    places: tuple[Place, ...]  # on each bar that the pair pushes
    u_n: Array  # mm/s, speed of the body's surface along the normal and the tangent
    u_t: Array
    lever: Array  # mm that the foot runs per radian: R + t/2 where a face lies on a circle, 0 at a round end


class Lever(NamedTuple):
    """How a pair pushes one bar, (bodies, features): g_n = (n, r x n) and g_t = (t, r x t) of that bar."""

    share: Array | None  # 0..1 of the pair's force; None: all of it
    rn: Array  # r x n, mm
    rt: Array  # r x t, mm


def shared(bar: Place | Lever, value: Array) -> Array:
    """The bar's part of something of the pair."""
    return value if bar.share is None else bar.share * value


class Pairs(NamedTuple):
    """Evaluated pairs, (bodies, features). Forces carry the pair's weight already.

    v_n = g_n.v - u_n is the speed with which the touched point leaves, summed over its bars by their shares; v_t likewise.
    """

    touch: Touch
    gap: Array
    nx: Array
    ny: Array
    levers: tuple[Lever, ...]  # its own bar; on the smooth skin the bar in front and the bar behind
    v_n: Array
    v_t: Array
    u_n: Array  # mm/s of the body's surface
    u_t: Array
    weight: Array
    turning: Array  # geometric stiffness of the skin's rotation, kg mm2/s2


class Kept(NamedTuple):
    """The bodies that each feature is held against: all of them, (bodies, 1), or a few nearby ones, (slots, features).

    An index of None keeps a family whole. Rollers are the first circles; `travel` and `spin` say how a circle moves.
    """

    circle_index: Array | None
    line_index: Array | None
    arc_index: Array | None
    radius: Array
    active: Array
    travel_x: Array  # unit direction of a movable roller's travel, 0 for all other circles
    travel_y: Array
    spin_lever: Array  # radius of a freely turning roller, 0 for all other circles
    lines: Lines | None  # None: there are none, or they are not looked at
    arcs: Arcs | None
    surface: Surface
    allowed: Array  # mm that a bar axis may lie inside
    approach: Array  # mm that a sheet may come nearer in one step
    pair_index: tuple[Any, Any]  # rollers of the pairs that are looked at, (pairs,) or (movable, partners)
    pair_surface: Surface
    slot: Array | None  # (rollers, features) which slot holds it, circles where they stick; None: rows are bodies
    has_slot: Array | None  # and whether one does

    @property
    def n_circles(self) -> int:
        """Rows that hold circles."""
        return self.radius.shape[0]


def pick(values: Array, index: Array | None) -> Array:
    """(bodies,) -> (bodies, 1) or (slots, features)."""
    return values[:, None] if index is None else values[index]


def picked(values: tuple[Array, ...], index: Array | None) -> tuple[Array, ...]:
    """`pick` for several at once: one gather instead of many."""
    return tuple(v[:, None] for v in values) if index is None else tuple(jnp.stack(values)[:, index])


def _kept(family: Any, index: Array | None) -> Any:
    """`pick` for every value of a family of guides."""
    return jax.tree.map(lambda v: pick(v, index), family)


def keep_all(model: Model) -> Kept:
    """Every body against every feature."""
    return keep(model, None, None, None)


def keep_rollers(model: Model) -> Kept:
    """Every roller against every feature, and no guide: half the work or less, for who asks about nips."""
    whole, n = keep_all(model), model.rollers.n
    fields = ("radius", "active", "travel_x", "travel_y", "spin_lever")
    cut = {name: getattr(whole, name)[:n] for name in fields}
    surface, allowed, approach = jax.tree.map(lambda v: v[:n], (whole.surface, whole.allowed, whole.approach))
    return whole._replace(lines=None, arcs=None, surface=surface, allowed=allowed, approach=approach, **cut)


def allowed_in_circles(radius: Array) -> Array:
    """mm that a bar axis may lie inside circles."""
    return jnp.maximum(jnp.minimum(DEEPEST, 0.5 * radius), SHALLOWEST)


def allowed_depths(model: Model) -> Array:
    """(bodies,) mm that a bar axis may lie inside: deeper, the sheet is on its way to the other side."""
    behind = [DEEP_IN_GUIDES * guides.faces.depth for guides in (model.lines, model.arcs)]
    return jnp.concatenate([allowed_in_circles(model.circles.radius), *behind])


def allowed_approaches(model: Model) -> Array:
    """(bodies,) mm that a sheet may come nearer in one step: half of what takes it out of a body on the other side, so that
    it is seen inside. That is the depth of a guide, and the way to the centre and as far beyond as an axis may lie in a
    small circle; in a large one it is seen to be too deep before."""
    circles = jnp.minimum(0.5 * (model.circles.radius + allowed_in_circles(model.circles.radius)), 0.5 * DEEPEST)
    return jnp.concatenate([circles, 0.5 * allowed_depths(model)[model.circles.radius.shape[0] :]])


def keep(
    model: Model, circles: Array | None, lines: Array | None, arcs: Array | None, pairs: Array | None = None
) -> Kept:
    """The bodies of the given indices, (slots, features) each, and of each movable roller the given partners."""
    rollers, n = model.rollers, len(model.circle_names)
    still = jnp.zeros((n - rollers.n_movable,))
    levers = jnp.zeros((n,)).at[rollers.free].set(rollers.radius[rollers.free])
    n_lines, c = len(model.lines.names), n

    def surface(values: Array) -> Array:
        parts = [(values[:c], circles), (values[c : c + n_lines], lines), (values[c + n_lines :], arcs)]
        return _in_rows([pick(v, index) for v, index in parts if v.shape[0]] or [pick(values, None)])

    slot = has_slot = None
    if circles is not None:
        looked_up = n if model.sticks[0] else rollers.n
        hot = circles[None] == jnp.arange(looked_up, dtype=circles.dtype)[:, None, None]
        slot, has_slot = jnp.argmax(hot, axis=1), jnp.any(hot, axis=1)
    pair_index, pair_surface = model.pair_index, model.pair_surface
    if pairs is not None:
        partner, which = (jnp.take_along_axis(jnp.asarray(v), pairs, axis=1) for v in model.pairs_by_roller)
        mine = jnp.broadcast_to(jnp.arange(rollers.n_movable)[:, None], partner.shape)
        pair_index, pair_surface = (mine, partner), jax.tree.map(lambda v: v[which], pair_surface)
    return Kept(
        circle_index=circles,
        line_index=lines,
        arc_index=arcs,
        radius=pick(model.circles.radius, circles),
        active=pick(model.circles.active, circles),
        travel_x=pick(jnp.concatenate([rollers.dir_x, still]), circles),
        travel_y=pick(jnp.concatenate([rollers.dir_y, still]), circles),
        spin_lever=pick(levers, circles),
        lines=_kept(model.lines, lines) if model.lines.names else None,
        arcs=_kept(model.arcs, arcs) if model.arcs.names else None,
        surface=jax.tree.map(surface, model.surface),
        allowed=surface(allowed_depths(model)),
        approach=surface(allowed_approaches(model)),
        pair_index=pair_index,
        pair_surface=pair_surface,
        slot=slot,
        has_slot=has_slot,
    )


def sheet_contacts(model: Model, at: Pose, world: Bodies, kept: Kept, grip: Grip | None = None) -> Pairs:
    """The kept bodies against every feature of every sheet. Without a `grip`, friction is regularised everywhere."""
    rows = features(model, at)
    near, half_thickness = _near(model, rows, world, kept), rows[-1].half_thickness
    near = derived_once(near)
    levers, away, along = [], [], []
    for row, place in zip(rows, near.places, strict=True):
        rn = place.arm_x * near.ny - place.arm_y * near.nx
        rt = place.arm_x * near.nx + place.arm_y * near.ny - half_thickness
        levers.append(Lever(place.share, rn, rt))
        away.append(near.nx * row.vx + near.ny * row.vy + row.w * rn)
        along.append(near.nx * row.vy - near.ny * row.vx + row.w * rt)
    v_n, v_t = blend(levers, away) - near.u_n, blend(levers, along) - near.u_t
    raw = contact_law(kept.surface, -near.gap, v_n, v_t, rows[-1].friction_factor, grip)
    touch = jax.tree.map(lambda v: near.weight * v, computed_once(raw))
    # What turns under a circle moves the foot: dM/dtheta = -F (R + t/2). Its positive part, as all of it is. The skin turns
    # with the headings of its two bars by their shares.
    turning = touch.force * near.lever
    moving = (v_n, v_t, near.u_n, near.u_t)
    return Pairs(touch, near.gap, near.nx, near.ny, tuple(levers), *moving, near.weight, turning)


def to_bars(model: Model, parts: Sequence[Array]) -> Array:
    """(..., features) for each lever of the pairs -> (..., bars)."""
    if model.skin == "smooth":
        return pieces_to_bars(model.layout, *parts)
    return from_nodes(model.layout, *parts)


def blend(bars: Sequence[Place | Lever], values: Sequence[Array]) -> Array:
    """Values of the bars summed by their shares."""
    return functools.reduce(jnp.add, [shared(bar, value) for bar, value in zip(bars, values, strict=True)])


def heading(model: Model, at: Pose, pairs: Pairs) -> tuple[Array, Array]:
    """Cosine and sine of the direction of travel where pairs touch: the bar's, or the smooth skin's tangent."""
    rows = features(model, at)
    if len(rows) == 1:
        return rows[0].c, rows[0].s
    c, s = (blend(pairs.levers, values) for values in ([r.c for r in rows], [r.s for r in rows]))
    return polar(c, s)[1:]


def _near(model: Model, rows: tuple[Features, ...], world: Bodies, kept: Kept) -> Closest:
    families = []
    if kept.n_circles:
        families.append(circles_near(model, rows, world, kept))
    if kept.lines is not None or kept.arcs is not None:
        families.append(guides_near(model, rows, world, kept))
    return _in_rows(families)


def circles_near(model: Model, rows: tuple[Features, ...], world: Bodies, kept: Kept) -> Closest:
    """The skin against rollers, circle guides and tips."""
    rigid = Rigid(*(v[: kept.n_circles] for v in picked(tuple(world.circles), kept.circle_index)))
    half_thickness = rows[-1].half_thickness
    reach = kept.radius + half_thickness
    if len(rows) == 1:
        (row,) = rows
        near = chain_circle(_chain(model, row), rigid.x, rigid.y, kept.radius)
        places, lever = (Place(None, near.arm * row.c, near.arm * row.s),), jnp.where(near.on_face, reach, 0.0)
    else:
        near = piece_circle(_pieces(model, *rows), rigid.x, rigid.y, kept.radius)
        places, lever = _places(model, rows, near.u), near.run * reach
    return Closest(
        gap=near.gap - half_thickness,
        nx=near.nx,
        ny=near.ny,
        weight=near.weight * kept.active,
        places=places,
        u_n=near.nx * rigid.vx + near.ny * rigid.vy,
        u_t=near.nx * rigid.vy - near.ny * rigid.vx + rigid.w * kept.radius,
        lever=lever,
    )


def _chain(model: Model, row: Features) -> Chain:
    ahead, behind = ((jnp.roll(row.c, k, axis=1), jnp.roll(row.s, k, axis=1)) for k in (1, -1))
    layout = model.layout
    ends = (layout.first_feature[None, :], layout.last_feature[None, :], layout.tail[None, :])
    return Chain(row.x, row.y, row.c, row.s, row.half_length, ahead, behind, *ends)


def _pieces(model: Model, front: Features, behind: Features) -> Pieces:
    """The curve at each node, between the middles of the bars in front and behind; at lead and tail from the node itself."""
    lead, tail = model.layout.first_feature[None, :], model.layout.tail[None, :]
    half = jnp.where(lead | tail, -0.5, -1.0) * front.half_length
    out, back = jnp.where(lead, front.half_length, 0.0), half
    return Pieces(
        x=front.x + out * front.c,
        y=front.y + out * front.s,
        first_x=back * front.c,
        first_y=back * front.s,
        second_x=back * behind.c,
        second_y=back * behind.s,
        lead=lead,
        tail=tail,
    )


def _places(model: Model, rows: tuple[Features, ...], u: Array) -> tuple[Place, ...]:
    """Where the point u of the smooth skin's pieces hangs on the bar in front and on the bar behind."""
    lead, tail = model.layout.first_feature[None, :], model.layout.tail[None, :]
    found = touched(u, rows[0].half_length, rows[1].half_length, lead, tail)
    return tuple(Place(f.share, f.arm * row.c, f.arm * row.s) for f, row in zip(found, rows, strict=True))


def guides_near(model: Model, rows: tuple[Features, ...], world: Bodies, kept: Kept) -> Closest:
    """End circles, or points of the smooth skin, against line guides and arc guides."""
    places = _samples(model, rows)
    px, py = _points(rows, places)
    faced, faces, moving = [], [], world.guide_motion
    if kept.lines is not None:
        lines = kept.lines if moving is None else _kept(world.lines, kept.line_index)
        faced.append(point_line(px, py, lines.x, lines.y, lines.tx, lines.ty, lines.length))
        faces.append(lines.faces)
    if kept.arcs is not None:
        arcs = kept.arcs if moving is None else _kept(world.arcs, kept.arc_index)
        mid, quarter = (arcs.mid_x, arcs.mid_y), (arcs.cos_quarter, arcs.sin_quarter)
        faced.append(point_arc(px, py, arcs.x, arcs.y, arcs.radius, mid, quarter, arcs.side))
        faces.append(arcs.faces)
    near, motion = round_ends(px, py, _in_rows(faced), _in_rows(faces)), None
    if moving is not None:
        families = ((kept.lines, moving.lines, kept.line_index), (kept.arcs, moving.arcs, kept.arc_index))
        motion = _in_rows([_kept(moved, index) for guides, moved, index in families if guides is not None])
    return _end_circles(rows, places, near, motion)


def _in_rows(families: list[Any]) -> Any:
    """Families of bodies one after the other: (bodies, 1) or (slots, features) each."""
    if len(families) == 1:
        return families[0]

    def joined(*parts: Array) -> Array:
        width = max(v.shape[1] for v in parts)
        return jnp.concatenate([jnp.broadcast_to(v, (v.shape[0], width)) for v in parts])

    return jax.tree.map(joined, *families)


def _samples(model: Model, rows: tuple[Features, ...]) -> tuple[Place, ...]:
    """The points of the sheets that guides feel, (1, features): the nodes, or the middles of the smooth skin's pieces and
    the sheets' ends."""
    if len(rows) == 1:
        (row,) = rows
        arm = row.end * row.half_length
        return (Place(None, arm * row.c, arm * row.s),)
    middle = np.where(model.layout.first_feature, 0.0, np.where(model.layout.tail, 1.0, 0.5))
    return _places(model, rows, jnp.asarray(middle, rows[0].x.dtype)[None, :])


def _points(rows: tuple[Features, ...], places: tuple[Place, ...]) -> tuple[Array, Array]:
    x = [row.x + place.arm_x for row, place in zip(rows, places, strict=True)]
    y = [row.y + place.arm_y for row, place in zip(rows, places, strict=True)]
    return blend(places, x), blend(places, y)


def _end_circles(rows: tuple[Features, ...], places: tuple[Place, ...], near: Near, motion: Rigid | None) -> Closest:
    """Circles around points of the sheets against guides; a moving guide lends its surface speed at the touched point."""
    u_n = u_t = zero = jnp.zeros_like(near.gap)
    half_thickness = rows[-1].half_thickness
    if motion is not None:
        px, py = _points(rows, places)
        rx, ry = px - half_thickness * near.nx - motion.x, py - half_thickness * near.ny - motion.y
        ux, uy = motion.vx - motion.w * ry, motion.vy + motion.w * rx
        u_n, u_t = near.nx * ux + near.ny * uy, near.nx * uy - near.ny * ux
    places = jax.tree.map(lambda v: jnp.broadcast_to(v, zero.shape), places)
    return Closest(near.gap - half_thickness, near.nx, near.ny, near.weight, places, u_n, u_t, zero)


def by_circle(kept: Kept, values: Array, which: np.ndarray, kind: np.ndarray | int = 0) -> Array:
    """(k, kinds, rows, features) of circles -> (k, which, features): of one kind each, the row of a circle or the slot that
    holds it. Rollers are the first; other circles can be asked for only where circles stick."""
    rows = values.shape[2]
    flat = values.reshape(values.shape[0], -1, values.shape[3])
    if kept.slot is None or kept.has_slot is None:
        return flat[:, rows * kind + which]
    offset = jnp.asarray(np.broadcast_to(rows * kind, which.shape)[:, None], kept.slot.dtype)
    held = jnp.take_along_axis(flat, (offset + kept.slot[which])[None], axis=1)
    return jnp.where(kept.has_slot[which], held, 0.0)


class RollerPairs(NamedTuple):
    """Roller against roller, (pairs,) or (movable, partners): the normal pushes the first away from the second."""

    between: tuple[Any, Any]  # index of the first and of the second
    surface: Surface
    touch: Touch
    gap: Array
    nx: Array
    ny: Array
    v_n: Array
    v_t: Array


def roller_gaps(model: Model, world: Bodies, index: tuple[Any, Any]) -> tuple[Rigid, Rigid, Near, Array]:
    """Motions of the two rollers of pairs, where they are nearest, and their gap: of the shape of the index."""
    i, j = index
    radius, count = model.rollers.radius, i.shape[0]
    both = jnp.stack([v[: model.rollers.n] for v in world.circles])[:, _joined(i, j)]
    a, b = Rigid(*both[:, :count]), Rigid(*both[:, count:])
    near = point_circle(a.x, a.y, b.x, b.y, radius[j])
    return a, b, near, near.gap - radius[i]


def _joined(i: Any, j: Any) -> Any:
    return np.concatenate([i, j]) if isinstance(i, np.ndarray) else jnp.concatenate([i, j])


def roller_contacts(model: Model, world: Bodies, kept: Kept) -> RollerPairs:
    """Rollers against each other: a pinch rests on its drive when no sheet is there. Their friction is regularised."""
    (i, j), radius = kept.pair_index, model.rollers.radius
    a, b, near, gap = roller_gaps(model, world, kept.pair_index)
    dvx, dvy = a.vx - b.vx, a.vy - b.vy
    v_n = near.nx * dvx + near.ny * dvy
    v_t = near.nx * dvy - near.ny * dvx - a.w * radius[i] - b.w * radius[j]
    touch = contact_law(kept.pair_surface, -gap, v_n, v_t, 1.0)
    return RollerPairs(kept.pair_index, kept.pair_surface, touch, gap, near.nx, near.ny, v_n, v_t)
