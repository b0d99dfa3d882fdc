"""The picture of the stability map: a panel for each stepper and number, a coloured cell for each run."""

from typing import TYPE_CHECKING, Any

import numpy as np

from diffeed import plot_style
from diffeed.bench.stability import CLASSES, CONTROLLED, RIGHT, WRONG
from diffeed.bench.stability_scene import AXES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {"right": "#56B4E9", "inaccurate": "#F0E442", "wrong": "#D55E00", "failed": "#8d949e", "unclear": "#eceff2"}
WORDS = {
    "right": f"right: within {RIGHT:g} mm",
    "inaccurate": "inaccurate",
    "wrong": f"wrong by {WRONG:g} mm and more, and yet holds",
    "failed": "failed, and said so",
    "unclear": "reference not known that well",
}


def stability(rows: list[dict[str, Any]]) -> "Axes":
    """Steppers downwards, numbers across. Hatched: what `diffeed.check` refuses; the line is its limit."""
    from matplotlib import pyplot

    methods = list(dict.fromkeys(r["method"] for r in rows))
    names = [name for name in AXES if len({r["value"] for r in rows if r["axis"] == name}) > 1]
    size = (plot_style.WIDTH + 0.6, 1.15 * len(methods) + 1.1)
    figure, made = pyplot.subplots(
        len(methods), len(names), figsize=size, dpi=150, layout="constrained", sharex="col", sharey="row", squeeze=False
    )
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.03)  # type: ignore[union-attr]
    for line, method in zip(made, methods, strict=True):
        for ax, name in zip(line, names, strict=True):
            _panel(ax, [r for r in rows if (r["method"], r["axis"]) == (method, name)])
        vertical = "Tolerance (mm)" if method == CONTROLLED else "Time step (s)"
        line[0].set_ylabel(f"{method.replace(', ', chr(10))}\n{vertical}", fontsize=plot_style.SMALL)
    for ax, name in zip(made[-1], names, strict=True):
        title, unit, _ = AXES[name]
        ax.set_xlabel(f"{title}\n({unit})" if unit != "1" else title, fontsize=plot_style.SMALL)
    _legend(figure, rows)
    return made[0, 0]


def _panel(ax: "Axes", rows: list[dict[str, Any]]) -> None:
    from matplotlib.colors import ListedColormap

    values, sizes = (sorted({r[key] for r in rows}) for key in ("value", "size"))
    became = np.full((len(sizes), len(values)), np.nan)
    for r in rows:
        became[sizes.index(r["size"]), values.index(r["value"])] = CLASSES.index(r["became"])
    across, up = _edges(values), _edges(sizes)
    ax.set_xscale("log")
    ax.set_yscale("log")
    colors = ListedColormap([COLORS[name] for name in CLASSES])
    ax.pcolormesh(
        across, up, np.ma.masked_invalid(became), cmap=colors, vmin=-0.5, vmax=len(CLASSES) - 0.5, edgecolors="white",
        linewidth=0.4,
    )  # fmt: skip
    for r in rows:
        _mark(ax, r, across[values.index(r["value"]) :][:2], up[sizes.index(r["size"]) :][:2])
    _limit(ax, rows, across, up)
    ax.set_xlim(across[0], across[-1])
    ax.set_ylim(up[0], up[-1])
    _ticks(ax, values)


def _mark(ax: "Axes", row: dict[str, Any], across: np.ndarray, up: np.ndarray) -> None:
    """Hatching over what is refused, a cross on what is wrong: told apart without colour too."""
    from matplotlib.patches import Rectangle

    if row["refused"]:
        corner, width, height = (across[0], up[0]), across[1] - across[0], up[1] - up[0]
        ax.add_patch(
            Rectangle(corner, width, height, fill=False, hatch="//////", edgecolor="white", linewidth=0.0, alpha=0.8)
        )
    if row["became"] == "wrong":
        middle = np.sqrt(across[0] * across[1]), np.sqrt(up[0] * up[1])
        ax.plot(*middle, marker="x", markersize=3.2, markeredgewidth=1.0, color="white", zorder=4)


def _limit(ax: "Axes", rows: list[dict[str, Any]], across: np.ndarray, up: np.ndarray) -> None:
    """The largest stable step of the explicit stepper, value by value."""
    known = sorted({(r["value"], r["limit_s"]) for r in rows if r["limit_s"] is not None})
    if known:
        limits = np.clip([limit for _, limit in known], up[0], up[-1])
        ax.stairs(limits, across, color=plot_style.INK, linewidth=1.1, baseline=None, zorder=5)


def _edges(centres: list[float]) -> np.ndarray:
    """Borders of cells, in the middle between their centres on a logarithmic scale."""
    at = np.log(np.array(centres, float))
    if len(at) < 2:
        return np.exp(at[0] + np.array([-0.5, 0.5]))
    middle = 0.5 * (at[1:] + at[:-1])
    return np.exp(np.concatenate([[2.0 * at[0] - middle[0]], middle, [2.0 * at[-1] - middle[-1]]]))


def _ticks(ax: "Axes", values: list[float]) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogFormatterMathtext, LogLocator, NullFormatter

    narrow = values[-1] / values[0] < 100.0
    ax.xaxis.set_major_locator(FixedLocator(values) if narrow else LogLocator(numticks=4))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}") if narrow else LogFormatterMathtext())
    ax.yaxis.set_major_locator(LogLocator(numticks=6))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter(NullFormatter())
        axis.set_minor_locator(FixedLocator([]))
    ax.tick_params(labelsize=plot_style.SMALL - 0.5, color=plot_style.STEEL, length=2.0, pad=1.5)
    ax.tick_params(axis="x", length=2.0 if ax.get_subplotspec().is_last_row() else 0.0)  # type: ignore[union-attr]
    for edge in ax.spines.values():
        edge.set_visible(False)


def _legend(figure: Any, rows: list[dict[str, Any]]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    shown = [name for name in CLASSES if name == "wrong" or any(r["became"] == name for r in rows)]
    handles: list[Any] = [Patch(color=COLORS[name], label=WORDS[name]) for name in shown]
    if any(r["limit_s"] is not None for r in rows):
        handles.append(Patch(facecolor=COLORS["failed"], edgecolor="white", hatch="//////", linewidth=0.0,
                             label="refused by check (colour: if run all the same)"))  # fmt: skip
        handles.append(Line2D([], [], color=plot_style.INK, linewidth=1.1, label="largest stable step, by theory"))
    figure.legend(handles=handles, loc="outside upper left", ncols=3, fontsize=plot_style.SMALL, frameon=False)
