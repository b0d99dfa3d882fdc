"""What the fields of one record must satisfy together, and with the rest of the scene: one small rule each.

A rule speaks only where the fields it reads are right in themselves, so that one mistake gives one sentence.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from diffeed.base.limits import MAX_BARS, MAX_PAIRS, MAX_PARTS, MAX_POINTS, rest_problem
from diffeed.base.names import hint
from diffeed.base.records import fields
from diffeed.input.check_values import measure, show, sound
from diffeed.input.parts import (
    SECTIONS,
    ArcGuide,
    CircleGuide,
    Clamp,
    Contact,
    FixedRoller,
    LineGuide,
    Load,
    Motion,
    MovableRoller,
    Profile,
    Scene,
    Sensor,
    Sheet,
)

Rule = Callable[[str, Any, Scene], Iterator[str]]
SHORT = 2.0
"""mm: a sheet that is shorter than this may be given in metres."""


def names(scene: Scene, section: str) -> list[str]:
    """Names in a section of a scene, whatever the section may be."""
    parts = getattr(scene, section)
    return [n for n in parts if isinstance(n, str)] if isinstance(parts, dict) else []


def bars_of(sheet: Sheet) -> int | None:
    """The number of bars, if it is one that can be used."""
    right = isinstance(sheet.bars, (int, np.integer)) and not isinstance(sheet.bars, bool)
    return int(sheet.bars) if right and 1 <= sheet.bars <= MAX_BARS else None


def size_problems(scene: Scene) -> Iterator[str]:
    """Of a scene that is too large to be looked at part by part."""
    parts = _count(scene, SECTIONS)
    if parts > MAX_PARTS:
        yield f"a scene must have at most {MAX_PARTS} parts, but has {parts}"
    sheets = scene.sheets.values() if isinstance(scene.sheets, dict) else ()
    bars = sum(bars_of(s) or 0 for s in sheets if isinstance(s, Sheet))
    if len(sheets) > 1 and bars > MAX_BARS:
        yield f"sheets must have at most {MAX_BARS} bars together, but have {bars}"
    bodies = _count(scene, ("rollers", "guides"))
    if bars * bodies > MAX_PAIRS:
        yield f"bars times rollers and guides must be at most {MAX_PAIRS}, but {bars} x {bodies} are {bars * bodies}"
    elif isinstance(scene.initial, str) and scene.initial == "settled" and (problem := rest_problem(bars, bodies)):
        yield problem


def stack_problems(scene: Scene) -> Iterator[str]:
    """Of what `stack` made: every number of it would be one."""
    found = measure(scene.gravity)
    if found is not None and len(found.shape) == 2:
        yield f"this is a stack of {found.shape[0]} scenes, not one scene: jax.vmap takes it (of a function of one scene)"


def _count(scene: Scene, sections: Iterable[str]) -> int:
    found = (getattr(scene, s) for s in sections)
    return sum(len(parts) for parts in found if isinstance(parts, dict))


def _duration(path: str, scene: Scene, _: Scene) -> Iterator[str]:
    found = measure(scene.duration)
    if found is None or found.shape or found.entries is None:
        return
    if not 0 < float(found.entries) < np.inf:
        yield f"duration must be finite and > 0 s, but is {show(scene.duration)}"


def _some_sheet(path: str, scene: Scene, _: Scene) -> Iterator[str]:
    if isinstance(scene.sheets, dict) and not scene.sheets:
        yield "sheets must hold at least one sheet, but is empty"


def _goal(path: str, scene: Scene, _: Scene) -> Iterator[str]:
    known = names(scene, "sensors")
    if isinstance(scene.goal, str) and scene.goal and scene.goal not in known:
        yield f"goal must be the name of a sensor, but is {show(scene.goal)}{hint(scene.goal, known)}"


def _bar_count(path: str, sheet: Sheet, _: Scene) -> Iterator[str]:
    right = isinstance(sheet.bars, (int, np.integer)) and not isinstance(sheet.bars, bool)
    if right and bars_of(sheet) is None:
        yield f"{path}.bars must be from 1 to {MAX_BARS}, but is {show(sheet.bars)}"


def _bar_length(path: str, sheet: Sheet, _: Scene) -> Iterator[str]:
    length, thickness, bars = sound(sheet, "length"), sound(sheet, "thickness"), bars_of(sheet)
    if length is None or thickness is None or bars is None or thickness <= length / bars:
        return
    bar = float(length) / bars
    wanted = f"<= the length of a bar ({bar:.6g} mm: length / bars)"
    yield (
        f"{path}.thickness must be {wanted}, but is {show(sheet.thickness)}"
        + f"; is {path}.length, {length:g} mm, in m?" * bool(length < SHORT)
    )


def _two_speeds(path: str, roller: Any, _: Scene) -> Iterator[str]:
    if roller.angular_speed is not None and roller.surface_speed is not None:
        yield f"{path} must have one of angular_speed and surface_speed, but has both"


def _direction(path: str, part: Any, _: Scene) -> Iterator[str]:
    direction = sound(part, "direction")
    if direction is not None and not direction.any():
        yield f"{path}.direction must not be zero, but is {show(part.direction)}"


def _stops(path: str, roller: MovableRoller, _: Scene) -> Iterator[str]:
    low, high = sound(roller, "travel_min"), sound(roller, "travel_max")
    if low is not None and high is not None and low > high:
        yield f"{path}.travel_min must be <= travel_max ({show(roller.travel_max)}), but is {show(roller.travel_min)}"


def _line_length(path: str, guide: LineGuide, _: Scene) -> Iterator[str]:
    start, end = sound(guide, "start"), sound(guide, "end")
    if start is not None and end is not None and (start == end).all():
        yield f"{path}.end must differ from start, but both are {show(guide.end)}"


def _sweep(path: str, guide: ArcGuide, _: Scene) -> Iterator[str]:
    sweep = sound(guide, "sweep")
    if sweep is not None and (sweep == 0 or abs(sweep) > 360):
        yield f"{path}.sweep must be from -360 to 360 deg and not 0, but is {show(guide.sweep)}"


def _smoothing(path: str, contact: Contact, _: Scene) -> Iterator[str]:
    smoothing, exponent = sound(contact, "smoothing"), sound(contact, "exponent")
    if smoothing is not None and exponent is not None and smoothing == 0 and exponent <= 1:
        yield f"{path}.smoothing must be > 0 mm unless exponent > 1, but is {show(contact.smoothing)}"


def _contact_set(path: str, part: Any, scene: Scene) -> Iterator[str]:
    known = {"default", *names(scene, "contacts")}
    if isinstance(part.contact, str) and part.contact not in known:
        wrong = f"{show(part.contact)}{hint(part.contact, known)}"
        yield f"{path}.contact must be the name of a contact set, but is {wrong}"


def _sheet_name(path: str, part: Any, scene: Scene) -> Iterator[str]:
    known = names(scene, "sheets")
    if isinstance(part.sheet, str) and part.sheet not in known:
        yield f"{path}.sheet must be the name of a sheet, but is {show(part.sheet)}{hint(part.sheet, known)}"


def _at(path: str, part: Any, scene: Scene) -> Iterator[str]:
    if isinstance(part.at, str) and part.at in ("lead", "tail"):
        return
    bar = isinstance(part, Clamp) and isinstance(part.kind, str) and part.kind == "bar"
    wanted = f'"lead", "tail" or the number of a {"bar" if bar else "node"}'
    if isinstance(part.at, bool) or not isinstance(part.at, (int, np.integer)):
        yield f"{path}.at must be {wanted}, but is {show(part.at)}"
        return
    sheets = scene.sheets if isinstance(scene.sheets, dict) else {}
    sheet = sheets.get(part.sheet) if isinstance(part.sheet, str) else None
    bars = bars_of(sheet) if isinstance(sheet, Sheet) else None
    last = None if bars is None else bars - bar
    if part.at < 0 or (last is not None and part.at > last):
        yield f"{path}.at must be {wanted} (0 to {'the last' if last is None else last}), but is {show(part.at)}"
    elif last is not None and 0 < part.at < last and isinstance(part, Clamp) and part.kind == "wall":
        yield f'{path}.at must be "lead" or "tail" with kind "wall", but is {show(part.at)}: kind "bar" holds a sheet within'


def _increasing(path: str, series: Any, _: Scene) -> Iterator[str]:
    times = sound(series, "times")
    if times is None:
        return
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if wrong.size:
        i = int(wrong[0])
        yield f"{path}.times must increase, but {float(times[i + 1])!r} follows {float(times[i])!r}"


def _equal_lengths(path: str, series: Any, _: Scene) -> Iterator[str]:
    times = measure(series.times)
    if times is None or len(times.shape) != 1 or not times.shape[0]:
        return
    n = times.shape[0]
    for f in fields(series):
        found = measure(getattr(series, f.name))
        if f.metadata["shape"][0] != "points" or found is None or len(found.shape) != len(f.metadata["shape"]):
            continue
        if found.shape[0] not in (0, n):
            yield f"{path}.{f.name} must have one entry for each of the {n} times, but has {found.shape[0]}"


def _not_too_many(path: str, series: Any, _: Scene) -> Iterator[str]:
    count = len(series.times) if isinstance(series.times, (list, tuple)) else np.size(series.times)
    if count > MAX_POINTS:
        yield f"{path}.times must have at most {MAX_POINTS} entries, but has {count}"


_SERIES: tuple[Rule, ...] = (_increasing, _equal_lengths, _not_too_many)
RULES: dict[type, tuple[Rule, ...]] = {
    Scene: (_some_sheet, _duration, _goal),
    Sheet: (_bar_count, _bar_length),
    FixedRoller: (_two_speeds, _contact_set),
    MovableRoller: (_two_speeds, _direction, _stops, _contact_set),
    LineGuide: (_line_length, _contact_set),
    ArcGuide: (_sweep, _contact_set),
    CircleGuide: (_contact_set,),
    Contact: (_smoothing,),
    Clamp: (_sheet_name, _at),
    Load: (_sheet_name, _at),
    Sensor: (_direction,),
    Profile: _SERIES,
    Motion: _SERIES,
}
