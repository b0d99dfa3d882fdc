"""A scene as plain numpy points and lines, for the pictures and the player. Units: mm, rad."""

import dataclasses
from typing import Any

import numpy as np

from diffeed.input.parts import ArcGuide, CircleGuide, LineGuide, Motion, MovableRoller, Profile, Scene, Sheet
from diffeed.model.guides import JOIN_TOLERANCE

POINTS_PER_TURN = 180
TICK_SPACING = 4.0  # mm between the ticks behind a bearing face


@dataclasses.dataclass(frozen=True)
class GuideOutline:
    """A guide at its home position: the bearing face, ticks on the side that bears nothing, tips (x, y, radius)."""

    face: np.ndarray  # (points, 2)
    ticks: np.ndarray  # (ticks, 2, 2): from the face to `depth` behind it
    tips: np.ndarray  # (tips, 3)


def vector(value: Any) -> np.ndarray:
    """A leaf of a scene as numpy numbers."""
    return np.asarray(value, dtype=float)


def turning(roller: Any) -> int:
    """1: driven counter-clockwise, -1: driven clockwise, 0: idle."""
    speed = roller.angular_speed if roller.angular_speed is not None else roller.surface_speed
    if speed is None:
        return 0
    values = np.atleast_1d(vector(speed.values if isinstance(speed, Profile) else speed))
    return int(np.sign(values[np.argmax(np.abs(values))]))


def travel_direction(roller: Any) -> np.ndarray | None:
    """Unit vector along which a movable roller travels; None for a fixed one."""
    if not isinstance(roller, MovableRoller):
        return None
    direction = vector(roller.direction)
    return direction / np.hypot(*direction)


def circle(center: Any, radius: float) -> np.ndarray:
    """Points of a closed circle."""
    return _arc(vector(center), radius, 0.0, 2.0 * np.pi)


def moved(points: np.ndarray, displacement: Any, rotation: Any, pivot: Any) -> np.ndarray:
    """Points of a rigid part turned by `rotation` (rad) about `pivot`, then shifted."""
    c, s = np.cos(float(rotation)), np.sin(float(rotation))
    return (points - vector(pivot)) @ np.array([[c, s], [-s, c]]) + vector(pivot) + vector(displacement)


def pivot(part: Any) -> np.ndarray:
    """The point about which a part turns; the origin for one that does not."""
    return np.zeros(2) if part.motion is None else vector(part.motion.pivot)


def guide(scene: Scene, name: str) -> GuideOutline:
    """The outline of one guide at its home position."""
    part = scene.guides[name]
    if isinstance(part, CircleGuide):
        return _circle_guide(part)
    face, normals = _line_face(part) if isinstance(part, LineGuide) else _arc_face(part)
    free = [] if _is_closed(part) else [end for end in (0, -1) if not _is_joined(scene, name, face[end])]
    tips = [_tip(part, face[end], normals[end]) for end in free]
    keep = np.array(tips).reshape(-1, 3)
    return GuideOutline(face, _ticks(face, normals, float(part.depth)), keep[keep[:, 2] > 0.0])


def guide_at(scene: Scene, trajectory: Any, name: str, frame: int) -> GuideOutline:
    """The outline of one guide at a frame; at its home position without a trajectory."""
    home = guide(scene, name)
    if trajectory is None:
        return home
    track = trajectory.guides[name]
    pose = (vector(track.displacement)[frame], vector(track.rotation)[frame], pivot(scene.guides[name]))
    tips = np.column_stack([moved(home.tips[:, :2], *pose), home.tips[:, 2]])
    return GuideOutline(moved(home.face, *pose), moved(home.ticks, *pose), tips)


def initial_nodes(sheet: Sheet) -> np.ndarray:
    """Nodes (bars + 1, 2) of a sheet as its record places it, leading edge first."""
    degrees = np.full(sheet.bars, float(sheet.heading)) if sheet.headings is None else vector(sheet.headings)
    angles = np.deg2rad(degrees)
    steps = np.column_stack([np.cos(angles), np.sin(angles)]) * float(sheet.length) / sheet.bars
    return vector(sheet.lead) - np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])


def curvature(headings: np.ndarray, bar_length: float) -> np.ndarray:
    """Curvature (..., bars) in 1/mm, positive to the left along the travel: the mean of a bar's two joints."""
    joints = (headings[..., :-1] - headings[..., 1:]) / bar_length
    if joints.shape[-1] == 0:
        return np.zeros_like(headings)
    return 0.5 * (np.concatenate([joints[..., :1], joints], -1) + np.concatenate([joints, joints[..., -1:]], -1))


def time(trajectory: Any) -> np.ndarray:
    """Times (frames,) of a run, s."""
    return vector(trajectory.time)


def nodes(scene: Scene, trajectory: Any, name: str, frame: int) -> np.ndarray:
    """Nodes (bars + 1, 2) of a sheet at a frame; as its record places it without a trajectory."""
    if trajectory is None:
        return initial_nodes(scene.sheets[name])
    return vector(trajectory.sheets[name].nodes)[frame]


def center(scene: Scene, trajectory: Any, name: str, frame: int) -> np.ndarray:
    """Centre of a roller at a frame, or at its home position."""
    return vector(scene.rollers[name].center if trajectory is None else trajectory.rollers[name].center[frame])


def angle(trajectory: Any, name: str, frame: int) -> float:
    """Angle of a roller at a frame, rad."""
    return 0.0 if trajectory is None else float(trajectory.rollers[name].angle[frame])


def clamp_node(scene: Scene, name: str) -> int:
    """The number of the node that a clamp holds (the first one of a bar that it holds)."""
    clamp = scene.clamps[name]
    bars = scene.sheets[clamp.sheet].bars
    last = bars - 1 if clamp.kind == "bar" else bars
    return {"lead": 0, "tail": last}[clamp.at] if isinstance(clamp.at, str) else int(clamp.at)


def clamp_point(scene: Scene, trajectory: Any, name: str, frame: int) -> np.ndarray:
    """Where a clamp holds its sheet at a frame."""
    return nodes(scene, trajectory, scene.clamps[name].sheet, frame)[clamp_node(scene, name)]


def extent(scene: Scene, trajectory: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the machine and of every place where a sheet has been."""
    points = [guide(scene, name).face for name in scene.guides]
    points += [gate(sensor) for sensor in scene.sensors.values()]
    points += [initial_nodes(sheet) for sheet in scene.sheets.values()]
    for roller in scene.rollers.values():
        direction = travel_direction(roller)
        ring = circle(roller.center, float(roller.radius))
        points += [ring] if direction is None else [ring, ring + 1.3 * float(roller.radius) * direction]
    if trajectory is not None:
        points += [vector(track.nodes).reshape(-1, 2) for track in trajectory.sheets.values()]
    cloud = np.vstack(points)
    return np.nanmin(cloud, axis=0), np.nanmax(cloud, axis=0)


def top(values: np.ndarray, share: float = 99.5) -> float:
    """An upper limit for a scale that a single peak does not spoil: all but the rest of `share` % lie below."""
    finite = values[np.isfinite(values)]
    return max(float(np.percentile(finite, share)), 1e-12) if finite.size else 1.0


def gate(sensor: Any) -> np.ndarray:
    """The two ends of a sensor's line across the path."""
    direction = vector(sensor.direction)
    across = np.array([-direction[1], direction[0]]) / np.hypot(*direction) * float(sensor.range)
    return vector(sensor.position) + np.array([[-1.0], [1.0]]) * across


def _arc(center: np.ndarray, radius: float, start: float, sweep: float) -> np.ndarray:
    count = max(2, int(np.ceil(abs(sweep) / (2.0 * np.pi) * POINTS_PER_TURN)) + 1)
    angles = start + np.linspace(0.0, sweep, count)
    return center + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def _line_face(part: LineGuide) -> tuple[np.ndarray, np.ndarray]:
    start, end = vector(part.start), vector(part.end)
    count = max(2, int(np.hypot(*(end - start)) / TICK_SPACING) + 1)
    along = (end - start) / np.hypot(*(end - start))
    face = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
    return face, np.tile([-along[1], along[0]], (count, 1))


def _arc_face(part: ArcGuide) -> tuple[np.ndarray, np.ndarray]:
    face = _arc(vector(part.center), float(part.radius), *np.deg2rad([float(part.start_angle), float(part.sweep)]))
    outward = (face - vector(part.center)) / float(part.radius)
    return face, outward if part.side == "outside" else -outward


def _circle_guide(part: CircleGuide) -> GuideOutline:
    face = circle(part.center, float(part.radius))
    inward = (vector(part.center) - face) / float(part.radius)
    return GuideOutline(face, _ticks(face, -inward, 0.3 * float(part.radius)), np.zeros((0, 3)))


def _tip(part: Any, end: np.ndarray, normal: np.ndarray) -> np.ndarray:
    radius = float(part.tip_radius)
    return np.append(end - radius * normal, radius)


def _is_closed(part: Any) -> bool:
    """Whether an arc goes all around: it has no ends then."""
    return (
        isinstance(part, ArcGuide) and abs(float(np.deg2rad(part.sweep))) > 2.0 * np.pi - JOIN_TOLERANCE / part.radius
    )


def _ends(part: Any) -> list[np.ndarray]:
    if isinstance(part, CircleGuide) or _is_closed(part):
        return []
    face = _line_face(part)[0] if isinstance(part, LineGuide) else _arc_face(part)[0]
    return [face[0], face[-1]]


def _is_joined(scene: Scene, name: str, end: np.ndarray) -> bool:
    """Whether an end is also that of another guide that moves alike, as the model has it."""
    motion = scene.guides[name].motion
    others = [p for other, p in scene.guides.items() if other != name and _same(p.motion, motion)]
    return any(np.hypot(*(point - end)) < JOIN_TOLERANCE for part in others for point in _ends(part))


def _same(a: Motion | None, b: Motion | None) -> bool:
    if a is None or b is None:
        return a is b
    return all(np.array_equal(vector(getattr(a, f)), vector(getattr(b, f))) for f in Motion.__dataclass_fields__)


def _ticks(face: np.ndarray, normals: np.ndarray, depth: float) -> np.ndarray:
    """Strokes behind the face at 45 degrees, every TICK_SPACING along it."""
    along = np.column_stack([normals[:, 1], -normals[:, 0]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(face, axis=0).T))])
    places = np.arange(0.5 * TICK_SPACING, length[-1], TICK_SPACING)
    roots, lean = _along(places, length, face), _along(places, length, -normals - along)
    return np.stack([roots, roots + 0.5 * depth * lean], axis=1)


def _along(places: np.ndarray, length: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(places, length, column) for column in rows.T])
