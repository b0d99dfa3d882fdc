"""Whether samples come out the same in shorter steps: what scatters may be what the steps leave, not what the tolerances do."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from diffeed.readings.agreement import FINER
from optimize.asked import run_problems
from optimize.tolerance.problem import ToleranceProblem
from optimize.tolerance.run import Rows, chosen
from optimize.tolerance.study import here, run_rows

FEWEST, MOST, ONE_IN = 4, 16, 16
"""Samples that are run again: one in so many, so that it costs a quarter of a study; no fewer and no more than these."""
GOOD_PART = 0.3
"""Of the standard deviation of a measure: what the steps leave of that size is told."""


class Again(NamedTuple):
    """Of some samples, how many came out the same."""

    same: int
    of: int


class Confirmation(NamedTuple):
    """Samples of a study run again in steps `FINER` times shorter, or with such a tolerance."""

    samples: np.ndarray  # their indices: half of them did not pass, as far as there are such
    passed: Again  # of those that passed
    others: Again  # of those that did not
    apart: dict[str, float]  # RMS of the change of each measure and limit; NaN where no sample has a value in both
    scatter: dict[str, float]  # standard deviation of the same among all samples

    @property
    def holds(self) -> bool:
        """Every one came out the same."""
        return all(again.same == again.of for again in (self.passed, self.others))

    @property
    def unsure(self) -> list[str]:
        """Measures of whose scatter the steps make a good part."""
        return [name for name, value in self.apart.items() if value > GOOD_PART * self.scatter[name]]

    def sentence(self) -> str:
        """What it came to, in words."""
        told = [
            f"of {again.of} that {what} {again.same} {too}"
            for again, what, too in ((self.passed, "passed", "pass too"), (self.others, "did not", "do not either"))
            if again.of
        ]
        count = len(self.samples)
        text = f"{count} samples run again in steps {FINER} times as fine: {', '.join(told)}."
        if not self.holds:
            text += " The steps decide on the others: give a smaller --dt, or the study a step_tolerance."
        elif self.unsure:
            text += f" Of the scatter of {', '.join(self.unsure)} the steps make a good part: a smaller --dt tells how much."
        return text

    def as_numbers(self) -> dict[str, Any]:
        """For the summary."""
        return {
            "times as fine": FINER,
            "samples": self.samples.tolist(),
            "passed": self.passed._asdict(),
            "others": self.others._asdict(),
            "apart": self.apart,
        }


def confirm(problem: ToleranceProblem, rows: Rows) -> Confirmation:
    """Run some of a study's samples again, here. Raises ValueError where such steps are more than a run may have."""
    study, problems = problem.study.finer(), list[str]()
    run_problems(study, problem.scene, "", problems)
    if problems:
        raise ValueError("; ".join(problems))
    before = chosen(rows, picked(rows.passed))
    finer = replace(problem, study=study)
    after = run_rows(finer, before.deviation, here(finer, len(before.sample)))
    same, passed = before.passed == after.passed, before.passed
    apart, scatter = {}, {}
    for k, asked in enumerate(problem.asked):
        change, values = after.values[:, k] - before.values[:, k], rows.values[:, k]
        change, values = change[np.isfinite(change)], values[np.isfinite(values)]
        apart[asked.name] = float(np.sqrt(np.mean(change**2))) if len(change) else np.nan
        scatter[asked.name] = float(np.std(values, ddof=1)) if len(values) > 1 else np.nan
    return Confirmation(
        before.sample,
        Again(int(same[passed].sum()), int(passed.sum())),
        Again(int(same[~passed].sum()), int((~passed).sum())),
        apart,
        scatter,
    )


def picked(passed: np.ndarray) -> np.ndarray:
    """Places of the samples to run again: the first that did not pass and the first that did, as many of each if there are."""
    count = min(int(np.clip(len(passed) // ONE_IN, FEWEST, MOST)), len(passed))
    others, fine = np.flatnonzero(~passed), np.flatnonzero(passed)
    n = min(len(others), max(count // 2, count - len(fine)))
    return np.sort(np.concatenate([others[:n], fine[: count - n]]))
