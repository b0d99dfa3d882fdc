"""Pictures for print, one function each. Every function draws into `ax` (or a new figure) and returns the axes.

Nothing is shown or saved. Legends stand beside the curves: make figures of your own with `layout="constrained"`. Colours are
safe for the colour-blind; lines also differ in dash, for black and white print.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from diffeed import plot_style
from diffeed.base.names import known_name
from diffeed.input.parts import Scene
from diffeed.model.rollers import is_driven
from diffeed.show import outlines, plot_machine

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN_FRAMES = 5


def machine(
    scene: Scene, trajectory: Any = None, frames: Iterable[int] | None = None, ax: "Axes | None" = None
) -> "Axes":
    """The machine with its part names, and the sheets at several frames (default: five over the run).

    Ticks lie behind the bearing face of a guide, as deep as half its `depth`; parts stand as in the last frame drawn.
    """
    trajectory = jax.device_get(trajectory)
    chosen = _chosen_frames(trajectory, frames)
    ax = plot_machine.map_axes(ax, scene, trajectory)
    plot_machine.draw_parts(ax, scene, trajectory, chosen[-1])
    plot_machine.draw_sheets(ax, scene, trajectory, chosen)
    plot_machine.draw_clamps(ax, scene, trajectory, chosen[-1])
    plot_style.label(ax, "x (mm)", "y (mm)")
    plot_style.legend_above(ax)
    plot_machine.write_names(ax, scene, trajectory, chosen)
    return ax


def slip(scene: Scene, trajectory: Any, ax: "Axes | None" = None) -> "Axes":
    """Slip speed between each driven roller and the sheet, drawn while they touch (Figure 11 of the source paper)."""
    ax, trajectory = plot_style.axes(ax), jax.device_get(trajectory)
    driven = [name for name in sorted(scene.rollers) if is_driven(scene.rollers[name])]
    values = {name: _slip_in_contact(trajectory.rollers[name]) for name in driven}
    for name in driven:
        ax.plot(outlines.time(trajectory), values[name], label=name, **plot_style.lines(scene.rollers)[name])
    plot_style.leave_out_peaks(ax, np.array(list(values.values())))
    return _curves(ax, trajectory, "Slip, roller minus sheet (mm/s)", "Slip of the driven rollers")


def nip_forces(scene: Scene, trajectory: Any, ax: "Axes | None" = None) -> "Axes":
    """Normal force between each roller and the sheets."""
    ax, trajectory = plot_style.axes(ax), jax.device_get(trajectory)
    for name, style in plot_style.lines(scene.rollers).items():
        ax.plot(outlines.time(trajectory), outlines.vector(trajectory.rollers[name].force), label=name, **style)
    return _curves(ax, trajectory, "Normal force (N)", "Normal force on the rollers")


def paths(
    scene: Scene, trajectory: Any, bars: Sequence[int] = (0, 1, 2), sheet: str | None = None, ax: "Axes | None" = None
) -> "Axes":
    """Paths of some bar centres with the machine drawn faintly (Figure 12 of the source paper). Bar 0 leads."""
    trajectory = jax.device_get(trajectory)
    ax = plot_machine.map_axes(ax, scene, trajectory)
    plot_machine.draw_parts(ax, scene, trajectory, 0, faint=True)
    nodes = outlines.vector(trajectory.sheets[_sheet_name(scene, sheet)].nodes)
    for i, bar in enumerate(bars):
        if not 0 <= bar < nodes.shape[1] - 1:
            raise ValueError(f"bars must be from 0 to {nodes.shape[1] - 2}, but one is {bar}")
        center, style = 0.5 * (nodes[:, bar] + nodes[:, bar + 1]), plot_style.line(i)
        end = " (lead)" if bar == 0 else " (tail)" if bar == nodes.shape[1] - 2 else ""
        ax.plot(*center.T, label=f"centre of bar {bar}{end}", zorder=5, **style)
        ax.plot(*center[0], marker="o", markersize=3, color=style["color"], zorder=5)
    plot_style.label(ax, "x (mm)", "y (mm)")
    plot_style.legend_above(ax)
    return ax


def sheet_state(
    scene: Scene, trajectory: Any, quantity: str = "curvature", sheet: str | None = None, ax: "Axes | None" = None
) -> "Axes":
    """Heat map over time and place on the sheet: "curvature" (1/mm), or contact "force" per width (N/mm)."""
    ax, name = plot_style.axes(ax), _sheet_name(scene, sheet)
    record = scene.sheets[name]
    values, limits, colors, meaning = _state(record, trajectory.sheets[name], quantity)
    places = (np.arange(record.bars) + 0.5) * float(record.length) / record.bars
    image = ax.pcolormesh(outlines.time(trajectory), places, values.T, cmap=colors, shading="nearest")
    image.set_clim(*limits)
    image.set_rasterized(True)
    plot_style.label(ax, "Time (s)", "Distance from the leading edge (mm)", f"Sheet {name}")
    ax.invert_yaxis()
    ax.grid(visible=False)
    bar = ax.figure.colorbar(image, ax=ax, pad=0.02)
    bar.set_label(meaning, fontsize=plot_style.TEXT)
    bar.ax.tick_params(labelsize=plot_style.SMALL)
    return ax


def _state(record: Any, track: Any, quantity: str) -> tuple[np.ndarray, tuple[float, float], str, str]:
    """Values (frames, bars), their range, a colour map and the meaning."""
    if quantity == "curvature":
        values = outlines.curvature(outlines.vector(track.headings), float(record.length) / record.bars)
        top = outlines.top(np.abs(values))
        return values, (-top, top), "PuOr", "Curvature, left positive (1/mm)"
    if quantity == "force":
        values = outlines.vector(track.force) / float(record.width)
        return values, (0.0, outlines.top(values)), "Blues", "Contact force per width (N/mm)"
    raise ValueError(f'quantity must be "curvature" or "force", but is {quantity!r}')


def _slip_in_contact(track: Any) -> np.ndarray:
    return np.where(outlines.vector(track.force) > 0.0, outlines.vector(track.slip), np.nan)


def _curves(ax: "Axes", trajectory: Any, quantity: str, title: str) -> "Axes":
    time = outlines.time(trajectory)
    ax.set_xlim(time[0], time[-1])
    ax.axhline(0.0, color=plot_style.FAINT, linewidth=0.8, zorder=0)
    plot_style.label(ax, "Time (s)", quantity, f"{title}, at {len(time)} moments")  # a report's peaks are of every step
    plot_style.legend_beside(ax)
    return ax


def _chosen_frames(trajectory: Any, frames: Iterable[int] | None) -> list[int]:
    if trajectory is None:
        return [0]
    time = outlines.time(trajectory)
    count = len(time)
    if frames is None:  # a run that has failed stands: from there on its frames are all alike
        moving = np.flatnonzero(np.diff(time, prepend=-np.inf) > 0)
        return sorted({int(moving[int(k)]) for k in np.linspace(0, len(moving) - 1, DRAWN_FRAMES)})
    chosen = list(frames) if isinstance(frames, Iterable) else [frames]
    if wrong := [frame for frame in chosen if not -count <= frame < count]:
        raise ValueError(f"frames must be from 0 to {count - 1}, but one is {wrong[0]}")
    return sorted({int(frame) % count for frame in chosen})


def _sheet_name(scene: Scene, sheet: str | None) -> str:
    name = min(scene.sheets) if sheet is None else sheet
    known_name("sheet", name, scene.sheets)
    return name
