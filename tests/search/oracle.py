"""What no run that holds may show, told from its frames by plain NumPy: nothing of the simulator's own checks is used."""

from typing import Any

import numpy as np

from diffeed import ArcGuide, CircleGuide, LineGuide, Scene
from diffeed.readings.trajectory import Trajectory

DEEPEST, SHALLOWEST, BEHIND = 3.0, 0.25, 1.0
SLACK = 1.6
"""Times what is allowed: the last frame is one step ahead of what a run looks at."""
STRETCH = 1e-6
"""Of a bar's length, by which joints may gape in the frames (rounding of long coordinates)."""


def complaints(scene: Scene, run: Trajectory) -> list[str]:
    """Everything wrong with one run that says it holds; both with plain arrays."""
    found = _not_finite(run)
    if found:
        return found
    for name, track in sorted(run.sheets.items()):
        sheet = scene.sheets[name]
        found += _gaping(name, sheet, track.nodes)
        for part, body in sorted(scene.guides.items()):
            if isinstance(body, LineGuide | ArcGuide) and body.motion is None:
                found += across(part, body, track.nodes)
            elif isinstance(body, CircleGuide) and body.motion is None:
                found += _inside(
                    part, np.broadcast_to(body.center, (len(run.time), 2)), float(body.radius), track.nodes
                )
        for part, body in sorted(scene.rollers.items()):
            found += _inside(part, np.asarray(run.rollers[part].center), float(body.radius), track.nodes)
    return found


def _not_finite(run: Trajectory) -> list[str]:
    for section in ("sheets", "rollers", "guides"):
        for name, track in getattr(run, section).items():
            for field in track.__dataclass_fields__:
                if field != "gap" and not np.isfinite(getattr(track, field)).all():
                    return [f"{section}.{name}.{field} is not finite"]
    return []


def _gaping(name: str, sheet: Any, nodes: np.ndarray) -> list[str]:
    bar = float(sheet.length) / sheet.bars
    long = np.linalg.norm(np.diff(nodes, axis=1), axis=2)
    worst = np.abs(long / bar - 1.0).max()
    return [f"a bar of {name} changed its length by {worst:.1e}"] if worst > STRETCH else []


def _inside(part: str, centers: np.ndarray, radius: float, nodes: np.ndarray) -> list[str]:
    """Distance of every bar (a segment) to the circle's centre, frame by frame."""
    a, b = nodes[:, :-1], nodes[:, 1:]
    along = b - a
    share = np.clip(np.sum((centers[:, None] - a) * along, axis=2) / np.sum(along**2, axis=2), 0.0, 1.0)
    depth = radius - np.linalg.norm(a + share[..., None] * along - centers[:, None], axis=2).min()
    allowed = SLACK * max(min(DEEPEST, 0.5 * radius), SHALLOWEST)
    return [f"the sheet is {depth:.3g} mm deep in {part}"] if depth > allowed else []


def across(part: str, guide: Any, nodes: np.ndarray) -> list[str]:
    """A bar whose ends lie on both sides of the face, one of them behind its depth, and which meets the face."""
    height = _height(guide, nodes)
    a, b = height[:, :-1], height[:, 1:]
    front, rear = nodes[:, :-1], nodes[:, 1:]
    for _ in range(60):  # halved until the face is met
        meets = 0.5 * (front + rear)
        near = (_height(guide, meets) * a > 0)[..., None]
        front, rear = np.where(near, meets, front), np.where(near, rear, meets)
    through = (a * b < 0) & (np.minimum(a, b) < -BEHIND * float(guide.depth)) & _on_face(guide, meets)
    return [f"a bar lies across {part} in frame {int(np.argwhere(through)[0, 0])}"] if through.any() else []


def _height(guide: Any, points: np.ndarray) -> np.ndarray:
    if isinstance(guide, LineGuide):
        way = np.asarray(guide.end) - np.asarray(guide.start)
        tangent = way / np.linalg.norm(way)
        dx, dy = np.moveaxis(points - np.asarray(guide.start), -1, 0)
        return dy * tangent[0] - dx * tangent[1]
    side = 1.0 if guide.side == "inside" else -1.0
    return side * (float(guide.radius) - np.linalg.norm(points - np.asarray(guide.center), axis=-1))


def _on_face(guide: Any, points: np.ndarray) -> np.ndarray:
    if isinstance(guide, LineGuide):
        way = np.asarray(guide.end) - np.asarray(guide.start)
        along = (points - np.asarray(guide.start)) @ way / (way @ way)
        return (along > 0.0) & (along < 1.0)
    dx, dy = np.moveaxis(points - np.asarray(guide.center), -1, 0)
    turned = (np.rad2deg(np.arctan2(dy, dx)) - float(guide.start_angle)) * np.sign(float(guide.sweep))
    return np.mod(turned, 360.0) < abs(float(guide.sweep))
