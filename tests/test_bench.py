"""Benchmarks: what is compared, counted, chosen and written. No test takes a time: machines are noisy."""

import dataclasses
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
from diffeed.base.records import replace
from diffeed.bench import (
    advise,
    batch,
    features,
    files,
    gradient,
    growth,
    jaxprs,
    pareto,
    point,
    records,
    report,
    settings,
    timing,
    transport,
)
from diffeed.bench import front as fronts
from diffeed.bench.outcome import Outcome, differences
from diffeed.bench.settings import Setting
from diffeed.input.paths import assign

ROOT = Path(__file__).parent.parent
TINY = """
# A strip that bends under its weight, held at its tail, beside a nip that feeds another.

duration = 0.02
initial = "given"

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
center = [0.0, -10.095]
radius = 10.0
angular_speed = { times = [0.0, 0.01], values = [0.0, -20.0] }

[rollers.upper]
kind = "fixed"
center = [0.0, 10.095]
radius = 10.0
angular_speed = { times = [0.0, 0.01], values = [0.0, 20.0] }
"""
STEPS = (1e-3, 5e-4, 2.5e-4)


@pytest.fixture(scope="module")
def tiny() -> diffeed.Scene:
    return diffeed.read_scene(TINY)


@pytest.fixture(scope="module")
def swept(tiny) -> records.Front:
    """Three steps of one method, a step that cannot be, and a change that cannot be."""
    asked = [
        *(Setting("step", "linear_euler", dt) for dt in STEPS),
        Setting("step", "runge_kutta", 1e-3),
        Setting("bars", "linear_euler", 1e-3, changes=("sheets.strip.bars=0",), label="no bars"),
        Setting("bars", "linear_euler", 1e-3, changes=("sheets.tape.bars=8",), label="another sheet"),
        Setting("precision", "linear_euler", 1e-3, precision="float32", label="float32"),
    ]
    return fronts.front(tiny, "tiny.toml", settings=asked, reference_step=2.5e-4, fewest=1)


def row_of(error: float | None, run: float | None, dt: float = 1e-4, **more) -> records.Row:
    errors = more.pop("errors", {"lead": error, "slip": error, "force": None})
    group = more.pop("group", "step")
    setting = Setting(group, "linear_euler", dt, label="" if group == "step" else group)
    return records.Row(
        setting, more.pop("status", "ok"), run_seconds=run, errors=errors, steps=100, compile_seconds=1.0, **more
    )


def front_of(rows: list[records.Row], doubt: float = 1e-6, **more) -> records.Front:
    reference = records.Reference(
        Setting("step", "linear_euler", 1e-6),
        1.0,
        {"lead": doubt, "slip": doubt, "force": None},
        {"lead": "", "slip": ""},
    )
    host = {"processor": "abacus", "cores": 1, "device": "cpu: cpu", "jax": "0", "diffeed": "0"}
    given = {"reference": reference, "no_reference": "", "assignments": (), **more}
    return records.Front(scene="made_up", key="k", duration=1.0, rows=rows, machine=host, **given)


# --- comparing --------------------------------------------------------------------------------------------------------


def test_the_reference_differs_from_itself_by_nothing(swept):
    assert swept.reference is not None
    same = next(r for r in swept.rows if r.setting == swept.reference.setting)
    assert same.errors == {"lead": 0.0, "slip": 0.0, "force": 0.0}


@pytest.mark.long
def test_half_the_step_halves_the_difference_to_a_fine_run(tiny):
    """Order one on a scene without impacts: against a run so fine that its own error does not count."""
    runs = [fronts.run_setting(tiny, Setting("step", "linear_euler", dt), frames=5).result for dt in (2e-4, 1e-4, 2e-6)]
    coarse, fine, exact = (r for r in runs if r is not None)
    first, second = (differences(r, exact)["lead"] for r in (coarse, fine))
    assert first is not None
    assert second is not None
    assert first.value / second.value == pytest.approx(2.0, rel=0.15)


def test_differences_name_the_worst_place():
    time = np.array([0.0, 1.0, 2.0])
    still = np.zeros((3, 2))
    moved = np.array([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]])
    mine = Outcome(time, {"a": still, "b": moved}, {"x": 1.0, "y": 5.0}, {"x": 2.0})
    other = Outcome(time, {"a": still, "b": still}, {"x": 1.5, "y": 5.1}, {"x": 2.0})
    found = differences(mine, other)
    assert found["lead"] == (5.0, "b, 1 s")
    assert found["slip"] == (0.5, "x")
    assert found["force"] == (0.0, "x")
    assert differences(mine._replace(slip={}, force={}), other._replace(slip={}, force={}))["slip"] is None


@pytest.mark.parametrize(
    ("duration", "largest", "gaps"), [(1.0, 1e-3, 100), (0.01, 1e-3, 10), (0.06, 0.02, 3), (0.01, 0.1, 1)]
)
def test_frames_leave_the_largest_step_as_it_is(duration, largest, gaps):
    assert fronts.frames_for(duration, largest) == gaps + 1


def test_steps_are_those_asked_for(swept):
    assert [r.steps for r in swept.rows[:3]] == [20, 40, 80]


def test_the_uncertainty_is_the_difference_from_twice_the_step(swept):
    assert swept.reference is not None
    twice = next(r for r in swept.rows if r.setting.dt == 5e-4)
    assert swept.reference.uncertainty == twice.errors
    assert all(v > 0 for v in twice.errors.values())


def test_a_setting_that_cannot_run_is_a_row_that_says_so(swept):
    by_name = {r.setting.name: r for r in swept.rows}
    refused = by_name["runge_kutta, 1e-3 s"]
    assert refused.status == "not run"
    assert "dt must be at most" in refused.reason
    assert "bars must be" in by_name["no bars (linear_euler, 1e-3 s)"].reason
    assert 'has no "tape"' in by_name["another sheet (linear_euler, 1e-3 s)"].reason
    assert all(not r.errors for r in swept.rows if r.status != "ok")


def test_a_run_that_fails_says_when_and_why(tiny):
    fast = diffeed.put(tiny, "sheets.strip.speed", 1e9)
    row = fronts.run_setting(fast, Setting("step", "linear_euler", 1e-3), frames=3).row
    assert row.status == "failed"
    assert row.reason.startswith("at 0.0")


def test_all_are_timed_in_turns_and_short_ones_more_often():
    order, times = [], {"short": [0.5, 0.1, 0.3, 0.2], "long": [3.0, 9.0, 6.0]}

    def made(name: str) -> timing.Timed:
        left = iter(times[name][1:])

        def again() -> float:
            order.append(name)
            return next(left)

        return timing.Timed(1.0, times[name][0], 1, None, 0.5, None, again)

    short, long = timing.in_turns([made("short"), made("long")], fewest=3)
    assert order == ["short", "long", "short", "long", "short"]
    assert (short.run, short.repeats) == (0.25, 4)
    assert (long.run, long.repeats) == (6.0, 3)


@pytest.mark.long
def test_no_reference_is_told_and_the_rows_remain(tiny):
    fast = diffeed.put(tiny, "sheets.strip.speed", 1e9)
    found = fronts.front(fast, settings=[Setting("step", "linear_euler", 1e-3)], frames=3, fewest=1)
    assert found.reference is None
    assert [r.status for r in found.rows] == ["failed"]
    assert "No reference, so no errors" in report.notes(found)[-1]
    with pytest.raises(records.BenchError, match="no reference"):
        advise.advise(found, {"lead": 1.0})


def test_float32_leaves_the_session_as_it_was(swept):
    row = next(r for r in swept.rows if r.setting.precision == "float32")
    assert row.status == "ok", row.reason
    assert 0.0 < row.errors["lead"] < 1.0
    with timing.precision("float32"):
        assert jnp.zeros(()).dtype == jnp.float32
    assert jnp.zeros(()).dtype == jnp.float64


# --- settings ---------------------------------------------------------------------------------------------------------


def test_every_method_is_swept_at_every_step():
    found = {(s.method, s.dt) for s in settings.sweep(STEPS) if s.group == "step"}
    assert found == {(m, dt) for m in diffeed.METHODS for dt in STEPS}


def test_knobs_change_one_thing_each_and_say_what(tiny):
    found = {s.label: s for s in settings.knobs(tiny, STEPS)}
    assert found["half the bars"].changes == ("sheets.strip.bars=2",)
    assert assign(tiny, found["twice the bars"].changes).sheets["strip"].bars == 8
    assert assign(tiny, found["friction tanh"].changes).contacts["default"].friction_law == "tanh"
    assert found["float32"].precision == "float32"
    assert {s.dt for s in found.values()} == {5e-4}
    assert not any(s.numerical for s in found.values())
    assert "friction sqrt" not in found, "that is what the scene has"


# --- the front --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("costs", "errors", "expected"),
    [
        ([3.0, 1.0, 2.0], [0.1, 3.0, 1.0], [1, 2, 0]),
        ([1.0, 2.0, 3.0], [1.0, 1.0, 0.5], [0, 2]),
        ([1.0, 1.0], [2.0, 1.0], [1]),
        ([1.0, 1.0], [1.0, 1.0], [0]),
        ([1.0, None, 2.0, 3.0], [None, 1.0, float("nan"), 5.0], [3]),
        ([float("nan"), 2.0, float("inf")], [0.1, 1.0, 0.1], [1]),
        ([], [], []),
    ],
)
def test_the_front_holds_what_nothing_beats(costs, errors, expected):
    assert pareto.pareto(costs, errors) == expected


def test_other_models_are_never_on_the_front():
    found = front_of([row_of(1.0, 2.0), row_of(0.1, 0.1, group="bars")])
    assert report.on_front(found)["lead"] == [0]


def test_errors_that_the_reference_cannot_tell_are_said_to_be_so():
    found = front_of([row_of(1.0, 1.0), row_of(0.1, 2.0)], doubt=0.05)
    assert "1 of 2 errors" in report.unconverged(found, "lead")
    assert "0.150 mm" in report.unconverged(found, "lead")
    assert report.unconverged(front_of(found.rows, doubt=0.01), "lead") == ""
    assert "no nip force" in report.notes(found)[-1]


# --- advice -----------------------------------------------------------------------------------------------------------

LINE = [row_of(0.8, 0.1, 1e-3), row_of(0.4, 0.2, 5e-4), row_of(0.15, 0.5, 2e-4), row_of(0.07, 1.0, 1e-4)]


def test_the_cheapest_that_meets_the_wanted_error_is_chosen():
    found = advise.advise(front_of(LINE), {"lead": 0.5})
    assert found.met
    assert found.row is LINE[1]
    assert advise.advise(front_of(LINE[::-1]), {"lead": 0.2}).row is LINE[2]


def test_every_wanted_error_must_be_met():
    poor = [dataclasses.replace(r, errors={"lead": r.errors["lead"], "slip": 3.0 * r.errors["lead"]}) for r in LINE]
    assert advise.advise(front_of(poor), {"lead": 0.5, "slip": 0.5}).row is poor[2]


def test_the_uncertainty_of_the_reference_counts_as_error():
    assert advise.advise(front_of(LINE, doubt=0.12), {"lead": 0.5}).row is LINE[2]


def test_if_nothing_meets_it_the_best_is_named_and_why():
    found = advise.advise(front_of(LINE), {"lead": 0.01})
    assert not found.met
    assert found.row is LINE[3]
    assert "too coarse" in found.reasons[0]
    assert "does not converge that far" in advise.advise(front_of(LINE, doubt=0.1), {"lead": 0.01}).reasons[0]


def test_a_result_is_sure_only_with_margin_and_neighbours_that_agree():
    assert advise.advise(front_of(LINE), {"lead": 0.399}).sure
    assert not advise.advise(front_of(LINE), {"lead": 0.2}).sure, "little margin"
    lucky = [LINE[0], row_of(0.05, 0.2, 5e-4), *LINE[2:]]
    found = advise.advise(front_of(lucky), {"lead": 0.2})
    assert found.row is lucky[1]
    assert not found.sure
    assert any("do not agree" in r for r in found.reasons)
    assert not advise.advise(front_of(LINE, doubt=0.2), {"lead": 0.5}).sure, "the reference is as bad"


def test_a_coarser_neighbour_that_fails_is_told():
    broken = [row_of(None, None, 1e-3, status="failed"), *LINE[1:]]
    found = advise.advise(front_of(broken), {"lead": 0.9})
    assert found.row is broken[1]
    assert any("at 1e-3 s the run failed" in r for r in found.reasons)


def test_another_model_is_named_but_not_chosen():
    other = row_of(0.3, 0.01, group="bars")
    found = front_of([*LINE, other])
    chosen = advise.advise(found, {"lead": 0.5})
    assert chosen.row is LINE[1]
    assert advise.cheaper_models(found, chosen.row, {"lead": 0.5}) == [
        "bars (linear_euler, 1e-4 s): 0.0100 s per simulated second"
    ]


def test_advice_refuses_what_cannot_be_said():
    with pytest.raises(records.BenchError, match="no nip force"):
        advise.advise(front_of(LINE), {"force": 1.0})
    with pytest.raises(records.BenchError, match="no setting ran: linear_euler, 1e-4 s: it jammed"):
        advise.advise(front_of([row_of(None, None, status="failed", reason="it jammed")]), {"lead": 1.0})


def test_the_command_runs_what_was_advised(swept):
    row = row_of(0.1, 1.0, 2e-4)
    found = front_of([row], assignments=("rollers.drive.radius=10.1",))
    assert advise.command(found, row) == (
        f"diffeed run made_up --duration {found.duration:g} --dt 2e-4 --method linear_euler --set rollers.drive.radius=10.1"
    )
    seconds = f"{found.duration:g}"
    assert advise.call(found, row) == f"diffeed.simulate(scene, duration={seconds}, dt=2e-4, method='linear_euler')"


# --- files ------------------------------------------------------------------------------------------------------------


def test_a_benchmark_reads_back_as_it_was(swept, tmp_path):
    (tmp_path / files.DATA).write_text(json.dumps(files.plain(swept.plain()), allow_nan=False))
    assert files.load_front(tmp_path) == swept


@pytest.mark.parametrize(
    ("text", "says"),
    [("{", "is not a benchmark's file"), ("{}", "format 1 is needed"), ('{"format": 1}', "not as it was written")],
)
def test_a_file_that_is_no_benchmark_is_named(tmp_path, text, says):
    (tmp_path / files.DATA).write_text(text)
    with pytest.raises(records.BenchError, match=f"{files.DATA}.*{says}"):
        files.load_front(tmp_path)
    with pytest.raises(records.BenchError, match="No such file"):
        files.load_front(tmp_path / "nowhere")


def test_tables_have_a_line_for_each_setting(swept):
    lines = files.front_table(swept).splitlines()
    assert len(lines) == len(swept.rows) + 1
    assert "lead edge error (mm)" in lines[0]


def test_pictures_of_every_kind_are_written(swept, tmp_path):
    from diffeed.bench import charts

    rows = [
        {"series": s, "size": n, "us_per_step": 1.0 * n} for s in ("bars", "line guides", "samples") for n in (1, 10)
    ]
    rows += [{"series": "length", "size": 1.0, "peak_mb": 300.0}, {"series": "bars", "size": 100, "reason": "too long"}]
    made = {
        "front": lambda: charts.front(swept),
        "empty": lambda: charts.front(dataclasses.replace(swept, rows=[row_of(None, None, status="failed")])),
        "growth": lambda: charts.growth(rows),
        "features": lambda: charts.features([{"without": "", "equations": 9}, {"without": "x", "equations": 5}]),
        "gradient": lambda: charts.gradient(
            [{"what": "run", "trace_seconds": 1.0, "compile_seconds": 2.0, "run_seconds": 0.1}]
        ),
        "batch": lambda: charts.batch([{"precision": "float64", "samples": 1, "steps_per_second": 2.0}], "cpu"),
    }
    for name, draw in made.items():
        (tmp_path / "draft").mkdir()
        assert files.write_rows(tmp_path / "draft", tmp_path / name, name, {}, draw) == [f"{name}.png", f"{name}.json"]
        assert (tmp_path / name / f"{name}.png").stat().st_size > 5000, name


# --- growth, features, batches ------------------------------------------------------------------------------------------


def test_equations_of_loops_branches_and_calls_are_counted():
    def body(x, _):
        return x + 1.0, None

    one = jnp.zeros(())
    assert jaxprs.count_equations(lambda x: x + 1.0, one) == 1
    assert jaxprs.count_equations(lambda x: jax.lax.scan(body, x, None, length=7)[0], one) == 2
    assert jaxprs.count_equations(jax.jit(lambda x: jnp.sin(x) * 2.0), one) == 3
    branches = jaxprs.count_equations(lambda x: jax.lax.cond(True, jnp.sin, lambda y: y * y + y, x), one)
    assert branches == 1 + 1 + 2


def test_kinds_are_free_of_charge_and_values_are_not(tiny):
    guide = {"table": diffeed.ArcGuide(center=(0.0, 50.0), radius=60.0, start_angle=-90.0, sweep=10.0)}
    scene = diffeed.scene(sheets=tiny.sheets, rollers=tiny.rollers, guides=guide, initial="given")
    rows = features.features(("arc guides", "gravity", "observing nips"), (scene, ("nips",)), times=False)
    cheaper, same = features.free_of_charge(rows)
    assert cheaper == ["arc guides", "observing nips"]
    assert same == ["gravity"]


@pytest.mark.parametrize("name", features.FEATURES)
def test_a_feature_taken_away_leaves_a_sound_scene(name):
    scene, observers = features.FEATURES[name]((features.full_scene(), features.OBSERVERS))
    assert set(observers) <= set(diffeed.OBSERVERS)
    assert diffeed.scene(**{f: getattr(scene, f) for f in ("sheets", "rollers", "guides", "contacts", "loads")})


def test_growth_follows_powers():
    sizes = (1, 10, 100, 1000, 10000)
    assert growth.exponent(sizes, [7.0, 7.0, 5.0, 50.0, 500.0]) == pytest.approx(1.0)
    assert growth.exponent(sizes, [1.0, 10.0, None, None, None]) == pytest.approx(1.0)
    assert growth.exponent(sizes, [1.0, None, None, None, None]) is None


def test_a_size_that_fails_is_a_row_and_one_that_takes_too_long_ends_its_series():
    def run(size: float) -> dict[str, float]:
        if size == 1:
            raise MemoryError("no room\nat all")
        if size == 3:
            raise point.TooLong("stopped after 7 s")
        return {"us_per_step": size}

    rows = growth.one_series("bars", (1, 2, 3, 4), run)
    assert [r.get("reason") for r in rows] == ["no room", None, "stopped after 7 s", "not run: 3 took too long"]
    assert rows[1] == {"series": "bars", "size": 2, "us_per_step": 2}


def test_every_series_that_is_swept_is_known():
    assert set(growth.SWEEP) == set(point.SERIES)


def test_a_process_of_its_own_tells_its_memory_its_failure_and_is_stopped():
    row = point.run_apart("bars", 4, 300.0)
    assert row["peak_mb"] > 50.0
    assert {"compile_seconds", "us_per_step"} < set(row)
    with pytest.raises(RuntimeError, match="KeyError: 'wings'"):
        point.run_apart("wings", 4, 300.0)
    with pytest.raises(point.TooLong, match="stopped after 0 s"):
        point.run_apart("bars", 4, 0.01)


@pytest.mark.parametrize(("guides", "driven", "nips"), [(2, 4, 0), (5, 7, 0), (2, 4, 3)])
def test_a_transport_path_has_the_parts_asked_for_and_is_sound(guides, driven, nips):
    scene = transport.transport(bars=5, guides=guides, driven=driven, nips=nips)
    assert len(scene.guides) == guides
    assert len(scene.rollers) == driven + 2 * nips
    assert diffeed.check(scene) == []


@pytest.mark.long
def test_the_sheet_of_a_transport_path_moves_on():
    run = diffeed.simulate(transport.transport(bars=5, duration=0.05), dt=1e-3, frames=2)
    moved = run.sheets["sheet"].nodes[-1, 0, 0] - run.sheets["sheet"].nodes[0, 0, 0]
    assert bool(run.ok)
    assert float(moved) == pytest.approx(transport.SPEED * 0.05, rel=0.01)


@pytest.mark.long
def test_batches_hold_samples_that_differ(tiny):
    many = batch.samples(tiny, 3)
    assert many.sheets["strip"].youngs_modulus.tolist() == [1980.0, 2000.0, 2020.0]
    rows = batch.batch(tiny, (2,), ("float64", "float32"), dt=1e-3, steps=4, fewest=1)
    assert [(r["precision"], r["samples"], r["failed"]) for r in rows] == [("float64", 2, 0), ("float32", 2, 0)]
    assert [r["steps_per_second"] * r["run_seconds"] for r in rows] == pytest.approx([2 * 4] * 2)
    assert batch.batch(tiny, (400,), ("float64",), dt=1e-5, fewest=1)[0]["steps"] == batch.STEPS


@pytest.mark.slow
def test_a_gradient_costs_more_than_its_run(tiny):
    rows = gradient.gradient(tiny, duration=4e-3, dt=1e-3, fewest=1)
    assert [r["what"] for r in rows] == [gradient.RUN, gradient.FORWARD, gradient.REVERSE]
    assert [r["numbers"] > 1 for r in rows] == [False, False, True]
    assert [r["reason"] for r in rows] == [None] * 3
    assert rows[0]["runs"] == 1.0
    assert all(r["trace_seconds"] > 0 and r["compile_seconds"] > 0 and r["temporary_mb"] > 0 for r in rows)
    broken = replace(
        tiny, sheets={k: replace(s, lead=(0.0, 50.0)) for k, s in tiny.sheets.items()}, gravity=(0.0, -1e9)
    )
    assert "the run fails" in gradient.gradient(broken, duration=4e-3, dt=1e-3, fewest=1)[0]["reason"]


# --- the command line -------------------------------------------------------------------------------------------------


def invoke(*arguments: object):
    return CliRunner().invoke(cli.main, [str(a) for a in arguments])


def test_a_scene_without_the_word_front_is_what_front_does(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "diffeed.bench.cli._sweep", lambda scene, **given: asked.append((scene, given)) or front_of(LINE)
    )
    for words in (("bench", "x.toml"), ("bench", "front", "x.toml"), ("bench", "--quick", "x.toml")):
        done = invoke(*words)
        assert done.exit_code == 0, done.output
    assert [scene for scene, _ in asked] == ["x.toml"] * 3
    assert [given["quick"] for _, given in asked] == [False, False, True]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("bench", "no_such_machine"), "no such file, nor a shipped scene"),
        (("bench", "film_feeder", "--dt", "0"), "'--dt': 0"),
        (("bench", "film_feeder", "--duration", "-1"), "'--duration': -1"),
        (("bench", "film_feeder", "--set", "rollers.drvie.radius=3"), 'did you mean "drive_3"?'),
        (("advise", "film_feeder"), "Missing option '--error'"),
        (("advise", "film_feeder", "--error", "-1"), "'--error': -1"),
        (("advise", "film_feeder", "--error", "1", "--from", "/nowhere"), "/nowhere cannot be read: No such file"),
        (("bench", "batch", "--size", "0"), "'--size': 0"),
    ],
)
def test_a_bad_argument_gives_one_clear_message(words, says, monkeypatch):
    monkeypatch.setattr("diffeed.bench.cli.set_up", lambda **_: None)  # it would change this process
    done = invoke(*words)
    assert done.exit_code == 2
    assert says in done.output
    assert "Traceback" not in done.output


def test_results_are_not_overwritten_without_force(tmp_path, monkeypatch):
    monkeypatch.setattr("diffeed.bench.cli._measured", lambda *_: pytest.fail("it ran"))
    (tmp_path / "growth.json").write_text("precious")
    done = invoke("bench", "growth", "--out", tmp_path)
    assert done.exit_code == 2
    assert "already holds growth.json" in done.output
    assert (tmp_path / "growth.json").read_text() == "precious"


def test_help_needs_nothing_heavy():
    code = """
import sys
import diffeed.cli
from click.testing import CliRunner
for words in (["advise"], ["bench"], *(["bench", n] for n in diffeed.cli.main.commands["bench"].commands)):
    done = CliRunner().invoke(diffeed.cli.main, [*words, "--help"])
    assert done.exit_code == 0, done.output
heavy = {"jax", "numpy", "matplotlib", "rich"} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def run_command(*arguments: object) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "diffeed.cli", *(str(a) for a in arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, cwd=ROOT, check=False)


@pytest.mark.slow
def test_from_a_scene_to_advice(tmp_path):
    scene, out = tmp_path / "tiny.toml", tmp_path / "out"
    scene.write_text(TINY)
    done = run_command(
        "bench", scene, "--dt", "1e-3", "--dt", "5e-4", "--duration", "0.01", "--only-steps", "--out", out
    )
    assert done.returncode == 0, done.stderr
    assert max(len(line) for line in done.stdout.splitlines() if str(tmp_path) not in line) <= 80
    assert "linear_euler" in done.stdout
    assert "not run: dt must be at most" in done.stdout.replace("\n", " ")
    assert {p.name for p in out.iterdir()} == set(files.FRONT)
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
    found = files.load_front(out)
    assert all(r.errors for r in found.rows if r.status == "ok")

    told = run_command("advise", scene, "--error", "100", "--from", out, "--duration", "0.01")
    assert told.returncode == 0, told.stderr
    assert "Use " in told.stdout
    assert f"diffeed run {scene} --duration 0.01 --dt " in told.stdout
    none = run_command("advise", scene, "--error", "1e-30", "--from", out, "--duration", "0.01")
    assert none.returncode == 1
    assert "The best there is" in none.stdout
    other = run_command("advise", scene, "--error", "1", "--from", out)
    assert other.returncode == 2
    assert "a benchmark of another scene" in other.stderr
