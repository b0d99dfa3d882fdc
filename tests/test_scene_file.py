import os
import tomllib

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffeed.base.records import fields, replace
from diffeed.input import scene_file
from diffeed.input.check_records import SceneError, check_records
from diffeed.input.parts import (
    SECTIONS,
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
    Sensor,
    Sheet,
    normalise,
)
from diffeed.input.paths import numbers
from diffeed.input.scene_file import load_scene, save_scene, scene_text, shipped_scenes

FILM = """
[sheets.film]
length = 200.0
thickness = 0.5
width = 35.0
density = 2.2e-6
youngs_modulus = 2250.0
"""
DRIVE = """
[rollers.drive]
kind = "fixed"
center = [0.0, -10.0]
radius = 10.0
"""


def read(folder, text: str) -> Scene:
    file = folder / "scene.toml"
    file.write_text(text, encoding="utf-8")
    return load_scene(file)


def problems_of(folder, text: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        read(folder, text)
    return caught.value.problems


def assert_same(a: Scene, b: Scene) -> None:
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for (path, x), y in zip(jax.tree.leaves_with_path(a), jax.tree.leaves(b), strict=True):
        assert (x.dtype, x.shape) == (y.dtype, y.shape), path
        assert np.asarray(x).tobytes() == np.asarray(y).tobytes(), path


def full_scene(x: float = 0.1, y: float = 1.0 / 3.0) -> Scene:
    """Every kind of part with every field off its default; x and y > 0."""
    motion = Motion(times=(0.0, x), displacement=((x, -y), (y, 0.0)), rotation=(-x, y), pivot=(x, y))
    profile = Profile(times=(-x, 0.0, y), values=(x, -0.0, -y))
    film = Sheet(
        length=1e3 * x, thickness=x, width=y, density=y, youngs_modulus=x, structural_damping=y, bars=3, lead=(x, -y),
        heading=-x, curl=y, speed=x, friction_factor=y, headings=(x, y, -x), rates=(y, x, -y), velocity=(-x, y),
    )  # fmt: skip
    fixed = FixedRoller(
        center=(x, y), radius=y, friction=x, angular_speed=profile, inertia=y, bearing_drag=x, spin=-y, motion=motion,
        contact="rubber",
    )  # fmt: skip
    movable = MovableRoller(
        center=(x, y), direction=(y, -x), radius=x, mass=y, inertia=x, spring=y, preload=-x, damper=y, friction=x,
        surface_speed=y, bearing_drag=x, spin=y, travel=-x, travel_min=-y, travel_max=x, stop_stiffness=y,
        contact="rubber",
    )  # fmt: skip
    shared = {"friction": y, "motion": motion, "contact": "rubber"}
    guides = {
        "line": LineGuide(start=(x, y), end=(-x, y), depth=x, tip_radius=y, **shared),
        "arc": ArcGuide(
            center=(x, y), radius=y, start_angle=x, sweep=-1.0, depth=x, tip_radius=x, side="outside", **shared
        ),
        "circle": CircleGuide(center=(x, y), radius=x, **shared),
    }
    rubber = Contact(
        stiffness=x, exponent=y, damping=x, damping_exponent=y, smoothing=x, stick_speed=y, static_ratio=x,
        transition_speed=y, stick_displacement=x, friction_law="tanh", damped=False,
    )  # fmt: skip
    clamp = Clamp(sheet="film", at="lead", kind="wall", free="x", displacement=(x, y), rotation=x, motion=motion)
    return Scene(
        sheets={"film": film},
        rollers={"fixed": fixed, "movable": movable, "other": replace(fixed, angular_speed=-y)},
        guides=guides,
        contacts={"rubber": rubber},
        clamps={"hold": clamp, "end": replace(clamp, at="lead")},
        loads={"tip": Load(sheet="film", at=2, force=(x, -y), moment=-x)},
        sensors={"exit": Sensor(position=(x, y), direction=(-y, x), range=y)},
        gravity=(x, -y),
        duration=y,
        initial="given",
        goal="exit",
    )


def test_every_field_of_the_full_scene_differs_from_its_default():
    """Otherwise the round trip below would not notice that a field is never written."""
    scene, table = full_scene(), tomllib.loads(scene_text(full_scene()))
    kinds = set()
    for section in SECTIONS:
        for name, part in getattr(scene, section).items():
            kinds.add(type(part))
            missing = {f.name for f in fields(part)} - table[section][name].keys()
            assert missing <= {"angular_speed", "surface_speed"}, f"{section}.{name}"
    assert kinds == {kind for section in SECTIONS.values() for kind in section.values()}
    assert {"gravity", "duration", "initial", "goal"} < table.keys()


@pytest.mark.parametrize("scene", [full_scene(), load_scene("film_feeder")], ids=["full", "film_feeder"])
def test_round_trip_is_exact(tmp_path, scene):
    save_scene(scene, tmp_path / "saved.toml")
    assert_same(load_scene(tmp_path / "saved.toml"), normalise(scene))
    assert os.listdir(tmp_path) == ["saved.toml"]


@pytest.mark.parametrize("scene", [full_scene(), Scene(sheets=full_scene().sheets)], ids=["full", "short"])
def test_round_trip_is_exact_in_float32(tmp_path, scene):
    with jax.enable_x64(False):
        save_scene(scene, tmp_path / "saved.toml")
        again = load_scene(tmp_path / "saved.toml")
        assert_same(again, normalise(scene))
        assert again.gravity.dtype == np.float32


_POSITIVE = st.floats(min_value=1e-200, max_value=1e200)


@settings(max_examples=25, deadline=None)
@given(x=_POSITIVE, y=_POSITIVE)
def test_round_trip_is_exact_for_any_value(tmp_path_factory, x, y):
    scene = full_scene(x, y)
    sheets = {"film": replace(scene.sheets["film"], length=1e201)}
    scene = replace(scene, sheets=sheets)
    file = tmp_path_factory.mktemp("any") / "saved.toml"
    save_scene(scene, file)
    assert_same(load_scene(file), normalise(scene))


def test_a_minus_zero_is_kept_though_the_default_is_plus_zero(tmp_path):
    scene = replace(full_scene(), gravity=(-0.0, -9810.0))
    save_scene(scene, tmp_path / "saved.toml")
    assert np.signbit(load_scene(tmp_path / "saved.toml").gravity[0])


def test_only_what_is_required_or_not_default_is_written():
    film = Sheet(length=200, thickness=0.5, width=35.0, density=2.2e-6, youngs_modulus=2250.0)
    assert scene_text(Scene(sheets={"film": film})) == FILM.lstrip().replace("e-6", "e-06") + "\n[contacts.default]\n"


def test_saving_replaces_a_file_whole_and_refuses_a_bad_scene(tmp_path):
    file = tmp_path / "saved.toml"
    file.write_text("old")
    with pytest.raises(SceneError):
        save_scene(replace(full_scene(), duration=-1.0), file)
    assert file.read_text() == "old"
    save_scene(full_scene(), file)
    assert file.read_text() == scene_text(full_scene())


def test_a_failed_write_leaves_the_old_file_and_no_draft(tmp_path, monkeypatch):
    file = tmp_path / "saved.toml"
    file.write_text("old")
    monkeypatch.setattr(scene_file.os, "fsync", lambda _: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        save_scene(full_scene(), file)
    assert (os.listdir(tmp_path), file.read_text()) == (["saved.toml"], "old")


def test_order_of_names_does_not_matter(tmp_path):
    two = DRIVE + DRIVE.replace("drive", "a_drive").replace("radius = 10.0", "radius = 12.0")
    swapped = DRIVE.replace("drive", "a_drive").replace("radius = 10.0", "radius = 12.0") + DRIVE
    assert_same(read(tmp_path, two + FILM), read(tmp_path, FILM + swapped))
    assert read(tmp_path, two + FILM).rollers["a_drive"].radius == 12.0


def test_film_feeder_is_shipped_with_a_description():
    assert shipped_scenes()["film_feeder"].startswith("The film feeding machine")
    scene = load_scene("film_feeder")
    assert check_records(scene) == []
    assert (len(scene.rollers), len(scene.guides), len(numbers(scene)) > 100) == (7, 7, True)


@pytest.mark.parametrize("name", list(shipped_scenes()))
def test_every_shipped_scene_loads_and_says_what_it_is(name):
    assert load_scene(name).sheets
    assert len(shipped_scenes()[name]) > 20


def test_profile_and_motion_in_a_file(tmp_path):
    text = FILM + DRIVE + "angular_speed = {times = [0, 0.1], values = [0, -30]}\n"
    text += "[rollers.drive.motion]\ntimes = [0, 1]\ndisplacement = [[0, 0], [1, 2]]\nrotation = [0, 5]\n"
    drive = read(tmp_path, text).rollers["drive"]
    assert drive.angular_speed.values.tolist() == [0.0, -30.0]
    assert drive.motion.displacement.tolist() == [[0.0, 0.0], [1.0, 2.0]]


def test_windows_line_ends_and_byte_order_mark(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_bytes(b"\xef\xbb\xbf" + FILM.replace("\n", "\r\n").encode())
    assert load_scene(str(file)).sheets["film"].length == 200.0


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        (FILM + DRIVE + "radus = 3", 'rollers.drive.radus is not a field of FixedRoller; did you mean "radius"?'),
        (FILM + "[roller.x]", 'roller is not a field of Scene; did you mean "rollers"?'),
        ("durations = 1\n" + FILM, 'durations is not a field of Scene; did you mean "duration"?'),
        (FILM + DRIVE.replace("radius = 10.0", ""), "rollers.drive.radius is missing: it must be a number > 0 in mm"),
        (
            FILM + DRIVE.replace('"fixed"', '"fixd"'),
            'must be "fixed" or "movable", but is "fixd"; did you mean "fixed"?',
        ),
        (FILM + DRIVE.replace('kind = "fixed"', ""), 'rollers.drive.kind is missing: it must be "fixed" or "movable"'),
        (FILM + DRIVE.replace('"fixed"', "[1]"), 'rollers.drive.kind must be "fixed" or "movable", but is [1]'),
        (FILM + 'kind = "sheet"', "sheets.film.kind is not a field of Sheet"),
        (FILM + DRIVE + 'motion = "x"', "rollers.drive.motion must be a Motion"),
        (FILM + DRIVE + "motion = {}", "rollers.drive.motion.times is missing"),
        (
            FILM + DRIVE + "angular_speed = {time = [0.0]}",
            'angular_speed.time is not a field of Profile; did you mean "ti',
        ),
        (FILM + DRIVE + "friction = {times = [0.0]}", "rollers.drive.friction must be a number >= 0, but is a table"),
        (FILM + DRIVE + "friction = 2024-01-01", "rollers.drive.friction must be a number >= 0, but is datetime.date"),
        (FILM + DRIVE + "friction = nan", "rollers.drive.friction must be finite, but is nan"),
        ("rollers = 3\n" + FILM, "rollers must be a table of named parts, but is 3"),
        (
            FILM + "[rollers]\ndrive = 3",
            "rollers.drive must be a FixedRoller or MovableRoller (in a file: a table [roll",
        ),
        (FILM + "[[guides]]\nx = 3", "guides must be a table of named parts"),
        (FILM + '[contacts."a b"]', 'contacts: a name must be made of letters A-Z a-z, digits and _, but is "a b"'),
        ("", "sheets must hold at least one sheet"),
        ("a = 1\nb = = 2", 'Invalid value, line 2: "b = = 2"'),
        ("a = 1\na = 2", 'this is given a second time, line 2: "a = 2"'),
        ("[sheets.a]\n[sheets.a]", 'this is given a second time, line 2: "[sheets.a]"'),
        ("a = [" + "1, " * 99 + "b]", "1, 1, 1..."),
        ("a = 1\n\ufeff", r'Invalid statement, line 2: "\ufeff"'),
        ("a = " + "[" * 100_000, "nests tables or lists too deeply"),
        ("a = " + "1" * 5000, "not readable TOML"),
    ],
)
def test_problems_of_a_file(tmp_path, text, fragment):
    assert any(fragment in p for p in problems_of(tmp_path, text)), problems_of(tmp_path, text)


def test_every_problem_of_a_file_is_told_at_once(tmp_path):
    text = "goal = 'x'\n" + FILM.replace("35.0", "-35.0") + "colour = 'red'" + DRIVE.replace("10.0]", "nan]")
    assert problems_of(tmp_path, text) == [
        "sheets.film.colour is not a field of Sheet" + problems_of(tmp_path, text)[0].partition("Sheet")[2],
        "sheets.film.width must be > 0 mm, but is -35.0",
        "rollers.drive.center must be finite, but is [0.0, nan]",
        'goal must be the name of a sensor, but is "x"; there is none',
    ]


@pytest.mark.parametrize("name", ["film_feder", "no/such/file.toml", ".", "a\0b", "x" * 5000, ""])
def test_a_missing_file_names_the_shipped_scenes(name):
    with pytest.raises(SceneError, match=r"shipped scenes:.* film_feeder"):
        load_scene(name)


def test_a_file_that_is_too_large_or_not_text(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_bytes(b"#" * (scene_file.MAX_BYTES + 1))
    with pytest.raises(SceneError, match="must be <= 10 MB"):
        load_scene(file)
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(SceneError, match="not readable TOML"):
        load_scene(file)
