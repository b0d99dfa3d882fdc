"""The chain as one dense symmetric matrix: fastest for short chains.

Unknowns: acceleration of each sheet's lead and the turning of every bar. The matrix needs no products of Jacobians: with
l_j the acceleration of what lies behind bar j per unit of its turning, and v_k the impulse that turning bar k asks of
everything in front, its entries are l_j . v_k for j before k. `v` comes from running sums over the bars behind.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_factor, cho_solve

from diffeed.model import Layout
from diffeed.system import System


def respond(system: System, layout: Layout, sides: Array) -> tuple[Array, Array, Array]:
    """(columns, 3, bars) right-hand sides -> accelerations x, y, w, each (columns, bars). Column 0 carries the bias."""
    n_sheets = len(layout.bars)
    lx, ly = 2.0 * system.lever_x, 2.0 * system.lever_y
    bias_x, bias_y = _centres(layout, system.bias_x[None], system.bias_y[None])
    sides = sides.at[0].add(-_pull(system, bias_x[0], bias_y[0]))
    matrix = _matrix(system, layout, lx, ly)
    y = cho_solve(cho_factor(matrix, lower=True), _gather(layout, sides, lx, ly).T).T
    lead_x, lead_y, w = y[:, :n_sheets], y[:, n_sheets : 2 * n_sheets], y[:, 2 * n_sheets :]
    x, y = _centres(layout, system.lever_x[None] * w, system.lever_y[None] * w)
    x, y = x + lead_x[:, layout.sheet_of_bar], y + lead_y[:, layout.sheet_of_bar]
    return x.at[0].add(bias_x[0]), y.at[0].add(bias_y[0]), w


def _pull(system: System, x: Array, y: Array) -> Array:
    """(3, bars): what the blocks answer to accelerations of the centres."""
    b = system.bars
    return jnp.stack([b.xx * x + b.xy * y, b.xy * x + b.yy * y, b.xw * x + b.yw * y])


def _centres(layout: Layout, half_x: Array, half_y: Array) -> tuple[Array, Array]:
    """(columns, bars) half steps from front node to rear node -> sums from the lead to each centre, sheet by sheet."""
    along = np.tril(2.0 * np.ones((layout.n_bars,) * 2), -1) + np.eye(layout.n_bars)
    table = jnp.asarray(along * _same_sheet(layout), half_x.dtype).T
    return half_x @ table, half_y @ table


def _same_sheet(layout: Layout) -> np.ndarray:
    return layout.sheet_of_bar[:, None] == layout.sheet_of_bar[None, :]


def _behind(layout: Layout, values: Array) -> Array:
    """(rows, bars) -> half of each bar's own plus all of those behind it in its sheet."""
    table = (np.tril(np.ones((layout.n_bars,) * 2), -1) + 0.5 * np.eye(layout.n_bars)) * _same_sheet(layout)
    return values @ jnp.asarray(table, values.dtype)


def _per_sheet(layout: Layout, dtype: np.dtype) -> Array:
    """(bars, sheets) 1 where the bar belongs to the sheet."""
    return jnp.asarray(layout.sheet_of_bar[:, None] == np.arange(len(layout.bars))[None, :], dtype)


def _matrix(system: System, layout: Layout, lx: Array, ly: Array) -> Array:
    b, e, n = system.bars, system.coupling, layout.n_bars
    hxx, hxy, hyy = _behind(layout, jnp.stack([b.xx, b.xy, b.yy]))
    vx, vy = hxx * lx + hxy * ly + b.xw, hxy * lx + hyy * ly + b.yw
    before = jnp.asarray(np.triu(np.ones((n, n)), 1) * _same_sheet(layout), lx.dtype)
    upper = before * (lx[:, None] * vx[None, :] + ly[:, None] * vy[None, :])
    # The bar itself: a quarter of its own block instead of the half that `behind` holds.
    own = b.ww + lx * (vx - 0.25 * (b.xx * lx + b.xy * ly)) + ly * (vy - 0.25 * (b.xy * lx + b.yy * ly))
    upper = upper - jnp.diag(e[:-1], 1)
    turning = upper + upper.T + jnp.diag(own + e + jnp.roll(e, 1))
    member = _per_sheet(layout, lx.dtype)
    lead = jnp.concatenate([(vx[:, None] * member).T, (vy[:, None] * member).T])
    xx, xy, yy = (jnp.diag(v @ member) for v in (b.xx, b.xy, b.yy))
    return jnp.block([[jnp.block([[xx, xy], [xy, yy]]), lead], [lead.T, turning]])


def _gather(layout: Layout, sides: Array, lx: Array, ly: Array) -> Array:
    """(columns, 3, bars) on bars -> (columns, 2 sheets + bars) on leads and turnings."""
    member = _per_sheet(layout, lx.dtype)
    fx, fy, fw = sides[:, 0], sides[:, 1], sides[:, 2]
    turning = fw + lx[None] * _behind(layout, fx) + ly[None] * _behind(layout, fy)
    return jnp.concatenate([fx @ member, fy @ member, turning], axis=1)
