"""What the accelerations that a step has found add to the speeds of its contacts. Prescribed speeds are of its end already."""

import jax.numpy as jnp
from jax import Array

from diffeed.chain.system import Solution
from diffeed.contact.features import blend, laid_out
from diffeed.contact.kept import Kept, picked
from diffeed.contact.sweep import Pairs
from diffeed.model.arrays import Model


def apart(model: Model, pairs: Pairs, a: Solution, kept: Kept) -> Array:
    """Of each pair, mm/s2: what is added to v_n."""
    rows = zip(laid_out(model, jnp.stack([a.x, a.y, a.w]), kept.pairs), pairs.levers, strict=True)
    gained = blend(pairs.levers, [pairs.nx * x + pairs.ny * y + lever.rn * w for (x, y, w), lever in rows])
    if not (model.n_border and kept.n_circles):
        return gained
    n, (x, y, _) = kept.n_circles, _of_circles(model, a, kept)
    return jnp.concatenate([gained[:n] - (pairs.nx[:n] * x + pairs.ny[:n] * y), gained[n:]])


def along(model: Model, pairs: Pairs, a: Solution, kept: Kept) -> Array:
    """Of each pair, mm/s2: what is added to v_t."""
    rows = zip(laid_out(model, jnp.stack([a.x, a.y, a.w]), kept.pairs), pairs.levers, strict=True)
    gained = blend(pairs.levers, [pairs.nx * y - pairs.ny * x + lever.rt * w for (x, y, w), lever in rows])
    if not (model.n_border and kept.n_circles):
        return gained
    n, (x, y, w) = kept.n_circles, _of_circles(model, a, kept)
    surface = pairs.nx[:n] * y - pairs.ny[:n] * x + kept.radius * w
    return jnp.concatenate([gained[:n] - surface, gained[n:]])


def _of_circles(model: Model, a: Solution, kept: Kept) -> tuple[Array, ...]:
    """Accelerations of the kept circles, x, y and turning: those of travels and free spins."""
    rollers = model.rollers
    m, f, rest = rollers.n_movable, rollers.n_free, len(model.circle_names) - rollers.n
    travel, still = a.border[:m], jnp.zeros((rollers.n - m + rest,))
    before, after = jnp.zeros((rollers.counts[0],)), jnp.zeros((rollers.counts[3] + rest,))
    of_circles = (
        jnp.concatenate([rollers.dir_x * travel, still]),
        jnp.concatenate([rollers.dir_y * travel, still]),
        jnp.concatenate([before, a.border[m : m + f], after]),
    )
    return picked(of_circles, kept.circle_index)
