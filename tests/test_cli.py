"""The command line, as a user meets it: real runs in processes of their own, and what needs no run in this one."""

import errno
import io
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest
from click.testing import CliRunner
from packed import unpack
from rich.console import Console

import diffeed
from diffeed import cli, tuning
from diffeed.base import folders
from diffeed.bench.cli import bench
from diffeed.command import earlier, outputs, report
from diffeed.run import pieces
from optimize.cli import main as optimize_main

ROOT = Path(__file__).parent.parent
COMMAND = (sys.executable, "-m", "diffeed.cli")
MINI = """
# One nip that feeds a short strip.

duration = 0.06
goal = "exit"

[sheets.strip]
length = 20.0
thickness = 0.2
width = 20.0
density = 1.0e-6
youngs_modulus = 2000.0
structural_damping = 1.0e-3
bars = 4
lead = [12.0, 0.0]

[rollers.drive]
kind = "fixed"
center = [0.0, -10.1]
radius = 10.0
angular_speed = { times = [0.0, 0.005], values = [0.0, -40.0] }

[rollers.pinch]
kind = "movable"
center = [0.0, 10.1]
direction = [0.0, 1.0]
radius = 10.0
mass = 0.02
spring = 0.5
preload = 5.0
damper = 0.005

[guides.table]
kind = "line"
start = [5.0, -0.5]
end = [60.0, -0.5]

[sensors.exit]
position = [-4.0, 0.0]
direction = [1.0, 0.0]
"""
PUSHED_THROUGH = """
duration = 0.01
initial = "given"
gravity = [0.0, 0.0]

[sheets.strip]
length = 20.0
thickness = 0.2
width = 20.0
density = 1.0e-4
youngs_modulus = 2000.0
bars = 2
lead = [-20.0, 0.0]
speed = 20000.0

[contacts.default]
stiffness = 0.1
damping = 0.0

[rollers.post]
kind = "fixed"
center = [0.0, 0.0]
radius = 10.0
friction = 0.0
surface_speed = 0.0
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with scenes, and a cache of compiled programs that the tests share."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "mini.toml").write_text(MINI)
    (folder / "through.toml").write_text(PUSHED_THROUGH)
    return folder


def environment(place: Path) -> dict[str, str]:
    plain = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "COLUMNS")}
    return plain | {"XDG_CACHE_HOME": str(place / "cache"), "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "error"}


def command(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments], cwd=place, env=environment(place), capture_output=True, text=True, timeout=300
    )


# --- real runs --------------------------------------------------------------------------------------------------------


def compiled(place: Path) -> set[str]:
    return {p.name for p in (place / "cache/diffeed/xla").glob("*-cache")}


FIRST = ("--frames", "13", "--set", "rollers.drive.radius=10.05", "--set", "gravity[1]=-9800")


@pytest.fixture(scope="module")
def finished(place) -> subprocess.CompletedProcess[str]:
    return command(place, "run", "mini.toml", "--out", "results/first", *FIRST)


def test_a_run_reports_its_verdict_first_in_plain_text_of_80_columns(finished):
    assert finished.returncode == 0, finished.stderr
    lines = finished.stdout.splitlines()
    assert lines[0].startswith("PASSED: the tail of strip passed sensor exit, at 0.0")
    assert "\x1b" not in finished.stdout + finished.stderr
    assert max(len(line) for line in lines[:-1]) <= 80
    assert "Traceback" not in finished.stderr
    for title in ("Rollers", "Guides", "Arrivals", "Sheets", "Smallest gaps", "Energy balance"):
        assert any(line.startswith(title) for line in lines)


def test_a_run_writes_every_file(finished, place):
    out = place / "results/first"
    assert {p.name for p in out.iterdir()} == set(outputs.FILES)
    assert [p.name for p in out.parent.iterdir()] == ["first"], "a draft was left behind"
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in outputs.PICTURES)
    page = (out / "player.html").read_text()
    assert "strip" in page
    assert not re.search(r'(src|href)\s*=\s*"https?:', page)


def test_the_summary_says_what_was_run(finished, place):
    summary = json.loads((place / "results/first/summary.json").read_text())
    assert summary["verdict"]["status"] == "passed"
    assert summary["settings"]["assignments"] == ["rollers.drive.radius=10.05", "gravity[1]=-9800"]
    assert summary["versions"]["diffeed"] == diffeed.__version__
    assert summary["run"]["precision"] == "float64"
    assert summary["run"]["steps"] == 600
    assert 4.0 < summary["rollers"]["pinch"]["force_mean"] < 6.0
    assert summary["sheets"]["strip"]["arrivals"]["exit"]["tail"] == pytest.approx(summary["verdict"]["time"])
    assert sum("simulate" in name for name in compiled(place)) == 1, "the finer run is of the same program"


@pytest.mark.long
def test_a_changed_machine_is_held_against_the_run_before(finished, place):
    """Other numbers of the same parts: no program is compiled again."""
    kept = compiled(place)
    done = command(
        place, "run", "mini.toml", *FIRST, "--set", "rollers.pinch.preload=6", "--out", "results/second",
        "--before", "results/first",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert compiled(place) == kept
    told = done.stdout.split("what differs by more than 0.1 %\n")[1]
    (row,) = re.findall(r"^pinch: normal mean \(N\) +([\d.]+) +([\d.]+) +\+([\d.]+)$", told, re.M)
    old, new, change = map(float, row)
    now, then = (json.loads((place / f"results/{f}/summary.json").read_text()) for f in ("second", "first"))
    assert old == pytest.approx(then["rollers"]["pinch"]["force_mean"], rel=1e-3)
    assert new == pytest.approx(now["rollers"]["pinch"]["force_mean"], rel=1e-3)
    assert change == pytest.approx(1.0, abs=0.15)  # the preload's, and the mass of the roller in it
    page = (place / "results/second/player.html").read_text()
    (data,) = re.findall(r'<script id="data"[^>]*>(.*?)</script>', page, re.S)
    shown = json.loads(data)
    assert shown["labels"] == ["before", "after"]
    with np.load(place / "results/first/data.npz") as first:
        nodes = unpack(shown["runs"][0]["sheets"]["strip"]["nodes"])
        np.testing.assert_array_equal(nodes, np.float32(first["sheets.strip.nodes"]))
    assert shown["runs"][1]["rollers"]["pinch"]["force"] != shown["runs"][0]["rollers"]["pinch"]["force"]


def test_runs_of_two_lengths_are_not_compared_in_silence(capsys):
    """A nip that the shorter one never reached carries nothing in it."""
    from diffeed.base.terminal import console

    def said(before, after):
        empty = {"sheets": {}, "rollers": {}, "verdict": {"status": "passed"}}
        report.print_changes(console(), *(empty | {"run": {"simulated": t}} for t in (before, after)))
        return " ".join(capsys.readouterr().out.split())

    assert "The runs are not of one length: 1 s before, 0.1 s after." in said(1.0, 0.1)
    assert "one length" not in said(1.0, 1.0)


def test_a_failed_run_before_tells_its_time_once(finished, place, tmp_path):
    folder = tmp_path / "old"
    shutil.copytree(place / "results/first", folder)
    summary = json.loads((folder / "summary.json").read_text())
    reason = "at 0.7 s, at rollers.pinch: a bar was pushed deeper into a body than it may be"
    summary["verdict"] = {"status": "failed", "reason": reason, "time": 0.7, "place": ""}
    (folder / "summary.json").write_text(json.dumps(summary))
    run = earlier.read_run(folder).run
    assert not run.ok
    assert run.failure.describe() == reason


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda folder: (folder / "summary.json").unlink(), "holds no results of `diffeed run`"),
        (lambda folder: (folder / "summary.json").write_text("{}"), "holds no whole results"),
        (lambda folder: (folder / "data.npz").write_bytes(b"PK"), "holds no whole results"),
        (lambda folder: (folder / "scene.toml").unlink(), "holds no whole results"),
        (lambda folder: np.savez(folder / "data.npz", time=np.array([{}], dtype=object)), "holds no whole results"),
        (lambda folder: np.savez(folder / "data.npz", strange=np.zeros(2)), "holds no whole results"),
    ],
)
def test_results_that_are_not_whole_are_refused(finished, place, tmp_path, harm, told):
    folder = tmp_path / "old"
    shutil.copytree(place / "results/first", folder)
    earlier.read_run(folder)
    harm(folder)
    done = CliRunner().invoke(cli.main, ["run", "film_feeder", "--before", str(folder), "--out", str(tmp_path / "new")])
    assert done.exit_code == 2
    assert told in done.output
    assert not (tmp_path / "new").exists()


@pytest.mark.long
def test_a_run_in_pieces_is_the_single_run(finished, place):
    scene = diffeed.load_scene(place / "results/first/scene.toml")
    assert float(scene.rollers["drive"].radius) == 10.05
    assert float(scene.gravity[1]) == -9800.0
    whole = diffeed.simulate(scene, dt=1e-4, frames=13)
    with np.load(place / "results/first/data.npz", allow_pickle=False) as data:
        # Two compilations differ in rounding only; a step lost or doubled at a boundary would be 0.04 mm.
        np.testing.assert_allclose(data["time"], whole.time, rtol=1e-12)
        np.testing.assert_allclose(data["sheets.strip.nodes"], whole.sheets["strip"].nodes, atol=1e-7)
        np.testing.assert_allclose(data["rollers.drive.slip"], whole.rollers["drive"].slip, atol=1e-5)
        assert data["guides.table.gap"].shape == (13,)
        assert data["sheets.strip.headings"].shape == data["sheets.strip.rates"].shape == (13, 4)


@pytest.mark.long
def test_a_run_that_diverges_says_where_and_what_to_try(place):
    done = command(place, "run", "through.toml", "--out", "broken")
    assert done.returncode == 1
    assert done.stdout.startswith("FAILED: ")
    assert "rollers.post" in done.stderr
    assert "--dt" in done.stderr
    assert "Traceback" not in done.stderr
    assert json.loads((place / "broken/summary.json").read_text())["verdict"]["status"] == "failed"
    with np.load(place / "broken/data.npz") as data:
        assert (np.diff(data["time"]) > 0).all(), "frames after the failure were kept"
        assert data["time"][-1] < 0.01


def test_every_problem_of_a_scene_file_stands_on_its_own_line(place):
    (place / "bad.toml").write_text(MINI.replace("radius = 10.0", "radius = -10.0").replace("goal", "gaol"))
    done = command(place, "run", "bad.toml", "--out", "bad")
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert sum("radius must be > 0 mm" in line for line in lines) == 2
    assert sum("gaol is not a field" in line for line in lines) == 1
    assert not done.stdout
    assert "Traceback" not in done.stderr
    assert not (place / "bad").exists()


def test_a_wrong_set_is_named(place):
    done = command(place, "run", "mini.toml", "--out", "bad", "--set", "rollers.drvie.radius=3")
    assert done.returncode == 2
    assert 'did you mean "drive"?' in done.stderr
    assert "Traceback" not in done.stderr
    assert not (place / "bad").exists()


def test_a_wrong_method_is_named_before_anything_is_written(place):
    done = command(place, "run", "mini.toml", "--out", "new/bad", "--method", "magic", "--dt", "-1")
    assert done.returncode == 2
    assert "method must be one of linear_euler" in done.stderr
    assert "dt must be > 0 s" in done.stderr
    assert not (place / "new").exists()


def test_check_finds_a_sound_scene_sound(place):
    done = command(place, "check", "mini.toml", "--dt", "1e-4")
    assert (done.returncode, done.stdout) == (0, "sound\n")


@pytest.mark.slow
def test_ctrl_c_keeps_what_there_is(place):
    """40,000 steps, stopped after the first pieces."""
    status, stdout, _ = interrupted(place, rb"[0-9.]+ of 4 s", "--duration", "4", "--out", "part")
    assert status == 130
    assert stdout.startswith("STOPPED: ")
    summary = json.loads((place / "part/summary.json").read_text())
    assert summary["verdict"]["status"] == "stopped"
    assert 0.0 < summary["run"]["simulated"] < 4.0
    assert {p.name for p in (place / "part").iterdir()} == set(outputs.FILES)


def test_ctrl_c_while_compiling_writes_nothing(place):
    begun = time.monotonic()
    status, stdout, stderr = interrupted(place, rb"compiling", "--out", "nothing", "--set", "sheets.strip.bars=5")
    assert status == 130
    assert not stdout
    assert "nothing was written" in stderr
    assert "Traceback" not in stderr
    assert not list(place.glob("*nothing*"))
    assert time.monotonic() - begun < 30.0


def interrupted(place: Path, moment: bytes, *arguments: str) -> tuple[int, str, str]:
    """Run in a terminal, since a progress bar is drawn only there, and press Ctrl-C when `moment` appears."""
    master, slave = pty.openpty()
    whole = [*COMMAND, "run", "mini.toml", *arguments]
    # Ctrl-C may fall into an import and leave its file to the collector: Python says so only where all warnings are errors.
    quiet = environment(place) | {"PYTHONWARNINGS": "error,ignore::ResourceWarning"}
    process = subprocess.Popen(whole, cwd=place, env=quiet, stdout=subprocess.PIPE, stderr=slave, text=True)
    os.close(slave)
    try:
        seen = read_until(master, moment)
        process.send_signal(signal.SIGINT)
        # A terminal that nobody reads fills up, and then holds up the one who writes to it.
        with ThreadPoolExecutor(1) as reader:
            rest = reader.submit(read_rest, master)
            stdout, _ = process.communicate(timeout=60)
            seen += rest.result(timeout=10)
    finally:
        process.kill()
        process.wait()
        os.close(master)
    return process.returncode, stdout, seen.decode()


def read_rest(stream: int) -> bytes:
    seen = b""
    while True:
        try:
            more = os.read(stream, 4096)
        except OSError:  # how Linux says that the other end is closed
            return seen
        if not more:
            return seen
        seen += more


def read_until(stream: int, pattern: bytes) -> bytes:
    seen = b""
    while not re.search(pattern, seen):
        more = os.read(stream, 4096)
        assert more, f"ended before {pattern!r} came: {seen.decode()}"
        seen += more
    return seen


# --- without a process ------------------------------------------------------------------------------------------------


def test_help_needs_nothing_heavy():
    code = """
import sys
import diffeed.cli
from click.testing import CliRunner
for words in ([], ["run"], ["check"], ["scenes"]):
    done = CliRunner().invoke(diffeed.cli.main, [*words, "--help"])
    assert done.exit_code == 0, done.output
heavy = {"jax", "numpy", "matplotlib", "rich"} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def invoke(*arguments: str):
    return CliRunner().invoke(cli.main, list(arguments))


def test_version_and_examples():
    assert invoke("--version").output.strip().endswith(diffeed.__version__)
    for words in ([], ["run"], ["check"]):
        assert "Examples:\n    diffeed " in invoke(*words, "--help").output


def test_python_runs_it_as_a_module():
    found = subprocess.run([sys.executable, "-m", "diffeed", "--help"], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("Usage: python -m diffeed ")


def test_scenes_are_listed_with_their_purpose():
    listed = invoke("scenes").output
    assert listed.startswith("film_feeder\n  The film feeding machine")
    assert {line for line in listed.splitlines() if line[0] != " "} == set(diffeed.shipped_scenes())


def test_a_shipped_scene_is_printed_as_it_stands():
    done = invoke("scenes", "gap_bridge")
    assert done.output == (ROOT / "diffeed/scenes/gap_bridge.toml").read_text()
    again = invoke("scenes", "gap_brige")
    assert again.exit_code == 2
    assert 'there is no shipped scene of that name; did you mean "gap_bridge"?; there are: film_feeder' in again.output


def test_every_method_is_named_in_the_help():
    assert all(method in invoke("run", "--help").output for method in diffeed.METHODS)


@pytest.mark.parametrize("group", [cli.main, bench, optimize_main])
def test_every_command_is_listed_by_a_whole_sentence(group):
    listed = CliRunner().invoke(group, ["--help"], terminal_width=80).output
    assert not re.search(r"\w\.\.\.", listed)
    assert all(name in listed for name in group.commands)


def test_results_are_not_overwritten_without_force(tmp_path):
    (tmp_path / "data.npz").write_text("precious")
    done = invoke("run", "film_feeder", "--out", str(tmp_path))
    assert done.exit_code == 2
    assert "already holds data.npz" in done.output
    assert "--force" in done.output
    assert (tmp_path / "data.npz").read_text() == "precious"


@pytest.mark.slow
def test_steps_by_their_error(tmp_path):
    """`--tolerance` reaches the run, says so in the summary, and is refused where it makes no sense."""
    scene = tmp_path / "mini.toml"
    scene.write_text(MINI)
    done = invoke("run", str(scene), "--tolerance", "0.01", "--out", str(tmp_path / "out"))
    assert done.exit_code == 0, done.output
    took = json.loads((tmp_path / "out" / "summary.json").read_text())["run"]
    assert took["tolerance"] == 0.01
    assert 0 < took["steps"] < 600
    assert took["dt"] == pytest.approx(0.06 / took["steps"])
    refused = invoke("run", str(scene), "--tolerance", "-1", "--method", "midpoint")
    assert refused.exit_code == 2
    assert "tolerance must be > 0 mm, but is -1.0" in refused.output
    assert (
        "with a tolerance, method must be one of linear_euler, extrapolated_euler, but is 'midpoint'" in refused.output
    )


def test_an_out_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "results").write_text("precious")
    done = invoke("run", "film_feeder", "--out", str(tmp_path / "results"))
    assert done.exit_code == 2
    assert "is a file" in done.output


def test_other_files_of_a_folder_are_left_alone(tmp_path):
    folders.refuse_overwriting(tmp_path / "new", outputs.FILES)
    (tmp_path / "notes.txt").write_text("mine")
    folders.refuse_overwriting(tmp_path, outputs.FILES)


def write_stubs(monkeypatch, **writers) -> None:
    monkeypatch.setattr(outputs, "_writers", lambda *_: {k.replace("_", "."): v for k, v in writers.items()})


def test_forced_results_replace_all_old_ones(tmp_path, monkeypatch):
    folder = tmp_path / "out"
    folder.mkdir()
    for name in ("notes.txt", "slip.png", "summary.json"):
        (folder / name).write_text("old")
    write_stubs(monkeypatch, scene_toml=lambda p: p.write_text("new"), summary_json=lambda p: p.write_text("new"))
    with folders.draft_of(folder) as draft:
        outputs.write_files(draft, folder, None, None, {})  # type: ignore[arg-type]
    found = {p.name: p.read_text() for p in folder.iterdir()}
    assert found == {"notes.txt": "old", "scene.toml": "new", "summary.json": "new"}
    assert list(tmp_path.iterdir()) == [folder]


def test_a_full_disk_leaves_no_folder_and_one_sentence(tmp_path, monkeypatch):
    def fill(path: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_stubs(monkeypatch, scene_toml=lambda p: p.write_text("new"), data_npz=fill)
    sentence = r"the results were not written to .*: No space left on device$"
    with pytest.raises(folders.OutputError, match=sentence), folders.draft_of(tmp_path / "out") as draft:
        outputs.write_files(draft, tmp_path / "out", None, None, {})  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_found_before_the_run(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(folders.OutputError, match=r"cannot write to .*: Not a directory"):
        folders.draft_of(tmp_path / "file" / "out").__enter__()


@pytest.mark.parametrize(("frames", "count"), [(2, 1), (11, 10), (101, 20), (102, 101), (1001, 20), (24, 23)])
def test_pieces_hold_whole_frames(frames, count):
    assert pieces.count_pieces(frames) == count


@pytest.mark.slow
def test_all_pieces_are_one_program(tmp_path):
    from diffeed.run.rollout import _simulate

    (tmp_path / "mini.toml").write_text(MINI)
    scene = diffeed.load_scene(tmp_path / "mini.toml")
    before = _simulate.program._cache_size()
    found = list(pieces.run_in_pieces(scene, 1e-3, 4, "linear_euler", report.OBSERVE))
    assert len(found) == 3
    finer = list(pieces.run_in_pieces(scene, 1e-3, 4, "linear_euler", report.OBSERVE, shorter=4))
    assert _simulate.program._cache_size() == before + 1
    for one, other in zip(found, finer, strict=True):
        np.testing.assert_allclose(other.time, one.time, rtol=1e-12)
        assert float(other.dt) == pytest.approx(0.25 * float(one.dt))
        assert int(other.steps) == 4 * int(one.steps)
    whole = diffeed.simulate(scene, dt=2.5e-4, frames=4)
    np.testing.assert_allclose(
        np.concatenate([p.sheets["strip"].nodes[1:] for p in finer]), whole.sheets["strip"].nodes[1:], atol=1e-7
    )


def test_without_a_place_for_a_cache_the_run_goes_on(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        assert "Not a directory" in tuning.keep_compilations()
        assert jax.config.values["jax_compilation_cache_dir"] is None
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "-"), (0.0, "0"), (-1e-9, "0"), (0.2578, "0.258"), (9.996, "9.996"), (-40.0, "-40.00"), (12345.6, "12346"),
     (1.5e7, "1.5e+07"), (999.96, "1000.0")],
)  # fmt: skip
def test_numbers_of_a_table_are_short(value, text):
    assert report._text(value) == text


@pytest.mark.parametrize("width", [80, 120])
def test_a_report_with_long_names_fits_the_terminal(width):
    name = "a_roller_with_a_name_of_forty_characters"
    nip = dict.fromkeys(
        ("contact_time", "slip_mean", "slip_rms", "creep_floor", "force_mean", "force_peak", "friction_mean",
         "torque_mean"), -1234.5678)  # fmt: skip
    sheet = {"arrivals": {name: {"lead": 0.5, "tail": None}}, "largest_curvature": 0.01, "fed": 300.0}
    sheet |= {"commanded": 300.0, "progress": 1.0, "longest_stall": 0.0}
    sheet["jam_margins"] = dict.fromkeys(("progress", "buckling", "fold", "attack", "gap"), -1234.5678)
    run = {"scene": "x", "simulated": 1.0, "steps": 10, "dt": 0.1, "error": 0.1, "method": "m", "precision": "float64"}
    summary = {
        "verdict": {"status": "jammed", "reason": "[x] stalled", "time": 0.5, "place": "here"},
        "rollers": {name: nip},
        "sheets": {name: sheet},
        "guides": {name: {"contact_time": 0.5, "force_mean": -1234.5678, "force_peak": 9.0}},
        "smallest_gaps": {f"rollers.{name}": -0.1, **{f"guides.{k}": 1.0 for k in range(20)}},
        "energy": {"work of drives": 0.0, "stored": 1.0},
        "run": run | {"compile_seconds": 1.0, "run_seconds": 1.0},
    }
    text = io.StringIO()
    report.print_report(Console(file=text, width=width, highlight=False, markup=False), summary)
    lines = text.getvalue().splitlines()
    assert lines[0] == "JAMMED: [x] stalled, at 0.5 s, here"
    assert max(map(len, lines)) <= width
    assert "…" not in text.getvalue()
    assert "-1235" in text.getvalue()
    assert "never" in text.getvalue()


def test_what_is_hardly_meant_is_said_and_what_is_not_there_is_guessed():
    done = invoke("check", "film_feeder", "--set", "sheets.film.youngs_modulus=3e9")
    assert "note: sheets.film.youngs_modulus is 3e+09 N/mm2: in Pa?" in done.output
    again = invoke("check", "film_feder")
    assert again.exit_code == 2
    assert 'nor a shipped scene of that name; did you mean "film_feeder"?' in again.output
    assert "checking" not in again.output, "nothing is checked of what is not there"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("duration=abc", "duration must be"),
        ("duration=[1,2]", "duration must be"),
        ("sheets.film=3", '"sheets.film" is a whole part: it must be a Sheet, or none, but is 3'),
        ("guides=3", "guides must be a table of named parts"),
    ],
)
def test_a_value_of_the_wrong_kind_is_said_before_any_remark(change, said):
    done = invoke("check", "film_feeder", "--set", change)
    assert done.exit_code == 2
    assert said in done.output


def test_steps_too_long_for_the_energy_are_told():
    assert report._unbalanced({"work of drives": 100.0, "numerical": 15.0}) == ""
    assert "too long" in report._unbalanced({"work of drives": 100.0, "numerical": -237.0})
    assert report._unbalanced({"work of drives": 0.0, "numerical": 1.0}) == ""
    assert "too long" in report._unbalanced({"work of drives": 0.0, "lost in friction": 0.2, "numerical": -0.1})


def test_a_tolerance_is_said_to_be_that_of_a_step():
    run = {"tolerance": 0.01}
    assert report._steps(run) == "The tolerance of 0.01 mm is that of each step; together they leave"
    assert report._steps({"tolerance": None}) == "The steps leave"


def test_before_and_after_tells_what_rollers_and_energies_do():
    def summary(torque, work):
        nip = {**dict.fromkeys(report.COMPARED, 1.0), "torque_mean": torque}
        return {
            "verdict": {"status": "passed"}, "sheets": {}, "rollers": {"drive": nip}, "energy": {"work of drives": work},
            "run": {"simulated": 1.0},
        }  # fmt: skip

    text = io.StringIO()
    report.print_changes(Console(file=text, width=80), summary(0.5, 3.0), summary(15.4, 4.0))
    rows = [line.split() for line in text.getvalue().splitlines()]
    assert ["drive:", "torque", "mean", "(N", "mm)", "0.5", "15.4", "+14.9"] in rows
    assert ["work", "of", "drives", "(N", "mm)", "3", "4", "+1"] in rows
    assert not [row for row in rows if "slip" in row]


@pytest.mark.parametrize(
    ("finer", "mark"),
    [
        ((2.0, 2.1), []),
        ((2.0, 2.06), []),
        ((2.0, 2.04), ["*"]),
        ((2.0, 1.9), ["*"]),
        ((None, 2.0), []),
        ((None, None), []),
    ],
)
def test_a_change_that_is_another_with_shorter_steps_is_marked(finer, mark):
    """An error that both runs have is none of their difference; where a run was not made again, nothing is known."""
    text, changed = io.StringIO(), "work of drives (N mm)"
    empty = {"verdict": {"status": "passed"}, "sheets": {}, "rollers": {}, "run": {"simulated": 1.0}}
    runs = [
        empty | {"energy": {"work of drives": value}} | ({} if again is None else {"finer": {changed: again}})
        for value, again in zip((3.0, 3.1), finer, strict=True)
    ]
    report.print_changes(Console(file=text, width=120), *runs)
    rows = [line.split() for line in text.getvalue().splitlines()]
    assert ["work", "of", "drives", "(N", "mm)", "3", "3.1", "+0.1", *mark] in rows
    assert ("*: not confirmed" in text.getvalue()) == bool(mark)


@pytest.mark.parametrize(("curvature", "radius"), [(0.01, "100.0"), (5e-17, "-"), (0.0, "-")])
def test_a_sheet_that_nothing_bends_has_no_radius(curvature, radius):
    row = {"largest_curvature": curvature, "fed": 300.0, "commanded": 300.0, "progress": 1.0, "longest_stall": 0.0}
    text = io.StringIO()
    Console(file=text, width=120).print(report._sheet_table({"film": row}))
    (line,) = (line for line in text.getvalue().splitlines() if line.startswith("film"))
    assert line.split()[2] == radius
