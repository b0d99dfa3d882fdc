"""A run under way: where it starts, one step with its checks and observers, and what is carried from step to step."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.ad_checkpoint import checkpoint_name

from diffeed.base.records import replace
from diffeed.chain.kinematics import Pose, pose
from diffeed.chain.state import State, initial_state
from diffeed.contact import stick
from diffeed.contact.bodies import Bodies, bodies
from diffeed.contact.candidates import Candidates, check_reach
from diffeed.contact.crossing import any_misplaced
from diffeed.contact.kept import Kept, keep_all
from diffeed.contact.profile import in_order
from diffeed.faults import balance, judge, rebounds
from diffeed.faults.causes import (
    ACROSS,
    BEHIND,
    FROM_NOWHERE,
    LOST_REBOUND,
    MOVED_TOO_FAR,
    NO_REST,
    OUT_OF_ORDER,
    TOO_MANY_NEAR,
)
from diffeed.faults.rebounds import Slower
from diffeed.faults.tally import tallied
from diffeed.forces.contacts import Contacts, at_own_time
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.readings.observe import OBSERVERS, Seen
from diffeed.readings.snapshot import look
from diffeed.readings.trajectory import Resume
from diffeed.statics.rest import settle_model

FIRST = 1e-6
"""s: the first attempt of error-controlled steps; a start is often an impact."""

VERDICT = "verdict"
Step = Callable[[Any, Array], Any]


def begin(model: Model, scene: Scene, initial: State | Resume | None, observe: tuple[str, ...]) -> Resume:
    """Where a run starts: from a state, from another run, or from the scene itself (settled if it says so)."""
    if isinstance(initial, Resume):
        if set(initial.open) != set(observe):
            had, asked = (", ".join(sorted(names)) or "nothing" for names in (initial.open, observe))
            raise ValueError(f"observe must be what it was in the run that goes on, {had}, but is {asked}")
        return replace(initial, state=stick.fitted(model, initial.state))
    if initial is not None:
        state = stick.fitted(model, initial)
        found = jnp.all(jnp.isfinite(jnp.concatenate([state.x, state.y, state.heading, state.travel])))  # by `settle`
    else:
        state, found = initial_state(model, scene), jnp.asarray(True)
        if scene.initial == "settled":
            with jax.named_scope("settle"):
                state, found = settle_model(model, state)
    state = _all_with_tangents(state)
    cause = jnp.where(found, jnp.where(in_order(model), 0, OUT_OF_ORDER), NO_REST).astype(jnp.int32)
    start = {name: OBSERVERS[name].start(model, scene, state) for name in observe}
    at, world = pose(model, state), bodies(model, state, state.time, state.time)
    cause = jnp.where(cause == 0, _misplaced(model, at, world), cause).astype(jnp.int32)
    failed_at = jnp.where(cause == 0, jnp.inf, state.time)
    dtype, book = state.time.dtype, balance.opened(*lax.stop_gradient((model, state, at)))
    made = Resume(
        state=state,
        cause=cause,
        failed_at=failed_at,
        open=start,
        next_step=jnp.full((), FIRST, dtype),
        book=book,
        error=jnp.zeros((), dtype),
        lacks=rebounds.nothing(model, state.time),
        half=jnp.zeros((), dtype),
    )
    # No weak types: what goes on from the end of a run is the same program as what goes on from here.
    return jax.tree.map(lambda v: jnp.asarray(v, v.dtype), made)


def _all_with_tangents(state: State) -> State:
    """The same state. Where it is differentiated all of it has tangents but the time, also speeds that start as zero: a scan
    whose carry gets more of them on the way is traced once more. And where it is in a batch, all of it is."""
    nothing = 0.0 * state.x[0]  # a plain zero would be seen through
    return replace(jax.tree.map(lambda v: v + nothing, state), time=state.time)


def taken(
    model: Model,
    scene: Scene,
    carry: Resume,
    after: State,
    touching: Contacts,
    h: Array,
    kept: Kept,
    observe: tuple[str, ...],
    slower: Slower,
    explicit: bool = False,
) -> Resume:
    """A step taken: judged and observed. A run that has failed stands still, so that its last good state can be looked at."""
    before = carry.state
    # Judging has no derivative: nothing of it is carried on by one.
    judged, then, now, met, near = lax.stop_gradient((model, before, after, touching, kept))
    tally, book = tallied(met.sheets, near, h), carry.book
    cause, leap = judge.of_step(judged, then, now, met, tally, near, h, explicit)
    if balance.is_kept(model):
        book = balance.entered(judged, book, tally, met.at, h)
    lacks = carry.lacks
    if met.sheets is not None:
        lacks, lost = rebounds.judged(judged, lacks, met.sheets, near, then.time, h, slower, tally.entered)
        cause = jnp.where((cause == 0) & lost, LOST_REBOUND, cause).astype(jnp.int32)
    # By a sum over an array: a plain `and` would be merged into each of its many readers, with all that it is made of.
    fine = checkpoint_name(jnp.sum(jnp.stack([carry.cause, cause])) == 0, VERDICT)
    opened = carry.open
    if observe:
        opened = _observed(
            model, scene, carry.open, Seen(before, after, h, carry.half + 0.5 * h, touching, kept), observe
        )
    return Resume(
        state=jax.tree.map(lambda a, b: jnp.where(fine, a, b), after, before),
        cause=jnp.where(carry.cause == 0, cause, carry.cause),
        failed_at=jnp.where((carry.cause == 0) & (cause > 0), after.time, carry.failed_at),
        open=jax.tree.map(lambda a, b: jnp.where(fine, a, b), opened, carry.open),
        next_step=carry.next_step,
        book=book,  # of no use once a run has failed
        error=carry.error + jnp.where(fine, leap, 0.0),
        lacks=lacks,
        half=jnp.where(fine, 0.5 * h, carry.half),
    )


def _observed(model: Model, scene: Scene, past: dict[str, Any], step: Seen, observe: tuple[str, ...]) -> dict[str, Any]:
    """The accumulators after a step, given with the contacts that it saw itself, of which only friction is computed again. What
    is far from everything is looked at only for those who ask."""
    seen = whole = step._replace(touching=at_own_time(model, step.before, step.touching, step.kept))
    if any(OBSERVERS[name].far for name in observe):
        whole = step._replace(touching=look(model, step.before)[2], kept=keep_all(model))

    def updated(name: str) -> Any:
        asked = OBSERVERS[name]
        return asked.update(model, scene, past[name], whole if asked.far else seen)

    return {name: updated(name) for name in observe}


def recomputed(step: Step) -> Step:
    """A step of a scan whose derivative keeps the state before and the verdict, computes the step again, and judges no more."""
    return jax.checkpoint(step, prevent_cse=False, policy=jax.checkpoint_policies.save_only_these_names(VERDICT))


def _misplaced(model: Model, at: Pose, world: Bodies) -> Array:
    """The cause if a bar is where no sheet may be, else 0."""
    found = any_misplaced(model, at, world)
    return jnp.where(found.across, ACROSS, jnp.where(found.behind, BEHIND, 0))


def searched(model: Model, found: Candidates, begun: Resume, carry: Resume) -> Resume:
    """The end of a block of steps that had `begun`: a failure if its candidates were not good until here, if a bar lies across a
    guide or behind one, or if energy came from nowhere: then the run stands, with what was observed, where its energy was
    last good."""
    judged, reached, found = lax.stop_gradient((model, carry.state, found))  # judging has no derivative
    at, world = pose(judged, reached), bodies(judged, reached, reached.time, reached.time)
    near_enough = check_reach(judged, found, reached, at, world)
    unseen = jnp.where(found.complete, MOVED_TOO_FAR, TOO_MANY_NEAR)
    cause = jnp.where(near_enough, _misplaced(judged, at, world), unseen)
    book, good = carry.book, (carry.state, carry.open, carry.error, carry.half)
    if balance.is_kept(model):
        book, gained = balance.judged(judged, lax.stop_gradient(book), reached, at, found.pace)
        gained &= (carry.cause == 0) & (cause == 0)
        cause = jnp.where(gained, FROM_NOWHERE, cause)
        good = jax.tree.map(
            lambda a, b: jnp.where(gained, a, b), (begun.state, begun.open, begun.error, begun.half), good
        )
    lost, (state, seen, error, half) = (carry.cause == 0) & (cause > 0), good
    return replace(
        carry,
        state=state,
        open=seen,
        error=error,
        half=half,
        cause=jnp.where(lost, cause, carry.cause).astype(jnp.int32),
        failed_at=jnp.where(lost, carry.state.time, carry.failed_at),
        book=book,
    )
