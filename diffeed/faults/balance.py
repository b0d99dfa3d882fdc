"""The sheets' energy against the work done on them: a step may lose energy, never find some.

Stored: motion, bending, height, springs of contacts. Work: what the surfaces of rollers and guides do through contact
forces, and loads. What is there beyond both came from nowhere: an unstable step, a contact that gives back more than it
took. Damping and sliding only take, so that they need not be counted. The work of a step is that of the forces where it
begins, which errs where a step is long for its contact; hence the wide margin. It is counted in every step, what is stored
after every block of steps.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State
from diffeed.faults.tally import Tally
from diffeed.forces.energy import load_power, sheet_energies
from diffeed.model.arrays import Model

SHARE = 0.9
"""Of all energy that is stored or went through: more than this from nowhere is a failure."""
SLOW, STRUCK = 10.0, 2.0
"""mm/s, and times the speed of the fastest surface: the energy of a sheet at this speed fails no run. What a surface strikes
leaves with up to twice its speed, and a hit within one step is not in the work."""
ROUNDING = 1e4
"""Times the rounding error of the stored energies: below, there is nothing to be seen."""


class Book(NamedTuple):
    """Kept from step to step. Energies in kg mm2/s2."""

    sums: Array  # as below: in one array, for every array is a call in every step
    start: Array  # stored where the run began, outside contacts
    peak: Array  # the most that was stored so since
    pace: Array  # mm/s, of the fastest surface so far


class Sums(NamedTuple):
    """What every step adds to. The power of a step is that where it begins."""

    begun: Array  # 1.0 after the first step, else 0.0
    pressed: Array  # stored in contacts where the run began
    work: Array  # done on the sheets
    through: Array  # the same without signs


def opened(model: Model, state: State, at: Pose) -> Book:
    """The book of a run that begins."""
    start = sum(sheet_energies(model, state, at), jnp.zeros(()))
    zero = jnp.zeros_like(start)
    return Book(jnp.zeros((len(Sums._fields),), start.dtype), start, zero, zero)


def is_kept(model: Model) -> bool:
    """Whether the work can be counted: that of a clamp that moves is not known."""
    return all(hold.path is None for hold in model.holds)


def entered(model: Model, book: Book, tally: Tally, at: Pose, h: Array) -> Book:
    """The book after a step of length h that begins with bars `at` such a pose and with what is tallied of their contacts."""
    old, power = Sums(*book.sums), tally.power + load_power(model, at)
    sums = Sums(
        begun=jnp.ones_like(old.begun),
        pressed=jnp.where(old.begun > 0, old.pressed, tally.pressed),
        work=old.work + h * power,
        through=old.through + h * jnp.abs(power),
    )
    return book._replace(sums=jnp.stack(sums))


def judged(model: Model, book: Book, state: State, at: Pose, pace: Array) -> tuple[Book, Array]:
    """The book after a block of steps in which no surface was faster than `pace`, and whether energy came from nowhere."""
    sums = Sums(*book.sums)
    moving, bending, height = sheet_energies(model, state, at)
    # A spring may be loaded too much for the length of a step, where a contact begins within it: what counts is what comes
    # out of it.
    more = moving + bending + height - book.start - sums.pressed
    peak = jnp.maximum(book.peak, jnp.maximum(moving + bending, jnp.abs(more)))
    pace = jnp.maximum(book.pace, pace)
    unseen = 0.5 * jnp.sum(model.bars.mass) * (SLOW + STRUCK * pace) ** 2
    unseen = unseen + ROUNDING * jnp.finfo(more.dtype).eps * (jnp.abs(height) + bending + sums.pressed)
    gained = more - sums.work > SHARE * (peak + sums.through) + unseen
    return book._replace(peak=peak, pace=pace), gained
