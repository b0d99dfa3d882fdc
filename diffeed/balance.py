"""The sheets' energy against the work done on them: a step may lose energy, never find some.

Stored: motion, bending, height, springs of contacts. Work: what the surfaces of rollers and guides do through contact
forces, and loads. What is there beyond both came from nowhere: an unstable step, a contact that gives back more than it
took. Damping and sliding only take, so that they need not be counted. The work is the trapezoidal rule over the forces at
the ends of steps, which errs where a step is long for its contact; hence the wide margin.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.contact import Pairs
from diffeed.energy import sheet_energies
from diffeed.forces import Contacts, pushes
from diffeed.kinematics import Pose
from diffeed.model import Model
from diffeed.state import State

SHARE = 0.9
"""Of all energy that is stored or went through: more than this from nowhere is a failure."""
SLOW, STRUCK = 10.0, 2.0
"""mm/s, and times the speed of the fastest surface: the energy of a sheet at this speed fails no run. What a surface strikes
leaves with up to twice its speed, and a hit within one step is not in the work."""
ROUNDING = 1e4
"""Times the rounding error of the stored energies: below, there is nothing to be seen."""


class Book(NamedTuple):
    """Kept from step to step."""

    opened: Array  # bool: there was a first look
    sums: Array  # (5,) as below: in one array, for every array is a call in every step
    pace: Array  # mm/s, of the fastest surface so far


class Sums(NamedTuple):
    """Energies in kg mm2/s2."""

    start: Array  # stored at the first look
    power: Array  # at the last look, kg mm2/s3
    work: Array  # done on the sheets since
    through: Array  # the same without signs
    peak: Array  # the most that was stored outside contacts


def empty(dtype: jnp.dtype) -> Book:
    """Before the first look."""
    return Book(jnp.asarray(False), jnp.zeros((len(Sums._fields),), dtype), jnp.zeros((), dtype))


def is_kept(model: Model) -> bool:
    """Whether the work can be counted: that of a clamp that moves is not known."""
    return all(hold.path is None for hold in model.holds)


def entered(model: Model, book: Book, state: State, touching: Contacts, h: Array) -> tuple[Book, Array]:
    """The book after a look at the state before a step of length h, and whether energy came from nowhere until then."""
    at, old = touching.at, Sums(*book.sums)
    moving, bending, height = sheet_energies(model, state, at)
    pressed, power = (jnp.zeros(()), jnp.zeros(())) if touching.sheets is None else _contacts(touching.sheets)
    power = power + _loads(model, at)
    start = jnp.where(book.opened, old.start, moving + bending + height + pressed)
    half = 0.5 * h
    work = old.work + jnp.where(book.opened, half * (old.power + power), 0.0)
    through = old.through + jnp.where(book.opened, half * (jnp.abs(old.power) + jnp.abs(power)), 0.0)
    # A spring may be loaded too much for the length of a step, where a contact begins within it: what counts is what comes
    # out of it.
    free = moving + bending + height
    peak = jnp.maximum(old.peak, jnp.maximum(moving + bending, jnp.abs(free - start)))
    found = free - start - work
    unseen = 0.5 * jnp.sum(model.bars.mass) * (SLOW + STRUCK * book.pace) ** 2
    unseen = unseen + ROUNDING * jnp.finfo(found.dtype).eps * (jnp.abs(height) + bending + pressed)
    gained = found > SHARE * (peak + through) + unseen
    return Book(jnp.asarray(True), jnp.stack(Sums(start, power, work, through, peak)), book.pace), gained


def _contacts(pairs: Pairs) -> tuple[Array, Array]:
    """A bound on the energy of the contact springs (force times depth), and the power of the bodies' surfaces on the sheets."""
    touch = pairs.touch
    stored = touch.force * jnp.maximum(-pairs.gap, 0.0)
    power = touch.force * pairs.u_n - touch.friction * pairs.u_t
    sums = jnp.sum(jnp.stack([stored, power]), axis=(1, 2))
    return sums[0], sums[1]


def _loads(model: Model, at: Pose) -> Array:
    """Power of dead forces and moments on nodes."""
    load = pushes(model, at)
    return jnp.zeros(()) if load is None else jnp.sum(load.fx * at.vx + load.fy * at.vy + load.fw * at.w)
