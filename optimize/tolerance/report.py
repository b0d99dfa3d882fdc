"""What a tolerance study gives its user: tables on the screen, and pictures and numbers beside its rows."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diffeed import plot_style
from diffeed.base.files import plain, write_whole
from diffeed.base.terminal import plain_table
from optimize.tolerance import charts
from optimize.tolerance.folder import PICTURES, RESULT, pictures_of
from optimize.tolerance.latitude import Map
from optimize.tolerance.problem import ToleranceProblem
from optimize.tolerance.run import Rows
from optimize.tolerance.statistics import convergence
from optimize.tolerance.summary import TIGHTER, UNKNOWN, limits_of

if TYPE_CHECKING:
    from rich.console import Console


NAMES = {"first order": "gradient, first order", "regression": "Monte-Carlo regression", "sobol total": "Sobol total"}
"""Shares of the variance as the pictures and tables call them."""
MOST = 12
"""Inputs in a table on the screen."""


def print_summary(console: "Console", summary: dict[str, Any], before: dict[str, Any] | None = None) -> None:
    """Ways to fail (beside those of an earlier study, `before`), measures, what is to blame, what to tighten."""
    console.print(
        f"{summary['title'] or 'tolerance study'}: {summary['samples']} samples, {summary['sampling']}\n", style="bold"
    )
    table = plain_table(
        "does not pass", "samples", "share", "95 % interval", *(["before"] if before else []), "for example"
    )
    for name, way in summary["fails"].items():
        was = [_percent(before[name]["value"]) if name in before else "-"] if before else []
        some = ", ".join(map(str, way["samples"]))
        interval = f"{_percent(way['low'])} to {_percent(way['high'])}"
        table.add_row(name, str(way["count"]), _percent(way["value"]), interval, *was, some)
    console.print(table)
    if summary["fails"].get("late", {}).get("count"):
        console.print(
            "late: still on its way when the run ended; a longer duration of the scene tells whether it passes"
        )
    if summary["sampling"] != "plain":
        console.print(f"intervals are exact for plain draws; those of {summary['sampling']} mostly scatter less")
    console.print()
    table = plain_table("measure", "unit", "mean", "std", "1 %", "50 %", "99 %", "Cp", "Cpk", words=("unit",))
    for name, m in summary["measures"].items():
        if m["runs"]:
            shares = [_text(m["percentiles"][p]["value"]) for p in ("1", "50", "99")]
            table.add_row(
                name, m["unit"], _text(m["mean"]), _text(m["std"]), *shares, _text(m.get("cp")), _text(m.get("cpk"))
            )
    console.print(table)
    for name, m in summary["measures"].items():
        if m.get("never"):
            console.print(f"{name}: never in {m['never']} of {m['runs']} samples; mean and std are of the others")
    for name, blame in summary["contributions"].items():
        _print_blame(console, name, blame, list(summary["inputs"]))
    _print_tighten(console, summary["tighten"])


def _print_blame(console: "Console", name: str, blame: dict[str, Any], inputs: list[str]) -> None:
    known = _known(blame)
    if not known:
        return
    console.print()
    table = plain_table(f"share of the variance of {name}", *known)
    first = np.array([v or 0.0 for v in next(reversed(known.values()))])
    for k in np.argsort(-first)[:MOST]:
        table.add_row(inputs[k], *(_percent(v[k]) for v in known.values()))
    console.print(table)
    if blame["explained"] is not None:
        console.print(
            f"a straight line explains {_percent(blame['explained'])} of the variance (std {_text(blame['std'])})"
        )
    if blame.get("first order std") is not None and blame["std"]:
        ratio = blame["first order std"] / blame["std"]
        verdict = "they agree" if 0.8 < ratio < 1.25 else "they part: do not trust the slopes at the nominal scene here"
        console.print(
            f"std from gradients at the nominal scene: {_text(blame['first order std'])}, {ratio:.2f} of it: {verdict}"
        )


def _known(blame: dict[str, Any]) -> dict[str, list[float | None]]:
    """Shares of the variance by the words for their kind, of the kinds that know any."""
    given = {words: blame.get(key) or [] for key, words in NAMES.items()}
    return {words: shares for words, shares in given.items() if any(v is not None for v in shares)}


def _print_tighten(console: "Console", found: dict[str, Any]) -> None:
    priced = any("cost" in v for v in found.values())
    table = plain_table(
        f"tolerance made {100 * TIGHTER:g} % tighter",
        "more pass",
        "error",
        *(["cost", "gain per cost"] if priced else []),
    )
    by = "gain per cost" if priced else "gain"
    order = sorted(found.items(), key=lambda item: -np.inf if item[1].get(by) is None else item[1][by], reverse=True)
    for name, v in order:
        extra = [_text(v.get("cost")), _points(v.get("gain per cost"))] if priced else []
        table.add_row(name, _points(v["gain"]), _points(v["error"]), *extra)
    console.print()
    console.print(table)
    console.print("in percentage points; a gain within twice its error may be none: such a tolerance may be relaxed")
    if any(v["gain"] is None for v in found.values()):
        console.print(f'"-": no estimate, as for {UNKNOWN}')


def write_result(
    folder: Path,
    problem: ToleranceProblem,
    rows: Rows,
    summary: dict[str, Any],
    pictures: bool,
    before: Rows | None = None,
) -> list[str]:
    """Pictures, in place of all earlier ones, and last the summary: a folder that holds `result.json` is complete. OSError where
    it cannot be written."""
    for name in (*PICTURES, *(picture for asked in problem.asked for picture in pictures_of(asked.name))):
        (folder / name).unlink(missing_ok=True)
    names = _pictures(folder, problem, rows, summary, before) if pictures else []
    write_whole(folder / RESULT, json.dumps(summary, indent=1, allow_nan=False) + "\n")
    return [*names, RESULT]


def _pictures(
    folder: Path, problem: ToleranceProblem, rows: Rows, summary: dict[str, Any], before: Rows | None
) -> list[str]:
    converged, tightened = PICTURES
    made: dict[str, Any] = {converged: lambda: charts.convergence(*convergence(~rows.passed))}
    inputs = [i.name for i in problem.inputs]
    for k, asked in enumerate(problem.asked):
        label = f"{asked.name}, {asked.term.unit}" if asked.term.unit != "1" else asked.name
        was = before.values[:, k] if before is not None else None
        values, limits = rows.values[:, k], limits_of(asked)
        histogram, distribution, contributions = pictures_of(asked.name)
        made[histogram] = lambda v=values, t=label, e=limits, w=was: charts.histogram(v, t, e, before=w)
        made[distribution] = lambda v=values, t=label, e=limits, w=was: charts.distribution(v, t, e, before=w)
        blame = summary["contributions"][asked.name]
        shares = {words: np.array([np.nan if v is None else v for v in of]) for words, of in _known(blame).items()}
        if shares and len(values) > 1:
            made[contributions] = lambda s=shares: charts.contributions(inputs, s)
    tighter = {n: v for n, v in summary["tighten"].items() if v["gain"] is not None and v["error"] is not None}
    if tighter:
        gain, error = (np.array([v[key] for v in tighter.values()]) for key in ("gain", "error"))
        made[tightened] = lambda: charts.gains(list(tighter), gain, error, TIGHTER)
    for name, draw in made.items():
        plot_style.save(folder / name, draw)
    return list(made)


LATITUDE = ("latitude.png", "latitude.json")
"""The last is written last."""


def write_latitude(folder: Path, found: Map) -> list[str]:
    """The picture and the numbers of a latitude."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {
        "x": {"name": found.labels[0], "values": found.x},
        "y": {"name": found.labels[1], "values": found.y},
        "passed": found.passed,
        "margin": found.margin,
    }
    plot_style.save(
        folder / "latitude.png",
        lambda: charts.latitude(found.x, found.y, found.margin, found.passed, *found.labels, nominal=found.nominal),
    )
    write_whole(folder / "latitude.json", json.dumps(plain(numbers), indent=1, allow_nan=False) + "\n")
    return list(LATITUDE)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.3g} %"


def _points(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:+.2g}"


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
