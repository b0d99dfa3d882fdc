"""Whether samples come out the same in shorter steps: what scatters may be what the steps leave, not what the tolerances do."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from diffeed.readings.agreement import FINER
from optimize.asked import refuse_runs
from optimize.tolerance.problem import ToleranceProblem
from optimize.tolerance.run import Rows, chosen
from optimize.tolerance.study import here, run_rows

FEWEST, MOST, ONE_IN = 4, 16, 16
"""Samples that are run again: one in so many, so that it costs a quarter of a study; no fewer and no more than these."""
GOOD_PART = 0.3
"""Of the standard deviation of a measure: what the steps leave of that size is told."""
ROUNDING = 1e-9
"""Of a value: smaller changes are those of rounding."""


class Again(NamedTuple):
    """Of some samples, how many came out the same."""

    same: int
    of: int


class Change(NamedTuple):
    """What shorter steps change of a measure or limit; NaN where no sample has a value in both."""

    mean: float
    std: float  # about that mean
    scatter: float  # standard deviation of the values of all samples
    size: float  # the largest of them

    def counts(self, part: float) -> bool:
        """Whether a mean or std is a good part of the scatter, and more than rounding."""
        return abs(part) > max(GOOD_PART * self.scatter, ROUNDING * self.size)


class Confirmation(NamedTuple):
    """Samples of a study run again in steps `FINER` times shorter, or with such a tolerance."""

    samples: np.ndarray  # their indices: half of them did not pass, as far as there are such
    passed: Again  # of those that passed
    others: Again  # of those that did not
    parted: np.ndarray  # indices of those that came out otherwise
    changes: dict[str, Change]
    remedy: str  # what makes the steps of the study shorter, as a sentence begins

    @property
    def holds(self) -> bool:
        """Every one came out the same."""
        return len(self.parted) == 0

    @property
    def unsure(self) -> list[str]:
        """Measures of whose scatter the steps make a good part."""
        return [name for name, change in self.changes.items() if change.counts(change.std)]

    @property
    def shifted(self) -> list[str]:
        """Measures that the steps shift for all samples alike by a good part of their scatter."""
        return [name for name, change in self.changes.items() if change.counts(change.mean)]

    def sentence(self) -> str:
        """What it came to, in words."""
        told = [
            f"of {again.of} that {what} {again.same} {too}"
            for again, what, too in ((self.passed, "passed", "pass too"), (self.others, "did not", "do not either"))
            if again.of
        ]
        text = f"{len(self.samples)} samples run again in steps {FINER} times as fine: {', '.join(told)}."
        if not self.holds:
            text += f" The steps decide on the others ({', '.join(map(str, self.parted))})."
        if self.shifted:
            alike = (f"{name} by {self.changes[name].mean:.3g}" for name in self.shifted)
            text += f" Finer steps shift all of them: {', '.join(alike)}."
        if self.unsure:
            text += f" Of the scatter of {', '.join(self.unsure)} the steps make a good part."
        doubtful = not self.holds or self.shifted or self.unsure
        return f"{text} {self.remedy} tells more." if doubtful else text

    def as_numbers(self) -> dict[str, Any]:
        """For the summary."""
        return {
            "times as fine": FINER,
            "samples": self.samples.tolist(),
            "passed": self.passed._asdict(),
            "others": self.others._asdict(),
            "parted": self.parted.tolist(),
            "changes": {name: {"mean": c.mean, "std": c.std} for name, c in self.changes.items()},
        }


def confirm(problem: ToleranceProblem, rows: Rows) -> Confirmation:
    """Run some of a study's samples again, here. Raises ValueError where such steps are more than a run may have."""
    finer = replace(problem, study=problem.study.finer())
    refuse_runs(finer.study, {"": problem.scene})
    before = chosen(rows, picked(rows.passed))
    after = run_rows(finer, before.deviation, here(finer, len(before.sample)))
    same, passed = before.passed == after.passed, before.passed
    moved = after.values - before.values
    return Confirmation(
        before.sample,
        Again(int(same[passed].sum()), int(passed.sum())),
        Again(int(same[~passed].sum()), int((~passed).sum())),
        before.sample[~same],
        {a.name: _change(moved[:, k], rows.values[:, k]) for k, a in enumerate(problem.asked)},
        "A smaller --dt" if problem.study.step_tolerance is None else "A smaller step_tolerance of the study",
    )


def _change(moved: np.ndarray, values: np.ndarray) -> Change:
    moved, values = moved[np.isfinite(moved)], values[np.isfinite(values)]
    std, scatter = (float(np.std(v, ddof=1)) if len(v) > 1 else np.nan for v in (moved, values))
    mean = float(np.mean(moved)) if len(moved) else np.nan
    return Change(mean, std, scatter, size=float(np.max(np.abs(values), initial=0.0)))


def picked(passed: np.ndarray) -> np.ndarray:
    """Places of the samples to run again: the first that did not pass and the first that did, as many of each if there are."""
    count = min(int(np.clip(len(passed) // ONE_IN, FEWEST, MOST)), len(passed))
    others, fine = np.flatnonzero(~passed), np.flatnonzero(passed)
    n = min(len(others), max(count // 2, count - len(fine)))
    return np.sort(np.concatenate([others[:n], fine[: count - n]]))
