"""Steps chosen by their error: what the tolerance buys, gradients through the accepted steps, batches, failures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.scenes import draw, free_sheet

import diffeed
from diffeed.base.records import replace
from diffeed.bench.transport import transport
from diffeed.faults.causes import CAUSES
from diffeed.run import rollout
from diffeed.steppers import ESTIMATING

FEEDER = diffeed.load_scene("film_feeder")
RADIUS = "rollers.drive_1.radius"
SHORT = {"duration": 0.02, "frames": 5, "most_steps": 4000}
"""One program for most of these tests: tolerance and duration are traced."""


@pytest.fixture(scope="module")
def rest() -> diffeed.State:
    return jax.jit(diffeed.settle)(FEEDER)


def lead(scene: diffeed.Scene, **options) -> jax.Array:
    return next(iter(diffeed.simulate(scene, **options).sheets.values())).nodes[:, 0]


@pytest.fixture(scope="module")
def converged(rest) -> np.ndarray:
    """The film's lead edge over the first 20 ms, mm. The start is an impact: rollers turn at full speed, the film rests."""
    return np.asarray(lead(FEEDER, method="extrapolated_euler", tolerance=1e-6, initial=rest, **SHORT))


@pytest.mark.long
def test_agrees_with_equal_steps_and_beats_them_at_the_same_number(rest, converged):
    def error(dt: float) -> float:
        return float(np.max(np.abs(np.asarray(lead(FEEDER, duration=0.02, dt=dt, frames=5, initial=rest)) - converged)))

    run = diffeed.simulate(FEEDER, method="extrapolated_euler", tolerance=1e-3, initial=rest, **SHORT)
    chosen = np.max(np.abs(np.asarray(run.sheets["film"].nodes[:, 0]) - converged))
    assert error(2e-6) < 5e-4
    # Each step is two half steps and a whole one, to see the error: three of the others for one.
    assert chosen < 0.3 * error(0.02 / (3 * int(run.steps)))


@pytest.mark.long
@pytest.mark.parametrize("stepper", ESTIMATING)
def test_error_falls_with_the_tolerance(stepper, rest, converged):
    """Steps go as the square root of the tolerance (the error of a step of order one is h^2), and so does the error at the
    end: to a tenth for a hundredth."""
    errors, steps = [], []
    for tolerance in (1e-2, 1e-4):
        run = diffeed.simulate(FEEDER, method=stepper, tolerance=tolerance, initial=rest, **SHORT)
        errors.append(np.max(np.abs(np.asarray(run.sheets["film"].nodes[:, 0]) - converged)))
        steps.append(int(run.steps))
        assert run.ok
        assert float(run.time[-1]) == pytest.approx(0.02, abs=1e-12)
        assert float(run.dt) == pytest.approx(0.02 / steps[-1])
    assert errors[0] < 0.03
    assert errors[1] < 0.2 * errors[0]
    assert steps[0] < steps[1] < 400


@pytest.mark.long
def test_steps_are_short_in_the_impact_and_long_after_it(rest):
    first, whole = (
        int(diffeed.simulate(FEEDER, tolerance=1e-3, initial=rest, **SHORT | {"duration": t}).steps)
        for t in (5e-3, 0.05)
    )
    assert (whole - first) * 5e-3 < 0.3 * first * 0.045  # per second of feeding, less than a third


@pytest.mark.slow
@pytest.mark.parametrize("stepper", ESTIMATING)
def test_derivative_is_that_of_the_steps_taken(stepper, rest):
    """Both modes alike to rounding; and along the trend over ten micrometres of radius, as far as the steps resolve the start:
    these 20 ms are all impact, so that the derivative is that of the trend to 5 %, and scatter a tenth of a micrometre."""

    def at(radius, tolerance=1e-3):
        changed = diffeed.put(FEEDER, RADIUS, radius)
        return lead(changed, method=stepper, tolerance=tolerance, initial=rest, **SHORT | {"most_steps": 400})[-1, 0]

    forward = float(jax.jit(jax.jacfwd(at))(10.0))
    reverse = float(jax.jit(jax.grad(at))(10.0))
    assert reverse == pytest.approx(forward, rel=1e-8)
    sweep = np.linspace(-5e-3, 5e-3, 9)
    values = np.asarray(jax.jit(jax.vmap(at))(10.0 + sweep))
    trend = np.polyfit(sweep, values, 2)
    assert forward == pytest.approx(trend[1], rel=0.05)
    assert np.std(values - np.polyval(trend, sweep)) < 1e-4  # mm
    # A tolerance may be traced; the steps that it gives are held fixed.
    value, slope = jax.jit(lambda t: jax.jvp(lambda t: at(10.0, t), (t,), (jnp.ones(()),)))(1e-3)
    assert np.isfinite(value)
    assert slope == 0.0


@pytest.mark.long
def test_derivative_of_a_free_fall_is_exact():
    """Through accepted and rejected steps, blocks and frames: the way of a falling sheet by gravity is t^2/2."""
    scene = replace(free_sheet(np.random.default_rng(0)), gravity=jnp.array([0.0, -9810.0]))

    def fallen(gravity):
        run = diffeed.simulate(
            replace(scene, gravity=jnp.stack([jnp.zeros(()), gravity])),
            duration=0.01, frames=3, tolerance=1e-3, method="extrapolated_euler", most_steps=600,
        )  # fmt: skip
        return jnp.mean(run.sheets["paper"].nodes[-1, :, 1]), run.ok

    slope, ok = jax.jit(jax.grad(fallen, has_aux=True))(-9810.0)
    assert ok
    assert float(slope) == pytest.approx(0.5 * 0.01**2, rel=1e-6)


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


@pytest.mark.slow
def test_observers_weigh_by_time(rest):
    """Against equal steps: sums over steps of unequal length."""
    observe = ("nips",)
    run = diffeed.simulate(FEEDER, tolerance=1e-5, observe=observe, initial=rest, **SHORT)
    equal = diffeed.simulate(FEEDER, duration=0.02, dt=2e-6, frames=5, observe=observe, initial=rest)
    chosen, expected = run.observed["nips"]["drive_1"], equal.observed["nips"]["drive_1"]
    assert float(chosen.contact_time) == pytest.approx(0.02)
    assert float(chosen.force_mean) == pytest.approx(float(expected.force_mean), rel=2e-3)
    assert float(chosen.slip_rms) == pytest.approx(float(expected.slip_rms), rel=0.03)


def test_running_out_of_steps_is_a_failure(rest):
    run = diffeed.simulate(FEEDER, tolerance=1e-9, initial=rest, **SHORT)
    assert not run.ok
    assert CAUSES[int(run.failure.cause)] == "the tolerance asks for more steps than `most_steps` allows"
    assert 0.0 < float(run.failure.time) < 0.02
    assert float(run.time[-1]) == float(run.failure.time), "a failed run stands still"


@pytest.mark.parametrize("most", [25, 40])
def test_no_more_steps_than_allowed(most):
    """In a run that would take some hundreds: blocks of steps and frames are no excuse."""
    sheet = diffeed.Sheet(length=40.0, thickness=0.1, width=100.0, density=8e-7, youngs_modulus=3000.0, bars=4)
    fall = diffeed.Scene(sheets={"a": sheet}, initial="given", duration=0.2)
    run = diffeed.simulate(fall, tolerance=1e-7, frames=21, most_steps=most)
    assert CAUSES[int(run.failure.cause)] == "the tolerance asks for more steps than `most_steps` allows"
    assert int(run.steps) == most


@pytest.mark.slow
def test_a_derivative_of_a_failed_run_says_so():
    """The steps that are differentiated are those that were taken; that the run failed after them must not be lost."""
    scene = free_sheet(np.random.default_rng(0))

    def height(gravity):
        changed = replace(scene, gravity=jnp.stack([jnp.zeros(()), gravity]))
        run = diffeed.simulate(
            changed, duration=0.01, frames=3, tolerance=1e-7, method="extrapolated_euler", most_steps=600
        )
        return jnp.mean(run.sheets["paper"].nodes[-1, :, 1]), (run.ok, run.failure.cause, run.failure.time)

    _, (ok, cause, time) = jax.jit(jax.grad(height, has_aux=True))(-9810.0)
    assert not ok
    assert CAUSES[int(cause)].startswith("the tolerance asks for more steps")
    assert 0.0 < float(time) < 0.01


def test_a_scene_that_cannot_go_on_fails():
    scene = replace(free_sheet(np.random.default_rng(0)), gravity=jnp.array([0.0, -1e30]))
    run = diffeed.simulate(scene, duration=0.01, frames=3, tolerance=1e-3, most_steps=600)
    assert not run.ok
    assert "no step, however small" in run.failure.describe() or "speeds grew" in run.failure.describe()


@pytest.mark.slow
def test_pieces_are_one_run(rest):
    """`final` holds the next step to try, so that a run goes on as if it had not been cut."""
    whole = diffeed.simulate(FEEDER, tolerance=1e-3, initial=rest, **SHORT)
    first = diffeed.simulate(FEEDER, tolerance=1e-3, initial=rest, **SHORT | {"duration": 0.01, "frames": 3})
    second = diffeed.simulate(FEEDER, tolerance=1e-3, initial=first.final, **SHORT | {"duration": 0.01, "frames": 3})
    assert int(first.steps) + int(second.steps) == int(whole.steps)
    assert np.asarray(second.states.heading[-1]) == pytest.approx(np.asarray(whole.states.heading[-1]), abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [{"tolerance": 1e-2}, {"dt": 2e-4}])
def test_no_more_bodies_than_slots_where_the_next_search_can_come_earlier(steps):
    """Long steps reach far: the gap bridge has more bodies near its sheet than a search keeps."""
    run = diffeed.simulate(diffeed.load_scene("gap_bridge"), duration=0.6, frames=7, **steps)
    assert run.ok, run.failure.describe()


@pytest.mark.slow
def test_hard_pressed_pinches_are_searched_often_enough():
    """The search among rollers reaches as far as 20 N take a pinch; over a long step that is further than the next nip."""
    scene = transport(nips=12, duration=0.05)
    for name in (n for n in scene.rollers if n.startswith("pinch")):
        scene = diffeed.put(scene, f"rollers.{name}.preload", 20.0)
    run = diffeed.simulate(scene, tolerance=1e-2, frames=6, most_steps=400)
    assert run.ok, run.failure.describe()


@pytest.mark.parametrize("dt", [1e-6, 1e-4, 2e-4, 5e-4, 1e-3, 5e-3])
def test_searches_are_close_in_steps_and_in_time(dt):
    counts = rollout.plan(0.7, dt, 11)
    assert counts.total * dt >= 0.7 - 1e-12
    assert counts.steps <= rollout.BLOCK
    assert counts.steps <= 2 or counts.steps * dt <= rollout.SEARCHED + 1e-12
    assert counts.total <= 1.1 * 0.7 / dt  # blocks of equal length: never a tenth more steps than asked for


@pytest.mark.parametrize("dt", [3e-4, 5e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("steps", [1, 5, 7, 13])
def test_long_steps_are_as_long_as_asked_for(dt, steps):
    assert rollout.plan(3 * steps * dt, dt, 4).total == 3 * steps


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


def _nip_driven_by(profile: diffeed.Profile, duration: float) -> diffeed.Scene:
    sheet = diffeed.Sheet(length=60.0, thickness=0.2, width=30.0, density=1e-6, youngs_modulus=3000.0, bars=3,
                          structural_damping=1e-4, lead=(20.0, 0.0))  # fmt: skip
    drive = diffeed.FixedRoller(center=(0.0, -8.1), radius=8.0, friction=1.0, surface_speed=profile)
    pinch = diffeed.MovableRoller(center=(0.0, 8.1), direction=(0.0, 1.0), radius=8.0, mass=0.01, preload=5.0, inertia=0.2,
                                  friction=1.0, damper=0.005)  # fmt: skip
    return diffeed.scene(sheets={"a": sheet}, rollers={"drive": drive, "pinch": pinch}, gravity=(0.0, 0.0), duration=duration,
                         contacts={"default": diffeed.Contact(stick_speed=0.5)}, initial="settled")  # fmt: skip


@pytest.fixture(scope="module")
def standing() -> diffeed.State:
    """Where it begins, whatever drives it: a derivative by the drive's corners need not go through the search for it."""
    return diffeed.settle(_nip_driven_by(diffeed.Profile(times=(0.0, 1.0), values=(0.0, 0.0)), 0.1))


@pytest.mark.long
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_a_short_pulse_of_a_drive_is_not_stepped_over(tolerance):
    """0.6 ms at up to 1 m/s after 0.1 s at rest, where steps have grown to their longest: 1000 * 0.0006 / 2 = 0.3 mm."""
    start, end = 0.1003, 0.1009
    profile = diffeed.Profile(times=(0.0, start, 0.5 * (start + end), end), values=(0.0, 0.0, -1000.0, 0.0))
    scene = _nip_driven_by(profile, 0.2)
    run = diffeed.simulate(scene, frames=3, observe=("feed",), tolerance=tolerance, method="extrapolated_euler")
    assert run.ok
    assert float(run.observed["feed"]["a"].commanded) == pytest.approx(0.3, rel=1e-6)
    assert -8.0 * float(run.rollers["drive"].angle[-1]) == pytest.approx(0.3, rel=1e-6)
    assert float(run.sheets["a"].nodes[-1, 0, 0]) - 20.0 == pytest.approx(0.2428, abs=0.02)


@pytest.mark.long
def test_what_is_fed_does_not_depend_on_how_long_the_steps_are():
    """Run up to 400 mm/s in 50 ms, then 50 ms at that speed: 30 mm, in steps from 1 us to 2 ms."""
    scene = _nip_driven_by(diffeed.Profile(times=(0.0, 0.05), values=(0.0, -400.0)), 0.1)
    run = diffeed.simulate(scene, frames=3, observe=("feed", "nips"), tolerance=1e-2, method="extrapolated_euler")
    feed = run.observed["feed"]["a"]
    assert float(run.sheets["a"].nodes[-1, 0, 0]) - 20.0 == pytest.approx(30.0, abs=1e-3)
    assert float(feed.fed) == pytest.approx(30.0, abs=1e-3)
    assert float(feed.commanded) == pytest.approx(30.0, abs=1e-6)
    assert float(run.observed["nips"]["drive"].contact_time) == pytest.approx(0.1, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("mode", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow)])
def test_steps_that_end_at_corners_go_along_with_them(standing, mode):
    """Of a pulse of a drive, a step or two long at this tolerance: what is fed by a later start, peak and end. With ends held
    fixed it is -1000, 500 and 879 by the first two of these steps. The sheet slips; what it does depends on steps by 5 %."""
    corners = jnp.array([0.1003, 0.1006, 0.1009])

    def fed(corners):
        profile = diffeed.Profile(times=jnp.concatenate([jnp.zeros(1), corners]), values=(0.0, 0.0, -1000.0, 0.0))
        run = diffeed.simulate(
            _nip_driven_by(profile, 0.2),
            frames=3,
            observe=("feed",),
            tolerance=1e-2,
            method="extrapolated_euler",
            most_steps=400,
            initial=standing,
        )
        return jnp.stack([run.observed["feed"]["a"].commanded, -8.0 * run.rollers["drive"].angle[-1]])

    np.testing.assert_allclose(jax.jit(mode(fed))(corners), np.array([[-500.0, 0.0, 500.0]] * 2), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("frames", [3, 8])
def test_where_a_frame_ends_at_a_corner_places_are_those_at_its_time(standing, frames):
    """Run up to 400 mm/s from 0 until a corner at 0.05 s, with a frame at that time and without: by a later one 200 mm/s less is
    fed in all, and until there: the way up to a given time goes as its square over the time of running up."""

    def fed(corner):
        profile = diffeed.Profile(times=jnp.stack([jnp.zeros(()), corner]), values=(0.0, -400.0))
        run = diffeed.simulate(
            _nip_driven_by(profile, 0.1), frames=frames, tolerance=1e-4, method="extrapolated_euler", most_steps=4000,
            initial=standing,
        )  # fmt: skip
        return run.sheets["a"].nodes[:, 0, 0], -8.0 * run.rollers["drive"].angle

    nodes, angles = jax.jit(jax.jacfwd(fed))(0.05)
    times = np.linspace(0.0, 0.1, frames)
    wanted = np.where(times <= 0.05, -200.0 * (times / 0.05) ** 2, -200.0)
    np.testing.assert_allclose(angles, wanted, atol=1e-6)
    np.testing.assert_allclose(nodes, wanted, atol=0.1)  # it slips while it is accelerated, by its steps


def _lift(start, lasting) -> diffeed.Motion:
    """By 2.5 mm."""
    return diffeed.Motion(
        times=jnp.stack([jnp.zeros(()), start, start + lasting]),
        displacement=((0.0, 0.0), (0.0, 0.0), (0.0, 2.5)),
        rotation=(0.0, 0.0, 0.0),
    )


@pytest.mark.long
def test_a_guide_that_moves_later_is_later():
    """A table lifts a sheet at 50 mm/s from 0.05 to 0.1 s, times of two frames: by a later movement it is lower on the way. The
    table throws nothing back, or the sheet would still hop at 0.125 s."""

    def height(start):
        motion = _lift(start, 0.05)
        table = diffeed.LineGuide(start=(-60.0, 0.0), end=(60.0, 0.0), motion=motion)
        sheet = diffeed.Sheet(
            length=60.0, thickness=0.2, width=30.0, density=1e-6, youngs_modulus=3000.0, bars=3, lead=(20.0, 0.1)
        )
        dead = {"default": diffeed.Contact(damping=0.02, damping_exponent=0.0)}
        scene = diffeed.scene(sheets={"a": sheet}, guides={"table": table}, contacts=dead, initial="settled")
        run = diffeed.simulate(scene, duration=0.15, frames=7, tolerance=1e-3, most_steps=2000)
        return jnp.mean(run.sheets["a"].nodes[:, :, 1], axis=1)

    slopes = jax.jit(jax.jacfwd(height))(0.05)
    # In 2 ms steps it follows the table by a tenth of a millimetre late, and so do the slopes by 1 %.
    np.testing.assert_allclose(slopes, [0.0, 0.0, 0.0, -50.0, -50.0, 0.0, 0.0], atol=1.0)


@pytest.mark.long
def test_a_clamp_that_moves_later_is_later():
    """It lifts a sheet by 2.5 mm in 50.1 ms from 50.3 ms on; frames do not end at its corners."""

    def height(start):
        motion = _lift(start, 0.0501)
        sheet = diffeed.Sheet(length=60.0, thickness=0.2, width=30.0, density=1e-6, youngs_modulus=3000.0, bars=3,
                              lead=(20.0, 0.1), structural_damping=1e-3)  # fmt: skip
        clamp = diffeed.Clamp(sheet="a", at=2, kind="bar", motion=motion)
        scene = diffeed.scene(sheets={"a": sheet}, clamps={"arm": clamp}, gravity=(0.0, 0.0), initial="given")
        run = diffeed.simulate(scene, duration=0.15, frames=7, tolerance=1e-3, most_steps=1500)
        return run.sheets["a"].nodes[:, 2, 1]

    speed = 2.5 / 0.0501
    slopes = jax.jit(jax.jacfwd(height))(0.0503)
    np.testing.assert_allclose(slopes, [0.0, 0.0, 0.0, -speed, -speed, 0.0, 0.0], atol=1e-3)  # a clamp is no spring


@pytest.mark.slow
@pytest.mark.parametrize("together", [True, False])
def test_a_corner_that_another_drive_shares_or_repeats(together):
    """Another drive has a shorter profile, whose last point is at the first corner of the pulse and stands there three times for
    the arrays. It counts once, and changes nothing where it moves along. Alone, half the step goes along: 6 % off by unlike
    steps."""
    corners = jnp.array([0.1003, 0.1006, 0.1009])

    def fed(first):
        moved = corners.at[0].set(first)
        pulse = diffeed.Profile(times=jnp.concatenate([jnp.zeros(1), moved]), values=(0.0, 0.0, -1000.0, 0.0))
        shorter = diffeed.Profile(
            times=jnp.stack([jnp.zeros(()), first if together else corners[0]]), values=(0.0, 9.0)
        )
        far = diffeed.FixedRoller(center=(0.0, -80.0), radius=8.0, surface_speed=shorter)
        scene = _nip_driven_by(pulse, 0.2)
        scene = diffeed.scene(**vars(replace(scene, rollers=scene.rollers | {"far": far})))
        how = {"tolerance": 1e-2, "method": "extrapolated_euler", "most_steps": 400}
        return diffeed.simulate(scene, frames=3, observe=("feed",), **how).observed["feed"]["a"].commanded

    slope = float(jax.jit(jax.jacfwd(fed))(corners[0]))
    assert slope == pytest.approx(-500.0, abs=1e-6) if together else slope == pytest.approx(-562.5, abs=0.1)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::diffeed.SinglePrecision")
def test_a_replay_that_loses_its_run_says_so():
    """In single precision the steps found are not always stepped again: what is differentiated then stood still."""
    with jax.enable_x64(False):

        def fed(start):
            times = jnp.stack([jnp.zeros(()), start, jnp.asarray(0.1006), jnp.asarray(0.1009)])
            scene = _nip_driven_by(diffeed.Profile(times=times, values=(0.0, 0.0, -1000.0, 0.0)), 0.2)
            how = {"tolerance": 1e-2, "method": "extrapolated_euler", "most_steps": 400}
            run = diffeed.simulate(scene, frames=3, **how)
            return -8.0 * run.rollers["drive"].angle[-1], run.ok

        (turned, ok), (slope, _) = jax.jvp(fed, (jnp.asarray(0.1003),), (jnp.asarray(1.0),))
    # Where it holds, it is right by the roundings of some hundred steps.
    assert not ok or (float(turned), float(slope)) == pytest.approx((0.3, -500.0), rel=1e-2)


@pytest.mark.long
def test_a_corner_a_rounding_before_a_frame_leaves_no_stub():
    """The fourth frame is at 0.30000000000000004 s. With this longest step the last step of a block ends at 0.3."""
    scene = _nip_driven_by(diffeed.Profile(times=(0.0, 0.3), values=(0.0, -400.0)), 0.4)
    run = diffeed.simulate(scene, frames=5, dt=0.00192, tolerance=0.1)
    assert run.ok, run.failure.describe()
