"""Robust design: the search sees machines that scatter, and follows the mean, the tail or the worst of them."""

import io

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from stand_in_nip import nip

import optimize
from diffeed import measures
from optimize.asked import by_limit
from optimize.descent import begin
from optimize.design_run import Result, Scored, _margins
from optimize.evaluate import Evaluator
from optimize.journal import fingerprint
from optimize.problem import Seen, Settings, _over_samples, make_problem
from optimize.report import print_result, summarise

pytestmark = pytest.mark.usefixtures("as_users_have_it")


STUDY = {
    "scene": "nip", "duration": 0.01, "frames": 5, "dt": 1e-3,
    "variables": {"preload": {"path": "rollers.pinch.preload", "bounds": [1.0, 6.0]}},
    "objective": {"force": {"measure": "nip_force", "of": "pinch", "target": 4.0}},
    "tolerances": {"scatter": {"path": "rollers.pinch.preload", "sigma": 0.3}},
    "robust": {"samples": 8},
    "search": {"iterations": 25, "learning_rate": 0.1},
}  # fmt: skip


def problem(**changes):
    return make_problem(optimize.make_study(STUDY | changes), scene=nip(initial="settled"))


def test_risks_of_known_samples():
    values = jnp.asarray([[1.0, 4.0, 2.0, 3.0]])
    every = Seen(values[..., None], values[..., None], values[..., None], values, jnp.ones((1, 4), bool))

    def risk(**robust):
        return float(_over_samples(problem(robust={"samples": 4} | robust), every).objective[0])

    assert risk(over="mean") == pytest.approx(2.5)
    assert risk(over="worst") == pytest.approx(4.0)
    assert risk(over="cvar", tail=0.5) == pytest.approx(3.5)
    assert risk(over="cvar", tail=0.375) == pytest.approx((4.0 + 0.5 * 3.0) / 1.5)
    assert float(_over_samples(problem(), every).goals[0, 0]) == pytest.approx(2.5)
    broken = every._replace(ok=jnp.asarray([[True, False, True, True]]))
    assert not bool(_over_samples(problem(), broken).ok[0])


@pytest.mark.parametrize(
    ("over", "violation", "told"),
    [("worst", 0.4, "BROKEN by 0.8"), ("cvar", 0.4, "BROKEN by 0.8"), ("mean", -1.0, ""), ("worst", 0.005, "")],
)
def test_a_limit_is_broken_by_what_ranks_the_points(over, violation, told):
    """Not by the mean of its measure, which stands beside it and may keep the limit where the worst machines do not."""
    limit = {"measure": "nip_force", "of": "pinch", "at_least": 1.0, "at_most": 5.0, "scale": 2.0}
    study = problem(limits={"force": limit}, robust={"samples": 8, "over": over})
    verdict = measures.Verdict("passed", "", 0.01, "")
    point = Scored(
        study.start, {"preload": 3.0}, np.array([[4.0]]), np.array([[4.0]]), 0.0, violation, (verdict,),
        by_limit(study.limits, np.array([[-1.0, violation]])), ({},),
    )  # fmt: skip
    text = io.StringIO()
    print_result(Console(file=text, width=140), Result(study, point, point, begin(study), [], "enough"))
    row = next(line for line in text.getvalue().splitlines() if "<= 5" in line)
    assert row.strip().endswith(told or "<= 5")
    words = {"mean": "all are means", "worst": "are those of the worst", "cvar": "the mean of the worst 25 %"}[over]
    (line,) = (line for line in text.getvalue().splitlines() if "8 machines that scatter" in line)
    assert words in line
    assert summarise(Result(study, point, point, begin(study), [], ""))["after"]["keeps_limits"] == (not told)


def test_where_machines_scatter_no_part_of_a_margin_binds():
    spare = {"spare": {"measure": "jam_margin", "of": "strip", "weight": -1.0}}
    assert _margins(problem(objective=spare), None, None) == {}


@pytest.mark.parametrize(("objective", "told"), [(0.0, True), (0.1, False)])
def test_an_objective_that_cannot_get_less_says_so(objective, told):
    study, verdict = problem(), measures.Verdict("jammed", "", 0.01, "")
    value = np.array([[4.0]])
    point = Scored(study.start, {"preload": 3.0}, value, value, objective, 0.0, (verdict,), value, ({},))
    text = io.StringIO()
    print_result(Console(file=text, width=140), Result(study, point, point, begin(study), [], "enough"))
    assert ("The objective is 0 at the start" in text.getvalue()) is told


@pytest.mark.slow
def test_the_expected_objective_has_the_variance_in_it():
    """E (f + d - 4)^2 = (f - 4)^2 + Var d: the best preload is the same, its score is the scatter."""
    study = problem()
    result = optimize.design(study)
    scatter = study.deviations()[:, 0]
    assert result.after.values["preload"] + scatter.mean() == pytest.approx(4.0, abs=0.1)
    assert result.after.objective == pytest.approx(np.var(scatter), abs=0.02)
    assert result.progress.counts.gradients == 8 * result.progress.iteration


def test_draws_are_fixed_or_new_by_choice():
    fixed, new = problem(), problem(robust={"samples": 8, "redraw": True})
    assert np.array_equal(fixed.deviations(3), fixed.deviations(0))
    assert not np.array_equal(new.deviations(3), new.deviations(0))
    assert np.array_equal(new.deviations(3), new.deviations(3))
    with pytest.raises(optimize.StudyError, match="redraw must be false"):
        problem(robust={"redraw": True}, search={"name": "lbfgs"})
    with pytest.raises(optimize.StudyError, match=r"tolerances.scatter.sigma must be greater than 0"):
        problem(tolerances={"scatter": {"path": "rollers.pinch.preload", "sigma": -1}})


@pytest.mark.slow
def test_the_gradient_of_the_tail_is_that_of_differences():
    study = problem(robust={"samples": 8, "over": "cvar", "tail": 0.3})
    evaluator = Evaluator(study)
    none = np.zeros((1, 1, 0))

    def at(u):
        return evaluator.gradients(np.array([[u]]), none, np.ones(1), Settings())

    found, step = at(0.4), 1e-5
    slope = (at(0.4 + step).value[0] - at(0.4 - step).value[0]) / (2 * step)
    assert found.gradient[0, 0] == pytest.approx(slope, rel=1e-5)
    mean = Evaluator(problem()).gradients(np.array([[0.4]]), none, np.ones(1), Settings())
    assert found.value[0] > mean.value[0]


def test_measured_values_belong_to_the_study(tmp_path):
    """A table that was edited in between gives other machines: the search that stopped is not gone on with."""

    def keys(*values):
        (tmp_path / "preloads.csv").write_text("\n".join(["preload", *map(str, values)]))
        of = {"path": "rollers.pinch.preload", "kind": "data", "file": "preloads.csv", "column": "preload"}
        study = optimize.make_study(STUDY | {"tolerances": {"scatter": of}})
        found = make_problem(study, scene=nip(initial="settled"), folder=tmp_path)
        return found.key, fingerprint(found)

    was = keys(2.9, 3.0, 3.2)
    assert keys(3.2, 2.9, 3.0) == was
    assert not set(keys(2.9, 3.0, 3.3)) & set(was)
