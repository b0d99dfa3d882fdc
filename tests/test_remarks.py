"""What `check` refuses of guides that meet, and what is only remarked on."""

import numpy as np
import pytest

import diffeed
from diffeed import ArcGuide, FixedRoller, LineGuide, Motion, MovableRoller, Profile, Scene, Sheet
from diffeed.base.records import replace

NOTE = Sheet(length=72.0, thickness=0.1, width=140.0, density=9e-7, youngs_modulus=3000.0, bars=24)
FLOOR = LineGuide(start=(-20.0, 0.0), end=(0.0, 0.0))
TURN = ArcGuide(center=(0.0, 15.0), radius=15.0, start_angle=-90.0, sweep=40.0)


def guided(**guides):
    above = replace(NOTE, lead=(0.0, 60.0))
    return Scene(sheets={"note": above}, guides=guides, contacts={"default": diffeed.Contact()}, initial="given")


@pytest.mark.parametrize("backwards", [False, True])
def test_guides_that_go_on_in_each_other_bear_on_one_side(backwards):
    """However the arc is swept. The middle of a wedge and ends that do not meet are not judged."""
    turn = replace(TURN, start_angle=-50.0, sweep=-40.0) if backwards else TURN
    assert diffeed.check(guided(floor=FLOOR, turn=turn)) == []
    (said,) = diffeed.check(guided(floor=FLOOR, turn=replace(turn, side="outside")))
    assert said.startswith(
        "guides.floor and guides.turn go on in each other at [0.0, 0.0] but bear on opposite sides: turn one"
    )
    (said,) = diffeed.check(guided(floor=replace(FLOOR, start=(0.0, 0.0), end=(-20.0, 0.0)), turn=turn))
    assert "opposite sides" in said
    apart = replace(turn, center=(0.0, 15.1), side="outside")
    assert diffeed.check(guided(floor=FLOOR, turn=apart)) == []
    wedge = {
        "above": LineGuide(start=(0.0, 0.0), end=(20.0, 3.0)),
        "below": LineGuide(start=(20.0, -3.0), end=(0.0, 0.0)),
    }
    assert diffeed.check(guided(**wedge)) == []


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        ("sheets.note.youngs_modulus", 3e9, "sheets.note.youngs_modulus is 3e+09 N/mm2: in Pa?"),
        ("sheets.note.youngs_modulus", 3.0, "sheets.note.youngs_modulus is 3 N/mm2: in GPa?"),
        ("sheets.note.density", 900.0, "sheets.note.density is 900 kg/mm3: in other units?"),
        ("sheets.note.thickness", 1e-4, "sheets.note.thickness is 0.0001 mm: in other units?"),
        ("sheets.note.curl", 50.0, "sheets.note.curl is 50 1/mm, a radius of 0.02 mm: is it the radius?"),
        (
            "rollers.pinch.direction",
            (1.0, 0.1),
            "rollers.pinch.direction runs beside rollers.drive, not towards or away",
        ),
        ("gravity", (0.0, -9.81), "gravity is 9.81 mm/s2: in m/s2?"),
        (
            "contacts.default.damping",
            0.0,
            "contacts.default.damping is 0: what hits it at 100 mm/s is thrown back with 1 of",
        ),
        (
            "contacts.default.damping",
            0.2,
            "contacts.default.damping is 0.2: what hits it at 100 mm/s is thrown back with 0.94",
        ),
        (
            "contacts.default.damped",
            False,
            "contacts.default.damped is false: what hits it at 100 mm/s is thrown",
        ),
        ("sheets.note.width", 0.14, "sheets.note.width is 0.14 mm: in m? A4 is 210 mm wide"),
        ("sheets.note.heading", 1.5708, "sheets.note.heading is 1.5708 degrees: in radians? Then it is 90"),
        ("guides.turn.start_angle", -0.7854, "guides.turn.start_angle is -0.7854 degrees: in radians? Then it is -45"),
        ("sheets.note.bars", 8, "sheets.note.bars is 8: bars of 9 mm cannot follow guides.turn, whose radius is 15 mm"),
        ("rollers.drive.surface_speed", 9e4, "rollers.drive turns at up to 9e+04 mm/s: in mm/min? Divide by 60;"),
        ("guides.turn.sweep", 1.5708, "guides.turn.sweep is 1.5708 degrees: in radians?"),
        ("rollers.drive.surface_speed", -1.5, "rollers.drive turns at 1.5 mm/s at most: in m/s?"),
        (
            "rollers.pinch.preload",
            -4.0,
            "rollers.pinch.preload is -4 N, which opens the nip: the spring pushes against",
        ),
        (
            "rollers.pinch.direction",
            (0.0, -1.0),
            "rollers.pinch.direction points at rollers.drive, so that its preload opens",
        ),
    ],
)
def test_a_number_that_is_hardly_meant_is_remarked_on(part, change, said):
    ramp = Profile(times=[0.0, 0.1], values=[0.0, -1500.0])
    rollers = {
        "drive": FixedRoller(center=(0.0, -10.05), radius=10.0, surface_speed=ramp),
        "pinch": MovableRoller(center=(0.0, 10.05), direction=(0.0, 1.0), radius=10.0, mass=0.01, preload=4.0),
    }
    scene = diffeed.scene(sheets={"note": NOTE}, rollers=rollers, guides={"turn": TURN})
    assert diffeed.remarks(scene) == []
    (remark,) = diffeed.remarks(diffeed.put(scene, part, change))
    assert remark.startswith(said)


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        ("rollers.pinch.mass", 20.0, "rollers.pinch.mass is 20 kg: in g?"),
        ("rollers.drive.friction", 120.0, "rollers.drive.friction is 120: in percent?"),
        ("contacts.default.stiffness", 6e7, "contacts.default.stiffness is 6e+07: in N/m?"),
        ("duration", 0.001, "rollers.drive.surface_speed.times end at 0.02 s, but the run at 0.001 s: in ms?"),
    ],
)
def test_numbers_of_rollers_and_contacts_in_other_units(part, change, said):
    ramp = Profile(times=(0.0, 0.02), values=(0.0, -300.0))
    rollers = {
        "drive": FixedRoller(center=(0.0, -10.05), radius=10.0, surface_speed=ramp),
        "pinch": MovableRoller(center=(0.0, 10.05), direction=(0.0, 1.0), radius=10.0, mass=0.01, preload=4.0),
    }
    scene = diffeed.scene(sheets={"note": NOTE}, rollers=rollers, duration=0.02)
    assert diffeed.remarks(scene) == []
    (remark,) = diffeed.remarks(diffeed.put(scene, part, change))
    assert remark.startswith(said)


def test_a_profile_of_one_point_changes_nothing():
    steady = Profile(times=(0.0,), values=(-300.0,))
    drive = FixedRoller(center=(0.0, -10.05), radius=10.0, surface_speed=steady)
    assert diffeed.remarks(diffeed.scene(sheets={"note": NOTE}, rollers={"drive": drive}, duration=0.02)) == []


@pytest.mark.parametrize(
    ("times", "turn", "said"),
    [
        ((0.0, 20.0), 14.0, "guides.flap.motion.times end at 20 s, but the run at 0.02 s: in ms?"),
        ((0.0, 0.02), 0.244, "guides.flap.motion.rotation is 0.244 degrees at most: in radians?"),
        ((0.02, 0.05), 14.0, "guides.flap.motion changes nothing before 0.02 s, but the run ends at 0.02 s"),
        ((0.019, 0.05), 14.0, None),
        ((0.02, 0.05), 0.0, None),
        ((0.0, 0.02), 14.0, None),
    ],
)
def test_movements_in_other_units(times, turn, said):
    swing = Motion(times=times, displacement=np.zeros((2, 2)), rotation=(0.0, turn))
    flap = LineGuide(start=(-20.0, -5.0), end=(0.0, -5.0), motion=swing)
    found = diffeed.remarks(diffeed.scene(sheets={"note": NOTE}, guides={"flap": flap}, duration=0.02))
    assert [f.startswith(said) for f in found] == [True] if said else found == []


@pytest.mark.parametrize(
    ("at", "pivot", "told"), [(100.0, (0.0, 0.0), True), (100.0, (80.0, -5.0), False), (10.0, (0.0, 0.0), False)]
)
def test_a_part_that_swings_about_an_origin_far_away(at, pivot, told):
    swing = Motion(times=(0.0, 0.02), displacement=np.zeros((2, 2)), rotation=(0.0, 14.0), pivot=pivot)
    flap = LineGuide(start=(at, -5.0), end=(at + 20.0, -5.0), motion=swing)
    found = diffeed.remarks(diffeed.scene(sheets={"note": NOTE}, guides={"flap": flap}, duration=0.02))
    said = "guides.flap.motion.pivot is (0, 0), 100 mm from the part: was it forgotten?"
    assert [f.startswith(said) for f in found] == [True] * told


def test_the_faces_of_a_blade_that_is_thinner_than_they_feel():
    """A millimetre apart each catches, up to 3 mm behind it, what lies on the other."""

    def blade(apart, **changes):
        left = replace(LineGuide(start=(0.0, 0.0), end=(0.0, 30.0)), **changes)
        right = replace(LineGuide(start=(apart, 30.0), end=(apart, 2.0)), **changes)
        return diffeed.remarks(guided(left=left, right=right))

    one, two = blade(1.0)
    assert one.startswith(
        "guides.left and guides.right are back to back, 1 mm apart, which is less than guides.left.depth, 3 mm"
    )
    assert two.startswith("guides.right and guides.left are back to back")
    assert blade(1.0, depth=0.4) == blade(3.5) == []
    assert blade(-1.0) == []  # a channel, its faces towards each other
    beside = LineGuide(start=(1.0, 80.0), end=(1.0, 40.0))
    assert diffeed.remarks(guided(left=LineGuide(start=(0.0, 0.0), end=(0.0, 30.0)), right=beside)) == []


def test_a_pinch_that_its_stop_holds_off_is_remarked_on():
    drive = FixedRoller(center=(0.0, -10.05), radius=10.0, surface_speed=300.0)
    pinch = MovableRoller(center=(0.0, 10.5), direction=(0.0, 1.0), radius=10.0, mass=0.01, preload=4.0, travel_min=0.0)
    (remark,) = diffeed.remarks(diffeed.scene(sheets={"note": NOTE}, rollers={"drive": drive, "pinch": pinch}))
    assert remark.startswith(
        "rollers.pinch stops 0.55 mm before rollers.drive (travel_min = 0 mm): no sheet is pressed there"
    )
    for stop in (None, -0.5):
        free = replace(pinch, travel_min=stop)
        assert diffeed.remarks(diffeed.scene(sheets={"note": NOTE}, rollers={"drive": drive, "pinch": free})) == []


def test_a_shaft_whose_speed_is_in_rpm():
    drive = FixedRoller(center=(0.0, -10.05), radius=10.0, angular_speed=-955.0)
    (remark,) = diffeed.remarks(diffeed.scene(sheets={"note": NOTE}, rollers={"drive": drive}))
    assert remark.startswith("rollers.drive turns at up to 9550 mm/s: in rpm? 1 rpm is 0.1047 rad/s")


@pytest.mark.parametrize(
    ("angles", "told"), [(np.arange(-70, 71) / 10.0, False), ((1.05, 45.0), False), ((3.14, -1.57, 0.524), True)]
)
def test_angles_in_degrees_are_not_remarked_on(angles, told):
    for angle in angles:
        found = diffeed.remarks(diffeed.scene(sheets={"note": replace(NOTE, heading=angle)}))
        assert [f.startswith(f"sheets.note.heading is {angle:g} degrees: in radians?") for f in found] == [True] * told


@pytest.mark.parametrize(
    ("guide", "nearest"),
    [
        (LineGuide(start=(-20.0, -7.0), end=(20.0, -7.0)), "3"),
        (LineGuide(start=(-20.0, -7.0), end=(-2.0, -7.0)), "3.6"),
        (LineGuide(start=(-20.0, -7.0), end=(-8.0, -7.0)), None),
        (LineGuide(start=(-20.0, -1.0), end=(20.0, -1.0)), None),  # the roller looks out of its slot
        (ArcGuide(center=(0.0, 13.0), radius=20.0, start_angle=-135.0, sweep=90.0), "3"),
        (ArcGuide(center=(0.0, 13.0), radius=20.0, start_angle=-45.0, sweep=270.0), None),
    ],
)
def test_a_guide_through_a_roller(guide, nearest):
    drive = FixedRoller(center=(0.0, -10.0), radius=10.0, surface_speed=300.0)
    high = replace(NOTE, lead=(0.0, 60.0))
    found = diffeed.remarks(diffeed.scene(sheets={"note": high}, rollers={"drive": drive}, guides={"floor": guide}))
    said = f"guides.floor runs through rollers.drive, {nearest} mm from its centre"
    assert [f.startswith(said) for f in found] == ([True] if nearest else [])


def test_a_run_far_too_long_is_remarked_on():
    scene = diffeed.load_scene("film_feeder")
    assert diffeed.remarks(scene) == []
    (remark,) = diffeed.remarks(replace(scene, duration=1500.0))
    assert remark.startswith("duration is 1500 s, in which the drives feed")


@pytest.mark.parametrize("name", diffeed.shipped_scenes())
def test_nothing_is_unusual_about_shipped_scenes(name):
    assert diffeed.remarks(diffeed.load_scene(name)) == []


def test_what_is_wrong_or_traced_is_not_remarked_on():
    """That is for `check`; a remark is never an error."""
    odd = Scene(
        sheets={"note": replace(NOTE, density="heavy", thickness=np.nan)},
        rollers={"r": FixedRoller(center=None, radius=None)},
    )
    assert diffeed.remarks(odd) == []
