"""Whether what a search found is better in shorter steps too: a search sees no more than its steps do, and takes what they
leave wrong for a gain."""

from dataclasses import dataclass, replace

from diffeed.readings.agreement import FINER
from optimize.asked import refuse_runs
from optimize.design_run import Result, Scored, score
from optimize.problem import SLACK

PART = 0.5
"""Of the gain of a search: less that is left in shorter steps is told."""


@dataclass(frozen=True)
class Confirmation:
    """The machine before and after in steps `FINER` times shorter, or such a tolerance."""

    before: Scored
    after: Scored
    searched: tuple[float, float]  # the objectives of both in the steps of the search

    @property
    def holds(self) -> bool:
        """It is better in these steps too."""
        return self.after.rank < self.before.rank

    @property
    def mostly_of_the_steps(self) -> bool:
        """What is gained in these steps is less than `PART` of what the search gained in its own. Not where limits were broken
        before, for then the objective may have to grow."""
        (one, two), kept = self.searched, self.before.violation <= SLACK
        return kept and 0.0 <= self.before.objective - self.after.objective < PART * (one - two)

    def sentence(self) -> str:
        """What it came to, in words."""
        (one, two), (first, then) = self.searched, (self.before.objective, self.after.objective)
        told = f"in steps {FINER} times as fine the objective goes from {first:.4g} to {then:.4g}, in the search's own from "
        told += f"{one:.4g} to {two:.4g}"
        told += f"; there {_state(self.before)} before, {_state(self.after)} after"
        if self.holds and self.mostly_of_the_steps:
            return f"Confirmed in part: {told}. Most of that gain is of the steps: search with a smaller dt, or a step_tolerance."
        if self.holds:
            return f"Confirmed: {told}."
        return f"Not confirmed: {told}. That is no gain: search with a smaller dt, or a step_tolerance."


def _state(point: Scored) -> str:
    """Whether it runs and keeps the limits, in words."""
    statuses = [v.status for v in point.verdicts]
    ran = "/".join(dict.fromkeys(statuses))
    if point.violation <= SLACK:
        return ran
    return f"{ran} with limits broken by up to {point.violation:.2g} of their scale"


def confirm(result: Result) -> Confirmation | None:
    """Score the machine before and after a search in steps `FINER` times shorter; None where the search found nothing better.

    Raises ValueError where such steps are more than a run may have.
    """
    if not result.improved:
        return None
    problem = replace(result.problem, study=result.problem.study.finer())
    where = [f"media.{name}" if name else "" for name in problem.media]
    refuse_runs(problem.study, dict(zip(where, problem.scenes, strict=True)))
    before, after = (score(problem, point.unit) for point in (result.before, result.after))
    return Confirmation(before, after, (result.before.objective, result.after.objective))
