"""Study files: what is wrong is said all at once, with path, value and what it must be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stand_in_nip import nip

import diffeed
import optimize
from optimize.optimisers import OPTIMISERS, UNSCHEDULED, make_optimiser
from optimize.problem import make_problem
from optimize.study_file import is_tolerance, load_study, make_study, read_table, shipped_studies
from optimize.terms import TERMS, Term
from optimize.tolerance.problem import load_tolerance

GOOD = {
    "scene": "film_feeder",
    "variables": {"preload": {"path": "rollers.pinch.preload", "bounds": [1.0, 6.0]}},
    "objective": {"force": {"measure": "nip_force", "of": "pinch", "target": 4.0}},
}

FELL = np.array([True, False, False])

THIN = {"sheets.strip.thickness": 0.15}


def problems_of(table, scene=None):
    with pytest.raises(optimize.StudyError) as caught:
        make_problem(make_study(table), scene=scene or nip())
    return caught.value.problems


def test_what_two_variables_or_one_twice_would_move():
    """The last would win, and the first have no effect."""
    preload = GOOD["variables"]["preload"]
    (problem,) = problems_of(GOOD | {"variables": {"preload": preload, "again": preload}})
    assert problem.startswith(
        "variables.again.path must name other numbers than variables.preload, but names rollers.pinch"
    )
    twice = {"shift": ["rollers.pinch", "rollers.pinch"], "direction": [0, 1], "bounds": [0, 1]}
    with pytest.raises(optimize.StudyError, match=r"rollers\.pinch is named again"):
        make_study(GOOD | {"variables": {"nip": twice}})


TIME = "rollers.drive.angular_speed.times[1]"


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"a": {"path": TIME, "bounds": [-0.01, 0.03]}}, "variables.a.bounds: at -0.01, rollers.drive.angular_speed.times"),
        ({"a": {"path": [TIME, TIME.replace("1]", "0]")], "bounds": [0.0, 0.03]}}, "variables, where the search begins: "),
        ({"a": {"delay": [TIME], "bounds": [-0.03, 0.01]}}, "variables.a.bounds: at -0.03, rollers.drive.angular_speed.times"),
        ({"a": {"path": "rollers.drive.radius", "bounds": [-1.0, 6.0]}}, "variables.a.bounds: at -1, rollers.drive.radius"),
        ({"a": {"delay": ["rollers.drive.radius"], "bounds": [0.0, 1.0]}}, "variables.a: delay must name times of profiles"),
        ({"a": {"delay": ["sheets.strip.structural_damping"], "bounds": [0.0, 1.0]}}, "variables.a: delay must name times"),
        (
            {"a": {"path": TIME, "bounds": [0.01, 0.03]}, "b": {"delay": [TIME[:-3]], "bounds": [0.0, 0.01]}},
            "variables.b.delay must name other times than variables.a.path, but names rollers.drive.angular_speed.times",
        ),
    ],
)  # fmt: skip
def test_what_no_scene_can_have_is_refused_before_the_search(variables, said):
    (problem,) = problems_of(GOOD | {"variables": variables})
    assert problem.startswith(said)


def test_a_table_and_a_scene_of_python_are_a_study():
    table = {key: value for key, value in GOOD.items() if key != "scene"}
    assert make_problem(table, scene=nip()).names == ("preload",)
    with pytest.raises(optimize.StudyError, match="scene"):
        make_problem(table)


def test_a_term_that_cannot_be_asked_is_said_before_anything_runs(monkeypatch):
    def of_two(scene, run):
        return run.time[-1]

    study = GOOD | {"objective": {"mine": {"measure": "mine"}}}
    for term, said in (
        (Term(of_two, "sheets", "s", "time"), "must take (scene, run, part, at), but takes (scene, run)"),
        (Term(lambda s, r, p, a: r.time[-1], "sheet", "s", "time"), 'but is "sheet"; did you mean "sheets"?'),
    ):
        monkeypatch.setitem(TERMS, "mine", term)
        (problem,) = problems_of(study)
        assert said in problem


def test_a_tolerance_wider_than_the_room_ends_at_a_bound():
    wide = GOOD["variables"]["preload"] | {"bounds": [0.5, 3.3], "transform": "log", "tolerance": 9.0}
    problem = make_problem(make_study(GOOD | {"variables": {"preload": wide}}), scene=nip())
    assert problem.tolerance == pytest.approx(problem.start)  # down to the lower bound


def test_what_an_optimiser_cannot_take_is_said():
    (problem,) = problems_of(GOOD | {"search": {"name": "rprop", "schedule": "cosine"}})
    assert problem == 'search.schedule must be "constant" for "rprop", but is "cosine"'
    assert any("search.name must be" in p for p in problems_of(GOOD | {"search": {"name": "noisy_sgd"}}))
    climate = {"tolerances": {"air": {"climate": "strip", "sigma": 0.3}}}
    (problem,) = problems_of(GOOD | climate)
    assert problem == "tolerances.air.climate belongs to tolerance studies, whose media are cards"


@pytest.mark.usefixtures("as_users_have_it")
@pytest.mark.parametrize("name", [n for n in OPTIMISERS if n != "lbfgs"])
def test_every_optimiser_steps_falls_back_and_is_kept(name, tmp_path):
    """As the search does it: over several starts, of which some go back, and in a file."""
    search = make_study(GOOD | {"search": {"name": name, "schedule": "constant"}}).search
    schedules = ["constant"] if name in UNSCHEDULED else ["constant", "cosine", "exponential"]
    for schedule in schedules:
        transform = make_optimiser(search.model_copy(update={"schedule": schedule}), 10)
        unit = jnp.array([[0.2, 0.5], [0.4, 0.6], [0.3, 0.9]])
        state = jax.device_get(jax.vmap(transform.init)(unit))
        step, after = jax.device_get(jax.jit(jax.vmap(transform.update))(0.1 * unit, state, unit))
        assert np.isfinite(step).all()
        mixed = jax.tree.map(lambda a, b: np.where(FELL.reshape(-1, *[1] * (np.ndim(a) - 1)), b, a), after, state)
        np.savez(tmp_path / "state.npz", *jax.tree.leaves(mixed))


def test_a_good_study_has_no_problems():
    problem = make_problem(make_study(GOOD), scene=nip())
    assert problem.names == ("preload",)
    assert problem.units == ("N",)
    assert problem.start[0] == pytest.approx((3.0 - 1.0) / 5.0)
    assert problem.observe == ("nips",)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"objektive": {}}, ["objektive", "objective"]),
        ({"dt": -1.0}, ["dt", "greater than 0", "-1.0"]),
        ({"dt": float("nan")}, ["dt", "finite", "nan"]),
        ({"variables": {}}, ["variables", "at least 1"]),
        ({"variables": {"a": {"path": "rollers.pinch.preload"}}}, ["variables.a.bounds", "missing"]),
        ({"variables": {"a": {"bounds": [0, 1]}}}, ["variables.a", "path, shift, turn"]),
        ({"variables": {"a": {"path": "x", "bounds": [2, 1]}}}, ["variables.a", "lower < upper"]),
        ({"variables": {"a": {"path": "x", "bounds": [0, 1], "transform": "log"}}}, ["variables.a", "log", "> 0"]),
        ({"variables": {"a": {"path": "x", "bounds": [0, 1], "tolerence": 2}}}, ["variables.a.tolerence", '"tolerance"']),
        ({"variables": {"a": {"shift": ["rollers.pinch"], "bounds": [0, 1]}}}, ["variables.a", "direction"]),
        ({"limits": {"b": {"measure": "slip"}}}, ["limits.b", "at_least or at_most"]),
        ({"search": {"iterations": 0}}, ["search.iterations", "greater than or equal to 1", "0"]),
        ({"dt": "5"}, ["dt must be a number", "'5'"]),
        ({"frames": True}, ["frames must be a number", "True"]),
        ({"variables": {"a": {"path": "x", "bounds": ["0", 1]}}}, ["variables.a.bounds", "must be a number", "'0'"]),
        ({"over": "median"}, ["over", "'mean'", "median"]),
        ({"variables": {"stroke": {"path": "x"}}}, ["variables.stroke.bounds is missing"]),
        ({"variables": {"str": {"path": "x"}}}, ["variables.str.bounds is missing"]),
        ({"variables": {"a": {"path": "x", "bounds": [0, 1], "strat": 3}}}, ["variables.a.strat is not", '"start"']),
        ({"strategy": 1}, ["strategy is not a field here"]),
        ({"[key]": 1}, ['"[key]" is not a field here']),
        ({"limits": {"a b": {"measure": "slip", "at_most": 1}}}, ['limits."a b": a name must be made of']),
        ({"step_tolerance": 0.01, "most_steps": 30}, ["most_steps must be at least", "(40)", "but is 30"]),
    ],
)  # fmt: skip
def test_one_wrong_value_names_path_and_rule(change, words):
    with pytest.raises(optimize.StudyError) as caught:
        make_study(GOOD | change)
    (line,) = caught.value.problems
    assert all(word in line for word in words), line


def test_of_a_field_with_alternatives_the_place_is_that_in_the_file():
    """A word or a list of words: pydantic says what is wrong with either, and names the one it tried."""
    table = GOOD | {"variables": {"str": {"path": ["x", 3], "bounds": [0, 1]}}}
    with pytest.raises(optimize.StudyError) as caught:
        make_study(table)
    assert [line.split(" must be ")[0] for line in caught.value.problems] == [
        "variables.str.path",
        "variables.str.path.1",
    ]


def test_a_step_for_each_frame_is_enough():
    assert make_study(GOOD | {"step_tolerance": 0.01, "most_steps": 30, "frames": 31}).frames == 31
    assert make_study(GOOD | {"most_steps": 30}).frames == 41  # steps of one length: they are not counted
    with pytest.raises(optimize.StudyError) as caught:
        make_study(GOOD | {"step_tolerance": 0.01, "most_steps": 29, "frames": 31})
    assert caught.value.problems == [
        "most_steps must be at least one for each frame after the first (30) with a step_tolerance, but is 29"
    ]


def test_everything_that_does_not_fit_the_scene_is_said_at_once():
    table = GOOD | {
        "variables": {
            "a": {"path": "rollers.pinch.prelaod", "bounds": [1, 6]},
            "b": {"path": "rollers.pinch.center", "bounds": [1, 6]},
            "c": {"path": "rollers.pinch.spring", "bounds": [1, 6]},
            "d": {"shift": ["sheets.strip"], "direction": [1, 0], "bounds": [-1, 1]},
            "i": {"path": "rollers.drive.angular_speed", "bounds": [1, 6]},
        },
        "objective": {
            "e": {"measure": "nip_forec", "of": "pinch"},
            "f": {"measure": "nip_force", "of": "pinhc"},
            "g": {"measure": "nip_force"},
            "h": {"measure": "arrival"},
        },
        "search": {"name": "lbfg"},
        "method": "euler",
        "set": {"rollers.nowhere.radius": 3.0},
    }
    found = "\n".join(problems_of(table))
    for words in (
        "variables.a.path", 'did you mean "preload"', "variables.b.path: path must name one number",
        "variables.i.path: path must name one number, but rollers.drive.angular_speed holds Profile(",
        "variables.c.bounds must hold the start, 0.5", "variables.d: sheets.strip", "objective.e.measure",
        'did you mean "nip_force"', 'objective.f.of: there is no "pinhc"', "objective.g.of must name",
        "objective.h.at must name a sensor (gate)", "search.name", 'did you mean "lbfgs"', "method must be one of",
        "set:",
    ):  # fmt: skip
        assert words in found, f"{words}\n--\n{found}"


def test_a_scene_that_does_not_hold_is_refused_for_each_medium():
    table = GOOD | {"media": {"foil": {"set": {"sheets.strip.thickness": -1.0}}}}
    assert any("media.foil" in p and "thickness" in p for p in problems_of(table))


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("sheets.strip.bars", 3, "sheets.strip.bars is 4 in one and 3 in the other"),
        ("contacts.default.friction_law", "tanh", "contacts.default.friction_law is 'sqrt' in one and 'tanh'"),
        ("initial", "settled", "initial is 'given' in one and 'settled' in the other"),
        ("duration", 0.02, "duration is 0.03 in one and 0.02 in the other"),
        ("rollers.drive.angular_speed", -30.0,
         "rollers.drive.angular_speed is a profile in one and a number in the other"),
        ("rollers.pinch.travel_max", 1.0, "rollers.pinch.travel_max is absent in one and a number in the other"),
    ],
)  # fmt: skip
def test_media_that_cannot_run_together_are_named_with_what_differs(path, value, said):
    """All media are one batch: they have the same words and shapes, and numbers of their own."""
    (problem,) = problems_of(GOOD | {"media": {"plain": {}, "thin": {"set": THIN}, "coarse": {"set": {path: value}}}})
    assert problem.startswith(f"media.coarse must differ from media.plain in numbers alone, but {said}"), problem


def test_media_differ_in_numbers_and_one_alone_in_anything():
    """A profile has as many points as it likes, and a single medium is no batch."""
    longer = diffeed.Profile(times=(0.0, 0.01, 0.02), values=(0.0, -10.0, -40.0))
    media = {"plain": {}, "thin": {"set": THIN | {"rollers.drive.angular_speed": longer}}}
    assert make_problem(make_study(GOOD | {"media": media}), scene=nip()).media == ("plain", "thin")
    alone = {"coarse": {"set": {"sheets.strip.bars": 3}}}
    assert make_problem(make_study(GOOD | {"media": alone}), scene=nip()).media == ("coarse",)


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(optimize.StudyError, match="no such file"):
        load_study(tmp_path / "nothing.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("scene = ")
    with pytest.raises(optimize.StudyError, match="not readable TOML"):
        load_study(broken)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(n for n in shipped_studies() if not is_tolerance(read_table(n)[0])))
def test_shipped_studies_are_sound(name):
    study = load_study(name)
    assert study.title
    assert make_problem(study, name).names


# --- what makes two studies the same ----------------------------------------------------------------------------------


def test_a_study_is_the_same_from_wherever_it_is_named(tmp_path, monkeypatch):
    place = tmp_path / "place"
    place.mkdir()
    diffeed.save_scene(nip(), place / "nip.toml")
    (place / "study.toml").write_text(
        'scene = "nip.toml"\n[variables.preload]\npath = "rollers.pinch.preload"\nbounds = [1.0, 6.0]\n'
        '[objective.force]\nmeasure = "nip_force"\nof = "pinch"\n'
    )
    keys = []
    for folder, name in ((place, "study.toml"), (tmp_path, "place/study.toml")):
        monkeypatch.chdir(folder)
        keys.append(make_problem(load_study(name)).key)
    diffeed.save_scene(nip(preload=2.0), place / "nip.toml")
    keys.append(make_problem(load_study(name)).key)
    assert keys[0] == keys[1] != keys[2]


def test_measured_values_lie_beside_their_study_wherever_it_is_named(tmp_path, monkeypatch):
    """From Python too, and even where the working folder has a table of that name; the key is that of the values."""
    path = ["path = 'rollers.pinch.preload'", "kind = 'data'", "file = 'preloads.csv'", "column = 'N'"]
    scatter = "\n".join(["[tolerances.preload]", *path, ""])
    wanted = (
        "[variables.spring]\npath = 'rollers.pinch.spring'\nbounds = [0.1, 1.0]\n"
        "[objective.force]\nmeasure = 'nip_force'\nof = 'pinch'\n"
    )
    for folder, values in (("place", "N\n2.9\n3.1\n"), ("copy", "N\n2.9\n3.1\n"), (".", "N\n4.9\n5.1\n")):
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        diffeed.save_scene(nip(), place / "nip.toml")
        (place / "preloads.csv").write_text(values)
        (place / "design.toml").write_text(f"scene = 'nip.toml'\n{wanted}{scatter}")
        (place / "tolerance.toml").write_text(f"scene = 'nip.toml'\n{scatter}")

    def made(folder):
        studies = make_problem(load_study(f"{folder}/design.toml")), load_tolerance(f"{folder}/tolerance.toml")
        assert all(list(s.inputs[0].column) == [2.9, 3.1] for s in studies)
        return [s.key for s in studies]

    monkeypatch.chdir(tmp_path)
    keys = made("place")
    assert keys == made("copy") == made(tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    assert made(".") == keys
    (tmp_path / "place/preloads.csv").unlink()
    monkeypatch.chdir(tmp_path)
    for ready in (
        lambda: make_problem(load_study("place/design.toml")),
        lambda: load_tolerance("place/tolerance.toml"),
    ):
        with pytest.raises(optimize.StudyError, match=r"tolerances.preload.file: .*place.preloads.csv must be a file"):
            ready()


def test_a_section_that_is_no_table_is_refused_as_such(tmp_path):
    """Paths are made whole before the study is checked."""
    for text in ("tolerances = 3", "tolerances = {a = 3}", "tolerances = {a = {file = 3}}"):
        (tmp_path / "study.toml").write_text(f"variables = {{}}\n{text}\n")
        with pytest.raises(optimize.StudyError, match=r"tolerances.* must be"):
            load_study(tmp_path / "study.toml")


def test_a_step_that_is_not_given_is_no_bound_of_chosen_steps():
    def key(**changes):
        return make_problem(make_study(GOOD | changes), scene=nip()).key

    default = make_study(GOOD).dt
    assert key() == key(dt=default)
    assert key(step_tolerance=0.01) != key(step_tolerance=0.01, dt=default)


def test_the_order_of_variables_counts():
    """It is that of a point's numbers, in the state of a search as well."""
    spring = {"path": "rollers.pinch.spring", "bounds": [0.1, 1.0]}
    both = GOOD["variables"] | {"spring": spring}
    keys = [
        make_problem(make_study(GOOD | {"variables": v}), scene=nip()).key
        for v in (both, dict(reversed(both.items())), dict(both))
    ]
    assert keys[0] == keys[2] != keys[1]


def test_a_shift_needs_its_direction():
    moved = {"shift": ["guides.table"], "bounds": [-1.0, 1.0]}
    with pytest.raises(optimize.StudyError, match="a shift needs its direction"):
        make_study(GOOD | {"variables": {"aside": moved}})
    with pytest.raises(optimize.StudyError, match="direction belongs to shift, and only there"):
        make_study(GOOD | {"variables": {"preload": GOOD["variables"]["preload"] | {"direction": [1.0, 0.0]}}})
