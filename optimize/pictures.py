"""Pictures of a search. Each function returns the matplotlib axes and neither shows nor saves."""

from typing import TYPE_CHECKING, Any

import numpy as np

import diffeed
from diffeed import plot, plot_style
from optimize.blame_map import Arising, Blame, gain_of
from optimize.problem import SLACK
from optimize.variables import unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 8
"""Arrows on the blame map."""
ABSURD = 10.0
"""Times the objective that 0.1 mm would gain: no machine does that."""
FAINTEST = 0.01
"""Of the largest gain: less gets no arrow."""


def history(lines: list[dict[str, Any]], ax: "Axes | None" = None) -> "Axes":
    """Objective and best kept objective over iterations; broken limits are marked."""
    ax = plot_style.axes(ax)
    k = np.array([line["iteration"] for line in lines])
    now = np.array([_number(line["objective"]) for line in lines])
    best = np.array([_number(line["best"]) for line in lines])
    broken = np.array([_number(line["violation"]) for line in lines]) > SLACK
    ax.plot(k, now, label="objective", **plot_style.line(5))
    if np.isfinite(best).any():
        ax.plot(k, best, label="best that keeps the limits", **plot_style.line(0))
    if broken.any():
        ax.plot(k[broken], now[broken], "x", color=plot_style.COLORS[1], markersize=4, label="a limit is broken")
    plot_style.label(ax, "Iteration", "Objective")
    plot_style.legend_beside(ax)
    return ax


def variables(problem: Any, lines: list[dict[str, Any]], ax: "Axes | None" = None) -> "Axes":
    """Every variable as its share of the way between its bounds, against the iteration; logarithmic where so searched."""
    ax = plot_style.axes(ax)
    k = [line["iteration"] for line in lines]
    values = np.array([[line["values"][name] for name in problem.names] for line in lines])
    for i, (name, path) in enumerate(zip(problem.names, np.asarray(unit(problem.variables, values)).T, strict=True)):
        ax.plot(k, path, label=name, **plot_style.line(i))
    ax.set_ylim(-0.03, 1.03)
    plot_style.label(ax, "Iteration", "Place within the bounds")
    plot_style.legend_beside(ax)
    return ax


def blame_map(
    scene: diffeed.Scene, run: Any, found: Blame, size: float | None = None, ax: "Axes | None" = None
) -> "Axes":
    """The machine with arrows: move this point this way. Lengths are in proportion to the gain; the gain of 0.1 mm is
    written beside the largest. No arrows where that would be `ABSURD`, held against the `size` of the objective (the point's own
    if None)."""
    ax = plot.machine(scene, run, frames=(0, -1), ax=ax)
    rows = gain_of(found)[:SHOWN]
    rows = [row for row in rows if row[2] >= FAINTEST * rows[0][2]]  # the shortest arrow must not stand for nothing
    if not rows:
        _title(ax, "Moving parts does not change the objective")
        return ax
    worth = abs(found.objective) if size is None else size
    if rows[0][2] > ABSURD * worth > 0.0:
        most = "" if size is None else " at most"
        _title(
            ax,
            f"No gradient to believe: it promises {rows[0][2]:.2g} per 0.1 mm of an objective of {worth:.3g}{most}",
        )
        return ax
    low, high = np.array(ax.get_xlim()), np.array(ax.get_ylim())
    longest = 0.12 * max(np.ptp(low), np.ptp(high))
    for i, (path, way, gain) in enumerate(rows):
        at = np.asarray(diffeed.get(scene, path))
        tip = at + way * longest * max(gain / rows[0][2], 0.15)
        arrow = {"arrowstyle": "-|>", "color": plot_style.COLORS[1], "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", xy=tuple(tip), xytext=tuple(at), zorder=9, arrowprops=arrow)
        if i < 4:
            ax.annotate(f"{gain:.2g}", xy=tuple(tip), xytext=(3, 3), textcoords="offset points", zorder=10,
                        fontsize=plot_style.SMALL, color=plot_style.COLORS[1])  # fmt: skip
    title = "Which way to move what: gain in the objective per 0.1 mm"
    if rows[0][2] > worth > 0.0:
        title += f"\n(more than the whole objective, {worth:.3g}: directions at most, no amounts)"
    _title(ax, title)
    return ax


def _title(ax: "Axes", text: str) -> None:
    ax.set_title(text, fontsize=plot_style.TITLE, loc="left", pad=18)


def heat_map(found: Arising, ax: "Axes | None" = None) -> "Axes":
    """Part by time: where and when the sensitivity of the objective arises (logarithmic)."""
    order = np.argsort(-np.max(np.nan_to_num(found.share), axis=1))[:16]
    share = found.share[order]
    ax = plot_style.axes(ax, height=0.6 + 0.24 * len(order))
    top = float(np.nanmax(share)) or 1.0
    shown = np.log10(np.clip(share / top, 1e-4, 1.0))
    image = ax.pcolormesh(found.edges, np.arange(len(order) + 1), shown, cmap="Blues", vmin=-4, vmax=0)
    ax.set_yticks(np.arange(len(order)) + 0.5, [found.parts[i].split(".")[1] for i in order])
    ax.invert_yaxis()
    plot_style.label(ax, "Time (s)", "")
    ax.grid(visible=False)
    bar = ax.figure.colorbar(image, ax=ax, pad=0.02, ticks=[-4, -3, -2, -1, 0])
    bar.ax.set_yticklabels(["1e-4", "1e-3", "1e-2", "0.1", "1"])
    bar.set_label("Sensitivity, share of the largest", fontsize=plot_style.TEXT)
    bar.ax.tick_params(labelsize=plot_style.SMALL)
    return ax


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)
