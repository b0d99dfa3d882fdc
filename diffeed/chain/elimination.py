"""The chain in O(bars): elimination from tail to lead.

Each bar is eliminated by one scalar division: the cost of everything behind a joint is a quadratic function of the
joint's acceleration and of the turning of the bar in front (as in articulated-body dynamics). The implicit joint
spring couples two turnings; written as e h/(h + e) it loses no digits, so that card and tissue fare alike.

In three passes: what the bars alone decide, from tail to lead; all right-hand sides, those of the border among them, likewise;
and the answers, from lead to tail, once the border is solved. Between the last two no column of the border needs to be
carried to the tail, for what columns and sides share is the sum over the bars of what each pass left there.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.products import SIDE_BY_SIDE, product
from diffeed.base.smooth import solve_positive
from diffeed.chain.sums import running
from diffeed.chain.system import Answer, System
from diffeed.model.layout import Layout


def respond(system: System, layout: Layout, sides: Array, border: Array) -> Answer:
    """Right-hand sides (sides, 3, bars) and (sides, border) -> accelerations. Side 0 carries the bias.

    The rollers' own unknowns follow from a small Schur complement.
    """
    k, beside, lever = sides.shape[0], system.border, (system.lever_x, system.lever_y)
    m = border.shape[1]
    # What centres do if nothing turns any faster: sums of what each joint adds to the one in front.
    bias_x, bias_y = running(layout, 2.0 * jnp.stack([system.bias_x, system.bias_y]))
    given = jnp.concatenate([sides[:1] - system.bars.pull(bias_x, bias_y)[None], sides[1:]])
    if beside is not None:
        nothing = jnp.zeros((-(k + m) % SIDE_BY_SIDE, *given.shape[1:]), given.dtype)
        given = jnp.concatenate([given, beside.columns, nothing])
    chain = _factored(system, layout)
    left = _carried(chain, layout, lever, given)
    z = border
    if beside is not None:
        own = slice(k, k + m)
        shared = product(left.pushed[:, own].T, left.turned) + product(left.lead_force[:, own].T, left.lead)
        mine = jnp.sum(beside.columns[:, 0] * bias_x[None] + beside.columns[:, 1] * bias_y[None], axis=1)
        known = jnp.concatenate([(border[:1] - mine[None]).T, border[1:].T], axis=1) - shared[:, :k]
        z = solve_positive(beside.matrix() - shared[:, own], known).T
        left = left._replace(
            turned=left.turned[:, :k] - product(left.turned[:, own], z.T),
            lead=left.lead[:, :k] - product(left.lead[:, own], z.T),
        )
    x, y, w = _placed(chain, layout, lever, left)
    first = jnp.asarray(np.arange(k) == 0, x.dtype)[:, None]
    return Answer(x + first * bias_x[None], y + first * bias_y[None], w, z)


class Chain(NamedTuple):
    """What the bars alone decide; (bars,) each. A bar's turning is eliminated with the acceleration of its front node given."""

    to_x: Array  # what the turning has with the acceleration of the front node
    to_y: Array
    scale: Array  # one over what the turning has with itself
    spring: Array  # implicit stiffness of the joint in front
    joined: Array  # 1.0, and 0.0 where a sheet begins
    xx: Array  # of all from this bar on, its turning eliminated, for its front node
    xy: Array
    yy: Array


class Left(NamedTuple):
    """Of every side what is left to do, (bars, sides) and (leads, sides) for x, then for y."""

    pushed: Array  # right-hand side of each turning
    turned: Array  # the turning, with the front node and the bar in front at rest
    lead_force: Array  # right-hand side of the leads
    lead: Array  # acceleration of the leads


def _factored(system: System, layout: Layout) -> Chain:
    bars, lx, ly = system.bars, system.lever_x, system.lever_y
    # Blocks moved from the centre to the front node.
    xw, yw = bars.xw + bars.xx * lx + bars.xy * ly, bars.yw + bars.xy * lx + bars.yy * ly
    ww = bars.ww + lx * (bars.xw + xw) + ly * (bars.yw + yw)
    spring, joined = jnp.roll(system.coupling, 1), jnp.asarray(~layout.first, lx.dtype)

    def bar(behind: tuple[Array, ...], row: tuple[Array, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        qxx, qxy, qyy, qxw, qyw, qww = behind
        axx, axy, ayy, axw, ayw, aww, lx, ly, e, joined = row
        sx, sy = qxx * lx + qxy * ly, qxy * lx + qyy * ly
        hx, hy = axw + qxw + sx, ayw + qyw + sy
        hw = aww + qww + lx * (2.0 * qxw + sx) + ly * (2.0 * qyw + sy)
        scale = 1.0 / (hw + e)
        kx, ky, ke = hx * scale, hy * scale, e * scale
        xx, xy, yy = axx + qxx - hx * kx, axy + qxy - hx * ky, ayy + qyy - hy * ky
        on = (joined * xx, joined * xy, joined * yy, joined * hx * ke, joined * hy * ke, joined * hw * ke)
        return on, (hx, hy, scale, xx, xy, yy)

    rows = (bars.xx, bars.xy, bars.yy, xw, yw, ww, 2.0 * lx, 2.0 * ly, spring, joined)
    nothing = (jnp.zeros((), lx.dtype),) * 6
    hx, hy, scale, xx, xy, yy = lax.scan(bar, nothing, rows, reverse=True)[1]
    return Chain(hx, hy, scale, spring, joined, xx, xy, yy)


def _carried(chain: Chain, layout: Layout, lever: tuple[Array, Array], sides: Array) -> Left:
    """All sides, (sides, 3, bars), from the tails to the leads."""
    lx, ly = lever
    fx, fy = sides[:, 0], sides[:, 1]
    fw = sides[:, 2] + lx[None] * fx + ly[None] * fy
    many = len(layout.bars) > 1

    def bar(behind: tuple[Array, ...], row: tuple[Array, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        rx, ry, rw = behind
        fx, fy, fw, lx, ly, hx, hy, scale, e, joined = row
        gx, gy, pushed = fx + rx, fy + ry, fw + rw + lx * rx + ly * ry
        turned = pushed * scale
        x, y = gx - hx * turned, gy - hy * turned
        if not many:  # of one sheet the last is the lead
            return (x, y, e * turned), (pushed, turned)
        return (joined * x, joined * y, joined * e * turned), (pushed, turned, x, y)

    rows = (fx.T, fy.T, fw.T, 2.0 * lx, 2.0 * ly, chain.to_x, chain.to_y, chain.scale, chain.spring, chain.joined)
    nothing = (jnp.zeros((sides.shape[0],), lx.dtype),) * 3
    (x, y, _), (pushed, turned, *of_bars) = lax.scan(bar, nothing, rows, reverse=True)
    starts = np.array(layout.starts[:-1])
    x, y = (v[starts] for v in of_bars) if many else (x[None], y[None])
    xx, xy, yy = (v[starts][:, None] for v in (chain.xx, chain.xy, chain.yy))
    scale = 1.0 / (xx * yy - xy * xy)
    lead = jnp.concatenate([(yy * x - xy * y) * scale, (xx * y - xy * x) * scale])
    return Left(pushed, turned, jnp.concatenate([x, y]), lead)


def _placed(chain: Chain, layout: Layout, lever: tuple[Array, Array], left: Left) -> tuple[Array, Array, Array]:
    """Accelerations of the centres and turnings, (sides, bars) each, from the leads to the tails."""
    (lx, ly), n_sheets, many = lever, len(layout.bars), len(layout.bars) > 1

    def bar(front: tuple[Array, ...], row: tuple[Array, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        px, py, turn = front
        turned, kx, ky, ke, lx, ly, *start = row
        if many:
            joined, lead_x, lead_y = start
            px, py = jnp.where(joined > 0, px, lead_x), jnp.where(joined > 0, py, lead_y)
        w = turned + ke * turn - kx * px - ky * py
        return (px + lx * w, py + ly * w, w), (px, py, w)

    by = chain.scale
    rows = [left.turned, chain.to_x * by, chain.to_y * by, chain.joined * chain.spring * by, 2.0 * lx, 2.0 * ly]
    if many:
        rows += [chain.joined, left.lead[layout.sheet_of_bar], left.lead[n_sheets + layout.sheet_of_bar]]
    begin = (left.lead[0], left.lead[n_sheets], jnp.zeros_like(left.lead[0]))
    px, py, w = (v.T for v in lax.scan(bar, begin, tuple(rows))[1])
    return px + lx[None] * w, py + ly[None] * w, w
