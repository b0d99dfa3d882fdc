"""The chain in O(bars): elimination from tail to lead, for long chains.

Each bar is eliminated by one scalar division: the cost of everything behind a joint is a quadratic function of the
joint's acceleration and of the turning of the bar in front (as in articulated-body dynamics). The implicit joint
spring couples two turnings; written as e h/(h + e) it loses no digits, so that card and tissue fare alike.
"""

import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.products import product
from diffeed.base.smooth import solve_positive
from diffeed.chain.system import Answer, System
from diffeed.model.layout import Layout


def respond(system: System, layout: Layout, sides: Array, border: Array) -> Answer:
    """Right-hand sides (sides, 3, bars) and (sides, border) -> accelerations. Side 0 carries the bias.

    The rollers' own unknowns follow from a small Schur complement.
    """
    if system.border is None:
        return Answer(*_chain(system, layout, sides), border)
    k, columns = sides.shape[0], system.border.columns
    found = _chain(system, layout, jnp.concatenate([sides, columns]))
    moved = product(jnp.stack(found, axis=1).reshape(k + columns.shape[0], -1), columns.reshape(columns.shape[0], -1).T)
    z = solve_positive(system.border.matrix() - moved[k:], (border - moved[:k]).T).T
    return Answer._make([*(v[:k] - product(z, v[k:]) for v in found), z])


def _chain(system: System, layout: Layout, sides: Array) -> tuple[Array, Array, Array]:
    """The chain alone: (columns, 3, bars) -> x, y, w, each (columns, bars). Column 0 carries the bias."""
    bars, lx, ly, bx, by = system.bars, system.lever_x, system.lever_y, system.bias_x, system.bias_y
    columns = sides.shape[0]
    biased = jnp.zeros((columns, 1), lx.dtype).at[0].set(1.0)
    # Move blocks and right-hand sides from the centre to the front node.
    xw, yw = bars.xw + bars.xx * lx + bars.xy * ly, bars.yw + bars.xy * lx + bars.yy * ly
    ww = bars.ww + lx * (bars.xw + xw) + ly * (bars.yw + yw)
    fx = sides[:, 0] - biased * (bars.xx * bx + bars.xy * by)[None]
    fy = sides[:, 1] - biased * (bars.xy * bx + bars.yy * by)[None]
    fw = sides[:, 2] - biased * (bars.xw * bx + bars.yw * by)[None] + lx[None] * fx + ly[None] * fy
    front = jnp.roll(system.coupling, 1)
    joined = jnp.asarray(~layout.first, lx.dtype)
    rows = (bars.xx, bars.xy, bars.yy, xw, yw, ww, 2.0 * lx, 2.0 * ly, 2.0 * bx, 2.0 * by, front, joined)
    table = jnp.concatenate([jnp.stack(rows, axis=1), fx.T, fy.T, fw.T], axis=1)
    start = jnp.zeros((6 + 3 * columns,), lx.dtype)
    _, (gains, heads) = lax.scan(_eliminate_bar(columns), start, table, reverse=True, unroll=2)
    lead = _lead_acceleration(heads, columns)
    way = jnp.concatenate([gains, table[:, 6:10], table[:, 11:12], lead], axis=1)
    _, out = lax.scan(_place_bar(columns), jnp.zeros((3 * columns,), lx.dtype), way, unroll=2)
    p, w = out[:, : 2 * columns], out[:, 2 * columns :].T
    x = p[:, :columns].T + lx[None] * w + biased * bx[None]
    y = p[:, columns:].T + ly[None] * w + biased * by[None]
    return x, y, w


def _eliminate_bar(columns: int):
    """Body of the backward scan. Carry: the quadratic (xx, xy, yy, xw, yw, ww) and its linear part, one per column."""
    biased = [1.0] + [0.0] * (columns - 1)

    def body(carry: Array, row: Array) -> tuple[Array, tuple[Array, Array]]:
        qxx, qxy, qyy, qxw, qyw, qww = carry[:6]
        rx, ry, rw = carry[6:].reshape(3, columns)
        axx, axy, ayy, axw, ayw, aww, lx, ly, bx, by, e, joined = row[:12]
        fx, fy, fw = row[12:].reshape(3, columns)
        first = jnp.asarray(biased, row.dtype)
        rx = rx - first * (qxx * bx + qxy * by)
        ry = ry - first * (qxy * bx + qyy * by)
        rw = rw - first * (qxw * bx + qyw * by) + lx * rx + ly * ry
        hx, hy = qxw + qxx * lx + qxy * ly, qyw + qxy * lx + qyy * ly
        hw = aww + qww + lx * (qxw + hx) + ly * (qyw + hy)
        hx, hy = axw + hx, ayw + hy
        gx, gy, gw = fx + rx, fy + ry, fw + rw
        scale = 1.0 / (hw + e)
        kx, ky, ke, kf = hx * scale, hy * scale, e * scale, gw * scale
        quadratic = [axx + qxx - hx * kx, axy + qxy - hx * ky, ayy + qyy - hy * ky, hx * ke, hy * ke, hw * ke]
        after = jnp.concatenate([jnp.stack(quadratic), gx - hx * kf, gy - hy * kf, e * kf])
        return joined * after, (jnp.concatenate([jnp.stack([kx, ky, ke]), kf]), after[: 6 + 2 * columns])

    return body


def _lead_acceleration(heads: Array, columns: int) -> Array:
    """(bars, 2 columns): acceleration of each bar's front node if it led a sheet: the 2 x 2 solve."""
    xx, xy, yy = heads[:, 0:1], heads[:, 1:2], heads[:, 2:3]
    rx, ry = heads[:, 6 : 6 + columns], heads[:, 6 + columns :]
    scale = 1.0 / (xx * yy - xy * xy)
    return jnp.concatenate([(yy * rx - xy * ry) * scale, (xx * ry - xy * rx) * scale], axis=1)


def _place_bar(columns: int):
    """Body of the forward scan. Carry: acceleration of the next front node (x, y) and turning of the bar before."""
    biased = [1.0] + [0.0] * (columns - 1)

    def body(carry: Array, row: Array) -> tuple[Array, Array]:
        px, py, turn = carry.reshape(3, columns)
        kx, ky, ke = row[:3]
        kf = row[3 : 3 + columns]
        lx, ly, bx, by, joined = row[3 + columns : 8 + columns]
        lead = row[8 + columns :].reshape(2, columns)
        px = jnp.where(joined > 0, px, lead[0])
        py = jnp.where(joined > 0, py, lead[1])
        w = kf + joined * ke * turn - kx * px - ky * py
        first = jnp.asarray(biased, row.dtype)
        after = jnp.concatenate([px + lx * w + first * bx, py + ly * w + first * by, w])
        return after, jnp.concatenate([px, py, w])

    return body
