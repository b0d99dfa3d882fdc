"""The hard judgement of a run: `outcome`, a number that works under `vmap`, and `verdict`, its sentence."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.packing import jit_of_scene, stacked
from diffeed.input.parts import LineGuide, Scene, normalise
from diffeed.model.build import build
from diffeed.readings.frames import Feeding, motion
from diffeed.readings.gate import crosses
from diffeed.readings.margin import FOLDED
from diffeed.readings.trajectory import Trajectory
from diffeed.readings.why import place, reasons, still_to_go

STATUSES = ("passed", "late", "jammed", "failed")
"""late: still moving, but the goal is not reached; failed: numerically. In the order of how bad they are."""
REACHED, FREE, RESTS, LATE, FOLDS, STRAYS, STALLS, LET_GO, BROKE = range(9)
_STATUS_OF = np.array([0, 0, 0, 1, 2, 2, 2, 2, 3])
STALLED = 0.1
"""Share of the commanded speed below which a sheet stands still."""
STRAYED = 50.0
"""mm outside the box around all parts that counts as having left the path."""


class Outcome(NamedTuple):
    """What became of a run, of its worst sheet; scalars, or (samples,) under `vmap`."""

    status: Array  # index into STATUSES
    reason: Array
    sheet: Array  # index into the sorted names of the sheets
    frame: Array  # frame at which it was found
    time: Array  # s; the end if it is late, infinite if it was still moving or stood as its rollers did


class Verdict(NamedTuple):
    """passed, jammed, late (still moving, but the goal is not reached) or failed (numerically)."""

    status: str
    reason: str
    time: float | None
    place: str

    def sentence(self) -> str:
        if self.status == "failed":  # the reason says where and when
            return f"failed: {self.reason}"
        when = "" if self.time is None else f" at {self.time:.4g} s"
        where = f", {self.place}" if self.place else ""
        return f"{self.status}{when}: {self.reason}{where}"


def verdict(scene: Scene, trajectory: Trajectory) -> Verdict:
    """Judge a finished run, the worst sheet first. A scene's `goal` names the sensor that each tail must pass."""
    return judged(scene, trajectory)[0]


def judged(scene: Scene, trajectory: Trajectory) -> tuple[Verdict, dict[str, float]]:
    """The verdict, and when each sheet's fate was decided, s: it passed the goal, folded, left the path or stalled. Infinite
    for one that was still on its way at the end, and for all in a run that failed."""
    scene = normalise(scene)
    names = sorted(scene.sheets)
    if not bool(trajectory.ok):
        failure = trajectory.failure
        return Verdict("failed", failure.describe(), float(failure.time), ""), dict.fromkeys(names, np.inf)
    each = _fates(scene, trajectory)
    late = np.asarray(each.status) == STATUSES.index("late")
    decided = dict(zip(names, np.where(late, np.inf, each.time).tolist(), strict=True))
    return _in_words(scene, trajectory, jax.device_get(_worst(each, trajectory.ok, trajectory.failure.time))), decided


def outcome(scene: Scene, trajectory: Trajectory) -> Outcome:
    """The same judgement as numbers, inside a trace too."""
    return _worst(_fates(scene, trajectory), trajectory.ok, trajectory.failure.time)


def _fates(scene: Scene, trajectory: Trajectory) -> Outcome:
    """(sheets,) what became of each, as if the run had not failed."""
    scene = normalise(scene)
    return _judge_each(scene, trajectory, motion(scene, trajectory.states).fed)


@jit_of_scene
def _judge_each(scene: Scene, trajectory: Trajectory, fed: Feeding) -> Outcome:
    names = sorted(scene.sheets)
    each = [_judge(scene, trajectory, n, Feeding(*(v[:, k] for v in fed)), k) for k, n in enumerate(names)]
    return jax.tree.map(lambda *v: jnp.stack(v), *each)


def _worst(each: Outcome, ok: Array, failed_at: Array) -> Outcome:
    """Of all sheets; a run that failed is worse than anything that became of them."""
    worst = jnp.argmax(each.status)
    found: Outcome = jax.tree.map(lambda v: v[worst], each)
    return found._replace(
        status=jnp.where(ok, found.status, _STATUS_OF[BROKE]),
        reason=jnp.where(ok, found.reason, BROKE),
        time=jnp.where(ok, found.time, failed_at),
    )


def _in_words(scene: Scene, trajectory: Trajectory, found: Outcome) -> Verdict:
    name, reason = sorted(scene.sheets)[int(found.sheet)], int(found.reason)
    text = {
        REACHED: f"the tail of {name} passed sensor {scene.goal}",
        FREE: f"{name} was still moving at the end",
        RESTS: f"{name} stood at the end, as the rollers that hold it did",
        LATE: f"the tail of {name} has not passed sensor {scene.goal} at the end of the run",
        FOLDS: f"{name} folded back on itself",
        STRAYS: f"{name} left the path",
        STALLS: f"{name} stalled",
        LET_GO: f"{name} stalled: no driven roller holds it",
    }[reason]
    status = STATUSES[int(found.status)]
    if status != "passed":
        fed = motion(scene, trajectory.states).fed
        fed = Feeding(*(v[:, sorted(scene.sheets).index(name)] for v in fed))
        text += still_to_go(scene, trajectory, name, fed) if reason == LATE else ""
        text += reasons(scene, trajectory, name, fed, int(found.frame) if reason == STALLS else None)
    where = place(scene, trajectory, name, int(found.frame)) if status == "jammed" else ""
    return Verdict(status, text, float(found.time) if np.isfinite(found.time) else None, where)


def _judge(scene: Scene, trajectory: Trajectory, name: str, fed: Feeding, k: int) -> Outcome:
    track, time = trajectory.sheets[name], trajectory.time
    last = time.shape[0] - 1
    done = _passed_goal(scene, trajectory, name)
    folds, strays = _first(_is_folded(track.headings)), _first(_has_strayed(scene, track.nodes))
    fastest = _fastest_drive(scene)
    stalls = last + 1 if fastest is None else _stalled_since(fed, fastest)
    driven = jnp.max(jnp.where(jnp.arange(last + 1) >= stalls, jnp.abs(fed.wanted), 0.0)) > 0
    rests = fed.held[-1] & (jnp.abs(fed.speed[-1]) < STALLED * jnp.max(jnp.abs(fed.wanted)))
    end = LATE if scene.goal else jnp.where(rests, RESTS, FREE)
    tests = [
        (jnp.isfinite(done), REACHED, last),
        (folds <= last, FOLDS, folds),
        (strays <= last, STRAYS, strays),
        (stalls <= last, jnp.where(driven, STALLS, LET_GO), stalls),
    ]
    reason, frame = jnp.asarray(end), jnp.asarray(last)
    for is_so, why, when in reversed(tests):
        reason, frame = jnp.where(is_so, why, reason), jnp.where(is_so, when, frame)
    moving = (reason == FREE) | (reason == RESTS)
    at = jnp.where(reason == REACHED, done, jnp.where(moving, jnp.inf, time[frame]))
    return Outcome(jnp.asarray(_STATUS_OF)[reason], reason, jnp.asarray(k), frame, at)


def _first(flags: Array) -> Array:
    """Index of the first True, or the length."""
    return jnp.where(jnp.any(flags), jnp.argmax(flags), flags.shape[0])


def _passed_goal(scene: Scene, trajectory: Trajectory, name: str) -> Array:
    """Time at which the tail passed the goal, infinite if never: exact if arrivals were observed, else from the frames."""
    if not scene.goal:
        return jnp.asarray(jnp.inf)
    if "arrivals" in trajectory.observed:
        return trajectory.observed["arrivals"][name][scene.goal]["tail"]
    crossed = _first(crosses(scene, trajectory, name, 1.0))
    return jnp.concatenate([trajectory.time[1:], jnp.full((1,), jnp.inf)])[crossed]


def _is_folded(headings: Array) -> Array:
    """(frames,) bool."""
    span = min(3, headings.shape[1] - 1)
    if span < 1:
        return jnp.zeros(len(headings), bool)
    return jnp.any(jnp.abs(headings[:, span:] - headings[:, :-span]) > FOLDED, axis=1)


def _has_strayed(scene: Scene, nodes: Array) -> Array:
    """(frames,) bool."""
    corners = _corners(scene)
    if not len(corners):
        return jnp.zeros(nodes.shape[0], bool)
    # A sheet that starts outside the parts (on a table that is not modelled) has not strayed there.
    points = jnp.concatenate([corners, nodes[0]])
    low, high = jnp.min(points, axis=0) - STRAYED, jnp.max(points, axis=0) + STRAYED
    length = jnp.sqrt(jnp.sum((nodes[0, 0] - nodes[0, -1]) ** 2))
    lead = nodes[:, 0]
    out = jnp.any((lead < (low - length)[None]) | (lead > (high + length)[None]), axis=1)
    # Ahead of the last roller a sheet may hang out by its length; sideways, it may not fall out of the machine.
    return out | (jnp.max(nodes[:, :, 1], axis=1) < low[1])


def _corners(scene: Scene) -> Array:
    """(corners, 2) of the boxes around all rollers and guides."""
    parts = (*scene.rollers.values(), *scene.guides.values())
    lines, rounds = ([p for p in parts if isinstance(p, LineGuide) == is_line] for is_line in (True, False))
    ends = [stacked([getattr(p, end) for p in lines], (2,)) for end in ("start", "end")]
    center, radius = stacked([p.center for p in rounds], (2,)), stacked([p.radius for p in rounds])[:, None]
    return jnp.concatenate([*ends, center - radius, center + radius])


def _fastest_drive(scene: Scene) -> Array | None:
    """mm/s, of the surfaces of all driven rollers at any time; None if there is none."""
    rollers = build(scene).rollers
    spins = jnp.concatenate([jnp.max(jnp.abs(d.values), axis=1) for d in rollers.drives])
    return jnp.max(spins * rollers.radius[rollers.driven]) if spins.shape[0] else None


def _stalled_since(fed: Feeding, fastest: Array) -> Array:
    """Frame since which the sheet has stood still until the end (for at least a twentieth of the run), or the length. What
    nothing ever drove is held against the `fastest` drive; what stands as the rollers that hold it do has not stalled."""
    frames, most = fed.speed.shape[0], jnp.max(jnp.abs(fed.wanted))
    reference = jnp.where(most > 0, most, fastest)
    as_told = fed.held & (jnp.abs(fed.wanted) < STALLED * reference)
    moving = (jnp.abs(fed.speed) >= STALLED * reference) | as_told
    since = jnp.max(jnp.where(moving, jnp.arange(1, frames + 1), 0))
    long_enough = frames - since >= max(2, frames // 20)
    return jnp.where((reference > 0) & long_enough, since, frames)
