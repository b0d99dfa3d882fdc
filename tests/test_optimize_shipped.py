"""The shipped studies, searched: each must better its machine and keep its limits. Minutes each."""

import pytest

import diffeed
from diffeed import measures
from optimize.design_run import design
from optimize.problem import make_problem
from optimize.study_file import load_study

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("as_users_have_it")]


def problem_of(name, **search):
    study = load_study(name)
    return make_problem(study.model_copy(update={"search": study.search.model_copy(update=search)}), name)


def test_nip_slip_finds_less_slip():
    result = design(problem_of("nip_slip", iterations=12))
    assert result.improved
    assert result.after.objective < 0.95 * result.before.objective
    assert result.after.violation <= 0.01


def test_speed_mismatch_matches_the_surface_speeds():
    """Worn drives pull at each other; what was found lets all surfaces run within 1 % of one speed (2 % before)."""
    problem = problem_of("speed_mismatch")
    result = design(problem)
    assert result.after.objective < 0.5 * result.before.objective
    assert result.before.violation > 0.5
    assert result.after.violation <= 0.01

    def spread(scene):
        speeds = [
            float(r.radius * r.angular_speed.values[1]) for name, r in scene.rollers.items() if name.startswith("drive")
        ]
        return (max(speeds) - min(speeds)) / abs(sum(speeds) / len(speeds))

    assert spread(problem.scenes[0]) > 0.018
    assert spread(result.scene) < 0.01


def test_jam_rescue_gets_out_of_the_jam():
    result = design(problem_of("jam_rescue"))
    assert result.before.verdicts[0].status == "jammed"
    assert result.after.verdicts[0].status == "passed"
    assert result.after.goals[0, 0] > 0.0 > result.before.goals[0, 0]
    again = diffeed.simulate(result.scene, dt=1e-4, observe=("feed", "spans", "arrivals"))
    assert measures.verdict(result.scene, again).status == "passed"
    assert float(measures.jam_margin(result.scene, again)) > 0.0
