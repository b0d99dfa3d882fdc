"""Exact changes of a scene and of what a run shows, field by field: shift, turn, mirror, reverse, change units.

Tracks have the fields and units of records, so one table serves inputs and outputs alike.
"""

import re
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from diffeed.base.records import fields, replace
from diffeed.input.parts import Clamp, LineGuide, Load, Motion, Profile, Scene, Sheet
from diffeed.readings.trajectory import GuideTrack, SheetTrack, Trajectory

POINTS = ("lead", "center", "start", "end", "position", "pivot", "nodes")
VECTORS = ("direction", "velocity", "velocities", "displacement", "gravity", "push")
ANGLES = ("heading", "headings", "start_angle")  # absolute ones
HANDED = ("sweep", "rotation", "curl", "rates", "angular_speed", "surface_speed", "spin", "moment", "angle",
          "angular_velocity", "torque")  # fmt: skip

Change = Callable[[Any, str, Any], Any]
Outputs = dict[str, Any]


def outputs(trajectory: Trajectory) -> Outputs:
    """All that the frames of a run show: tracks of each sheet, blocks of rollers and guides."""
    shown: Outputs = {f"sheets.{name}": track for name, track in trajectory.sheets.items()}
    shown |= {"rollers": trajectory.rollers.block} if len(trajectory.rollers) else {}
    return shown | ({"guides": trajectory.guides.block} if len(trajectory.guides) else {})


def map_numbers(record: Any, change: Change) -> Any:
    """A copy of a record (a dictionary of them) with change(owner, field, value) in place of every number."""
    if isinstance(record, dict):
        return {name: map_numbers(value, change) for name, value in record.items()}
    changes = {}
    for f in fields(record):
        value, role = getattr(record, f.name), f.metadata["role"]
        value = np.asarray(value) if isinstance(value, jax.Array) else value
        if value is None or role == "word":
            continue
        if isinstance(value, Profile):
            changes[f.name] = Profile(
                times=change(value, "times", np.asarray(value.times)),
                values=change(record, f.name, np.asarray(value.values)),
            )
        else:
            changes[f.name] = change(record, f.name, value) if role == "number" else map_numbers(value, change)
    return replace(record, **changes)


def _is_vector(owner: Any, name: str) -> bool:
    return name in VECTORS or (isinstance(owner, Load) and name == "force")


def _angle_unit(owner: Any) -> float:
    """Angles are degrees in scenes and radians in tracks."""
    return 1.0 if isinstance(owner, (SheetTrack, GuideTrack)) else 180.0 / np.pi


def shifted(record: Any, by: Any) -> Any:
    """Everything moved by a vector, mm."""
    return map_numbers(
        record, lambda owner, name, v: v + np.broadcast_to(np.asarray(by), v.shape) if name in POINTS else v
    )


def turned(record: Any, angle: float) -> Any:
    """Everything turned about the origin, rad."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.array([[c, s], [-s, c]])

    def change(owner: Any, name: str, value: Any) -> Any:
        if name in POINTS or _is_vector(owner, name):
            return value @ matrix
        return value + _angle_unit(owner) * angle if name in ANGLES else value

    return map_numbers(record, change)


def mirrored(record: Any) -> Any:
    """y -> -y. A line guide bears on its left, so its ends change places."""

    def change(owner: Any, name: str, value: Any) -> Any:
        if isinstance(owner, LineGuide) and name in ("start", "end"):
            value = owner.end if name == "start" else owner.start
        if name in POINTS or _is_vector(owner, name):
            return value * np.array([1.0, -1.0])
        return -value if name in ANGLES + HANDED else value

    return map_numbers(record, change)


def carried(record: Any, velocity: Any, time: Any) -> Any:
    """Everything moves with a constant velocity besides. `time` (frames,): that of tracks; scenes need none."""
    v = np.asarray(velocity)

    def change(owner: Any, name: str, value: Any) -> Any:
        if name in ("velocity", "velocities"):
            return value + np.broadcast_to(v, value.shape)
        if name == "displacement" and not isinstance(owner, Clamp):
            clock = owner.times if isinstance(owner, Motion) else time
            return value + _over(clock, value) * np.broadcast_to(v, value.shape)
        if name in ("nodes", "center") and not isinstance(owner, Scene) and time is not None:
            return value + _over(time, value) * np.broadcast_to(v, value.shape)
        return value

    return map_numbers(record, change)


def _over(time: Any, like: Any) -> Any:
    return np.broadcast_to(np.reshape(time, (-1,) + (1,) * (like.ndim - 1)), like.shape)


def reversed_sheets(scene: Scene) -> Scene:
    """Bars numbered from the other end: lead and tail change places, every heading turns by half a turn."""
    return replace(scene, sheets={name: _reversed_sheet(sheet) for name, sheet in scene.sheets.items()})


def _reversed_sheet(sheet: Sheet) -> Sheet:
    bar = sheet.length / sheet.bars
    angle = np.deg2rad(sheet.headings)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1) * bar
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    tail_velocity = sheet.velocity - np.sum(sheet.rates[:, None] * aside, axis=0)
    return replace(
        sheet, lead=sheet.lead - np.sum(ahead, axis=0), heading=sheet.heading + 180.0, curl=-sheet.curl,
        headings=sheet.headings[::-1] + 180.0, rates=sheet.rates[::-1], velocity=tail_velocity, speed=-sheet.speed,
    )  # fmt: skip


# --- units ------------------------------------------------------------------------------------------------------------

_NEWTON = np.array([1.0, -2.0, 1.0])
_BASE = {
    "mm": (1, 0, 0),
    "s": (0, 1, 0),
    "kg": (0, 0, 1),
    "N": _NEWTON,
    "rad": (0, 0, 0),
    "deg": (0, 0, 0),
    "1": (0, 0, 0),
}


def dimensions(owner: Any, name: str) -> np.ndarray:
    """Exponents of length, time and mass of a field, read from the unit that stands beside it."""
    field = next(f for f in fields(owner) if f.name == name)
    above, _, below = field.metadata["unit"].partition("/")
    return _exponents(owner, above) - (_exponents(owner, below) if below else 0.0)


def _exponents(owner: Any, unit: str) -> np.ndarray:
    total = np.zeros(3)
    for factor in unit.split():
        found = re.fullmatch(r"([A-Za-z]+|1)(\d+)?(?:\^\(?([a-z0-9_+]+)\)?)?", factor)
        assert found, unit
        base, digits, words = found.groups()
        power = sum(float(w) if w.isdigit() else float(getattr(owner, w)) for w in (words or digits or "1").split("+"))
        total = total + power * np.array(_BASE[base], dtype=float)
    return total


def width_exponents(owner: Any, name: str) -> float:
    """Power of the width by which a field grows where only the width is changed: all that carries mass or force,
    but material properties."""
    if isinstance(owner, Sheet):
        return 1.0 if name == "width" else 0.0
    return dimensions(owner, name)[2]


def rescaled(record: Any, factor: Callable[[Any, str], float]) -> Any:
    """Every number times factor(owner, field)."""
    return map_numbers(record, lambda owner, name, value: value * factor(owner, name))


def in_units(record: Any, units: Any) -> Any:
    """A record whose units of length, time and mass are made smaller by these three factors."""
    factors = np.asarray(units)
    return rescaled(record, lambda owner, name: float(np.prod(factors ** dimensions(owner, name))))


# --- comparison -------------------------------------------------------------------------------------------------------

FLOORS = {"mm": 1.0, "mm/s": 1.0, "N": 1e-3, "N mm": 1e-3, "rad": 1e-3, "rad/s": 1e-3}
"""Smallest size of each quantity that counts as one; below it differences are absolute."""


def difference(expected: Outputs, actual: Outputs, skip: tuple[str, ...] = ()) -> float:
    """Largest difference of any field of two runs, relative to the field's own largest value."""
    worst = 0.0
    for key, record in expected.items():
        for f in fields(record):
            if f.name in skip:
                continue
            a, b = (np.asarray(getattr(r, f.name)) for r in (record, actual[key]))
            size = np.max(np.abs(a), where=np.isfinite(a), initial=FLOORS[f.metadata["unit"]])
            same = (a == b) | (np.isnan(a) & np.isnan(b))
            found = np.max(np.where(same, 0.0, np.abs(np.where(same, 0.0, a) - np.where(same, 0.0, b)))) / size
            assert not np.isnan(found), f"{key}.{f.name}"
            worst = max(worst, float(found))
    return worst
