"""Some twenty fixed structures whose numbers are drawn far and wide: from tissue to steel, from creeping to 5 m/s.

Names, kinds and counts never change within a structure, so that all scenes of one run in one compiled batch.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

import diffeed
from diffeed import (
    ArcGuide,
    CircleGuide,
    Clamp,
    Contact,
    FixedRoller,
    LineGuide,
    Load,
    Motion,
    MovableRoller,
    Scene,
    Sheet,
)
from diffeed.base.records import replace
from diffeed.input.parts import normalise
from diffeed.input.paths import numbers, put

Generator = np.random.Generator


DURATION = 0.02
"""s, of every run."""


def far(rng: Generator, low: float, high: float) -> float:
    """Drawn evenly on a logarithmic scale."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sheet(rng: Generator, bars: int, lead: Any, length: tuple[float, float] = (20.0, 200.0), **other: Any) -> Sheet:
    """From tissue to steel foil and card; a bar is never shorter than it is thick."""
    long = rng.uniform(*length)
    given = {
        "length": long,
        "thickness": min(far(rng, 0.02, 0.8), 0.9 * long / bars),
        "width": far(rng, 5.0, 300.0),
        "density": far(rng, 2e-7, 8e-6),
        "youngs_modulus": far(rng, 1.0, 2e5),
        "structural_damping": rng.choice([0.0, far(rng, 1e-6, 1e-2)]),
        "bars": bars,
        "lead": lead,
        "curl": rng.choice([0.0, rng.uniform(-0.02, 0.02)]),
        "friction_factor": rng.uniform(0.3, 3.0),
    }
    return Sheet(**given | other)


def contact(rng: Generator, **other: Any) -> Contact:
    """Soft rubber to hard steel; with and without damping."""
    given = {
        "stiffness": far(rng, 3.0, 3e3),
        "exponent": rng.uniform(1.0, 2.0),
        "damping": rng.choice([0.0, far(rng, 1e-4, 5.0)]),
        "damping_exponent": rng.uniform(0.0, 1.5),
        "smoothing": far(rng, 1e-4, 5e-2),
        "stick_speed": far(rng, 0.1, 100.0),
    }
    return Contact(**given | other)


def grip(rng: Generator) -> float:
    """A friction coefficient: none, an everyday one, or glue."""
    return float(rng.choice([0.0, rng.uniform(0.1, 1.5), far(rng, 5.0, 1e3)], p=[0.1, 0.8, 0.1]))


def pace(rng: Generator) -> float:
    """A speed of feeding, mm/s: from creeping to the fastest machines, either way."""
    return far(rng, 3.0, 5000.0) * rng.choice([1.0, 1.0, 1.0, -1.0])


def scene(rng: Generator, **given: Any) -> Scene:
    gravity = rng.choice([(0.0, -9810.0), (0.0, 0.0), (9810.0, 0.0)], p=[0.7, 0.2, 0.1])
    return Scene(**{"gravity": gravity, "initial": "given", "contacts": {"default": contact(rng)}} | given)


# --- sheets alone -----------------------------------------------------------------------------------------------------


def flight(rng: Generator) -> Scene:
    """A bent sheet thrown through the air."""
    thrown = sheet(
        rng, 8, (0.0, 0.0), headings=np.cumsum(rng.uniform(-40.0, 40.0, 8)), rates=rng.normal(0.0, 30.0, 8),
        velocity=rng.normal(0.0, 1000.0, 2),
    )  # fmt: skip
    return scene(rng, sheets={"paper": thrown})


def stick(rng: Generator) -> Scene:
    """One bar that falls on a corner."""
    lead = (rng.uniform(5.0, 15.0), rng.uniform(1.5, 3.0))
    guides = {"floor": LineGuide(start=(-300.0, 0.0), end=(0.0, 0.0), friction=grip(rng))}
    rod = sheet(rng, 1, lead, curl=0.0, heading=rng.uniform(0.0, 3.0), speed=far(rng, 1.0, 1000.0))
    return scene(rng, sheets={"rod": rod}, guides=guides)


def scissors(rng: Generator) -> Scene:
    """Two bars and their one joint, shaken by a moving clamp."""
    motion = Motion(
        times=[0.0, 0.01, 0.02],
        displacement=np.cumsum([(0.0, 0.0), *rng.normal(0.0, 1.0, (2, 2))], axis=0),
        rotation=np.cumsum([0.0, *rng.normal(0.0, 5.0, 2)]),
    )
    return scene(
        rng,
        sheets={"paper": sheet(rng, 2, (0.0, 0.0))},
        clamps={"wall": Clamp(sheet="paper", at="tail", kind="wall", motion=motion)},
    )


def pendulum(rng: Generator) -> Scene:
    """A sheet that hangs from a pin, pulled and twisted at its lead."""
    load = Load(sheet="paper", at="lead", force=rng.normal(0.0, 0.05, 2), moment=rng.normal(0.0, 0.05))
    hung = sheet(rng, 10, (0.0, 0.0), heading=rng.uniform(-180.0, 180.0))
    return scene(rng, sheets={"paper": hung}, clamps={"pin": Clamp(sheet="paper", at="tail")}, loads={"pull": load})


def tissue(rng: Generator) -> Scene:
    """Forty bars of the thinnest, dropped on a post."""
    thin = sheet(rng, 40, (60.0, 0.0), length=(118.0, 122.0), thickness=far(rng, 0.01, 0.03), youngs_modulus=200.0)
    post = CircleGuide(center=(0.0, -8.2 - rng.uniform(0.0, 0.2)), radius=8.0, friction=grip(rng))
    return scene(rng, sheets={"tissue": thin}, guides={"post": post})


# --- sheets and guides -----------------------------------------------------------------------------------------------


def floor(rng: Generator) -> Scene:
    """A sheet dropped on a floor, flat or not."""
    guides = {"floor": LineGuide(start=(-300.0, -2.0), end=(100.0, -2.0), friction=grip(rng))}
    dropped = sheet(
        rng, 8, (0.0, rng.uniform(0.0, 5.0)), curl=0.0, velocity=(rng.normal(0.0, 500.0), -far(rng, 1.0, 3000.0))
    )
    return scene(rng, sheets={"paper": dropped}, guides=guides)


def slope(rng: Generator) -> Scene:
    """A sheet laid on a slope."""
    tilt = np.deg2rad(rng.uniform(-50.0, 50.0))
    way = np.array([np.cos(tilt), np.sin(tilt)])
    laid = sheet(rng, 6, (0.0, 0.0), curl=0.0, heading=float(np.rad2deg(tilt)))
    below = np.array([np.sin(tilt), -np.cos(tilt)]) * 0.5 * laid.thickness
    guides = {"slope": LineGuide(start=below - 400.0 * way, end=below + 200.0 * way, friction=grip(rng))}
    return scene(rng, sheets={"paper": laid}, guides=guides, contacts={"default": contact(rng, friction_law="stick")})


def channel(rng: Generator) -> Scene:
    """A sheet shot into a straight channel that narrows."""
    gap = rng.uniform(1.0, 4.0)
    guides = {
        "lower": LineGuide(start=(5.0, -gap), end=(120.0, -0.5), friction=grip(rng)),
        "upper": LineGuide(start=(120.0, 0.5), end=(5.0, gap), friction=grip(rng)),
    }
    shot = sheet(
        rng, 10, (0.0, 0.0), curl=rng.uniform(-2e-3, 2e-3), thickness=far(rng, 0.02, 0.5), speed=abs(pace(rng))
    )
    return scene(rng, sheets={"paper": shot}, guides=guides)


def bend(rng: Generator) -> Scene:
    """A sheet shot into a curved channel of two arcs with straight lead-ins."""
    radius, gap, y = rng.uniform(15.0, 60.0), rng.uniform(1.5, 3.0), 1.0
    guides = {
        "lower": LineGuide(start=(-200.0, -y), end=(5.0, -y), friction=grip(rng)),
        "outer": ArcGuide(center=(5.0, radius - y), radius=radius, start_angle=-90.0, sweep=80.0, friction=grip(rng)),
        "inner": ArcGuide(
            center=(5.0, radius - y), radius=radius - gap, start_angle=-90.0, sweep=80.0, side="outside",
            friction=grip(rng),
        ),
    }  # fmt: skip
    shot = sheet(rng, 12, (0.0, 0.0), curl=0.0, thickness=far(rng, 0.02, 0.3), speed=abs(pace(rng)))
    return scene(rng, sheets={"paper": shot}, guides=guides)


def gate(rng: Generator) -> Scene:
    """A diverter that swings at a lying sheet, and a post that comes from above."""
    swing = Motion(
        times=[0.0, 0.02], displacement=np.zeros((2, 2)), rotation=[0.0, rng.uniform(5.0, 40.0)], pivot=(-40.0, -2.0)
    )
    drop = Motion(times=[0.0, 0.02], displacement=[(0.0, 0.0), (0.0, -rng.uniform(1.0, 10.0))], rotation=[0.0, 0.0])
    guides = {
        "diverter": LineGuide(start=(-40.0, -2.0), end=(10.0, -2.0), friction=grip(rng), motion=swing),
        "post": CircleGuide(center=(-60.0, 8.0), radius=5.0, friction=grip(rng), motion=drop),
    }
    return scene(rng, sheets={"paper": sheet(rng, 10, (5.0, 0.0), curl=0.0)}, guides=guides)


# --- rollers -----------------------------------------------------------------------------------------------------------


def _fixed(rng: Generator, x: float, y: float, radius: float, speed: float | None, **other: Any) -> FixedRoller:
    return FixedRoller(center=(x, y), radius=radius, friction=grip(rng), surface_speed=speed, **other)


def _pinch(rng: Generator, x: float, y: float, radius: float, **other: Any) -> MovableRoller:
    given = {
        "mass": far(rng, 1e-3, 0.2),
        "inertia": far(rng, 1e-2, 30.0),
        "spring": far(rng, 0.01, 20.0),
        "preload": far(rng, 0.05, 20.0),
        "damper": rng.choice([0.0, far(rng, 1e-4, 0.1)]),
    }
    return MovableRoller(center=(x, y), direction=(0.0, np.sign(y)), radius=radius, friction=grip(rng), **given | other)


def _nip(rng: Generator, name: str, x: float, thickness: float, speed: float) -> dict[str, Any]:
    r, s = far(rng, 3.0, 40.0), far(rng, 3.0, 40.0)
    bite = 0.5 * thickness
    return {
        f"drive_{name}": _fixed(rng, x, -r - bite, r, -speed),
        f"pinch_{name}": _pinch(rng, x + rng.uniform(-1.0, 1.0), s + bite, s),
    }


def nip(rng: Generator) -> Scene:
    """A sheet in a driven nip with a sprung pinch."""
    fed = sheet(rng, 12, (30.0, 0.0), length=(60.0, 200.0), curl=0.0)
    return scene(rng, sheets={"paper": fed}, rollers=_nip(rng, "1", 0.0, fed.thickness, pace(rng)))


def two_nips(rng: Generator) -> Scene:
    """Two nips of different speed that stretch or buckle the sheet between them."""
    fed = sheet(rng, 16, (80.0, 0.0), length=(150.0, 200.0), curl=0.0)
    speed = pace(rng)
    rollers = _nip(rng, "1", 0.0, fed.thickness, speed)
    return scene(
        rng, sheets={"paper": fed}, rollers=rollers | _nip(rng, "2", 60.0, fed.thickness, speed * rng.uniform(0.8, 1.2))
    )


def hard_pair(rng: Generator) -> Scene:
    """Two fixed rollers that squeeze the sheet by a given amount."""
    fed = sheet(rng, 10, (20.0, 0.0), curl=0.0)
    y, speed = 10.0 + 0.5 * fed.thickness - rng.uniform(0.0, 0.05), pace(rng)
    rollers = {"lower": _fixed(rng, 0.0, -y, 10.0, -speed), "upper": _fixed(rng, 0.0, y, 10.0, speed)}
    return scene(rng, sheets={"paper": fed}, rollers=rollers)


def idle(rng: Generator) -> Scene:
    """A sheet drawn over an idle roller by its lead."""
    fed = sheet(rng, 10, (60.0, 0.0), length=(80.0, 150.0), curl=0.0)
    rollers = {
        "idle": _fixed(
            rng, 0.0, -12.0 - 0.5 * fed.thickness, 12.0, None, inertia=far(rng, 0.01, 100.0), bearing_drag=0.1
        )
    }
    loads = {"pull": Load(sheet="paper", at="lead", force=(far(rng, 1e-3, 3.0), -far(rng, 1e-3, 0.3)))}
    return scene(rng, sheets={"paper": fed}, rollers=rollers, loads=loads)


def entry(rng: Generator) -> Scene:
    """A sheet shot at the mouth of a nip, which it may hit anywhere."""
    speed = abs(pace(rng))
    shot = sheet(rng, 10, (-12.0, rng.uniform(-3.0, 3.0)), curl=0.0, heading=rng.uniform(-8.0, 8.0), speed=speed)
    return scene(
        rng, sheets={"paper": shot}, rollers=_nip(rng, "1", 0.0, shot.thickness, speed * rng.uniform(0.5, 2.0))
    )


def stuck(rng: Generator) -> Scene:
    """A nip that drives a sheet against a stop, and a pinch that is stuck on its way."""
    fed = sheet(rng, 12, (30.0, 0.0), length=(60.0, 120.0), curl=0.0)
    rollers = _nip(rng, "1", 0.0, fed.thickness, abs(pace(rng)))
    blocked = _pinch(rng, -25.0, 8.0 + 0.5 * fed.thickness, 8.0, travel_min=0.0, travel_max=0.0)
    stop = LineGuide(start=(32.0, -20.0), end=(32.0, 20.0), friction=grip(rng))
    return scene(rng, sheets={"paper": fed}, rollers=rollers | {"stuck": blocked}, guides={"stop": stop})


def pair_of_sheets(rng: Generator) -> Scene:
    """Two sheets one behind the other in a nip and on a table."""
    first = sheet(rng, 6, (30.0, 0.0), length=(50.0, 80.0), curl=0.0)
    second = sheet(rng, 6, (-60.0, 0.0), length=(50.0, 80.0), curl=0.0, thickness=first.thickness, speed=abs(pace(rng)))
    guides = {
        "table": LineGuide(
            start=(-200.0, -0.5 * first.thickness), end=(-10.0, -0.5 * first.thickness), friction=grip(rng)
        )
    }
    return scene(
        rng,
        sheets={"first": first, "second": second},
        rollers=_nip(rng, "1", 0.0, first.thickness, abs(pace(rng))),
        guides=guides,
    )


def skin(rng: Generator) -> Scene:
    """The nip again, with the smooth skin."""
    return replace(nip(rng), skin="smooth")


# --- the shipped scenes, mutated -------------------------------------------------------------------------------------


@functools.cache
def _shipped(name: str) -> tuple[Scene, dict[str, float]]:
    found = diffeed.load_scene(name)
    return found, numbers(normalise(found))


def mutant(name: str) -> Callable[[Generator], Scene]:
    """A shipped scene with a handful of its numbers changed: a little, much, or taken far out of their range."""

    def draw(rng: Generator) -> Scene:
        changed, values = _shipped(name)
        for path in rng.choice(list(values), rng.integers(1, 6), replace=False):
            if any(word in path for word in ("times", "direction")):
                continue
            value = float(np.asarray(values[path]))
            kind = rng.integers(3)
            moved = (
                value + rng.normal(0.0, 0.5)
                if kind == 0
                else value * far(rng, *((0.7, 1.4) if kind == 1 else (0.02, 50.0)))
            )
            changed = put(changed, str(path), moved)
        return changed

    return draw


MACHINES: dict[str, Callable[[Generator], Scene]] = {
    "flight": flight,
    "stick": stick,
    "scissors": scissors,
    "pendulum": pendulum,
    "tissue": tissue,
    "floor": floor,
    "slope": slope,
    "channel": channel,
    "bend": bend,
    "gate": gate,
    "nip": nip,
    "two_nips": two_nips,
    "hard_pair": hard_pair,
    "idle": idle,
    "entry": entry,
    "stuck": stuck,
    "pair_of_sheets": pair_of_sheets,
    "skin": skin,
    "film_feeder": mutant("film_feeder"),
    "gap_bridge": mutant("gap_bridge"),
    "jam_layout": mutant("jam_layout"),
    "long_path": mutant("long_path"),
}
