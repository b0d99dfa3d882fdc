"""What the checks of a step ask of its pairs, summed at once: every sweep over them is paid for by every step."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.products import product
from diffeed.contact.hits import entered
from diffeed.contact.kept import Kept
from diffeed.contact.sweep import Pairs


class Tally(NamedTuple):
    """Of all pairs of a sheet and a body."""

    deep: Array  # how many are entered more deeply than allowed
    unresolved: Array  # how many come so much nearer in the step that it does not resolve them
    entered: Array  # how many do not touch yet and will within the step
    pressed: Array  # kg mm2/s2, a bound on the energy of the contact springs: force times depth
    power: Array  # kg mm2/s3, of the bodies' surfaces on the sheets


def tallied(pairs: Pairs | None, kept: Kept, h: Array) -> Tally:
    """Of a step of length h that begins with these pairs, if there are any."""
    if pairs is None:
        return Tally._make([jnp.zeros(())] * len(Tally._fields))
    touch, (depth, closing) = pairs.touch, depth_and_approach(pairs, kept, h)
    of_each = Tally(
        deep=(touch.force > 0) & (depth > kept.allowed),
        unresolved=(pairs.weight > 0) & (closing > kept.approach) & (closing > pairs.gap),
        entered=entered(pairs, h),
        pressed=touch.force * jnp.maximum(-pairs.gap, 0.0),
        power=touch.force * pairs.u_n - touch.friction * pairs.u_t,
    )
    rows = [v.astype(pairs.gap.dtype).ravel() for v in of_each]
    # As a product: the compiler takes a long sum in two calls.
    return Tally(*product(jnp.stack(rows), jnp.ones_like(rows[0])))


def depth_and_approach(pairs: Pairs, kept: Kept, h: Array) -> tuple[Array, Array]:
    """How deep the axis lies in the body, and how much nearer it comes in a step (mm)."""
    return -(pairs.gap + kept.own.half_thickness), -pairs.v_n * h
