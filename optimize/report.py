"""What a search gives its user: a table on the screen, and a folder with scene, numbers and pictures."""

import json
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import diffeed
from diffeed import player
from diffeed.base.files import write_whole
from diffeed.base.terminal import plain_table
from optimize.blame_map import arising, blame, parts_of
from optimize.confirmation import Confirmation
from optimize.descent import raises
from optimize.design_run import Result, Scored, run_of
from optimize.journal import FILES, SUMMARY
from optimize.problem import SLACK, Problem
from optimize.study import Goal, Limit, Robust

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

WORDS = ("unit", "wanted")
"""Columns of words in the tables."""
STEEP = 1e4
"""Times the objective that a gradient promises over the range of the variables: no landscape that means anything is so steep."""

FEWEST, MOST_OF, EMPTY, LITTLE = 5, 0.75, 0.1, 0.01
"""Steps; the part of them that a gradient worth following leads the right way; the part of what gradients promise below which
they are of no use (a step that curvature spoils still changes about as much as was promised); and of the largest objective what
must be promised to be worth a word."""


def summarise(result: Result, confirmed: Confirmation | None = None) -> dict[str, Any]:
    """The result as plain words and numbers."""
    problem = result.problem
    return {
        "title": problem.study.title,
        "scene": problem.study.scene,
        "reason": result.reason,
        "improved": result.improved,
        "simulations": result.progress.counts.simulations,
        "gradients": result.progress.counts.gradients,
        "iterations": result.progress.iteration,
        "seconds": result.progress.seconds,
        "before": _point(result, result.before),
        "after": _point(result, result.after),
        "confirmed": None
        if confirmed is None
        else {
            "holds": confirmed.holds,
            "before": _point(result, confirmed.before),
            "after": _point(result, confirmed.after),
        },
    }


def _point(result: Result, scored: Scored) -> dict[str, Any]:
    problem = result.problem
    return {
        "objective": _finite(scored.objective),
        "violation": _finite(max(scored.violation, 0.0)),
        "keeps_limits": scored.violation <= SLACK,
        "variables": scored.values,
        "media": {
            name or "sheet": {
                "verdict": scored.verdicts[m].sentence(),
                "goals": {a.name: _finite(scored.goals[m][k]) for k, a in enumerate(problem.goals)},
                "limits": {a.name: _finite(scored.limits[m][k]) for k, a in enumerate(problem.limits)},
                "jam_margins": {
                    sheet: {part: _finite(v) for part, v in parts.items()} for sheet, parts in scored.margins[m].items()
                },
            }
            for m, name in enumerate(problem.media)
        },
    }


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def print_result(console: "Console", result: Result) -> None:
    """Verdicts, then variables, goals and limits before and after."""
    problem, before, after = result.problem, result.before, result.after
    word = "better" if result.improved else "no better point was found"
    console.print(
        f"{problem.study.title or problem.study.scene}: {word}. The search ended: {result.reason}.", style="bold"
    )
    if before.objective == 0.0 and not result.improved:
        console.print(
            "The objective is 0 at the start, and no less can be had: what its goals measure does not happen there (the slip of"
            " a roller that touches no sheet). For a machine that jams ask for jam_margin."
        )
    for m, name in enumerate(problem.media):
        where = f"{name}: " if name else ""
        console.print(f"  {where}before {before.verdicts[m].sentence()}")
        console.print(f"  {where}after  {after.verdicts[m].sentence()}")
    console.print("\nVariables", style="bold")
    table = plain_table("variable", "unit", "before", "after", "lower", "upper", words=WORDS)
    for name, unit, variable in zip(problem.names, problem.units, problem.variables, strict=True):
        at_bound = min(abs(after.values[name] - b) for b in variable.bounds) < 1e-3 * np.ptp(variable.bounds)
        row = (before.values[name], after.values[name], *variable.bounds)
        table.add_row(name + (" (at its bound)" if at_bound else ""), unit, *(f"{v:.5g}" for v in row))
    console.print(table)
    console.print("Goals and limits", style="bold")
    console.print(_measured(result))
    if problem.inputs:
        console.print(_machines(problem.study.robust))
    _print_search(console, result)


def _measured(result: Result) -> "Table":
    """Goals, limits and the parts of jam margins of each medium, and the objective."""
    problem, before, after = result.problem, result.before, result.after
    table = plain_table("measure", "unit", "before", "after", "wanted", words=WORDS)

    def add(name: str, unit: str, was: Any, now: Any, wanted: str) -> None:
        table.add_row(name, unit, *("-" if np.isnan(v) else f"{v:.5g}" for v in (was, now)), wanted)

    for m, medium in enumerate(problem.media):
        where = f"{medium}: " if medium else ""
        for k, asked in enumerate(problem.goals):
            add(where + asked.name, asked.term.unit, before.goals[m][k], after.goals[m][k], _wanted(asked.spec))
        for k, asked in enumerate(problem.limits):
            wanted = _wanted(asked.spec) + _broken(problem, asked.spec, after.missed[m][k])
            add(where + asked.name, asked.term.unit, before.limits[m][k], after.limits[m][k], wanted)
        for sheet, parts in before.margins[m].items():
            for part, was in parts.items():
                add(f"{where}{sheet}: {part}", "1", was, after.margins[m][sheet][part], "")
    add("objective", "", before.objective, after.objective, "least")  # not a number: a machine's run fails
    return table


def _print_search(console: "Console", result: Result) -> None:
    """Whether its gradients can be believed, and what it took."""
    spent, size = result.progress, result.size
    steep = sum(line["gradient"] is not None and line["gradient"] > STEEP * size > 0.0 for line in result.history)
    if steep:
        console.print(
            f"In {steep} of {len(result.history)} iterations the gradient promised more than {STEEP:g} times the largest"
            " objective over the range of the variables: do not believe it. `check` says of which variables;"
            ' search.gradient = "expected" may help.'
        )
    kept = _kept(result)
    if kept.steps >= FEWEST and kept.promised > LITTLE * size:
        console.print(_told(kept))
    console.print(
        f"{spent.iteration} iterations, {spent.counts.simulations} simulations with {spent.counts.gradients} gradients, "
        f"{spent.seconds:.1f} s (compilation included)"
    )


class _Kept(NamedTuple):
    """What became of what gradients promised: over so many steps, of which so many went the way that the gradient said, by how
    much in all the loss was to change, and did."""

    steps: int
    same_way: int
    promised: float
    came: float


def _kept(result: Result) -> _Kept:
    """Of the steps of the best starts that can be held against what came of them. Not where another loss came between, or
    another start."""
    pairs = []
    for line, after in pairwise(result.history):
        same = all(line[key] == after[key] for key in ("start", "stage"))
        same = same and not raises(result.problem, line["iteration"])
        # None where the run failed, and in a history of before they were kept.
        was, now, expected = np.array([line.get("loss"), after.get("loss"), line.get("promised")], float)
        if same and np.isfinite([was, now, expected]).all():
            pairs.append((expected, now - was))
    promised, came = np.array(pairs, float).reshape(-1, 2).T
    return _Kept(
        len(pairs), int(np.sum(promised * came > 0.0)), float(np.abs(promised).sum()), float(np.abs(came).sum())
    )


def _told(kept: _Kept) -> str:
    if kept.came < EMPTY * kept.promised:
        return (
            f"Over {kept.steps} steps the gradients promised changes of {kept.promised:.3g} in all, and {kept.came:.3g} came:"
            " they are those of single time steps, not of the machine. `check` says of which variables; shorter steps, a"
            ' step_tolerance or search.gradient = "expected" may help.'
        )
    told = f"Of {kept.steps} steps {kept.same_way} changed what is minimised the way that their gradient said"
    if kept.same_way >= MOST_OF * kept.steps:
        return told + "."
    return (
        told
        + ": few, so they are too long (search.learning_rate), or the gradients those of single time steps. `check` says"
        " whether they are, and of which variables; then shorter steps or a smaller step_tolerance help."
    )


def _wanted(spec: Goal | Limit) -> str:
    if isinstance(spec, Goal):
        return (
            "least"
            if spec.target is None and spec.weight > 0
            else "most"
            if spec.target is None
            else f"{spec.target:g}"
        )
    low = "" if spec.at_least is None else f">= {spec.at_least:g}"
    high = "" if spec.at_most is None else f"<= {spec.at_most:g}"
    return " and ".join(filter(None, (low, high)))


def _broken(problem: Problem, spec: Any, missed: float) -> str:
    """By how much, where machines scatter: there the mean of the measure in the same row does not say it."""
    if missed <= SLACK:
        return ""
    return f"  BROKEN by {missed * spec.scale:.3g}" if problem.inputs else "  BROKEN"


def _machines(robust: Robust) -> str:
    """What the numbers of the table are of, where machines scatter."""
    drawn = f"of {robust.samples} machines that scatter"
    if robust.over == "mean":
        return f"{drawn}, all are means"
    tail = "the worst" if robust.over == "worst" else f"the mean of the worst {100 * robust.tail:g} %"
    return f"{drawn}, measures are means; the objective and by how much limits are broken are those of {tail}"


def write_result(
    folder: Path, result: Result, pictures: bool = True, confirmed: Confirmation | None = None
) -> list[str]:
    """Scene, player, pictures and numbers, in place of all files of an earlier result; the names of the files written."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in reversed(FILES):  # the summary first: without it the folder is not complete
        (folder / name).unlink(missing_ok=True)
    diffeed.save_scene(result.scene, folder / "scene.toml")
    if pictures:
        _write_pictures(folder, result)
    text = json.dumps(summarise(result, confirmed), indent=2, allow_nan=False) + "\n"
    write_whole(folder / SUMMARY, text)
    return [name for name in FILES if (folder / name).exists()]


def _write_pictures(folder: Path, result: Result) -> None:
    from diffeed import plot_style
    from optimize import pictures

    problem = result.problem
    points = {"before": result.before.unit, "after": result.after.unit}
    runs = {k: run_of(problem, u) for k, u in points.items()}
    scenes = {k: problem.scene(u) for k, u in points.items()}
    player.write_player(
        folder / "before_after.html", scenes["before"], runs["before"], compare=(scenes["after"], runs["after"]),
        title=problem.study.title or problem.study.scene,
    )  # fmt: skip
    if result.history:
        plot_style.save(folder / "history.png", lambda: pictures.history(result.history))
        plot_style.save(folder / "variables.png", lambda: pictures.variables(problem, result.history))
    for k, unit in points.items():
        found = blame(problem, unit)
        plot_style.save(
            folder / f"blame_{k}.png",
            lambda k=k, found=found: pictures.blame_map(scenes[k], runs[k], found, result.size),
        )
    if parts_of(scenes["before"]):
        found = arising(problem, points["before"])
        plot_style.save(folder / "when_before.png", lambda: pictures.heat_map(found))
