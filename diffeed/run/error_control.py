"""Steps as long as a tolerance allows: impacts (start-up, nip entry) are resolved, free feeding runs on long steps.

Each attempt goes the same way in one step and in two halves (`steppers/extrapolated_euler.py`); their difference is the
error of the whole step. Too large: the state stands and the next attempt is shorter. Step lengths are found in a loop that
ends when the run does; no step goes past a time at which a drive, guide or clamp changes how it moves, for what happens
within a step both ways may miss. A derivative is then taken through the accepted steps, in a scan of static length in which
the rest is skipped. The lengths themselves are held fixed: the derivative is that of the steps taken, as with a given step. Only
where a step ends at such a time its end goes along with it: a pulse that comes later is run through in the same steps, later.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.records import replace
from diffeed.chain.kinematics import node_velocities, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import spins
from diffeed.contact.candidates import Candidates, for_as_long_as_they_last, search
from diffeed.contact.hits import missed
from diffeed.contact.profile import all_times
from diffeed.faults.causes import LOST_REBOUND, OUT_OF_STEPS, TOO_MANY_NEAR, TOO_SMALL
from diffeed.faults.rebounds import Slower, by_tolerance
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.readings.trajectory import Resume
from diffeed.run.progress import recomputed, searched, taken
from diffeed.steppers import ESTIMATING
from diffeed.steppers.extrapolated_euler import Ways, both_ways

BLOCK = 8
"""Accepted steps between two searches for candidates, at most."""
SMALLEST = 1e-9
"""s: a step that must be shorter than this fails the run."""
SAFETY, SHRINK, GROW = 0.9, 0.2, 2.0
HORIZON = 1e-4
"""s: an error in speed counts as the way it makes in this time: it is felt by all steps to come."""


class Control(NamedTuple):
    """Static: frames after the first, the most steps accepted, stepper, observers."""

    frames: int
    most_steps: int
    method: str
    observe: tuple[str, ...]

    @property
    def blocks(self) -> int:
        return blocks(self.most_steps, self.frames)


class Limits(NamedTuple):
    """What the user wants, traced: seconds between frames, largest error of a step (mm), longest step (s)."""

    frame: Any
    tolerance: Any
    longest: Any


class Schedule(NamedTuple):
    """Accepted steps: `lengths` (blocks, BLOCK) s, 0 for none; `ends` (frames,) the block that ends each frame."""

    lengths: Array
    ends: Array
    taken: Array


class _Search(NamedTuple):
    """Carry of the loop over blocks."""

    progress: Resume
    h: Array
    block: Array
    frame: Array
    schedule: Schedule
    states: State  # (frames, ...) as they are reached


class _Block(NamedTuple):
    """Carry of the loop over attempts."""

    progress: Resume
    h: Array
    accepted: Array
    lengths: Array


def slower(limits: Limits) -> Slower:
    """As lost rebounds are judged by."""
    return by_tolerance(_harmless(limits))


def _harmless(limits: Limits) -> Array:
    """mm/s that a speed may be wrong by after a step."""
    return limits.tolerance / HORIZON


def blocks(most_steps: int, frames: int) -> int:
    """Blocks with room for `most_steps`; a frame ends one early."""
    return -(-most_steps // BLOCK) + frames


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def run(control: Control, limits: Limits, model: Model, scene: Scene, first: Resume) -> tuple[Resume, State, Array]:
    """From a start to the end: the last progress, the states at the frames after the first, and the number of steps."""
    found = _find(control, limits, model, scene, first)
    return found.progress, found.states, found.schedule.taken


@run.defjvp
def _run_jvp(control: Control, given: Any, moved: Any) -> Any:
    found = lax.stop_gradient(_find(control, *given))
    replay = functools.partial(_replay, control, given[0], found.schedule, found.progress)
    return jax.jvp(replay, given[1:], moved[1:])  # limits have no derivative


def _find(control: Control, limits: Limits, model: Model, scene: Scene, first: Resume) -> _Search:
    """Go through the run, choosing steps."""
    start = first.state.time
    n, dtype = control.frames, start.dtype

    def going(carry: _Search) -> Array:
        room = (carry.block < control.blocks) & (carry.schedule.taken < control.most_steps)
        return (carry.frame < n) & room & (carry.progress.cause == 0)

    def one_block(carry: _Search) -> _Search:
        end = start + (carry.frame + 1).astype(dtype) * limits.frame
        span = jnp.minimum(end - carry.progress.state.time, BLOCK * carry.h)
        candidates, span = for_as_long_as_they_last(search(model, carry.progress.state, span), span)
        until = carry.progress.state.time + span
        until = jnp.where(until + _smallest(end) >= end, end, until)  # no stub is left over by rounding
        done = _attempts(control, limits, model, scene, carry, candidates, until)
        progress = _failed(
            searched(model, candidates, carry.progress, done.progress), span < _smallest(until), TOO_MANY_NEAR
        )
        reached = (progress.state.time >= end) | (progress.cause > 0)
        schedule = Schedule(
            carry.schedule.lengths.at[carry.block].set(done.lengths),
            carry.schedule.ends.at[carry.frame].set(carry.block),
            carry.schedule.taken + done.accepted,
        )
        states = jax.tree.map(lambda all, one: all.at[carry.frame].set(one), carry.states, progress.state)
        return _Search(progress, done.h, carry.block + 1, carry.frame + reached.astype(jnp.int32), schedule, states)

    empty = Schedule(jnp.zeros((control.blocks, BLOCK), dtype), jnp.zeros((n,), jnp.int32), jnp.zeros((), jnp.int32))
    states = jax.tree.map(lambda v: jnp.broadcast_to(v, (n, *v.shape)), first.state)
    zero = jnp.zeros((), jnp.int32)
    begun = _Search(first, jnp.minimum(first.next_step, limits.longest), zero, zero, empty, states)
    last = lax.while_loop(going, one_block, begun)
    progress = _failed(last.progress, last.frame < n, OUT_OF_STEPS)
    return _stand_still(last._replace(progress=replace(progress, next_step=last.h)))


def _failed(progress: Resume, failed: Array, cause: int) -> Resume:
    """A failure here and now, if none came before."""
    new = failed & (progress.cause == 0)
    return replace(
        progress,
        cause=jnp.where(new, cause, progress.cause).astype(jnp.int32),
        failed_at=jnp.where(new, progress.state.time, progress.failed_at),
    )


def _stand_still(last: _Search) -> _Search:
    """A failed run stands still: its last state fills the frames that it did not reach."""
    ends = last.schedule.ends
    missing = jnp.arange(ends.shape[0], dtype=jnp.int32) >= last.frame

    def filled(all: Array, one: Array) -> Array:
        return jnp.where(missing.reshape(-1, *[1] * one.ndim), one[None], all)

    return last._replace(
        states=jax.tree.map(filled, last.states, last.progress.state),
        schedule=last.schedule._replace(ends=jnp.where(missing, jnp.maximum(last.block - 1, 0), ends)),
    )


def _attempts(
    control: Control,
    limits: Limits,
    model: Model,
    scene: Scene,
    carry: _Search,
    candidates: Candidates,
    until: Array,
) -> _Block:
    """Attempts until the block's time is over or its steps are used up."""
    chosen, corners = ESTIMATING[control.method].chosen, _corners(model)
    most = jnp.minimum(BLOCK, control.most_steps - carry.schedule.taken)

    def going(block: _Block) -> Array:
        progress = block.progress
        return (block.accepted < most) & (progress.state.time < until) & (progress.cause == 0)

    def attempt(block: _Block) -> _Block:
        before = block.progress
        time = before.state.time
        # No stub beside a corner, neither after one that is just passed nor before a frame that is a rounding later.
        ahead = (corners > time + _smallest(time)) & (corners + _smallest(until) < until)
        stop = jnp.min(jnp.where(ahead, corners, until), initial=until)
        left = stop - time
        # Two equal steps rather than a long one and a stub.
        h = jnp.where(block.h >= left, left, jnp.minimum(block.h, 0.5 * left))
        ways = both_ways(model, before.state, h, candidates.kept)
        error = _error(model, ways)
        if ways.touching.sheets is not None:
            hit = missed(model, ways.touching.sheets, candidates.kept, h, _harmless(limits))
            error = jnp.maximum(error, HORIZON * hit)
        after = replace(chosen(ways), time=jnp.where(h >= left, stop, time + h))
        then = taken(model, scene, before, after, ways.touching, h, candidates.kept, control.observe, slower(limits))
        # A step that fails is tried again shorter, as long as that is possible and of use.
        good = (error <= limits.tolerance) & ((then.cause == 0) | (then.cause == LOST_REBOUND))
        stuck = _failed(before, h <= _smallest(time), TOO_SMALL)
        stuck = replace(stuck, cause=jnp.where((stuck.cause > 0) & (then.cause > 0), then.cause, stuck.cause))
        progress = jax.tree.map(lambda a, b: jnp.where(good, a, b), then, stuck)
        wanted = jnp.clip(_next(h, block.h, error, good, limits.tolerance), _smallest(time), limits.longest)
        lengths = jnp.where(good, block.lengths.at[block.accepted].set(h), block.lengths)
        return _Block(progress, wanted, block.accepted + good.astype(jnp.int32), lengths)

    none = jnp.zeros((BLOCK,), carry.h.dtype)
    return lax.while_loop(going, attempt, _Block(carry.progress, carry.h, jnp.zeros((), jnp.int32), none))


def _corners(model: Model) -> Array:
    """(times,) s, at which something prescribed changes how it moves."""
    return jnp.concatenate([jnp.zeros((0,)), *(times.ravel() for times in all_times(model))])


def _next(h: Array, planned: Array, error: Array, good: Array, tolerance: Array) -> Array:
    """s: the next attempt after one of length h, shortened from `planned` by the end of a block. The error goes as h^2."""
    factor = SAFETY * jnp.sqrt(tolerance / jnp.maximum(error, 1e-6 * tolerance))
    factor = jnp.where(jnp.isfinite(error), jnp.clip(factor, SHRINK, GROW), SHRINK)
    grown = jnp.maximum(h * factor, jnp.where(factor >= 1.0, planned, 0.0))
    return jnp.where(good, grown, h * jnp.minimum(factor, 0.5))


def _smallest(time: Array) -> Array:
    """s: below this a step fails the run: time itself would hardly move on."""
    return jnp.maximum(SMALLEST, 8.0 * jnp.finfo(time.dtype).eps * time)


def _error(model: Model, ways: Ways) -> Array:
    """mm: largest difference of any node or movable roller, or of their speeds over `HORIZON`. NaN where a way failed."""
    found = []
    for state in (ways.whole, ways.halves):
        at = pose(model, state)
        place = jnp.concatenate([*nodes(model, at), state.travel])
        speed = jnp.concatenate([*node_velocities(model, at), state.travel_rate])
        found.append(jnp.stack([place, HORIZON * speed]))
    return jnp.max(jnp.abs(found[0] - found[1]))


def _replay(
    control: Control,
    limits: Limits,
    schedule: Schedule,
    found: Resume,
    model: Model,
    scene: Scene,
    first: Resume,
) -> tuple[Resume, State, Array]:
    """The same run with given steps: what a derivative goes through. Whether it failed is known already, but single precision
    may lose a step here that it found there: that is told."""
    stepper, courses, losing = ESTIMATING[control.method].step, all_times(model), slower(limits)

    def one_block(carry: Resume, lengths: Array) -> tuple[Resume, State]:
        def work(carry: Resume) -> Resume:
            span = jnp.sum(lengths)
            candidates, _ = for_as_long_as_they_last(search(model, carry.state, span), span)

            @recomputed
            def one_step(carry: Resume, h: Array) -> tuple[Resume, None]:
                def go(carry: Resume) -> Resume:
                    length = h + _goes_along(courses, carry.state.time, h, found.state.time)
                    after, touching = stepper(model, carry.state, length, candidates.kept)
                    return taken(model, scene, carry, after, touching, length, candidates.kept, control.observe, losing)

                return lax.cond(h > 0, go, lambda c: c, carry), None

            last, _ = lax.scan(one_step, carry, lengths)
            return searched(model, candidates, carry, last)

        carry = lax.cond(lengths[0] > 0, work, lambda c: c, carry)
        return carry, carry.state

    last, states = lax.scan(one_block, first, schedule.lengths)
    known = found.cause > 0
    cause = jnp.where(known, found.cause, last.cause)
    failed_at = jnp.where(known, found.failed_at, last.failed_at)
    last = replace(last, cause=cause, failed_at=failed_at, next_step=found.next_step)
    at_frames = jax.tree.map(lambda v: v[schedule.ends], states)
    return last, _at_fixed_times(model, at_frames) if courses else at_frames, schedule.taken


def _goes_along(courses: list[Array], time: Array, h: Array, last: Array) -> Array:
    """0, which changes as the step must: its start where the step before ended, its end at the corner that is there, if one is.
    The run itself ends when it does, at `last`. Where several of the `courses`, (parts, points) s each, have a corner there, it
    goes along with their mean: right where they move together."""
    start = lax.stop_gradient(time)
    end, parts, later = start + h, jnp.zeros_like(h), jnp.zeros_like(h)
    for times in courses:
        at = lax.stop_gradient(times)
        here = ((jnp.abs(at - end) <= _smallest(end)) & (at < last - _smallest(last))).astype(h.dtype)
        count = jnp.sum(here, axis=1)  # more than one of a shorter profile among drives, whose last point is repeated
        parts = parts + jnp.sum(jnp.minimum(count, 1.0))
        later = later + jnp.sum(jnp.sum(here * (times - at), axis=1) / jnp.maximum(count, 1.0))
    return later / jnp.maximum(parts, 1.0) - (time - start)


def _at_fixed_times(model: Model, states: State) -> State:
    """The same states, which change as those at their frames' times do where a frame's end went along with a corner: places by
    their speeds. Speeds have a corner there themselves: theirs stay those at the corner, and what is read of both sheets and
    bodies at such a frame (slip, gap, force) has no derivative by its time that holds."""
    late = states.time - lax.stop_gradient(states.time)

    def back(places: Array, speeds: Array) -> Array:
        return places - late.reshape(-1, *[1] * (places.ndim - 1)) * speeds

    return replace(
        states,
        time=states.time - late,
        x=back(states.x, states.vx),
        y=back(states.y, states.vy),
        heading=back(states.heading, states.rate),
        travel=back(states.travel, states.travel_rate),
        angle=back(states.angle, jax.vmap(lambda state: spins(model, state, state.time))(states)),
    )
