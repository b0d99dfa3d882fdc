"""Which setting to use: the cheapest of a sweep that meets the wanted errors, and how sure that is."""

import itertools
import shlex
from dataclasses import dataclass

from diffeed.bench.outcome import MEASURES
from diffeed.bench.records import BenchError, Front, Row
from diffeed.bench.report import digits, resolved
from diffeed.bench.settings import power

LOOSE = 3e-3
"""mm: above this tolerance derivatives through extrapolated steps are useless (measured on the film feeder)."""
STEADY = 2.0
"""A margin of the wanted error over the error that counts as comfortable."""


@dataclass(frozen=True)
class Advice:
    """A row of the sweep; `met` is false if it is only the best there is."""

    row: Row
    met: bool
    sure: bool
    reasons: list[str]  # sentences: why it may be believed, why it may not


def advise(front: Front, wanted: dict[str, float]) -> Advice:
    """The cheapest setting whose errors, with the reference's uncertainty added, are within `wanted` (by measure).

    Only settings that solve the scene as it is: another model or precision is for the user to choose. Raises BenchError
    where nothing can be said.
    """
    _refuse(front, wanted)
    rows = [r for r in front.rows if r.ok and r.setting.numerical]
    meeting = [r for r in rows if all(bound(front, r, m) <= limit for m, limit in wanted.items())]
    if meeting:
        best = min(meeting, key=lambda r: (r.run_seconds or 0.0, r.setting.name))
        reasons, sure = _judge(front, best, wanted)
        return Advice(best, True, sure, reasons)
    best = min(rows, key=lambda r: max(bound(front, r, m) / limit for m, limit in wanted.items()))
    return Advice(best, False, False, _why_not(front, best, wanted))


def bound(front: Front, row: Row, measure: str) -> float:
    """The error that a row may have: against the reference, and that of the reference itself."""
    error = row.errors.get(measure)
    doubt = None if front.reference is None else front.reference.uncertainty.get(measure)
    return float("inf") if error is None else error + (doubt or 0.0)


def _refuse(front: Front, wanted: dict[str, float]) -> None:
    if not wanted:
        raise BenchError("no wanted error is given")
    if front.reference is None:
        raise BenchError(f"no reference, so no errors are known: {front.no_reference}")
    for measure in wanted:
        if front.reference.uncertainty.get(measure) is None:
            raise BenchError(f"this scene has no {MEASURES[measure][0]} to compare")
    if not any(r.ok and r.setting.numerical for r in front.rows):
        causes = "; ".join(f"{r.setting.name}: {r.reason}" for r in front.rows if not r.ok)
        raise BenchError(f"no setting ran: {causes}")


def _judge(front: Front, row: Row, wanted: dict[str, float]) -> tuple[list[str], bool]:
    """Sentences for and against, and whether nothing speaks against."""
    assert front.reference is not None
    found, sure = [], True
    for measure, limit in wanted.items():
        title, unit, _ = MEASURES[measure]
        error, doubt = row.errors[measure] or 0.0, front.reference.uncertainty[measure] or 0.0
        margin = limit / max(bound(front, row, measure), 1e-300)
        found.append(
            f"{title}: error {digits(error)} {unit} ({row.where.get(measure, '')}), reference uncertain by {digits(doubt)}, "
            f"wanted {digits(limit)}: {'a margin of ' + digits(margin) + ' times' if margin < 1e6 else 'a wide margin'}"
        )
        sure &= margin >= STEADY
        if margin < STEADY:
            found.append(f"  less than {STEADY:g} times: another scene like this one may not meet it")
        if 3.0 * doubt > limit:
            sure = False
            found.append(
                "  the reference's uncertainty is not well below the wanted error: run a benchmark with smaller steps"
            )
        words, steady = _neighbours(front, row, measure)
        found.append(f"  {words}")
        sure &= steady
    setting = row.setting
    if setting.method == "extrapolated_euler" and (setting.tolerance or 0.0) > LOOSE:
        found.append("not for gradients: at such a tolerance derivatives through extrapolated_euler grow without bound")
    return found, sure


def _neighbours(front: Front, row: Row, measure: str) -> tuple[str, bool]:
    """Whether the error falls with the step (or tolerance) from the next coarser to the next finer setting."""
    kind = (row.setting.group, row.setting.method)
    line = [r for r in front.rows if (r.setting.group, r.setting.method) == kind]
    line.sort(key=lambda r: -_size(r))
    k = next(i for i, r in enumerate(line) if r is row)
    near = [r for r in line[max(0, k - 1) : k + 2] if r.ok]
    if not _falls(front, near, measure):
        shown = ", ".join(f"{digits(r.errors.get(measure))} at {r.setting.size}" for r in near)
        return f"its neighbours do not agree ({shown}): the error may be small by chance", False
    if len(near) == 3:
        return "its neighbours agree: the error falls as the step does", True
    if k > 0 and not line[k - 1].ok:
        return f"at {line[k - 1].setting.size} the run failed; the finer neighbour agrees", len(near) > 1
    return "at the end of the sweep: one neighbour is missing", len(near) > 1


def _size(row: Row) -> float:
    return row.setting.dt if row.setting.tolerance is None else row.setting.tolerance


def _falls(front: Front, near: list[Row], measure: str) -> bool:
    """From coarse to fine no error grows, but for those that are below what the reference can tell."""
    errors = [r.errors.get(measure) for r in near]
    known = [e for e in errors if e is not None]
    steps = itertools.pairwise(known)
    return len(known) == len(errors) and all(b <= a or not resolved(front, measure, b) for a, b in steps)


def _why_not(front: Front, best: Row, wanted: dict[str, float]) -> list[str]:
    assert front.reference is not None
    found = []
    for measure, limit in wanted.items():
        title, unit, _ = MEASURES[measure]
        doubt, reach = front.reference.uncertainty[measure] or 0.0, bound(front, best, measure)
        if reach <= limit:
            continue
        cause = "the smallest step of the sweep is too coarse: give smaller ones with --dt"
        if doubt > limit:
            cause = "the reference itself is not known that well: this scene does not converge that far at these steps"
        found.append(
            f"{title}: within {digits(reach)} {unit} (error {digits(best.errors[measure])}, reference uncertain by "
            f"{digits(doubt)}), wanted {digits(limit)}: {cause}"
        )
    return found


def cheaper_models(front: Front, row: Row, wanted: dict[str, float]) -> list[str]:
    """Other models that are cheaper and no further from the reference than wanted: named, not chosen."""
    return [
        f"{r.setting.name}: {digits(r.cost(front.duration))} s per simulated second"
        for r in front.rows
        if r.ok and not r.setting.numerical and (r.run_seconds or 0.0) < (row.run_seconds or 0.0)
        and all(bound(front, r, m) <= limit for m, limit in wanted.items())
    ]  # fmt: skip


def command(front: Front, row: Row) -> str:
    """The command line that runs a scene so."""
    s = row.setting
    words = ["diffeed", "run", front.scene, "--duration", f"{front.duration:g}"]
    words += ["--dt", power(s.dt), "--method", s.method]
    words += [] if s.tolerance is None else ["--tolerance", power(s.tolerance)]
    words += ["--float32"] if s.precision == "float32" else []
    for change in (*front.assignments, *s.changes):
        words += ["--set", change]
    return " ".join(shlex.quote(w) for w in words)


def call(front: Front, row: Row) -> str:
    """The call of `simulate` that does the same."""
    given = ", ".join(
        f"{k}={v!r}" if isinstance(v, str) else f"{k}={power(v)}" for k, v in row.setting.options().items()
    )
    return f"diffeed.simulate(scene, duration={front.duration:g}, {given})"
