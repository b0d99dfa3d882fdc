"""The linear system of one step: what `forces` fills in and `chain_solve` solves.

Unknowns: accelerations of every bar (x, y of its centre and turning), closed at the joints; beside them a small border
of roller travels, free spins and clamp reactions.
"""

from typing import NamedTuple

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


class Border(NamedTuple):
    """Coupling to the unknowns beside the chain. `columns` (border, 3, bars), `matrix` (border, border), `rhs` (border,)."""

    columns: Array
    matrix: Array
    rhs: Array


class System(NamedTuple):
    """[A U; U' Z][a; z] = [f; g] with the joints of the chain closed."""

    bars: BarTerms
    coupling: Array  # (bars,): implicit stiffness of the joint behind each bar
    lever_x: Array  # (bars,): acceleration of the centre seen from the front node per unit of turning
    lever_y: Array
    bias_x: Array  # (bars,): centripetal acceleration of the centre seen from the front node
    bias_y: Array
    border: Border | None


class Solution(NamedTuple):
    """Accelerations of bars (bars,) and of the border (border,)."""

    x: Array
    y: Array
    w: Array
    border: Array
