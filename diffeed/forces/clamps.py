"""Clamps: rows that hold a node or a heading, and wall joints."""

import jax.numpy as jnp
from jax import Array

from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State
from diffeed.chain.system import BarTerms, Clamped
from diffeed.contact.movement import shift_at
from diffeed.forces.terms import Step, bar_terms, on_bar, summed
from diffeed.model.arrays import Hold, Model


def hold_target(hold: Hold, time: Array) -> tuple[Array, Array, Array]:
    """Where a clamp holds its node (mm) and heading (rad) at a time."""
    if hold.path is None:
        return hold.x, hold.y, hold.angle
    shift = shift_at(hold.path, time)
    return hold.x + shift.dx, hold.y + shift.dy, hold.angle + shift.angle


def hold_speed(hold: Hold, time: Array) -> tuple[Array, Array, Array]:
    """And how fast that moves (mm/s, rad/s)."""
    if hold.path is None:
        zero = jnp.zeros(())
        return zero, zero, zero
    shift = shift_at(hold.path, time)
    return shift.vx, shift.vy, shift.w


def by_direction(values: tuple[Array, Array, Array]) -> dict[str, Array]:
    """(x, y, heading) by the words that a clamp's rows use."""
    return dict(zip(("x", "y", "heading"), values, strict=True))


def walls(model: Model, state: State, step: Step) -> BarTerms | None:
    """Wall joints: a spring-damper of twice the joint's stiffness between the wall and the bar at its node."""
    found = []
    for hold in model.holds:
        if not hold.wall:
            continue
        k, c = 2.0 * model.wall_stiffness[hold.bar], 2.0 * model.wall_damping[hold.bar]
        rate, lag = state.rate[hold.bar], (step.h if step.implicit else 0.0)
        angle, turning = (of(hold, state.time + lag)[2] for of in (hold_target, hold_speed))
        moment = -k * (state.heading[hold.bar] - angle + lag * rate) - c * (rate - turning)
        terms = {"fw": on_bar(model, hold.bar, moment)}
        if step.implicit:
            terms["ww"] = on_bar(model, hold.bar, step.h * (c + step.h * k))
        found.append(bar_terms(model, **terms))
    return summed(found) if found else None


def clamps(model: Model, state: State, at: Pose, step: Step) -> Clamped:
    """Rows of all clamps."""
    rows = [_hold_rows(model, state, at, hold, step) for hold in model.holds]
    return Clamped(*(jnp.concatenate(v) for v in zip(*rows, strict=True)))


def closing_rate(model: Model, bar: int) -> Array:
    """1/s: rate at which a clamp's error decays (Baumgarte).

    The bending frequency of one bar of the sheet: below the fastest that a stable explicit step resolves, whatever the
    units. A rate of the machine is part of the differential equation, so the order of the method is kept: one that grows
    as 1/h makes speeds of order h from the errors of order h^2 that a step or a stage leaves, and no extrapolation takes
    those away. Zero for a sheet without stiffness.
    """
    squared = model.wall_stiffness[bar] / model.bars.inertia[bar]
    stiff = squared > 0.0
    return jnp.where(stiff, jnp.sqrt(jnp.where(stiff, squared, 1.0)), 0.0)  # a root has no slope at zero


def _hold_rows(model: Model, state: State, at: Pose, hold: Hold, step: Step) -> tuple[Array, Array]:
    """Rows of one clamp, (rows, 3, bars) and (rows,): the held point's acceleration is what closes its error.

    Implicit: with the speed of a decay at the end of the step. Explicit: with its acceleration, critically damped.
    """
    k, arm = hold.bar, hold.end * model.bars.half_length[hold.bar]
    c, s, w = at.c[k], at.s[k], at.w[k]
    one, zero = jnp.ones(()), jnp.zeros(())
    rows: dict[str, tuple[Array, ...]] = {
        "x": (one, zero, -arm * s),
        "y": (zero, one, arm * c),
        "heading": (zero, zero, one),
    }
    place = by_direction((at.x[k] + arm * c, at.y[k] + arm * s, state.heading[k]))
    speed = by_direction((at.vx[k] - arm * s * w, at.vy[k] + arm * c * w, w))
    bias = by_direction((arm * w * w * c, arm * w * w * s, zero))
    meant = state.time + step.h if step.implicit else state.time
    target, wanted = by_direction(hold_target(hold, meant)), by_direction(hold_speed(hold, meant))
    rate = closing_rate(model, k)
    if step.implicit:  # any rate is stable: a limp sheet, which has none of its own, closes half of its error in a step
        rate = jnp.where(rate > 0.0, rate, 1.0 / step.h)
    columns, values = [], []
    for d in hold.rows:
        columns.append(jnp.zeros((3, model.layout.n_bars)).at[:, k].set(jnp.stack(rows[d])))
        error = target[d] - place[d]
        if step.implicit:
            # What the speed leaves over is closed by the share of a decay at that rate: nearly all in a long step.
            left = error - step.h * wanted[d]
            closing = (wanted[d] + rate / (1.0 + step.h * rate) * left - speed[d]) / step.h
        else:
            closing = rate * rate * error + 2.0 * rate * (wanted[d] - speed[d])
        values.append(closing + bias[d])
    return jnp.stack(columns), jnp.stack(values)
