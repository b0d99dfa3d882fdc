"""Where features and bodies are closest, and how fast the body's surface moves there. Geometry from `diffeed.pair`.

To add a guide shape: tell `point_face` in `pair/shapes.py` of it, and `model/guides.py` how a record becomes it; law, sums and
solver do not change.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.contact.bodies import Bodies, Rigid
from diffeed.contact.features import Features, Place, blend
from diffeed.contact.kept import Kept, in_rows, kept_guides, part, picked
from diffeed.pair.shapes import Chain, Near, chain_circle, point_face, round_ends
from diffeed.pair.skin import Pieces, hull_circle, piece_circle, touched


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


def nearest(rows: tuple[Features, ...], world: Bodies, kept: Kept) -> Closest:
    """The skin against all kept bodies, in their order."""
    families = []
    n = kept.n_circles
    if n:
        families.append(circles_near(part(rows, kept.pairs, slice(n)), world, kept))
    if kept.guides is not None:
        families.append(guides_near(part(rows, kept.pairs, slice(n, None)), world, kept))
    return in_rows(families)


def circles_near(rows: tuple[Features, ...], world: Bodies, kept: Kept) -> Closest:
    """The skin against rollers, circle guides and tips."""
    rigid = Rigid(*(v[: kept.n_circles] for v in picked(tuple(world.circles), kept.circle_index)))
    half_thickness = rows[-1].own.half_thickness
    reach = kept.radius + half_thickness
    if len(rows) == 1:
        (row,) = rows
        near = chain_circle(_chain(row), rigid.x, rigid.y, kept.radius)
        places, lever = (Place(None, near.arm * row.c, near.arm * row.s),), jnp.where(near.on_face, reach, 0.0)
    else:
        near = piece_circle(_pieces(*rows), rigid.x, rigid.y, kept.radius)
        places, lever = _places(rows, near.u), near.run * reach
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


def hulls_near(rows: tuple[Features, ...], world: Bodies, kept: Kept) -> tuple[Array, Array, Array]:
    """Gap and normal, (circles, features), from circles to what holds the pieces of the smooth skin."""
    x, y = picked((world.circles.x, world.circles.y), kept.circle_index)
    gap, nx, ny = hull_circle(_pieces(*rows), x, y, kept.radius)
    return gap - rows[-1].own.half_thickness, nx, ny


def _chain(row: Features) -> Chain:
    own = row.own
    return Chain(
        row.x, row.y, row.c, row.s, own.half_length, row.ahead, row.behind, own.first, own.last, own.tail
    )  # fmt: skip


def _pieces(front: Features, behind: Features) -> Pieces:
    """The curve at each node, between the middles of the bars in front and behind; at lead and tail from the node itself."""
    lead, tail, whole = front.own.first, front.own.tail, front.own.half_length
    half = jnp.where(lead | tail, -0.5, -1.0) * whole
    out, back = jnp.where(lead, whole, 0.0), half
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


def _places(rows: tuple[Features, ...], u: Array) -> tuple[Place, ...]:
    """Where the point u of the smooth skin's pieces hangs on the bar in front and on the bar behind."""
    front, behind = (row.own for row in rows)
    found = touched(u, front.half_length, behind.half_length, front.first, front.tail)
    return tuple(Place(f.share, f.arm * row.c, f.arm * row.s) for f, row in zip(found, rows, strict=True))


def guides_near(rows: tuple[Features, ...], world: Bodies, kept: Kept) -> Closest:
    """End circles, or points of the smooth skin, against line and arc guides."""
    places, guides, moving = _samples(rows), kept.guides, world.guide_motion
    assert guides is not None, "only where there are some"
    if moving is not None:
        guides = kept_guides(world.guides, kept.guide_index)
        moving = Rigid(*picked(tuple(moving), kept.guide_index))
    px, py = _points(rows, places)
    faced = point_face(px, py, *guides.shape)
    return _end_circles(rows, places, round_ends(px, py, faced, guides.faces), moving)


def felt_points(rows: tuple[Features, ...]) -> tuple[Array, Array]:
    """The points of the sheets that guides feel, like the rows: the nodes, or the middles of the smooth skin's pieces and the
    sheets' ends."""
    return _points(rows, _samples(rows))


def _samples(rows: tuple[Features, ...]) -> tuple[Place, ...]:
    """Where those points are on the bars."""
    if len(rows) == 1:
        (row,) = rows
        arm = row.own.end * row.own.half_length
        return (Place(None, arm * row.c, arm * row.s),)
    own, dtype = rows[0].own, rows[0].x.dtype
    middle = jnp.where(own.first, 0.0, jnp.where(own.tail, 1.0, 0.5))
    return _places(rows, middle.astype(dtype))


def _points(rows: tuple[Features, ...], places: tuple[Place, ...]) -> tuple[Array, Array]:
    x = [row.x + place.arm_x for row, place in zip(rows, places, strict=True)]
    y = [row.y + place.arm_y for row, place in zip(rows, places, strict=True)]
    return blend(places, x), blend(places, y)


def _end_circles(rows: tuple[Features, ...], places: tuple[Place, ...], near: Near, motion: Rigid | None) -> Closest:
    """Circles around points of the sheets against guides; a moving guide lends its surface speed at the touched point."""
    u_n = u_t = zero = jnp.zeros_like(near.gap)
    half_thickness = rows[-1].own.half_thickness
    if motion is not None:
        px, py = _points(rows, places)
        rx, ry = px - half_thickness * near.nx - motion.x, py - half_thickness * near.ny - motion.y
        ux, uy = motion.vx - motion.w * ry, motion.vy + motion.w * rx
        u_n, u_t = near.nx * ux + near.ny * uy, near.nx * uy - near.ny * ux
    places = jax.tree.map(lambda v: jnp.broadcast_to(v, zero.shape), places)
    return Closest(near.gap - half_thickness, near.nx, near.ny, near.weight, places, u_n, u_t, zero)
