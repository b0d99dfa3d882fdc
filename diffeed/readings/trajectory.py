"""Trajectory: what a run hands back. Arrays stand by part in one block; `trajectory.rollers["pinch_1"]` cuts one out.

Under `vmap` every array gains leading batch axes; parts are always cut from the last axes.
"""

from collections.abc import Iterator
from typing import Any, Generic, TypeVar

import numpy as np

from diffeed.base.records import fields, number, record, replace, word
from diffeed.chain.state import State
from diffeed.faults.causes import CAUSES, REMEDIES

T = TypeVar("T")


@record
class SheetTrack:
    """One sheet over time."""

    nodes: Any = number(unit="mm", doc="(frames, bars + 1, 2), node 0 the leading edge")
    velocities: Any = number(unit="mm/s", doc="(frames, bars + 1, 2)")
    headings: Any = number(unit="rad", doc="(frames, bars), absolute, never wrapped")
    rates: Any = number(unit="rad/s", doc="(frames, bars)")
    force: Any = number(unit="N", doc="(frames, bars) sum of normal contact forces on each bar")
    push: Any = number(unit="N", doc="(frames, bars, 2) contact force on each bar, friction included")


@record
class RollerTrack:
    """Rollers over time; forces are the law at the frame's own state."""

    center: Any = number(unit="mm", doc="(frames, 2)", shape=(2,))
    travel: Any = number(unit="mm", doc="(frames,) along its direction; 0 for a fixed roller")
    angle: Any = number(unit="rad", doc="(frames,)")
    angular_velocity: Any = number(
        unit="rad/s", doc="(frames,); of a driven one against what carries it, if that turns"
    )
    force: Any = number(unit="N", doc="(frames,) normal force from sheets")
    friction: Any = number(unit="N", doc="(frames,) friction on sheets along their heading")
    torque: Any = number(
        unit="N mm", doc="(frames,) of sheets and other rollers on it; a drive must supply the opposite"
    )
    slip: Any = number(
        unit="mm/s", doc="(frames,) roller surface minus sheet along the heading, weighted by force; 0 if idle"
    )
    gap: Any = number(unit="mm", doc="(frames,) smallest signed gap to any sheet")


@record
class GuideTrack:
    """Guides over time."""

    displacement: Any = number(unit="mm", doc="(frames, 2) of its prescribed movement", shape=(2,))
    rotation: Any = number(unit="rad", doc="(frames,) of its prescribed movement")
    force: Any = number(unit="N", doc="(frames,) normal force from sheets")
    friction: Any = number(unit="N", doc="(frames,) friction on sheets along their heading")
    gap: Any = number(unit="mm", doc="(frames,) smallest signed gap to any sheet")


@record
class Parts(Generic[T]):
    """Tracks of many parts in one block; a read-only mapping from name to track."""

    block: Any
    names: tuple[str, ...] = word(default=(), doc="names in the block's order", type=tuple)

    def __getitem__(self, name: str) -> T:
        k = self.names.index(name) if name in self.names else None
        if k is None:
            raise KeyError(f"no part named {name!r}; known: {', '.join(self.names) or 'none'}")
        cut = {
            f.name: getattr(self.block, f.name)[(..., k, *[slice(None)] * len(f.metadata["shape"]))]
            for f in fields(self.block)
        }
        return replace(self.block, **cut)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def keys(self) -> tuple[str, ...]:
        return self.names

    def items(self) -> list[tuple[str, T]]:
        return [(name, self[name]) for name in self.names]

    def values(self) -> list[T]:
        return [self[name] for name in self.names]


@record
class Failure:
    """Why a run is not to be believed; cause 0 and time infinity where it is."""

    time: Any = number(unit="s", doc="when")
    cause: Any = number(unit="1", doc="index into CAUSES")
    part: Any = number(unit="1", doc="index into `parts` of the part to blame, or pressed hardest then; -1: none")
    parts: tuple[str, ...] = word(default=(), doc="names of all parts", type=tuple)

    def describe(self) -> str:
        """One sentence; empty for a run that holds. Needs concrete values of a single run."""
        cause = int(self.cause)
        if cause == 0:
            return ""
        part = f", at {self.parts[int(self.part)]}" if int(self.part) >= 0 else ""
        return f"at {float(self.time):.6g} s{part}: {CAUSES[cause]}"

    def remedy(self) -> str:
        """What helps, in a few words; empty for a run that holds."""
        return REMEDIES[int(self.cause)]


@record
class Trajectory:
    """A run: frames, failure as a value, and what was observed in every step."""

    time: Any = number(unit="s", doc="(frames,)")
    dt: Any = number(unit="s", doc="step actually taken; with a tolerance, their mean")
    steps: Any = number(unit="1", doc="steps taken")
    sheets: dict[str, SheetTrack] = number(unit="", doc="a SheetTrack by name")
    rollers: Parts[RollerTrack] = number(unit="", doc="a RollerTrack by name")
    guides: Parts[GuideTrack] = number(unit="", doc="a GuideTrack by name")
    error: Any = number(
        unit="mm",
        doc="estimate of what the steps' length leaves in the sheet's place: half of each step at the speed gained in it, "
        "summed; a stepper of higher order does better, a sheet that hits or buckles may do worse",
    )
    ok: Any = number(unit="1", doc="bool: the run holds")
    failure: Failure = number(unit="", doc="time, part and cause if it does not")
    observed: dict[str, Any] = number(unit="", doc="what `observe` asked for")
    final: "Resume" = number(unit="", doc="hand it to `simulate(initial=...)` to go on")
    states: State = number(unit="", doc="the full state of every frame")


@record
class Resume:
    """What a run needs to go on where another stopped: state, failure so far, open observations, next step to try (s),
    the sheets' energy, the error so far, what rebounds they lack and half of the last step."""

    state: State  # at the end of the run
    cause: Any  # number of the cause of a failure, 0 for none
    failed_at: Any  # s
    open: dict[str, Any]  # observations that go on, by name
    next_step: Any  # s
    book: Any  # of the sheets' energy
    error: Any  # mm, so far
    lacks: Any  # of the sheets' speeds, by rebounds that steps took away
    half: Any  # s, of the last step: in an integral by the trapezoidal rule it belongs to the next look


FRAMED = ("time", "sheets", "rollers", "guides", "states")
"""What of a trajectory has frames."""


def join(pieces: list[Trajectory]) -> Trajectory:
    """One trajectory from consecutive runs, each begun from the one before (the shared frame is kept once)."""

    def along(*values: Any) -> Any:
        arrays = [np.asarray(v) for v in values]
        return np.concatenate([arrays[0]] + [a[1:] for a in arrays[1:]])

    import jax

    last = pieces[-1]
    merged = {name: jax.tree.map(along, *[getattr(p, name) for p in pieces]) for name in FRAMED}
    steps = sum(np.asarray(p.steps) for p in pieces)
    return replace(last, steps=steps, dt=(merged["time"][-1] - merged["time"][0]) / np.maximum(steps, 1), **merged)
