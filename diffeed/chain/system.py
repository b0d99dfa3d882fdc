"""The linear system of one step: what `diffeed.forces` fills in and `solve` solves.

Unknowns: accelerations of every bar (x, y of its centre and turning), closed at the joints; beside them a small border
of roller travels and free spins, and the reactions of clamps.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array


class BarTerms(NamedTuple):
    """Symmetric 3 x 3 blocks and right-hand sides, one per bar, by component; (bars,) each."""

    xx: Array
    xy: Array
    yy: Array
    xw: Array
    yw: Array
    ww: Array
    fx: Array
    fy: Array
    fw: Array

    def pull(self, x: Array, y: Array) -> Array:
        """(3, bars): what the blocks answer to accelerations of the centres."""
        return jnp.stack([self.xx * x + self.xy * y, self.xy * x + self.yy * y, self.xw * x + self.yw * y])


class Border(NamedTuple):
    """Rollers beside the chain: their travels, then their free spins. With the chain they form one positive matrix.

    `twin` (border,) is the other unknown of the same roller, or itself where there is none; nothing is mixed there. `rest` is a
    function, for with many rollers it is dear and seldom needed. `apart` says that the rest is zero; True: it always is;
    None: not asked.
    """

    columns: Array  # (border, 3, bars) with the bars
    rhs: Array  # (border,)
    own: Array  # (border,) of each unknown
    mixed: Array  # (border,) with its twin
    twin: np.ndarray
    rest: Callable[[], Array]  # (border, border) between rollers, of which the lower triangle is enough
    apart: Array | bool | None

    def matrix(self) -> Array:
        """(border, border)."""
        eye = np.eye(len(self.twin))
        own, twin = (jnp.asarray(place, self.own.dtype) for place in (eye, eye[self.twin]))
        return own * self.own[:, None] + twin * self.mixed[:, None] + self.rest()


class Clamped(NamedTuple):
    """Rows of the clamps: `columns` (clamps, 3, bars) times the accelerations of the bars must be `rhs` (clamps,)."""

    columns: Array
    rhs: Array


class Answer(NamedTuple):
    """What chain and rollers answer to several right-hand sides: (sides, bars) each, border (sides, border)."""

    x: Array
    y: Array
    w: Array
    border: Array


class System(NamedTuple):
    """[A U C'; U' Z 0; C 0 0][a; z; r] = [f; g; c] with the joints of the chain closed."""

    bars: BarTerms
    coupling: Array  # (bars,): implicit stiffness of the joint behind each bar
    lever_x: Array  # (bars,): acceleration of the centre seen from the front node per unit of turning
    lever_y: Array
    bias_x: Array  # (bars,): centripetal acceleration of the centre seen from the front node
    bias_y: Array
    border: Border | None
    clamps: Clamped | None


class Solution(NamedTuple):
    """Accelerations of bars (bars,) and of the border (border,); reactions of the clamps (clamps,)."""

    x: Array
    y: Array
    w: Array
    border: Array
    reaction: Array
