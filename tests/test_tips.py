"""Where the face of a guide ends: a corner of a sheet is felt once, by the face before the end and by the rounded tip past it."""

import numpy as np
import pytest

import diffeed
from diffeed import ArcGuide, CircleGuide, Clamp, Contact, LineGuide, Load, Motion, Sheet
from diffeed.base.records import replace
from diffeed.chain.state import initial_state
from diffeed.model.build import build
from diffeed.pair.shapes import HANDED
from diffeed.readings.snapshot import snapshot

STIFFNESS, SMOOTHING, HALF = 200.0, 2e-3, 0.1
"""N/mm, mm, and half the thickness of the sheet, mm."""


def scene(x, y, guide, skin="bars", heading=-60.0, **more):
    sheet = Sheet(length=20.0, thickness=2.0 * HALF, width=30.0, density=1e-6, youngs_modulus=3000.0, lead=(x, y),
                  heading=heading, bars=1 if skin == "bars" else 4)  # fmt: skip
    contact = Contact(stiffness=STIFFNESS, smoothing=SMOOTHING, friction_law="none", damped=False)
    return diffeed.scene(**{
        "sheets": {"a": sheet}, "guides": {"end": guide}, "contacts": {"default": contact}, "gravity": (0.0, 0.0),
        "duration": 1e-6, "initial": "given", "skin": skin,
    } | more)  # fmt: skip


def force(x, y, guide, **more):
    run = diffeed.simulate(scene(x, y, guide, **more), dt=1e-6, frames=2)
    return float(run.guides["end"].force[0])


def by_hand(penetration):
    """k (d - s/2) of the ramp beyond its smoothing length."""
    assert penetration > SMOOTHING
    return STIFFNESS * (penetration - 0.5 * SMOOTHING)


# A face along y = 0 that ends at the origin, its sheet above: straight, round and hollow.
GUIDES = {
    "line": lambda tip: LineGuide(start=(-100.0, 0.0), end=(0.0, 0.0), friction=0.0, tip_radius=tip),
    "line that begins there": lambda tip: LineGuide(start=(0.0, 0.0), end=(-100.0, 0.0), friction=0.0, tip_radius=tip),
    "outside": lambda tip: ArcGuide(center=(0.0, -1e4), radius=1e4, start_angle=95.0, sweep=-5.0, side="outside", friction=0.0,
                                    tip_radius=tip),
    "inside": lambda tip: ArcGuide(center=(0.0, 1e4), radius=1e4, start_angle=-90.0, sweep=-5.0, side="inside", friction=0.0,
                                   tip_radius=tip),
}  # fmt: skip


@pytest.mark.parametrize("skin", ["bars", "smooth"])
@pytest.mark.parametrize("kind", [k for k in GUIDES if k != "line that begins there"])
@pytest.mark.parametrize("tip", [0.1, 0.5])
def test_a_lead_at_the_end_of_a_guide_is_pushed_once(kind, skin, tip):
    guide = GUIDES[kind](tip)
    handed = HANDED * (tip + HALF)  # over so much before the end the face hands over to the tip
    for x in (-0.3, -handed, 0.0, 1e-9):
        assert force(x, 0.05, guide, skin=skin) == pytest.approx(by_hand(HALF - 0.05), rel=1e-3), x
    for x in np.linspace(-handed, 0.0, 9)[1:-1]:
        assert 0.9 * by_hand(HALF - 0.05) < force(x, 0.05, guide, skin=skin) <= 1.001 * by_hand(HALF - 0.05), x
    for x in (0.03, 0.06):
        penetration = HALF + tip - np.hypot(x, 0.05 + tip)
        assert force(x, 0.05, guide, skin=skin) == pytest.approx(by_hand(penetration), rel=1e-6), x


def test_a_tail_at_the_end_of_a_guide_is_pushed_once():
    """Turned about, with the face's other end."""
    guide = LineGuide(start=(0.0, 0.0), end=(100.0, 0.0), friction=0.0, tip_radius=0.5)
    for x, penetration in ((0.2, HALF - 0.05), (-0.03, HALF + 0.5 - np.hypot(0.03, 0.55))):
        turn = np.deg2rad(120.0)
        lead = x + 20.0 * np.cos(turn), 0.05 + 20.0 * np.sin(turn)
        assert force(*lead, guide, heading=120.0) == pytest.approx(by_hand(penetration), rel=1e-6)


@pytest.mark.parametrize("skin", ["bars", "smooth"])
def test_what_a_tip_touches_between_the_corners_it_feels_alone(skin):
    """A sheet that lies across a tip, its corners far away."""
    guide = LineGuide(start=(-100.0, -20.0), end=(0.0, 0.0), friction=0.0, tip_radius=0.5)
    normal = np.array([-20.0, 100.0]) / np.hypot(20.0, 100.0)
    centre = -0.5 * normal
    found = force(8.0, centre[1] + 0.5 + 0.05, guide, heading=0.0, skin=skin)
    assert found == pytest.approx(by_hand(HALF - 0.05), rel=1e-3)


def test_the_end_of_a_guide_that_swings_is_where_it_has_come_to():
    """At 1 s the face points along y, its sheet on the left: what was past its end may stand on it, and the other way about."""
    turned = Motion(times=(0.0, 1.0), displacement=np.zeros((2, 2)), rotation=(0.0, 90.0))
    guide = LineGuide(start=(-100.0, 0.0), end=(0.0, 0.0), friction=0.0, tip_radius=0.5, motion=turned)
    for y, penetration in ((-0.3, HALF - 0.05), (0.05, HALF + 0.5 - np.hypot(0.05, 0.55))):
        start = scene(-0.05, y, guide, heading=30.0)
        model = build(start)
        _, _, guides = snapshot(model, replace(initial_state(model, start), time=np.asarray(1.0)))
        assert float(guides["end"].force) == pytest.approx(by_hand(penetration), rel=1e-6)


def test_a_sheet_that_stands_on_an_end_sinks_in_by_one_stiffness():
    load = Load(sheet="a", at="tail", force=(0.0, -4.0))
    clamps = {"upright": Clamp(sheet="a", at=0, kind="bar", free="y")}
    for guide in (GUIDES["line"](0.5), CircleGuide(center=(0.0, -0.5), radius=0.5, friction=0.0)):
        rest = diffeed.settle(scene(0.0, 0.09, guide, heading=-90.0, loads={"down": load}, clamps=clamps))
        lead = float(rest.y[0]) - 10.0
        assert HALF - lead == pytest.approx(4.0 / STIFFNESS + 0.5 * SMOOTHING, rel=1e-6)
