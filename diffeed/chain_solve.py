"""Solve the system of a step: the chain by the cheaper of two ways, then a small Schur complement for the border."""

import jax.numpy as jnp
from jax import Array, lax

from diffeed import chain_dense, chain_elimination
from diffeed.model import Layout
from diffeed.system import Border, Solution, System

DENSE_UP_TO = 100
"""Bars up to which one dense matrix is faster than elimination bar by bar (measured, one CPU core, one run)."""


def solve(system: System, layout: Layout) -> Solution:
    """Solve the bordered system; the joints are closed exactly."""
    border, bars = system.border, system.bars
    respond = chain_dense.respond if layout.n_bars <= DENSE_UP_TO else chain_elimination.respond
    force = jnp.stack([bars.fx, bars.fy, bars.fw])[None]
    sides = force if border is None else jnp.concatenate([force, border.columns])
    x, y, w = respond(system, layout, sides)
    if border is None:
        return Solution(x[0], y[0], w[0], jnp.zeros((0,), x.dtype))
    z = _solve_border(border, jnp.stack([x, y, w], axis=1))
    particular, response = (x[0], y[0], w[0]), (x[1:], y[1:], w[1:])
    out = [p - z @ r for p, r in zip(particular, response, strict=True)]
    return Solution(out[0], out[1], out[2], z)


def _solve_border(border: Border, response: Array) -> Array:
    """Schur complement. `response` (1 + border, 3, bars): the chain's answer to its forces and to each column."""
    flat = response.reshape(response.shape[0], -1)
    gram = border.columns.reshape(border.columns.shape[0], -1) @ flat.T
    return solve_quasidefinite(border.matrix - gram[:, 1:], border.rhs - gram[:, 0])


def solve_quasidefinite(matrix: Array, rhs: Array) -> Array:
    """Solve a symmetric quasi-definite system (positive rollers, negative clamps) by elimination without pivoting."""
    n = rhs.shape[0]
    if n == 1:
        return rhs / matrix[0]

    def eliminate(table: Array, k: Array) -> tuple[Array, None]:
        row = table[k] / table[k, k]
        factor = table[:, k].at[k].set(0.0)
        return (table - factor[:, None] * row[None, :]).at[k].set(row), None

    table, _ = lax.scan(eliminate, jnp.concatenate([matrix, rhs[:, None]], axis=1), jnp.arange(n))
    return table[:, n]


def net_joint_force(system: System, solution: Solution) -> tuple[Array, Array]:
    """(bars,) kg mm/s2: what the joints add to the other forces on each bar."""
    b, u = system.bars, solution
    x = b.xx * u.x + b.xy * u.y + b.xw * u.w - b.fx
    y = b.xy * u.x + b.yy * u.y + b.yw * u.w - b.fy
    if system.border is None:
        return x, y
    pull = jnp.tensordot(u.border, system.border.columns, axes=1)
    return x + pull[0], y + pull[1]
