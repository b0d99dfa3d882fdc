"""Steps chosen by their error: what the tolerance buys, gradients through the accepted steps, batches, failures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.scenes import draw, free_sheet

import diffeed
from diffeed.records import replace
from diffeed.steppers import ESTIMATING
from diffeed.trajectory import CAUSES

FEEDER = diffeed.load_scene("film_feeder")
RADIUS = "rollers.drive_1.radius"
SHORT = {"duration": 0.02, "frames": 5, "most_steps": 400}


def lead(scene: diffeed.Scene, **options) -> jax.Array:
    return next(iter(diffeed.simulate(scene, **options).sheets.values())).nodes[:, 0]


@pytest.fixture(scope="module")
def converged() -> np.ndarray:
    """The film's lead edge over the first 20 ms, from two small steps and the order of the method, mm."""
    coarse, fine = (np.asarray(lead(FEEDER, duration=0.02, dt=dt, frames=5)) for dt in (4e-6, 2e-6))
    return 2.0 * fine - coarse


@pytest.mark.parametrize("stepper", ESTIMATING)
def test_error_falls_with_the_tolerance(stepper, converged):
    """The start is an impact: rollers turn at full speed under a film at rest. Steps go as the square root of the tolerance
    (the error of a step of order one is h^2), and so does the error at the end: to a tenth for a hundredth."""
    errors, steps = [], []
    for tolerance in (1e-2, 1e-4):
        run = diffeed.simulate(FEEDER, method=stepper, tolerance=tolerance, **SHORT)
        errors.append(np.max(np.abs(np.asarray(run.sheets["film"].nodes[:, 0]) - converged)))
        steps.append(int(run.steps))
        assert run.ok
        assert float(run.time[-1]) == pytest.approx(0.02, abs=1e-12)
        assert float(run.dt) == pytest.approx(0.02 / steps[-1])
    assert errors[0] < 0.03
    assert errors[1] < 0.2 * errors[0]
    assert steps[0] < steps[1] < 400


def test_beats_equal_steps_at_the_same_number(converged):
    run = diffeed.simulate(FEEDER, method="extrapolated_euler", tolerance=1e-3, **SHORT)
    # Each step is two half steps and a whole one, to see the error: three of the others for one.
    equal = lead(FEEDER, duration=0.02, dt=0.02 / (3 * int(run.steps)), frames=5)
    chosen = np.max(np.abs(np.asarray(run.sheets["film"].nodes[:, 0]) - converged))
    assert chosen < 0.3 * np.max(np.abs(np.asarray(equal) - converged))


def test_steps_are_short_in_the_impact_and_long_after_it():
    frames = [
        diffeed.simulate(FEEDER, duration=t, frames=2, tolerance=1e-3, most_steps=400).steps for t in (5e-3, 0.05)
    ]
    first, rest = int(frames[0]), int(frames[1]) - int(frames[0])
    assert rest * 5e-3 < 0.3 * first * 0.045  # per second of feeding, less than a third


@pytest.mark.parametrize("stepper", ["linear_euler", pytest.param("extrapolated_euler", marks=pytest.mark.slow)])
def test_derivative_is_that_of_the_steps_taken(stepper):
    """Both modes alike; and along the trend over ten micrometres of radius, which equal steps blur."""

    def at(radius):
        return lead(diffeed.put(FEEDER, RADIUS, radius), method=stepper, tolerance=1e-3, **SHORT)[-1, 0]

    forward = float(jax.jit(jax.jacfwd(at))(10.0))
    reverse = float(jax.jit(jax.grad(at))(10.0))
    assert reverse == pytest.approx(forward, rel=1e-8)
    sweep = np.linspace(-5e-3, 5e-3, 9)
    values = np.asarray(jax.jit(jax.vmap(at))(10.0 + sweep))
    trend = np.polyfit(sweep, values, 2)
    assert forward == pytest.approx(trend[1], rel=0.02)
    assert np.std(values - np.polyval(trend, sweep)) < 5e-5  # mm


def test_tolerance_may_be_traced():
    value, slope = jax.jit(
        lambda t: jax.jvp(lambda t: lead(FEEDER, tolerance=t, **SHORT)[-1, 0], (t,), (jnp.ones(()),))
    )(1e-3)
    assert np.isfinite(value)
    assert slope == 0.0  # the steps are held fixed


def test_batch_equals_single_runs():
    scenes = [draw("free_sheet", seed) for seed in (0, 1, 2)]
    options = {"duration": 0.01, "frames": 3, "tolerance": 1e-4, "most_steps": 600}
    batch = jax.vmap(lambda s: diffeed.simulate(s, **options))(diffeed.stack(scenes))
    for k, scene in enumerate(scenes):
        single = diffeed.simulate(scene, **options)
        assert int(batch.steps[k]) == int(single.steps)
        assert np.asarray(batch.sheets["paper"].nodes[k]) == pytest.approx(
            np.asarray(single.sheets["paper"].nodes), abs=1e-10
        )
    assert len({int(n) for n in batch.steps}) > 1, "samples must differ for this to show anything"


def test_observers_weigh_by_time():
    run = diffeed.simulate(FEEDER, tolerance=1e-3, observe=("nips",), **SHORT)
    equal = diffeed.simulate(FEEDER, duration=0.02, dt=1e-5, frames=5, observe=("nips",))
    chosen, expected = run.observed["nips"]["drive_1"], equal.observed["nips"]["drive_1"]
    assert float(chosen.contact_time) == pytest.approx(0.02)
    assert float(chosen.force_mean) == pytest.approx(float(expected.force_mean), rel=2e-3)
    assert float(chosen.slip_rms) == pytest.approx(float(expected.slip_rms), rel=0.05)


def test_running_out_of_steps_is_a_failure_of_that_sample_alone():
    options = {"duration": 0.02, "frames": 3, "most_steps": 40}
    few = jax.vmap(lambda t: diffeed.simulate(FEEDER, tolerance=t, **options))(jnp.array([1e-1, 1e-9]))
    assert few.ok.tolist() == [True, False]
    assert CAUSES[int(few.failure.cause[1])] == "the tolerance asks for more steps than `most_steps` allows"
    assert 0.0 < float(few.failure.time[1]) < 0.02
    assert float(few.time[1, -1]) == float(few.failure.time[1]), "a failed run stands still"


def test_a_scene_that_cannot_go_on_fails():
    rng = np.random.default_rng(0)
    scene = replace(free_sheet(rng), gravity=jnp.array([0.0, -1e30]))
    run = diffeed.simulate(scene, duration=0.01, frames=3, tolerance=1e-3, most_steps=600)
    assert not run.ok
    assert "step" in run.failure.describe() or "speeds" in run.failure.describe()


def test_no_more_bodies_than_slots_where_the_next_search_can_come_earlier():
    """Long steps reach far: the gap bridge has more bodies near its sheet than a search keeps."""
    run = diffeed.simulate(diffeed.load_scene("gap_bridge"), duration=0.3, frames=4, tolerance=1e-2)
    assert run.ok, run.failure.describe()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tolerance": 0.0}, "tolerance must be a positive number of mm, but is 0.0"),
        ({"tolerance": 1e-3, "method": "midpoint"}, "with a tolerance, method must be one of linear_euler, "),
        ({"tolerance": 1e-3, "most_steps": 3}, "most_steps must be a whole number of at least one per frame (4)"),
    ],
)
def test_says_what_is_wrong(options, said):
    with pytest.raises(ValueError, match="must be") as error:
        diffeed.simulate(FEEDER, **({"frames": 5} | options))
    assert said in str(error.value)
