"""Benchmarks as tables for a terminal of 80 columns, and in words."""

from typing import TYPE_CHECKING, Any

from diffeed.base.terminal import plain_table
from diffeed.bench.machine import sentence
from diffeed.bench.outcome import MEASURES
from diffeed.bench.pareto import pareto
from diffeed.bench.records import Front, Row
from diffeed.bench.stability import CLASSES, CONTROLLED, RIGHT, WRONG
from diffeed.bench.stability_scene import AXES

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

BELOW = 3.0
"""An error is told from the reference's own uncertainty when it is this many times larger."""


def print_front(console: "Console", front: Front) -> None:
    """Every setting with its cost and errors, then what could not be run, the reference and the machine."""
    best = on_front(front)
    columns = [f"{title}\n{unit}".replace(" ", "\n") for title, unit, _ in MEASURES.values()]
    cost = ["compile\ns", "run\ns per s", "us per\nstep"]
    own = [r for r in front.rows if r.setting.numerical]
    others = [r for r in front.rows if not r.setting.numerical]
    title = f"{front.scene}, {front.duration:g} s: errors against a finer run (* best for its time)"
    if own:
        _print(console, title, plain_table("method, step", *cost, *columns), _by_method(front, best, own))
    if others:
        title = f"One change of {others[0].setting.short}, at a time: differences of model"
        _print(console, title, plain_table("change", *cost, *columns), [
            (r.setting.label, *_cells(front, best, r)) for r in others
        ])  # fmt: skip
    for line in notes(front):
        console.print(f"\n{line}")
    console.print(f"\n{sentence(front.machine)}", style="dim")


def _by_method(front: Front, best: dict[str, list[int]], rows: list[Row]) -> list[tuple[str, ...]]:
    """A line with each method, then one per step; of a method that never ran the first line alone."""
    lines: list[tuple[str, ...]] = []
    for kind in dict.fromkeys((r.setting.method, r.setting.group) for r in rows):
        own = [r for r in rows if (r.setting.method, r.setting.group) == kind]
        name = kind[0] if kind[1] == "step" else f"{kind[0]}, {kind[1]}"
        ran = any(r.ok for r in own)
        lines.append((name, "" if ran else own[0].status, *[""] * (1 + len(best))))
        lines += [(f"  {r.setting.size}", *_cells(front, best, r)) for r in own if ran]
    return lines


def _print(console: "Console", title: str, table: "Table", rows: list[tuple[str, ...]]) -> None:
    for row in rows:
        table.add_row(*row)
    console.print(f"\n{title}", style="bold")
    console.print(table)


def on_front(front: Front) -> dict[str, list[int]]:
    """By measure: the rows on the front of run time against error, those that solve the scene as it is."""
    own = [r if r.setting.numerical and r.ok else None for r in front.rows]
    times = [None if r is None else r.run_seconds for r in own]
    return {m: pareto(times, [None if r is None else r.errors.get(m) for r in own]) for m in MEASURES}


def _cells(front: Front, best: dict[str, list[int]], row: Row) -> list[str]:
    if row.status != "ok":
        return [row.status, "", "", *["-"] * len(MEASURES)]
    cost = [row.compile_seconds, row.cost(front.duration), row.microseconds()]
    return [digits(v) for v in cost] + [_error(front, best, row, m) for m in MEASURES]


def _error(front: Front, best: dict[str, list[int]], row: Row, measure: str) -> str:
    value = row.errors.get(measure)
    unclear = "" if value is None or resolved(front, measure, value) else "~"
    star = "*" if any(row is front.rows[k] for k in best[measure]) else " "
    return f"{unclear}{digits(value, 2)}{star}"


def resolved(front: Front, measure: str, error: float) -> bool:
    """Whether an error stands clear of the reference's own uncertainty."""
    doubt = None if front.reference is None else front.reference.uncertainty.get(measure)
    return doubt is None or error >= BELOW * doubt


def notes(front: Front) -> list[str]:
    """What could not be run, what the reference is and how far it can be trusted, measure by measure."""
    found = broken(front)
    if front.reference is None:
        return [*found, f"No reference, so no errors: {front.no_reference}"]
    doubts = {m: u for m, u in front.reference.uncertainty.items() if u is not None}
    parts = [f"{MEASURES[m][0]} {digits(u)} {MEASURES[m][1]} ({front.reference.where[m]})" for m, u in doubts.items()]
    found.append(
        f"Errors are against {front.reference.setting.short} ({front.reference.run_seconds:.3g} s to run). It differs from "
        f"twice that step by: {', '.join(parts)}."
    )
    for measure in doubts:
        if words := unconverged(front, measure):
            found.append(words)
    missing = [title for m, (title, _, _) in MEASURES.items() if m not in doubts]
    return found + ([f"This scene has no {' and no '.join(missing)} to compare."] if missing else [])


def broken(front: Front) -> list[str]:
    """Why rows have no errors; of a method that fails at several steps, the smallest one's cause."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in front.rows:
        if row.status != "ok":
            groups.setdefault((row.status, row.setting.method, row.setting.group, row.setting.label), []).append(row)
    found = []
    for rows in groups.values():
        last = min(rows, key=lambda r: r.setting.dt)
        more = f" (and at {len(rows) - 1} larger)" if len(rows) > 1 else ""
        found.append(f"{last.setting.name}{more}: {last.status}: {last.reason}")
    return found


def unconverged(front: Front, measure: str) -> str:
    """A sentence if the reference is not well below the errors of the sweep in this measure."""
    title, unit, _ = MEASURES[measure]
    doubt = None if front.reference is None else front.reference.uncertainty.get(measure)
    errors = [
        r.errors[measure] for r in front.rows if r.ok and r.setting.numerical and r.errors.get(measure) is not None
    ]
    blurred = [e for e in errors if e is not None and not resolved(front, measure, e)]
    if not blurred or doubt is None:
        return ""
    return (
        f"The reference is not converged in the {title}: it is itself uncertain by {digits(doubt)} {unit}, so {len(blurred)} of "
        f"{len(errors)} errors, marked ~ and below {digits(BELOW * doubt)} {unit}, are not told from it."
    )


def digits(value: float | None, count: int = 3) -> str:
    """Three digits, or so many."""
    if value is None:
        return "-"
    if value == 0.0:
        return "0"
    if abs(value) >= 1e5 or abs(value) < 1e-4:
        return f"{value:.1e}"
    return f"{value:#.{count}g}".rstrip(".") if abs(value) < 10**count else f"{value:.0f}"


def print_growth(console: "Console", rows: list[dict[str, Any]], powers: list[dict[str, Any]]) -> None:
    """Every size, then the powers with which costs grow."""
    headings = {"size": "size", "compile_seconds": "compile\ns", "us_per_step": "us per\nstep", "peak_mb": "peak\nMB"}
    _print_rows(console, "Growth, on a generated transport path", "series", headings, rows)
    console.print("samples: us per step and sample. length: s simulated, each in a process of its own.", style="dim")
    headings = {"compile_seconds": "compile", "us_per_step": "step", "peak_mb": "peak memory"}
    _print_rows(console, "Powers of the size with which they grow (last three sizes)", "series", headings, powers)
    for row in rows:
        if row.get("reason"):
            console.print(f"{row['series']}, {row['size']:g}: {row['reason']}")


def print_features(console: "Console", rows: list[dict[str, Any]], values: list[str]) -> None:
    """The full scene and what is saved without each feature."""
    headings = {
        "equations": "equations",
        "saved": "fewer",
        "compile_seconds": "compile\ns",
        "us_per_step": "us per\nstep",
    }
    shown = [r | {"without": f"without {r['without']}" if r["without"] else "everything"} for r in rows]
    _print_rows(console, "A scene with every feature, and with one taken away", "without", headings, shown)
    if values:
        console.print(f"\nAs many equations without them (values, not kinds): {', '.join(values)}.")


def print_batch(console: "Console", rows: list[dict[str, Any]]) -> None:
    """Every size and precision."""
    headings = {
        "samples": "samples",
        "steps": "steps",
        "compile_seconds": "compile\ns",
        "run_seconds": "run\ns",
        "steps_per_second": "steps of all\nper s",
        "us_per_sample_step": "us per step\nand sample",
    }
    _print_rows(console, "Batches of runs", "precision", headings, rows)
    for row in rows:
        if row.get("reason"):
            console.print(f"{row['samples']} samples, {row['precision']}: {row['reason']}")
        elif row.get("failed"):
            console.print(f"{row['samples']} samples, {row['precision']}: {row['failed']} runs failed")


def print_gradient(console: "Console", rows: list[dict[str, Any]]) -> None:
    """The run and its gradients."""
    headings = {
        "numbers": "numbers",
        "trace_seconds": "trace\ns",
        "compile_seconds": "compile\ns",
        "run_seconds": "run\ns",
        "runs": "in\nruns",
        "temporary_mb": "memory\nMB",
        "planned_mb": "planned\nMB",
    }
    _print_rows(console, "The run, and the gradient of where the lead edge ends", "what", headings, rows)
    _reasons(console, rows)


def print_ripple(console: "Console", rows: list[dict[str, Any]]) -> None:
    """Every skin and number of bars."""
    headings = {
        "us_per_step": "us per\nstep",
        "force_n": "force\nN",
        "force_ripple_n": "ripple\nN",
        "force_error_n": "error\nN",
        "slip_mm_s": "slip\nmm/s",
        "slip_ripple_mm_s": "ripple\nmm/s",
        "lead_error_mm": "lead\nedge\nmm off",
    }
    named = [r | {"what": f"{r['skin']}, {r['bars']} bars"} for r in rows]
    _print_rows(console, "A sheet pulled around a roller, steadily", "what", headings, named)
    _reasons(console, named)


def print_roughness(console: "Console", data: dict[str, Any]) -> None:
    """A line for each start and way of stepping, a column for every second frame."""
    rows = [r | {"what": f"{r['start']}, {r['steps']}"} for r in data["rows"]]
    times = sorted({r["time"] for r in rows if "time" in r})
    times = times[1::2] or times
    lines = [
        {"what": what} | {f"{r['time']:g}": r["scatter_um"] for r in rows if r["what"] == what and "time" in r}
        for what in dict.fromkeys(r["what"] for r in rows)
    ]
    title = f"Scatter of the lead edge about a parabola, um, by {data['by']} within {data['span']:g} to either side"
    _print_rows(console, title, "what", {f"{t:g}": f"at\n{t:g} s" for t in times}, lines)
    _reasons(console, rows)


def print_stability(console: "Console", rows: list[dict[str, Any]]) -> None:
    """How many runs of each stepper became what; then those that are wrong and yet hold, and what `check` let pass."""
    titles = {**dict.fromkeys(CLASSES), "wrong": f"wrong\n>{WRONG:g} mm", "failed": "failed,\nsaid so"}
    table = plain_table("stepper", *(title or name for name, title in titles.items()), "refused\nby check")
    lines = []
    for method in dict.fromkeys(r["method"] for r in rows):
        own = [r for r in rows if r["method"] == method]
        counts = [sum(r["became"] == name for r in own) for name in CLASSES]
        lines.append((method, *map(str, counts), str(sum(r["refused"] for r in own))))
    _print(console, f"What became of {len(rows)} runs (right: within {RIGHT:g} mm)", table, lines)
    for line in [*wrong_runs(rows), *explicit_runs(rows)]:
        console.print(line)


def wrong_runs(rows: list[dict[str, Any]]) -> list[str]:
    """Runs that are plainly wrong and yet say that they hold: a line for each stepper and number, with the error that they
    tell of themselves."""
    wrong: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for r in rows:
        if r["became"] == "wrong":
            wrong.setdefault((r["method"], r["axis"]), []).append(r)
    if not wrong:
        return ["\nNo run is plainly wrong without saying so."]
    count = sum(map(len, wrong.values()))
    found = [
        "\n1 run is plainly wrong and yet holds:" if count == 1 else f"\n{count} runs are plainly wrong and yet hold:"
    ]
    for (method, axis), own in wrong.items():
        errors = [r["error_mm"] for r in own if r["error_mm"] is not None]
        worst = f"up to {digits(max(errors))} mm" if len(errors) == len(own) else "not finite"
        refused, told = sum(r["refused"] for r in own), [r["told_mm"] for r in own if r["told_mm"] is not None]
        worst += f", told {digits(min(told))} mm{' and more' * (len(told) > 1)}" if told else ""
        found.append(
            f"  {method}, {_named(axis, _range(own, 'value'))}, at {_range(own, 'size')} "
            f"{'mm' if method == CONTROLLED else 's'}: {len(own)} ({worst}{f', {refused} refused' if refused else ''})"
        )
    return found


def _named(axis: str, value: str) -> str:
    title, unit, _ = AXES[axis]
    return f"{title.lower()} {value}" + ("" if unit == "1" else f" {unit}")


def _range(rows: list[dict[str, Any]], key: str) -> str:
    low, high = (pick(r[key] for r in rows) for pick in (min, max))
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def explicit_runs(rows: list[dict[str, Any]]) -> list[str]:
    """Whether `check` refuses what fails, and lets pass what does not."""
    limited = [r for r in rows if r["limit_s"] is not None]
    refused, passed = [r for r in limited if r["refused"]], [r for r in limited if not r["refused"]]
    if not limited:
        return []
    sound = sum(r["became"] == "right" for r in refused)
    missed = [r for r in passed if r["became"] in ("failed", "wrong")]
    found = [
        f"\nOf {len(refused)} runs that check refuses for their step, {sound} would be right; of {len(passed)} that it "
        f"lets pass, {len(missed)} fail or are plainly wrong{':' if missed else '.'}"
    ]
    for r in missed:
        title, unit, _ = AXES[r["axis"]]
        found.append(
            f"  {title.lower()} {digits(r['value'])} {unit}, {digits(r['size'])} s: {r['cause'] or r['became']}"
        )
    return found


def _print_rows(
    console: "Console", title: str, first: str, headings: dict[str, str], rows: list[dict[str, Any]]
) -> None:
    table = plain_table(first, *headings.values())
    _print(console, title, table, [(str(r[first]), *(_cell(r.get(key)) for key in headings)) for r in rows])


def _reasons(console: "Console", rows: list[dict[str, Any]]) -> None:
    """Why rows have no figures."""
    for row in rows:
        if row.get("reason"):
            console.print(f"{row['what']}: {row['reason']}")


def _cell(value: Any) -> str:
    return str(value) if isinstance(value, int) else digits(value)
