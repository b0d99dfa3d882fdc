"""What makes a step or a block of steps not to be believed, found inside the compiled run and told by number (`causes`).

Nothing here is felt by the run itself: no force, no gradient.
"""

import jax.numpy as jnp
from jax import Array

from diffeed.base.sweeps import largest
from diffeed.chain.state import State
from diffeed.contact.kept import Kept, allowed_in_circles
from diffeed.contact.roller_pairs import RollerPairs
from diffeed.faults.causes import FROZEN, LEAPT, NOT_FINITE, SINGULAR, TOO_DEEP, TOO_FAST, TURNED_ABOUT, UNRESOLVED
from diffeed.faults.overshoot import turns_about
from diffeed.faults.tally import Tally, depth_and_approach
from diffeed.forces.contacts import Contacts
from diffeed.model.arrays import Model

FASTEST = 1e7
"""mm/s: ten kilometres a second."""
LEAP = 0.4
"""mm: half a step at the speed that was gained in it, the error that first order leaves. A step of 10 ms under gravity has
0.5 mm."""
STILL = 1.0
"""mm/s: a sheet that is slower may well stay where it is."""


def of_step(
    model: Model,
    before: State,
    after: State,
    touching: Contacts,
    tally: Tally,
    kept: Kept,
    h: Array,
    explicit: bool = False,
) -> tuple[Array, Array]:
    """Cause of failure of a step, 0 for none, and its error by the order one (mm): half the step at the speed gained in it.

    `touching` are the contacts of the state before, as the steppers see them, and `tally` what is summed of them.
    """
    then, now = (_speeds(model, state) for state in (before, after))
    idlers = after.spin * model.rollers.radius[model.rollers.free]  # mm/s, of their surfaces
    gained = jnp.concatenate([now - then, jnp.zeros_like(idlers)])
    fastest, change = largest(jnp.concatenate([now, idlers]), gained)
    leap = 0.5 * h * change
    cause = jnp.where(tally.deep, TOO_DEEP, jnp.where(tally.unresolved, UNRESOLVED, 0))
    if touching.rollers is not None:
        cause = jnp.where(jnp.any(_depth_of_rollers(model, touching.rollers) > 1.0), TOO_DEEP, cause)
    if explicit:
        cause = jnp.where((cause == 0) & turns_about(model, before, touching, kept, h), TURNED_ABOUT, cause)
    if before.x.dtype == jnp.float32:
        cause = jnp.where((cause == 0) & _is_frozen(before, after, h), FROZEN, cause)
    cause = jnp.where((cause == 0) & (leap > LEAP), LEAPT, cause)
    cause = jnp.where(fastest > FASTEST, TOO_FAST, cause)
    return jnp.where(jnp.isfinite(fastest), cause, _blown(model, touching)).astype(jnp.int32), leap


def _blown(model: Model, touching: Contacts) -> Array:
    """The chain alone always has a solution; clamps may contradict each other, though all that they meet is finite."""
    if not model.holds or touching.sheets is None:
        return jnp.asarray(SINGULAR if model.holds else NOT_FINITE)
    return jnp.where(jnp.all(jnp.isfinite(touching.sheets.touch.force)), SINGULAR, NOT_FINITE)


def _speeds(model: Model, state: State) -> Array:
    return jnp.concatenate([state.vx, state.vy, state.rate * jnp.max(model.bars.half_length), state.travel_rate])


def _is_frozen(before: State, after: State, h: Array) -> Array:
    """A sheet that moves, but whose position is too long a number to notice a step."""

    def lost(place: Array, then: Array, speed: Array) -> Array:
        return (jnp.abs(speed) > STILL) & (jnp.abs(place - then - h * speed) > 0.5 * jnp.abs(h * speed))

    return jnp.any(lost(after.x, before.x, after.vx) | lost(after.y, before.y, after.vy))


def _depth_of_rollers(model: Model, pairs: RollerPairs) -> Array:
    """How deep rollers lie in each other, in what they allow."""
    allowed, (i, j) = allowed_in_circles(model.rollers.radius), pairs.between
    return -pairs.gap / jnp.minimum(allowed[i], allowed[j])


def severity(model: Model, touching: Contacts, kept: Kept, h: Array) -> Array:
    """(bodies,) by how much each is entered or approached, in what it allows: whom to blame for a failed step."""
    assert touching.sheets is not None
    depth, closing = depth_and_approach(touching.sheets, kept, h)
    here = touching.sheets.weight > 0
    deep = jnp.where(here & (touching.sheets.touch.force > 0), depth, -jnp.inf)
    near = jnp.where(here & (closing > touching.sheets.gap), closing, -jnp.inf)
    worst = jnp.max(jnp.maximum(deep / kept.allowed, near / kept.approach), axis=1)
    if touching.rollers is None:
        return worst
    (i, j), share = touching.rollers.between, _depth_of_rollers(model, touching.rollers)
    return worst.at[i].max(share).at[j].max(share)
