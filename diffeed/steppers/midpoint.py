"""Implicit midpoint rule: order two, time-reversible, no damping of its own; eleven linear solves per step.

The middle of the step is where implicit Euler of half a step ends; the end is as far beyond it as the start is before.
The middle is found by Newton's method on the plain equations of motion, (q' - q'_0)/(h/2) = a(q, q'), with the matrix of
`linear_euler`: an approximation (friction's secant, the positive part of the geometric stiffness) that costs a pass or two
and no accuracy. Without friction and dampers energy does not drift. Stiff damped contact is followed, not damped away:
`linear_euler` and `extrapolated_euler` are the methods for large steps. Where the passes do not come together (a sheet lands and
leaves within a step) their last one would brake and throw by forces that no step has: such a step is one of `linear_euler`.
So is one in which dampers should stop what hits them: what stands in the middle of a step goes back as fast at its end.
"""

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.base.batching import any_of_batch
from diffeed.base.products import ALL_DIGITS
from diffeed.base.records import replace
from diffeed.chain import solve as chain_solve
from diffeed.chain.kinematics import Pose
from diffeed.chain.state import State, spread
from diffeed.chain.sums import from_mean
from diffeed.chain.system import System
from diffeed.contact import stick
from diffeed.contact.hits import closing, hits, taken_away
from diffeed.contact.kept import Kept
from diffeed.contact.sweep import Pairs
from diffeed.forces.assemble import assemble
from diffeed.forces.clamps import closing_rate
from diffeed.forces.contacts import Contacts
from diffeed.forces.terms import Step
from diffeed.model.arrays import Model
from diffeed.steppers import linear_euler, runge_kutta
from diffeed.steppers.advance import advance_positions, advance_velocities
from diffeed.steppers.astray import RATES, astray, mixed, of_change

PASSES = 5
"""Corrections per step, each a solve for the acceleration and one for the correction; the first guess is a half step of
`linear_euler`. With 5 the way back of a whirling sheet is found to 1e-9 mm, with 4 to 5e-7."""
UNNOTICED, PLAIN = 0.05, 0.2
"""Of what speeds change by in half a step: by how much the last pass may change them before the step is taken as one of
`linear_euler`, and from where on wholly so. Resolved steps stay below 0.02; in between is a mixture, so that a run has
no jump."""

HARMLESS = 10.0
"""mm/s: what is thrown back more slowly hops by a hundredth of a millimetre at most."""


def step(model: Model, state: State, h: Array, kept: Kept) -> tuple[State, Contacts]:
    """One step; also the contacts of the state it started from."""
    half, start = 0.5 * h, state
    guess, touching = linear_euler.guess(model, state, half, kept)
    # From there on a deflection that nothing presses would only change its sign with every pass.
    state = replace(state, grip=stick.pressed_only(model, state.grip, touching.sheets, kept))

    def improve(guesses: tuple[State, State], _: None) -> tuple[tuple[State, State], None]:
        return (_corrected(model, state, guesses[0], half, kept), guesses[0]), None

    (middle, before), _ = jax.lax.scan(improve, (guess, guess), None, length=PASSES)
    after = jax.tree.map(lambda m, s: 2.0 * m - s, middle, state)
    after = replace(after, time=state.time + h, stretch=middle.stretch, grip=stick.bounded(after.grip))
    if touching.sheets is None and touching.rollers is None:
        return after, touching
    part = astray(model, state, middle, before, half, UNNOTICED, PLAIN)
    if touching.sheets is not None and kept.surface.damping is not None:
        part = jnp.maximum(part, _thrown_back(model, start, after, touching.sheets, h, kept))
    robust = jax.lax.cond(any_of_batch(part > 0), lambda: linear_euler.step(model, start, h, kept)[0], lambda: after)
    return mixed(part, after, robust), touching


def _thrown_back(model: Model, start: State, after: State, pairs: Pairs, h: Array, kept: Kept) -> Array:
    """0 to 1: how far what hits a contact is thrown back by the step, and not by the contact's law."""
    which = closing(pairs, h)
    hit = hits(model, pairs, kept, which)
    fast = jnp.maximum(hit.speed - HARMLESS, 0.0)
    wrong = jnp.where(which, taken_away(h / hit.law.seconds, 2) * (1.0 - hit.law.share) * fast, 0.0)
    return of_change(model, start, after, jnp.max(wrong), h, UNNOTICED, PLAIN)


def _corrected(model: Model, start: State, guess: State, half: Array, kept: Kept) -> State:
    """One pass of Newton's method on the middle of the step."""
    slope = runge_kutta.derivative(model, guess, half, kept)[0]
    missing = {name: getattr(slope, name) - (getattr(guess, name) - getattr(start, name)) / half for name in RATES}
    system, at, _ = assemble(model, guess, Step(half, True), kept)
    change = chain_solve.solve(_for_correction(model, system, at, missing, half), model.layout)
    faster = advance_velocities(model, guess, change, half)
    moving = replace(
        start,
        **{name: getattr(faster, name) for name in RATES},
        stretch=guess.stretch,
        grip=None if start.grip is None else start.grip + half * slope.grip,
    )
    return advance_positions(model, moving, half)


def _for_correction(model: Model, system: System, at: Pose, missing: dict[str, Array], half: Array) -> System:
    """The matrix of an implicit step, with the inertia times the missing acceleration on the right: (M + hC + h^2 K) d = M r."""
    bars, layout = model.bars, model.layout
    bar = 2.0 * bars.half_length * missing["rate"]
    dx, dy = from_mean(layout, jnp.stack([bar * at.s, -bar * at.c]))
    x, y = spread(layout, missing["vx"]) + dx, spread(layout, missing["vy"]) + dy
    still = jnp.zeros_like(at.x)
    border, clamps = system.border, system.clamps
    if border is not None:
        masses = jnp.concatenate([model.rollers.mass, model.rollers.inertia])
        border = border._replace(rhs=masses * jnp.concatenate([missing["travel_rate"], missing["spin"]]))
    if clamps is not None:
        # What closes a clamp's error, rate^2 error - 2 rate speed, changes with the correction as stiff springs do.
        rates = jnp.stack([closing_rate(model, hold.bar) for hold in model.holds for _ in hold.rows])
        lacking = jnp.tensordot(clamps.columns, jnp.stack([x, y, missing["rate"]]), axes=2, precision=ALL_DIGITS)
        clamps = clamps._replace(rhs=lacking / (1.0 + half * rates) ** 2)
    return system._replace(
        bars=system.bars._replace(fx=bars.mass * x, fy=bars.mass * y, fw=bars.inertia * missing["rate"]),
        bias_x=still,
        bias_y=still,
        border=border,
        clamps=clamps,
    )
