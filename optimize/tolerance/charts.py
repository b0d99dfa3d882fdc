"""Pictures of tolerances. Each function takes plain arrays, returns the matplotlib axes and neither shows nor saves.

A draw is one run with its own random deviations. Shares go in as fractions and are drawn in percent.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from diffeed import plot_style
from optimize.tolerance.statistics import exact_interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Limits = tuple[float | None, float | None]
Ends = tuple[np.ndarray, np.ndarray]

AFTER, BEFORE, BROKEN = plot_style.COLORS[0], plot_style.INK, plot_style.COLORS[1]
PASSES, PASSES_NOT, FAILED = "#cde3f3", "#f7dcc6", "#f1f2f4"
LEVEL = 0.95  # of the confidence band of a distribution
LINE = 36  # letters of a name in one line


def histogram(
    values: np.ndarray, label: str, limits: Limits, ax: "Axes | None" = None, before: np.ndarray | None = None
) -> "Axes":
    """Share of the draws (%) over `values` (n,) in the unit that `label` names, limits as lines, shaded outside.

    `before` (n,) is an earlier design under the same draws, as an outline. What is not finite is left out and counted.
    """
    ax = plot_style.axes(ax)
    now, old = _finite(values), _finite(before)
    low, high = _span(np.concatenate([now, old]))
    bins = int(np.clip(np.sqrt(now.size), 12, 50)) // 2 * 2 + 1  # odd: a single value stands in the middle of its bar
    edges = np.linspace(low, high, bins + 1)
    names = _legend(now, old, limits, before is not None)
    if now.size:
        ax.stairs(_heights(now, edges), edges, fill=True, color=AFTER, alpha=0.75, label=names[0])
    if old.size:
        ax.stairs(_heights(old, edges), edges, color=BEFORE, linewidth=1.2, label=names[1])
    _draw_limits(ax, limits, _view(limits, low, high))
    ax.set_ylim(bottom=0.0)
    plot_style.label(ax, label, "Share of the draws (%)")
    plot_style.legend_beside(ax)
    _note(ax, "; ".join(_left_out(values, low, high) + _left_out(before, low, high, "before: ")))
    return ax


def distribution(
    values: np.ndarray, label: str, limits: Limits, ax: "Axes | None" = None, before: np.ndarray | None = None
) -> "Axes":
    """Share of the draws (%) at or below each of the `values` (n,), with the exact band of 95 % at each place.

    `before` (n,) is an earlier design under the same draws, as a line. What is not finite is left out and counted.
    """
    ax = plot_style.axes(ax)
    now, old = _finite(values), _finite(before)
    low, high = _span(np.concatenate([now, old]))
    view = _view(limits, low, high)
    names = _legend(now, old, limits, before is not None)
    if now.size:
        at, share = _steps(now, view)
        band = [100.0 * end for end in exact_interval(np.round(share * now.size), now.size, LEVEL)]
        ax.fill_between(
            at,
            band[0],
            band[1],
            step="post",
            color=AFTER,
            alpha=0.2,
            linewidth=0,
            label=f"{100 * LEVEL:g} % confidence",
        )
        ax.step(at, 100.0 * share, where="post", color=AFTER, linewidth=1.4, label=names[0])
    if old.size:
        at, share = _steps(old, view)
        ax.step(at, 100.0 * share, where="post", color=BEFORE, linewidth=1.0, dashes=(6, 2), label=names[1])
    _draw_limits(ax, limits, view)
    ax.set_ylim(-2.0, 102.0)
    plot_style.label(ax, label, "Share of the draws at or below (%)")
    plot_style.legend_beside(ax)
    _note(ax, "; ".join(_left_out(values, low, high) + _left_out(before, low, high, "before: ")))
    return ax


def convergence(
    counts: np.ndarray, value: np.ndarray, low: np.ndarray, high: np.ndarray, ax: "Axes | None" = None
) -> "Axes":
    """Share of the draws that fails, `value` (k,) with its interval `low` to `high` (k,), after `counts` (k,) draws."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    ax = plot_style.axes(ax)
    counts, value, low, high = (np.atleast_1d(np.asarray(a, float)) for a in (counts, value, low, high))
    known = np.flatnonzero(np.isfinite([value, low, high]).all(axis=0) & (counts > 0.0))
    ax.set_xscale("log")
    ax.set_ylim(0.0, 100.0)
    if known.size:
        at, percent, ends = counts[known], 100.0 * value[known], (100.0 * low[known], 100.0 * high[known])
        ax.fill_between(at, *ends, color=AFTER, alpha=0.2, linewidth=0, label="exact interval")
        ax.plot(at, percent, color=AFTER, linewidth=1.4, marker="o", markersize=2.5, label="share that fails")
        if known.size == 1:
            ax.vlines(at, *ends, color=AFTER, alpha=0.3, linewidth=4)
        top = min(100.0, 4.0 * ends[1][-1]) or 100.0  # the first few draws say little and run off the scale
        ax.set_xlim(at.min() / 1.5, at.max() * 1.5)
        ax.set_ylim(-0.02 * top, top)
        _note(ax, f"{percent[-1]:.3g} % ({ends[0][-1]:.3g} to {ends[1][-1]:.3g} %) after {at[-1]:.0f} draws")
    else:
        _note(ax, "no finite value")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    plot_style.label(ax, "Number of draws", "Share that fails (%)")
    plot_style.legend_beside(ax)
    return ax


def contributions(
    names: Sequence[str],
    shares: Mapping[str, np.ndarray],
    intervals: Mapping[str, Ends] | None = None,
    ax: "Axes | None" = None,
    most: int = 15,
) -> "Axes":
    """Share of the variance that each deviation brings, as fractions (d,) by the name of the way it was found.

    The `most` largest by the first of the `shares`; `intervals` holds the low and high ends (d,) of some of them.
    """
    found = {series: np.asarray(share, float) for series, share in shares.items()}
    order = _largest(next(iter(found.values())))
    kept, thick = order[:most], 0.8 / len(found)
    rows = {series: np.arange(len(kept)) + thick * (i + 0.5) - 0.4 for i, series in enumerate(found)}
    ax = plot_style.axes(ax, height=_height(len(order), most, max(0.26, 0.13 * len(found))))
    ax.axvline(0.0, color=plot_style.STEEL, linewidth=0.8)
    for color, (series, share) in zip(plot_style.COLORS, found.items(), strict=False):
        ax.barh(rows[series], 100.0 * share[kept], thick, color=color, alpha=0.85, label=series)
    for i, (series, ends) in enumerate((intervals or {}).items()):
        low, high = (100.0 * np.asarray(end, float)[kept] for end in ends)
        ax.hlines(rows[series], low, high, color=plot_style.INK, linewidth=1.0, label="" if i else "interval")
    _write_names(ax, names, order, most)
    ax.set_xlim(min(0.0, ax.get_xlim()[0]), max(100.0, ax.get_xlim()[1]))  # a share of hardly anything looks like one
    plot_style.label(ax, "Share of the variance (%)", "Deviation")
    ax.grid(visible=False, axis="y")
    plot_style.legend_above(ax)
    return ax


def gains(
    names: Sequence[str],
    gain: np.ndarray,
    error: np.ndarray,
    tighter: float,
    ax: "Axes | None" = None,
    most: int = 15,
) -> "Axes":
    """Change of the share that passes when one tolerance is made tighter by the share `tighter`; largest first.

    `gain` (d,), a fraction, and `error` (d,), its standard error. Without a finite gain there is no bar.
    """
    change, spread = 100.0 * np.asarray(gain, float), 100.0 * np.abs(np.asarray(error, float))
    order = _largest(np.abs(change))
    kept = order[:most]
    rows = np.arange(len(kept))
    ax = plot_style.axes(ax, height=_height(len(order), most, 0.26))
    for chosen, color, meaning in (
        (change >= 0.0, AFTER, "more draws pass"),
        (change < 0.0, BROKEN, "fewer draws pass"),
    ):
        if chosen[kept].any():
            ax.barh(rows[chosen[kept]], change[kept][chosen[kept]], 0.6, color=color, alpha=0.85, label=meaning)
    ends = change[kept] - spread[kept], change[kept] + spread[kept]
    ax.hlines(rows, *ends, color=plot_style.INK, linewidth=1.0, label="± standard error")
    ax.axvline(0.0, color=plot_style.STEEL, linewidth=0.8)
    _write_names(ax, names, order, most)
    title = f"Change of the share that passes, tolerance {100 * tighter:g} % tighter (percentage points)"
    plot_style.label(ax, title, "Tolerance")
    ax.grid(visible=False, axis="y")
    plot_style.legend_above(ax)
    return ax


def latitude(
    x: np.ndarray,
    y: np.ndarray,
    margin: np.ndarray,
    passed: np.ndarray,
    x_label: str,
    y_label: str,
    ax: "Axes | None" = None,
    nominal: tuple[float, float] | None = None,
) -> "Axes":
    """Media latitude: where in the plane of `x` (nx,) and `y` (ny,) a sheet passes, `passed` (ny, nx).

    Contours of the `margin` (ny, nx) from a jam; where it is not finite the run failed. A sheet may keep away from a jam and
    not pass: by its limits.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    ax = plot_style.axes(ax, height=4.0)
    x, y, margin = np.asarray(x, float), np.asarray(y, float), np.asarray(margin, float)
    failed = ~np.isfinite(margin)
    state = np.where(failed, 2, np.asarray(passed, bool))
    across, up = _edges(x).tolist(), _edges(y).tolist()
    colors = ListedColormap([PASSES_NOT, PASSES, FAILED])
    ax.pcolormesh(across, up, state, cmap=colors, vmin=0, vmax=2, edgecolors="white", linewidth=0.3)
    for color, meaning in ((PASSES, "passes"), (PASSES_NOT, "does not pass")):
        ax.plot([], [], "s", color=color, markersize=8, label=meaning)
    for k, (j, i) in enumerate(np.argwhere(failed)):
        corner, wide, tall = (across[i], up[j]), across[i + 1] - across[i], up[j + 1] - up[j]
        hatch = {"hatch": "////", "facecolor": "none", "edgecolor": plot_style.STEEL, "linewidth": 0.0}
        ax.add_patch(Rectangle(corner, wide, tall, label="run failed" if k == 0 else None, **hatch))
    _draw_margin(ax, x, y, np.ma.masked_invalid(margin))
    if nominal is not None:
        ax.plot(*nominal, "*", color=plot_style.INK, markeredgecolor="white", markersize=12, zorder=5, label="nominal")
    plot_style.label(ax, x_label, y_label)
    ax.grid(visible=False)
    plot_style.legend_above(ax)
    return ax


def _finite(values: np.ndarray | None) -> np.ndarray:
    found = np.ravel(np.asarray([] if values is None else values, float))
    return found[np.isfinite(found)]


def _span(values: np.ndarray) -> tuple[float, float]:
    """Ends of an axis for finite values: all of them, less a few that lie far off."""
    if values.size == 0:
        return 0.0, 0.0
    near, far = np.percentile(values, [1.0, 99.0])
    room = far - near or np.inf
    low, high = max(values.min(), near - room), min(values.max(), far + room)
    if high - low > 1e-9 * max(abs(low), abs(high)):
        return float(low), float(high)
    around = 0.05 * abs(low) or 0.5
    return float(low - around), float(high + around)


def _heights(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return 100.0 * np.histogram(values, edges)[0] / values.size


def _steps(values: np.ndarray, view: tuple[float, float]) -> Ends:
    """Places and shares of the empirical distribution, with the ends of the view as first and last place."""
    from scipy.stats import ecdf

    curve = ecdf(values).cdf
    ends = min(view[0], values.min()), max(view[1], values.max())
    return np.r_[ends[0], curve.quantiles, ends[1]], np.r_[0.0, curve.probabilities, 1.0]


def _known(limits: Limits) -> dict[str, float]:
    both = zip(("lower", "upper"), limits, strict=True)
    return {name: float(limit) for name, limit in both if limit is not None and np.isfinite(limit)}


def _view(limits: Limits, low: float, high: float) -> tuple[float, float]:
    """Ends of the horizontal axis: the values from `low` to `high` (none if these are equal) and the limits."""
    known = list(_known(limits).values())
    if low == high:
        low, high = _span(np.array(known or [0.0, 1.0]))
    low, high = min([low, *known]), max([high, *known])
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _draw_limits(ax: "Axes", limits: Limits, view: tuple[float, float]) -> None:
    """Lines at the limits, shaded outside."""
    for name, limit in _known(limits).items():
        end, dash = (view[0], (0, (6, 2))) if name == "lower" else (view[1], "-")
        ax.axvspan(min(limit, end), max(limit, end), color=BROKEN, alpha=0.12, linewidth=0, zorder=0)
        ax.axvline(limit, color=BROKEN, linewidth=1.2, linestyle=dash, label=f"{name} limit {limit:g}")
    ax.set_xlim(*view)


def _legend(now: np.ndarray, old: np.ndarray, limits: Limits, two: bool) -> tuple[str, str]:
    """Names of the design and of the earlier one, each with the share of its draws outside the limits."""
    known = _known(limits)
    low, high = known.get("lower", -np.inf), known.get("upper", np.inf)
    found = []
    for name, values in (("after" if two else "draws", now), ("before, same draws", old)):
        outside = 100.0 * np.mean((values < low) | (values > high)) if values.size else 0.0
        found.append(f"{name}\n({outside:.3g} % outside)" if known else name)
    return found[0], found[1]


def _left_out(values: np.ndarray | None, low: float, high: float, who: str = "") -> list[str]:
    """What a picture of `values` between `low` and `high` does not show."""
    if values is None:
        return []
    finite, total = _finite(values), np.size(values)
    beyond = int(np.sum((finite < low) | (finite > high)))
    found = [f"{total - finite.size} of {total} draws not finite"] if finite.size < total else []
    return [who + ", ".join(found + ([f"{beyond} off the scale"] if beyond else []))] if found or beyond else []


def _note(ax: "Axes", text: str) -> None:
    if text:
        ax.text(1.0, 1.02, text, transform=ax.transAxes, ha="right", va="bottom",
                fontsize=plot_style.SMALL, color=plot_style.STEEL)  # fmt: skip


def _largest(values: np.ndarray) -> np.ndarray:
    """Indices, largest first; what is not finite comes last."""
    return np.argsort(-np.where(np.isfinite(values), values, -np.inf), kind="stable")


def _height(count: int, most: int, each: float) -> float:
    """Inches for the bars, the line below them that says how many are left out, and the axis."""
    return 0.8 + max(0.6, each * (min(count, most) + (count > most)))


def _write_names(ax: "Axes", names: Sequence[str], order: np.ndarray, most: int) -> None:
    """One line per bar, largest on top, and one that says how many are left out."""
    shown = [_fit(names[int(i)]) for i in order[:most]]
    if len(order) > most:
        shown.append(f"and {len(order) - most} smaller ones")
    ax.set_yticks(np.arange(len(shown)), shown)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)


def _fit(name: str) -> str:
    """The name in one or two lines; of a longer one the beginning and the end."""
    lines = textwrap.wrap(name, LINE)
    return "\n".join(lines if len(lines) <= 2 else [name[: LINE - 1] + "…", "…" + name[1 - LINE :]])


def _edges(centers: np.ndarray) -> np.ndarray:
    """Borders (n + 1,) of the cells around ascending `centers` (n,)."""
    if centers.size == 1:
        around = 0.05 * abs(centers[0]) or 0.5
        return np.array([centers[0] - around, centers[0] + around])
    inner = 0.5 * (centers[1:] + centers[:-1])
    return np.r_[2.0 * centers[0] - inner[0], inner, 2.0 * centers[-1] - inner[-1]]


def _draw_margin(ax: "Axes", x: np.ndarray, y: np.ndarray, margin: np.ma.MaskedArray) -> None:
    """Contours with their values, the one of zero thick; none where there is nothing between two."""
    from matplotlib.ticker import MaxNLocator

    if min(margin.shape) < 2 or margin.count() == 0:
        return
    low, high = float(margin.min()), float(margin.max())
    levels = [level for level in MaxNLocator(8, steps=[1, 2, 5, 10]).tick_values(low, high) if low < level < high]
    if not levels:
        return
    wide = [2.2 if abs(level) < 1e-12 else 0.7 for level in levels]
    drawn = ax.contour(x, y, margin, levels=levels, colors=plot_style.INK, linewidths=wide, linestyles="-")
    ax.clabel(drawn, fontsize=plot_style.SMALL, fmt="%g")
    thick = 2.2 in wide
    ax.plot(
        [], [], color=plot_style.INK, linewidth=2.2 if thick else 0.7, label="margin (thick: 0)" if thick else "margin"
    )
