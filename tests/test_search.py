"""Short versions of the searches of `python -m tests.search`, and the cases that they found."""

import random
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.search import fuzz, invalid, kill, mutations, seeds


@pytest.mark.parametrize("kind", invalid.KINDS)
def test_harmed_files_and_records_are_read_or_refused_with_plain_sentences(tmp_path, kind):
    found = {invalid.judged(kind, seed, tmp_path)[0] for seed in range(120)}
    assert found == {"read", "refused"} or (kind, found) == ("record", {"refused"})


@pytest.mark.parametrize(
    ("kind", "seed"), [("scene", 8883), ("study", 262), ("study", 1285), ("study", 1432), ("study", 7138)]
)
def test_what_the_search_once_found(tmp_path, kind, seed):
    """A kind of 5000 hexadecimal digits; a variable on a whole section; paths of thousands of characters."""
    assert invalid.judged(kind, seed, tmp_path)[0] == "refused"


def test_the_same_seed_makes_the_same_case(tmp_path):
    assert invalid.judged("scene", 7, tmp_path) == invalid.judged("scene", 7, tmp_path)
    text = seeds.ALL_KINDS
    assert mutations.harmed_text(text, random.Random(1)) != mutations.harmed_text(text, random.Random(2))


@pytest.mark.parametrize(
    "fault",
    [
        KeyError("x"),
        invalid.SceneError([]),
        invalid.SceneError(["one line\nand another"]),
        invalid.SceneError(["KeyError: x"]),
    ],
)
def test_the_search_sees_a_fault(fault):
    def read():
        raise fault

    with pytest.raises(invalid.Fault):
        invalid._judge(read, "case")


def test_the_fuzzer_feeds_bytes_and_says_what_it_needs(monkeypatch):
    for text in seeds.scenes():
        invalid.judged_bytes(text.encode())
    invalid.judged_bytes(b"\xff\x00[")
    monkeypatch.setitem(__import__("sys").modules, "atheris", None)
    done = CliRunner().invoke(fuzz.command, ["--minutes", "0.01"])
    assert done.exit_code == 1
    assert fuzz.MISSING in done.output


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run", "run --force", "tolerance", "design"])
def test_a_killed_command_leaves_what_can_be_brought_to_its_end(tmp_path, name):
    place = kill.Place(tmp_path)
    for seed in range(2):
        kill.killed_once(place, name, seed)


def test_the_killer_sees_a_file_that_is_cut_off(tmp_path):
    for name, text in (("result.json", '{"a": '), ("player.html", "<html>"), ("scene.toml", "["), ("data.npz", "PK")):
        (tmp_path / name).write_text(text)
        with pytest.raises(kill.Fault, match=f"{name} cannot be read"):
            kill.contents(tmp_path)
        (tmp_path / name).unlink()


def test_the_killer_sees_another_end():
    a = {"result.json": {"x": [1.0], "seconds": 2.0}}
    assert kill.first_difference(a, {"result.json": {"x": [1.5], "seconds": 2.0}})
    assert kill.first_difference(a, {}) == ": ['result.json']"
    assert not kill.first_difference(kill._timeless(a), kill._timeless({"result.json": {"x": [1.0], "seconds": 3.0}}))


def test_every_search_is_a_command():
    from tests.search.__main__ import main

    assert {"invalid", "fuzz", "kill"} <= set(main.commands)
    assert Path(main.callback.__code__.co_filename).name == "__main__.py"
