"""`python -m optimize`, as a user meets it."""

import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from stand_in_nip import nip

import diffeed
import optimize
from diffeed.base.terminal import once_more
from optimize.cli import main
from optimize.study_file import read_table

ROOT = Path(__file__).parent.parent
STUDY = """
title = "A nip of 4 N"
scene = "nip.toml"
duration = 0.01
frames = 5

[variables.preload]
path = "rollers.pinch.preload"
bounds = [1.0, 6.0]

[objective.force]
measure = "nip_force"
of = "pinch"
target = 4.0

[search]
learning_rate = 0.1
iterations = 6
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    diffeed.save_scene(nip(), folder / "nip.toml")
    (folder / "study.toml").write_text(STUDY)
    return folder


def run(place, *words):
    return subprocess.run(
        [sys.executable, "-m", "optimize", *words], cwd=place, capture_output=True, text=True, timeout=900,
        env={"PATH": "/usr/bin:/bin", "HOME": str(place), "PYTHONPATH": str(ROOT), "COLUMNS": "110"},
    )  # fmt: skip


@pytest.mark.parametrize("name", sorted(optimize.shipped_studies()))
def test_a_shipped_study_is_copied_with_its_scene(tmp_path, name):
    done = CliRunner().invoke(main, ["studies", name, "--out", str(tmp_path / "mine")])
    assert done.exit_code == 0, done.output
    mine = read_table(str(tmp_path / "mine" / f"{name}.toml"))[0]
    shipped = read_table(name)[0]
    assert diffeed.scene_text(diffeed.load_scene(mine["scene"])) == diffeed.scene_text(
        diffeed.load_scene(shipped["scene"])
    )
    assert {k: v for k, v in mine.items() if k != "scene"} == {k: v for k, v in shipped.items() if k != "scene"}
    assert mine["scene"] in diffeed.shipped_scenes() or str(tmp_path) in mine["scene"]
    again = CliRunner().invoke(main, ["studies", name, "--out", str(tmp_path / "mine")])
    assert again.exit_code == 2
    assert "already holds" in again.output
    assert f"{name}.toml" in again.output
    forced = CliRunner().invoke(main, ["studies", name, "--out", str(tmp_path / "mine"), "--force"])
    assert forced.exit_code == 0
    assert CliRunner().invoke(main, ["studies", name]).output == (tmp_path / "mine" / f"{name}.toml").read_text()


def test_a_scene_is_not_a_study_nor_a_study_a_scene(tmp_path):
    (tmp_path / "machine.toml").write_text(diffeed.scene_text(nip()))
    done = CliRunner().invoke(main, ["design", str(tmp_path / "machine.toml")])
    assert done.exit_code == 2
    assert 'this is a scene, not a study; a study names it: scene = "machine.toml"' in done.output
    (tmp_path / "study.toml").write_text(STUDY)
    with pytest.raises(diffeed.SceneError, match="this is a study, not a scene"):
        diffeed.load_scene(tmp_path / "study.toml")


def test_help_needs_nothing_heavy():
    code = """
import sys
from click.testing import CliRunner
from optimize.cli import main
for words in ([], ["design"], ["check"], ["compare"], ["studies"]):
    done = CliRunner().invoke(main, [*words, "--help"])
    assert done.exit_code == 0, done.output
heavy = {"jax", "numpy", "optax", "pydantic", "matplotlib", "rich"} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


@pytest.mark.slow
def test_design_writes_scene_numbers_and_pictures_and_resumes(place):
    done = run(place, "design", "study.toml", "--out", "better", "--iterations", "3")
    assert done.returncode == 0, done.stderr
    assert "A nip of 4 N: better" in done.stdout
    assert re.search(r"preload +N +3 ", done.stdout)
    assert "Confirmed: in steps 4 times as fine" in done.stdout
    folder = place / "better"
    summary = json.loads((folder / "result.json").read_text())
    assert summary["improved"]
    assert summary["iterations"] == 3
    assert summary["confirmed"]["holds"]
    improved = diffeed.load_scene(folder / "scene.toml")
    assert float(improved.rollers["pinch"].preload) == pytest.approx(summary["after"]["variables"]["preload"])
    names = (
        "before_after.html",
        "history.png",
        "variables.png",
        "blame_before.png",
        "blame_after.png",
        "when_before.png",
    )
    for name in names:
        assert (folder / name).stat().st_size > 5000, name
    again = run(place, "design", "study.toml", "--out", "better")
    assert again.returncode == 2
    assert "--resume" in again.stderr
    more = run(place, "design", "study.toml", "--out", "better", "--resume", "--no-pictures", "--once")
    assert more.returncode == 0, more.stderr
    assert "onfirmed" not in more.stdout
    assert json.loads((folder / "result.json").read_text())["confirmed"] is None
    lines = (folder / "history.jsonl").read_text().splitlines()
    assert [json.loads(line)["iteration"] for line in lines] == [1, 2, 3, 4, 5, 6]


def test_a_bad_study_is_refused_without_a_traceback(place):
    bad = place / "bad.toml"
    bad.write_text(STUDY.replace("preload", "prelaod").replace("target", "targt"))
    done = run(place, "design", "bad.toml", "--out", "nothing")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert 'objective.force.targt is not a field here; did you mean "target"?' in done.stderr
    assert not (place / "nothing").exists()


def test_studies_are_listed():
    done = CliRunner().invoke(main, ["studies"])
    assert done.exit_code == 0
    assert "nip_slip" in done.output


@pytest.mark.slow
def test_compare_runs_the_three_searches(place):
    done = run(place, "compare", "study.toml", "--budget", "12", "--out", "compared")
    assert done.returncode == 0, done.stderr
    for name in ("gradient", "differential evolution", "Nelder-Mead"):
        assert re.search(rf"^{name} +\S+", done.stdout, re.MULTILINE), done.stdout
    data = json.loads((place / "compared" / "comparison.json").read_text())
    assert data["gradient_cost"] > 0.0  # measured; of a run as short as this one it may be anything
    (first, _), *falls = data["searches"]["gradient"]["falls"]
    assert first == 1.0
    gradients = [cost / data["gradient_cost"] for cost, _ in falls]
    assert gradients == pytest.approx([round(n) for n in gradients])
    assert gradients


@pytest.mark.parametrize(
    ("command", "run", "write"),
    [("check", "trust.check_study", "trust.write_check"), ("compare", "compare.compare", "compare.write_comparison")],
)
def test_a_full_disk_is_told_in_one_sentence(tmp_path, monkeypatch, command, run, write):
    def fill(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("optimize.cli._problem", lambda *_, **__: None)
    monkeypatch.setattr(f"optimize.{run}", lambda *_: "found")
    monkeypatch.setattr("optimize.compare.table", str)
    monkeypatch.setattr(f"optimize.{write}", fill)
    out = tmp_path / "out"
    done = CliRunner().invoke(main, [command, "study.toml", "--out", str(out)])
    assert (done.exit_code, type(done.exception)) == (2, SystemExit)
    assert f"the results were not written to {out}: No space left on device" in done.output.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("raised", "said"), [(KeyboardInterrupt, "stopped by Ctrl-C"), (ValueError("too short"), "too short")]
)
def test_what_cannot_be_confirmed_is_no_failure(capsys, raised, said):
    def find():
        raise raised

    assert once_more("both", find) is None
    assert (
        capsys.readouterr().err
        == f"both once more, with shorter steps (--once leaves that out)\nnot confirmed: {said}\n"
    )
    assert once_more("both", lambda: 3) == 3
