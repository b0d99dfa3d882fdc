"""What a search gives its user: a table on the screen, and a folder with scene, numbers and pictures."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import diffeed
from diffeed import player
from diffeed.base.files import write_whole
from diffeed.base.terminal import plain_table
from optimize.blame_map import arising, blame, parts_of
from optimize.confirmation import Confirmation
from optimize.design_run import Result, Scored, run_of
from optimize.journal import FILES, SUMMARY
from optimize.problem import SLACK, Problem
from optimize.study import Goal, Limit, Robust

if TYPE_CHECKING:
    from rich.console import Console

WORDS = ("unit", "wanted")
"""Columns of words in the tables."""
STEEP = 1e4
"""Times the objective that a gradient promises over the range of the variables: no landscape that means anything is so steep."""


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
    table = plain_table("measure", "unit", "before", "after", "wanted", words=WORDS)
    for m, medium in enumerate(problem.media):
        for k, asked in enumerate(problem.goals):
            table.add_row(_label(medium, asked), asked.term.unit, f"{before.goals[m][k]:.5g}", f"{after.goals[m][k]:.5g}",
                          _wanted(asked.spec))  # fmt: skip
        for k, asked in enumerate(problem.limits):
            broken = _broken(problem, asked.spec, after.missed[m][k])
            table.add_row(_label(medium, asked), asked.term.unit, f"{before.limits[m][k]:.5g}",
                          f"{after.limits[m][k]:.5g}", _wanted(asked.spec) + broken)  # fmt: skip
        for sheet, parts in before.margins[m].items():
            for part, was in parts.items():
                table.add_row(
                    _margin(medium, sheet, part), "1", f"{was:.5g}", f"{after.margins[m][sheet][part]:.5g}", ""
                )
    worth = (
        "-" if np.isnan(v) else f"{v:.5g}" for v in (before.objective, after.objective)
    )  # "-": a machine's run fails
    table.add_row("objective", "", *worth, "least")
    console.print(table)
    if problem.inputs:
        console.print(_machines(problem.study.robust))
    _print_search(console, result)


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
    console.print(
        f"{spent.iteration} iterations, {spent.counts.simulations} simulations with {spent.counts.gradients} gradients, "
        f"{spent.seconds:.1f} s (compilation included)"
    )


def _margin(medium: str, sheet: str, part: str) -> str:
    """A part of a jam margin, of the machine as drawn: the smallest binds."""
    return f"{medium}: {sheet}: {part}" if medium else f"{sheet}: {part}"


def _label(medium: str, asked: Any) -> str:
    return f"{medium}: {asked.name}" if medium else asked.name


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
