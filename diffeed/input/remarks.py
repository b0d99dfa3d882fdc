"""What is sound in itself but hardly meant: a number in another unit, a pinch that opens its nip. Said, never refused."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from diffeed.base.records import fields
from diffeed.input.check_records import check_records
from diffeed.input.check_rules import Rule
from diffeed.input.check_values import sound
from diffeed.input.parts import (
    ArcGuide,
    CircleGuide,
    Contact,
    FixedRoller,
    LineGuide,
    Motion,
    MovableRoller,
    Profile,
    Scene,
    Sheet,
)
from diffeed.pair.law import NEWTON
from diffeed.pair.rebound import Rebound, rebound

STIFFEST, LIMPEST = 5e5, 5.0
"""N/mm2: harder than any steel, and softer than rubber."""
LIGHTEST, HEAVIEST = 5e-9, 3e-5
"""kg/mm3: a hundredth of paper, and more than any metal."""
THINNEST, THICKEST = 2e-3, 10.0
"""mm."""
BLADE = 0.5
"""Of a guide's length: two that look away from each other along so much of it are a blade."""
SLOWEST = 5.0
"""mm/s: a drive that never turns faster than this."""
GRAVITY = (9.0, 10.5)
"""m/s2, given as mm/s2."""
NIP = 3.0
"""mm between two rollers that may be meant as a nip."""
TURNED = 1.6
"""Degrees: a movement that turns a part by less may be meant in radians."""
ASIDE = 2.0
"""Times its own size: a part that swings about an origin further away than that may lack its pivot."""
STUB = 3.0
"""mm of an arc: hardly a guide."""
CURLED = 3.0
"""mm: a smaller radius of curl is hardly meant."""
BESIDE = 0.3
"""Cosine between the travel of a pinch and the way to its partner: less hardly presses."""
BULKY, ROUGH, STUBBORN = 5.0, 3.0, 1e5
"""kg of a roller, its friction, N/mm of a contact: more is hardly meant."""
HIT, LIVELY = 100.0, 0.9
"""mm/s at which a contact is hit, and share of it that is thrown back: paper falls dead on sheet metal, rubber bounces more."""
COURSES = ("displacement", "rotation", "values")
"""What a motion or a profile says for each of its times."""
LATER = 10.0
"""Times the duration at which a profile ends: it is hardly meant for this run."""
BEYOND_USE = 100.0
"""Times the way through the machine that is fed in a run."""


def remarks(scene: Scene) -> list[str]:
    """Sentences on what a sound scene holds that is unusual enough to be a mistake; empty for most, and for an unsound one.

    Each names part, field and value, and what is usual. `diffeed check` and `diffeed run` show them and go on.
    """
    if check_records(scene):
        return []
    found = list(_of_scene(scene))
    for section in ("sheets", "rollers", "guides", "contacts"):
        for name, part in sorted(getattr(scene, section).items()):
            for rule in _RULES.get(type(part), ()):
                found += rule(f"{section}.{name}", part, scene)
    return found


def _number(part: Any, field: str) -> float | None:
    value = sound(part, field)
    return float(value) if value is not None and np.ndim(value) == 0 else None


def _of_scene(scene: Scene) -> Iterator[str]:
    gravity = sound(scene, "gravity")
    if gravity is not None and GRAVITY[0] < float(np.hypot(*gravity)) < GRAVITY[1]:
        yield f"gravity is {np.hypot(*gravity):g} mm/s2: in m/s2? That of the earth is 9810 mm/s2"
    duration, fastest = scene.duration, max((_fastest(r) or 0.0 for r in scene.rollers.values()), default=0.0)
    places, lengths = _places(scene), [_number(s, "length") or 0.0 for s in scene.sheets.values()]
    way = sum(lengths) + (float(np.ptp(np.array(places), axis=0).sum()) if places else 0.0)
    if duration * fastest > BEYOND_USE * way > 0:
        yield (
            f"duration is {duration:g} s, in which the drives feed {duration * fastest:.3g} mm: many times the way through the"
            " machine"
        )


def _places(scene: Scene) -> list[Any]:
    return [place for part in (*scene.rollers.values(), *scene.guides.values()) for place in _points(part)]


def _points(part: Any) -> list[Any]:
    """The centre of a part, or its two ends."""
    fields = [f for f in ("center", "start", "end") if getattr(part, f, None) is not None]
    return [value for f in fields if (value := sound(part, f)) is not None]


def _sheet(path: str, sheet: Sheet, _: Scene) -> Iterator[str]:
    modulus, density, thickness = (_number(sheet, f) for f in ("youngs_modulus", "density", "thickness"))
    if modulus and modulus > STIFFEST:
        yield f"{path}.youngs_modulus is {modulus:g} N/mm2: in Pa? Steel has 2.1e5 N/mm2, paper 2000 to 8000"
    if modulus and modulus < LIMPEST:
        yield f"{path}.youngs_modulus is {modulus:g} N/mm2: in GPa? Rubber has 1 to 10 N/mm2, paper 2000 to 8000"
    if density and not LIGHTEST < density < HEAVIEST:
        yield f"{path}.density is {density:g} kg/mm3: in other units? Paper has 8e-7 kg/mm3 (800 kg/m3)"
    if thickness and not THINNEST < thickness < THICKEST:
        yield f"{path}.thickness is {thickness:g} mm: in other units? Copy paper has 0.1 mm"
    curl = _number(sheet, "curl")
    if curl and abs(curl) * CURLED > 1.0:
        yield f"{path}.curl is {curl:g} 1/mm, a radius of {1.0 / abs(curl):.2g} mm: is it the radius? A curl of 50 mm is 0.02"


def _arc(path: str, guide: ArcGuide, _: Scene) -> Iterator[str]:
    sweep, radius = _number(guide, "sweep"), _number(guide, "radius")
    if sweep and radius and abs(sweep) <= 2.0 * np.pi and radius * np.deg2rad(abs(sweep)) < STUB:
        yield f"{path}.sweep is {sweep:g} degrees: in radians? A quarter turn is 90"


def _in_the_run(path: str, part: Motion | Profile, scene: Scene) -> Iterator[str]:
    times = sound(part, "times")
    if times is None:
        return
    if float(times[-1]) > LATER * scene.duration:
        yield f"{path}.times end at {float(times[-1]):g} s, but the run at {scene.duration:g} s: in ms?"
        return
    courses = (sound(part, f.name) for f in fields(part) if f.name in COURSES)
    changes = (np.diff(v, axis=0).reshape(len(times) - 1, v[0].size).any(axis=1) for v in courses if v is not None)
    first = min((float(time) for changed in changes for time in times[:-1][changed]), default=0.0)
    if first >= scene.duration:
        yield f"{path} changes nothing before {first:g} s, but the run ends at {scene.duration:g} s"


def _moved(path: str, part: Any, scene: Scene) -> Iterator[str]:
    if part.motion is None:
        return
    yield from _in_the_run(f"{path}.motion", part.motion, scene)
    turn = sound(part.motion, "rotation")
    furthest = 0.0 if turn is None else float(np.max(np.abs(turn)))
    if 0.0 < furthest < TURNED:
        yield f"{path}.motion.rotation is {furthest:g} degrees at most: in radians? A quarter turn is 90"
    pivot, points = sound(part.motion, "pivot"), _points(part)
    if not furthest or pivot is None or np.any(pivot) or not points:
        return
    radius = _number(part, "radius") or 0.0 if hasattr(part, "radius") else 0.0
    away = min(float(np.hypot(*point)) for point in points) - radius
    size = float(np.hypot(*np.ptp(points, axis=0))) + 2.0 * radius
    if away > ASIDE * size:
        yield f"{path}.motion.pivot is (0, 0), {away:.3g} mm from the part: was it forgotten? The part swings about it"


def _fastest(roller: Any) -> float | None:
    """mm/s of its surface, None if it idles or that is not known."""
    for field, lever in (("surface_speed", 1.0), ("angular_speed", _number(roller, "radius"))):
        speed = getattr(roller, field)
        values = sound(speed, "values") if isinstance(speed, Profile) else sound(roller, field)
        if values is not None and lever:
            return float(np.max(np.abs(values)) * lever)
    return None


def _drive(path: str, roller: Any, scene: Scene) -> Iterator[str]:
    fastest, friction = _fastest(roller), _number(roller, "friction")
    if friction and friction > ROUGH:
        yield f"{path}.friction is {friction:g}: in percent? Rubber on paper has 0.8 to 1.5"
    for field in ("surface_speed", "angular_speed"):
        if isinstance(profile := getattr(roller, field), Profile):
            yield from _in_the_run(f"{path}.{field}", profile, scene)
    if fastest and fastest < SLOWEST:
        yield f"{path} turns at {fastest:g} mm/s at most: in m/s? Feeders run at 100 to 3000 mm/s"


def _contact(path: str, contact: Contact, scene: Scene) -> Iterator[str]:
    stiffness = _number(contact, "stiffness")
    if stiffness and stiffness > STUBBORN:
        yield f"{path}.stiffness is {stiffness:g}: in N/m? Rubber has 10 to 1000 N/mm, hard plastic 1e4"
        return
    if thrown := _thrown_back(contact, scene):
        given = f"{path}.damping is {contact.damping:g}" if contact.damped else f"{path}.damped is false"
        yield (
            f"{given}: what hits it at {HIT:g} mm/s is thrown back with {thrown.share:.2g} of its speed within"
            f" {thrown.seconds:.1g} s, which longer steps take away: they may fail by that; real surfaces are damped"
        )


def _thrown_back(contact: Contact, scene: Scene) -> Rebound | None:
    """What becomes of the lightest node, None if it loses more than a tenth or a number is not known."""
    law = [_number(contact, f) for f in ("stiffness", "exponent", "damping", "damping_exponent")]
    masses = [mass for sheet in scene.sheets.values() if (mass := _mass_of_a_node(sheet))]
    if None in law or not masses:
        return None
    stiffness, exponent, damping, damping_exponent = (v for v in law if v is not None)
    damping = damping if contact.damped else 0.0
    thrown = rebound(NEWTON * stiffness, exponent, NEWTON * damping, damping_exponent, min(masses), HIT, xp=np)
    return thrown if thrown.share > LIVELY else None


def _mass_of_a_node(sheet: Sheet) -> float | None:
    """kg."""
    given = [_number(sheet, f) for f in ("density", "length", "width", "thickness")]
    return None if None in given else float(np.prod(np.array(given, float))) / (sheet.bars + 1)


def _mass(path: str, roller: MovableRoller, _: Scene) -> Iterator[str]:
    mass = _number(roller, "mass")
    if mass and mass > BULKY:
        yield f"{path}.mass is {mass:g} kg: in g? A pinch roller has 0.01 to 0.5 kg"


def _out_of_reach(path: str, roller: MovableRoller, scene: Scene) -> Iterator[str]:
    """A pinch whose stop holds it off every roller that it is near: no sheet is pressed there."""
    center, way, radius = sound(roller, "center"), sound(roller, "direction"), _number(roller, "radius")
    stop, sheets = _number(roller, "travel_min"), [_number(s, "thickness") or 0.0 for s in scene.sheets.values()]
    if center is None or way is None or radius is None or stop is None or not sheets or not np.any(way):
        return
    nearest, gap = "", NIP
    for name, other in sorted(scene.rollers.items()):
        place, size = sound(other, "center"), _number(other, "radius")
        if other is roller or place is None or size is None:
            continue
        left = float(np.hypot(*(center + stop * way / np.hypot(*way) - place))) - radius - size
        nearest, gap = (name, left) if left < gap else (nearest, gap)
    if nearest and gap > max(sheets):
        yield (
            f"{path} stops {gap:.3g} mm before rollers.{nearest} (travel_min = {stop:g} mm): no sheet is pressed there, for the"
            f" thickest has {max(sheets):g} mm"
        )


def _pinch(path: str, roller: MovableRoller, scene: Scene) -> Iterator[str]:
    center, way, radius = sound(roller, "center"), sound(roller, "direction"), _number(roller, "radius")
    preload = _number(roller, "preload")
    if preload and preload < 0:
        yield f"{path}.preload is {preload:g} N, which opens the nip: the spring pushes against `direction` where it is > 0"
        return
    if center is None or way is None or radius is None or not preload:
        return
    for name, other in sorted(scene.rollers.items()):
        place, size = sound(other, "center"), _number(other, "radius")
        if other is roller or place is None or size is None:
            continue
        towards = np.asarray(place) - center
        if np.hypot(*towards) - radius - size >= NIP:
            continue
        share = way @ towards / (np.hypot(*way) * np.hypot(*towards))
        if abs(share) < BESIDE:
            yield f"{path}.direction runs beside rollers.{name}, not towards or away from it: its preload does not close the nip"
        if share > 0.5:
            yield (
                f"{path}.direction points at rollers.{name}, so that its preload opens the nip: the spring pushes against"
                " `direction`"
            )


def _back_to_back(path: str, guide: LineGuide, scene: Scene) -> Iterator[str]:
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


_RULES: dict[type, tuple[Rule, ...]] = {
    Sheet: (_sheet,),
    ArcGuide: (_arc, _moved),
    LineGuide: (_moved, _back_to_back),
    CircleGuide: (_moved,),
    Contact: (_contact,),
    FixedRoller: (_drive, _moved),
    MovableRoller: (_drive, _mass, _pinch, _out_of_reach),
}
