"""How each part of a machine is drawn on paper, and where its name goes."""

from typing import TYPE_CHECKING, Any

import numpy as np

from diffeed.input.parts import Scene
from diffeed.plot_style import COLORS, FAINT, INK, SMALL, STEEL, WIDTH, axes
from diffeed.show import labels, outlines

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEAT = 2.1  # radii from the home of a pinch roller to the seat of its spring
MARKERS = {"pin": "^", "wall": "s", "bar": "D"}


def map_axes(ax: "Axes | None", scene: Scene, trajectory: Any) -> "Axes":
    """Axes with equal scales that show the machine and every place where a sheet has been."""
    low, high = outlines.extent(scene, trajectory)
    shape = (high[1] - low[1]) / max(high[0] - low[0], 1e-9)
    ax = axes(ax, float(np.clip(0.9 * WIDTH * shape + 0.8, 2.0, 9.0)))
    margin = 0.03 * float(np.max(high - low))
    ax.set_xlim(low[0] - margin, high[0] + margin)
    ax.set_ylim(low[1] - margin, high[1] + margin)
    ax.set_aspect("equal", adjustable="box")
    return ax


def draw_parts(ax: "Axes", scene: Scene, trajectory: Any, frame: int, faint: bool = False) -> None:
    """Guides, rollers and sensors at a frame."""
    ink, metal = (FAINT, FAINT) if faint else (INK, STEEL)
    for name in sorted(scene.guides):
        _draw_guide(ax, outlines.guide_at(scene, trajectory, name, frame), ink, metal)
    for name in sorted(scene.rollers):
        center = outlines.center(scene, trajectory, name, frame)
        _draw_roller(ax, scene.rollers[name], center, ink, "none" if faint else "#eef1f4")
        _draw_mark(ax, scene.rollers[name], center, outlines.angle(trajectory, name, frame), ink)
        _draw_spring(ax, scene.rollers[name], center, metal)
        _draw_turning(ax, scene.rollers[name], center, FAINT if faint else COLORS[1])
    for name in sorted(scene.sensors):
        ends = outlines.gate(scene.sensors[name])
        ax.plot(*ends.T, color=FAINT if faint else COLORS[2], linewidth=1.0, linestyle=(0, (4, 2)), zorder=2)


def draw_sheets(ax: "Axes", scene: Scene, trajectory: Any, frames: list[int]) -> None:
    """Every sheet at every frame, darker with time."""
    from matplotlib import colormaps

    shades = colormaps["Blues"](np.linspace(0.45, 1.0, len(frames)))
    for name in sorted(scene.sheets):
        width = max(1.2, float(scene.sheets[name].thickness) * _points_per_mm(ax))
        for shade, frame in zip(shades, frames, strict=True):
            nodes = outlines.nodes(scene, trajectory, name, frame)
            label = None
            if trajectory is not None and name == min(scene.sheets):
                label = f"{'sheet at ' if frame == frames[0] else ''}{outlines.time(trajectory)[frame]:.3g} s"
                label += ": failed" if frame == frames[-1] and not np.all(trajectory.ok) else ""
            ax.plot(*nodes.T, color=shade, linewidth=width, label=label, solid_capstyle="round", zorder=5)


def draw_clamps(ax: "Axes", scene: Scene, trajectory: Any, frame: int) -> None:
    """A triangle for a pin, a square for a wall, a diamond for a held bar."""
    for name in sorted(scene.clamps):
        x, y = outlines.clamp_point(scene, trajectory, name, frame)
        marker = MARKERS[scene.clamps[name].kind]
        ax.plot(x, y, marker=marker, markersize=5, color=COLORS[3], markeredgecolor=INK, zorder=6)


def write_names(ax: "Axes", scene: Scene, trajectory: Any, frames: list[int]) -> None:
    """Write every part's name where it covers least; a thin line leads to a part that is not next to its name."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()  # the layout must be final: names are placed on the page, not in the machine
    ax.apply_aspect()
    scale = 72.0 / figure.get_dpi()
    obstacles = scale * np.vstack([_dense(line, 3.0) for line in _drawn(ax, scene, trajectory, frames)])
    left, bottom, right, top = scale * np.asarray(ax.get_window_extent().extents)
    anchors = _anchors(ax, scene, trajectory, frames[-1])
    wanted = [
        _wanted(name, points * scale, _back(scene, trajectory, section, name, frames[-1]))
        for (section, name), points in anchors.items()
    ]
    for label, spot in zip(wanted, labels.place(wanted, obstacles, (left, bottom, right, top)), strict=True):
        _write_name(ax, label, spot, scale)


def _draw_guide(ax: "Axes", outline: outlines.GuideOutline, ink: str, metal: str) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle

    ax.add_collection(LineCollection(list(outline.ticks), colors=metal, linewidths=0.4, zorder=1))
    ax.plot(*outline.face.T, color=ink, linewidth=1.1, solid_capstyle="butt", zorder=3)
    for x, y, radius in outline.tips:
        ax.add_patch(Circle((x, y), radius, facecolor=metal, edgecolor=ink, linewidth=0.4, zorder=3))


def _draw_roller(ax: "Axes", roller: Any, center: np.ndarray, ink: str, fill: str) -> None:
    from matplotlib.patches import Circle

    middle = (float(center[0]), float(center[1]))
    ax.add_patch(Circle(middle, float(roller.radius), facecolor=fill, edgecolor=ink, linewidth=0.9, zorder=3))


def _draw_mark(ax: "Axes", roller: Any, center: np.ndarray, angle: float, ink: str) -> None:
    """A hub and one spoke that turns with the roller."""
    rim = center + float(roller.radius) * np.array([np.cos(angle), np.sin(angle)])
    ax.plot(*np.array([center, rim]).T, color=ink, linewidth=0.7, zorder=4)
    ax.plot(*center, marker="o", markersize=2, color=ink, zorder=4)


def _draw_turning(ax: "Axes", roller: Any, center: np.ndarray, color: str) -> None:
    """An arc with a head: the direction in which a roller is driven."""
    if not outlines.turning(roller):
        return
    angles = np.deg2rad(90.0 + outlines.turning(roller) * np.linspace(-70.0, 50.0, 40))
    arc = center + 0.62 * float(roller.radius) * np.column_stack([np.cos(angles), np.sin(angles)])
    ax.plot(*arc.T, color=color, linewidth=1.0, zorder=4)
    _draw_head(ax, arc[-1], arc[-1] + (arc[-1] - arc[-4]), color)


def _draw_spring(ax: "Axes", roller: Any, center: np.ndarray, color: str) -> None:
    """A spring from the roller's rim to its seat, and an arrow the way it pushes."""
    direction = outlines.travel_direction(roller)
    if direction is None:
        return
    side, radius = np.array([-direction[1], direction[0]]), float(roller.radius)
    start, seat = center + radius * direction, outlines.vector(roller.center) + SEAT * radius * direction
    along = np.linspace(0.0, 1.0, 12)[:, None]
    swing = np.array([0, 0, 1, -1, 1, -1, 1, -1, 1, -1, 0, 0])[:, None] * 0.22 * radius
    ax.plot(*(start + along * (seat - start) + swing * side).T, color=color, linewidth=0.8, zorder=2)
    ax.plot(*(seat + np.outer([-0.6, 0.6], side) * radius).T, color=color, linewidth=1.6, zorder=2)
    tail = seat + 0.5 * radius * side
    _draw_head(ax, tail, tail - 0.9 * radius * direction, color)


def _draw_head(ax: "Axes", tail: np.ndarray, tip: np.ndarray, color: str) -> None:
    """An arrow of fixed head size."""
    style = {"arrowstyle": "-|>,head_width=0.18,head_length=0.35", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", tuple(tip), tuple(tail), zorder=4, arrowprops=style | {"color": color})


def _write_name(ax: "Axes", label: labels.Label, spot: labels.Place, scale: float) -> None:
    reach = np.maximum(np.abs(spot.center - spot.anchor) - 0.5 * np.array(label.size), 0.0)
    leader = {"arrowstyle": "-", "color": STEEL, "linewidth": 0.4, "shrinkA": 0, "shrinkB": 0}
    x, y = ax.transData.inverted().transform(spot.anchor / scale)
    away = spot.center - spot.anchor
    ax.annotate(
        label.text,
        xy=(x, y),
        xytext=(away[0], away[1]),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=SMALL,
        color=INK,
        zorder=7,
        arrowprops=leader if np.hypot(*reach) > 5.0 else None,
    )


def _wanted(name: str, anchors: np.ndarray, side: tuple[float, float]) -> labels.Label:
    return labels.Label(name, (0.56 * SMALL * len(name) + 2.0, SMALL + 1.5), anchors, side)


def _back(scene: Scene, trajectory: Any, section: str, name: str, frame: int) -> tuple[float, float]:
    """Where a guide has its back to the sheet; zero for other parts."""
    if section != "guides":
        return (0.0, 0.0)
    x, y = np.sum(np.diff(outlines.guide_at(scene, trajectory, name, frame).ticks, axis=1), axis=(0, 1))
    return (float(x), float(y))


def _anchors(ax: "Axes", scene: Scene, trajectory: Any, frame: int) -> dict[tuple[str, str], np.ndarray]:
    """Points of the page beside which the name of a part may stand, by section and name."""
    spots = {}
    for name in sorted(scene.rollers):
        center = outlines.center(scene, trajectory, name, frame)
        spots["rollers", name] = outlines.circle(center, float(scene.rollers[name].radius))[::12]
    for name in sorted(scene.guides):
        face = outlines.guide_at(scene, trajectory, name, frame).face
        spots["guides", name] = face[np.unique(np.linspace(0, len(face) - 1, 9).astype(int))]
    for name in sorted(scene.sensors):
        spots["sensors", name] = outlines.gate(scene.sensors[name])
    for name in sorted(scene.clamps):
        spots["clamps", name] = outlines.clamp_point(scene, trajectory, name, frame)[None]
    return {part: ax.transData.transform(points) for part, points in spots.items()}


def _drawn(ax: "Axes", scene: Scene, trajectory: Any, frames: list[int]) -> list[np.ndarray]:
    """All that names should not cover, as lines on the page."""
    drawn = [outlines.guide_at(scene, trajectory, name, frames[-1]).face for name in scene.guides]
    drawn += [outlines.gate(sensor) for sensor in scene.sensors.values()]
    drawn += [outlines.nodes(scene, trajectory, name, frame) for name in scene.sheets for frame in frames]
    for name, roller in scene.rollers.items():
        center, radius = outlines.center(scene, trajectory, name, frames[-1]), float(roller.radius)
        drawn += [outlines.circle(center, share * radius) for share in (1.0, 0.8, 0.6, 0.4, 0.2)]
        direction = outlines.travel_direction(roller)
        if direction is not None:
            drawn += [outlines.circle(center + share * radius * direction, 0.6 * radius) for share in (1.5, 1.9)]
    return [ax.transData.transform(line) for line in drawn]


def _dense(line: np.ndarray, spacing: float) -> np.ndarray:
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    places = np.arange(0.0, length[-1] + spacing, spacing)
    return np.column_stack([np.interp(places, length, column) for column in line.T])


def _points_per_mm(ax: "Axes") -> float:
    ax.apply_aspect()
    pixels = ax.transData.transform([(0.0, 0.0), (1.0, 0.0)])
    return float(pixels[1, 0] - pixels[0, 0]) * 72.0 / ax.figure.get_dpi()
