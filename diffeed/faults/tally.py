"""What the checks of a step ask of its pairs, summed at once: every sweep over them is paid for by every step."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.sweeps import totals
from diffeed.contact.hits import entered
from diffeed.contact.kept import Kept
from diffeed.contact.sweep import Pairs


class Tally(NamedTuple):
    """Of all pairs of a sheet and a body."""

    deep: Array  # bool: any is entered more deeply than allowed
    unresolved: Array  # bool: any comes so much nearer in the step that it does not resolve it
    entered: Array  # bool: any does not touch yet and will within the step
    pressed: Array  # kg mm2/s2, a bound on the energy of the contact springs: force times depth
    power: Array  # kg mm2/s3, of the bodies' surfaces on the sheets


def tallied(pairs: Pairs | None, kept: Kept, h: Array) -> Tally:
    """Of a step of length h that begins with these pairs, if there are any."""
    if pairs is None:
        return Tally(*[jnp.zeros((), bool)] * 3, *[jnp.zeros(())] * 2)
    touch, (depth, closing) = pairs.touch, depth_and_approach(pairs, kept, h)
    of_each = Tally(
        deep=(touch.force > 0) & (depth > kept.allowed),
        unresolved=(pairs.weight > 0) & (closing > kept.approach) & (closing > pairs.gap),
        entered=entered(pairs, h),
        pressed=touch.force * jnp.maximum(-pairs.gap, 0.0),
        power=touch.force * pairs.u_n - touch.friction * pairs.u_t,
    )
    return Tally(*totals(*jnp.broadcast_arrays(*of_each)))


def depth_and_approach(pairs: Pairs, kept: Kept, h: Array) -> tuple[Array, Array]:
    """How deep the axis lies in the body, and how much nearer it comes in a step (mm)."""
    return -(pairs.gap + kept.own.half_thickness), -pairs.v_n * h
