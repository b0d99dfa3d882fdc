"""A tolerance study end to end on a small scene: known answers, the same rows however they are run, nothing lost."""

import contextlib
import io
import json
import os
import subprocess
import sys
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from scipy import stats
from stand_in_nip import nip
from test_optimize_cli import ROOT

import diffeed
from diffeed import measures, tuning
from diffeed.readings.verdict import Verdict
from optimize.asked import StudyError
from optimize.terms import TERMS, Term
from optimize.tolerance import latitude as latitude_of
from optimize.tolerance import report
from optimize.tolerance.contributions import indices, refuse_groups, slopes
from optimize.tolerance.folder import INDICES, PICTURES, Folder, FolderError, names_of, pictures_of, read_rows
from optimize.tolerance.latitude import latitude
from optimize.tolerance.problem import load_tolerance, make_tolerance, rest_of, unpacked
from optimize.tolerance.replay import judged, replay, sample_scene
from optimize.tolerance.report import print_summary, write_result
from optimize.tolerance.run import Rows, chosen, run_of
from optimize.tolerance.spread import chunk_size
from optimize.tolerance.study import drawn, here, run_rows, run_study
from optimize.tolerance.summary import summarise, tighten

STUDY = {
    "scene": "nip",
    "title": "A nip",
    "duration": 0.01,
    "dt": 5e-4,
    "frames": 5,
    "samples": 24,
    "tolerances": {
        "preload": {"path": "rollers.pinch.preload", "sigma": 0.1},
        "spring": {"path": "rollers.pinch.spring", "relative": True, "sigma": 0.01},
    },
    "measures": {"fed": {"measure": "fed"}},
    "limits": {"force": {"measure": "nip_force", "of": "pinch", "at_most": 3.128}},
}


def problem(scene=None, **changes):
    return make_tolerance(STUDY | changes, scene=nip(initial="settled") if scene is None else scene)


@pytest.fixture(scope="module")
def rows():
    return run_study(problem(), here(problem(), 8))


def same(a, b):
    return all(np.array_equal(x, y, equal_nan=x.dtype.kind == "f") for x, y in zip(a, b, strict=True))


# --- known answers ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_linear_measure_has_the_known_variance_and_blame(rows):
    """A settled nip carries its preload and the little by which its spring is compressed: force = preload + spring u."""
    summary = summarise(problem(), rows, slopes(problem(), rows.deviation[:4]))
    force = rows.values[:, 1]
    assert np.std(force) == pytest.approx(np.std(rows.deviation[:, 0]), rel=0.01)
    blame = summary["contributions"]["force"]
    assert blame["regression"][0] == pytest.approx(1.0, abs=0.01)
    assert blame["first order"][0] > 0.99
    assert blame["derivative based"][0] > 0.99
    assert blame["first order std"] == pytest.approx(0.1, rel=0.01)


@pytest.mark.long
def test_a_known_share_breaks_its_limit():
    study = problem(samples=256, sampling="sobol", dt=1e-3)
    found = run_study(study, here(study, 64))
    nominal = found.values[np.argmin(np.abs(found.deviation).sum(axis=1)), 1]
    slope = np.polyfit(found.deviation[:, 0], found.values[:, 1], 1)[0]
    expected = stats.norm.sf((3.128 - nominal) / (0.1 * slope))
    summary = summarise(study, found)
    share = summary["fails"]["force above 3.128"]
    assert share["value"] == pytest.approx(expected, abs=0.01)
    assert share["low"] < expected < share["high"]
    assert share["value"] > 0.05
    screen = Console(file=io.StringIO(), width=120)
    print_summary(screen, summary)
    assert "those of sobol mostly scatter less" in screen.file.getvalue()


@pytest.mark.slow
def test_a_known_share_jams():
    """A wall at the end of a channel: where the opening in it is out of the sheet's way, the sheet stands still."""
    scene = nip(initial="settled", speed=-200.0)
    walls = {
        "roof": diffeed.LineGuide(start=(15.5, 0.6), end=(3.0, 0.6)),
        "floor": diffeed.LineGuide(start=(3.0, -0.6), end=(15.5, -0.6)),
        "over": diffeed.LineGuide(start=(16.0, 2.0), end=(16.0, 40.0), friction=0.5),
        "under": diffeed.LineGuide(start=(16.0, -40.0), end=(16.0, -2.0), friction=0.5),
    }
    scene = diffeed.scene(**{**vars(scene), "guides": {**scene.guides, **walls}})
    study = problem(
        scene, duration=0.06, dt=2e-4, frames=61, samples=64, sampling="sobol", limits={}, measures={},
        tolerances={"walls": {"shift": ["guides.over", "guides.under"], "tied": True, "direction": [0.0, 1.0],
                              "kind": "uniform", "tolerance": 6.0}},
    )  # fmt: skip
    found = run_study(study, here(study, 32))
    off = np.abs(found.deviation[:, 0])
    open_, shut = off < 1.0, off > 2.7  # between them it depends on how the corner is met
    assert np.mean(shut) == pytest.approx(1.0 - 2.7 / 6.0, abs=0.03)
    assert np.all(found.status[open_] == 0)
    assert np.all(found.status[shut] >= 2)


@pytest.mark.long
def test_a_sheet_that_fails_numerically_is_no_pass():
    """With a preload of thousands of newtons the pinch goes through the sheet in some samples."""
    study = problem(tolerances={"preload": {"path": "rollers.pinch.preload", "sigma": 1e5}}, samples=8)
    found = run_study(study, here(study, 8))
    failed = found.status == measures.STATUSES.index("failed")
    assert failed.any()
    assert not failed.all()
    assert not found.passed[failed].any()
    assert np.isnan(found.values[failed]).all()
    ways = summarise(study, found)["fails"]
    assert ways["simulation failed"]["count"] == failed.sum()
    assert ways["in all"]["count"] >= failed.sum()


@pytest.mark.slow
def test_slopes_are_those_of_differences(rows):
    at = np.zeros((1, 2))
    found = slopes(problem(), at)
    assert np.array_equal(found.nominal, found.samples[0])
    evaluate = here(problem(), 4)
    step = np.array([[1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]])
    (seen,) = evaluate(np.arange(4), step)
    assert found.nominal[:, 0] == pytest.approx((seen.values[0] - seen.values[1]) / 2e-3, rel=1e-4, abs=1e-7)
    assert found.nominal[:, 1] == pytest.approx((seen.values[2] - seen.values[3]) / 2e-3, rel=1e-4, abs=1e-7)


def test_what_is_to_blame_is_shown_where_there_is_no_slope_at_the_nominal_scene():
    """Shares that are known stand in the table; a kind of which nothing is known has no column."""
    none, blame = [None, None], {"std": 1.0, "regression": [0.7, 0.3], "explained": 0.99, "first order std": None}
    few = {"std": 1.0, "regression": none, "explained": None, "sobol total": [0.6, 0.4]}

    def told(blame):
        text = io.StringIO()
        report._print_blame(Console(file=text, width=100), "arrival", blame, ["a", "b"])
        return text.getvalue()

    found = told(blame | {"first order": none})
    assert found == told(blame)
    assert "70 %" in found
    assert "a straight line explains 99 %" in found
    found = told(few)
    assert "60 %" in found
    assert "Sobol total" in found
    assert "regression" not in found
    assert "straight line" not in found
    assert told(few | {"sobol total": none}) == ""


@pytest.mark.slow
def test_sobol_indices_blame_the_preload():
    study = problem()
    found = indices(study, 64, here(study, 8), None)[1]
    assert found.first[0] == pytest.approx(1.0, abs=0.1)
    assert found.total[1] == pytest.approx(0.0, abs=0.05)


def test_a_study_that_asks_for_nothing_has_no_slopes():
    study = problem(nip(), measures={}, limits={})
    found = slopes(study, np.zeros((3, 2)))
    assert found.nominal.shape == (0, 2)
    assert found.samples.shape == (3, 0, 2)


def test_blame_falls_on_the_number_that_moves_the_measure_not_on_another_of_its_part():
    place = {"path": ["rollers.pinch.center[0]", "rollers.pinch.center[1]"], "sigma": 0.01}
    study = problem(tolerances={"place": place}, limits={})
    off, nothing = drawn(study), np.zeros(24)
    summary = summarise(
        study, Rows(np.arange(24), off, nothing.astype(int), nothing, nothing, off[:, 1:], np.zeros((24, 0), bool))
    )
    assert len(summary["inputs"]) == 2
    screen = Console(file=io.StringIO(), width=120)
    print_summary(screen, summary)
    first, second = (line for line in screen.file.getvalue().splitlines() if "rollers.pinch" in line)
    assert first.split() == ["place[rollers.pinch.center[1]]", "100", "%"]
    assert second.startswith("place[rollers.pinch.center[0]]")


# --- what tightening brings ---------------------------------------------------------------------------------------------


BATCH = {"group": "batch", "correlation": 0.8}
SPRING = {"path": "rollers.pinch.spring", "sigma": 0.01} | BATCH


def tightened(passing, samples=20_000, **tolerances):
    """What `tighten` finds where a sample passes by its deviations alone, (samples, inputs)."""
    study = problem(nip(), tolerances=tolerances, samples=samples)
    off, nothing = drawn(study), np.zeros(samples)
    status, broken = np.where(passing(off), 0, 1), np.zeros((samples, 0), bool)
    return tighten(study, Rows(np.arange(samples), off, status, nothing, nothing, off, broken))


@pytest.mark.parametrize(
    "other",
    [
        {"kind": "uniform", "tolerance": 0.5},
        {"kind": "triangular", "tolerance": 0.6},
        {"kind": "truncated_normal", "tolerance": 0.6},
        {"sigma": 0.25},
    ],
)
def test_what_only_goes_with_the_cause_brings_nothing(other):
    """Samples pass by their preload alone, whose group the spring is of: a tighter spring lets no more of them pass."""
    preload = {"path": "rollers.pinch.preload"} | BATCH | other
    found = tightened(lambda off: np.abs(off[:, 1]) < 0.3, spring=SPRING, preload=preload)["spring"]
    assert abs(found["gain"]) < 3.0 * found["error"] < 0.01


def test_the_gain_in_a_group_of_two_kinds_is_that_of_tighter_parts():
    """The pass depends on both: the same draws with a spring scatter 5 % smaller and larger give the slope."""
    preload = {"path": "rollers.pinch.preload", "kind": "uniform", "tolerance": 0.5} | BATCH

    def passing(off, by=1.0):
        return np.abs(off[:, 1] / 0.5 + by * off[:, 0] / 0.01) < 1.5

    found = tightened(passing, 100_000, spring=SPRING, preload=preload)
    off = drawn(problem(nip(), tolerances={"spring": SPRING, "preload": preload}, samples=100_000))
    slope = (passing(off, 1.05).mean() - passing(off, 0.95).mean()) / 0.1
    assert found["spring"]["gain"] == pytest.approx(-0.1 * slope, abs=4.0 * found["spring"]["error"])
    assert found["spring"]["error"] < 0.1 * found["spring"]["gain"]
    assert np.isnan(found["preload"]["gain"])


def test_one_of_inputs_that_are_one_has_no_estimate():
    """Two numbers of one draw: no sample says what one tightened without the other does; tightened together they have one."""
    one, other = (
        {"path": f"rollers.{part}.friction", "sigma": 0.05, "group": "g", "correlation": 1.0}
        for part in ("drive", "pinch")
    )
    found = tightened(lambda off: np.abs(off[:, 0]) < 0.05, 2000, one=one, other=other)
    assert np.isnan([found["one"]["gain"], found["other"]["gain"]]).all()
    both = tightened(lambda off: np.abs(off[:, 0]) < 0.05, 2000, both=one | {"path": [one["path"], other["path"]]})[
        "both"
    ]
    assert both["gain"] > 3.0 * both["error"]


def test_a_gain_without_an_estimate_is_explained():
    """A dash in the table has its reasons beneath."""
    study = problem(nip(), tolerances={"preload": STUDY["tolerances"]["preload"] | {"kind": "triangular"}})
    off, nothing = drawn(study), np.zeros(24)
    rows = Rows(np.arange(24), off, nothing.astype(int), nothing, nothing, np.zeros((24, 2)), np.zeros((24, 1), bool))
    screen = Console(file=io.StringIO(), width=200)
    print_summary(screen, summarise(study, rows))
    assert '"-": no estimate' in screen.file.getvalue()


# --- the same however it is run -----------------------------------------------------------------------------------------


@pytest.mark.long
def test_rows_do_not_depend_on_the_chunk(rows):
    other = run_study(problem(), here(problem(), 5))
    assert np.array_equal(other.deviation, rows.deviation)
    assert other.values == pytest.approx(rows.values, rel=1e-9)
    assert np.array_equal(other.status, rows.status)


def test_resuming_a_truncated_study_gives_the_same_bits(rows, tmp_path):
    folder = tmp_path / "made"
    assert same(run_study(problem(), here(problem(), 8), folder), rows)
    assert same(read_rows(folder, problem(), drawn(problem())), rows)
    table = folder / "samples.csv"
    text = table.read_bytes()
    for keep in (len(text) // 2, len(text) - 3, 40, 0):
        table.write_bytes(text[:keep])
        ran = []
        again = run_study(
            problem(), here(problem(), 8), folder, resume=True, show=lambda *told, ran=ran: ran.append(told[2])
        )
        assert same(again, rows), keep
        assert 0 < sum(ran) <= 24
        assert table.read_bytes() == text
    more = run_study(problem(samples=32), here(problem(), 8), folder, resume=True)
    assert same((v[:24] for v in more), rows)


def test_fewer_samples_leave_the_rows_of_the_others(rows, tmp_path):
    folder = tmp_path / "made"
    run_study(problem(), here(problem(), 8), folder)
    text = (folder / "samples.csv").read_bytes()
    fewer = run_study(problem(samples=10), None, folder, resume=True)
    assert same(fewer, [v[:10] for v in rows])
    assert (folder / "samples.csv").read_bytes() == text


def test_only_rows_of_the_numbers_that_are_asked_for_are_kept(rows, tmp_path):
    """The runs of 2 Sobol points and those of 4 have the same numbers, and other deviations."""
    study = problem()
    run_study(study, here(study, 8), tmp_path / "made")
    first = rows.deviation[:6]
    found = run_rows(study, first, here(study, 8), Folder(tmp_path / "made", study, "indices"), resume=True)
    assert np.array_equal(found.deviation, first)
    other = rows.deviation[10:18]
    again = run_rows(study, other, here(study, 8), Folder(tmp_path / "made", study, "indices"), resume=True)
    assert np.array_equal(again.deviation, other)
    assert np.array_equal(again.values, rows.values[10:18])


def test_an_earlier_study_is_compared_sample_by_sample(rows, tmp_path):
    run_study(problem(), here(problem(), 8), tmp_path / "made")
    fewer = problem(samples=10)
    assert same(read_rows(tmp_path / "made", fewer, drawn(fewer)), [v[:10] for v in rows])
    with pytest.raises(FolderError, match="drew other deviations"):
        read_rows(tmp_path / "made", problem(seed=1), drawn(problem(seed=1)))
    other = problem(limits={})
    with pytest.raises(
        FolderError, match="headings of this study; compare studies of the same tolerances, measures and"
    ):
        read_rows(tmp_path / "made", other, drawn(other))


def test_a_study_with_fewer_samples_is_not_compared(tmp_path):
    """Shares of two numbers of draws would stand side by side; a sample that was written twice counts once."""
    study = problem(samples=4)
    deviation = drawn(study)
    blank = {"status": np.zeros(4, int), "reason": np.zeros(4, int), "time": np.zeros(4)}
    made = Rows(np.arange(4), deviation, **blank, values=np.zeros((4, 2)), broken=np.zeros((4, 1), bool))
    folder = Folder(tmp_path / "made", study)
    folder.start(resume=False, force=False)
    try:
        folder.add(chosen(made, np.array([0, 0, 2])))
        with pytest.raises(
            FolderError, match=r"samples.csv holds 2 of the 4 samples to compare with; finish that study"
        ):
            read_rows(tmp_path / "made", study, deviation)
        folder.add(chosen(made, np.array([3, 1])))
        assert same(read_rows(tmp_path / "made", study, deviation), made)
    finally:
        folder.close()


def test_indices_of_a_group_are_refused_before_anything_is_run():
    rubber = {"path": ["rollers.drive.friction", "rollers.pinch.friction"], "sigma": 0.01, "group": "batch"}
    with pytest.raises(ValueError, match="draws groups together: batch"):
        refuse_groups(problem(tolerances={"rubber": rubber}))


@pytest.mark.long
def test_a_folder_belongs_to_one_study(rows, tmp_path):
    folder = tmp_path / "made"
    run_study(problem(samples=2), here(problem(), 2), folder)
    with pytest.raises(FolderError, match="already holds a study; add --resume"):
        run_study(problem(samples=2), None, folder)
    with pytest.raises(FolderError, match="holds another study; name another folder, or give --force instead of"):
        run_study(problem(seed=1), None, folder, resume=True)
    with pytest.raises(FolderError, match="holds no study to resume"):
        run_study(problem(), None, tmp_path / "none", resume=True)
    other = tmp_path / "photos"
    other.mkdir()
    (other / "cat.jpg").write_text("meow")
    with pytest.raises(FolderError, match="holds other files"):
        run_study(problem(), None, other)
    assert [p.name for p in other.iterdir()] == ["cat.jpg"]
    lines = (folder / "samples.csv").read_text().splitlines()
    (folder / "samples.csv").write_text("\n".join([lines[0], lines[1].replace("passed", "psased"), lines[2]]) + "\n")
    with pytest.raises(FolderError, match="line 2 cannot be read"):
        run_study(problem(samples=2), None, folder, resume=True)


def test_a_study_is_replaced_with_its_pictures_and_its_users_files_stay(rows, tmp_path):
    """Its old pictures would look like those of the new study."""
    folder, study = tmp_path / "made", problem()
    run_study(study, here(study, 8), folder)
    made = write_result(folder, study, rows, summarise(study, rows), pictures=True)
    assert set(made) >= {*PICTURES, *pictures_of("fed"), *pictures_of("force")}
    for name in (f"{INDICES}.csv", *names_of(3)):
        (folder / name).write_text("")
    mine = {"parts.csv", "my_histogram.png", "force_histogram.csv", "sample_3_mine.toml"}
    for name in mine:
        (folder / name).write_text("mine")
    new = Folder(folder, problem(seed=1, measures={}, limits={}))
    new.start(resume=False, force=True)
    new.close()
    assert {p.name for p in folder.iterdir()} == mine | {"study.json", "samples.csv"}


def test_two_runs_do_not_write_into_one_folder(tmp_path):
    first, second = Folder(tmp_path / "made", problem()), Folder(tmp_path / "made", problem())
    first.start(resume=False, force=False)
    try:
        with pytest.raises(FolderError, match="is being written by another run"):
            second.start(resume=True, force=False)
    finally:
        first.close()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_a_full_disk_is_told_and_keeps_what_is_there(rows, tmp_path):
    folder = Folder(tmp_path / "made", problem())
    folder.start(resume=False, force=False)
    folder.close()
    folder._stream = open("/dev/full", "w")  # noqa: SIM115
    with pytest.raises(FolderError, match="No space left"):
        folder.add(rows)
    with contextlib.suppress(OSError):
        folder.close()


def test_a_worker_gets_numbers_and_measures_in_the_order_of_the_study(monkeypatch):
    """Rows come back by place: a study that was sorted on its way would move the wrong part."""
    distributed = pytest.importorskip("dask.distributed")
    from optimize.tolerance.cluster import on_cluster

    class Task:
        def __init__(self, function, text, *given, **how):
            self.result, self.release = lambda: unpacked(json.loads(text)), lambda: None

    class Client:
        submit = Task

    monkeypatch.setattr(distributed, "as_completed", iter)
    tolerances, limit = STUDY["tolerances"], STUDY["limits"]["force"]
    study = problem(
        tolerances={name: tolerances[name] for name in ("spring", "preload")}, samples=4,
        limits={"zero": {"measure": "fed", "at_least": -1e3}, "force": limit},
    )  # fmt: skip
    (there,) = on_cluster(study, Client(), 4)(np.arange(4), drawn(study))
    assert [i.name for i in there.inputs] == ["spring", "preload"]
    assert [a.name for a in there.asked] == ["fed", "zero", "force"]


def test_a_cluster_that_gives_up_says_so_in_a_sentence(monkeypatch):
    distributed = pytest.importorskip("dask.distributed")
    from optimize.tolerance.cluster import ClusterError, on_cluster

    class Task:
        def result(self):
            raise distributed.CancelledError("run_chunk-1", "scheduler restarted")

    class Client:
        def submit(self, *given, **how):
            return Task()

    monkeypatch.setattr(distributed, "as_completed", iter)
    with pytest.raises(
        ClusterError, match=r"^the cluster gave up: .*run_chunk-1.*; what was run is kept, --resume goes on$"
    ):
        list(on_cluster(problem(), Client(), 4)(np.arange(4), drawn(problem())[:4]))


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_gives_the_same_rows(rows):
    from optimize.tolerance.cluster import connect, on_cluster

    with connect(None, 2) as client:
        killed = []

        def show(done, failed, now):
            if not killed:
                workers = sorted(client.run(os.getpid).values())
                killed.append(workers[0])
                os.kill(workers[0], 9)

        found = run_study(problem(), on_cluster(problem(), client, 8), show=show)
    assert killed
    assert same(found, rows)


@pytest.mark.slow
def test_two_devices_give_the_same_rows(rows, tmp_path):
    """In a process of its own: devices are made before the first computation."""
    code = """
import sys
sys.path.insert(0, "tests")
import jax
jax.config.update("jax_enable_x64", True)
from diffeed import tuning
tuning.use_all_cores(); jax.config.update("jax_num_cpu_devices", 2)
import os; os.environ["NPROC"] = "16"
from test_tolerance_study import problem, run_study, here
import numpy as np
found = run_study(problem(), here(problem(), 8))
np.save(sys.argv[1], found.values)
assert len(jax.devices()) == 2
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "v.npy")], check=True, cwd=ROOT, timeout=300)
    assert np.load(tmp_path / "v.npy") == pytest.approx(rows.values, rel=1e-9)


# --- maps, replays, the command -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_latitude_tells_what_passes_and_by_what_margin(monkeypatch):
    study = problem(
        latitude={"x": {"path": "sheets.strip.thickness", "range": [0.1, 0.3], "points": 3},
                  "y": {"path": "sheets.strip.curl", "range": [-0.01, 0.01], "points": 3}},
    )  # fmt: skip
    found = latitude(study)  # more points than one core takes at once
    assert found.margin.shape == found.passed.shape == (3, 3)
    assert np.isfinite(found.margin).all()
    scene = diffeed.put(diffeed.put(study.scene, "sheets.strip.thickness", 0.3), "sheets.strip.curl", 0.01)
    run = diffeed.simulate(scene, 0.01, 5e-4, 5, observe=("feed", "spans"))
    assert found.margin[2, 2] == pytest.approx(float(measures.jam_margin(scene, run)), rel=1e-6)
    assert found.labels[0] == "sheets.strip.thickness, mm"
    # The machine before and after a change: one program for both.
    monkeypatch.setattr(latitude_of, "run_of", None)
    other = latitude(study, diffeed.put(study.scene, "rollers.pinch.preload", 1.0))
    softer = diffeed.put(scene, "rollers.pinch.preload", 1.0)
    run = diffeed.simulate(softer, 0.01, 5e-4, 5, observe=("feed", "spans"))
    assert other.margin[2, 2] == pytest.approx(float(measures.jam_margin(softer, run)), rel=1e-6)
    assert abs(other.margin[2, 2] - found.margin[2, 2]) > 1e-6


def test_what_breaks_a_limit_does_not_pass(monkeypatch, tmp_path):
    """In the map as among the samples; the replay names the limit. Made-up runs: all of them pass their verdict."""
    of = lambda scene, *_: scene.sheets["strip"].thickness  # noqa: E731
    monkeypatch.setitem(TERMS, "made_up", Term(of, "", "mm", "made up"))
    study = make_tolerance(
        STUDY | {
            "limits": {"made_up": {"measure": "made_up", "at_most": 0.25}},
            "latitude": {"x": {"path": "sheets.strip.thickness", "range": [0.1, 0.3], "points": 3},
                         "y": {"path": "sheets.strip.curl", "range": [-0.01, 0.01], "points": 2}},
        },
        scene=nip(),
    )  # fmt: skip
    made = SimpleNamespace(ok=jnp.asarray(True))
    monkeypatch.setattr(latitude_of, "run_of", lambda *_: made)
    monkeypatch.setattr(measures, "jam_margin", lambda scene, run: jnp.asarray(0.5))
    monkeypatch.setattr(measures, "outcome", lambda scene, run: SimpleNamespace(status=jnp.asarray(0)))
    assert latitude(study).passed.tolist() == [[True, True, False]] * 2

    monkeypatch.setattr(measures, "verdict", lambda scene, run: Verdict("passed", "it moved", None, ""))
    thick = diffeed.put(study.scene, "sheets.strip.thickness", 0.3)
    assert judged(study, study.scene, made) == "passed: it moved"
    assert judged(study, thick, made) == "passed: it moved, but breaks its limits: made_up above 0.25 (it is 0.3 mm)"
    failed = SimpleNamespace(ok=jnp.asarray(False))
    assert judged(study, thick, failed) == "passed: it moved"


@pytest.mark.long
def test_a_sample_is_replayed_with_the_parts_that_it_drew(rows, tmp_path):
    path, verdict = replay(problem(), 7, tmp_path)
    assert path.stat().st_size > 5000
    assert verdict.startswith("passed")
    scene = diffeed.load_scene(tmp_path / "sample_7.toml")
    assert float(scene.rollers["pinch"].preload) == pytest.approx(3.0 + rows.deviation[7, 0], rel=1e-12)
    with pytest.raises(ValueError, match="samples 0 to 23"):
        replay(problem(), 24, tmp_path)


def test_no_sample_of_another_study_is_written_beside_the_rows(tmp_path):
    study = problem(sampling="latin_hypercube")
    kept = Folder(tmp_path, study)
    kept.start(resume=False, force=False)
    kept.close()
    for other in (study.changed(samples=12), problem(sampling="latin_hypercube", seed=1)):
        with pytest.raises(FolderError, match=r"holds another study; name another folder$"):
            replay(other, 7, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"study.json", "samples.csv"}


def test_shipped_study_fits_its_scene():
    study = load_tolerance("film_tolerances")
    assert len(study.study.tolerances) == 12
    assert len(study.inputs) == 24
    with pytest.raises(StudyError, match="design search"):
        load_tolerance("nip_slip")


@pytest.mark.slow
def test_the_command_from_study_to_pictures(tmp_path):
    diffeed.save_scene(nip(initial="settled"), tmp_path / "nip.toml")
    (tmp_path / "study.toml").write_text(
        """
title = "A nip"
scene = "nip.toml"
duration = 0.01
dt = 5e-4
frames = 5
samples = 24
[tolerances.preload]
path = "rollers.pinch.preload"
sigma = 0.1
[tolerances.radius]
path = ["rollers.drive.radius", "rollers.pinch.radius"]
tolerance = 0.05
[limits.force]
measure = "nip_force"
of = "pinch"
at_most = 3.128
[latitude.x]
path = "sheets.strip.thickness"
range = [0.1, 0.3]
[latitude.y]
path = "sheets.strip.curl"
range = [-0.01, 0.01]
"""
    )

    def run(*words):
        return subprocess.run(
            [sys.executable, "-m", "optimize", *words], cwd=tmp_path, capture_output=True, text=True, timeout=300,
            env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": str(ROOT), "COLUMNS": "110"},
        )  # fmt: skip

    done = run("tolerance", "study.toml", "--out", "made", "--gradients", "4", "--indices", "8")
    assert done.returncode == 0, done.stderr
    assert "A nip: 24 samples" in done.stdout
    assert "they agree" in done.stdout
    summary = json.loads((tmp_path / "made/result.json").read_text())
    assert summary["samples"] == 24
    assert set(summary["inputs"]) == {"preload", "radius[drive]", "radius[pinch]"}
    for name in ("convergence.png", "force_histogram.png", "force_distribution.png", "force_contributions.png"):
        assert (tmp_path / "made" / name).stat().st_size > 5000, name
    again = run("tolerance", "study.toml", "--out", "made")
    assert again.returncode == 2
    assert "--resume" in again.stderr
    more = run("tolerance", "study.toml", "--out", "made", "--resume", "--samples", "30", "--no-pictures")
    assert more.returncode == 0, more.stderr
    assert not list((tmp_path / "made").glob("*.png")), "pictures of 24 samples beside the numbers of 30"
    compared = run("tolerance", "study.toml", "--out", "after", "--before", "made", "--samples", "30")
    assert compared.returncode == 0, compared.stderr
    assert "before" in compared.stdout
    mapped = run("latitude", "study.toml", "--points", "3", "--out", "map")
    assert mapped.returncode == 0, mapped.stderr
    assert "of 9 sheets pass" in mapped.stdout
    assert (tmp_path / "map/latitude.png").stat().st_size > 5000
    played = run("tolerance", "study.toml", "--replay", "3", "--out", "made")
    assert played.returncode == 0, played.stderr
    assert (tmp_path / "made/sample_3.html").exists()
    bad = run("tolerance", "study.toml", "--indices", "6")
    assert bad.returncode == 2
    assert "power of two" in bad.stderr


ARRIVAL = {"measures": {"arrival": {"measure": "arrival", "at": "gate"}}, "limits": {}, "samples": 2}


@pytest.mark.long
def test_what_never_arrives_is_no_time():
    """Within 10 ms the strip is fed half a millimetre of the one to the gate: infinite, and counted apart."""
    study = problem(**ARRIVAL)
    rows = run_study(study, here(study, 2))
    assert np.isinf(rows.values[:, 0]).all()
    found = summarise(study, rows)["measures"]["arrival"]
    assert (found["runs"], found["never"], found["mean"]) == (2, 2, None)
    text = io.StringIO()
    print_summary(Console(file=text, width=120), summarise(study, rows))
    assert "arrival: never in 2 of 2 samples; mean and std are of the others" in text.getvalue()


@pytest.mark.slow
def test_what_never_arrives_has_no_slope_and_breaks_a_limit():
    study = problem(**ARRIVAL)
    assert np.isnan(slopes(study, drawn(study)[:1]).samples).all()
    late = problem(limits={"arrival": {"measure": "arrival", "at": "gate", "at_most": 0.005}})
    scene = sample_scene(late, 0)
    assert judged(late, scene, run_of(late, scene, rest_of(late))).endswith(
        "breaks its limits: arrival above 0.005 (never)"
    )


@pytest.mark.parametrize(
    ("memory", "rows", "at_once"),
    [(80e9, 1, 16), (80e9, 1000, 1024), (80e9, 10**6, 16384), (1e8, 1000, 128), (1e3, 1000, 16), (None, 1000, 1024)],
)
def test_an_accelerator_computes_at_once_what_fits_its_memory_and_no_more_than_there_are(
    monkeypatch, memory, rows, at_once
):
    """At 0.1 MB a sample; a quarter of the memory is for them. Where the memory is not told, 8 GB are taken for granted."""
    card = SimpleNamespace(platform="gpu", memory_stats=lambda: memory and {"bytes_limit": memory})
    monkeypatch.setattr(tuning, "safe_devices", lambda devices: [card])
    assert chunk_size(lambda: 10**5, rows) == at_once
    monkeypatch.setattr(tuning, "safe_devices", lambda devices: [card, card])
    assert chunk_size(lambda: 10**5, 2 * rows) == 2 * at_once
