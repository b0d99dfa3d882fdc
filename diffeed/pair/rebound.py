"""With what share of its speed, and after what time, a contact throws back what hits it: its law alone, without geometry.

m d'' = -(k d^p + c d^n d') from first touch until it parts. By its largest depth without damping, D, and the speed v of the
hit, time goes as D/v, and all that is left is the ratio of damper to spring, r = c D^n v / (k D^p). Without damping the way
in and out is known, and what the damper takes of the energy on it, to first order in r, is 2 r B with B the beta function of
(n+1)/(p+1) and 3/2. The share of the speed is taken as 1/(1 + r B/2)^2, which has this slope and is within 0.09 of what the
law gives where much is lost (`tests/test_rebound.py`).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

TOUCHED = 3.0
"""Times D/v from touch to parting: 3.14 for a linear spring, 2.94 for a power of 1.5, 2.80 for one of 2."""


class Rebound(NamedTuple):
    """Share of the speed that is left, and the time in touch (s)."""

    share: Array
    seconds: Array


def rebound(
    stiffness: Any, exponent: Any, damping: Any, damping_exponent: Any, mass: Any, speed: Any, xp: Any = jnp
) -> Rebound:
    """Of `mass` (kg) that hits a contact at `speed` (mm/s, > 0). Stiffness in kg/(s^2 mm^(exponent - 1)), damping in
    kg/(s mm^damping_exponent), or None where nothing is damped. Any shapes that fit. `xp`: numpy where compiling does not pay."""
    squared = speed * speed * mass
    log_depth = xp.log(0.5 * (exponent + 1.0) * squared / stiffness) / (exponent + 1.0)
    seconds = TOUCHED * xp.exp(log_depth) / speed
    if damping is None:
        return Rebound(xp.ones_like(seconds), seconds)
    ratio = 2.0 * damping * speed * xp.exp((damping_exponent + 1.0) * log_depth) / ((exponent + 1.0) * squared)
    x = (damping_exponent + 1.0) / (exponent + 1.0)
    lost = ratio / (x * xp.sqrt(1.0 + 1.25 * x))  # the beta function within 1 %
    return Rebound(1.0 / (1.0 + 0.5 * lost) ** 2, seconds)
