"""What is sound in itself but hardly meant: a number in another unit, a part where it does no good. Said, never refused."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from diffeed.base.records import fields
from diffeed.input import remarks_places as places
from diffeed.input.check_records import check_records
from diffeed.input.check_rules import Rule
from diffeed.input.check_values import number_of, sound
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
NARROWEST = 1.0
"""mm of a sheet's width: less may be metres. A length in metres is refused, for its bars are shorter than the sheet is thick."""
RADIANS, AS_GIVEN = np.pi / 12, 2e-3
"""What angles in radians are multiples of, and how near to one (pi may be 3.14): none in degrees with one decimal is so near."""
SLOWEST, FASTEST = 5.0, 8000.0
"""mm/s: a drive that never turns faster than this, and one that does."""
GRAVITY = (9.0, 10.5)
"""m/s2, given as mm/s2."""
TURNED = 1.6
"""Degrees: a movement that turns a part by less may be meant in radians."""
ASIDE = 2.0
"""Times its own size: a part that swings about an origin further away than that may lack its pivot."""
STUB = 3.0
"""mm of an arc: hardly a guide."""
CURLED = 3.0
"""mm: a smaller radius of curl is hardly meant."""
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


def _of_scene(scene: Scene) -> Iterator[str]:
    gravity = sound(scene, "gravity")
    if gravity is not None and GRAVITY[0] < float(np.hypot(*gravity)) < GRAVITY[1]:
        yield f"gravity is {np.hypot(*gravity):g} mm/s2: in m/s2? That of the earth is 9810 mm/s2"
    duration, fastest = scene.duration, max((_fastest(r) or 0.0 for r in scene.rollers.values()), default=0.0)
    places, lengths = _places(scene), [number_of(s, "length") or 0.0 for s in scene.sheets.values()]
    way = sum(lengths) + (float(np.ptp(np.array(places), axis=0).sum()) if places else 0.0)
    if fastest <= FASTEST and duration * fastest > BEYOND_USE * way > 0:
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
    modulus, density, thickness = (number_of(sheet, f) for f in ("youngs_modulus", "density", "thickness"))
    if (width := number_of(sheet, "width")) and width < NARROWEST:
        yield f"{path}.width is {width:g} mm: in m? A4 is 210 mm wide"
    if modulus and modulus > STIFFEST:
        yield f"{path}.youngs_modulus is {modulus:g} N/mm2: in Pa? Steel has 2.1e5 N/mm2, paper 2000 to 8000"
    if modulus and modulus < LIMPEST:
        yield f"{path}.youngs_modulus is {modulus:g} N/mm2: in GPa? Rubber has 1 to 10 N/mm2, paper 2000 to 8000"
    if density and not LIGHTEST < density < HEAVIEST:
        yield f"{path}.density is {density:g} kg/mm3: in other units? Paper has 8e-7 kg/mm3 (800 kg/m3)"
    if thickness and not THINNEST < thickness < THICKEST:
        yield f"{path}.thickness is {thickness:g} mm: in other units? Copy paper has 0.1 mm"
    curl = number_of(sheet, "curl")
    if curl and abs(curl) * CURLED > 1.0:
        yield f"{path}.curl is {curl:g} 1/mm, a radius of {1.0 / abs(curl):.2g} mm: is it the radius? A curl of 50 mm is 0.02"
    yield from _in_radians(path, sheet, "heading")


def _in_radians(path: str, part: Any, field: str) -> Iterator[str]:
    """An angle that is a twelfth of pi, or some of them, to the digits that it is given with."""
    value = number_of(part, field)
    if value is None or not 0.0 < abs(value) < 2.0 * np.pi + RADIANS:
        return
    times = round(value / RADIANS)
    if times and abs(value - times * RADIANS) < AS_GIVEN:
        meant = np.rad2deg(times * RADIANS)
        yield f"{path}.{field} is {value:g} degrees: in radians? Then it is {meant:g}"


def _arc(path: str, guide: ArcGuide, _: Scene) -> Iterator[str]:
    sweep, radius = number_of(guide, "sweep"), number_of(guide, "radius")
    yield from _in_radians(path, guide, "start_angle")
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
    radius = number_of(part, "radius") or 0.0 if hasattr(part, "radius") else 0.0
    away = min(float(np.hypot(*point)) for point in points) - radius
    size = float(np.hypot(*np.ptp(points, axis=0))) + 2.0 * radius
    if away > ASIDE * size:
        yield f"{path}.motion.pivot is (0, 0), {away:.3g} mm from the part: was it forgotten? The part swings about it"


def _fastest(roller: Any) -> float | None:
    """mm/s of its surface, None if it idles or that is not known."""
    for field, lever in (("surface_speed", 1.0), ("angular_speed", number_of(roller, "radius"))):
        speed = getattr(roller, field)
        values = sound(speed, "values") if isinstance(speed, Profile) else sound(roller, field)
        if values is not None and lever:
            return float(np.max(np.abs(values)) * lever)
    return None


def _drive(path: str, roller: Any, scene: Scene) -> Iterator[str]:
    fastest, friction = _fastest(roller), number_of(roller, "friction")
    if friction and friction > ROUGH:
        yield f"{path}.friction is {friction:g}: in percent? Rubber on paper has 0.8 to 1.5"
    for field in ("surface_speed", "angular_speed"):
        if isinstance(profile := getattr(roller, field), Profile):
            yield from _in_the_run(f"{path}.{field}", profile, scene)
    if fastest and fastest < SLOWEST:
        yield f"{path} turns at {fastest:g} mm/s at most: in m/s? Feeders run at 100 to 3000 mm/s"
    if fastest and fastest > FASTEST:
        unit = "rpm? 1 rpm is 0.1047 rad/s" if roller.surface_speed is None else "mm/min? Divide by 60"
        yield f"{path} turns at up to {fastest:.4g} mm/s: in {unit}; feeders run at 100 to 3000 mm/s"


def _contact(path: str, contact: Contact, scene: Scene) -> Iterator[str]:
    stiffness = number_of(contact, "stiffness")
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
    law = [number_of(contact, f) for f in ("stiffness", "exponent", "damping", "damping_exponent")]
    masses = [mass for sheet in scene.sheets.values() if (mass := _mass_of_a_node(sheet))]
    if None in law or not masses:
        return None
    stiffness, exponent, damping, damping_exponent = (v for v in law if v is not None)
    damping = damping if contact.damped else 0.0
    thrown = rebound(NEWTON * stiffness, exponent, NEWTON * damping, damping_exponent, min(masses), HIT, xp=np)
    return thrown if thrown.share > LIVELY else None


def _mass_of_a_node(sheet: Sheet) -> float | None:
    """kg."""
    given = [number_of(sheet, f) for f in ("density", "length", "width", "thickness")]
    return None if None in given else float(np.prod(np.array(given, float))) / (sheet.bars + 1)


def _mass(path: str, roller: MovableRoller, _: Scene) -> Iterator[str]:
    mass = number_of(roller, "mass")
    if mass and mass > BULKY:
        yield f"{path}.mass is {mass:g} kg: in g? A pinch roller has 0.01 to 0.5 kg"


_RULES: dict[type, tuple[Rule, ...]] = {
    Sheet: (_sheet,),
    ArcGuide: (_arc, places.bends, places.through, _moved),
    LineGuide: (_moved, places.through, places.back_to_back),
    CircleGuide: (_moved,),
    Contact: (_contact,),
    FixedRoller: (_drive, _moved),
    MovableRoller: (_drive, _mass, places.pinch, places.out_of_reach),
}
