"""A straight transport path of any length, generated: what growth is measured on. One sheet, many parts, few of them near."""

from typing import Any

from diffeed.input.check_records import make_scene
from diffeed.input.parts import FixedRoller, LineGuide, Motion, MovableRoller, Scene, Sheet

PITCH = 100.0  # mm from nip to nip
LENGTH, THICKNESS, RADIUS = 160.0, 0.2, 10.0
PRESSED = 0.005  # mm, of a roller on a fixed shaft into the sheet
SPEED = 100.0  # mm/s


def transport(
    bars: int = 20, guides: int = 2, driven: int = 4, nips: int = 0, duration: float = 0.05, moving: bool = False
) -> Scene:
    """A path of `driven` rollers on fixed shafts (in pairs, both driven), then `nips` of a drive and a movable pinch, and
    line guides below, which may swing away. The sheet runs in the first of them."""
    rollers: dict[str, Any] = {}
    for k in range((driven + 1) // 2):
        for name, side in (("lower", -1.0), ("upper", 1.0)):
            if len(rollers) < driven:
                rollers[f"{name}_{k}"] = _driven(k, side)
    for k in range((driven + 1) // 2, (driven + 1) // 2 + nips):
        rollers[f"drive_{k}"], rollers[f"pinch_{k}"] = _driven(k, -1.0), _pinch(k)
    sheet = Sheet(
        length=LENGTH, thickness=THICKNESS, width=50.0, density=1.0e-6, youngs_modulus=2000.0, structural_damping=1e-3,
        bars=bars, lead=(130.0, 0.0), speed=SPEED,
    )  # fmt: skip
    return make_scene(
        sheets={"sheet": sheet},
        rollers=rollers,
        guides={f"guide_{k}": _guide(k, moving) for k in range(guides)},
        initial="given",
        duration=duration,
    )


def _driven(k: int, side: float) -> FixedRoller:
    height = side * (RADIUS + 0.5 * THICKNESS - PRESSED)
    return FixedRoller(center=(PITCH * k, height), radius=RADIUS, surface_speed=side * SPEED)


def _pinch(k: int) -> MovableRoller:
    return MovableRoller(
        center=(PITCH * k, RADIUS + 0.5 * THICKNESS), direction=(0.0, 1.0), radius=RADIUS, mass=0.02, spring=0.5,
        preload=1.0, damper=0.005,
    )  # fmt: skip


def _guide(k: int, moving: bool) -> LineGuide:
    start = (PITCH * k + 12.0, -0.3)
    swing = Motion(times=(0.0, 1.0), displacement=((0.0, 0.0), (0.0, -1.0)), rotation=(0.0, -5.0), pivot=start)
    return LineGuide(start=start, end=(PITCH * k + 88.0, -0.3), motion=swing if moving else None)
