"""Chain and rollers as one dense positive matrix: fastest for short chains.

Unknowns: acceleration of each sheet's lead, the turning of every bar, then the border. The matrix needs no products of
Jacobians: with l_j the acceleration of what lies behind bar j per unit of its turning, and v_k the impulse that turning
bar k asks of everything in front, its entries are l_j . v_k for j before k. `v` comes from sums over the bars behind.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.model import Layout
from diffeed.smooth import solve_positive
from diffeed.sums import apply, before, membership, same_sheet
from diffeed.system import Answer, System


def respond(system: System, layout: Layout, sides: Array, border: Array) -> Answer:
    """Right-hand sides (sides, 3, bars) and (sides, border) -> accelerations. Side 0 carries the bias."""
    k, n_sheets = sides.shape[0], len(layout.bars)
    lx, ly = 2.0 * system.lever_x, 2.0 * system.lever_y
    bias_x, bias_y = _centres(layout, jnp.stack([system.bias_x, system.bias_y]))
    sides = sides.at[0].add(-_pull(system, bias_x, bias_y))
    matrix = _matrix(system, layout, lx, ly)
    if system.border is None:
        gathered = _gather(layout, sides, lx, ly)
    else:
        columns = system.border.columns
        both = _gather(layout, jnp.concatenate([sides, columns]), lx, ly)
        gathered, coupling = both[:k], both[k:]
        matrix = _joined(matrix, coupling, system.border.matrix)
        bias = jnp.concatenate([bias_x, bias_y]) @ columns[:, :2].reshape(columns.shape[0], -1).T
        gathered = jnp.concatenate([gathered, border.at[0].add(-bias)], axis=1)
    found = solve_positive(matrix, gathered.T).T
    lead_x, lead_y, w, rest = jnp.split(found, (n_sheets, 2 * n_sheets, 2 * n_sheets + layout.n_bars), axis=1)
    turned = _centres(layout, jnp.concatenate([system.lever_x[None] * w, system.lever_y[None] * w]))
    x, y = turned[:k] + lead_x[:, layout.sheet_of_bar], turned[k:] + lead_y[:, layout.sheet_of_bar]
    return Answer(x.at[0].add(bias_x), y.at[0].add(bias_y), w, rest)


def _pull(system: System, x: Array, y: Array) -> Array:
    """(3, bars): what the blocks answer to accelerations of the centres."""
    b = system.bars
    return jnp.stack([b.xx * x + b.xy * y, b.xy * x + b.yy * y, b.xw * x + b.yw * y])


def _centres(layout: Layout, halves: Array) -> Array:
    """(k, bars) half steps from front node to rear node -> sums from the lead to each centre, sheet by sheet."""
    return apply(halves, 2.0 * before(layout))


def _totals(layout: Layout, values: Array) -> tuple[Array, Array]:
    """(k, bars) -> (k, bars) half of each bar's own plus all behind it, and (k, sheets) totals: one product."""
    both = apply(values, np.concatenate([before(layout).T, membership(layout)], axis=1))
    return both[:, : layout.n_bars], both[:, layout.n_bars :]


def _matrix(system: System, layout: Layout, lx: Array, ly: Array) -> Array:
    b, e, n = system.bars, system.coupling, layout.n_bars
    (hxx, hxy, hyy), totals = _totals(layout, jnp.stack([b.xx, b.xy, b.yy]))
    vx, vy = hxx * lx + hxy * ly + b.xw, hxy * lx + hyy * ly + b.yw
    ahead = jnp.asarray(np.triu(np.ones((n, n)), 1) * same_sheet(layout), lx.dtype)
    # A product, not broadcasts: the compiler would compute each factor again for every entry of the matrix.
    upper = ahead * (jnp.stack([lx, ly]).T @ jnp.stack([vx, vy]))
    # The bar itself: a quarter of its own block instead of the half that is behind.
    own = b.ww + lx * (vx - 0.25 * (b.xx * lx + b.xy * ly)) + ly * (vy - 0.25 * (b.xy * lx + b.yy * ly))
    upper = upper - jnp.diag(e[:-1], 1)
    turning = upper + upper.T + jnp.diag(own + e + jnp.roll(e, 1))
    member = jnp.asarray(membership(layout).T, lx.dtype)
    lead = jnp.concatenate([vx[None] * member, vy[None] * member])
    xx, xy, yy = (jnp.diag(v) for v in totals)
    return _joined(jnp.block([[xx, xy], [xy, yy]]), lead.T, turning)


def _joined(first: Array, below: Array, last: Array) -> Array:
    """[[first, below'], [below, last]]. Set block by block: in one concatenation each entry would ask which block it is in."""
    n, m = first.shape[0], first.shape[0] + last.shape[0]
    whole = jnp.zeros((m, m), first.dtype).at[:n, :n].set(first)
    return whole.at[n:, :n].set(below).at[:n, n:].set(below.T).at[n:, n:].set(last)


def _gather(layout: Layout, sides: Array, lx: Array, ly: Array) -> Array:
    """(k, 3, bars) on bars -> (k, 2 sheets + bars) on leads and turnings."""
    k = sides.shape[0]
    behind, totals = _totals(layout, jnp.concatenate([sides[:, 0], sides[:, 1]]))
    turning = sides[:, 2] + lx[None] * behind[:k] + ly[None] * behind[k:]
    return jnp.concatenate([totals[:k], totals[k:], turning], axis=1)
