"""The sheet's own: inertia, weight, joints, tension."""

import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State
from diffeed.chain.sums import up_to_centre
from diffeed.chain.system import BarTerms
from diffeed.forces.terms import Step, bar_terms
from diffeed.model.arrays import Model


def inertia(model: Model) -> BarTerms:
    """Mass matrix: diagonal, for the centre is the mass centre."""
    return bar_terms(model, xx=model.bars.mass, yy=model.bars.mass, ww=model.bars.inertia)


def weight(model: Model) -> BarTerms:
    """Gravity."""
    return bar_terms(model, fx=model.bars.mass * model.gravity[0], fy=model.bars.mass * model.gravity[1])


def joint_moments(model: Model, state: State, lag: Array | float = 0.0) -> Array:
    """(bars,) moment of the joint behind each bar on that bar (source paper, eq. 3, about the rest angle); the next bar
    feels the opposite. `lag` adds stiffness times lag to the damping: the moment at the end of a step."""
    bars = model.bars
    bend = state.heading - jnp.roll(state.heading, -1) - bars.rest_angle
    rate = state.rate - jnp.roll(state.rate, -1)
    return -bars.joint_stiffness * bend - (bars.joint_damping + lag * bars.joint_stiffness) * rate


def joints(model: Model, state: State, step: Step) -> BarTerms:
    """Rotational spring-dampers; their implicit part is the system's `coupling`."""
    moment = joint_moments(model, state, step.h if step.implicit else 0.0)
    return bar_terms(model, fw=moment - jnp.roll(moment, 1))


def coupling(model: Model, step: Step) -> Array:
    """(bars,) what the joint behind each bar adds to the matrix between its two bars: h (c + h k)."""
    if not step.implicit:
        return jnp.zeros_like(model.bars.mass)
    return step.h * (model.bars.joint_damping + step.h * model.bars.joint_stiffness)


def tension(state: State, step: Step) -> BarTerms | None:
    """Geometric stiffness of joint forces, its positive part, from the last step: a taut sheet needs it."""
    if not step.implicit:
        return None
    taut = step.h * jnp.maximum(state.stretch, 0.0)
    zero = jnp.zeros_like(taut)
    return BarTerms(zero, zero, zero, zero, zero, step.h * taut, zero, zero, -taut * state.rate)


def joint_stretch(model: Model, at: Pose, net_x: Array, net_y: Array) -> Array:
    """(bars,) geometric stiffness per heading: half length times (pull at the front + pull at the rear).

    `net_x`, `net_y`: net joint force on each bar; sums from the lead give the force at each joint.
    """
    pull_x, pull_y = up_to_centre(model.layout, jnp.stack([net_x, net_y]))
    return -2.0 * model.bars.half_length * (at.c * pull_x + at.s * pull_y)
