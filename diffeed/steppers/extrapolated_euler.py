"""Linearly implicit Euler extrapolated: two half steps against a whole one. Order two, L-stable, three linear solves.

With E(h) one step of `linear_euler`, 2 E(h/2)^2 - E(h) cancels the term of first order in the error of any smooth
one-step method (Richardson), so the secant of friction and other shortcuts in the matrix of `linear_euler` do no harm. On
the test equation it gives 2/(1 - z/2)^2 - 1/(1 - z), which stays below 1 in the left half-plane and vanishes at infinity.
Positions are minimal coordinates, so that joints stay closed. Where something is hit within the step the two ways have little in
common, and the combination would throw it: then the halves are taken. The difference of the two ways is the error of the
first: what error-controlled steps go by.
"""

from typing import NamedTuple

import jax
from jax import Array

from diffeed.base.records import replace
from diffeed.chain.state import State
from diffeed.contact import stick
from diffeed.contact.kept import Kept
from diffeed.forces.contacts import Contacts
from diffeed.model.arrays import Model
from diffeed.steppers import linear_euler
from diffeed.steppers.astray import astray, mixed

UNNOTICED, PLAIN = 0.25, 0.5
"""Of what speeds change by in a step: by how much its two ways may differ before the halves are taken, and from where on they
alone. Linear forces, however stiff, leave 0.2 at most."""


class Ways(NamedTuple):
    """The same time passed in one step and in two."""

    whole: State
    halves: State
    touching: Contacts
    astray: Array
    """0 to 1: how far the two are from coming together."""

    def best(self) -> State:
        """The order-two combination; of a hit that the step does not resolve, the halves alone."""
        found = jax.tree.map(lambda two, one: 2.0 * two - one, self.halves, self.whole)
        found = replace(found, time=self.halves.time, grip=stick.bounded(found.grip))
        # What drives prescribe has no hits.
        return replace(mixed(self.astray, found, self.halves), angle=found.angle)


def both_ways(model: Model, state: State, h: Array, kept: Kept) -> Ways:
    """One step of h and two of h/2, and the contacts of the state that both start from."""
    whole, touching = linear_euler.step(model, state, h, kept)
    halves, _ = two_halves(model, state, h, kept)
    return Ways(whole, halves, touching, astray(model, state, halves, whole, h, UNNOTICED, PLAIN))


def two_halves(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """Two steps of h/2, and the contacts of the state that they start from. A scan: the step is compiled once."""

    def half(carry: State, _: None) -> tuple[State, Contacts]:
        return linear_euler.step(model, carry, 0.5 * h, kept)

    after, touching = jax.lax.scan(half, state, None, length=2)
    return after, jax.tree.map(lambda v: v[0], touching)


def step(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """One step; also the contacts of the state it started from."""
    ways = both_ways(model, state, h, kept)
    return ways.best(), ways.touching
