"""Scene and study files are data: they run nothing, read nothing else, and ask for no more than fits."""

import ast
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from stand_in_nip import nip

import diffeed
from diffeed import cli, player
from diffeed.base import limits, toml_text
from diffeed.base.records import replace
from diffeed.base.words import key_text, name_problem, quoted, short
from diffeed.input.check_records import SceneError, check_records
from diffeed.input.scene_file import read_scene
from optimize.asked import StudyError
from optimize.journal import Journal, JournalError
from optimize.problem import make_problem
from optimize.study_file import load_study, make_study
from optimize.tolerance.problem import make_tolerance

ROOT = Path(__file__).parent.parent
SHEET = {"length": 2e5, "thickness": 0.1, "width": 20.0, "density": 1e-6, "youngs_modulus": 2000.0}


def sheets(count: int, bars: int) -> dict[str, diffeed.Sheet]:
    return {f"sheet_{k}": diffeed.Sheet(**SHEET, bars=bars) for k in range(count)}


def guides(count: int) -> dict[str, diffeed.CircleGuide]:
    return {f"guide_{k}": diffeed.CircleGuide(center=(0.0, 50.0 * k), radius=1.0) for k in range(count)}


@pytest.mark.parametrize(
    ("parts", "fragment"),
    [
        ({"sheets": sheets(1, 10**9)}, "sheets.sheet_0.bars must be from 1 to 10000, but is 1000000000"),
        ({"sheets": sheets(2, 6000)}, "sheets must have at most 10000 bars together, but have 12000"),
        ({"sheets": sheets(1, 2), "guides": guides(5000)}, "a scene must have at most 5000 parts, but has 5001"),
        (
            {"sheets": sheets(1, 9000), "guides": guides(300)},
            "bars times rollers and guides must be at most 2000000, but 9000 x 300 are 2700000",
        ),
        (
            {"sheets": sheets(1, 2000), "guides": guides(24), "initial": "settled"},
            "sheets: with 24 rollers and guides a scene that starts settled must have at most 912 bars, but has 2000",
        ),
    ],
)
def test_a_scene_that_asks_for_too_much_is_refused_with_the_limit(parts, fragment):
    problems = check_records(diffeed.Scene(**({"initial": "given"} | parts)))
    assert len(problems) == 1
    assert fragment in problems[0]


def test_a_profile_of_too_many_points():
    n = limits.MAX_POINTS + 1
    long = diffeed.Profile(times=np.arange(n, dtype=float), values=np.zeros(n))
    drive = replace(nip().rollers["drive"], angular_speed=long)
    problems = check_records(replace(nip(), rollers={"drive": drive}))
    assert problems == ["rollers.drive.angular_speed.times must have at most 100000 entries, but has 100001"]


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["--frames", "1000000000"], "frames must be at most 555,555 here (36 bars and parts), but is 1,000,000,000"),
        (["--dt", "1e-12"], "duration / dt must be at most 1,000,000,000 steps, but 1 s / 1e-12 s is more"),
        (["--dt", "1e-320"], "duration / dt must be at most 1,000,000,000 steps"),
        (["--duration", "1e300"], "but 1e+300 s / 0.0001 s is more"),
        (["--set", "sheets.film.bars=1000000000"], "must be from 1 to 10000, but is 1000000000"),
    ],
)
def test_a_run_that_asks_for_too_much_is_refused_before_anything_is_compiled(words, fragment, tmp_path):
    done = CliRunner().invoke(cli.main, ["run", "film_feeder", "--out", str(tmp_path / "out"), *words])
    assert done.exit_code == 2
    assert fragment in done.output
    assert not list(tmp_path.iterdir())


def test_simulate_refuses_what_the_command_refuses():
    with pytest.raises(ValueError, match="frames must be at most"):
        diffeed.simulate(nip(), frames=10**9)
    with pytest.raises(ValueError, match="duration / dt must be at most"):
        diffeed.simulate(nip(), dt=1e-12)
    with pytest.raises(ValueError, match="most_steps must be at most"):
        diffeed.simulate(nip(), tolerance=1e-2, most_steps=10**12)


# --- text ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    ["a" + ".a" * 200_000 + " = 1", "[" + "a." * 50_000 + "a]", "x = {" + "'a' . " * 20 + "a = 1}"],
    ids=["key", "header", "inline"],
)
def test_a_key_of_very_many_names_is_refused_unread(text, monkeypatch):
    """The reader of TOML would take memory in proportion to the square of their number."""
    monkeypatch.setattr(toml_text.tomllib, "loads", lambda _: pytest.fail("was read"))
    with pytest.raises(SceneError, match="nests tables too deeply: at most 16 names joined by dots"):
        read_scene(text)


def test_numbers_and_prose_are_no_deep_keys():
    text = (
        'a = "'
        + "1.5 " * 100
        + '"\nb = ['
        + "1.5, " * 100
        + "]\n# ........................ and so on. And on. e.g. i.e.\n"
    )
    assert toml_text.decode(text.encode(), 10_000)["b"][99] == 1.5


def test_a_study_file_is_read_no_further_than_its_limit(tmp_path):
    file = tmp_path / "study.toml"
    with file.open("wb") as stream:
        stream.truncate(200 * 10**9)  # no such disk is needed: nothing is written
    with pytest.raises(StudyError, match="must be <= 1 MB, but is larger"):
        load_study(file)
    for name in ("x" * 5000, "a\0b", str(tmp_path)):
        with pytest.raises(StudyError, match="there is no such file"):
            load_study(name)


def test_many_wrong_fields_are_told_up_to_a_number():
    with pytest.raises(SceneError) as caught:
        read_scene("".join(f"field_{k} = 1\n" for k in range(5000)))
    assert len(caught.value.problems) < 300


NOT_NAMES = [
    "",
    "a b",
    "../up",
    "a/b",
    "a\nb",
    "\x1b[31m",
    "é",
    "\u202eabc",
    "<script>",
    "a.b",
    "a" * 61,
    "$x^",
    None,
    3,
]


@pytest.mark.parametrize("name", NOT_NAMES, ids=range(len(NOT_NAMES)))
def test_names_are_words_everywhere(name):
    assert name_problem(name)
    assert name_problem(name).isprintable()
    found = check_records(replace(nip(), guides={name: nip().guides["table"]}))
    assert any(p.startswith("guides: a name must") for p in found)
    assert all(p.isprintable() for p in found)


ODD = ["a\nb", "\x1b[2J", "\u202e", "\ud800", object(), [object()], {"a\nb": 1}, 10**5000, print]


@pytest.mark.parametrize("value", ODD, ids=range(len(ODD)))
def test_values_are_quoted_on_one_line(value):
    text = short(value)
    assert text.isprintable()
    assert len(text) < 300
    assert " at 0x" not in text
    assert quoted(str(type(value))).isprintable()
    assert key_text("a\nb") == '"a\\nb"'


def test_a_name_of_a_part_cannot_end_the_script_of_the_player(tmp_path):
    scene = nip()
    wicked = "</script><script>alert(1)</script>"
    harmed = replace(scene, guides={wicked: scene.guides["table"]})
    run = diffeed.simulate(scene, duration=1e-3, dt=5e-4, frames=2)
    run = replace(run, guides={wicked: run.guides["table"]})
    page = player.write_player(tmp_path / "p.html", harmed, run, title=wicked).read_text("utf-8")
    assert "alert(1)</script>" not in page.replace("&lt;/script&gt;", "")
    assert page.count("</script>") == player.page(
        scene, diffeed.simulate(scene, duration=1e-3, dt=5e-4, frames=2)
    ).count("</script>")
    with pytest.raises(SceneError, match="a name must be made of"):
        diffeed.scene_text(harmed)


def test_the_page_writes_no_markup_from_data():
    for file in (ROOT / "diffeed" / "show" / "player_page").glob("*.js"):
        text = file.read_text("utf-8")
        assert not any(
            word in text for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(")
        )


# --- studies ------------------------------------------------------------------------------------------------------------

DESIGN = {
    "scene": "nip",
    "variables": {"preload": {"path": "rollers.pinch.preload", "bounds": [1.0, 6.0]}},
    "objective": {"force": {"measure": "nip_force", "of": "pinch"}},
}
TOLERANCE = {"scene": "nip", "tolerances": {"preload": {"path": "rollers.pinch.preload", "sigma": 0.1}}}
HUGE = 10**400


@pytest.mark.parametrize(
    ("search", "fragment"),
    [
        ({"seed": HUGE}, "search.seed must be less than or equal to 4294967295"),
        ({"iterations": HUGE}, "search.iterations must be less than or equal to 1000000"),
        ({"iterations": 10**5000}, "search.iterations must be"),
        ({"starts": 257}, "search.starts must be less than or equal to 256"),
        ({"samples": 10**6}, "search.samples must be less than or equal to 1024"),
        ({"stages": [{"iterations": 1}] * 101}, "search.stages"),
        ({"learning_rate": float("nan")}, "search.learning_rate must be a finite number"),
    ],
    ids=["seed", "iterations", "digits", "starts", "samples", "stages", "rate"],
)
def test_a_search_that_asks_for_too_much(search, fragment):
    with pytest.raises(StudyError) as caught:
        make_study(DESIGN | {"search": search})
    assert any(fragment in p for p in caught.value.problems), caught.value.problems


def test_all_runs_of_an_iteration_count_together():
    table = DESIGN | {"frames": 2001, "search": {"starts": 256}, "robust": {"samples": 1024}}
    table |= {"tolerances": TOLERANCE["tolerances"]}
    with pytest.raises(StudyError, match=r"frames must be at most 7 here .*, 262,144 runs at once\), but is 2,001"):
        make_problem(make_study(table), scene=nip())


@pytest.mark.parametrize(
    ("changes", "fragment"),
    [
        ({"samples": 10**8}, "samples must be less than or equal to 10000000"),
        ({"frames": 10**9}, "frames must be less than or equal to 100001"),
        ({"most_steps": HUGE}, "most_steps must be less than or equal to 1000000000"),
        ({"dt": 1e-300}, "duration / dt must be at most 1,000,000,000 steps"),
        ({"title": "a\x1b]0;owned\x07"}, "title: must be one line without control characters"),
        (
            {"limits": {"../../up": {"measure": "fed", "at_most": 1.0}}},
            "a name must be made of letters A-Z a-z, digits and _",
        ),
        ({"measures": {"a/b": {"measure": "fed"}}}, 'but is "a/b"'),
    ],
)
def test_a_tolerance_study_that_asks_for_too_much_or_names_a_file(changes, fragment):
    with pytest.raises(StudyError) as caught:
        make_tolerance(TOLERANCE | changes, scene=nip())
    assert any(fragment in p for p in caught.value.problems), caught.value.problems
    assert all(p.isprintable() for p in caught.value.problems)


def test_samples_times_what_scatters_is_limited(monkeypatch):
    from optimize.tolerance import problem

    monkeypatch.setattr(problem, "MOST_NUMBERS", 10)
    with pytest.raises(StudyError, match="samples must be at most 10 with 1 numbers that scatter, but is 11"):
        make_tolerance(TOLERANCE | {"samples": 11}, scene=nip())


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="needs a device without end")
def test_measured_values_come_from_a_file_with_an_end():
    given = {"path": "rollers.pinch.preload", "kind": "data", "file": "/dev/zero", "column": "x"}
    with pytest.raises(StudyError, match=r"tolerances.p.file: /dev/zero must be a file of at most 100 MB"):
        make_tolerance(TOLERANCE | {"tolerances": {"p": given}}, scene=nip())


def test_a_variable_must_be_a_number_and_a_shift_must_go_somewhere():
    whole = DESIGN | {"variables": {"all": {"path": "rollers", "bounds": [0.0, 1.0]}}}
    with pytest.raises(StudyError, match='"rollers" is not a number'):
        make_problem(make_study(whole), scene=nip())
    nowhere = {"shift": ["guides.table"], "direction": [0.0, 0.0], "bounds": [-1.0, 1.0]}
    with pytest.raises(StudyError, match="direction must not be zero"):
        make_study(DESIGN | {"variables": {"a": nowhere}})


# --- what is read back --------------------------------------------------------------------------------------------------


def test_nothing_that_is_read_can_run_code():
    """Arrays are read without pickle; no module reads pickles, runs text or builds objects from a file."""
    for path in [*(ROOT / "diffeed").rglob("*.py"), *(ROOT / "optimize").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = {a.name for a in node.names} | {getattr(node, "module", "") or ""}
                assert not names & {"pickle", "cloudpickle", "marshal", "shelve", "yaml", "dill", "joblib"}, path
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("eval", "exec", "os.system", "compile"), path
                if called in ("np.load", "numpy.load"):
                    assert any(k.arg == "allow_pickle" and ast.unparse(k.value) == "False" for k in node.keywords), path


@pytest.mark.parametrize("harm", ["pickle", "cut", "empty", "other"])
def test_a_state_that_is_none_is_refused_with_one_sentence(tmp_path, harm):
    stream = io.BytesIO()
    arrays = {"x": np.array([{"a": 1}], dtype=object)} if harm == "pickle" else {"x": np.zeros(3)}
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    data = {"cut": stream.getvalue()[:100], "empty": b""}.get(harm, stream.getvalue())
    (tmp_path / "state.npz").write_bytes(data)
    problem = make_problem(make_study(DESIGN), scene=nip())
    with pytest.raises(JournalError, match=r"state\.npz is not the state of a search .*add --force to begin anew"):
        Journal(tmp_path, problem).start(resume=True, force=False)


def test_a_benchmark_that_is_none_is_refused_with_one_sentence(tmp_path):
    from diffeed.bench.files import load_front
    from diffeed.bench.records import BenchError

    for text in ("[" * 100_000, "", "{}", json.dumps([1])):
        (tmp_path / "bench.json").write_text(text)
        with pytest.raises(BenchError):
            load_front(tmp_path)
