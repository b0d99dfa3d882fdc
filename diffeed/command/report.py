"""What a run came to, as plain data (for a file) and as tables (for a terminal of 80 columns, or a pipe)."""

from typing import TYPE_CHECKING, Any

from diffeed import measures
from diffeed.base.files import plain
from diffeed.base.records import fields
from diffeed.base.terminal import plain_table
from diffeed.input.parts import Scene
from diffeed.readings.agreement import OF_GUIDES
from diffeed.readings.observe import NIP_WORDS, nip_unit
from diffeed.readings.trajectory import Trajectory

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

OBSERVE = ("nips", "guides", "arrivals", "energy", "gaps", "curvature", "feed", "spans")
"""What must be observed for a report."""
COLORS = {"passed": "bold green", "late": "bold yellow"}
COMPARED = {field: f"{words} ({nip_unit(field)})" for field, words in NIP_WORDS.items()}
"""Of each roller, before and after."""
GUIDES = {field: COMPARED[field] for field in OF_GUIDES}
"""Of each guide, likewise."""
FLAT = 1e-7
"""1/mm: a smaller curvature is rounding, and its radius, ten kilometres or more, says nothing."""
NEAREST = 8
"""Gaps in the table; the rest are in the summary."""
CREEP = (
    "Slip: roller surface minus sheet. Creep floor: the slip that the regularised friction needs to carry the load; "
    "slip of that size counts as sticking."
)
SAME = 1e-3
"""Of a value: less is no change in a comparison."""
ANOTHER = 0.5
"""Of a change: where it differs by more in the runs with shorter steps, it is marked."""
BY_STEPS = "*: not confirmed: between the two runs with shorter steps it is another change (by more than half)."
PRESSED = "Negative: pressed into the part."
MARGINS = (
    "1: no load; 0: at the limit, beyond which it jams. Progress towards the goal, buckling between nips, fold, "
    "attack at guides, head pressed into a guide (gap)."
)
FED = "Fed per turned: how far the sheet moved under the driven rollers that held it, over what they turned."
UNBALANCED = 0.2
"""Of the largest work, store or loss: more that the steps themselves took or gave is told."""


def summarise(scene: Scene, trajectory: Trajectory) -> dict[str, Any]:
    """Verdict and measures of a run as words, numbers and None (not a number, or never)."""
    return plain(
        {
            "verdict": measures.verdict(scene, trajectory)._asdict(),
            "rollers": _rollers(scene, trajectory),
            "sheets": {name: _sheet(scene, trajectory, name) for name in sorted(scene.sheets)},
            "guides": {name: _record(stats) for name, stats in trajectory.observed["guides"].items()},
            "smallest_gaps": _gaps(trajectory),
            "energy": measures.energy_balance(scene, trajectory),
        }
    )


def print_report(console: "Console", summary: dict[str, Any]) -> None:
    """The verdict in the first line, then rollers, guides, arrivals, sheets, gaps, energy, and what it took."""
    status = summary["verdict"]["status"]
    console.print(_verdict_line(summary["verdict"]), style=COLORS.get(status, "bold red"))
    for title, note, table in (
        ("Rollers, over the time in which they touch a sheet", CREEP, _roller_table(summary["rollers"])),
        ("Guides, over the time in which a sheet touches them", "", _guide_table(summary["guides"])),
        ("Arrivals of the sheets' edges", "", _arrival_table(summary["sheets"])),
        ("Sheets", FED, _sheet_table(summary["sheets"])),
        ("Distance from a jam", MARGINS, _margin_table(summary["sheets"])),
        ("Smallest gaps between sheets and parts", PRESSED, _gap_table(summary["smallest_gaps"])),
        ("Energy balance", _unbalanced(summary["energy"]), _energy_table(summary["energy"])),
    ):
        if table.row_count:
            console.print(f"\n{title}", style="bold")
            console.print(table)
            console.print(note, end="\n" if note else "", style="dim")
    console.print(f"\n{_took(summary['run'])}")


def print_changes(console: "Console", before: dict[str, Any], after: dict[str, Any]) -> None:
    """What differs between two summaries by more than 0.1 %, and what of that is not so with shorter steps."""
    table = plain_table("", "before", "after", "change")
    old, new = numbers(before), numbers(after)
    marked = False
    with_shorter_steps = [summary.get("finer") or {} for summary in (before, after)]
    for name, value in new.items():
        earlier = old.get(name)
        if isinstance(value, str) or isinstance(earlier, str):
            if earlier != value:
                table.add_row(name, earlier, value, "")
        elif (earlier is None) != (value is None):
            table.add_row(name, _digits(earlier), _digits(value), "")
        elif earlier is not None and abs(value - earlier) > SAME * max(abs(earlier), abs(value)):
            change = value - earlier
            another = _is_another(change, *(run.get(name) for run in with_shorter_steps))
            table.add_row(name, _digits(earlier), _digits(value), f"{change:+.3g}{' *' if another else ''}")
            marked |= another
    console.print(f"\nBefore and after, what differs by more than {100 * SAME:g} %", style="bold")
    console.print(table if table.row_count else "nothing")
    if marked:
        console.print(BY_STEPS, style="dim")
    lengths = [summary["run"]["simulated"] for summary in (before, after)]
    if abs(lengths[1] - lengths[0]) > SAME * max(lengths):
        console.print(
            f"The runs are not of one length: {lengths[0]:.4g} s before, {lengths[1]:.4g} s after. Means, peaks and sums are "
            "of what each of them came to."
        )


def _is_another(change: float, before: float | None, after: float | None) -> bool:
    """Whether a number changes otherwise between two values; not, where one of them is not known."""
    return before is not None and after is not None and abs(after - before - change) > ANOTHER * abs(change)


# --- data -----------------------------------------------------------------------------------------------------------


def _rollers(scene: Scene, trajectory: Trajectory) -> dict[str, dict[str, Any]]:
    nips, floors = trajectory.observed["nips"], measures.creep_floor(scene, trajectory)
    return {name: _record(stats) | {"creep_floor": floors[name]} for name, stats in nips.items()}


def _record(stats: Any) -> dict[str, Any]:
    return {f.name: getattr(stats, f.name) for f in fields(stats)}


def _sheet(scene: Scene, trajectory: Trajectory, name: str) -> dict[str, Any]:
    seen = trajectory.observed
    feed = seen["feed"][name]
    return {
        "arrivals": seen["arrivals"][name],
        "largest_curvature": seen["curvature"][name],
        "fed": feed.fed,
        "commanded": feed.commanded,
        "progress": measures.progress(scene, trajectory)[name] if feed.commanded else None,
        "longest_stall": feed.longest_stall,
        "jam_margins": measures.jam_margins(scene, trajectory, name),
    }


def _gaps(trajectory: Trajectory) -> dict[str, Any]:
    gaps = trajectory.observed["gaps"]
    found = {f"{section}.{name}": value.gap for section in sorted(gaps) for name, value in gaps[section].items()}
    return dict(sorted(found.items(), key=lambda item: float(item[1])))


def numbers(summary: dict[str, Any]) -> dict[str, Any]:
    """Of a summary what is compared with another run's, by a name with its unit; None where it is not a number, or never."""
    found: dict[str, Any] = {"verdict": summary["verdict"]["status"]}
    for name, sheet in summary["sheets"].items():
        found[f"{name}: fed (mm)"] = sheet["fed"]
        found[f"{name}: largest curvature (1/mm)"] = sheet["largest_curvature"]
        for part, margin in sheet["jam_margins"].items():
            found[f"{name}: distance from a jam, {part}"] = margin
        for sensor, times in sheet["arrivals"].items():
            for edge in ("lead", "tail"):
                found[f"{name}: {edge} edge at {sensor} (s)"] = times[edge]
    for section, compared in (("rollers", COMPARED), ("guides", GUIDES)):
        for name, part in summary.get(section, {}).items():
            found |= {f"{name}: {meaning}": part.get(key) for key, meaning in compared.items()}
    return found | {f"{name} (N mm)": value for name, value in summary.get("energy", {}).items()}


# --- tables ---------------------------------------------------------------------------------------------------------


def _verdict_line(verdict: dict[str, Any]) -> str:
    words = [verdict["reason"]]
    if verdict["time"] is not None and verdict["status"] in ("passed", "jammed"):
        words.append(f"at {verdict['time']:.4g} s")
    words += [verdict["place"]] if verdict["place"] else []
    return f"{verdict['status'].upper()}: {', '.join(words)}"


def _roller_table(rollers: dict[str, Any]) -> "Table":
    columns = {
        "contact\ns": "contact_time",
        "slip\nmean\nmm/s": "slip_mean",
        "slip\nRMS\nmm/s": "slip_rms",
        "creep\nfloor\nmm/s": "creep_floor",
        "normal\nmean\nN": "force_mean",
        "normal\npeak\nN": "force_peak",
        "friction\nmean\nN": "friction_mean",
        "torque\nmean\nN mm": "torque_mean",
    }
    table = plain_table("roller", *columns)
    for name, row in rollers.items():
        touched = bool(row["contact_time"])
        values = [_text(row[key]) for key in columns.values()] if touched else ["never", *"-" * (len(columns) - 1)]
        table.add_row(name, *values)
    return table


def _arrival_table(sheets: dict[str, Any]) -> "Table":
    table = plain_table("sheet at sensor", "lead edge\ns", "tail edge\ns")
    for sheet, row in sheets.items():
        for sensor, times in row["arrivals"].items():
            table.add_row(f"{sheet} at {sensor}", *(_text(times[edge], "never") for edge in ("lead", "tail")))
    return table


def _sheet_table(sheets: dict[str, Any]) -> "Table":
    table = plain_table(
        "sheet",
        "largest\ncurvature\n1/mm",
        "smallest\nradius\nmm",
        "fed\nmm",
        "rollers\nturned\nmm",
        "fed per\nturned",
        "longest\nstall,\nheld\ns",
    )
    for name, row in sheets.items():
        curvature = row["largest_curvature"]
        radius = 1.0 / curvature if (curvature or 0.0) > FLAT else None
        values = (radius, row["fed"], row["commanded"], row["progress"], row["longest_stall"])
        table.add_row(name, "-" if curvature is None else f"{curvature:.3g}", *(_text(v) for v in values))
    return table


def _margin_table(sheets: dict[str, Any]) -> "Table":
    parts = list(next(iter(sheets.values()))["jam_margins"])
    table = plain_table("sheet", *parts)
    for name, row in sheets.items():
        table.add_row(name, *(_text(row["jam_margins"][part]) for part in parts))
    return table


def _guide_table(guides: dict[str, Any]) -> "Table":
    """Those that are pressed hardest."""
    table = plain_table("guide", "contact\ns", "normal\nmean\nN", "normal\npeak\nN")
    touched = sorted((row["force_peak"] or 0.0, name) for name, row in guides.items() if row["contact_time"])[::-1]
    for _, name in touched[:NEAREST]:
        row = guides[name]
        table.add_row(name, *(_text(row[key]) for key in ("contact_time", "force_mean", "force_peak")))
    if len(touched) > NEAREST:
        more = len(touched) - NEAREST
        table.add_row(f"and {more} {'guide' if more == 1 else 'guides'} pressed less", "", "", "")
    return table


def _gap_table(gaps: dict[str, Any]) -> "Table":
    table = plain_table("part", "mm")
    for name, gap in list(gaps.items())[:NEAREST]:
        table.add_row(name, _text(gap))
    if len(gaps) > NEAREST:
        more = len(gaps) - NEAREST
        table.add_row(f"and {more} {'part' if more == 1 else 'parts'} further away", "")
    return table


def _energy_table(energy: dict[str, Any]) -> "Table":
    table = plain_table("", "N mm", "share")
    work = energy["work of drives"]
    for name, value in energy.items():
        share = "" if not work or value is None else f"{100.0 * value / work:.1f} %"
        table.add_row(name, _text(value), share)
    return table


def _unbalanced(energy: dict[str, Any]) -> str:
    """What is to be said where steps as long as these do not add up."""
    lost = energy.get("numerical")
    most = max((abs(v) for name, v in energy.items() if name != "numerical" and v is not None), default=0.0)
    if not most or lost is None or abs(lost) <= UNBALANCED * most:
        return ""
    return (
        "The steps are too long for the forces: what they themselves took or gave is a good part of the energy moved."
    )


def _took(run: dict[str, Any]) -> str:
    return (
        f"{run['scene']}: {run['simulated']:.4g} s in {run['steps']} steps of {run['dt']:.4g} s "
        f"({run['method']}, {run['precision']}); took {run['compile_seconds']:.1f} s to prepare and compile, "
        f"{run['run_seconds']:.1f} s to run.\n"
        f"{_steps(run)} an error of about {_text(run['error'])} mm in the sheet's place, more where it buckles, bounces "
        "or leaves a nip"
    )


def _steps(run: dict[str, Any]) -> str:
    if run.get("tolerance") is None:
        return "The steps leave"
    return f"The tolerance of {run['tolerance']:g} mm is that of each step; together they leave"


def _digits(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _text(value: float | None, missing: str = "-") -> str:
    """Four digits, at most three of them decimals."""
    if value is None:
        return missing
    if abs(value) >= 1e5:
        return f"{value:.1e}"
    whole = len(str(int(abs(value))))
    text = f"{value:.{max(0, min(3, 4 - whole))}f}"
    return text if float(text) else "0"
