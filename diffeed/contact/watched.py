"""What becomes of pairs that a search left out: by how much their gaps can have shrunk."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose, nodes
from diffeed.contact.bodies import Bodies
from diffeed.contact.features import features
from diffeed.contact.kept import Kept, kept_guides
from diffeed.contact.near import Closest, felt_points, hulls_near
from diffeed.model.arrays import Guides, Model
from diffeed.pair.shapes import JOIN_WINDOW, point_face


class Watched(NamedTuple):
    """Pairs of a family as a search saw them, (bodies, features) each; a gap is infinite where the pair is listed."""

    gap: Array  # mm
    nx: Array
    ny: Array
    # The normal leads away from the body; else (behind a thin guide) either way may lead towards it.
    straight: Array
    body: Array  # (bodies, 1) which of its family it is
    # mm from where a guide's motion is told to where the pair is nearest; None: circles.
    arm: tuple[Array, Array] | None
    bend: Array | float  # 1/mm by which a gap closes as the square of the way along a hollow body


class Moved(NamedTuple):
    """What bodies of a family do, (bodies,): speeds, or ways. A guide turns about the place that stands for it."""

    x: Array
    y: Array
    turn: Array | None  # None: circles, whose turning brings nothing nearer


def speeds(world: Bodies) -> dict[str, Moved | None]:
    """Of all families, mm/s and rad/s; None: they stand still."""
    motion = world.guide_motion
    guides = None if motion is None else Moved(motion.vx, motion.vy, motion.w)
    return {"circles": Moved(world.circles.vx, world.circles.vy, None), "guides": guides}


def ways(then: Bodies, now: Bodies) -> dict[str, Moved | None]:
    """Of all families, mm and rad, from one time to another."""
    circles = Moved(now.circles.x - then.circles.x, now.circles.y - then.circles.y, None)
    a, b = then.guides, now.guides
    still = then.guide_motion is None
    guides = None if still else Moved(b.x - a.x, b.y - a.y, a.tx * b.ty - a.ty * b.tx)
    return {"circles": circles, "guides": guides}


def watch(model: Model, at: Pose, world: Bodies, near: Closest, kept: Kept, family: str) -> Watched:
    """The pairs of a family with the way that each has before it touches."""
    index = kept.circle_index if family == "circles" else kept.guide_index
    body = jnp.arange(near.gap.shape[0], dtype=jnp.int32)[:, None] if index is None else index
    if family == "circles":
        smooth = model.skin == "smooth"
        gap, nx, ny = hulls_near(features(model, at), world, kept) if smooth else (near.gap, near.nx, near.ny)
        gap = jnp.where(kept.active > 0, gap, jnp.inf)
        return Watched(gap, nx, ny, jnp.ones(gap.shape, bool), body, None, 0.0)
    guides = kept_guides(world.guides, index)
    felt, far, nx, ny = near.weight > 0, near.gap, near.nx, near.ny
    # Behind a thin guide a sheet is felt again as soon as it is within `depth` of the face.
    gap = far - jnp.where(felt, 0.0, guides.faces.depth)
    past, out_x, out_y = _past_joined_ends(model, at, guides)
    better = ~felt & (past > gap)
    gap, far, nx, ny = (jnp.where(better, *v) for v in ((past, gap), (past, far), (out_x, nx), (out_y, ny)))
    x, y = nodes(model, at)
    arm = x[None, :] - nx * far - world.guides.x[body], y[None, :] - ny * far - world.guides.y[body]
    # A way along the inside of an arc of radius R leads outwards by its square over 2 R, twice that from half as far out.
    bend = 0.0 if guides.bend is None else jnp.maximum(guides.bend.curvature, 0.0)
    return Watched(gap, nx, ny, felt | better, body, arm, bend)


def _past_joined_ends(model: Model, at: Pose, guides: Guides) -> tuple[Array, Array, Array]:
    """How far beyond the ends that another guide takes over points of the sheets are, (guides, features), and which way leads
    out: until they are back at the end a line is not felt, in front of it or behind. Not of arcs, past whose ends a point may
    come fast, near the centre."""
    px, py = felt_points(features(model, at))
    beyond = point_face(px, py, *guides.shape).beyond
    first, second = (
        jnp.where(joined > 0, past - JOIN_WINDOW, -jnp.inf)
        for past, joined in zip(beyond, guides.faces.joined, strict=True)
    )
    past, out = jnp.maximum(first, second), jnp.where(first > second, -1.0, 1.0)
    if guides.bend is not None:
        past = jnp.where(guides.bend.curvature == 0.0, past, -jnp.inf)
    return past, out * guides.tx, out * guides.ty


def approach(model: Model, seen: Watched, moved: tuple[Array, Array], bodies_moved: Moved | None) -> Array:
    """By how much gaps shrink as nodes and bodies move, (bodies, features): by speeds (mm/s) or ways (mm).

    What touches lies between some nodes, so it comes no nearer along a normal than the one that comes nearest.
    """
    x, y = moved[0][None, :], moved[1][None, :]
    from_body = jnp.zeros(())
    if bodies_moved is not None:
        bx, by, turn = bodies_moved.x[seen.body], bodies_moved.y[seen.body], bodies_moved.turn
        if turn is not None and seen.arm is not None:
            bx, by = bx - turn[seen.body] * seen.arm[1], by + turn[seen.body] * seen.arm[0]
        from_body = seen.nx * bx + seen.ny * by
    ends = [(x, y)]
    if model.skin == "smooth" or seen.arm is None:
        ends.append((_behind(model, x), _behind(model, y)))  # a bar's rear node
    if model.skin == "smooth":
        ends.append((_in_front(model, x), _in_front(model, y)))
    nearer = [from_body - (seen.nx * dx + seen.ny * dy) for dx, dy in ends]
    either = functools.reduce(jnp.maximum, [jnp.abs(v) for v in nearer])
    return jnp.where(seen.straight, functools.reduce(jnp.maximum, nearer), either)


def _behind(model: Model, values: Array) -> Array:
    """(1, features) of each feature's node -> of the node behind it in its sheet; a tail's own."""
    return jnp.where(model.layout.tail[None, :], values, jnp.roll(values, -1, axis=1))


def _in_front(model: Model, values: Array) -> Array:
    """The same of the node in front; a lead's own."""
    return jnp.where(model.layout.first_feature[None, :], values, jnp.roll(values, 1, axis=1))


def used_up(model: Model, seen: Watched, way: tuple[Array, Array], motion: Moved | None) -> Array:
    """Whether pairs may have come to touch, (bodies, features): by the way along the normal, and by what that leaves out in
    second order: a way along a hollow arc or a guide that turns, and the turn of a long arm."""
    nearer, furthest = approach(model, seen, way, motion), jnp.max(jnp.abs(way[0]) + jnp.abs(way[1]))
    nearer = nearer + seen.bend * furthest**2
    if motion is not None and motion.turn is not None and seen.arm is not None:
        turn = jnp.abs(motion.turn)[seen.body]
        nearer = nearer + turn * (furthest + 0.5 * turn * (jnp.abs(seen.arm[0]) + jnp.abs(seen.arm[1])))
    return nearer > seen.gap
