"""Contact sweep: what the law says of the pairs that are near.

Bodies stand along one axis (rollers, circle guides, tips, then line and arc guides), features of the sheets along the next:
(bodies, features). Or pairs stand one after the other, (pairs,): of circles, then of guides.
"""

from typing import NamedTuple

import jax
from jax import Array

from diffeed.base.once import computed_once, derived_once
from diffeed.base.smooth import polar
from diffeed.chain.kinematics import Pose
from diffeed.contact.bodies import Bodies
from diffeed.contact.features import Lever, Listed, blend, features
from diffeed.contact.kept import Kept
from diffeed.contact.near import nearest
from diffeed.model.arrays import Model
from diffeed.pair.law import Grip, Touch, contact_law


class Pairs(NamedTuple):
    """Evaluated pairs, (bodies, features) or (pairs,). Forces carry the pair's weight already.

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


def sheet_contacts(model: Model, at: Pose, world: Bodies, kept: Kept, grip: Grip | None = None) -> Pairs:
    """The kept pairs. Without a `grip`, friction is regularised everywhere."""
    rows = features(model, at, kept.pairs)
    near, half_thickness = nearest(rows, world, kept), rows[-1].own.half_thickness
    near = derived_once(near)
    levers, away, along = [], [], []
    for row, place in zip(rows, near.places, strict=True):
        rn = place.arm_x * near.ny - place.arm_y * near.nx
        rt = place.arm_x * near.nx + place.arm_y * near.ny - half_thickness
        levers.append(Lever(place.share, rn, rt))
        away.append(near.nx * row.vx + near.ny * row.vy + row.w * rn)
        along.append(near.nx * row.vy - near.ny * row.vx + row.w * rt)
    v_n, v_t = blend(levers, away) - near.u_n, blend(levers, along) - near.u_t
    raw = contact_law(kept.surface, -near.gap, v_n, v_t, rows[-1].own.friction_factor, grip)
    sticks = grip is not None and kept.surface.stick is not None
    touch = jax.tree.map(lambda v: near.weight * v, _once(raw, v_t, sticks))
    # What turns under a circle moves the foot: dM/dtheta = -F (R + t/2). Its positive part, as all of it is. The skin turns
    # with the headings of its two bars by their shares.
    turning = touch.force * near.lever
    moving = (v_n, v_t, near.u_n, near.u_t)
    return Pairs(touch, near.gap, near.nx, near.ny, tuple(levers), *moving, near.weight, turning)


def _once(touch: Touch, v_t: Array, sticks: bool) -> Touch:
    """The law is computed once for all that reads it. Where nothing sticks, friction is but a product of what was."""
    if touch.secant is None or sticks:
        return computed_once(touch)
    force, stiffness, damping, secant = computed_once((touch.force, touch.stiffness, touch.damping, touch.secant))
    return Touch(force, stiffness, damping, secant * v_t, secant)


def heading(model: Model, at: Pose, pairs: Pairs, listed: Listed | None) -> tuple[Array, Array]:
    """Cosine and sine of the direction of travel where pairs touch: the bar's, or the tangent of the smooth skin; of a shape that
    meets that of the pairs."""
    rows = features(model, at, listed)
    if len(rows) == 1:
        return rows[0].c, rows[0].s
    c, s = (blend(pairs.levers, values) for values in ([r.c for r in rows], [r.s for r in rows]))
    return polar(c, s)[1:]
