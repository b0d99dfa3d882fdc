"""Whether an explicit step overshoots by friction: it is bounded, so that no speed grows without end, but the sheet is fed wrong.

As stiff equations are found (Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2): how much the slope
changes over how much the state does. Here for every sheet as a whole and every roller that turns freely, in half a step of
friction's own making.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.products import product
from diffeed.chain.state import State, spread, total_per_sheet
from diffeed.chain.system import Solution
from diffeed.contact import gained, stick
from diffeed.contact.features import by_feature
from diffeed.contact.kept import Kept, by_roller
from diffeed.contact.roller_pairs import RollerPairs
from diffeed.contact.sweep import Pairs
from diffeed.forces.contacts import Contacts
from diffeed.model.arrays import Model
from diffeed.pair.law import Surface, friction_after

DAMPED, SWINGS = 2.785, 8.0**0.5
"""Step times rate, and step times circular frequency, up to which classical Runge-Kutta lets nothing grow."""
NOTICED = 0.1
"""Of the stick speed: what friction must change in a step to be judged. Less is rounding."""


def turns_about(model: Model, state: State, touching: Contacts, kept: Kept, h: Array) -> Array:
    """Whether friction would turn about within the step.

    Judged are each sheet along its own pull, each free roller, and each two rollers on each other; not what a sheet's bars do
    against each other. Once is enough, though a run might come right again after it. Where surfaces stick, it is told at a
    third to all of the step at which it happens: the lag of the deflection counts for it, not against it.
    """
    found = [jnp.zeros((), bool)]
    if touching.sheets is not None and touching.sheets.touch.secant is not None:
        found += _on_sheets(model, state, touching.sheets, kept, h)
    if touching.rollers is not None and touching.rollers.touch.secant is not None and model.rollers.n_free:
        found.append(_on_rollers(model, touching.rollers, h))
    return jnp.any(jnp.stack(found))


def _on_sheets(model: Model, state: State, pairs: Pairs, kept: Kept, h: Array) -> list[Array]:
    now = _pull(model, pairs, kept, pairs.touch.friction)
    more = 0.5 * h * gained.along(model, pairs, _spread(model, now), kept)
    # A deflection drifts for half a step too; this much less that its limit is the one of what swings.
    ahead, grip = h * DAMPED / SWINGS**2, stick.of_pairs(model, state.grip, kept, 0.0)
    then = _pull(model, pairs, kept, friction_after(kept.surface, pairs.touch, pairs.v_t, more, ahead, grip))
    return [_overshoots(a, b, kept.surface, h) for a, b in zip(now, then, strict=True)]


def _on_rollers(model: Model, pairs: RollerPairs, h: Array) -> Array:
    rollers, (i, j) = model.rollers, pairs.between
    give = jnp.zeros_like(rollers.radius).at[rollers.free].set(rollers.radius[rollers.free] ** 2 / rollers.inertia)
    give, friction = give[i] + give[j], pairs.touch.friction
    later = friction_after(pairs.surface, pairs.touch, pairs.v_t, -0.5 * h * give * friction, h, None)
    return _overshoots((give * friction)[None], (give * later)[None], pairs.surface, h)


def _overshoots(now: Array, then: Array, surface: Surface, h: Array) -> Array:
    """Accelerations (axes, any), mm/s2, by friction now and half a step later: whether any overshoots."""
    size, change = jnp.sum(now * now, axis=0), jnp.sum(now * (now - then), axis=0)
    least = NOTICED * jnp.min(surface.stick_speed)
    return jnp.any((2.0 * change > DAMPED * size) & (h * h * size > least**2))


def _pull(model: Model, pairs: Pairs, kept: Kept, friction: Array) -> tuple[Array, Array]:
    """(2, sheets) of each sheet and (1, free) of each free roller's surface, mm/s2."""
    layout, rollers = model.layout, model.rollers
    mass = total_per_sheet(layout, model.bars.mass)
    own = jnp.asarray(layout.sheet_of_feature, friction.dtype)
    force = by_feature(model, (pairs.ny * friction, -pairs.nx * friction), kept.pairs)
    free = np.arange(rollers.n)[rollers.free]
    if not len(free):
        return product(force, own) / mass[None], jnp.zeros((1, 0), friction.dtype)
    on_rollers = by_roller(model, kept, friction[None])[:, free]
    return product(force, own) / mass[None], on_rollers * (rollers.radius[rollers.free] ** 2 / rollers.inertia)[None]


def _spread(model: Model, pull: tuple[Array, Array]) -> Solution:
    """The same for bars and shafts."""
    (x, y), surface = pull[0], pull[1][0] / model.rollers.radius[model.rollers.free]
    border = jnp.concatenate([jnp.zeros((model.rollers.n_movable,), x.dtype), surface])
    still = jnp.zeros((model.layout.n_bars,), x.dtype)
    return Solution(spread(model.layout, x), spread(model.layout, y), still, border, jnp.zeros((0,), x.dtype))
