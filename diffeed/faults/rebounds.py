"""Rebounds that a step takes away: what hits a contact and leaves it within a few steps comes out too slow, or not at all.

A contact is entered in one step. What the sheet brings into it there, what its law would give back, and how much of that
steps of this length take away make the speed that the sheet lacks from then on. Where it is held or guided that is
forgotten within some milliseconds; where not, it is elsewhere than the run says.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.base.batching import any_of_batch
from diffeed.base.products import product
from diffeed.chain.state import total_per_sheet
from diffeed.contact.features import by_feature
from diffeed.contact.hits import Hits, entered, hits, taken_away
from diffeed.contact.kept import Kept
from diffeed.contact.sweep import Pairs
from diffeed.model.arrays import Model

FORGOTTEN = 0.02
"""s: what was lost fades so fast, for the next guide or nip is never far."""
NOTICED = 2.0
"""mm that the speed which a sheet lacks would make in this time: more fails a run."""


class Lacks(NamedTuple):
    """What sheets lack by rebounds that steps took away; each (sheets,), in one array from step to step, for every array is a
    call in every step."""

    x: Array  # mm/s, in the mean of a sheet
    y: Array
    since: Array  # s, when that was found: it fades from there


Slower = Callable[[Hits, Array], Array]
"""With what speed less, mm/s, a run comes out of hits without damping, by the length of the step that enters them (s)."""


def in_equal_steps(order: int) -> Slower:
    """By a method of that order."""
    return lambda hit, h: taken_away(h / hit.law.seconds, order) * hit.speed


def by_tolerance(error: Array) -> Slower:
    """In steps that may each err by so much, mm/s.

    Implicit Euler errs by (omega h)^2/4 of the speed in a step and by pi/2 omega h of it in a hit: by pi times the root of the
    speed and of that error. Measured: up to 2 times, by both orders (`tests/test_faults.py`).
    """
    return lambda hit, h: jnp.minimum(hit.speed, 2.0 * jnp.sqrt(error * hit.speed))


def nothing(model: Model, time: Array) -> Array:
    """`Lacks` where a run begins, (3, sheets)."""
    none = jnp.zeros((len(model.layout.names),), time.dtype)
    return jnp.stack(Lacks(none, none, none + time))


def judged(
    model: Model, before: Array, pairs: Pairs, kept: Kept, time: Array, h: Array, slower: Slower, hit: Array
) -> tuple[Array, Array]:
    """`Lacks`, (3, sheets), after a step of length h from `time`, in which a contact is entered if `hit`, and whether that
    matters."""

    def more() -> tuple[Array, Array]:
        impulse = lost_impulse(model, pairs, kept, h, slower)
        of_features = by_feature(model, (impulse * pairs.nx, impulse * pairs.ny), kept.pairs)
        lost = product(of_features, jnp.asarray(model.layout.sheet_of_feature, impulse.dtype))
        lost = lost / total_per_sheet(model.layout, model.bars.mass)[None]
        old = Lacks(*before)
        left = jnp.exp((old.since - time) / FORGOTTEN)
        now = Lacks(left * old.x + lost[0], left * old.y + lost[1], jnp.full_like(left, time))
        return jnp.stack(now), jnp.any(now.x * now.x + now.y * now.y > (NOTICED / FORGOTTEN) ** 2)

    # Most steps enter nothing, and then no sheet lacks more than before. Of a batch in which another is hit, this one keeps
    # its bits.
    now, matters = jax.lax.cond(any_of_batch(hit), more, lambda: (before, jnp.zeros((), bool)))
    return jnp.where(hit, now, before), hit & matters


def lost_impulse(model: Model, pairs: Pairs, kept: Kept, h: Array, slower: Slower) -> Array:
    """Of each pair, kg mm/s: along its normal, 0 where nothing is entered."""
    which = entered(pairs, h)
    hit = hits(model, pairs, kept, which)
    return jnp.where(which, hit.law.share * slower(hit, h) * hit.mass, 0.0)
