"""One look for all pictures: colours of Okabe and Ito, dashes that tell lines apart without colour, units on axes."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diffeed.base.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", (0, (6, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1.5)), (0, (9, 3)), (0, (3, 2, 1, 2, 1, 2)))
INK, STEEL, FAINT = "#222222", "#6b7280", "#c3c8cf"
WIDTH = 7.2  # inches: a text column of a page
TITLE, TEXT, SMALL = 9.0, 8.0, 7.0  # points


def axes(ax: "Axes | None", height: float = 2.8) -> "Axes":
    """`ax`, or the axes of a new figure of `height` inches."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    _, made = pyplot.subplots(figsize=(WIDTH, height), dpi=150, layout="constrained")
    return made


def lines(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Colour and dash of every part, the same in all pictures of a scene."""
    return {name: line(i) for i, name in enumerate(sorted(names))}


def line(i: int) -> dict[str, Any]:
    """Colour and dash number i; the 49 pairs differ."""
    dash = (i + i // len(COLORS)) % len(DASHES)
    return {"color": COLORS[i % len(COLORS)], "linestyle": DASHES[dash], "linewidth": 1.2}


def label(ax: "Axes", horizontal: str, vertical: str, title: str | None = None) -> None:
    """Axis labels, a title on the left, a light grid and no frame."""
    ax.set_xlabel(horizontal, fontsize=TEXT)
    ax.set_ylabel(vertical, fontsize=TEXT)
    ax.tick_params(labelsize=SMALL, color=STEEL)
    ax.grid(color="#eceff2", linewidth=0.6)
    ax.set_axisbelow(True)
    for edge in ("top", "right"):
        ax.spines[edge].set_visible(False)
    if title is not None:
        ax.set_title(title, fontsize=TITLE, loc="left")


def leave_out_peaks(ax: "Axes", values: np.ndarray) -> None:
    """Fit the vertical axis to all but 2 % of the values where a few peaks would flatten the rest, and say so."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return
    low, high = np.percentile(finite, [1.0, 99.0])
    room = 0.5 * (high - low)
    if finite.max() - finite.min() < 4.0 * (high - low) or room <= 0.0:
        return
    ax.set_ylim(low - room, high + room)
    note = f"peaks from {finite.min():.3g} to {finite.max():.3g} lie off the scale"
    ax.text(1.0, 1.02, note, transform=ax.transAxes, ha="right", va="bottom", fontsize=SMALL, color=STEEL)


def legend_beside(ax: "Axes") -> None:
    """A legend to the right of curves."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=SMALL, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))


def legend_above(ax: "Axes") -> None:
    """A legend in one row over a map, which needs the full width."""
    handles, _ = ax.get_legend_handles_labels()
    if handles:
        ax.legend(
            fontsize=SMALL, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(len(handles), 8)
        )


def save(path: Path, draw: "Callable[[], Axes]") -> None:
    """Draw without a screen, write the picture, and let its memory go."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure = draw().figure
    try:
        with replacing(path) as stream:
            figure.savefig(stream, format=path.suffix.removeprefix(".") or "png")  # type: ignore[union-attr]
    finally:
        pyplot.close(figure)  # type: ignore[arg-type]
