"""Energies and powers of a state, in N mm and N mm/s."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State
from diffeed.contact.bodies import arm_spins
from diffeed.contact.kept import Kept, by_roller
from diffeed.contact.roller_pairs import RollerPairs
from diffeed.contact.sweep import Pairs
from diffeed.forces.clamps import hold_speed, hold_target
from diffeed.forces.contacts import Contacts
from diffeed.forces.loads import pushes
from diffeed.model.arrays import Model
from diffeed.pair.law import NEWTON, Surface, elastic_energy, elastic_force


class Energies(NamedTuple):
    """Stored energies, N mm."""

    kinetic: Array
    bending: Array
    gravity: Array
    contact: Array
    springs: Array  # of movable rollers, preload and stops included


class Powers(NamedTuple):
    """Work and losses; as powers N mm/s, integrated over time N mm."""

    drives: Array  # work of driven shafts
    loads: Array  # work of dead forces and moments
    friction: Array  # what friction takes: lost in sliding, or lent to deflections (below mu F stick_displacement each)
    contact: Array  # loss in contact damping
    joints: Array  # loss in joint dampers
    rollers: Array  # loss in roller dampers and bearings


def energies(model: Model, state: State, touching: Contacts, kept: Kept) -> Energies:
    """Energies of a state. Driven rollers carry no kinetic energy of their own: their spin is given."""
    r = model.rollers
    moving, bending, height = sheet_energies(model, state, touching.at)
    moving = moving + 0.5 * jnp.sum(r.mass * state.travel_rate**2) + 0.5 * jnp.sum(r.inertia * state.spin**2)
    height = height - jnp.sum(r.mass * state.travel * (model.gravity[0] * r.dir_x + model.gravity[1] * r.dir_y))
    over = jnp.maximum(state.travel - r.stop_high, 0.0) + jnp.maximum(r.stop_low - state.travel, 0.0)
    springs = jnp.sum(r.preload * state.travel + 0.5 * r.spring * state.travel**2 + 0.5 * r.stop_stiffness * over**2)
    return Energies(*(v / NEWTON for v in (moving, bending, height, _contact_energy(touching, kept), springs)))


def sheet_energies(model: Model, state: State, at: Pose) -> tuple[Array, Array, Array]:
    """Of all sheets: motion, bending and height, kg mm2/s2."""
    bars = model.bars
    bend = state.heading - jnp.roll(state.heading, -1) - bars.rest_angle
    moving = bars.mass * (at.vx**2 + at.vy**2) + bars.inertia * at.w**2
    height = -bars.mass * (model.gravity[0] * at.x + model.gravity[1] * at.y)
    # One sum of three rows: every step of a run pays for it.
    sums = jnp.sum(jnp.stack([0.5 * moving, 0.5 * bars.joint_stiffness * bend**2, height]), axis=1)
    bending = sums[1]
    for hold in model.holds:
        if hold.wall:
            turn = state.heading[hold.bar] - hold_target(hold, state.time)[2]
            bending = bending + model.wall_stiffness[hold.bar] * turn**2
    return sums[0], bending, sums[2]


def _contact_energy(touching: Contacts, kept: Kept) -> Array:
    total, pairs = jnp.zeros(()), touching.sheets
    if pairs is not None:
        total = total + jnp.sum(pairs.weight * elastic_energy(kept.surface, -pairs.gap))
    if touching.rollers is not None:
        total = total + jnp.sum(elastic_energy(touching.rollers.surface, -touching.rollers.gap))
    return total


def powers(model: Model, state: State, touching: Contacts, kept: Kept) -> Powers:
    """Powers at a state: what the shafts put in, what dampers and sliding take out."""
    bars, r = model.bars, model.rollers
    every = [p for p in (touching.sheets, touching.rollers) if p is not None]
    friction = sum((jnp.sum(p.touch.friction * p.v_t) for p in every), jnp.zeros(()))
    damping = _damping_loss(touching, kept)
    rate = state.rate - jnp.roll(state.rate, -1)
    joints = jnp.sum(bars.joint_damping * rate**2)
    for hold in model.holds:
        if hold.wall:
            turning = state.rate[hold.bar] - hold_speed(hold, state.time)[2]
            joints = joints + 2.0 * model.wall_damping[hold.bar] * turning**2
    rollers = jnp.sum(r.damper * state.travel_rate**2) + jnp.sum(
        r.drag * (state.spin - arm_spins(model, state.time)) ** 2
    )
    drives = _drive_power(model, touching, kept)
    return Powers(*(v / NEWTON for v in (drives, load_power(model, touching.at), friction, damping, joints, rollers)))


def load_power(model: Model, at: Pose) -> Array:
    """Power of dead forces and moments on nodes, kg mm2/s3."""
    load = pushes(model, at)
    return jnp.zeros(()) if load is None else jnp.sum(load.fx * at.vx + load.fy * at.vy + load.fw * at.w)


def _damping_loss(touching: Contacts, kept: Kept) -> Array:
    """What the springs of contacts give and the contact force does not take: c D^n v_n^2, and where the force is
    clipped at zero the whole power of the spring (it lets go faster than the parts leave each other)."""

    def loss(surface: Surface, pairs: Pairs | RollerPairs, weight: Array | float) -> Array:
        return jnp.sum((weight * elastic_force(surface, -pairs.gap) - pairs.touch.force) * pairs.v_n)

    total, sheets, rollers = jnp.zeros(()), touching.sheets, touching.rollers
    if sheets is not None:
        total = total + loss(kept.surface, sheets, sheets.weight)
    if rollers is not None:
        total = total + loss(rollers.surface, rollers, 1.0)
    return total


def _drive_power(model: Model, touching: Contacts, kept: Kept) -> Array:
    """Shafts supply the opposite of what contacts exert on driven rollers."""
    r, n, sheets, pairs = model.rollers, model.rollers.n, touching.sheets, touching.rollers
    if n == 0:
        return jnp.zeros(())
    moment = jnp.zeros((n,))
    if sheets is not None:
        moment = moment + by_roller(model, kept, sheets.touch.friction[None])[0] * r.radius
    if pairs is not None:
        i, j = pairs.between
        moment = moment.at[i].add(pairs.touch.friction * r.radius[i]).at[j].add(pairs.touch.friction * r.radius[j])
    return -jnp.sum(jnp.where(r.driven, moment * touching.spin, 0.0))
