"""`simulate`: a pure function from a scene to a trajectory. Steps are scanned, checkpointed, and frames looked at after."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from diffeed.base.limits import MAX_STEPS, run_problem, scene_size
from diffeed.base.records import replace
from diffeed.chain.state import State
from diffeed.contact.candidates import search
from diffeed.contact.crossing import misplaced
from diffeed.contact.kept import keep_all
from diffeed.faults.causes import (
    ACROSS,
    BEHIND,
    FROM_NOWHERE,
    LOST_REBOUND,
    NO_REST,
    OUT_OF_ORDER,
    TOO_DEEP,
    UNRESOLVED,
)
from diffeed.faults.judge import severity
from diffeed.faults.rebounds import Slower, in_equal_steps, lost_impulse
from diffeed.input.check_records import checked
from diffeed.input.check_values import show
from diffeed.input.packing import bare, jit_of_scene
from diffeed.input.parts import Scene, normalise, warn_if_single
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.observe import OBSERVERS, End
from diffeed.readings.snapshot import felt_by_bodies, gaps_to_bodies, look, part_names, snapshot
from diffeed.readings.trajectory import Failure, Resume, Trajectory
from diffeed.run import error_control
from diffeed.run.progress import begin, recomputed, searched, taken
from diffeed.steppers import DEFAULT, ESTIMATING, EXPLICIT, ORDERS, STEPPERS

BLOCK, CROWDED_BLOCK = 32, 16
"""Most steps between two searches for candidates; between close walls, where a sheet meets more bodies in as many steps, half."""
LONG_BLOCK = 8
"""Length of a block beyond which a frame may get some steps more than asked for: few long ones stay as they are."""
SEARCHED = 4e-3
"""s: with long steps the searches stay this close in time, lest what moves now says little of what will. The shipped scenes end
alike with 2, 4 and 8 ms."""
MANY = 40_000
"""Steps up to which reverse mode stores the state of every step; beyond, one per block, and computes each step once more."""
STEP, LONGEST, MOST_STEPS = 1e-4, 2e-3, 20_000
"""s: the step if none is given; under error control the longest one, and how many at most."""


class Plan(NamedTuple):
    """Static counts of a run: frames, blocks per frame, steps per block."""

    frames: int
    blocks: int
    steps: int

    @property
    def total(self) -> int:
        return (self.frames - 1) * self.blocks * self.steps


def plan(duration: float, dt: float, frames: int, crowded: bool = False) -> Plan:
    """Counts for a run: a frame is a whole number of steps, so dt is shortened where frames do not divide the run."""
    per_frame = max(1, math.ceil(duration / (frames - 1) / dt - 1e-9))
    return in_blocks(per_frame, frames, min(longest_block(crowded), max(2, int(SEARCHED / dt + 1e-9))))


def longest_block(crowded: bool) -> int:
    return CROWDED_BLOCK if crowded else BLOCK


def in_blocks(per_frame: int, frames: int, most: int) -> Plan:
    """So many steps per frame, in equal blocks of at most `most`; of many steps a few more, if that makes the blocks longer."""
    least = most // 2 if most > LONG_BLOCK else 1
    whole = [k for k in range(most, least - 1, -1) if per_frame % k == 0]
    blocks = per_frame // whole[0] if whole else math.ceil(per_frame / most)
    return Plan(frames, blocks, math.ceil(per_frame / blocks))


def simulate(
    scene: Scene,
    duration: float | None = None,
    dt: float | None = None,
    frames: int = 101,
    method: str = DEFAULT,
    initial: State | Resume | None = None,
    observe: tuple[str, ...] = (),
    tolerance: float | None = None,
    most_steps: int = MOST_STEPS,
) -> Trajectory:
    """Run a scene for `duration` (s; the scene's own if None) and look at it `frames` times, evenly spaced.

    Works alike in plain Python and under `jit`, `grad`, `vmap`. `dt` is the longest step allowed (s; 1e-4 if None); the
    number of steps is static, so inside a trace `dt` must be a Python float. `method` names a stepper (`diffeed.METHODS`).
    `initial` is a state (of `settle`, say) or `trajectory.final` of a run to go on with. `observe` names what to accumulate
    in every step (`diffeed.OBSERVERS`). A run that fails is a value: `trajectory.ok`, `trajectory.failure`.

    With a `tolerance` (mm, error of one step; may be traced) steps are chosen by their error, none longer than `dt` (2e-3
    if None), none past a time at which a profile or a motion changes its course, and at most `most_steps` together, which is
    static: a derivative passes through that many places, a run that needs more fails.

    Raises TypeError for what is no scene, SceneError for numbers that none can have (as far as they are not traced), ValueError
    for another argument that makes no sense; `diffeed.check` judges the scene's geometry too.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"simulate takes a Scene (of diffeed.load_scene or diffeed.scene), but this is {show(scene)}")
    scene = checked(scene)
    warn_if_single(scene)
    duration = scene.duration if duration is None else duration
    dt = dt if dt is not None else STEP if tolerance is None else LONGEST
    refuse(duration, dt, frames, method, observe)
    duration, frames = float(duration), int(frames)
    steps_of = dt if tolerance is None else None
    if problem := run_problem(duration, steps_of, frames, scene_size(scene)):
        raise ValueError(problem)
    observe = tuple(sorted(set(observe)))
    scene = replace(scene, goal="")  # a word for those who judge a run: another one is no other program
    if tolerance is None:
        counts = plan(duration, dt, frames, scene.crowded)
        return _simulate(scene, duration / counts.total, initial, counts, method, observe)
    refuse_control(tolerance, most_steps, frames, method)
    control = error_control.Control(frames - 1, int(most_steps), method, observe)
    return _simulate_to(scene, error_control.Limits(duration / (frames - 1), tolerance, dt), initial, control)


def at_start(scene: Scene, observe: tuple[str, ...] = ()) -> Resume:
    """Where a run of the scene begins, as `simulate` takes it: what goes on from there is the run."""
    scene = normalise(scene)
    return _at_start(scene, tuple(sorted(set(observe))))


@jit_of_scene(static_argnames=("observe",))
def _at_start(scene: Scene, observe: tuple[str, ...]) -> Resume:
    model, scene = build(scene), bare(scene)
    return begin(model, scene, None, observe)


def go_on(
    scene: Scene, start: Resume, dt: Any, steps: int | Plan, method: str = DEFAULT, observe: tuple[str, ...] = ()
) -> Trajectory:
    """So many more steps from where a run stopped, or as many as are planned; their length may be traced: one program serves all
    lengths."""
    scene = replace(normalise(scene), goal="")
    counts = steps if isinstance(steps, Plan) else in_blocks(steps, 2, longest_block(scene.crowded))
    return _simulate(scene, dt, start, counts, method, tuple(sorted(observe)))


def refuse(duration: float, dt: float, frames: int, method: str, observe: tuple[str, ...]) -> None:
    for name, value in (("duration", duration), ("dt", dt)):
        if isinstance(value, Tracer):
            raise TypeError(
                f"{name} is traced, but says how many steps there are: give a Python number; `tolerance` may be traced"
            )
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive number of seconds, but is {value}")
    if int(frames) != frames or frames < 2:
        raise ValueError(f"frames must be a whole number of at least 2, but is {frames}")
    if method not in STEPPERS:
        raise ValueError(f"method must be one of {', '.join(STEPPERS)}, but is {method!r}")
    if isinstance(observe, str) or not set(observe) <= set(OBSERVERS):
        raise ValueError(f"observe must be a tuple of names out of {', '.join(OBSERVERS)}, but is {observe!r}")


def refuse_control(tolerance: Any, most_steps: int, frames: int, method: str) -> None:
    if method not in ESTIMATING:
        raise ValueError(f"with a tolerance, method must be one of {', '.join(ESTIMATING)}, but is {method!r}")
    if not isinstance(tolerance, Array) and not (math.isfinite(tolerance) and tolerance > 0):
        raise ValueError(f"tolerance must be a positive number of mm, but is {tolerance}")
    if int(most_steps) != most_steps or most_steps < frames - 1:
        raise ValueError(
            f"most_steps must be a whole number of at least one per frame ({frames - 1}), but is {most_steps}"
        )
    if most_steps > MAX_STEPS:
        raise ValueError(f"most_steps must be at most {MAX_STEPS:,}, but is {most_steps:,}")


@jit_of_scene(static_argnames=("counts", "method", "observe"))
def _simulate(
    scene: Scene, dt: Any, initial: State | Resume | None, counts: Plan, method: str, observe: tuple[str, ...]
) -> Trajectory:
    """Steps of one length."""
    model, scene = build(scene), bare(scene)
    h = jnp.asarray(dt, scene.gravity.dtype)
    first, slower = begin(model, scene, initial, observe), in_equal_steps(ORDERS[method])

    def one_block(carry: Resume, start: Array) -> Resume:
        with jax.named_scope("search"):
            # Brief lists make short steps; chosen steps would get shorter by them, for they end where a list does.
            found = search(model, carry.state, counts.steps * h, brief=True)

        @recomputed
        def one_step(carry: Resume, k: Array) -> tuple[Resume, None]:
            time = first.state.time + (k + 1).astype(h.dtype) * h  # a whole number of steps times dt: no drift
            after, touching = STEPPERS[method](model, carry.state, h, found.kept)
            after = replace(after, time=time)
            return taken(model, scene, carry, after, touching, h, found.kept, observe, slower, method in EXPLICIT), None

        last, _ = lax.scan(one_step, carry, start + jnp.arange(counts.steps))
        return searched(model, found, carry, last)

    if counts.total > MANY:
        one_block = jax.checkpoint(one_block, prevent_cse=False)  # in a scan nothing is merged that must not be

    def block_of_frame(given: tuple[Resume, State, Array], _: None) -> tuple[tuple[Resume, State, Array], None]:
        carry, states, done = given  # the count goes along: as an input of the scan it would be stored for every block
        carry = one_block(carry, done * counts.steps)
        frame = 1 + done // counts.blocks  # its last block has the last word
        return (carry, jax.tree.map(lambda all, one: all.at[frame].set(one), states, carry.state), done + 1), None

    blocks = (counts.frames - 1) * counts.blocks
    states = jax.tree.map(lambda v: jnp.broadcast_to(v, (counts.frames, *v.shape)), first.state)
    (last, states, _), _ = lax.scan(block_of_frame, (first, states, jnp.asarray(0)), length=blocks)
    gone = jnp.round((last.state.time - first.state.time) / h).astype(int)
    return _trajectory(model, scene, last, states, h, jnp.where(last.cause == 0, counts.total, gone), observe, slower)


@jit_of_scene(static_argnames=("control",))
def _simulate_to(
    scene: Scene, limits: error_control.Limits, initial: State | Resume | None, control: error_control.Control
) -> Trajectory:
    """Steps as long as a tolerance allows."""
    model, scene = build(scene), bare(scene)
    limits = error_control.Limits(*(jnp.asarray(v, scene.gravity.dtype) for v in limits))
    first = begin(model, scene, initial, control.observe)
    last, states, count = error_control.run(control, limits, model, scene, first)
    mean = (last.state.time - first.state.time) / jnp.maximum(count, 1).astype(limits.frame.dtype)
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first.state, states)
    return _trajectory(model, scene, last, states, mean, count, control.observe, error_control.slower(limits))


def _trajectory(
    model: Model,
    scene: Scene,
    last: Resume,
    states: State,
    dt: Array,
    steps: Array,
    observe: tuple[str, ...],
    slower: Slower,
) -> Trajectory:
    """Look at the frames."""
    sheets, rollers, guides = lax.map(lambda s: snapshot(model, s), states)
    end = End(model, last.state, last.half)
    part = _blamed(model, last, dt, slower) if model.has_bodies else jnp.full((), -1, jnp.int32)
    return Trajectory(
        time=states.time,
        dt=dt,
        steps=steps,
        sheets=sheets,
        rollers=rollers,
        guides=guides,
        error=last.error,
        ok=last.cause == 0,
        failure=Failure(
            time=last.failed_at,
            cause=last.cause,
            part=jnp.where((last.cause > NO_REST) & (last.cause != OUT_OF_ORDER), part, -1),
            parts=part_names(model),
        ),
        observed={name: OBSERVERS[name].close(model, scene, last.open[name], end) for name in observe},
        final=last,
        states=states,
    )


def _blamed(model: Model, last: Resume, h: Array, slower: Slower) -> Array:
    """Index into part_names of the roller or guide that the cause is about, else of the one that carries the largest
    force at the last good state; -1: nothing touches. What energy came from may have let go: then it is the nearest one."""
    at, _, touching = look(model, last.state)
    assert touching.sheets is not None
    force, gap = felt_by_bodies(model, touching.sheets, at).force, gaps_to_bodies(model, touching.sheets)
    about = severity(model, touching, keep_all(model), h)
    wrong = misplaced(model, last.state)
    astray = jnp.where(last.cause == BEHIND, wrong.behind, wrong.across).astype(gap.dtype)
    astray = jnp.concatenate([jnp.zeros((len(model.circle_names),)), astray])
    pressed = lax.stop_gradient(jnp.where(jnp.isnan(force), jnp.inf, force))
    nearest = (last.cause == FROM_NOWHERE) & (jnp.max(pressed) <= 0)
    pressed = jnp.where(nearest, 1.0 / (1.0 + jnp.maximum(gap, 0.0)), pressed)
    lost = jnp.sum(lost_impulse(model, touching.sheets, keep_all(model), h, slower), axis=1)
    told = (last.cause == TOO_DEEP) | (last.cause == UNRESOLVED)
    weight = jnp.where(told, about, jnp.where((last.cause == ACROSS) | (last.cause == BEHIND), astray, pressed))
    weight = jnp.where((last.cause == LOST_REBOUND) & (jnp.max(lost) > 0), lost, weight)
    by_part = _by_part(model, weight)
    return jnp.where(jnp.max(by_part) > 0, jnp.argmax(by_part), -1).astype(jnp.int32)


def _by_part(model: Model, values: Array) -> Array:
    """(bodies,) -> the largest for each of part_names: a guide's tips are the guide's."""
    n = model.rollers.n
    names = part_names(model)
    owners = [f"rollers.{name}" for name in model.rollers.names] + [f"guides.{name}" for name in model.body_names[n:]]
    index = np.array([names.index(owner) for owner in owners], dtype=int)
    return jax.ops.segment_max(values, index, len(names))
