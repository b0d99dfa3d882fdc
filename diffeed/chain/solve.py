"""Solve the system of a step: chain and rollers by the cheaper of two ways, then a small Schur complement for clamps."""

import jax.numpy as jnp
from jax import Array

from diffeed.base.factor import SMALL
from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.products import product
from diffeed.base.smooth import solve_positive
from diffeed.chain import dense, elimination
from diffeed.chain.system import Solution, System
from diffeed.model.layout import Layout

DENSE_UP_TO = 100
"""Bars up to which one dense matrix is faster than elimination bar by bar where loops are dear (measured, one CPU core, one
run)."""


def solve(system: System, layout: Layout) -> Solution:
    """Solve the whole system; the joints are closed exactly."""
    bars, clamps = system.bars, system.clamps
    respond = dense.respond if _as_matrix(system, layout) else elimination.respond
    force = jnp.stack([bars.fx, bars.fy, bars.fw])[None]
    rhs = jnp.zeros((1, 0), force.dtype) if system.border is None else system.border.rhs[None]
    if clamps is None:
        found = respond(system, layout, force, rhs)
        return Solution(found.x[0], found.y[0], found.w[0], found.border[0], jnp.zeros((0,), force.dtype))
    n = clamps.rhs.shape[0]
    found = respond(system, layout, jnp.concatenate([force, clamps.columns]), jnp.pad(rhs, ((0, n), (0, 0))))
    # Each clamp pulls until its own row holds: (C A^-1 C') r = C A^-1 f - c.
    moved = product(jnp.stack(found[:3], axis=1).reshape(n + 1, -1), clamps.columns.reshape(n, -1).T)
    reaction = solve_positive(moved[1:], (moved[0] - clamps.rhs)[:, None])[:, 0]
    return Solution._make([*(v[0] - product(reaction, v[1:]) for v in found), reaction])


def _as_matrix(system: System, layout: Layout) -> bool:
    """Where loops are cheap only if so many rollers travel or turn freely that they are better eliminated before the bars, each
    by itself: with 148 movable pinches that takes a twentieth of the time (`diffeed bench growth`)."""
    beside = system.border
    many = beside is not None and beside.apart is not None and beside.rhs.shape[0] > SMALL
    return layout.n_bars <= DENSE_UP_TO and (many or not loops_are_cheap())


def net_joint_force(system: System, solution: Solution) -> tuple[Array, Array]:
    """(bars,) kg mm/s2: what the joints add to the other forces on each bar."""
    b, u = system.bars, solution
    x = b.xx * u.x + b.xy * u.y + b.xw * u.w - b.fx
    y = b.xy * u.x + b.yy * u.y + b.yw * u.w - b.fy
    for beside, pull in ((system.border, u.border), (system.clamps, u.reaction)):
        if beside is not None:
            x, y = x + product(pull, beside.columns[:, 0]), y + product(pull, beside.columns[:, 1])
    return x, y
