"""The scene of the stability map, and the six numbers of it that are varied.

Copy paper settled in a driven nip, its lead over a guide that rises: the drive starts at full speed, the lead edge meets the
guide. Equal pulls at both ends stretch it without loading the nip.
"""

from typing import NamedTuple

from diffeed.input.check_records import make_scene
from diffeed.input.parts import Contact, FixedRoller, LineGuide, Load, MovableRoller, Scene, Sheet

LENGTH, THICKNESS, WIDTH = 100.0, 0.1, 210.0  # mm
RADIUS = 10.0  # mm
PRELOAD = 1.0  # N


class Axis(NamedTuple):
    """One number of the scene: what it is called in a picture, its unit, and the values of the map."""

    title: str
    unit: str
    values: tuple[float, ...]


AXES = {
    "tension": Axis("Sheet tension", "N", (0.01, 0.03, 0.1, 1.0, 10.0, 30.0, 100.0)),
    "bending": Axis("Bending stiffness", "N mm²", (0.03, 0.3, 3.0, 30.0, 300.0, 3e3, 3e4)),
    "contact": Axis("Contact stiffness", "N/mm", (30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4)),
    "mass": Axis("Mass of a bar", "kg", (1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3)),
    "speed": Axis("Feed speed", "mm/s", (10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)),
    "bars": Axis("Bars", "1", (5, 10, 20, 40)),
}
BASE = {"tension": 0.1, "bending": 30.0, "contact": 50.0, "mass": 1.5e-4, "speed": 300.0, "bars": 10}
"""Values of the numbers that are not varied; `mass` is that of a bar of ten."""


def vary(axis: str, value: float) -> Scene:
    """The scene with one number changed."""
    return machine(**BASE | {axis: value})


def machine(tension: float, bending: float, contact: float, mass: float, speed: float, bars: float) -> Scene:
    """The scene, of one structure for one number of bars."""
    sheet = Sheet(
        length=LENGTH, thickness=THICKNESS, width=WIDTH, density=10.0 * mass / (LENGTH * THICKNESS * WIDTH),
        youngs_modulus=bending * 12.0 / (WIDTH * THICKNESS**3), structural_damping=1e-4, bars=int(bars), lead=(55.0, 0.0),
    )  # fmt: skip
    pressed = PRELOAD / contact  # mm: the drive stands where the sheet is straight
    rollers = {
        "drive": FixedRoller(
            center=(0.0, pressed - RADIUS - 0.5 * THICKNESS), radius=RADIUS, surface_speed=-speed
        ),
        "pinch": MovableRoller(
            center=(0.0, RADIUS + 0.5 * THICKNESS - pressed), direction=(0.0, 1.0), radius=RADIUS, mass=0.02, spring=0.5,
            preload=PRELOAD, damper=5e-3,
        ),
    }  # fmt: skip
    pulls = {"lead": (tension, 0.0), "tail": (-tension, 0.0)}
    return make_scene(
        sheets={"sheet": sheet},
        rollers=rollers,
        guides={"guide": LineGuide(start=(20.0, -1.0), end=(1500.0, 59.0))},
        contacts={"default": Contact(stiffness=contact, damping=0.1, stick_speed=30.0)},
        loads={at: Load(sheet="sheet", at=at, force=force) for at, force in pulls.items()},
        initial="settled",
    )
