"""A run under way: where it starts, one step with its checks and observers, and what is carried from step to step."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from diffeed import stick
from diffeed.candidates import Candidates, check_reach
from diffeed.contact import Kept
from diffeed.forces import Contacts
from diffeed.kinematics import to_nodes
from diffeed.model import Model
from diffeed.observe import OBSERVERS, Seen
from diffeed.parts import Scene
from diffeed.snapshot import look
from diffeed.state import State, initial_state
from diffeed.statics import settle_model
from diffeed.trajectory import MOVED_TOO_FAR, NO_REST, NOT_FINITE, TOO_DEEP, TOO_FAST, TOO_MANY_NEAR, Resume

DEEPEST = 3.0
"""mm: a bar axis further inside a roller or circle guide than this (or than half its radius) went through it."""
FIRST = 1e-6
"""s: the first attempt of error-controlled steps; a start is often an impact."""
FASTEST = 1e7
"""mm/s: ten kilometres a second."""


class Progress(NamedTuple):
    """Carry of the scan: state, first failure, accumulators."""

    state: State
    cause: Array
    failed_at: Array
    open: dict[str, Any]
    next_step: Array  # s: the next attempt of error-controlled steps


def begin(model: Model, scene: Scene, initial: State | Resume | None, observe: tuple[str, ...]) -> Progress:
    """Where a run starts: from a state, from another run, or from the scene itself (settled if it says so)."""
    if isinstance(initial, Resume):
        return Progress(initial.state, initial.cause, initial.failed_at, initial.open, initial.next_step)
    state, found = None if initial is None else stick.fitted(model, initial), jnp.asarray(True)
    if state is None:
        state = initial_state(model, scene)
        if scene.initial == "settled":
            with jax.named_scope("settle"):
                state, found = settle_model(model, state)
    cause = jnp.where(found, 0, NO_REST).astype(jnp.int32)
    failed_at = jnp.where(found, jnp.inf, state.time)
    start = {name: OBSERVERS[name].start(model, scene, state) for name in observe}
    return Progress(state, cause, failed_at, start, jnp.full((), FIRST, state.time.dtype))


def taken(
    model: Model,
    scene: Scene,
    carry: Progress,
    after: State,
    touching: Contacts,
    h: Array,
    kept: Kept,
    observe: tuple[str, ...],
) -> Progress:
    """A step taken: judged and observed. A run that has failed stands still, so that its last good state can be looked at."""
    before = carry.state
    cause = judge(model, after, kept, touching)
    fine = (carry.cause == 0) & (cause == 0)
    opened = carry.open
    if observe:
        guides = any(OBSERVERS[name].guides for name in observe)
        seen = Seen(before, after, h, *look(model, before, guides))
        opened = {name: OBSERVERS[name].update(model, scene, carry.open[name], seen) for name in observe}
    return Progress(
        state=jax.tree.map(lambda a, b: jnp.where(fine, a, b), after, before),
        cause=jnp.where(carry.cause == 0, cause, carry.cause),
        failed_at=jnp.where((carry.cause == 0) & (cause > 0), after.time, carry.failed_at),
        open=jax.tree.map(lambda a, b: jnp.where(fine, a, b), opened, carry.open),
        next_step=carry.next_step,
    )


def searched(model: Model, found: Candidates, carry: Progress) -> Progress:
    """The end of a block of steps: a failure if its candidates were not good until here."""
    lost = (carry.cause == 0) & ~check_reach(model, found, carry.state)
    cause = jnp.where(found.complete, MOVED_TOO_FAR, TOO_MANY_NEAR).astype(jnp.int32)
    return carry._replace(
        cause=jnp.where(lost, cause, carry.cause), failed_at=jnp.where(lost, carry.state.time, carry.failed_at)
    )


def judge(model: Model, after: State, kept: Kept, touching: Contacts) -> Array:
    """Cause of failure of a step, 0 for none (see trajectory.CAUSES)."""
    speeds = jnp.concatenate([after.vx, after.vy, after.rate * jnp.max(model.bars.half_length), after.travel_rate])
    fastest = jnp.max(jnp.abs(speeds))
    cause = jnp.where(jnp.isfinite(fastest), jnp.where(fastest > FASTEST, TOO_FAST, 0), NOT_FINITE)
    if touching.sheets is not None and kept.n_circles:
        pairs, n = touching.sheets, kept.n_circles
        half = to_nodes(model.layout, model.bars.half_thickness, model.bars.half_thickness)[None, :]
        inside = jnp.where(pairs.touch.force[:n] > 0, pairs.gap[:n] + half, 0.0)
        deep = jnp.any(inside < -jnp.maximum(jnp.minimum(DEEPEST, 0.5 * kept.radius), 0.25))
        cause = jnp.where((cause == 0) & deep, TOO_DEEP, cause)
    return cause.astype(jnp.int32)
