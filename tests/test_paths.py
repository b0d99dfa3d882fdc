import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed.input.parts import FixedRoller, LineGuide, Motion, MovableRoller, Profile, Scene, Sheet, normalise
from diffeed.input.paths import PathError, get, numbers, parse_assignment, put, unit


def raw_scene() -> Scene:
    film = Sheet(length=100, thickness=0.1, width=30.0, density=1e-6, youngs_modulus=2000.0, bars=4)
    ramp = Profile(times=[0.0, 0.1, 0.2], values=[0.0, -10.0, -30.0])
    swing = Motion(times=(0.0, 1.0), displacement=((0.0, 0.0), (1.0, 2.0)), rotation=(0.0, 5.0))
    rollers = {
        "drive": FixedRoller(center=(1.0, 2.0), radius=10.0, angular_speed=ramp),
        "pinch": MovableRoller(center=[1.0, 22.0], direction=(0.0, 1.0), radius=10.0, mass=0.02, preload=5.0),
    }
    guides = {"flap": LineGuide(start=(0.0, 0.0), end=(5.0, 0.0), motion=swing)}
    return Scene(sheets={"film": film}, rollers=rollers, guides=guides)


VALUES = {
    "rollers.pinch.preload": 5.0,
    "rollers.drive.center[1]": 2.0,
    "rollers.drive.angular_speed.values[2]": -30.0,
    "guides.flap.motion.displacement[1][0]": 1.0,
    "gravity[1]": -9810.0,
    "sheets.film.bars": 4,
    "duration": 1.0,
}


@pytest.mark.parametrize("form", [raw_scene, lambda: normalise(raw_scene())])
@pytest.mark.parametrize("path", VALUES)
def test_get_finds_what_was_written(form, path):
    assert get(form(), path) == VALUES[path]


@pytest.mark.parametrize("form", [raw_scene, lambda: normalise(raw_scene())])
@pytest.mark.parametrize("path", VALUES)
def test_put_changes_that_value_and_nothing_else(form, path):
    old = form()
    new = put(old, path, 7)
    assert get(new, path) == 7
    assert get(old, path) == VALUES[path]
    assert {p: float(v) for p, v in numbers(new).items() if p != path} == {
        p: float(v) for p, v in numbers(old).items() if p != path
    }


def test_put_takes_words_parts_profiles_and_none():
    scene = normalise(raw_scene())
    assert get(put(scene, "rollers.drive.contact", "rubber"), "rollers.drive.contact") == "rubber"
    guide = LineGuide(start=(0.0, 0.0), end=(9.0, 0.0))
    assert get(put(scene, "guides.flap", guide), "guides.flap") is guide
    profile = put(scene, "rollers.drive.angular_speed", Profile(times=(0, 1), values=(0, 3)))
    assert profile.rollers["drive"].angular_speed.values.dtype == jnp.float64
    assert put(scene, "rollers.drive.angular_speed", "none").rollers["drive"].angular_speed is None
    assert put(scene, "rollers.drive.contact", "none").rollers["drive"].contact == "none"


def test_put_numbers_become_float_arrays_so_that_grad_accepts_the_scene():
    scene = put(normalise(raw_scene()), "rollers.drive.radius", 12)
    gradient = jax.grad(lambda s: get(s, "rollers.drive.radius") ** 2 + s.gravity.sum())(scene)
    assert get(gradient, "rollers.drive.radius") == 24.0
    assert numbers(gradient)["gravity[1]"] == 1.0


@pytest.mark.parametrize("path", ["rollers.pinch.preload", "rollers.drive.center[1]", "gravity[0]"])
def test_put_is_differentiable_under_jit(path):
    scene = normalise(raw_scene())
    slope = jax.jit(jax.grad(lambda x: get(put(scene, path, x), path) ** 3))(2.0)
    assert slope == pytest.approx(12.0, rel=1e-12)


def test_put_under_vmap_and_into_a_batch():
    scene, x = normalise(raw_scene()), jnp.arange(3.0)
    batch = jax.vmap(lambda v: put(scene, "rollers.drive.center[1]", v))(x)
    np.testing.assert_array_equal(get(batch, "rollers.drive.center[1]"), x)
    np.testing.assert_array_equal(get(put(batch, "rollers.drive.center[0]", x + 5), "rollers.drive.center[0]"), x + 5)
    with pytest.raises(PathError, match="2 entries"):
        get(batch, "rollers.drive.center[2]")


def test_numbers_lists_each_entry_once_and_put_of_them_all_changes_nothing():
    scene = normalise(raw_scene())
    listed = numbers(scene)
    assert len(listed) == sum(leaf.size for leaf in jax.tree.leaves(scene))
    assert "sheets.film.headings[0]" not in listed
    assert all(get(scene, path) == value for path, value in listed.items())


@pytest.mark.parametrize(
    ("path", "fragment"),
    [
        ("rollers.pinch.prelod", 'did you mean "preload"'),
        ("roller.pinch.preload", 'did you mean "rollers"'),
        ("rollers.pinh.preload", 'did you mean "pinch"'),
        ("rollers.zzzzzz", '"drive", "pinch"'),
        ("clamps.hold.kind", "clamps holds nothing"),
        ("rollers.pinch.radius.x", "rollers.pinch.radius has no fields"),
        ("gravity[2]", "2 entries"),
        ("rollers.pinch.radius[0]", "one number"),
        ("rollers.drive.angular_speed[0]", "name its .values"),
        ("sheets.film.headings[0]", "needs a vector"),
        ("guides.flap.motion.displacement[0][2]", "2 x 2"),
        ("a..b", "must read like"),
        ("gravity[-1]", "must read like"),
        ("gravity[0].x", "must read like"),
        ("", "must read like"),
    ],
)
def test_wrong_path_says_what_is_wrong(path, fragment):
    scene = normalise(raw_scene())
    for attempt in (lambda: get(scene, path), lambda: put(scene, path, 1.0)):
        with pytest.raises(PathError) as caught:
            attempt()
        assert fragment in str(caught.value)
        assert path in str(caught.value)


def test_put_of_a_word_at_an_index_is_refused():
    with pytest.raises(PathError, match="must be a number"):
        put(normalise(raw_scene()), "gravity[0]", "down")


def test_a_word_in_place_of_a_number_is_refused():
    with pytest.raises(PathError, match=r'"sheets.film.width" must be a number, but is "wide"'):
        put(normalise(raw_scene()), "sheets.film.width", "wide")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("rollers.drive.radius=10.2", 10.2),
        ("sheets.film.bars = 30", 30),
        ("gravity=[0.0, -1.0]", [0.0, -1.0]),
        ("rollers.drive.contact=rubber", "rubber"),
        ('rollers.drive.contact="rubber"', "rubber"),
        ("rollers.drive.radius=10.2mm", "10.2mm"),
        ("a.b=1\nc=2", "1\nc=2"),
    ],
)
def test_parse_assignment(text, value):
    assert parse_assignment(text) == (text.split("=")[0].strip(), value)


def test_parse_assignment_reads_a_profile():
    _, profile = parse_assignment("rollers.drive.angular_speed={times=[0, 1], values=[0, 2]}")
    assert isinstance(profile, Profile)
    assert profile.values == [0, 2]


@pytest.mark.parametrize("text", ["radius", "=3", "a=", "a b=3"])
def test_wrong_assignment(text):
    with pytest.raises(PathError, match="must read"):
        parse_assignment(text)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("rollers.drive.angular_speed.values[1]", "rad/s"),
        ("rollers.drive.angular_speed.times[1]", "s"),
        ("rollers.pinch.preload", "N"),
    ],
)
def test_the_value_of_a_profile_has_the_unit_of_its_field(path, expected):
    assert unit(normalise(raw_scene()), path) == expected


def test_a_copy_has_dictionaries_of_its_own():
    scene = normalise(raw_scene())
    copy = put(scene, "sheets.film.thickness", 0.2)
    for section in ("sheets", "rollers", "guides", "contacts"):
        getattr(copy, section).clear()
    assert list(scene.guides) == ["flap"]
    assert set(scene.rollers) == {"drive", "pinch"}
    assert scene.sheets["film"].thickness == 0.1
    assert scene.contacts


def test_a_part_is_added_and_taken_away():
    scene = normalise(raw_scene())
    more = put(scene, "guides.shelf", LineGuide(start=(0.0, -3.0), end=(5.0, -3.0)))
    assert list(normalise(more).guides) == ["flap", "shelf"]
    assert get(more, "guides.shelf.start[1]") == -3.0
    for nothing in (None, "none"):
        assert list(put(more, "guides.flap", nothing).guides) == ["shelf"]
    assert list(scene.guides) == ["flap"]
    other = put(scene, "rollers.drive", MovableRoller(center=(0.0, 0.0), direction=(0.0, 1.0), radius=5.0, mass=0.01))
    assert get(other, "rollers.drive.mass") == 0.01


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("guides.flab", None, 'guides has no "flab"; did you mean "flap"?'),
        ("guides.shelf", 3.0, 'guides has no "shelf"'),
        ("guides.shelf", Sheet, "must be a LineGuide or ArcGuide or CircleGuide, or none, but is a"),
        ("rollers.pinch", 3.0, "must be a FixedRoller or MovableRoller, or none, but is 3"),
    ],
)
def test_what_is_no_part_is_refused(path, value, said):
    scene = normalise(raw_scene())
    with pytest.raises(PathError, match=re.escape(said)):
        put(scene, path, scene.sheets["film"] if value is Sheet else value)


def test_a_part_without_its_section_is_found():
    with pytest.raises(
        PathError, match=re.escape('"pinch.preload": a scene has no "pinch"; did you mean "rollers.pinch"?')
    ):
        put(normalise(raw_scene()), "pinch.preload", 3.0)


def test_what_is_no_scene_is_said():
    with pytest.raises(PathError, match=re.escape('is looked for in a scene, but this is "nip.toml"')):
        put("nip.toml", "rollers.pinch.preload", 3.0)
