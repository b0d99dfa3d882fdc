"""With what share of its speed, and within what time, a contact throws back what hits it: its law alone, without geometry."""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

NEWTON = 1e3
"""kg mm/s2."""
LONGEST = 100.0
"""Times what it takes to come to the deepest point at full speed: what is still in touch then is not thrown back."""


class Rebound(NamedTuple):
    """Share of the speed that is left, and the time in touch (s)."""

    share: float
    seconds: float


def rebound(
    stiffness: float, exponent: float, damping: float, damping_exponent: float, mass: float, speed: float
) -> Rebound:
    """Of `mass` (kg) that hits a contact at `speed` (mm/s): m d'' = -max(0, k d^m + c d^n d'), from first touch until it parts or
    is pulled. Stiffness in N/mm^exponent, damping in N s/mm^(1 + damping_exponent)."""
    k, c = NEWTON * stiffness / mass, NEWTON * damping / mass
    deepest = (0.5 * (exponent + 1.0) * speed**2 / k) ** (1.0 / (exponent + 1.0))  # without damping
    second = deepest / speed
    k, c = k * deepest**exponent * second / speed, c * deepest**damping_exponent * second

    def motion(_: float, at: np.ndarray) -> list[float]:
        depth, rate = max(at[0], 0.0), at[1]
        return [rate, -max(0.0, k * depth**exponent + c * depth**damping_exponent * rate)]

    def parted(_: float, at: np.ndarray) -> float:
        return at[0]

    parted.terminal, parted.direction = True, -1  # type: ignore[attr-defined]
    run = solve_ivp(motion, (0.0, LONGEST), [1e-9, 1.0], method="LSODA", events=parted, rtol=1e-6, atol=1e-9)
    return Rebound(max(0.0, -float(run.y[1, -1])) if run.t_events[0].size else 0.0, second * float(run.t[-1]))
