"""What bars cost in smoothness: force and slip of a sheet that is pulled over a roller, on bars and on the smooth skin.

The sheet comes up to a roller that turns freely, goes around 60 degrees of it and into a driven nip; a dead force at its tail
drags it back. Loads and speed are steady: what ripples is the polygon, in the contact and in the bending of the joints.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from diffeed.bench.timing import timed
from diffeed.input.check_records import make_scene
from diffeed.input.parts import FixedRoller, Load, MovableRoller, Profile, Scene, Sheet, normalise
from diffeed.run.examine import prepare
from diffeed.run.rollout import simulate

BARS = (10, 20, 40, 80)
SKINS = ("bars", "smooth")
LENGTH, THICKNESS, RADIUS, NIP = 160.0, 0.1, 15.0, 40.0  # mm; the nip is so far behind the roller
WRAP = 60.0  # deg
DRAG = 1.0  # N
SPEED, RUN_UP, DURATION = 200.0, 0.15, 0.35  # mm/s, s
DT, FRAMES = 1e-4, 351

Show = Callable[[int, int, str], None]


def scene(bars: int, skin: str = "bars") -> Scene:
    """The sheet around the roller, at rest."""
    axis = RADIUS + 0.5 * THICKNESS
    lead = NIP + 15.0
    middles = (np.arange(bars) + 0.5) * LENGTH / bars - lead  # mm along the sheet behind the roller's top
    headings = np.clip(np.degrees(middles / axis), 0.0, WRAP)
    angle = math.radians(WRAP)
    sheet = Sheet(
        length=LENGTH, thickness=THICKNESS, width=50.0, density=1e-6, youngs_modulus=2000.0, structural_damping=3e-3,
        bars=bars, lead=(lead, 0.0), headings=tuple(headings),
    )  # fmt: skip
    start = Profile(times=[0.0, 0.02], values=[0.0, -SPEED / RADIUS])
    rollers: dict[str, Any] = {
        "turn": FixedRoller(center=(0.0, -axis), radius=RADIUS, inertia=1.0, friction=0.5),
        "drive": FixedRoller(center=(NIP, -axis), radius=RADIUS, angular_speed=start),
        "pinch": MovableRoller(
            center=(NIP, axis), direction=(0.0, 1.0), radius=RADIUS, mass=0.02, preload=5.0, damper=0.02
        ),
    }
    pull = Load(sheet="sheet", at="tail", force=(-DRAG * math.cos(angle), -DRAG * math.sin(angle)))
    return make_scene(
        sheets={"sheet": sheet},
        rollers=rollers,
        loads={"drag": pull},
        gravity=(0.0, 0.0),
        initial="settled",
        duration=DURATION,
        skin=skin,
    )


def ripple(
    counts: tuple[int, ...] = BARS, show: Show = lambda done, total, text: None, fewest: int = 3
) -> list[dict[str, Any]]:
    """One row per skin and number of bars: cost, force of the roller and slip of the drive with their standard deviations over
    the time after `RUN_UP`, and how far force and lead edge are from those of the smooth skin with twice the most bars."""
    asked = [(skin, bars) for skin in SKINS for bars in counts]
    rows = []
    for done, (skin, bars) in enumerate(asked):
        show(done, len(asked) + 1, f"{bars} bars, skin {skin}")
        rows.append({"skin": skin, "bars": bars} | _run(scene(bars, skin), fewest))
    show(len(asked), len(asked) + 1, "reference")
    finest = _run(scene(2 * max(counts), "smooth"), 1)
    return [row | _errors(row, finest) for row in rows]


def _run(given: Scene, fewest: int) -> dict[str, Any]:
    given = normalise(given)
    state = prepare(given).state

    def program(given: Scene, state: Any) -> Any:
        return simulate(given, dt=DT, frames=FRAMES, initial=state)

    made = timed(program, given, state, fewest=fewest)
    run = made.value
    if not bool(run.ok):
        return {"reason": f"the run failed {run.failure.describe()}"}
    late = np.asarray(run.time) > RUN_UP
    force, slip = np.asarray(run.rollers["turn"].force)[late], np.asarray(run.rollers["drive"].slip)[late]
    return {
        "compile_seconds": made.compile,
        "us_per_step": 1e6 * made.run / int(run.steps),
        "force_n": float(np.mean(force)),
        "force_ripple_n": float(np.std(force)),
        "slip_mm_s": float(np.mean(slip)),
        "slip_ripple_mm_s": float(np.std(slip)),
        "lead_mm": float(run.sheets["sheet"].nodes[-1, 0, 0]),
    }


def _errors(row: dict[str, Any], finest: dict[str, Any]) -> dict[str, float]:
    """None where either run failed."""
    pairs = {"force_error_n": "force_n", "lead_error_mm": "lead_mm"}
    return {new: abs(row[old] - finest[old]) for new, old in pairs.items() if old in row and old in finest}
