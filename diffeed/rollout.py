"""`simulate`: a pure function from a scene to a trajectory. Steps are scanned, checkpointed, and frames looked at after."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from diffeed import stick
from diffeed.candidates import Candidates, check_reach, search
from diffeed.contact import Kept
from diffeed.forces import Contacts
from diffeed.kinematics import to_nodes
from diffeed.model import Model, build
from diffeed.observe import OBSERVERS, Seen
from diffeed.parts import Scene, normalise, warn_if_single
from diffeed.records import replace
from diffeed.snapshot import by_guide, felt_by_bodies, look, part_names, roller_order, snapshot
from diffeed.state import State, initial_state
from diffeed.statics import settle_model
from diffeed.steppers import DEFAULT, STEPPERS
from diffeed.trajectory import (
    MOVED_TOO_FAR,
    NO_REST,
    NOT_FINITE,
    TOO_DEEP,
    TOO_FAST,
    TOO_MANY_NEAR,
    Failure,
    Resume,
    Trajectory,
)

BLOCK = 16
"""Most steps between two searches for candidates."""
MANY = 40_000
"""Steps up to which reverse mode stores the state of every step; beyond, one per block, and computes each step once more."""
DEEPEST = 3.0
"""mm: a bar axis further inside a roller or circle guide than this (or than half its radius) went through it."""
FASTEST = 1e7
"""mm/s: ten kilometres a second."""


class Plan(NamedTuple):
    """Static counts of a run: frames, blocks per frame, steps per block."""

    frames: int
    blocks: int
    steps: int

    @property
    def total(self) -> int:
        return (self.frames - 1) * self.blocks * self.steps


def plan(duration: float, dt: float, frames: int) -> Plan:
    """Counts for a run: a frame is a whole number of steps, so dt is shortened where frames do not divide the run."""
    per_frame = max(1, math.ceil(duration / (frames - 1) / dt - 1e-9))
    whole = [k for k in range(BLOCK, BLOCK // 2 - 1, -1) if per_frame % k == 0]
    blocks = per_frame // whole[0] if whole else math.ceil(per_frame / BLOCK)
    return Plan(frames, blocks, math.ceil(per_frame / blocks))


def simulate(
    scene: Scene,
    duration: float | None = None,
    dt: float = 1e-4,
    frames: int = 101,
    method: str = DEFAULT,
    initial: State | Resume | None = None,
    observe: tuple[str, ...] = (),
) -> Trajectory:
    """Run a scene for `duration` (s; the scene's own if None) and look at it `frames` times, evenly spaced.

    Works alike in plain Python and under `jit`, `grad`, `vmap`. `dt` is the longest step allowed (s); the number of steps
    is static, so inside a trace `dt` must be a Python float. `method` names a stepper (`diffeed.METHODS`). `initial` is a
    state (of `settle`, say) or `trajectory.final` of a run to go on with. `observe` names what to accumulate in every
    step (`diffeed.OBSERVERS`). A run that fails is a value: `trajectory.ok`, `trajectory.failure`.

    Raises ValueError for a static argument that makes no sense; call `diffeed.check` for the scene's own numbers.
    """
    scene = normalise(scene)
    warn_if_single(scene)
    duration = scene.duration if duration is None else float(duration)
    _refuse(duration, dt, frames, method, observe)
    return _simulate(
        scene,
        duration / plan(duration, dt, frames).total,
        initial,
        plan(duration, dt, frames),
        method,
        tuple(sorted(set(observe))),
    )


def _refuse(duration: float, dt: float, frames: int, method: str, observe: tuple[str, ...]) -> None:
    for name, value in (("duration", duration), ("dt", dt)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive number of seconds, but is {value}")
    if int(frames) != frames or frames < 2:
        raise ValueError(f"frames must be a whole number of at least 2, but is {frames}")
    if method not in STEPPERS:
        raise ValueError(f"method must be one of {', '.join(STEPPERS)}, but is {method!r}")
    if isinstance(observe, str) or not set(observe) <= set(OBSERVERS):
        raise ValueError(f"observe must be a tuple of names out of {', '.join(OBSERVERS)}, but is {observe!r}")


class Progress(NamedTuple):
    """Carry of the scan: state, first failure, accumulators."""

    state: State
    cause: Array
    failed_at: Array
    open: dict[str, Any]


@functools.partial(jax.jit, static_argnames=("counts", "method", "observe"))
def _simulate(
    scene: Scene, dt: Any, initial: State | Resume | None, counts: Plan, method: str, observe: tuple[str, ...]
) -> Trajectory:
    model = build(scene)
    h = jnp.asarray(dt, scene.gravity.dtype)
    first = begin(model, scene, initial, observe)

    def one_frame(carry: Progress, frame: Array) -> tuple[Progress, State]:
        starts = (frame * counts.blocks + jnp.arange(counts.blocks)) * counts.steps
        carry, _ = lax.scan(one_block, carry, starts)
        return carry, carry.state

    def one_block(carry: Progress, start: Array) -> tuple[Progress, None]:
        with jax.named_scope("search"):
            found = search(model, carry.state, counts.steps * h)

        @functools.partial(jax.checkpoint, prevent_cse=False)  # in a scan nothing can be merged that must not be
        def one_step(carry: Progress, k: Array) -> tuple[Progress, None]:
            time = first.state.time + (k + 1).astype(h.dtype) * h  # a whole number of steps times dt: no drift
            return _guarded_step(model, scene, carry, h, time, found, method, observe), None

        carry, _ = lax.scan(one_step, carry, start + jnp.arange(counts.steps))
        lost = (carry.cause == 0) & ~check_reach(model, found, carry.state)
        cause = jnp.where(found.complete, MOVED_TOO_FAR, TOO_MANY_NEAR).astype(jnp.int32)
        return carry._replace(
            cause=jnp.where(lost, cause, carry.cause), failed_at=jnp.where(lost, carry.state.time, carry.failed_at)
        ), None

    if counts.total > MANY:
        one_block = jax.checkpoint(one_block, prevent_cse=False)
    last, states = lax.scan(one_frame, first, jnp.arange(counts.frames - 1))
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first.state, states)
    sheets, rollers, guides = lax.map(lambda s: snapshot(model, s), states)
    part = _hardest_pressed(model, last.state) if model.has_bodies else jnp.full((), -1, jnp.int32)
    return Trajectory(
        time=states.time,
        dt=h,
        sheets=sheets,
        rollers=rollers,
        guides=guides,
        ok=last.cause == 0,
        failure=Failure(
            time=last.failed_at, cause=last.cause, part=jnp.where(last.cause > 1, part, -1), parts=part_names(model)
        ),
        observed={name: OBSERVERS[name].close(model, scene, last.open[name], last.state) for name in observe},
        final=Resume(**last._asdict()),
        states=states,
    )


def begin(model: Model, scene: Scene, initial: State | Resume | None, observe: tuple[str, ...]) -> Progress:
    """Where a run starts: from a state, from another run, or from the scene itself (settled if it says so)."""
    if isinstance(initial, Resume):
        return Progress(initial.state, initial.cause, initial.failed_at, initial.open)
    state, found = None if initial is None else stick.fitted(model, initial), jnp.asarray(True)
    if state is None:
        state = initial_state(model, scene)
        if scene.initial == "settled":
            with jax.named_scope("settle"):
                state, found = settle_model(model, state)
    cause = jnp.where(found, 0, NO_REST).astype(jnp.int32)
    failed_at = jnp.where(found, jnp.inf, state.time)
    start = {name: OBSERVERS[name].start(model, scene, state) for name in observe}
    return Progress(state, cause, failed_at, start)


def _guarded_step(
    model: Model,
    scene: Scene,
    carry: Progress,
    h: Array,
    time: Array,
    found: Candidates,
    method: str,
    observe: tuple[str, ...],
) -> Progress:
    """One step; a run that has failed stands still, so that its last good state can be looked at."""
    before = carry.state
    after, touching = STEPPERS[method](model, before, h, found.kept)
    after = replace(after, time=time)
    cause = _judge(model, after, found.kept, touching)
    fine = (carry.cause == 0) & (cause == 0)
    opened = carry.open
    if observe:
        guides = any(OBSERVERS[name].guides for name in observe)
        seen = Seen(before, after, h, *look(model, before, guides))
        opened = {name: OBSERVERS[name].update(model, scene, carry.open[name], seen) for name in observe}
    return Progress(
        state=jax.tree.map(lambda a, b: jnp.where(fine, a, b), after, before),
        cause=jnp.where(carry.cause == 0, cause, carry.cause),
        failed_at=jnp.where((carry.cause == 0) & (cause > 0), time, carry.failed_at),
        open=jax.tree.map(lambda a, b: jnp.where(fine, a, b), opened, carry.open),
    )


def _judge(model: Model, after: State, kept: Kept, touching: Contacts) -> Array:
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


def _hardest_pressed(model: Model, state: State) -> Array:
    """Index into part_names of the roller or guide that carries the largest force at a state."""
    at, _, touching = look(model, state)
    assert touching.sheets is not None
    felt = felt_by_bodies(model, touching.sheets, at)
    rollers = felt.force[: model.rollers.n][roller_order(model)]
    forces = lax.stop_gradient(jnp.concatenate([rollers, by_guide(model, felt).force]))
    return jnp.argmax(jnp.where(jnp.isnan(forces), jnp.inf, forces)).astype(jnp.int32)
