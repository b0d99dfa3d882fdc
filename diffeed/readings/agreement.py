"""Whether a run is what one with shorter steps comes to: what no run can tell of itself.

A run sees what its steps do, not what they leave out: a rebound that begins and ends within a step, a sheet that buckles
to whichever side rounding tips it.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from diffeed.base.limits import MAX_STEPS
from diffeed.faults.causes import SHORTER
from diffeed.input.parts import Scene
from diffeed.readings.observe import NIP_WORDS, nip_unit
from diffeed.readings.trajectory import Trajectory
from diffeed.readings.verdict import judged

FINER = 4
"""Times shorter are the steps, or smaller the tolerance, of the run to compare with."""
TOLD, SHARE = 3.0, 0.02
"""Times the error that the run tells of, and of the longest way that a node made: runs that agree differ by less than the
larger."""
WIDEST = 0.05
"""Of the same way: no error that a run tells of excuses more."""
APART, SMALL = 0.2, 0.05
"""Of a roller's own value and of the largest of all rollers: what differs by more than both is not confirmed. Less than a fifth
moves few decisions, and what is small beside the others' counts for little."""
MOST = 5
"""Differences that are told."""
OF_ROLLERS = ("slip_rms", "force_mean", "force_peak", "torque_mean")
"""What of a roller is held against the finer run, where both observed `nips`."""
OF_GUIDES = ("force_mean", "force_peak")
"""What of a guide, where both observed `guides`."""


def finer(dt: float | None = None, tolerance: float | None = None, most_steps: int | None = None) -> dict[str, Any]:
    """The keywords of a run to compare with: `dt` (s), or `tolerance` (mm), `FINER` times smaller, with as many more
    `most_steps` where they are given."""
    if tolerance is None:
        assert dt is not None
        return {"dt": dt / FINER}
    most = {} if most_steps is None else {"most_steps": min(FINER * most_steps, MAX_STEPS)}
    return {"tolerance": tolerance / FINER, **most}


class Confirmation(NamedTuple):
    """How far two runs of a scene are apart."""

    apart: float  # mm, of any node at any frame of both until its sheet's fate is decided
    sheet: str
    time: float  # s, when
    way: float  # mm: the longest that a node of the finer run made
    before: str  # status of the run: passed, late, jammed, failed
    after: str  # and of the finer one
    until: float  # s, up to which the runs were compared: when the fate of the last sheet was decided, or the end
    holds: bool  # they have one status, and are no further apart than TOLD, WIDEST and SHARE allow
    unsure: tuple[str, ...] = ()  # what of rollers and guides differs, in words; empty where it was not observed
    later: float = 0.0  # mm, of any node after its sheet's fate was decided, which does not count

    @property
    def to_the_end(self) -> bool:
        """Whether it holds, and of what a sheet did after its fate was decided, too."""
        return self.holds and not self.later > max(2.0 * self.apart, SHARE * self.way)

    def sentence(self) -> str:
        """What it came to, in words."""
        told = self._of_place()
        if self.holds and self.unsure:
            more = [f"and {len(self.unsure) - MOST} more"] if len(self.unsure) > MOST else []
            told += f" Not confirmed of rollers and guides: {'; '.join([*self.unsure[:MOST], *more])}."
        return told

    def _of_place(self) -> str:
        where = f"{self.apart:.3g} mm elsewhere ({self.sheet}, at {self.time:.3g} s), of {self.way:.3g} mm moved"
        up_to = f"until {self.until:.3g} s the sheet is"
        if self.holds:
            told = f"Confirmed by a run {FINER} times as fine: {up_to} at most {where}, and the verdict is the same."
            if not self.to_the_end:
                told += f" Not so what came after that: it comes up to {self.later:.3g} mm elsewhere."
            return told
        away = f"Not confirmed: in a run {FINER} times as fine, {up_to} up to {where}, and the "
        if self.after == self.before:
            return f"{away}verdict is the same. Believe no more than the verdict: {SHORTER}."
        return f"{away}verdict is {self.after}. Believe neither run: {SHORTER}."


def confirm(scene: Scene, run: Trajectory, again: Trajectory) -> Confirmation:
    """Compare a run with one of the same scene, duration and frames made `again` with steps `FINER` times shorter (or such a
    tolerance).

    What a sheet does after it has passed the goal or jammed in both is not compared. A run that failed is compared up to
    there, and not confirmed. Raises ValueError where the frames are not the same.
    """
    count = min(len(run.time), len(again.time))
    times = np.asarray(run.time)[:count]
    alike = np.allclose(times, np.asarray(again.time)[:count], rtol=1e-6, atol=0.0)
    if run.ok and again.ok and not (alike and len(run.time) == len(again.time)):
        ends = (f"{len(r.time)} until {float(r.time[-1]):g} s" for r in (run, again))
        raise ValueError(f"the runs must have the same frames, but have {' and '.join(ends)}")
    (first, fates), (second, finer_fates) = (judged(scene, r) for r in (run, again))
    before, after = first.status, second.status
    apart, way, sheet, frame, until, later = 0.0, 0.0, min(run.sheets), 0, 0, 0.0
    for name, track in run.sheets.items():
        fate = max(fates[name], finer_fates[name]) if before == after else np.inf
        last = min(int(np.searchsorted(times, fate)) + 1, count)  # the first frame after it as well
        mine, other = (np.asarray(t.nodes)[:count] for t in (track, again.sheets[name]))
        every = np.linalg.norm(mine - other, axis=-1).max(axis=1)
        gaps, later = every[:last], max(later, float(every[last:].max(initial=0.0)))
        steps = np.linalg.norm(np.diff(other[:last], axis=0), axis=-1)
        way, until = max(way, float(steps.sum(axis=0).max(initial=0.0))), max(until, last - 1)
        if not gaps.max() <= apart:  # what is not a number is further than any
            apart, sheet, frame = float(gaps.max()), name, int(gaps.argmax())
    near = apart <= max(min(TOLD * float(run.error), WIDEST * way), SHARE * way)
    holds = bool(near and before == after != "failed")
    unsure = tuple(_unlike(run, again)) if run.ok and again.ok else ()
    found = (apart, sheet, float(times[frame]), way, before, after, float(times[until]), holds)
    return Confirmation(*found, unsure, later)


def _unlike(run: Trajectory, again: Trajectory) -> Iterator[str]:
    """What the rollers and guides of two runs do differently, over the whole of both."""
    for observer, asked in (("nips", OF_ROLLERS), ("guides", OF_GUIDES)):
        if observer not in run.observed or observer not in again.observed:
            continue
        mine, other = run.observed[observer], again.observed[observer]
        for field in asked:
            values = {name: [float(getattr(parts[name], field)) for parts in (mine, other)] for name in mine}
            largest = max((abs(v) for pair in values.values() for v in pair if np.isfinite(v)), default=0.0)
            for name, (here, there) in values.items():
                if abs(here - there) > max(APART * max(abs(here), abs(there)), SMALL * largest):
                    yield f"{NIP_WORDS[field]} of {name}, {here:.3g} {nip_unit(field)} here and {there:.3g} there"
