"""The JSON schemas: what ships fits, what the readers refuse for its shape is refused, and no field is missing."""

import copy
import json
import tomllib
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner
from test_scene_file import DRIVE, FILM, full_scene

import diffeed.cli
import optimize.cli
from diffeed.base.names import LISTED
from diffeed.base.records import fields, is_required
from diffeed.input import parts
from diffeed.input.parts import SECTIONS, Motion, Profile, Scene
from diffeed.input.scene_file import load_scene, scene_text
from diffeed.schema import scene_schema
from optimize.asked import StudyError
from optimize.schema import STUDIES, study_schema
from optimize.study import Search, Study
from optimize.study_file import is_tolerance, make_study
from optimize.tolerance.problem import make_tolerance
from optimize.tolerance.records import Tolerance, ToleranceStudy

ROOT = Path(__file__).parent.parent
SCENES = sorted([*ROOT.glob("diffeed/scenes/*.toml"), *ROOT.glob("optimize/studies/scenes/*.toml")])
STUDY_FILES = sorted(ROOT.glob("optimize/studies/*.toml"))
SCENE = jsonschema.Draft202012Validator(scene_schema())
STUDY = {kind: jsonschema.Draft202012Validator(study_schema(kind)) for kind in STUDIES}


def complaints(validator, table) -> list[str]:
    return [f"{'.'.join(map(str, e.path))}: {e.message}" for e in validator.iter_errors(table)]


def test_schemas_are_schemas():
    for validator in (SCENE, *STUDY.values()):
        jsonschema.Draft202012Validator.check_schema(validator.schema)


@pytest.mark.parametrize("file", SCENES, ids=lambda f: f.stem)
def test_shipped_scenes_fit(file):
    assert complaints(SCENE, tomllib.loads(file.read_text("utf-8"))) == []


@pytest.mark.parametrize("file", STUDY_FILES, ids=lambda f: f.stem)
def test_shipped_studies_fit(file):
    table = tomllib.loads(file.read_text("utf-8"))
    assert complaints(STUDY["tolerance" if is_tolerance(table) else "design"], table) == []


def test_a_scene_with_every_field_fits_as_it_is_written():
    assert complaints(SCENE, tomllib.loads(scene_text(full_scene()))) == []


# --- scenes that are refused ----------------------------------------------------------------------------------------------

HARMED = {
    "unknown field": FILM + DRIVE + "radus = 3",
    "unknown section": FILM + "[roller.x]",
    "unknown word of the scene": "durations = 1\n" + FILM,
    "required field missing": FILM + DRIVE.replace("radius = 10.0", ""),
    "wrong kind": FILM + DRIVE.replace('"fixed"', '"fixd"'),
    "no kind": FILM + DRIVE.replace('kind = "fixed"', ""),
    "kind of another type": FILM + DRIVE.replace('"fixed"', "[1]"),
    "kind where there is one": FILM + 'kind = "sheet"',
    "field of another kind": FILM + DRIVE + "preload = 3.0",
    "word for a table": FILM + DRIVE + 'motion = "x"',
    "empty motion": FILM + DRIVE + "motion = {}",
    "wrong field of a profile": FILM + DRIVE + "angular_speed = {time = [0.0]}",
    "profile where none may be": FILM + DRIVE + "friction = {times = [0.0], values = [1.0]}",
    "word for a number": FILM + DRIVE + 'friction = "high"',
    "vector for a number": FILM + DRIVE + "friction = [0.2]",
    "number for a vector": FILM + "lead = 3.0",
    "too long a vector": FILM + "lead = [1.0, 2.0, 3.0]",
    "word in a vector": FILM + 'lead = [1.0, "x"]',
    "number for a section": "rollers = 3\n" + FILM,
    "number for a part": FILM + "[rollers]\ndrive = 3",
    "list of tables": FILM + "[[guides]]\nx = 3",
    "name with a blank": FILM + '[contacts."a b"]',
    "name too long": FILM + f"[contacts.{'x' * 61}]",
    "no sheets": "",
    "empty sheets": "[sheets]",
    "word that is no choice": FILM + '[contacts.x]\nfriction_law = "glue"',
    "initial that is no choice": 'initial = "setled"\n' + FILM,
    "number for a truth": FILM + "[contacts.x]\ndamped = 1",
    "part of a bar": FILM + "bars = 2.5",
    "no bars": FILM + "bars = 0",
    "negative length": FILM.replace("length = 200.0", "length = -200.0"),
    "negative friction": FILM + DRIVE + "friction = -0.1",
    "no duration": "duration = 0.0\n" + FILM,
    "word that is no end": FILM + '[loads.x]\nsheet = "film"\nat = "middle"',
    "node below the first": FILM + '[loads.x]\nsheet = "film"\nat = -1',
    "motion of a movable part": FILM
    + '[rollers.p]\nkind = "movable"\ncenter = [0.0, 9.0]\ndirection = [0.0, 1.0]\nradius = 3.0\nmass = 1.0\n'
    + "motion = {times = [0.0], displacement = [[0.0, 0.0]], rotation = [0.0]}",
    "flat displacement": FILM + DRIVE + "motion = {times = [0.0], displacement = [0.0, 0.0], rotation = [0.0]}",
}  # fmt: skip


@pytest.mark.parametrize("text", HARMED.values(), ids=HARMED.keys())
def test_what_the_reader_refuses_for_its_shape_the_schema_refuses(tmp_path, text):
    file = tmp_path / "scene.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(diffeed.SceneError):
        load_scene(file)
    assert complaints(SCENE, tomllib.loads(text))


def test_the_same_scenes_unharmed_fit(tmp_path):
    for text in (FILM, FILM + DRIVE, FILM + DRIVE + "angular_speed = {times = [0, 1], values = [0, -30]}"):
        file = tmp_path / "scene.toml"
        file.write_text(text, encoding="utf-8")
        assert load_scene(file).sheets
        assert complaints(SCENE, tomllib.loads(text)) == []


RECORDS = [Scene, Profile, Motion, *(kind for kinds in SECTIONS.values() for kind in kinds.values())]


@pytest.mark.parametrize("kind", RECORDS, ids=lambda k: k.__name__)
def test_every_field_has_an_entry_and_required_is_required(kind):
    schema = SCENE.schema if kind is Scene else SCENE.schema["$defs"][kind.__name__]
    named = {f.name for f in fields(kind)}
    word = {"kind"} if any(len(kinds) > 1 and kind in kinds.values() for kinds in SECTIONS.values()) else set()
    assert set(schema["properties"]) == named | word
    required = {f.name for f in fields(kind) if is_required(f)} | word
    assert set(schema["required"]) == (required if kind is not Scene else {"sheets"})
    for f in fields(kind):
        entry = schema["properties"][f.name]
        assert f.metadata["doc"] in entry["description"]
        if f.metadata["role"] == "number" and f.metadata["unit"] not in ("1", "that of the field"):
            assert f.metadata["unit"] in entry["description"]


def leaves(node, path=()):
    """Paths of all values of a table that are not tables."""
    if isinstance(node, dict):
        return [p for key, value in node.items() for p in leaves(value, (*path, key))]
    return [path]


@pytest.mark.parametrize(
    "wrong", ["a word that nothing takes", {"a": 1}, [[[1.0]]]], ids=["word", "table", "deep list"]
)
def test_reader_and_schema_agree_on_every_value_of_a_wrong_type(tmp_path, wrong):
    """Each value of a full scene in turn: whatever the reader says, the schema says. Names of parts are free words."""
    whole = tomllib.loads(scene_text(full_scene()))
    free = {"contact", "sheet", "goal"}  # the reader knows which names there are
    for path in leaves(whole):
        table = copy.deepcopy(whole)
        inner = table
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = wrong
        refused = bool(diffeed_problems(table))
        if not (isinstance(wrong, str) and path[-1] in free):
            assert refused, path
            assert complaints(SCENE, table), path


def diffeed_problems(table) -> list[str]:
    from diffeed.input import scene_file

    try:
        scene_file._scene(table, "scene")
    except diffeed.SceneError as error:
        return error.problems
    return []


# --- studies -------------------------------------------------------------------------------------------------------------

DESIGN = {
    "scene": "film_feeder",
    "variables": {"v": {"path": "rollers.pinch_1.preload", "bounds": [1.0, 9.0]}},
    "objective": {"o": {"measure": "slip_rms", "of": "drive_1"}},
}
TOLERANCE = {
    "scene": "film_feeder",
    "tolerances": {"t": {"path": "rollers.pinch_1.preload", "tolerance": 0.1}},
    "limits": {"l": {"measure": "slip_rms", "of": "drive_1", "at_most": 3.0}},
}
CHANGES = {
    "design": [
        ("scene", 3), ("durations", 1.0), ("duration", 0.0), ("frames", 1), ("frames", 2.5), ("variables", {}),
        ("variables", {"a b": DESIGN["variables"]["v"]}), ("variables", {"v": {"path": "x"}}),
        ("variables", {"v": {"path": "x", "bounds": [1.0]}}), ("objective", {"o": {"of": "drive_1"}}),
        ("objective", {"o": {"measure": "slip_rms", "of": 3}}), ("search", {"iterations": 0}),
        ("search", {"gradient": "rough"}), ("search", {"stages": [{"smoothing": 2.0}]}), ("over", "best"),
        ("robust", {"samples": 0}), ("limits", {"l": 3}), ("search", {"rate": 0.1}), ("dt", -1e-4),
    ],
    "tolerance": [
        ("tolerances", {}), ("samples", 0), ("sampling", "dice"), ("tolerances", {"t": {"path": "x", "kind": "odd"}}),
        ("tolerances", {"t": {"path": "x", "tolerance": 0.0}}), ("tolerances", {"t": {"path": "x", "size": 1.0}}),
        ("latitude", {"x": {"path": "x", "range": [0.0, 1.0]}}), ("seed", -1), ("title", "x" * 201),
        ("tolerances", {"t": {"path": "x", "tolerance": 1.0, "correlation": 2.0}}), ("media", {"film": 3}),
    ],
}  # fmt: skip
CASES = [(kind, key, value) for kind, changes in CHANGES.items() for key, value in changes]


def read_study(kind: str, table: dict) -> None:
    if kind == "design":
        make_study(table)
    else:
        make_tolerance(table)


def test_the_studies_to_be_harmed_are_sound():
    make_study(DESIGN)
    assert complaints(STUDY["design"], DESIGN) == []
    assert complaints(STUDY["tolerance"], TOLERANCE) == []


@pytest.mark.parametrize(("kind", "key", "value"), CASES, ids=[f"{k}-{key}-{i}" for i, (k, key, _) in enumerate(CASES)])
def test_what_the_reader_of_studies_refuses_the_schema_refuses(kind, key, value):
    table = {**(DESIGN if kind == "design" else TOLERANCE), key: value}
    with pytest.raises(StudyError):
        read_study(kind, table)
    assert complaints(STUDY[kind], table)


@pytest.mark.parametrize("kind", STUDIES)
def test_every_field_of_a_study_is_described(kind):
    schema = STUDY[kind].schema
    for record in (schema, *schema["$defs"].values()):
        for name, entry in record["properties"].items():
            assert entry.get("description"), (record["title"], name)
    assert set(schema["properties"]) == set(STUDIES[kind].model_fields)
    assert '"null"' not in json.dumps(schema), "TOML has none: an editor must not offer it"
    assert "null," not in json.dumps(schema)


def test_measures_and_methods_that_are_none_are_refused():
    for key, value in (("method", "euler"), ("objective", {"o": {"measure": "slipp", "of": "drive_1"}})):
        assert complaints(STUDY["design"], DESIGN | {key: value})


# --- commands ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("main", "words", "schema"),
    [
        (diffeed.cli.main, ["schema"], SCENE.schema),
        (optimize.cli.main, ["schema", "design"], STUDY["design"].schema),
        (optimize.cli.main, ["schema", "tolerance"], STUDY["tolerance"].schema),
    ],
    ids=["scene", "design", "tolerance"],
)
def test_commands_print_or_write_the_schema(tmp_path, main, words, schema):
    printed = CliRunner().invoke(main, words)
    assert (printed.exit_code, json.loads(printed.stdout)) == (0, schema)
    file = tmp_path / "new.json"
    assert CliRunner().invoke(main, [*words, "--out", str(file)]).exit_code == 0
    assert file.read_text("utf-8") == printed.stdout
    file.write_text("mine")
    again = CliRunner().invoke(main, [*words, "--out", str(file)])
    assert (again.exit_code, file.read_text()) == (2, "mine")
    assert "add --force" in again.output
    assert CliRunner().invoke(main, [*words, "--out", str(file), "--force"]).exit_code == 0
    assert file.read_text("utf-8") == printed.stdout
    missing = CliRunner().invoke(main, [*words, "--out", str(tmp_path / "no" / "new.json")])
    assert missing.exit_code == 2
    assert "Traceback" not in missing.output


def test_all_fields_of_a_record_are_listed_where_one_is_not_known():
    records = [r for r in vars(parts).values() if isinstance(r, type) and hasattr(r, "__dataclass_fields__")]
    assert max(len(r.__dataclass_fields__) for r in records) <= LISTED
    assert max(len(r.model_fields) for r in (ToleranceStudy, Tolerance, Study, Search)) <= LISTED
