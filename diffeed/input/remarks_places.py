"""Parts that are where they hardly do good: a pinch that opens its nip, a guide in a roller, a bend too tight for bars."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from diffeed.input.check_values import number_of, sound
from diffeed.input.parts import ArcGuide, LineGuide, MovableRoller, Scene

COARSE, FINE = 0.5, 0.25
"""Of the radius of an arc that bends a sheet: a longer bar cannot follow it, one of the second length can."""
BEND = 30.0
"""Degrees of an arc that bends a sheet."""
BLADE = 0.5
"""Of a guide's length: two that look away from each other along so much of it are a blade."""
NIP = 3.0
"""mm between two rollers that may be meant as a nip."""
THROUGH = 0.5
"""Of a roller's radius: a guide that comes nearer to its centre runs through it. Nearer the rim it may have a slot for it."""
BESIDE = 0.3
"""Cosine between the travel of a pinch and the way to its partner: less hardly presses."""


def _rollers(scene: Scene) -> Iterator[tuple[str, Any, np.ndarray, float]]:
    """Name, record, centre and radius of those of which both are known."""
    for name, roller in sorted(scene.rollers.items()):
        center, radius = sound(roller, "center"), number_of(roller, "radius")
        if center is not None and radius is not None:
            yield name, roller, center, radius


def bends(path: str, guide: ArcGuide, scene: Scene) -> Iterator[str]:
    """Bars that are too long to lie along an arc."""
    sweep, radius = number_of(guide, "sweep"), number_of(guide, "radius")
    if not sweep or not radius or abs(sweep) < BEND:
        return
    for name, sheet in sorted(scene.sheets.items()):
        length = number_of(sheet, "length")
        if length and length / sheet.bars > COARSE * radius and length > radius * np.deg2rad(abs(sweep)):
            enough = int(np.ceil(length / (FINE * radius)))
            yield (
                f"sheets.{name}.bars is {sheet.bars}: bars of {length / sheet.bars:.3g} mm cannot follow {path}, whose radius is"
                f" {radius:g} mm; with {enough} they can"
            )


def out_of_reach(path: str, roller: MovableRoller, scene: Scene) -> Iterator[str]:
    """A pinch whose stop holds it off every roller that it is near: no sheet is pressed there."""
    center, way, radius = sound(roller, "center"), sound(roller, "direction"), number_of(roller, "radius")
    stop, sheets = number_of(roller, "travel_min"), [number_of(s, "thickness") or 0.0 for s in scene.sheets.values()]
    if center is None or way is None or radius is None or stop is None or not sheets or not np.any(way):
        return
    nearest, gap = "", NIP
    for name, other, place, size in _rollers(scene):
        if other is roller:
            continue
        left = float(np.hypot(*(center + stop * way / np.hypot(*way) - place))) - radius - size
        nearest, gap = (name, left) if left < gap else (nearest, gap)
    if nearest and gap > max(sheets):
        yield (
            f"{path} stops {gap:.3g} mm before rollers.{nearest} (travel_min = {stop:g} mm): no sheet is pressed there, for the"
            f" thickest has {max(sheets):g} mm"
        )


def pinch(path: str, roller: MovableRoller, scene: Scene) -> Iterator[str]:
    center, way, radius = sound(roller, "center"), sound(roller, "direction"), number_of(roller, "radius")
    preload = number_of(roller, "preload")
    if preload and preload < 0:
        yield f"{path}.preload is {preload:g} N, which opens the nip: the spring pushes against `direction` where it is > 0"
        return
    if center is None or way is None or radius is None or not preload:
        return
    for name, other, place, size in _rollers(scene):
        towards = place - center
        if other is roller or np.hypot(*towards) - radius - size >= NIP:
            continue
        share = way @ towards / (np.hypot(*way) * np.hypot(*towards))
        if abs(share) < BESIDE:
            yield f"{path}.direction runs beside rollers.{name}, not towards or away from it: its preload does not close the nip"
        if share > 0.5:
            yield (
                f"{path}.direction points at rollers.{name}, so that its preload opens the nip: the spring pushes against"
                " `direction`"
            )


def through(path: str, guide: LineGuide | ArcGuide, scene: Scene) -> Iterator[str]:
    """A guide that stands still and runs through a roller that does."""
    face = _face(guide)
    if face is None or guide.motion is not None:
        return
    for name, roller, center, radius in _rollers(scene):
        if getattr(roller, "motion", None) is not None:
            continue
        way, away = np.diff(face, axis=0), center - face[:-1]
        share = np.clip(np.sum(away * way, axis=1) / np.sum(way**2, axis=1), 0.0, 1.0)
        nearest = float(np.min(np.hypot(*(away - share[:, None] * way).T)))
        if nearest < THROUGH * radius:
            yield (
                f"{path} runs through rollers.{name}, {nearest:.2g} mm from its centre: a sheet on the guide runs into the"
                " roller; end the guide before it, or move one of them"
            )


def _face(guide: LineGuide | ArcGuide) -> np.ndarray | None:
    """(points, 2) along the face of a guide, None where a number is not known."""
    if isinstance(guide, LineGuide):
        start, end = sound(guide, "start"), sound(guide, "end")
        return None if start is None or end is None or np.all(start == end) else np.stack([start, end])
    center, radius = sound(guide, "center"), number_of(guide, "radius")
    first, sweep = number_of(guide, "start_angle"), number_of(guide, "sweep")
    if center is None or not radius or first is None or not sweep:
        return None
    angle = np.deg2rad(first + sweep * np.linspace(0.0, 1.0, 65))
    return center + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def back_to_back(path: str, guide: LineGuide, scene: Scene) -> Iterator[str]:
    """A blade made of two faces: each feels a sheet behind it up to its depth, so that one may catch what lies on the other."""
    start, end, depth = (sound(guide, f) for f in ("start", "end", "depth"))
    if start is None or end is None or depth is None or not np.any(end - start):
        return
    length = np.hypot(*(end - start))
    way = (end - start) / length
    for name, other in sorted(scene.guides.items()):
        a, b = (sound(other, f) if isinstance(other, LineGuide) else None for f in ("start", "end"))
        if other is guide or a is None or b is None:
            continue
        away = np.stack([a, b]) - start
        along, behind = away @ way, away @ np.array([way[1], -way[0]])
        beside = min(along.max(), length) - max(along.min(), 0.0)
        # Turned about, it looks to the other side.
        if beside > BLADE * (along[0] - along[1]) > 0.0 and behind.min() >= 0.0 and behind.max() < depth:
            yield (
                f"{path} and guides.{name} are back to back, {behind.min():.3g} mm apart, which is less than {path}.depth, "
                f"{float(depth):g} mm: it catches a sheet that lies on the other; give both a depth of less than half of that"
            )
