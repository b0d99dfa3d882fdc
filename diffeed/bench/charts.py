"""Pictures of benchmarks. Each function takes plain records and returns the axes; nothing is shown or saved."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diffeed import plot_style
from diffeed.bench.outcome import MEASURES
from diffeed.bench.records import Front, Row
from diffeed.bench.report import on_front
from diffeed.show import labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">", "p", "h")
CONTROLLED = ", controlled"
HEIGHT = 2.9  # inches of one plot
BETWEEN = 7.0  # points of the page between a name and the next in its line


def front(found: Front) -> "Axes":
    """Error against run time, one plot per measure: every setting, the front as a line, and the reference's uncertainty."""
    from matplotlib import pyplot

    shown = [m for m in MEASURES if any(r.errors.get(m) for r in found.rows)]
    if not shown:
        return _nothing()
    size = (plot_style.WIDTH, HEIGHT * len(shown))
    figure, made = pyplot.subplots(len(shown), 1, figsize=size, dpi=150, layout="constrained", squeeze=False)
    styles = _styles(found)
    for ax, measure in zip(made[:, 0], shown, strict=True):
        _draw_measure(ax, found, measure, styles)
    title = f"{Path(found.scene).stem}, {found.duration:g} s simulated"
    figure.suptitle(title, fontsize=plot_style.TITLE, x=0.01, ha="left", fontweight="bold")
    made[-1, 0].set_xlabel("Run time (s), without compiling", fontsize=plot_style.TEXT)
    plot_style.legend_beside(made[0, 0])
    figure.draw_without_rendering()  # settles the layout, which names in points need
    for ax, measure in zip(made[:, 0], shown, strict=True):
        _name_points(ax, found, measure)
    return made[0, 0]


def _nothing() -> "Axes":
    ax = plot_style.axes(None)
    ax.text(0.5, 0.5, "nothing to show: see the table", transform=ax.transAxes, ha="center")
    return ax


def _styles(found: Front) -> dict[str, dict[str, Any]]:
    """Colour and mark of every kind of setting: a method has one colour, with steps given and controlled."""
    kinds = list(dict.fromkeys(_kind(r) for r in found.rows if r.ok))
    colors = list(dict.fromkeys(kind.removesuffix(CONTROLLED) for kind in kinds))
    return {
        kind: {
            "color": plot_style.COLORS[colors.index(kind.removesuffix(CONTROLLED)) % len(plot_style.COLORS)],
            "marker": MARKS[i % len(MARKS)],
        }
        for i, kind in enumerate(kinds)
    }


def _kind(row: Row) -> str:
    if row.setting.group == "step":
        return row.setting.method
    return f"{row.setting.method}{CONTROLLED}" if row.setting.group == "tolerance" else row.setting.group


def _draw_measure(ax: "Axes", found: Front, measure: str, styles: dict[str, dict[str, Any]]) -> None:
    title, unit, meaning = MEASURES[measure]
    shown = [r for r in found.rows if r.ok and r.errors.get(measure)]
    for kind, style in styles.items():
        own = [r for r in shown if _kind(r) == kind]
        points = np.array([(r.run_seconds, r.errors[measure]) for r in own], float).reshape(-1, 2)
        filled: dict[str, Any] = {} if own and own[0].setting.numerical else {"markerfacecolor": "white"}
        ax.plot(*points.T, linestyle="none", markersize=5, label=kind, **style, **filled)
    best = [found.rows[k] for k in on_front(found)[measure]]
    best = [r for r in best if r.errors[measure]]  # no logarithm of an error of zero
    ax.plot(
        [r.run_seconds for r in best], [r.errors[measure] for r in best],
        color=plot_style.INK, linewidth=1.0, zorder=1, label="best for its time",
    )  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.margins(0.12, 0.15)
    doubt = None if found.reference is None else found.reference.uncertainty.get(measure)
    if doubt:
        low, high = ax.get_ylim()
        low = min(low, 0.5 * doubt)
        ax.axhspan(
            low, doubt, color=plot_style.FAINT, alpha=0.4, linewidth=0, zorder=0, label="reference's uncertainty"
        )
        ax.set_ylim(low, high)
    plot_style.label(ax, "", f"Error ({unit})", f"{title[0].upper()}{title[1:]}: {meaning}")
    _log_ticks(ax)


def _log_ticks(ax: "Axes") -> None:
    """Plain numbers at 1, 2, 5 within a decade or two; powers of ten over more."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_view_interval()
        many = np.log10(high / low) > 2.5
        axis.set_major_locator(LogLocator(subs=(1.0,) if many else (1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)) if many else NullLocator())
        axis.set_minor_formatter(NullFormatter())


def _name_points(ax: "Axes", found: Front, measure: str) -> None:
    """Names beside the settings on the front and beside the knobs, clear of each other and of all points."""
    shown = [r for r in found.rows if r.ok and r.errors.get(measure)]
    best = {id(found.rows[k]) for k in on_front(found)[measure]}
    named = [r for r in shown if id(r) in best or not r.setting.numerical]
    points = np.concatenate(
        [_on_page(ax, [(r.run_seconds, r.errors[measure]) for r in shown]), _line(ax, found, measure)]
    )
    spots = _on_page(ax, [(r.run_seconds, r.errors[measure]) for r in named])
    place_names(ax, [r.setting.label or r.setting.size for r in named], spots, points)


def _line(ax: "Axes", found: Front, measure: str) -> np.ndarray:
    """Points along the front, close enough that no name fits between two."""
    best = [found.rows[k] for k in on_front(found)[measure]]
    corners = _on_page(ax, [(r.run_seconds, r.errors[measure]) for r in best if r.errors[measure]])
    pieces = [np.linspace(a, b, 80) for a, b in itertools.pairwise(corners)]
    return np.concatenate([corners, *pieces])


def _on_page(ax: "Axes", points: Sequence[Any]) -> np.ndarray:
    """Points of the page (72 per inch)."""
    return ax.transData.transform(np.asarray(points, float).reshape(-1, 2)) * 72.0 / ax.figure.get_dpi()


def place_names(ax: "Axes", names: list[str], spots: np.ndarray, points: np.ndarray) -> None:
    """Write names beside spots of the page, clear of all points."""
    if not names:
        return
    box = ax.get_window_extent().transformed(ax.figure.dpi_scale_trans.inverted())
    frame = (72.0 * box.x0, 72.0 * box.y0, 72.0 * box.x1, 72.0 * box.y1)
    small = plot_style.SMALL - 0.5
    wanted = [
        labels.Label(name, (0.56 * small * len(name) + BETWEEN, small + 2.0), spot[None] + np.zeros((1, 2)))
        for name, spot in zip(names, spots, strict=True)
    ]
    around = np.concatenate([points + np.array(shift) for shift in ((0, 0), (3, 0), (-3, 0), (0, 3), (0, -3))])
    for label, place in zip(wanted, labels.place(wanted, around, frame), strict=True):
        reach = place.center - place.anchor
        far = np.hypot(*(np.maximum(np.abs(reach) - 0.5 * np.array(label.size), 0.0))) > 6.0
        ax.annotate(
            label.text, _data(ax, place.anchor), xytext=tuple(reach), textcoords="offset points", ha="center", va="center",
            fontsize=small, color=plot_style.INK, zorder=7,
            arrowprops={"arrowstyle": "-", "color": plot_style.STEEL, "linewidth": 0.5} if far else None,
        )  # fmt: skip


def _data(ax: "Axes", point: np.ndarray) -> tuple[float, float]:
    x, y = ax.transData.inverted().transform(point * ax.figure.get_dpi() / 72.0)
    return float(x), float(y)


def growth(rows: list[dict[str, Any]]) -> "Axes":
    """Cost against size, both logarithmic: bars, parts, samples and length of the run."""
    by_series: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_series.setdefault(row["series"], []).append(row)
    parts = {k: v for k, v in by_series.items() if k not in ("bars", "samples", "length")}
    panels = []
    for key, vertical in (("us_per_step", "Time per step (us)"), ("compile_seconds", "Compile time (s)")):
        panels.append((vertical, "Bars of the sheet", key, {"bars": by_series.get("bars", [])}))
        panels.append((vertical, "Parts of the machine", key, parts))
    panels.append(
        ("Per step and sample (us)", "Samples in a batch", "us_per_step", {"samples": by_series.get("samples", [])})
    )
    panels.append(("Peak memory (MB)", "Simulated time (s)", "peak_mb", {"length": by_series.get("length", [])}))
    return _curves(panels)


def batch(rows: list[dict[str, Any]], device: str) -> "Axes":
    """Steps per second, and compile time, against the size of a batch."""
    series = {p: [r | {"size": r["samples"]} for r in rows if r["precision"] == p] for p in ("float64", "float32")}
    panels = [
        ("Steps of all samples per second", f"Samples in a batch, {device}", "steps_per_second", series),
        ("Compile time (s)", f"Samples in a batch, {device}", "compile_seconds", series),
    ]
    return _curves(panels)


def ripple(rows: list[dict[str, Any]]) -> "Axes":
    """Ripple of force and slip, and how far the lead edge is off, against time per step: where the smooth skin pays."""
    panels = []
    for key, title in (
        ("force_ripple_n", "Ripple of the force (N)"),
        ("slip_ripple_mm_s", "Ripple of the slip (mm/s)"),
        ("force_error_n", "Error of the mean force (N)"),
        ("lead_error_mm", "Error of the lead edge (mm)"),
    ):
        by_skin = {
            f"skin {skin}": [r | {"size": r["us_per_step"]} for r in rows if r["skin"] == skin and "us_per_step" in r]
            for skin in dict.fromkeys(r["skin"] for r in rows)
        }
        panels.append((title, "Time per step (us)", key, by_skin))
    return _curves(panels)


def roughness(rows: list[dict[str, Any]]) -> "Axes":
    """Scatter of the lead edge over time: a panel for each start, a line for each way of stepping."""
    panels = []
    for start in dict.fromkeys(r["start"] for r in rows):
        ways: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            if row["start"] == start and "time" in row:
                ways.setdefault(row["steps"], []).append(row | {"size": row["time"]})
        panels.append((f"Scatter, {start} (um)", "Time (s)", "scatter_um", ways))
    return _curves(panels)


Panel = tuple[str, str, str, dict[str, list[dict[str, Any]]]]
"""Vertical label, horizontal label, key of the value, rows by series."""


def _curves(panels: list[Panel]) -> "Axes":
    from matplotlib import pyplot

    panels = [p for p in panels if any(r.get(p[2]) for found in p[3].values() for r in found)]
    if not panels:
        return _nothing()
    rows = -(-len(panels) // 2)
    size = (plot_style.WIDTH, 2.3 * rows + 0.2)
    _, made = pyplot.subplots(rows, 2, figsize=size, dpi=150, layout="constrained", squeeze=False)
    for ax, (vertical, horizontal, key, series) in zip(made.flat, panels, strict=False):
        for i, (name, found) in enumerate(series.items()):
            known = [r for r in found if r.get(key)]
            at = [r["size"] for r in known], [r[key] for r in known]
            ax.plot(*at, marker=MARKS[i % len(MARKS)], markersize=4, label=name, **plot_style.line(i))
        ax.set_xscale("log")
        ax.set_yscale("log")
        _at_least_a_decade(ax)
        plot_style.label(ax, horizontal, vertical)
        _log_ticks(ax)
        if len(series) > 1:
            ax.legend(
                fontsize=plot_style.SMALL - 0.5, frameon=False, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2,
                columnspacing=1.2,
            )  # fmt: skip
    for ax in made.flat[len(panels) :]:
        ax.set_visible(False)
    return made.flat[0]


def _at_least_a_decade(ax: "Axes") -> None:
    """A flat curve looks flat only on a scale that shows more than its noise."""
    low, high = ax.get_ylim()
    if high < 10.0 * low:
        middle = (low * high) ** 0.5
        ax.set_ylim(middle / 10.0**0.5, middle * 10.0**0.5)


def features(rows: list[dict[str, Any]]) -> "Axes":
    """Equations, compile time and time per step of the full scene (dark) and without each feature."""
    keys = {"equations": "Equations", "compile_seconds": "Compile time (s)", "us_per_step": "Time per step (us)"}
    return _beside_the_first(rows, ["everything", *(f"without {r['without']}" for r in rows[1:])], keys)


def gradient(rows: list[dict[str, Any]]) -> "Axes":
    """Time, tracing and compilation of the run (dark) and of its gradients."""
    keys = {"run_seconds": "Time of one call (s)", "trace_seconds": "Tracing (s)", "compile_seconds": "Compiling (s)"}
    return _beside_the_first(rows, [r["what"].replace(", ", ",\n") for r in rows], keys)


def _beside_the_first(rows: list[dict[str, Any]], names: list[str], keys: dict[str, str]) -> "Axes":
    """A panel of bars for each key that is known; the first row is what the others are held against."""
    from matplotlib import pyplot

    keys = {key: title for key, title in keys.items() if any(r.get(key) for r in rows)}
    size = (plot_style.WIDTH, 0.9 + 0.2 * sum(name.count("\n") + 1 for name in names))
    _, grid = pyplot.subplots(1, len(keys), figsize=size, dpi=150, layout="constrained", sharey=True, squeeze=False)
    made = grid[0]
    places = np.arange(len(rows))
    for ax, (key, title) in zip(made, keys.items(), strict=True):
        values = np.array([r.get(key, np.nan) for r in rows], float)
        ax.barh(places, values, 0.65, color=[plot_style.INK, *[plot_style.COLORS[0]] * (len(rows) - 1)], alpha=0.85)
        if np.isfinite(values[0]):
            ax.axvline(values[0], color=plot_style.INK, linewidth=0.8, linestyle=(0, (4, 2)))
        plot_style.label(ax, title, "")
        ax.grid(visible=False, axis="y")
        ax.tick_params(axis="y", length=0)
    made[0].set_yticks(places, names)
    made[0].set_ylim(len(rows) - 0.4, -0.6)
    return made[0]
