"""Chain and rollers as one dense positive matrix: fastest for short chains.

Unknowns: acceleration of each sheet's lead, the turning of every bar, then the border. The matrix needs no products of
Jacobians: with l_j the acceleration of what lies behind bar j per unit of its turning, and v_k the impulse that turning
bar k asks of everything in front, its entries are l_j . v_k for j before k. `v` comes from sums over the bars behind.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.once import computed_once
from diffeed.base.products import product
from diffeed.base.smooth import beside_sides, solve_bordered, solve_positive
from diffeed.chain.sums import apply, before, membership
from diffeed.chain.system import Answer, Border, System
from diffeed.model.layout import Layout

APART_FROM = 16
"""Unknowns of rollers from which it pays to eliminate each by itself (measured, one CPU core)."""


def respond(system: System, layout: Layout, sides: Array, border: Array) -> Answer:
    """Right-hand sides (sides, 3, bars) and (sides, border) -> accelerations. Side 0 carries the bias."""
    k, n_sheets, beside = sides.shape[0], len(layout.bars), system.border
    columns = jnp.zeros((0, 3, layout.n_bars), sides.dtype) if beside is None else beside.columns
    lx, ly = 2.0 * system.lever_x, 2.0 * system.lever_y
    bias_x, bias_y = _centres(layout, jnp.stack([system.bias_x, system.bias_y]))
    given = jnp.concatenate([sides.at[0].add(-system.bars.pull(bias_x, bias_y)), columns])
    b = system.bars
    halves, totals = _totals(layout, jnp.concatenate([jnp.stack([b.xx, b.xy, b.yy]), given[:, 0], given[:, 1]]))
    (half_x, half_y), (total_x, total_y) = (jnp.split(v[3:], 2) for v in (halves, totals))
    gathered = jnp.concatenate([total_x, total_y, given[:, 2] + lx[None] * half_x + ly[None] * half_y], axis=1)
    bias = product(columns[:, 0], bias_x) + product(columns[:, 1], bias_y)
    right = (gathered[:k], border.at[0].add(-bias))

    def lower(below: Array) -> Array:
        return _lower(system, layout, (lx, ly), (halves[:3], totals[:3]), below)

    def whole() -> Array:
        rollers = jnp.zeros((0, 0), sides.dtype) if beside is None else beside.matrix()
        below = [[gathered[k:], jnp.pad(rollers, ((0, 0), (0, k)))], [*right, beside_sides(k, sides.dtype)]]
        return solve_bordered(lower(jnp.concatenate([jnp.concatenate(row, axis=1) for row in below])), k).T

    def each() -> Array:
        assert beside is not None
        return _by_rollers(lower(gathered[:0]), gathered[k:], beside, right)

    if beside is None or beside.apart is None or columns.shape[0] < APART_FROM:
        found = whole()
    else:
        found = each() if beside.apart is True else lax.cond(beside.apart, each, whole)
    lead_x, lead_y, w, rest = jnp.split(found, (n_sheets, 2 * n_sheets, 2 * n_sheets + layout.n_bars), axis=1)
    turned = _centres(layout, jnp.concatenate([system.lever_x[None] * w, system.lever_y[None] * w]))
    x, y = turned[:k] + lead_x[:, layout.sheet_of_bar], turned[k:] + lead_y[:, layout.sheet_of_bar]
    return Answer(x.at[0].add(bias_x), y.at[0].add(bias_y), w, rest)


def _by_rollers(chain: Array, coupling: Array, beside: Border, right: tuple[Array, Array]) -> Array:
    """The same with rollers that feel each other through the sheets alone: each is eliminated by itself, which leaves the
    chain."""
    own, mixed, twin = beside.own, beside.mixed, beside.twin
    alone = twin == np.arange(len(twin))
    size = jnp.where(alone, own, own * own[twin] - mixed * mixed)
    by_own, by_twin = jnp.where(alone, 1.0, own[twin]) / size, -mixed / size

    def freed(v: Array) -> Array:
        """(border, columns) forces on rollers that nothing else holds -> their accelerations."""
        return by_own[:, None] * v + by_twin[:, None] * v[twin]

    answer = freed(coupling)
    on_chain, on_rollers = right
    x = solve_positive(chain - product(coupling.T, answer), (on_chain - product(on_rollers, answer)).T).T
    return jnp.concatenate([x, freed((on_rollers - product(x, coupling.T)).T).T], axis=1)


def _centres(layout: Layout, halves: Array) -> Array:
    """(k, bars) half steps from front node to rear node -> sums from the lead to each centre, sheet by sheet."""
    return apply(halves, 2.0 * before(layout))


def _totals(layout: Layout, values: Array) -> tuple[Array, Array]:
    """(k, bars) -> (k, bars) half of each bar's own plus all behind it, and (k, sheets) totals: one product."""
    both = apply(values, np.concatenate([before(layout).T, membership(layout)], axis=1))
    return both[:, : layout.n_bars], both[:, layout.n_bars :]


def _lower(
    system: System, layout: Layout, lever: tuple[Array, Array], blocks: tuple[Array, Array], below: Array
) -> Array:
    """Lower triangle of the matrix, whose last rows are `below`: rollers, and sides that are solved along. `blocks` are sums of
    xx, xy, yy over the bars behind each and over sheets. A lead is a bar that all others of its sheet are behind.

    Made by products, a diagonal and few sums, for whatever is cheap to compute the compiler computes again for every
    entry of the matrix: so what the diagonal needs goes through a product too, and what each row and column is made of is
    computed once. Of two columns a call of the library's product takes ten times as long as two products of entries
    (measured, one CPU core).
    """
    b, n_sheets, more = system.bars, len(layout.bars), below.shape[0]
    (lx, ly), ((hxx, hxy, hyy), (txx, txy, tyy)) = lever, blocks
    vx, vy = hxx * lx + hxy * ly + b.xw, hxy * lx + hyy * ly + b.yw
    one, zero = jnp.ones((n_sheets,), lx.dtype), jnp.zeros((n_sheets,), lx.dtype)
    moved = jnp.stack([jnp.concatenate([one, zero, lx]), jnp.concatenate([zero, one, ly])])
    asked = jnp.stack([jnp.concatenate([txx, txy, vx]), jnp.concatenate([txy, tyy, vy])])
    (mx, my), (ax, ay) = computed_once((moved, asked))
    crossed = mx[:, None] * ax[None, :] + my[:, None] * ay[None, :]
    # The bar itself: a quarter of its own block instead of the half that is behind.
    own = b.ww + lx * (vx - 0.25 * (b.xx * lx + b.xy * ly)) + ly * (vy - 0.25 * (b.xy * lx + b.yy * ly))
    behind, diagonal, joint = _tables(layout)
    upper = jnp.asarray(behind.T, lx.dtype) * crossed
    upper = upper + jnp.diag(apply(jnp.concatenate([own, system.coupling]), diagonal))
    upper = upper - jnp.asarray(joint.T, lx.dtype) * jnp.pad(system.coupling, (2 * n_sheets, 0))[:, None]
    return jnp.concatenate([jnp.pad(upper, ((0, more), (0, 0))), below.T], axis=1).T


def _tables(layout: Layout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which row is behind which column; where own terms and joints stand on the diagonal; which row is a joint behind which
    column."""
    n, leads = layout.n_bars, 2 * len(layout.bars)
    sheet = np.concatenate([np.tile(np.arange(leads // 2), 2), layout.sheet_of_bar])
    behind = np.tril(sheet[:, None] == sheet[None, :])
    behind[range(leads, leads + n), range(leads, leads + n)] = False
    own = np.eye(n, leads + n, leads)
    joint = np.eye(leads + n, k=-1)
    joint[:, [*range(leads), leads + n - 1]] = 0.0
    return behind, np.concatenate([own, own + own @ joint.T]), joint
