"""The search on a nip whose answer is known: the force of a nip is its preload and the spring's share (no gravity)."""

import io
import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from stand_in_nip import nip

import diffeed
import optimize
from diffeed.readings.agreement import FINER
from optimize import blame_map, descent, evaluate, programs
from optimize.asked import values_of
from optimize.design_run import design, finish, score
from optimize.evaluate import Evaluated, Evaluator
from optimize.journal import FILES, HISTORY, Journal, JournalError
from optimize.problem import Seen, Settings, eased, look, make_problem, over_media, simulate
from optimize.report import _kept, print_result, write_result
from optimize.study_file import make_study

pytestmark = pytest.mark.usefixtures("as_users_have_it")


TABLE = {
    "scene": "stand in",
    "duration": 0.01,
    "dt": 5e-4,
    "frames": 5,
    "variables": {"preload": {"path": "rollers.pinch.preload", "bounds": [1.0, 6.0]}},
    "objective": {"force": {"measure": "nip_force", "of": "pinch", "target": 4.0}},
    "search": {"learning_rate": 0.1, "schedule": "cosine", "iterations": 40, "patience": 40},
}


def problem_of(**changes):
    search = TABLE["search"] | changes.pop("search", {})
    return make_problem(make_study(TABLE | {"search": search} | changes), scene=nip())


def history(folder):
    return [json.loads(line) for line in (folder / HISTORY).read_text("utf-8").splitlines()]


def told(result, history=None):
    """What the command says of a search."""
    text = io.StringIO()
    print_result(Console(file=text, width=100), result if history is None else replace(result, history=history))
    return " ".join(text.getvalue().split())


@pytest.mark.long
def test_adam_finds_the_preload_of_a_wanted_force():
    result = design(problem_of())
    assert result.improved
    assert result.after.goals[0, 0] == pytest.approx(4.0, abs=0.02)
    assert result.reason
    assert result.progress.counts.gradients == result.progress.iteration
    kept = _kept(result)  # a parabola: what is promised is up to twice what comes on the way down
    assert kept.steps > 5
    assert 0.3 < kept.came / kept.promised < 1.5
    assert kept.same_way >= 0.75 * kept.steps
    assert f"Of {kept.steps} steps {kept.same_way} changed what is minimised the way that their gradient said." in told(
        result
    )
    assert "promised" not in told(result)


@pytest.mark.long
def test_a_point_without_a_value_never_wins():
    good = score(problem_of(), np.array([0.5]))
    assert good.verdicts[0].status == "passed"
    assert min([replace(good, objective=np.nan), good, replace(good, violation=np.nan)], key=lambda s: s.rank) is good


@pytest.mark.slow
def test_the_blame_of_another_point_compiles_nothing(monkeypatch):
    problem, points = problem_of(), problem_of().start + np.array([[0.0], [0.1]])
    scored = [score(problem, point).objective for point in points]
    found = [blame_map.blame(problem, points[0])]
    monkeypatch.setattr(blame_map, "simulate", None)
    found.append(blame_map.blame(problem, points[1]))
    assert [f.objective for f in found] == pytest.approx(scored, rel=1e-12)
    assert scored[0] != scored[1]


@pytest.mark.slow
def test_when_sensitivity_arises_is_asked_of_the_whole_run(monkeypatch):
    """Of its frames, too: a margin begins where the run does."""
    problem, seen = problem_of(frames=7, objective={"spare": {"measure": "jam_margin", "of": "strip"}}), []

    def watched(goals, scene, run):
        jax.debug.callback(seen.append, run.time)
        return values_of(goals, scene, run)

    monkeypatch.setattr(blame_map, "values_of", watched)
    blame_map.arising(problem, problem.start, spans=3)
    jax.effects_barrier()
    np.testing.assert_allclose(seen[0], np.linspace(0.0, 0.01, 7), rtol=1e-9)


@pytest.mark.long
def test_which_part_of_a_margin_binds_is_told():
    """The parts beside the smoothed smallest of them, which is never above the smallest and at most 0.05 log 5 below."""
    problem = problem_of(objective={"spare": {"measure": "jam_margin", "of": "strip", "weight": -1.0}})
    result = finish(problem, descent.begin(problem), [])
    (margins,) = result.before.margins
    parts, margin = margins["strip"], float(result.before.goals[0, 0])
    assert list(parts) == ["progress", "buckling", "fold", "attack", "gap"]
    assert min(parts.values()) - 0.05 * np.log(5) <= margin <= min(parts.values())
    text = io.StringIO()
    print_result(Console(file=text, width=140), result)
    (row,) = (line.split() for line in text.getvalue().splitlines() if "strip: progress" in line)
    assert float(row[3]) == pytest.approx(parts["progress"], rel=1e-3)


@pytest.mark.slow
def test_when_the_sensitivity_arises_adds_up_to_the_blame():
    """One span is the whole run; two share it, and what a part does in each may only cancel."""
    problem = problem_of()
    whole = blame_map.blame(problem, problem.start)
    one, two = (blame_map.arising(problem, problem.start, spans) for spans in (1, 2))
    assert set(one.parts) == {"guides.table", "rollers.drive", "rollers.pinch"}
    for row, part in enumerate(one.parts):
        size = np.linalg.norm([v for path, v in whole.places.items() if path.rsplit(".", 1)[0] == part])
        assert (size > 0.01) == (part != "guides.table")
        assert one.share[row, 0] == pytest.approx(size, rel=1e-9)
        assert np.sum(two.share[row]) >= size * (1.0 - 1e-9)
        assert np.max(two.share[row]) <= 10.0 * size
    assert two.edges == pytest.approx([0.0, 0.005, 0.01])


def test_the_program_that_was_not_used_for_longest_goes_first():
    names = [f"test {k}" for k in range(programs.MOST + 1)]
    for name in names[:-1]:
        programs.kept(name, lambda name=name: name)
    assert programs.kept(names[0], lambda: "made again") == names[0]
    programs.kept(names[-1], lambda: names[-1])
    assert programs.kept(names[0], lambda: "made again") == names[0]
    assert programs.kept(names[1], lambda: "made again") == "made again"


@pytest.mark.slow
def test_lbfgs_finds_it_in_a_few_iterations():
    result = design(problem_of(search={"name": "lbfgs", "iterations": 6}))
    assert result.after.goals[0, 0] == pytest.approx(4.0, abs=1e-3)


def test_lbfgs_takes_no_expected_gradient():
    """Its line search looks at single points: it would compare them with a mean over others."""
    with pytest.raises(optimize.StudyError) as caught:
        problem_of(search={"name": "lbfgs", "gradient": "expected"})
    assert caught.value.problems == [
        'search.gradient must be "exact" for "lbfgs", whose line search compares single points, but is "expected"'
    ]


@pytest.mark.slow
def test_a_limit_is_kept_and_is_active():
    """Least force, but no less than 2.5 N: the answer is 2.5 N."""
    result = design(
        problem_of(
            objective={"force": {"measure": "nip_force", "of": "pinch"}},
            limits={"grip": {"measure": "nip_force", "of": "pinch", "at_least": 2.5}},
            search={"iterations": 60, "patience": 60},
        )
    )
    assert result.after.violation <= 0.01
    assert result.after.limits[0, 0] == pytest.approx(2.5, abs=0.05)


@pytest.mark.slow
def test_the_multiplier_is_the_price_of_the_limit():
    """At the answer the multiplier equals d objective/d limit = 1 N/N."""
    problem = problem_of(
        objective={"force": {"measure": "nip_force", "of": "pinch"}},
        limits={"grip": {"measure": "nip_force", "of": "pinch", "at_least": 2.5}},
        search={"name": "lbfgs", "iterations": 48, "patience": 48},
    )
    progress = descent.begin(problem)
    for _ in descent.search(problem, progress):
        pass
    assert progress.multipliers[0, 0, 0] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_media_are_weighed_and_the_worst_rules():
    """Two media whose forces differ by 1 N: the worst case balances the misses, a weighed mean does not."""
    thick = {"rollers.pinch.spring": 20.0, "sheets.strip.thickness": 0.25}
    media = {"thin": {"set": {}}, "thick": {"set": thick, "weight": 9.0}}
    search = {"name": "lbfgs", "iterations": 8}
    found = [design(problem_of(media=media, over=over, search=search)) for over in ("mean", "worst")]
    mean, worst = (f.after.goals[:, 0] - 4.0 for f in found)
    assert worst[0] == pytest.approx(-worst[1], abs=0.05)
    # The weighed squares are least where 1 * miss * slope = -9 * miss * slope. The slope of the force by the preload is not one:
    # the pinch's spring gives way with the contact.
    unit = found[0].after.unit
    ahead, behind = (score(found[0].problem, unit + by).goals[:, 0] for by in (0.02, -0.02))
    pulls = mean * (ahead - behind)
    assert pulls[0] == pytest.approx(-9.0 * pulls[1], rel=0.05)
    assert abs(pulls[0]) > 0.01


@pytest.mark.long
def test_a_start_that_fails_is_rolled_back_and_spares_the_others(monkeypatch):
    problem = problem_of(search={"starts": 3, "iterations": 12})
    whole = Evaluator.gradients

    def broken(self, unit, multipliers, penalty, settings):
        found = whole(self, unit, multipliers, penalty, settings)
        bad = unit[:, 0] > 0.7  # as if every run beyond failed
        found.value[bad], found.gradient[bad] = np.nan, np.nan
        return found

    monkeypatch.setattr(Evaluator, "gradients", broken)
    monkeypatch.setattr(descent, "first_points", lambda problem: np.array([[0.4], [0.9], [0.2]]))
    progress = descent.begin(problem)
    for _ in descent.search(problem, progress):
        pass
    assert np.isfinite(progress.merit[[0, 2]]).all()
    assert not np.isfinite(progress.merit[1])
    assert (progress.best[[0, 2]] <= 0.7).all()


def test_the_worst_tail_of_the_media():
    """Shares 1/2, 1/4, 1/4 with objectives 1, 5, 3: the worst 0.5 is (5 + 3)/2, the worst 0.75 takes half of the 1."""
    media = {"a": {"weight": 2.0}, "b": {}, "c": {}}
    objective = jnp.array([1.0, 5.0, 3.0])
    expected = {0.25: 5.0, 0.5: 4.0, 0.75: (0.25 * 5 + 0.25 * 3 + 0.25 * 1) / 0.75, 1.0: 2.5}
    for tail, value in expected.items():
        problem = problem_of(media=media, over="cvar", tail=tail)
        assert float(over_media(problem, objective)) == pytest.approx(value)
    assert float(over_media(problem_of(media=media, over="worst"), objective)) == 5.0


def test_starts_are_spread_about_the_study_s_own_and_do_not_change():
    problem = problem_of(search={"starts": 5, "spread": 0.1, "seed": 3})
    points = descent.first_points(problem)
    assert points.shape == (5, 1)
    np.testing.assert_array_equal(points[0], problem.start)
    assert (np.abs(points - problem.start) <= 0.1).all()
    assert len(np.unique(points)) == 5
    np.testing.assert_array_equal(points, descent.first_points(problem))


@pytest.mark.slow
def test_the_expected_gradient_averages_over_the_tolerance():
    exact, expected = problem_of(), problem_of(search={"gradient": "expected", "samples": 8})
    none = np.zeros((1, 1, 0))
    found = [Evaluator(p).gradients(p.start[None], none, np.ones(1), Settings()) for p in (exact, expected)]
    # The objective is a parabola: its mean gradient over a symmetric spread is that of its middle.
    assert found[1].gradient[0, 0] == pytest.approx(found[0].gradient[0, 0], rel=1e-2)
    assert found[1].value[0] > found[0].value[0]


@pytest.mark.long
def test_resume_after_a_kill_gives_the_same_iterates(tmp_path):
    whole = design(problem_of(search={"iterations": 9}), tmp_path / "whole")
    problem = problem_of(search={"iterations": 9})
    journal = Journal(tmp_path / "cut", problem)
    progress = journal.start(resume=False, force=False)
    for _, line in descent.search(problem, progress, journal.save):
        if line.iteration == 4:
            break
    journal.close()
    with (tmp_path / "cut" / "history.jsonl").open("a") as stream:
        stream.write('{"iteration": 5, "half a li')  # killed while writing
    for _ in range(2):  # when it has ended, and its result is written, nothing is added
        result = design(problem_of(search={"iterations": 9}), tmp_path / "cut", resume=True)
        write_result(tmp_path / "cut", result, pictures=False)
    lines = [history(tmp_path / name) for name in ("whole", "cut")]
    for a, b in zip(*lines, strict=True):
        a.pop("seconds"), b.pop("seconds")
        assert a == b
    assert len(lines[0]) == whole.progress.iteration


@pytest.mark.slow
def test_a_folder_is_not_overwritten_and_belongs_to_its_study(tmp_path):
    design(problem_of(search={"iterations": 2}), tmp_path)
    with pytest.raises(JournalError, match="already holds a search"):
        design(problem_of(search={"iterations": 2}), tmp_path)
    with pytest.raises(JournalError, match="another study"):
        design(problem_of(dt=2.5e-4), tmp_path, resume=True)
    with pytest.raises(JournalError, match="no search to resume"):
        design(problem_of(), tmp_path / "empty", resume=True)
    design(problem_of(search={"iterations": 3}), tmp_path, force=True)
    assert [json.loads(x)["iteration"] for x in (tmp_path / "history.jsonl").read_text().splitlines()] == [1, 2, 3]


@pytest.mark.long
def test_a_search_in_its_last_stage_goes_on_with_more_iterations(tmp_path):
    """To what it would have found with them from the start. Earlier stages must stay as they were."""

    def staged(first, last):
        stages = [{"iterations": first, "smoothing": 2.0}, {"iterations": last}]
        return problem_of(search={"stages": stages, "schedule": "constant"})

    design(staged(2, 2), tmp_path / "cut")
    with pytest.raises(JournalError, match="another study"):
        design(staged(3, 2), tmp_path / "cut", resume=True)
    design(staged(2, 4), tmp_path / "cut", resume=True)
    design(staged(2, 4), tmp_path / "whole")
    lines = [history(tmp_path / name) for name in ("whole", "cut")]
    for a, b in zip(*lines, strict=True):
        a.pop("seconds"), b.pop("seconds")
        assert a == b
    assert [line["stage"] for line in lines[1]] == [0, 0, 1, 1, 1, 1]


def test_a_search_whose_time_is_up_at_the_end_of_a_stage_goes_on_with_the_next():
    problem = problem_of(search={"stages": [{"iterations": 2}, {"iterations": 3}], "seconds": 1.0})
    progress = descent.begin(problem)
    progress.iteration, progress.seconds, progress.level = 2, 5.0, np.zeros(1)
    descent.stop(problem, progress)
    assert "time of 1 s" in progress.reason
    assert progress.stage == 1


class Landscape:
    """A search without runs: the loss of each start, and which points hold."""

    def __init__(self, monkeypatch, value, holds, **search):
        self.units, self.problem = [], problem_of(search=search)

        def seen(u, k):
            nothing = jnp.zeros((1, 1))
            return Seen(nothing, nothing[:, :0], nothing[:, :0], value(u)[None], jnp.asarray(holds(u, k))[None])

        landscape = self

        class Mock(Evaluator):
            def gradients(self, unit, multipliers, penalty, settings):
                landscape.units.append(unit.copy())
                rows = [(value(u), jax.grad(value)(u), seen(u, k)) for k, u in enumerate(jnp.asarray(unit))]
                return Evaluated(*jax.device_get(jax.tree.map(lambda *v: jnp.stack(v), *rows)))

        monkeypatch.setattr(descent, "Evaluator", Mock)
        monkeypatch.setattr(descent, "loss", lambda problem, u, m, p, s: (value(u), seen(u, 0)))

    def searched(self):
        progress = descent.begin(self.problem)
        return [(p.falls.copy(), line, p.reason) for p, line in descent.search(self.problem, progress)], progress


@pytest.mark.parametrize("name", ["sgd", "lbfgs"])
def test_a_search_stops_before_runs_that_fail(name, monkeypatch):
    """Less would be had at 0.9, but nothing holds from 0.7 on: the last point that holds is near there."""
    on = Landscape(
        monkeypatch,
        lambda u: jnp.sum((u - 0.9) ** 2),
        lambda u, k: u[0] < 0.7,
        name=name,
        learning_rate=1.0,
        iterations=25,
    )
    lines, progress = on.searched()
    assert 0.65 < progress.best[0, 0] < 0.7
    assert len(lines) == 25


def test_a_start_that_is_given_up_stays_so(monkeypatch):
    """The first holds at its first point alone, the second everywhere."""
    on = Landscape(
        monkeypatch, lambda u: jnp.sum(u), lambda u, k: k == 1 or len(on.units) == 1,
        name="sgd", learning_rate=1e-3, starts=2, iterations=22, patience=100,
    )  # fmt: skip
    lines, _ = on.searched()
    alive = [line.alive for _, line, _ in lines]
    assert alive == [2] * 8 + [1] * 14
    assert lines[-1][0].tolist() == [8, 0]


@pytest.mark.parametrize("patience", [1, 4])
def test_patience_counts_iterations_without_a_gain(patience, monkeypatch):
    """Flat: the first point is a gain, all others are none."""
    on = Landscape(
        monkeypatch, lambda u: 1.0 + 0.0 * jnp.sum(u), lambda u, k: True, name="sgd", patience=patience, iterations=30
    )
    lines, progress = on.searched()
    assert len(lines) == 1 + patience
    assert progress.reason.endswith(f"in {patience} iterations")


def test_an_expected_gradient_is_not_lost_where_most_samples_are_flat():
    """Samples without a slope say nothing of how long one may be."""
    slopes = jnp.array([[[0.0], [0.0], [0.0], [0.0], [0.0], [1.0], [1.0], [100.0]]])
    found = evaluate._without_outliers(slopes, jnp.ones((1, 8), bool))
    np.testing.assert_allclose(found[0, :, 0], [0, 0, 0, 0, 0, 1.0, 1.0, evaluate.OUTLIER])


@pytest.mark.long
def test_a_point_at_which_a_machine_fails_is_no_result():
    """As drawn it runs; of six that scatter widely some do not, and what those would give is worth nothing."""
    wild = {
        "tolerances": {"preload": {"path": "rollers.pinch.preload", "sigma": 300.0}},
        "robust": {"samples": 6},
    }
    point = score(problem_of(**wild), problem_of().start)
    assert point.verdicts[0].status == "passed"
    assert np.isnan(point.objective)
    assert point.rank > replace(point, objective=1e6).rank


@pytest.mark.long
def test_gradients_that_cannot_be_are_told():
    problem = problem_of(search={"iterations": 2})
    result = design(problem)
    steep = [result.history[0] | {"gradient": 1e26}, *result.history[1:]]
    assert "In 1 of 2 iterations the gradient promised more than 10000 times the largest objective" in told(
        result, steep
    )
    assert "promised" not in told(result)
    near = [line | {"objective": 1e-12} for line in result.history]
    assert "promised" not in told(result, near), "it came near its target"


@pytest.mark.long
def test_gradients_that_keep_no_promise_are_told():
    """Exact slopes of what single time steps do, of which nothing is left over the way that a search goes."""
    result = design(problem_of(search={"iterations": 1}))

    def history(came, **others):
        line = result.history[0] | others
        return [line | {"iteration": k + 1, "loss": 2.0 - came * (k % 2), "promised": -1.0} for k in range(7)]

    assert "Over 6 steps the gradients promised changes of 6 in all, and 0.3 came:" in told(result, history(0.05))
    assert "promised" not in told(result, history(0.5))
    assert "promised" not in told(result, history(0.05, objective=1e3)), "too little of it to matter"
    assert "promised" not in told(result, history(0.05)[:5])
    assert "promised" not in told(result, [line | {"start": k} for k, line in enumerate(history(0.05))])
    assert "promised" not in told(result, [line | {"loss": None} for line in history(0.05)])
    old = [{k: v for k, v in line.items() if k not in ("loss", "promised")} for line in history(0.05)]
    assert "promised" not in told(result, old)


def test_gradients_that_lead_the_wrong_way_are_told():
    """Every second step of a loss that goes up and down, while each gradient said down; and all of one that falls."""
    result = design(problem_of(search={"iterations": 1}))

    def history(losses):
        return [
            result.history[0] | {"iteration": k + 1, "loss": loss, "promised": -1.0} for k, loss in enumerate(losses)
        ]

    few = "Of 6 steps 3 changed what is minimised the way that their gradient said: few,"
    assert few in told(result, history([2.0, 1.5, 2.0, 1.5, 2.0, 1.5, 2.0]))
    falls = told(result, history([2.0, 1.8, 1.6, 1.4, 1.2, 1.0, 0.8]))
    assert "Of 6 steps 6 changed what is minimised the way that their gradient said." in falls
    assert "gradient said" not in told(result, history([2.0, 1.5, 2.0, 1.5, 2.0])), "four steps tell nothing"


@pytest.mark.long
def test_slip_is_held_against_the_floor_of_the_law_that_the_run_had():
    """Here a harder one than the machine's, whose own floor lies above all that is slipped."""
    problem = problem_of(objective={"slip": {"measure": "slip", "of": "drive"}})
    (seen,) = look(problem, problem.start, Settings(smoothing=0.05)).goals[0]
    hard = problem.scene(problem.start)
    scene = eased(hard, 0.05)
    run = simulate(problem, scene)
    floors = [float(diffeed.measures.creep_floor(s, run)["drive"]) for s in (scene, hard)]
    slipped = float(run.observed["nips"]["drive"].slip_rms)
    assert floors[0] < 0.9 * slipped < floors[1]
    assert float(seen) == pytest.approx(slipped - floors[0], rel=1e-9)


@pytest.mark.slow
def test_stages_ease_the_contact_and_end_at_the_hard_settings():
    problem = problem_of(
        search={"stages": [{"iterations": 4, "smoothing": 5.0, "duration": 0.005}, {"iterations": 20}]}
    )
    progress = descent.begin(problem)
    lines = [line for _, line in descent.search(problem, progress)]
    assert [line.stage for line in lines[:4]] == [0, 0, 0, 0]
    assert lines[-1].stage == 1
    result = finish(problem, progress, [line._asdict() for line in lines])
    assert result.after.goals[0, 0] == pytest.approx(4.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("search", "words"),
    [
        ({"goal": 0.5}, "reached the goal"),
        ({"seconds": 1e-3}, "time of 0.001 s"),
        ({"patience": 3, "gain": 0.9, "iterations": 60}, "no gain"),
        ({"iterations": 3}, "3 iterations are done"),
    ],
)
def test_the_reason_for_stopping_is_given(search, words):
    problem = problem_of(search=search)
    progress = descent.begin(problem)
    for _ in descent.search(problem, progress):
        pass
    assert words in progress.reason


def test_ctrl_c_leaves_a_usable_result():
    def press(problem, progress, line):
        if line.iteration == 4:
            raise KeyboardInterrupt

    result = design(problem_of(), watch=press)
    assert "stopped by hand after 4" in result.reason
    assert result.improved
    assert isinstance(result, optimize.Result)


def test_the_expected_gradient_is_not_ruled_by_one_sample():
    """Four samples of length 1 and one of 1000: that one counts as 3. A failed sample does not count at all."""
    others = np.array([[1.0, 0.0]] * 4)
    gradient = jnp.asarray(np.concatenate([others, [[0.0, 1000.0]], [[np.nan, np.nan]]])[None])
    fine = jnp.array([[True] * 5 + [False]])
    kept = np.asarray(evaluate._without_outliers(gradient, fine))[0]
    np.testing.assert_allclose(kept[:4], others)
    np.testing.assert_allclose(kept[4], [0.0, evaluate.OUTLIER])
    alone = jnp.array([[[3.0, 4.0]]])
    np.testing.assert_allclose(evaluate._without_outliers(alone, jnp.array([[True]])), alone)


# --- the result in shorter steps ---------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(("dt", "holds"), [(1.25e-4, True), (5e-4, False)])
def test_a_result_is_held_against_shorter_steps(dt, holds):
    """In steps of 0.5 ms the nip still rings at the end, which the search takes for force: the preload that it finds is worse
    than the start."""
    result = design(problem_of(dt=dt, search={"iterations": 20}))
    found = optimize.confirm(result)
    for at, then in ((result.before, found.before), (result.after, found.after)):
        again = score(problem_of(dt=dt / FINER), at.unit)
        assert then.objective == again.objective != at.objective
    assert found.holds == holds
    said = found.sentence()
    assert said.startswith("Confirmed: in steps" if holds else f"Not confirmed: in steps {FINER} times as fine")
    assert f"to {found.after.objective:.4g}, in the search's own from {result.before.objective:.4g}" in said
    assert ("That is no gain" in said) != holds


def test_a_machine_that_jams_or_breaks_limits_in_shorter_steps_is_told():
    before = score(problem_of(), np.array([0.5]))
    jams = before.verdicts[0]._replace(status="jammed")
    for after, told in (
        (replace(before, verdicts=(jams,)), "there passed before, jammed after"),
        (
            replace(before, violation=0.5),
            "there passed before, passed with limits broken by up to 0.5 of their scale after",
        ),
    ):
        found = optimize.Confirmation(before, after, (1.0, 0.5))
        assert not found.holds
        assert told in found.sentence()


def test_a_gain_that_is_mostly_of_the_steps_is_told():
    before = replace(score(problem_of(), np.array([0.5])), objective=1.0)
    for after, searched, part in ((0.9, (2.0, 1.0), True), (0.5, (2.0, 1.2), False), (0.9, (1.0, 0.9), False)):
        found = optimize.Confirmation(before, replace(before, objective=after), searched)
        assert found.holds
        assert found.sentence().startswith("Confirmed in part: " if part else "Confirmed: ")
        assert ("Most of that gain is of the steps" in found.sentence()) == part
    broken = replace(before, violation=0.5)
    assert optimize.Confirmation(broken, before, (2.0, 0.1)).sentence().startswith("Confirmed: "), (
        "it keeps the limits now"
    )


def test_what_was_not_improved_needs_no_confirmation_and_too_many_steps_are_told():
    result = design(problem_of(search={"iterations": 4}))
    assert optimize.confirm(replace(result, after=result.before)) is None
    study = result.problem.study.model_copy(update={"dt": 2e-11})
    with pytest.raises(ValueError, match="steps"):
        optimize.confirm(replace(result, problem=replace(result.problem, study=study)))


def test_a_smaller_tolerance_is_given_more_steps():
    study = problem_of(step_tolerance=0.1, most_steps=100).study
    assert study.finer().stepping == study.stepping | {"tolerance": 0.1 / FINER, "most_steps": 100 * FINER}
    assert problem_of().study.finer().stepping == problem_of().study.stepping | {"dt": TABLE["dt"] / FINER}


# --- the result in its folder -----------------------------------------------------------------------------------------


def test_a_result_leaves_no_files_of_an_earlier_one(tmp_path):
    for name in (*FILES, "notes.txt"):
        (tmp_path / name).write_text("earlier")
    result = design(problem_of(search={"iterations": 1}))
    assert write_result(tmp_path, result, pictures=False) == ["scene.toml", "result.json"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "result.json", "scene.toml"]
    (tmp_path / "scene.toml").unlink()
    (tmp_path / "scene.toml").mkdir()  # cannot be replaced
    with pytest.raises(OSError):  # noqa: PT011
        write_result(tmp_path, result, pictures=False)
    assert not (tmp_path / "result.json").exists(), "the folder looks complete"


def problem_without_parts():
    """A sheet that flies."""
    sheet = diffeed.Sheet(
        length=20.0, bars=2, thickness=0.1, width=50.0, density=1e-6, youngs_modulus=2e3, lead=(0.0, 0.0), speed=50.0
    )
    scene = diffeed.scene(sheets={"a": sheet}, gravity=(0.0, 0.0), initial="given", duration=0.01)
    variables = {"speed": {"path": "sheets.a.speed", "bounds": [10.0, 100.0]}}
    objective = {"way": {"measure": "lead_x", "target": 0.6}}
    table = TABLE | {"variables": variables, "objective": objective, "search": {"iterations": 1}}
    return make_problem(make_study(table), scene=scene)


@pytest.mark.long
def test_a_machine_without_rollers_and_guides_has_a_result(tmp_path):
    names = write_result(tmp_path, design(problem_without_parts()))
    assert set(FILES) - set(names) == {"when_before.png"}


@pytest.mark.slow
def test_without_rollers_and_guides_nothing_is_to_blame():
    problem = problem_without_parts()
    assert blame_map.arising(problem, problem.start, spans=3).share.shape == (0, 3)
