"""How a contact throws back what hits it, by its law alone: closed forms, and a bar that the simulator drops."""

import numpy as np
import pytest

import diffeed
from diffeed.pair.rebound import rebound

MASS, SPEED = 1e-4, 100.0


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_without_damping_all_speed_comes_back(exponent):
    assert rebound(200.0, exponent, 0.0, 1.0, MASS, SPEED).share == pytest.approx(1.0, abs=1e-5)


def test_a_linear_contact_is_touched_for_half_a_period():
    assert rebound(200.0, 1.0, 0.0, 1.0, MASS, SPEED).seconds == pytest.approx(np.pi * np.sqrt(MASS / 2e5), rel=1e-4)


@pytest.mark.parametrize("ratio", [0.05, 0.3, 0.9])
def test_a_linear_damper_takes_what_it_must(ratio):
    """Parted where the force is zero, before the way is: exp(-z phi / sqrt(1 - z^2)), with phi = 2 atan(sqrt(1 - z^2) / z)."""
    damper = 2.0 * ratio * np.sqrt(MASS * 2e5) / 1e3
    root = np.sqrt(1.0 - ratio**2)
    due = np.exp(-ratio * 2.0 * np.arctan(root / ratio) / root)
    assert rebound(200.0, 1.0, damper, 0.0, MASS, SPEED).share == pytest.approx(due, rel=1e-3)


def test_too_much_damping_throws_nothing_back():
    assert rebound(200.0, 1.0, 100.0, 0.0, MASS, SPEED).share == 0.0


@pytest.mark.parametrize("damping", [0.0, 0.5, 4.0])
def test_a_bar_that_falls_flat_is_thrown_back_as_its_nodes_are(damping):
    """One bar, two nodes: each carries half of it. Measured: within 0.5 %."""
    bar = diffeed.Sheet(
        length=10.0, thickness=0.1, width=100.0, density=2e-6, youngs_modulus=3000.0, bars=1, lead=(5.0, 0.06),
        velocity=(0.0, -SPEED),
    )  # fmt: skip
    scene = diffeed.scene(
        sheets={"bar": bar},
        guides={"table": diffeed.LineGuide(start=(-20.0, 0.0), end=(20.0, 0.0))},
        contacts={"default": diffeed.Contact(damping=damping, smoothing=1e-6)},
        gravity=(0.0, 0.0),
        initial="given",
        duration=2e-3,
    )
    run = diffeed.simulate(scene, dt=1e-6, frames=2, method="runge_kutta")
    assert run.ok
    due = rebound(200.0, 1.0, damping, 1.0, 0.5 * 2e-4, SPEED)
    assert float(run.states.vy[-1, 0]) / SPEED == pytest.approx(due.share, rel=0.01)
