"""Linearly implicit Euler on the whole system: order one, stiff terms damped, one linear solve per step, two where a sheet
lands (`forces.landing`)."""

import jax
import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.batching import any_of_batch
from diffeed.base.records import replace
from diffeed.chain import solve as chain_solve
from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State
from diffeed.chain.system import Solution, System
from diffeed.contact import stick
from diffeed.contact.kept import Kept
from diffeed.forces import landing
from diffeed.forces.assemble import assemble, system_of
from diffeed.forces.contacts import Contacts
from diffeed.forces.sheet import joint_stretch
from diffeed.forces.terms import Step
from diffeed.model.arrays import Model
from diffeed.steppers.advance import advance_positions, advance_velocities

Found = tuple[Solution, tuple[Array, Array]]


def step(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """One step; also the contacts of the state it started from."""
    given = Step(h, True)
    system, at, touching = assemble(model, state, given, kept)
    found = _solved(model, system)
    if touching.sheets is not None and touching.sheets.touch.secant is not None:
        found = _landed(model, state, given, kept, at, touching, found)
    return _advanced(model, state, h, kept, at, touching, found), touching


def guess(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """The same for those who correct it: of a landing no more is found."""
    system, at, touching = assemble(model, state, Step(h, True), kept)
    return _advanced(model, state, h, kept, at, touching, _solved(model, system)), touching


def _solved(model: Model, system: System) -> Found:
    """Accelerations, and what the joints pull with them."""
    a = chain_solve.solve(system, model.layout)
    return a, chain_solve.net_joint_force(system, a)


def _landed(model: Model, state: State, given: Step, kept: Kept, at: Pose, touching: Contacts, found: Found) -> Found:
    """Solved once more where friction is to go by what the step lets through."""
    pairs = touching.sheets
    assert pairs is not None, "only where there is friction"
    normal = landing.applied(model, pairs, found[0], given, kept)
    share = landing.share(model, pairs, normal, kept)
    lands = share > 0

    def again() -> Found:
        through = landing.let_through(model, normal, kept)
        force = pairs.touch.force + share * (through - pairs.touch.force)
        slower = landing.pressed_by(model, state, touching, force, given, kept)
        return _solved(model, system_of(model, state, given, kept, at, slower))

    other = lax.cond(any_of_batch(lands), again, lambda: found)
    # Of a batch in which another lands, this one keeps its bits.
    return jax.tree.map(lambda new, old: jnp.where(lands, new, old), other, found)


def _advanced(model: Model, state: State, h: Array, kept: Kept, at: Pose, touching: Contacts, found: Found) -> State:
    a, pull = found
    moving = replace(
        advance_velocities(model, state, a, h),
        stretch=joint_stretch(model, at, *pull),
        grip=stick.advance(model, state.grip, touching.sheets, a, h, kept),
    )
    return advance_positions(model, moving, h)
