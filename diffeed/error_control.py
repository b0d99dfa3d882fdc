"""Steps as long as a tolerance allows: impacts (start-up, nip entry) are resolved, free feeding runs on long steps.

Each attempt goes the same way in one step and in two halves (`steppers/extrapolated_euler.py`); their difference is the
error of the whole step. Too large: the state stands and the next attempt is shorter. Step lengths are found in a loop that
ends when the run does; a derivative is then taken through the accepted steps, in a scan of static length in which the
rest is skipped. The lengths themselves are held fixed: the derivative is that of the steps taken, as with a given step.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from diffeed.candidates import Candidates, for_as_long_as_they_last, search
from diffeed.kinematics import node_velocities, nodes, pose
from diffeed.model import Model, build
from diffeed.parts import Scene
from diffeed.progress import Progress, searched, taken
from diffeed.records import replace
from diffeed.state import State
from diffeed.steppers import Stepper, extrapolated_euler
from diffeed.steppers.extrapolated_euler import Ways, both_ways, two_halves
from diffeed.trajectory import OUT_OF_STEPS, TOO_MANY_NEAR, TOO_SMALL

BLOCK = 8
"""Accepted steps between two searches for candidates, at most."""
SMALLEST = 1e-9
"""s: a step that must be shorter than this fails the run."""
SAFETY, SHRINK, GROW = 0.9, 0.2, 2.0
MEMORY = 1e-4
"""s: an error in speed counts as the way it makes in this time: it is felt by all steps to come."""


class Control(NamedTuple):
    """Static: frames after the first, the most steps, stepper, observers."""

    frames: int
    blocks: int
    method: str
    observe: tuple[str, ...]


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

    progress: Progress
    h: Array
    block: Array
    frame: Array
    schedule: Schedule
    states: State  # (frames, ...) as they are reached


class _Block(NamedTuple):
    """Carry of the loop over attempts."""

    progress: Progress
    h: Array
    accepted: Array
    lengths: Array


def blocks(most_steps: int, frames: int) -> int:
    """Blocks with room for `most_steps`; a frame ends one early."""
    return -(-most_steps // BLOCK) + frames


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def run(control: Control, limits: Limits, scene: Scene, first: Progress) -> tuple[Progress, State, Array]:
    """From a start to the end: the last progress, the states at the frames after the first, and the number of steps."""
    found = _find(control, limits, scene, first)
    return found.progress, found.states, found.schedule.taken


@run.defjvp
def _run_jvp(control: Control, given: Any, moved: Any) -> Any:
    limits, scene, first = given
    found = lax.stop_gradient(_find(control, limits, scene, first))
    return jax.jvp(functools.partial(_replay, control, found.schedule, found.progress), (scene, first), moved[1:])


def _find(control: Control, limits: Limits, scene: Scene, first: Progress) -> _Search:
    """Go through the run, choosing steps."""
    model = build(scene)
    start = first.state.time
    n, dtype = control.frames, start.dtype

    def going(carry: _Search) -> Array:
        return (carry.frame < n) & (carry.block < control.blocks) & (carry.progress.cause == 0)

    def one_block(carry: _Search) -> _Search:
        end = start + (carry.frame + 1).astype(dtype) * limits.frame
        span = jnp.minimum(end - carry.progress.state.time, BLOCK * carry.h)
        candidates, span = for_as_long_as_they_last(search(model, carry.progress.state, span), span)
        until = carry.progress.state.time + span
        until = jnp.where(until + _smallest(end) >= end, end, until)  # no stub is left over by rounding
        done = _attempts(control, limits, model, scene, carry, candidates, until)
        progress = searched(model, candidates, done.progress)
        crowded = (span < _smallest(until)) & (progress.cause == 0)
        progress = progress._replace(
            cause=jnp.where(crowded, TOO_MANY_NEAR, progress.cause).astype(jnp.int32),
            failed_at=jnp.where(crowded, progress.state.time, progress.failed_at),
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
    last = lax.while_loop(
        going, one_block, _Search(first, jnp.minimum(first.next_step, limits.longest), zero, zero, empty, states)
    )
    # A failed run stands still: its last state fills the frames that it did not reach.
    missing = jnp.arange(n, dtype=jnp.int32) >= last.frame
    ends = jnp.where(missing, jnp.maximum(last.block - 1, 0), last.schedule.ends)
    states = jax.tree.map(
        lambda all, one: jnp.where(missing.reshape(-1, *[1] * one.ndim), one[None], all),
        last.states,
        last.progress.state,
    )
    short = (last.frame < n) & (last.progress.cause == 0)
    progress = last.progress._replace(
        cause=jnp.where(short, OUT_OF_STEPS, last.progress.cause).astype(jnp.int32),
        failed_at=jnp.where(short, last.progress.state.time, last.progress.failed_at),
        next_step=last.h,
    )
    return last._replace(progress=progress, states=states, schedule=last.schedule._replace(ends=ends))


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

    def going(block: _Block) -> Array:
        progress = block.progress
        return (block.accepted < BLOCK) & (progress.state.time < until) & (progress.cause == 0)

    def attempt(block: _Block) -> _Block:
        time = block.progress.state.time
        left = until - time
        # Two equal steps rather than a long one and a stub.
        h = jnp.where(block.h >= left, left, jnp.minimum(block.h, 0.5 * left))
        ways = both_ways(model, block.progress.state, h, candidates.kept)
        error = _error(model, ways)
        small = h <= _smallest(time)
        good = error <= limits.tolerance
        arrival = jnp.where(h >= left, until, time + h)
        after = replace(_kept_way(control.method, ways), time=arrival)
        then = taken(model, scene, block.progress, after, ways.touching, h, candidates.kept, control.observe)
        # A step that fails is tried again shorter, as long as that is possible.
        good = good & (then.cause == 0)
        stuck = ~good & small
        cause = jnp.where(then.cause > 0, then.cause, TOO_SMALL).astype(jnp.int32)
        failed = block.progress._replace(cause=cause, failed_at=time)
        progress = jax.tree.map(
            lambda a, b, c: jnp.where(good, a, jnp.where(stuck, b, c)), then, failed, block.progress
        )
        factor = SAFETY * jnp.sqrt(limits.tolerance / jnp.maximum(error, 1e-6 * limits.tolerance))
        factor = jnp.where(jnp.isfinite(error), jnp.clip(factor, SHRINK, GROW), SHRINK)
        factor = jnp.where(good, factor, jnp.minimum(factor, 0.5))
        wanted = jnp.where(good, jnp.maximum(h * factor, jnp.where(factor >= 1.0, block.h, 0.0)), h * factor)
        wanted = jnp.clip(wanted, _smallest(time), limits.longest)
        lengths = jnp.where(good, block.lengths.at[block.accepted].set(h), block.lengths)
        return _Block(progress, wanted, block.accepted + good.astype(jnp.int32), lengths)

    none = jnp.zeros((BLOCK,), carry.h.dtype)
    return lax.while_loop(going, attempt, _Block(carry.progress, carry.h, jnp.zeros((), jnp.int32), none))


def _smallest(time: Array) -> Array:
    """s: below this a step fails the run: time itself would hardly move on."""
    return jnp.maximum(SMALLEST, 8.0 * jnp.finfo(time.dtype).eps * time)


def _kept_way(method: str, ways: Ways) -> State:
    """What is gone on with: two halves, or the combination of order two."""
    return ways.halves if method == "linear_euler" else ways.best()


GONE_ON_WITH: dict[str, Stepper] = {"linear_euler": two_halves, "extrapolated_euler": extrapolated_euler.step}
"""The same without the estimate, by the method's name."""


def _error(model: Model, ways: Ways) -> Array:
    """mm: largest difference of any node or movable roller, or of their speeds over `MEMORY`. Not a number where a way failed."""
    found = []
    for state in (ways.whole, ways.halves):
        at = pose(model, state)
        place = jnp.concatenate([*nodes(model, at), state.travel])
        speed = jnp.concatenate([*node_velocities(model, at), state.travel_rate])
        found.append((place, speed))
    (place, speed), (place_2, speed_2) = found
    return jnp.maximum(jnp.max(jnp.abs(place - place_2)), MEMORY * jnp.max(jnp.abs(speed - speed_2)))


def _replay(
    control: Control, schedule: Schedule, found: Progress, scene: Scene, first: Progress
) -> tuple[Progress, State, Array]:
    """The same run with given steps: what a derivative goes through. Whether it failed is known already."""
    model = build(scene)

    def one_block(carry: Progress, lengths: Array) -> tuple[Progress, State]:
        def work(carry: Progress) -> Progress:
            span = jnp.sum(lengths)
            candidates, _ = for_as_long_as_they_last(search(model, carry.state, span), span)

            @functools.partial(jax.checkpoint, prevent_cse=False)
            def one_step(carry: Progress, h: Array) -> tuple[Progress, None]:
                def go(carry: Progress) -> Progress:
                    after, touching = GONE_ON_WITH[control.method](model, carry.state, h, candidates.kept)
                    return taken(model, scene, carry, after, touching, h, candidates.kept, control.observe)

                return lax.cond(h > 0, go, lambda c: c, carry), None

            carry, _ = lax.scan(one_step, carry, lengths)
            return searched(model, candidates, carry)

        carry = lax.cond(lengths[0] > 0, work, lambda c: c, carry)
        return carry, carry.state

    last, states = lax.scan(one_block, first, schedule.lengths)
    last = last._replace(cause=found.cause, failed_at=found.failed_at, next_step=found.next_step)
    return last, jax.tree.map(lambda v: v[schedule.ends], states), schedule.taken
