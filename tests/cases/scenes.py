"""Random admissible scenes of a few structures: values vary with the generator, names, kinds and counts do not, so that
each structure is compiled once per method.

Sheets are heavy and contacts soft, so that an explicit method runs at the same step (DT) as an implicit one.
"""

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
    Profile,
    Scene,
    Sheet,
)
from diffeed.base.records import replace
from diffeed.input.parts import normalise

METHODS = diffeed.METHODS
ORDER = {"linear_euler": 1, "extrapolated_euler": 2, "midpoint": 2, "runge_kutta": 4}
"""Order of convergence in smooth motion; a new method must be named here."""
ROUNDING = {"extrapolated_euler": 5.0}
"""Rounding of a step, in those of one linear solve: twice that of two half steps and that of a whole one."""
HIGH_ORDER = tuple(m for m in METHODS if ORDER[m] >= 4)
DURATION, DT, FRAMES = 0.01, 5e-5, 3

Generator = np.random.Generator


def run(scene: Scene, method: str, duration: float = DURATION, dt: float = DT, **options: Any) -> diffeed.Trajectory:
    """The one run that all symmetries share: equal statics, so one compilation per structure and method."""
    options = {"frames": FRAMES} | options
    trajectory = diffeed.simulate(scene, duration=duration, dt=dt, method=method, **options)
    assert bool(trajectory.ok), trajectory.failure.describe()
    return trajectory


def _vary(rng: Generator, value: float, share: float = 0.2) -> float:
    return value * rng.uniform(1.0 - share, 1.0 + share)


def _near(rng: Generator, *at: float, by: float = 5e-3) -> np.ndarray:
    return np.array(at) + rng.uniform(-by, by, len(at))


def _sheet(rng: Generator, length: float, bars: int, lead: Any, **other: Any) -> Sheet:
    """A slightly bent sheet in general motion."""
    given = {
        "length": length,
        "thickness": 0.5,
        "width": _vary(rng, 30.0),
        "density": _vary(rng, 1e-5),
        "youngs_modulus": _vary(rng, 300.0),
        "structural_damping": _vary(rng, 2e-4),
        "bars": bars,
        "lead": lead,
        "headings": rng.uniform(-0.1, 0.1, bars),
        "curl": rng.uniform(-2e-3, 2e-3),
        "rates": rng.uniform(-2.0, 2.0, bars),
        "velocity": np.array([_vary(rng, 400.0), rng.uniform(-20.0, 20.0)]),
        "friction_factor": _vary(rng, 1.0),
    }
    return Sheet(**given | other)


def _contact(rng: Generator, **other: Any) -> Contact:
    given = {
        "stiffness": _vary(rng, 30.0),
        "exponent": 1.3,
        "damping": _vary(rng, 0.05),
        "damping_exponent": 1.2,
        "smoothing": _vary(rng, 5e-3),
        "stick_speed": _vary(rng, 60.0),
    }
    return Contact(**given | other)


def _scene(rng: Generator, **given: Any) -> Scene:
    return normalise(Scene(gravity=_near(rng, 0.0, -9810.0, by=2000.0), initial="given", **given))


def free_sheet(rng: Generator) -> Scene:
    """A bent, curled and damped sheet in free flight."""
    sheet = _sheet(
        rng, 60.0, 6, rng.uniform(-50.0, 50.0, 2), rates=rng.uniform(-60.0, 60.0, 6),
        headings=np.cumsum(rng.uniform(-25.0, 25.0, 6)), curl=rng.uniform(-0.02, 0.02),
    )  # fmt: skip
    return _scene(rng, sheets={"paper": sheet})


def _drift(rng: Generator) -> Motion:
    """A steady movement; all runs lie inside its times."""
    way, turn = rng.uniform(-15.0, 15.0, 2), rng.uniform(-30.0, 30.0)
    return Motion(
        times=[-1.0, 1.0], displacement=[-way, way], rotation=[-turn, turn], pivot=rng.uniform(-20.0, 20.0, 2)
    )


def guided(rng: Generator) -> Scene:
    """Two sheets on moving guides of every kind (line joined to an arc, free tips, both sides of arcs, circle), and a
    driven roller on a moving shaft."""
    y = rng.uniform(-0.27, -0.25)
    guides = {
        "floor": LineGuide(start=(-80.0, y), end=(0.0, y), friction=_vary(rng, 0.3), motion=_drift(rng)),
        "turn": ArcGuide(center=(0.0, y + 15.0), radius=15.0, start_angle=-90.0, sweep=40.0, motion=_drift(rng)),
        "ceiling": LineGuide(start=_near(rng, -8.0, 0.27), end=_near(rng, -27.0, 0.27), motion=_drift(rng)),
        "hump": ArcGuide(
            center=_near(rng, 20.0, 79.78), radius=20.0, start_angle=115.0, sweep=-55.0, side="outside",
            friction=_vary(rng, 0.4), motion=_drift(rng), contact="hard",
        ),
        "post": CircleGuide(center=_near(rng, 5.0, 94.79), radius=5.0, motion=_drift(rng), contact="hard"),
    }  # fmt: skip
    wheel = FixedRoller(
        center=_near(rng, 12.0, 106.22), radius=6.0, friction=_vary(rng, 0.8), surface_speed=_vary(rng, 300.0),
        motion=_drift(rng),
    )  # fmt: skip
    sheets = {
        "long": _sheet(rng, 60.0, 6, _near(rng, -1.0, 0.0)),
        "short": _sheet(rng, 30.0, 3, _near(rng, 30.0, 100.0), curl=0.0, velocity=_near(rng, 300.0, -20.0, by=20.0)),
    }
    contacts = {"default": _contact(rng), "hard": _contact(rng, exponent=1.0, static_ratio=1.3, transition_speed=90.0)}
    return _scene(rng, sheets=sheets, rollers={"wheel": wheel}, guides=guides, contacts=contacts)


def slide(rng: Generator) -> Scene:
    """A sheet between a floor that bends up and a post above it; nothing moves but the sheet."""
    y = rng.uniform(-0.26, -0.25)
    guides = {
        "floor": LineGuide(start=(-80.0, y), end=(0.0, y), friction=_vary(rng, 0.3)),
        "turn": ArcGuide(center=(0.0, y + 15.0), radius=15.0, start_angle=-90.0, sweep=40.0),
        "post": CircleGuide(center=_near(rng, -25.0, 5.24), radius=5.0),
    }
    sheets = {"paper": _sheet(rng, 60.0, 6, _near(rng, -1.0, 0.0))}
    return _scene(rng, sheets=sheets, guides=guides, contacts={"default": _contact(rng, exponent=2.0)})


def nip(rng: Generator) -> Scene:
    """A sheet in a nip: driven shaft, sprung free and driven rollers, an idle one, one riding on the drive, a bed."""
    way = np.deg2rad(rng.uniform(-125.0, -115.0))
    ride = np.array([np.cos(way), np.sin(way)])
    drive = _near(rng, 0.0, -10.22)

    def sprung(center: Any, direction: Any, **other: Any) -> MovableRoller:
        given = {
            "mass": _vary(rng, 0.02), "inertia": _vary(rng, 1.0), "spring": _vary(rng, 2.0), "preload": _vary(rng, 0.5),
            "damper": _vary(rng, 2e-3), "friction": _vary(rng, 0.8), "travel": rng.uniform(-5e-3, 5e-3),
            "travel_min": -0.2, "travel_max": 0.004, "stop_stiffness": 20.0,
        }  # fmt: skip
        return MovableRoller(center=center, direction=direction, **given | other)

    # From just after the start: a corner at the first frame has another slope on either side.
    speeds = Profile(times=[7e-5, 0.02], values=[_vary(rng, 200.0) * -1.0, _vary(rng, 500.0) * -1.0])
    rollers = {
        "drive": FixedRoller(center=drive, radius=10.0, surface_speed=speeds, friction=_vary(rng, 0.8)),
        "pinch": sprung(
            _near(rng, 1.0, 10.22), (rng.uniform(-0.2, 0.2), 1.0), radius=10.0, bearing_drag=0.01, spin=20.0
        ),
        "idle": FixedRoller(
            center=_near(rng, -20.0, 7.21), radius=7.0, inertia=2.0, friction=_vary(rng, 0.5), spin=10.0
        ),
        "kicker": sprung(
            _near(rng, -34.0, 8.21), (0.1, 2.0), radius=8.0, angular_speed=_vary(rng, 40.0), contact="soft"
        ),
        "rider": sprung(drive + 15.99 * ride, ride, radius=6.0, spin=rng.uniform(-30.0, 30.0), contact="soft"),
    }
    contacts = {
        "default": _contact(rng),
        "soft": _contact(rng, exponent=1.0, static_ratio=1.4, transition_speed=80.0, friction_law="tanh"),
    }
    return _scene(
        rng,
        sheets={"paper": _sheet(rng, 60.0, 6, _near(rng, 15.0, 0.0))},
        rollers=rollers,
        guides={"bed": LineGuide(start=_near(rng, -50.0, -0.26), end=_near(rng, -12.0, -0.26), friction=0.3)},
        contacts=contacts,
    )


def clamped(rng: Generator) -> Scene:
    """A curled sheet that grows out of a moving wall, with a force and a moment at its lead and a pin on the way."""
    motion = Motion(
        times=[-1.0, 1.0], displacement=[[-30.0, -5.0], [30.0, 5.0]], rotation=[-200.0, 200.0], pivot=(7.0, 3.0)
    )
    return _scene(
        rng,
        sheets={"strip": _sheet(rng, 40.0, 5, (3.0, -4.0), heading=20.0, velocity=np.zeros(2), rates=np.zeros(5))},
        clamps={
            "wall": Clamp(sheet="strip", at="tail", kind="wall", rotation=rng.uniform(-5.0, 5.0), motion=motion),
        },
        loads={"tip": Load(sheet="strip", at="lead", force=_near(rng, 0.0, 0.3, by=0.3), moment=_vary(rng, 0.5))},
    )


def strut(load: float, kick: float) -> Scene:
    """A straight weightless sheet between two pins, pressed along its axis with `load` (N), started with a turning rate
    `kick` (rad/s) that differs from bar to bar."""
    sheet = Sheet(
        length=60.0, thickness=0.5, width=30.0, density=1e-5, youngs_modulus=300.0, bars=6, heading=0.0,
        rates=kick * np.cos(np.pi * (np.arange(6) + 0.5) / 6),
    )  # fmt: skip
    clamps = {"front": Clamp(sheet="paper", at="lead", free="x"), "rear": Clamp(sheet="paper", at="tail")}
    loads = {"press": Load(sheet="paper", at="lead", force=(-load, 0.0))}
    return normalise(Scene(sheets={"paper": sheet}, clamps=clamps, loads=loads, gravity=(0.0, 0.0), initial="given"))


def squeeze(rear: float, front: float) -> Scene:
    """A straight weightless sheet between two symmetric pairs of driven rollers with these surface speeds (mm/s)."""
    rollers = {
        f"{name}_{side}": FixedRoller(center=(x, sign * 10.24), radius=10.0, surface_speed=sign * speed)
        for name, x, speed in (("rear", -50.0, rear), ("front", -10.0, front))
        for side, sign in (("upper", 1.0), ("lower", -1.0))
    }
    sheet = Sheet(length=60.0, thickness=0.5, width=30.0, density=1e-5, youngs_modulus=300.0, bars=6)
    contact = Contact(stiffness=30.0, damping=0.05, stick_speed=60.0, exponent=1.3)
    return normalise(
        Scene(
            sheets={"paper": sheet}, rollers=rollers, contacts={"default": contact}, gravity=(0.0, 0.0), initial="given"
        )
    )


def rod(rng: Generator) -> Scene:
    """One bar: a rigid rod in free flight."""
    sheet = _sheet(rng, 40.0, 1, rng.uniform(-50.0, 50.0, 2), headings=rng.uniform(-180.0, 180.0, 1), curl=0.0)
    return _scene(rng, sheets={"rod": replace(sheet, rates=rng.uniform(-80.0, 80.0, 1))})


def posts(rng: Generator) -> Scene:
    """A fast sheet along a row of posts, of which it meets a few at a time."""
    x = np.linspace(-60.0, 80.0, 14)
    guides = {
        f"post_{k:02d}": CircleGuide(center=(x[k], (-1.0) ** k * rng.uniform(5.22, 5.3)), radius=5.0, contact="default")
        for k in range(len(x))
    }
    sheet = _sheet(rng, 60.0, 6, (0.0, 0.0), velocity=(3000.0, 0.0))
    return _scene(rng, sheets={"paper": sheet}, guides=guides, contacts={"default": _contact(rng)})


def beam(bars: int, clamped: bool, gravity: float) -> Scene:
    """A straight thin strip, held in a wall at its tail or free: the same physical sheet for every number of bars."""
    sheet = Sheet(
        length=100.0, thickness=0.1, width=20.0, density=1e-6, youngs_modulus=3000.0, bars=bars, lead=(100.0, 0.0)
    )
    clamps = {"wall": Clamp(sheet="strip", at="tail", kind="wall")} if clamped else {}
    return normalise(Scene(sheets={"strip": sheet}, clamps=clamps, gravity=(0.0, -gravity), initial="given"))


STRUCTURES = {"free_sheet": free_sheet, "guided": guided, "nip": nip, "clamped": clamped}


def draw(structure: str, seed: int) -> Scene:
    """A scene of a structure, the same for the same seed."""
    return STRUCTURES[structure](np.random.default_rng(seed))
