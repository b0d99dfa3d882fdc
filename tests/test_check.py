import datetime
import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import diffeed
from diffeed.base.records import fields, replace
from diffeed.input.check_records import SceneError, check_records, checked, make_scene
from diffeed.input.parts import (
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
from diffeed.run.examine import check

SWING = Motion(times=[0.0, 0.5, 1.0], displacement=[[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]], rotation=[0.0, 10.0, 20.0])
RAMP = Profile(times=(0.0, 0.1), values=(0.0, -30.0))
SCENE = Scene(
    sheets={"film": Sheet(length=200, thickness=0.5, width=35.0, density=2e-6, youngs_modulus=2250.0)},
    rollers={
        "drive": FixedRoller(center=(0.0, -10.0), radius=10.0, angular_speed=RAMP, contact="rubber"),
        "pinch": MovableRoller(center=(0.0, 10.0), direction=(0.0, 1.0), radius=10, mass=0.02),
    },
    guides={
        "line": LineGuide(start=(0.0, 0.0), end=(10.0, 0.0), motion=SWING),
        "arc": ArcGuide(center=(0.0, 0.0), radius=80.0, start_angle=-90.0, sweep=60.0),
        "circle": CircleGuide(center=(5.0, 5.0), radius=2.0),
    },
    contacts={"rubber": Contact(stiffness=50.0)},
    clamps={"hold": Clamp(sheet="film", at=20)},
    loads={"tip": Load(sheet="film", force=(0.0, -0.1))},
    sensors={"exit": Sensor(position=(100.0, 0.0), direction=(1.0, 0.0))},
    goal="exit",
)


def changed(node: Any, path: list[str], value: Any) -> Any:
    """The scene with any object whatever at a path, so that bad ones can be tried."""
    if not path:
        return value
    head, rest = path[0], path[1:]
    if isinstance(node, dict):
        return {**node, head: changed(node.get(head), rest, value)}
    return replace(node, **{head: changed(getattr(node, head), rest, value)})


def problems_with(path: str, value: Any) -> list[str]:
    return check_records(changed(SCENE, path.split("."), value))


def test_a_sound_scene_has_no_problems_raw_or_normalised():
    assert check_records(SCENE) == []
    assert check_records(normalise(SCENE)) == []


NAN = float("nan")
BAD: list[tuple[str, Any, str]] = [
    ("rollers.pinch.radius", -2.0, "rollers.pinch.radius must be > 0 mm, but is -2.0"),
    ("rollers.pinch.radius", jnp.asarray(-2.0), "rollers.pinch.radius must be > 0 mm, but is -2.0"),
    ("rollers.pinch.radius", 0, "must be > 0 mm, but is 0"),
    ("rollers.pinch.damper", -1.0, "rollers.pinch.damper must be >= 0 N s/mm, but is -1.0"),
    ("rollers.pinch.radius", None, "rollers.pinch.radius is missing: it must be a number > 0 in mm"),
    ("rollers.pinch.radius", "ten", 'must be a number > 0 in mm, but is "ten"'),
    ("rollers.pinch.radius", True, "must be a number > 0 in mm, but is true"),
    ("rollers.pinch.radius", np.asarray(True), "must be a number"),
    ("rollers.pinch.radius", 1j, "must be a number"),
    ("rollers.pinch.radius", [1.0], "must be a number > 0 in mm, but is [1.0]"),
    ("rollers.pinch.radius", {"a": 1}, "but is a table"),
    ("rollers.pinch.radius", RAMP, "but is a profile"),
    ("rollers.pinch.radius", datetime.date(2024, 1, 1), "but is datetime.date(2024, 1, 1)"),
    ("rollers.pinch.radius", NAN, "must be finite, but is nan"),
    ("rollers.pinch.radius", float("inf"), "must be finite, but is inf"),
    ("rollers.pinch.radius", 10**400, "must be finite"),
    ("rollers.pinch.radius", 10**5000, "must be finite"),
    ("rollers.pinch.center", 3.0, "rollers.pinch.center must be 2 numbers in mm, but is 3.0"),
    ("rollers.pinch.center", (1.0, 2.0, 3.0), "must be 2 numbers in mm, but is (1.0, 2.0, 3.0)"),
    ("rollers.pinch.center", [[1.0, 2.0]], "must be 2 numbers"),
    ("rollers.pinch.center", [1.0, [2.0]], "must be 2 numbers"),
    ("rollers.pinch.center", [1.0, NAN], "must be finite, but is [1.0, nan]"),
    ("rollers.pinch.direction", (0.0, 0.0), "rollers.pinch.direction must not be zero"),
    ("rollers.pinch.direction", None, "rollers.pinch.direction is missing"),
    ("rollers.pinch.surface_speed", [1.0, 2.0], "or a profile {times = [...], values = [...]}"),
    ("rollers.pinch", SCENE.sheets["film"], "must be a FixedRoller or MovableRoller"),
    ("rollers.pinch", 3, "rollers.pinch must be a FixedRoller or MovableRoller (in a file: a table [rollers.pinch])"),
    (
        "rollers.drive.surface_speed",
        3.0,
        "rollers.drive must have one of angular_speed and surface_speed, but has both",
    ),
    ("rollers.drive.contact", "rubbr", 'must be the name of a contact set, but is "rubbr"; did you mean "rubber"?'),
    ("rollers.drive.contact", 3, "rollers.drive.contact must be a word (name of the contact set), but is 3"),
    ("rollers.drive.angular_speed.times", [0.1, 0.1], "times must increase, but 0.1 follows 0.1"),
    ("rollers.drive.angular_speed.times", [0.0, 1.0, 2.0], "must have one entry for each of the 3 times, but has 2"),
    ("rollers.drive.angular_speed.times", [], "angular_speed.times must be a list of one or more numbers in s"),
    ("rollers.drive.angular_speed.values", [0.0, "x"], "must be a list of one or more numbers, but is [0.0, 'x']"),
    ("guides.line.end", (0.0, 0.0), "guides.line.end must differ from start"),
    ("guides.line.motion", 3, "guides.line.motion must be a Motion"),
    ("guides.line.motion.times", [0.0, 1.0, 0.5], "guides.line.motion.times must increase, but 0.5 follows 1.0"),
    ("guides.line.motion.rotation", [0.0], "motion.rotation must have one entry for each of the 3 times, but has 1"),
    ("guides.line.motion.displacement", [1.0, 2.0, 3.0], "must be a list of one or more pairs of numbers in mm"),
    ("guides.arc.sweep", 0.0, "guides.arc.sweep must be from -360 to 360 deg and not 0"),
    ("guides.arc.sweep", -361, "guides.arc.sweep must be from -360 to 360 deg and not 0, but is -361"),
    ("guides.arc.side", "insde", 'guides.arc.side must be "inside" or "outside", but is "insde"'),
    ("guides.arc.side", ["inside"], 'must be "inside" or "outside"'),
    ("guides", [1], "guides must be a table of named parts, but is [1]"),
    ("guides", "none", 'guides must be a table of named parts, but is "none"'),
    ("guides.a b", SCENE.guides["line"], 'guides: a name must be made of letters A-Z a-z, digits and _, but is "a b"'),
    ("guides.new\n", SCENE.guides["line"], "a name must be made of"),
    ("contacts.rubber.smoothing", 0.0, "contacts.rubber.smoothing must be > 0 mm unless exponent > 1, but is 0.0"),
    ("contacts.rubber.friction_law", "tan", 'must be "sqrt" or "tanh"'),
    ("sheets", {}, "sheets must hold at least one sheet, but is empty"),
    ("sheets.film.bars", 0, "sheets.film.bars must be from 1 to 10000, but is 0"),
    ("sheets.film.bars", 10_001, "sheets.film.bars must be from 1 to 10000, but is 10001"),
    ("sheets.film.bars", 20.0, "sheets.film.bars must be a whole number, but is 20.0"),
    ("sheets.film.bars", True, "sheets.film.bars must be a whole number, but is true"),
    ("sheets.film.bars", None, "sheets.film.bars is missing: it must be a whole number"),
    ("sheets.film.bars", 500, "thickness must be <= the length of a bar (0.4 mm: length / bars), but is 0.5"),
    ("sheets.film.length", 0.2, "length / bars), but is 0.5; is sheets.film.length, 0.2 mm, in m?"),
    ("sheets.film.headings", [0.0] * 19, "sheets.film.headings must be 20 numbers in deg, one for each bar"),
    ("sheets.film.rates", 0.0, "sheets.film.rates must be 20 numbers in rad/s, one for each bar, but is 0.0"),
    ("clamps.hold.sheet", "fim", 'clamps.hold.sheet must be the name of a sheet, but is "fim"; did you mean "film"?'),
    ("clamps.hold.sheet", None, "clamps.hold.sheet is missing"),
    ("clamps.hold.at", 21, '"lead", "tail" or the number of a node (0 to 20), but is 21'),
    ("clamps.hold.at", -1, "(0 to 20), but is -1"),
    ("clamps.hold.at", "head", '"lead", "tail" or the number of a node, but is "head"'),
    ("clamps.hold.at", True, "the number of a node, but is true"),
    ("clamps.hold.at", 1.0, "the number of a node, but is 1.0"),
    ("clamps.hold.kind", "bar", "the number of a bar (0 to 19), but is 20"),
    ("clamps.hold.kind", np.array(["bar", "pin"]), "clamps.hold.kind must be"),
    ("clamps.hold.kind", "weld", 'clamps.hold.kind must be "pin" or "wall" or "bar"'),
    ("loads.tip.sheet", "x", "loads.tip.sheet must be the name of a sheet"),
    ("loads.tip.at", 99, "(0 to 20), but is 99"),
    ("sensors.exit.direction", (0.0, 0.0), "sensors.exit.direction must not be zero"),
    ("goal", "exitt", 'goal must be the name of a sensor, but is "exitt"; did you mean "exit"?'),
    ("goal", 3, "goal must be a word"),
    ("duration", 0, "duration must be finite and > 0 s, but is 0"),
    ("duration", NAN, "duration must be finite and > 0 s, but is nan"),
    ("duration", "1 s", 'duration must be a plain number, but is "1 s"'),
    ("initial", "rest", 'initial must be "settled" or "given", but is "rest"'),
    ("gravity", -9810.0, "gravity must be 2 numbers in mm/s2, but is -9810.0"),
    ("gravity", None, "gravity is missing"),
]


@pytest.mark.parametrize(("path", "value", "fragment"), BAD, ids=[f"{i}-{p}" for i, (p, _, _) in enumerate(BAD)])
def test_one_mistake_is_named_with_field_value_and_wish(path, value, fragment):
    if path == "sheets":  # the clamp and the load lose their sheet as well
        assert fragment in problems_with(path, value)
        return
    problems = problems_with(path, value)
    assert len(problems) == 1, problems
    assert fragment in problems[0]


def test_stops_in_the_wrong_order():
    pinch = replace(SCENE.rollers["pinch"], travel_min=2.0, travel_max=1.0)
    assert problems_with("rollers.pinch", pinch) == ["rollers.pinch.travel_min must be <= travel_max (1.0), but is 2.0"]


def test_no_smoothing_is_right_for_an_exponent_above_one():
    assert problems_with("contacts.rubber", Contact(smoothing=0.0, exponent=1.5)) == []


def test_the_default_contact_set_needs_no_entry():
    assert problems_with("contacts", {"rubber": Contact()}) == []


def test_parts_of_the_same_name_in_two_sections_are_fine():
    assert problems_with("guides.drive", SCENE.guides["line"]) == []


def test_a_deep_start_is_that_of_the_sheet_that_lies_deep():
    """Card may be pressed in by more than half of the paper beside it; and the bar is counted on its own sheet."""
    wide = {"length": 20.0, "width": 50.0, "density": 1e-6, "youngs_modulus": 2e3, "bars": 4}
    floor = LineGuide(start=(-100.0, 0.0), end=(100.0, 0.0))

    def found(card, paper):
        sheets = {
            "a_card": Sheet(**wide, thickness=1.0, lead=(40.0, 0.5 - card)),
            "paper": Sheet(**wide, thickness=0.1, lead=(10.0, 0.05 - paper)),
        }
        drive = FixedRoller(center=(0.0, -50.0), radius=5.0, angular_speed=1.0)
        return check(Scene(sheets=sheets, guides={"drive": floor}, rollers={"drive": drive}, initial="given"))

    assert found(0.1, 0.0) == []
    (problem,) = found(0.1, 0.1)
    assert problem.startswith("guides.drive: sheet paper starts 0.1 mm deep in it (bar ")
    assert int(problem.split("bar ")[1].split(")")[0]) < 4
    assert "half the thickness, 0.05 mm" in problem


def test_what_the_default_precision_turns_into_zero_or_infinity_is_refused():
    with jax.enable_x64(False):
        assert "must be finite" in problems_with("rollers.pinch.radius", 1e300)[0]
        assert "must be > 0" in problems_with("rollers.pinch.radius", 1e-300)[0]
    assert problems_with("rollers.pinch.radius", 1e-300) == []


def test_numbers_of_numpy_are_numbers():
    """As a loop over an array gives them; and they have derivatives."""
    scene = make_scene(
        sheets={"film": replace(SCENE.sheets["film"], length=np.int64(200), width=np.float32(35.0), bars=np.int64(4))},
        rollers={"drive": FixedRoller(center=(np.int64(0), np.float32(-10.0)), radius=np.int64(10))},
    )
    leaves = jax.tree.leaves(scene)
    assert all(isinstance(v, jax.Array) and v.dtype == jnp.float64 for v in leaves)
    assert float(jax.grad(lambda s: s.rollers["drive"].radius ** 2)(scene).rollers["drive"].radius) == 20.0


def test_traced_numbers_pass_but_their_shape_is_checked():
    def judge(x):
        pair = problems_with("rollers.pinch.center", (x, 1.0))
        scene = checked(changed(SCENE, ["rollers", "pinch", "radius"], x))
        assert pair == []
        assert "must be 2 numbers in mm/s2, but is a value that JAX traces" in problems_with("gravity", x)[0]
        return scene.rollers["pinch"].radius

    assert jax.jit(jax.grad(judge))(3.0) == 1.0


@pytest.mark.long
def test_a_soft_roller_may_give_way_at_rest():
    """60 N/mm under 5 N: more than half the thickness of the sheet, and far less than a run would call too deep. Under 500 N
    it lies on the way to the other side, held by its stop alone; without one it would not come to rest."""

    def pressed(preload, stop):
        pinch = MovableRoller(center=(0.0, 10.05), direction=(0.0, 1.0), radius=10.0, mass=0.02, preload=preload)
        rollers = {"hard": FixedRoller(center=(0.0, -10.05), radius=10.0), "soft": replace(pinch, travel_min=stop)}
        sheet = Sheet(
            length=40.0, thickness=0.1, width=50.0, density=1e-6, youngs_modulus=2e3, bars=4, lead=(20.0, 0.0)
        )
        contacts = {"default": Contact(stiffness=60.0, exponent=1.0)}
        return check(
            Scene(sheets={"s": sheet}, rollers=rollers, contacts=contacts, gravity=(0.0, 0.0), initial="settled")
        )

    assert pressed(5.0, -4.0) == pressed(5.0, None) == []
    problems = pressed(500.0, -4.0)
    assert len(problems) == 2
    assert all("it must be less than 1.55 mm: a stiffer contact or less force" in p for p in problems)
    (problem,) = pressed(500.0, None)
    assert problem.startswith(
        "no rest state was found from which to start: look for a sheet or a pinch that nothing stops, for clamps that hold one"
        " thing twice, and for a mass"
    )


@pytest.mark.parametrize("thing", [None, 3, {}, "scene", SCENE.sheets["film"]])
def test_what_is_no_scene_at_all(thing):
    assert "a Scene is needed" in check_records(thing)[0]


def test_make_scene_normalises_or_lists_every_problem():
    film = SCENE.sheets["film"]
    assert make_scene(sheets={"film": film}).sheets["film"].length.dtype == jnp.float64
    with pytest.raises(SceneError) as caught:
        make_scene(sheets={"film": replace(film, length=-1.0, width="w")}, duration=-1.0)
    assert len(caught.value.problems) == 3
    assert str(caught.value).splitlines() == ["scene: 3 problems", *(f"  {p}" for p in caught.value.problems)]


@pytest.mark.parametrize(
    "use",
    [
        lambda scene: diffeed.simulate(scene, duration=1e-3, dt=1e-3, frames=2),
        diffeed.settle,
        lambda scene: diffeed.linearise(scene, None),
        diffeed.explain_gradient,
        lambda scene: diffeed.gradient_check(scene, ["sheets.film.width"]),
        lambda scene: diffeed.value_and_gradient(lambda _, run: run.time[-1], scene),
    ],
)
def test_whatever_takes_a_scene_refuses_numbers_that_none_can_have(use):
    bad = changed(changed(SCENE, ["rollers", "drive", "radius"], -10.0), ["sheets", "film", "width"], "wide")
    with pytest.raises(SceneError) as caught:
        use(bad)
    assert [p.split(" must be ")[0] for p in caught.value.problems] == ["sheets.film.width", "rollers.drive.radius"]
    with pytest.raises(SceneError, match="this is a stack of 2 scenes, not one scene"):
        use(diffeed.stack([SCENE, SCENE]))


def test_scene_error_survives_pickling():
    again = pickle.loads(pickle.dumps(SceneError(["a", "b"], "x.toml")))
    assert (again.problems, str(again)) == (["a", "b"], "x.toml: 2 problems\n  a\n  b")


def _places(node: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    children = node if isinstance(node, dict) else {f.name: getattr(node, f.name) for f in fields(node)}
    deep = [(n, c) for n, c in children.items() if hasattr(c, "__dataclass_fields__") or isinstance(c, dict)]
    return [(*path, n) for n in children] + [p for n, c in deep for p in _places(c, (*path, n))]


_ODD = st.sampled_from(
    [SCENE, SWING, RAMP, Scene, object(), b"x", 1j, -(10**400), np.array(["a"]), np.zeros((2, 0)), NAN]
)
_JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | _ODD,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2) | st.tuples(inner)
    ),
    max_leaves=5,
)


@settings(max_examples=300, deadline=None)
@given(where=st.lists(st.sampled_from(_places(SCENE)), min_size=1, max_size=2), junk=_JUNK)
def test_no_input_makes_the_check_raise(where, junk):
    scene = SCENE
    for path in where:
        try:
            scene = changed(scene, list(path), junk)
        except (TypeError, AttributeError):  # the first piece of junk replaced what the second path leads through
            continue
    assert all(isinstance(p, str) for p in check_records(scene))


def test_a_step_in_words_is_a_problem_and_no_traceback():
    scene = Scene(
        sheets={"s": Sheet(length=40.0, thickness=0.1, width=20.0, density=1e-6, youngs_modulus=2000.0, bars=2)}
    )
    assert 'dt must be > 0 s, but is "1e-4"' in check(scene, dt="1e-4")
    assert "tolerance must be > 0 mm, but is true" in check(scene, tolerance=True)
    with pytest.raises(TypeError, match="stack takes a list of scenes, but this is one scene"):
        diffeed.stack(scene)
