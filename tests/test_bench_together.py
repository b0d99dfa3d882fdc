"""Figures of all benchmarks in one form, and the benchmarks that measure smoothness. No test takes a time."""

import json
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import diffeed
from diffeed import cli
from diffeed.base.folders import Lock
from diffeed.bench import figures, files, kinds, machine, ripple, roughness, settings, together
from diffeed.input.paths import assign

HOST = {"processor": "abacus", "device": "cpu: cpu", "jax": "0", "diffeed": "0", "commit": "0123"}
GROWTH = {
    "rows": [
        {"series": "bars", "size": 20, "us_per_step": 7.0, "compile_seconds": 2.0, "peak_mb": None},
        {"series": "bars", "size": 50, "reason": "too long"},
    ],
    "exponents": [{"series": "bars", "us_per_step": 1.1, "compile_seconds": None, "peak_mb": None}],
    "machine": HOST,
}
RIPPLE = {
    "rows": [
        {"skin": s, "bars": n, "us_per_step": 9.0 * n, "force_ripple_n": 1.0 / n, "slip_ripple_mm_s": 1.0 / n}
        for s in ripple.SKINS
        for n in (10, 20)
    ],
    "machine": HOST,
}
ROUGHNESS = {
    "by": "rollers.drive.radius",
    "span": 0.005,
    "rows": [
        {"start": s, "steps": w, "time": t, "trend_mm_per_unit": 11.0, "scatter_um": 3.0 * t}
        for s in ("as given", "ramped")
        for w in ("1e-4 s", "1e-3 mm")
        for t in (0.1, 0.2, 0.3, 0.4)
    ]
    + [{"start": "ramped", "steps": "2e-4 s", "reason": "3 of 9 runs failed"}],
    "machine": HOST,
}


def read(name, data):
    return [json.loads(line) for line in figures.lines(name, data)]


def test_a_line_for_each_figure_says_what_it_is_of():
    found = read("growth", GROWTH)
    assert [(f["figure"], f["value"], f["unit"]) for f in found] == [
        ("compile_seconds", 2.0, "s"),
        ("us_per_step", 7.0, "us"),
        (None, None, None),
        ("power of us_per_step", 1.1, "1"),
    ]
    assert [f["of"] for f in found[1:]] == [
        {"series": "bars", "size": 20},
        {"series": "bars", "size": 50, "reason": "too long"},
        {"series": "bars"},
    ]
    assert all(f["machine"] == HOST and f["benchmark"] == "growth" for f in found)


def test_figures_of_a_front_are_costs_errors_and_the_uncertainty():
    setting = {"group": "step", "method": "linear_euler", "dt": 1e-4}
    doubt = {"lead": 1e-3, "slip": None, "force": None}
    row = {"setting": setting, "reason": "", "run_seconds": 0.5, "steps": 10, "errors": {"lead": 0.2, "slip": None}}
    data = {"scene": "x", "duration": 1.0, "assignments": [], "rows": [row], "machine": HOST}
    found = read("front", data | {"reference": {"setting": setting, "uncertainty": doubt}})
    assert [(f["figure"], f["value"], f["unit"]) for f in found] == [
        ("run_seconds", 0.5, "s"),
        ("steps", 10, "1"),
        ("lead edge error", 0.2, "mm"),
        ("lead edge uncertainty", 1e-3, "mm"),
    ]
    assert found[0]["of"]["setting"] == setting
    assert len(read("front", data | {"reference": None})) == 3


@pytest.mark.parametrize(("name", "data"), [("growth", GROWTH), ("ripple", RIPPLE), ("roughness", ROUGHNESS)])
def test_a_benchmark_is_printed_and_drawn_from_its_data(name, data, tmp_path, capsys):
    from diffeed.base.terminal import console

    kinds.KINDS[name].print(console(), data)
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 80
    assert all(r["reason"] in said for r in data["rows"] if "reason" in r)
    (tmp_path / "draft").mkdir()
    files.write_rows(tmp_path / "draft", tmp_path / name, name, data, lambda: kinds.KINDS[name].draw(data))
    assert (tmp_path / name / f"{name}.png").stat().st_size > 5000


def test_every_benchmark_of_rows_is_shown_and_run_together():
    made = {b.words[0] for b in together.BENCHMARKS.values()}
    assert made == {"front", *kinds.KINDS}
    assert made < set(cli.main.commands["bench"].commands)


def stand_in(tmp_path, monkeypatch, names):
    """Benchmarks that write their data at once: `{name}` into its folder; one called broken fails."""
    code = (
        "import json, pathlib, sys; name, out = sys.argv[2], pathlib.Path(sys.argv[sys.argv.index('--out') + 1]);"
        "sys.exit(3) if name == 'broken' else out.mkdir(parents=True, exist_ok=True);"
        f"(out / 'x.json').write_text(json.dumps({GROWTH!r}))"
    )
    real = subprocess.Popen
    monkeypatch.setattr(together, "BENCHMARKS", {n: together.Benchmark((n,), ("--quick",), "x.json") for n in names})
    ran = []

    def popen(words):
        ran.append(words[3:])
        return real([sys.executable, "-c", code, *words[3:]])

    monkeypatch.setattr(together.subprocess, "Popen", popen)
    return ran


def test_all_goes_on_where_it_stopped_and_tells_what_failed(tmp_path, monkeypatch):
    ran = stand_in(tmp_path, monkeypatch, ("first", "broken", "last"))
    out = tmp_path / "figures"
    done = CliRunner().invoke(cli.main, ["bench", "all", "--out", str(out)])
    assert done.exit_code == 1
    assert "broken failed" in done.output
    assert [w[1] for w in ran] == ["first", "broken", "last"]
    assert len((out / together.FIGURES).read_text().splitlines()) == 2 * 4
    again = CliRunner().invoke(cli.main, ["bench", "all", "--out", str(out), "--only", "first", "--only", "last"])
    assert again.exit_code == 0, again.output
    assert len(ran) == 3, "nothing was made twice"
    CliRunner().invoke(cli.main, ["bench", "all", "--out", str(out), "--only", "first", "--quick"])
    assert "--quick" in ran[-1]
    assert (out / "first_quick" / "x.json").exists(), "a short one does not stand for the long one"
    CliRunner().invoke(cli.main, ["bench", "all", "--out", str(out), "--only", "first", "--force"])
    assert "--force" in ran[-1]


def test_two_that_measure_into_one_folder_do_not_run_together(tmp_path, monkeypatch):
    """Each would take its times beside the other."""
    ran = stand_in(tmp_path, monkeypatch, ("first", "last"))
    out = tmp_path / "figures"
    out.mkdir()
    other = Lock(out)
    done = CliRunner().invoke(cli.main, ["bench", "all", "--out", str(out)])
    other.close()
    assert done.exit_code == 2
    assert "is being written by another run" in done.output
    assert ran == []


def test_figures_that_cannot_be_written_are_told_in_a_sentence(tmp_path, monkeypatch):
    stand_in(tmp_path, monkeypatch, ("first",))
    (tmp_path / together.FIGURES).mkdir()
    done = CliRunner().invoke(cli.main, ["bench", "all", "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert f"{together.FIGURES} could not be written: Is a directory" in done.output


def test_a_word_of_the_name_of_a_figure_says_what_the_others_are_of():
    found = read("roughness", ROUGHNESS)
    assert {f["of"]["steps"] for f in found} == {"1e-4 s", "1e-3 mm", "2e-4 s"}
    assert {f["figure"] for f in found} == {"trend_mm_per_unit", "scatter_um", None}


def test_the_load_is_what_runs_now(monkeypatch):
    """Two others beside the reader; the mean of the last minute is that of the benchmark before."""
    monkeypatch.setattr(Path, "read_text", lambda *_: "1.51 1.65 1.31 3/107 7203\n")
    assert machine._others_at_work(2, 0.0) == 2.0


def test_a_benchmark_that_is_not_there_is_named(tmp_path):
    done = CliRunner().invoke(cli.main, ["bench", "all", "--out", str(tmp_path / "x"), "--only", "speed"])
    assert done.exit_code == 2
    assert "--only must be one of front_film_feeder, " in done.output
    assert "but is speed" in done.output
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--by", "rollers.drvie_1.radius"), 'did you mean "drive_1"?'),
        (("--by", "rollers.drive_1.center"), "--by must name one number"),
        (("--span", "20"), "--span 20 is too much: at rollers.drive_1.radius = -10, rollers.drive_1.radius must be"),
    ],
)
def test_a_number_that_cannot_vary_is_refused(words, says, monkeypatch):
    monkeypatch.setattr("diffeed.bench.cli.set_up", lambda **_: None)  # it would change this process
    done = CliRunner().invoke(cli.main, ["bench", "roughness", *words])
    assert done.exit_code == 2
    assert says in done.output.replace("\n", " ")


# --- what is measured -------------------------------------------------------------------------------------------------


def test_ramped_shafts_come_up_to_their_speeds():
    scene = diffeed.load_scene("film_feeder")
    speed = roughness.ramped(scene).rollers["drive_1"].angular_speed
    np.testing.assert_allclose(speed.times, [0.0, roughness.RAMP])
    np.testing.assert_allclose(speed.values, [0.0, float(scene.rollers["drive_1"].angular_speed)])
    assert roughness.ramped(scene).rollers["pinch_1"].angular_speed is None


@pytest.mark.long
def test_a_smooth_run_has_its_trend_and_no_scatter():
    """A sheet that flies: its lead edge goes 0.02 s for each mm/s, and nothing else happens."""
    sheet = diffeed.Sheet(
        length=20.0, bars=4, thickness=0.1, width=50.0, density=1e-6, youngs_modulus=2e3, lead=(0.0, 0.0), speed=50.0
    )
    scene = diffeed.scene(sheets={"a": sheet}, gravity=(0.0, 0.0), initial="given", duration=0.02)
    rows = roughness.roughness(scene, "sheets.a.speed", 1.0, roughness.ways(quick=True), samples=6)
    last = [r for r in rows if r["time"] == pytest.approx(0.02)]
    assert {r["start"] for r in rows} == {"as given", "ramped"}
    assert len({r["time"] for r in rows}) == roughness.FRAMES - 1, "the same times, whatever the steps"
    assert [r["trend_mm_per_unit"] for r in last] == pytest.approx([0.02] * 4, rel=1e-6)
    assert max(r["scatter_um"] for r in rows) < 1e-6


@pytest.mark.long
def test_the_roller_carries_what_drags_the_sheet():
    """Sound with either skin; and at rest the normal forces of a wrap add up to the pull times its angle, pi/3 (capstan): half a
    newton more of drag is pi/6 on the roller. Where each bar touches makes 0.7 % with 80 bars, 4 % with 40."""
    for skin in ripple.SKINS:
        assert diffeed.check(ripple.scene(20, skin)) == []
    scene = ripple.scene(80)
    drag = jnp.asarray(scene.loads["drag"].force)
    assert float(jnp.hypot(*drag)) == pytest.approx(1.0)

    def carried(factor):
        run = diffeed.simulate(diffeed.put(scene, "loads.drag.force", factor * drag), duration=1e-3, dt=1e-4, frames=2)
        return float(run.rollers["turn"].force[0])

    assert carried(1.0) - carried(0.5) == pytest.approx(np.pi / 6.0, rel=0.01)


@pytest.mark.long
def test_every_pull_on_a_wrap_finds_its_rest():
    """Bars that meet a roller one after the other, and leave it: a search that is thrown by them fails for some pulls."""
    scene = ripple.scene(20)
    pulls = jnp.outer(jnp.linspace(0.4, 0.6, 16), jnp.asarray(scene.loads["drag"].force))
    rests = jax.jit(jax.vmap(lambda pull: diffeed.settle(diffeed.put(scene, "loads.drag.force", pull))))(pulls)
    assert np.all(np.isfinite(rests.heading))
    # A smooth change moves them by 0.07 mm; searches that jumped ended some mm away.
    assert np.max(np.ptp(rests.x, axis=0)) < 0.2


@pytest.mark.long
def test_a_wrap_of_many_bars_finds_its_rest():
    """Bars of 1 mm weigh 5 mg: a way of 1e-12 mm makes them flicker, and only steps shorter than 10 us take them past a
    friction that lets go. A search that refuses the one, or takes no step as short as the other, finds nothing."""
    scene = ripple.scene(160)
    halved = diffeed.put(scene, "loads.drag.force", 0.5 * jnp.asarray(scene.loads["drag"].force))
    run = diffeed.simulate(halved, duration=1e-3, dt=1e-4, frames=2)
    assert bool(run.ok), run.failure.describe()
    assert np.asarray(run.rollers["turn"].force) == pytest.approx(np.pi / 6.0, rel=0.05)


def test_the_knob_of_inertia_leaves_the_weight():
    scene = diffeed.load_scene("film_feeder")
    (knob,) = settings.knobs(scene, (1e-4,), ("inertia",))
    light = assign(scene, knob.changes)
    assert float(light.sheets["film"].density) == pytest.approx(1e-3 * float(scene.sheets["film"].density))
    assert float(light.rollers["pinch_1"].mass) == pytest.approx(1e-3 * float(scene.rollers["pinch_1"].mass))
    weights = [s.sheets["film"].density * jnp.asarray(s.gravity)[1] for s in (light, scene)]
    assert float(weights[0]) == pytest.approx(float(weights[1]))
    assert not knob.numerical
