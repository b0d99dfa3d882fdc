"""What a contact throws back, by its law alone and in the simulator; and how much of it steps of any length take away."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import diffeed
from diffeed.contact.hits import Hits, taken_away
from diffeed.faults.rebounds import by_tolerance
from diffeed.pair.rebound import rebound
from diffeed.run.error_control import HORIZON
from diffeed.run.rollout import at_start, go_on
from diffeed.steppers import ESTIMATING, ORDERS

STIFFNESS, MASS, SPEED = 2e5, 1e-4, 90.0


def integrated(exponent, damping, damping_exponent):
    """Share and seconds from the equation of motion, clipped where it would pull."""

    def motion(_, at):
        depth = max(at[0], 0.0)
        force = STIFFNESS * depth**exponent + damping * depth**damping_exponent * at[1]
        return [at[1], -max(0.0, force) / MASS]

    def parted(_, at):
        return at[0]

    parted.terminal, parted.direction = True, -1
    run = solve_ivp(
        motion, (0.0, 0.1), [1e-12, SPEED], method="LSODA", events=parted, rtol=1e-9, atol=1e-14, max_step=1e-5
    )
    assert run.t_events[0].size
    return -run.y[1, -1] / SPEED, run.t[-1]


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("damping_exponent", [0.0, 0.5, 1.0, 1.5])
@pytest.mark.parametrize("lost", [0.01, 0.1, 0.5, 2.0])
def test_the_closed_form_is_near_what_the_law_does(exponent, damping_exponent, lost):
    """Measured: little damping within 0.006 and 8 % of the time, else within 0.09."""
    depth = (0.5 * (exponent + 1.0) * MASS * SPEED**2 / STIFFNESS) ** (1.0 / (exponent + 1.0))
    damping = lost * STIFFNESS * depth ** (exponent - damping_exponent) / SPEED
    share, seconds = integrated(exponent, damping, damping_exponent)
    found = rebound(STIFFNESS, exponent, damping, damping_exponent, MASS, SPEED)
    assert float(found.share) == pytest.approx(share, abs=0.1 if lost > 0.1 else 0.01)
    if lost <= 0.1:
        assert float(found.seconds) == pytest.approx(seconds, rel=0.08)


def test_without_damping_all_speed_comes_back():
    assert float(rebound(STIFFNESS, 1.5, None, None, MASS, SPEED).share) == 1.0


def test_too_much_damping_throws_nothing_back():
    assert float(rebound(STIFFNESS, 1.0, 1e8, 0.0, MASS, SPEED).share) < 1e-4


def dropped(gap, damping=0.0, exponent=1.0):
    """One bar, two nodes, which falls flat: each node carries half of it."""
    bar = diffeed.Sheet(
        length=10.0, thickness=0.1, width=100.0, density=2e-6, youngs_modulus=3000.0, bars=1, lead=(5.0, 0.05 + gap),
        velocity=(0.0, -SPEED),
    )  # fmt: skip
    return diffeed.scene(
        sheets={"bar": bar},
        guides={"table": diffeed.LineGuide(start=(-20.0, 0.0), end=(20.0, 0.0))},
        contacts={"default": diffeed.Contact(damping=damping, exponent=exponent, smoothing=1e-6)},
        gravity=(0.0, 0.0),
        initial="given",
        duration=2e-3,
    )


@pytest.mark.parametrize("damping", [0.0, 0.5, 4.0])
def test_a_bar_that_falls_flat_is_thrown_back_as_its_nodes_are(damping):
    run = diffeed.simulate(dropped(0.01, damping), dt=1e-6, frames=2, method="runge_kutta")
    assert run.ok
    due = rebound(STIFFNESS, 1.0, 1e3 * damping, 1.0, MASS, SPEED)
    assert float(run.states.vy[-1, 0]) / SPEED == pytest.approx(float(due.share), abs=0.06)


@pytest.mark.long
@pytest.mark.parametrize("method", diffeed.METHODS)
def test_steps_take_away_no_more_of_a_rebound_than_is_said(method):
    """In the mean over when in a step the bar arrives, at 0.02 to 0.6 of the time of the hit (beyond, explicit steps have no
    use). Measured: up to 0.11 more than is said by implicit Euler, 0.03 by the others; at 0.02 all are within 0.03."""

    @jax.jit  # one program for steps of all lengths
    def fall(scenes, h):
        return jax.vmap(lambda scene: go_on(scene, at_start(scene), h, 162, method))(scenes)

    for exponent in (1.0, 2.0):
        hit = float(rebound(STIFFNESS, exponent, None, None, MASS, SPEED).seconds)
        for steps in (0.02, 0.1, 0.3, 0.6):
            h = steps * hit
            made = diffeed.stack([dropped((2.0 + k / 8) * h * SPEED, exponent=exponent) for k in range(8)])
            runs = fall(made, h)
            assert bool(runs.ok.all())  # 90 mm/s are too little to be told
            thrown = runs.states.vy[:, -1, 0] / SPEED
            lost, said = float(1.0 - thrown.mean()), float(taken_away(steps, ORDERS[method]))
            assert lost < said + (0.12 if method == "linear_euler" else 0.03), (exponent, steps, lost, said)
            if steps == 0.02:
                assert lost == pytest.approx(said, abs=0.03)


@pytest.mark.long
@pytest.mark.parametrize("method", ESTIMATING)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
def test_steps_by_a_tolerance_take_away_no_more_than_is_said(method, tolerance):
    """Wherever in a step the bar arrives, on springs and cones."""
    for exponent in (1.0, 2.0):
        made = diffeed.stack([dropped(0.01 + 0.003 * k, exponent=exponent) for k in range(8)])
        runs = jax.vmap(lambda s: diffeed.simulate(s, duration=4e-3, tolerance=tolerance, frames=2, method=method))(
            made
        )
        assert bool(runs.ok.all())
        lost = SPEED - np.asarray(runs.states.vy[:, -1, 0])
        law = rebound(STIFFNESS, exponent, None, None, MASS, SPEED)
        said = float(by_tolerance(np.asarray(tolerance / HORIZON))(Hits(MASS, SPEED, law), np.nan))
        assert said < SPEED
        assert lost.max() < said
        if method == "linear_euler":
            assert lost.mean() > said / 4.0
