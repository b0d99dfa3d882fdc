"""The stability map: how a run is judged, that what blows up is seen, what is counted, drawn and written."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import diffeed
from diffeed import cli
from diffeed.bench import files, machine, report, stability, stability_chart
from diffeed.bench.stability import Case, Doubted, Paths, judge
from diffeed.bench.stability_scene import AXES, BASE, vary
from diffeed.faults.causes import CAUSES, TOO_FAST


@pytest.mark.parametrize(
    ("ok", "error", "doubt", "became"),
    [
        (True, 0.05, 0.01, "right"),
        (True, 0.2, 0.01, "inaccurate"),
        (True, 5.2, 0.1, "wrong"),
        (True, 5.2, 0.5, "inaccurate"),
        (True, 0.095, 0.01, "unclear"),
        (True, 3.0, 4.0, "unclear"),
        (True, 0.0, np.inf, "unclear"),
        (True, np.nan, 0.0, "wrong"),
        (True, np.inf, np.inf, "wrong"),
        (False, 0.0, 0.0, "failed"),
        (False, np.nan, np.inf, "failed"),
    ],
)
def test_judging(ok, error, doubt, became):
    assert judge(ok, error, doubt) == became


def test_errors_are_the_largest_over_frames_and_nodes():
    reference = np.zeros((2, 3, 4, 2))
    found = reference.copy()
    found[0, 1, 2] = (3.0, 4.0)
    found[1, 2, 0, 1] = np.nan
    np.testing.assert_array_equal(stability.apart(found, reference), [5.0, np.nan])


@pytest.mark.parametrize("axis", [pytest.param(n, marks=[pytest.mark.slow] * (n == "bars")) for n in AXES])
def test_every_scene_of_the_map_is_sound_and_differs(axis):
    ends = AXES[axis].values[0], AXES[axis].values[-1]
    assert all(diffeed.check(vary(axis, v)) == [] for v in ends)
    assert AXES[axis].values[0] < BASE[axis] < AXES[axis].values[-1]


def test_frames_hold_whole_pieces():
    fine = (stability.FINE, 2.0 * stability.FINE, stability.QUICK_FINE, 2.0 * stability.QUICK_FINE)
    for dt in (*stability.STEPS, *fine):
        assert stability.FRAME / dt == pytest.approx(round(stability.FRAME / dt))


def test_every_value_is_in_one_batch_with_others_of_its_structure():
    groups = stability._groups(quick=False)
    assert sorted(c for g in groups for c in g) == sorted(Case(n, v) for n, a in AXES.items() for v in a.values)
    assert len(groups) == len(AXES["bars"].values)
    assert Case("bars", BASE["bars"]) in groups[0]
    assert len(stability._groups(quick=True)) == 1


@pytest.fixture(scope="module")
def batch() -> stability.Batch:
    return stability.Batch([Case("bars", 5), Case("bars", 5)])


@pytest.mark.long
def test_a_run_far_above_the_limit_fails_and_was_refused(batch):
    rows = list(batch.rows("runge_kutta", 2e-3, batch.run("runge_kutta", 2e-3), NOTHING, [1e-4, 1e-4]))
    assert {(r["became"], r["refused"]) for r in rows} == {("failed", True)}
    assert all(r["cause"] in CAUSES[1:] for r in rows)
    assert all(r["error_mm"] is None for r in rows)


@pytest.mark.slow
def test_the_limit_of_a_case_is_that_of_check(batch):
    assert batch.limits[0] == batch.limits[1]
    assert diffeed.check(vary("bars", 5), 0.99 * batch.limits[0], "runge_kutta") == []
    assert diffeed.check(vary("bars", 5), 1.01 * batch.limits[0], "runge_kutta") != []


@pytest.mark.slow
def test_pieces_are_the_run_that_simulate_makes(batch):
    whole = diffeed.simulate(vary("bars", 5), stability.FRAME * stability.FRAMES, 2e-3, stability.FRAMES + 1)
    found = batch.run("linear_euler", 2e-3)
    np.testing.assert_allclose(found.nodes[1], whole.sheets["sheet"].nodes[1:], atol=1e-9)
    assert bool(whole.ok) == (found.cause[1] == 0)


NOTHING = Doubted(np.zeros((2, stability.FRAMES, 6, 2)), np.zeros(2))


def test_rows_say_what_became_of_a_run(batch):
    nodes = np.zeros((2, stability.FRAMES, 6, 2))
    nodes[0, -1, 0, 0] = 7.0
    rows = list(batch.rows("midpoint", 1e-3, Paths(nodes, np.array([0, TOO_FAST]), np.array([4.0, 5.0])), NOTHING))
    assert [(r["became"], r["refused"], r["error_mm"], r["told_mm"], r["cause"]) for r in rows] == [
        ("wrong", False, 7.0, 4.0, ""),
        ("failed", False, None, None, CAUSES[TOO_FAST]),
    ]


def made_up() -> list[dict]:
    """Rows of two steppers by two numbers, every class among them."""
    found = []
    for method, limit in (("linear_euler", None), ("runge_kutta", 2e-4)):
        for k, became in enumerate(stability.CLASSES):
            for axis in ("tension", "bars"):
                size = 10.0 ** (-k - 1)
                found.append({
                    "method": method, "axis": axis, "value": AXES[axis].values[k % 3], "size": size, "became": became,
                    "refused": limit is not None and size > limit, "error_mm": 7.0 if became == "wrong" else None,
                    "told_mm": 2.0 + k, "doubt_mm": 0.01, "cause": CAUSES[TOO_FAST] if became == "failed" else "",
                    "limit_s": limit,
                })  # fmt: skip
    return found


def test_what_is_wrong_without_a_word_is_counted_and_named():
    said = report.wrong_runs(made_up())
    assert "4 runs are plainly wrong and yet hold:" in said[0]
    assert any("runge_kutta, sheet tension" in line and "1 refused" in line and "7.00 mm" in line for line in said)
    assert all("told 4.00 mm" in line for line in said[1:])
    first = next(r for r in made_up() if r["became"] == "wrong")
    alone = report.wrong_runs([first])
    assert "1 run is plainly wrong and yet holds:" in alone[0]
    assert "told 4.00 mm)" in alone[1]
    assert "told 2.00 mm and more)" in report.wrong_runs([first, first | {"told_mm": 2.0}])[1]
    assert "No run is plainly wrong" in report.wrong_runs([r for r in made_up() if r["became"] != "wrong"])[0]


def test_what_check_lets_pass_and_yet_fails_is_named():
    said = report.explicit_runs([r | {"size": 1e-4} if r["became"] == "failed" else r for r in made_up()])
    assert "of 4 that it lets pass, 2 fail" in said[0]
    assert CAUSES[TOO_FAST] in said[1]


def test_the_command_writes_a_picture_and_rows_that_can_be_drawn_again(tmp_path, monkeypatch):
    rows, host = made_up(), {"processor": "abacus", "commit": "0123"}
    monkeypatch.setattr("diffeed.bench.cli._measured", lambda *_: ({"rows": rows}, host))
    done = CliRunner().invoke(cli.main, ["bench", "stability", "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "linear_euler" in done.output
    assert max(map(len, done.output.splitlines()[:-1])) <= 80
    data = json.loads((tmp_path / "out" / "stability.json").read_text())
    assert data == {"machine": host, "rows": rows}
    assert (tmp_path / "out" / "stability.png").stat().st_size > 5000
    (tmp_path / "draft").mkdir()
    again = files.write_rows(
        tmp_path / "draft", tmp_path / "again", "stability", {}, lambda: stability_chart.stability(data["rows"])
    )
    assert again == ["stability.png", "stability.json"]


def test_a_working_copy_names_its_commit(tmp_path, monkeypatch):
    found = machine.machine()["commit"]
    assert (found is not None) == (Path(diffeed.__file__).parents[1] / ".git").exists()
    monkeypatch.setattr(machine, "__file__", str(tmp_path / "diffeed" / "bench" / "machine.py"))
    assert machine.machine()["commit"] is None


def test_cells_meet_half_way():
    np.testing.assert_allclose(stability_chart._edges([1.0, 100.0]), [0.1, 10.0, 1000.0])
    np.testing.assert_allclose(stability_chart._edges([1.0]), np.exp([-0.5, 0.5]))
