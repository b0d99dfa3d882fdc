"""Contact sweep: which pairs are near, what the law says of them. Geometry from `shapes`, forces from `contact_law`.

Bodies stand along one axis (rollers, circle guides, tips, then line guides, then arc guides), features of the sheets
along the next. A bar and its front end circle are one feature, the tail's end circle is another: (bodies, features).
To add a guide shape: give it a point-to-shape function in `shapes`, posed arrays in `model` and `bodies`, and one more
entry in `_near` and `keep`; law, sums and solver do not change.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.bodies import Bodies, Rigid
from diffeed.contact_law import Grip, Surface, Touch, contact_law
from diffeed.kinematics import Pose, to_nodes
from diffeed.model import Arcs, Lines, Model
from diffeed.shapes import Chain, Near, chain_circle, point_arc, point_circle, point_line


class Features(NamedTuple):
    """Features of the sheets, (1, features): for each bar the bar, then the tail; all values are the bar's."""

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


def features(model: Model, at: Pose) -> Features:
    """Lay bars out as features, sheet after sheet."""

    def lay(values: Array) -> Array:
        return to_nodes(model.layout, values, values)[None, :]

    bars = model.bars
    own = (bars.half_length, bars.half_thickness, bars.friction_factor)
    end = jnp.asarray(1.0 - 2.0 * model.layout.tail, at.x.dtype)[None, :]
    return Features._make([*(lay(v) for v in (*at, *own)), end])


class Closest(NamedTuple):
    """Geometry of pairs, (bodies, features)."""

    gap: Array  # mm, surface to surface, negative in contact
    nx: Array  # normal into the sheet; the tangent is (-ny, nx)
    ny: Array
    weight: Array  # 0..1: share of the contact that this pair carries
    arm_x: Array  # mm, from the bar's centre to the touched point of its axis
    arm_y: Array
    u_n: Array  # mm/s, speed of the body's surface along the normal and the tangent
    u_t: Array
    lever: Array  # mm: R + t/2 where a bar's face lies on a circle, else 0


class Pairs(NamedTuple):
    """Evaluated pairs, (bodies, features). Forces carry the pair's weight already.

    With g_n = (n, r x n) and g_t = (t, r x t) of the bar, v_n = g_n.v - u_n is the speed with which the bar leaves.
    """

    touch: Touch
    gap: Array
    nx: Array
    ny: Array
    rn: Array  # r x n, mm
    rt: Array  # r x t, mm
    v_n: Array
    v_t: Array
    weight: Array
    turning: Array  # geometric stiffness of the bar's rotation, kg mm2/s2


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
    lines: Lines | None  # None: not looked at
    arcs: Arcs | None
    surface: Surface
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


def keep_all(model: Model) -> Kept:
    """Every body against every feature."""
    return keep(model, None, None, None)


def keep_rollers(model: Model) -> Kept:
    """Every roller against every feature, and no guide: half the work or less, for who asks about nips."""
    whole, n = keep_all(model), model.rollers.n
    fields = ("radius", "active", "travel_x", "travel_y", "spin_lever")
    cut = {name: getattr(whole, name)[:n] for name in fields}
    return whole._replace(lines=None, arcs=None, surface=jax.tree.map(lambda v: v[:n], whole.surface), **cut)


def keep(model: Model, circles: Array | None, lines: Array | None, arcs: Array | None) -> Kept:
    """The bodies of the given indices, (slots, features) each."""
    rollers, n = model.rollers, len(model.circle_names)
    still = jnp.zeros((n - rollers.n_movable,))
    levers = jnp.zeros((n,)).at[rollers.free].set(rollers.radius[rollers.free])
    n_lines, c = len(model.lines.names), n

    def surface(values: Array) -> Array:
        parts = [(values[:c], circles), (values[c : c + n_lines], lines), (values[c + n_lines :], arcs)]
        rows = [pick(v, index) for v, index in parts if v.shape[0]] or [pick(values, None)]
        if all(r.shape[1] == 1 for r in rows):
            return jnp.concatenate(rows)
        width = model.layout.tail.shape[0]
        return jnp.concatenate([jnp.broadcast_to(r, (r.shape[0], width)) for r in rows])

    slot = has_slot = None
    if circles is not None:
        looked_up = n if model.sticks[0] else rollers.n
        hot = circles[None] == jnp.arange(looked_up, dtype=circles.dtype)[:, None, None]
        slot, has_slot = jnp.argmax(hot, axis=1), jnp.any(hot, axis=1)
    return Kept(
        circle_index=circles,
        line_index=lines,
        arc_index=arcs,
        radius=pick(model.circles.radius, circles),
        active=pick(model.circles.active, circles),
        travel_x=pick(jnp.concatenate([rollers.dir_x, still]), circles),
        travel_y=pick(jnp.concatenate([rollers.dir_y, still]), circles),
        spin_lever=pick(levers, circles),
        lines=jax.tree.map(lambda v: pick(v, lines), model.lines),
        arcs=jax.tree.map(lambda v: pick(v, arcs), model.arcs),
        surface=jax.tree.map(surface, model.surface),
        slot=slot,
        has_slot=has_slot,
    )


def sheet_contacts(model: Model, at: Pose, world: Bodies, kept: Kept, grip: Grip | None = None) -> Pairs:
    """The kept bodies against every feature of every sheet. Without a `grip`, friction is regularised everywhere."""
    row = features(model, at)
    near = _near(model, row, world, kept)
    rn = near.arm_x * near.ny - near.arm_y * near.nx
    rt = near.arm_x * near.nx + near.arm_y * near.ny - row.half_thickness
    v_n = near.nx * row.vx + near.ny * row.vy + row.w * rn - near.u_n
    v_t = near.nx * row.vy - near.ny * row.vx + row.w * rt - near.u_t
    raw = contact_law(kept.surface, -near.gap, v_n, v_t, row.friction_factor, grip)
    touch = Touch(*(near.weight * v for v in raw))
    # A face that turns under a circle moves the foot: dM/dtheta = -F (R + t/2). Its positive part, as all of it is.
    return Pairs(touch, near.gap, near.nx, near.ny, rn, rt, v_n, v_t, near.weight, touch.force * near.lever)


def _near(model: Model, row: Features, world: Bodies, kept: Kept) -> Closest:
    families = []
    if kept.n_circles:
        families.append(circles_near(model, row, world, kept))
    if model.lines.names and kept.lines is not None:
        families.append(lines_near(row, world, kept))
    if model.arcs.names and kept.arcs is not None:
        families.append(arcs_near(row, world, kept))
    if len(families) == 1:
        return families[0]
    return Closest(*(jnp.concatenate(v) for v in zip(*families, strict=True)))


def circles_near(model: Model, row: Features, world: Bodies, kept: Kept) -> Closest:
    """Bars (faces and end circles) against rollers, circle guides and tips."""
    rigid = Rigid(*(v[: kept.n_circles] for v in picked(tuple(world.circles), kept.circle_index)))
    near = chain_circle(_chain(model, row), rigid.x, rigid.y, kept.radius)
    return Closest(
        gap=near.gap - row.half_thickness,
        nx=near.nx,
        ny=near.ny,
        weight=near.weight * kept.active,
        arm_x=near.arm * row.c,
        arm_y=near.arm * row.s,
        u_n=near.nx * rigid.vx + near.ny * rigid.vy,
        u_t=near.nx * rigid.vy - near.ny * rigid.vx + rigid.w * kept.radius,
        lever=jnp.where(near.on_face, kept.radius + row.half_thickness, 0.0),
    )


def _chain(model: Model, row: Features) -> Chain:
    ahead, behind = ((jnp.roll(row.c, k, axis=1), jnp.roll(row.s, k, axis=1)) for k in (1, -1))
    layout = model.layout
    ends = (layout.first_feature[None, :], layout.last_feature[None, :], layout.tail[None, :])
    return Chain(row.x, row.y, row.c, row.s, row.half_length, ahead, behind, *ends)


def lines_near(row: Features, world: Bodies, kept: Kept) -> Closest:
    """End circles against line guides."""
    lines = kept.lines
    assert lines is not None
    if world.line_motion is not None:
        lines = jax.tree.map(lambda v: pick(v, kept.line_index), world.lines)
    px, py = _points(row)
    near = point_line(px, py, lines.x, lines.y, lines.tx, lines.ty, lines.length, lines.faces)
    return _end_circles(row, near, world.line_motion, kept.line_index)


def arcs_near(row: Features, world: Bodies, kept: Kept) -> Closest:
    """End circles against arc guides."""
    arcs = kept.arcs
    assert arcs is not None
    if world.arc_motion is not None:
        arcs = jax.tree.map(lambda v: pick(v, kept.arc_index), world.arcs)
    px, py = _points(row)
    mid, quarter = (arcs.mid_x, arcs.mid_y), (arcs.cos_quarter, arcs.sin_quarter)
    near = point_arc(px, py, arcs.x, arcs.y, arcs.radius, mid, quarter, arcs.side, arcs.faces)
    return _end_circles(row, near, world.arc_motion, kept.arc_index)


def _points(row: Features) -> tuple[Array, Array]:
    arm = row.end * row.half_length
    return row.x + arm * row.c, row.y + arm * row.s


def _end_circles(row: Features, near: Near, motion: Rigid | None, index: Array | None) -> Closest:
    """End circles against a guide's face; a moving guide lends its surface speed at the touched point."""
    arm = row.end * row.half_length
    u_n = u_t = zero = jnp.zeros_like(near.gap)
    if motion is not None:
        rigid = Rigid(*(pick(v, index) for v in motion))
        px, py = _points(row)
        rx, ry = px - row.half_thickness * near.nx - rigid.x, py - row.half_thickness * near.ny - rigid.y
        ux, uy = rigid.vx - rigid.w * ry, rigid.vy + rigid.w * rx
        u_n, u_t = near.nx * ux + near.ny * uy, near.nx * uy - near.ny * ux
    arms = (jnp.broadcast_to(arm * row.c, zero.shape), jnp.broadcast_to(arm * row.s, zero.shape))
    return Closest(near.gap - row.half_thickness, near.nx, near.ny, near.weight, *arms, u_n, u_t, zero)


def by_circle(kept: Kept, values: Array, count: int) -> Array:
    """(k, rows, features) of circles -> (k, count, features): the own row of each of the first circles, or the slot that
    holds it. Rollers are the first; all circles can be asked for only where circles stick."""
    if kept.slot is None or kept.has_slot is None:
        return values
    cut = slice(None if count == kept.slot.shape[0] else count)
    held = jnp.take_along_axis(values, kept.slot[None, cut], axis=1)
    return jnp.where(kept.has_slot[cut], held, 0.0)


class RollerPairs(NamedTuple):
    """Roller against roller, (pairs,): the normal pushes the first away from the second."""

    touch: Touch
    gap: Array
    nx: Array
    ny: Array
    v_n: Array
    v_t: Array


def roller_contacts(model: Model, world: Bodies) -> RollerPairs:
    """Rollers against each other: a pinch rests on its drive when no sheet is there. Their friction is regularised."""
    i, j = model.pair_index
    radius = model.rollers.radius
    both = jnp.stack([v[: model.rollers.n] for v in world.circles])[:, np.concatenate([i, j])]
    a, b = Rigid(*both[:, : len(i)]), Rigid(*both[:, len(i) :])
    near = point_circle(a.x, a.y, b.x, b.y, radius[j])
    gap = near.gap - radius[i]
    dvx, dvy = a.vx - b.vx, a.vy - b.vy
    v_n = near.nx * dvx + near.ny * dvy
    v_t = near.nx * dvy - near.ny * dvx - a.w * radius[i] - b.w * radius[j]
    return RollerPairs(contact_law(model.pair_surface, -gap, v_n, v_t, 1.0), gap, near.nx, near.ny, v_n, v_t)
