"""Hits: pairs that meet at some speed, and what becomes of that by the contact law alone (`pair.rebound`)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.base.batching import any_of_batch
from diffeed.base.smooth import power
from diffeed.contact.features import laid_out
from diffeed.contact.kept import Kept
from diffeed.contact.sweep import Pairs
from diffeed.model.arrays import Model
from diffeed.pair.rebound import TOUCHED, Rebound, rebound

SLOWEST = 1e-3
"""mm/s: what comes nearer more slowly hits nothing."""


class Hits(NamedTuple):
    """Of each pair, (bodies, features) or (pairs,)."""

    mass: Array  # kg, of a node: what is behind the touched point in the time of a hit
    speed: Array  # mm/s, > 0; 1 where nothing hits
    law: Rebound


def hits(model: Model, pairs: Pairs, kept: Kept, which: Array) -> Hits:
    """The `which` pairs, bool, as hits at the speed at which they come nearer."""
    surface = kept.surface
    mass, speed = _of_nodes(model, kept), jnp.where(which, -pairs.v_n, 1.0)
    law = rebound(surface.stiffness, surface.exponent, surface.damping, surface.damping_exponent, mass, speed)
    return Hits(mass, speed, law)


def _of_nodes(model: Model, kept: Kept) -> Array:
    """kg, of the node at each pair's feature: of the bars beside it a half each."""
    mass = laid_out(model, model.bars.mass[None], kept.pairs)[-1][0]
    return jnp.where(kept.own.first | kept.own.tail, 0.5, 1.0) * mass


def closing(pairs: Pairs, h: Array) -> Array:
    """Pairs that touch now or, as they move now, within a step of length h, and come nearer."""
    return (pairs.weight > 0) & (-pairs.v_n > SLOWEST) & (-pairs.v_n * h > pairs.gap)


def entered(pairs: Pairs, h: Array) -> Array:
    """Those of them that do not touch yet."""
    return closing(pairs, h) & (pairs.gap > 0)


def missed(model: Model, pairs: Pairs, kept: Kept, h: Array, harmless: Array) -> Array:
    """mm/s, the most of any pair: by what a step of length h errs in a hit, which steps of half the length err in alike.

    Where a contact is entered, nothing touches at the start: its spring should have slowed the sheet by v (d/D)^(p+1)/2 on the
    way to the depth d, of D where the hit turns. Where it touches, an implicit step far longer than the hit stops the sheet:
    the whole rebound is lost. A shorter one errs by (omega h)^2/4 of the speed. What comes nearer by less than `harmless` mm/s
    is not looked at there.
    """
    which = closing(pairs, h) & ((pairs.gap > 0) | (-pairs.v_n > harmless))

    def of_hits() -> Array:
        hit = hits(model, pairs, kept, which)
        ahead = TOUCHED * (h - jnp.maximum(pairs.gap, 0.0) / hit.speed) / hit.law.seconds
        ahead = jnp.where(which, ahead, 0.0)
        unfelt = jnp.where(pairs.gap > 0, 0.5 * power(ahead, kept.surface.exponent + 1.0), 0.0)
        lost = hit.law.share * (1.0 - 1.0 / (1.0 + 0.25 * ahead * ahead))
        return jnp.max(hit.speed * jnp.maximum(unfelt, lost))

    # Most steps hit nothing.
    return jax.lax.cond(any_of_batch(jnp.any(which)), of_hits, lambda: jnp.zeros((), pairs.gap.dtype))


def taken_away(steps: Array, order: int) -> Array:
    """0 to 1: the part of a rebound that is lost in steps of `steps` times its hit, by a method of that order.

    Implicit Euler of an oscillator loses exp(-omega h/2) in each radian, over half a period exp(-pi^2/2 steps). The others are
    bounds for what a dropped bar shows (`tests/test_rebound.py`).
    """
    return 1.0 - jnp.exp(-5.0 * steps) if order == 1 else 1.0 - 1.0 / (1.0 + 10.0 * steps**order)
