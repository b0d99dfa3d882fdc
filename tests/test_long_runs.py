"""A minute of feeding: nothing drifts, and the same inputs give the same bits."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import diffeed
from diffeed import ArcGuide, FixedRoller, Scene, Sheet
from diffeed.input.parts import normalise
from tests.cases.ledger import ledger

ROOT = Path(__file__).parent.parent
SPEED, RADIUS, DT, BARS = 300.0, 50.0, 5e-4, 10
TURN = 2.0 * np.pi * RADIUS / SPEED


def drum():
    """A sheet that a turning drum carries round inside a full circle, without end."""
    behind = np.rad2deg((np.arange(BARS) + 0.5) * 150.0 / BARS / RADIUS)
    sheet = Sheet(
        length=150.0, thickness=0.2, width=100.0, density=1e-6, youngs_modulus=200.0, bars=BARS, curl=1.0 / RADIUS,
        structural_damping=1e-3, lead=(0.0, RADIUS + 0.25), headings=180.0 - behind,
    )  # fmt: skip
    return normalise(
        Scene(
            sheets={"paper": sheet},
            rollers={"drum": FixedRoller(center=(0.0, 0.0), radius=RADIUS, surface_speed=SPEED, friction=1.0)},
            guides={
                "jacket": ArcGuide(
                    center=(0.0, 0.0), radius=RADIUS + 0.5, start_angle=0.0, sweep=360.0, friction=0.1, tip_radius=0.0
                )
            },
            initial="given",
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["linear_euler", "extrapolated_euler", "midpoint"])
def test_sixty_seconds_on_a_drum(method):
    """57 turns in 120 000 steps. Joints, times, turns and energies of the last ten seconds are those of the first."""
    scene = drum()
    run = diffeed.simulate(scene, duration=60.0, dt=DT, frames=6001, method=method, observe=("feed",))
    assert bool(run.ok), run.failure.describe()
    assert int(run.steps) == 120_000
    np.testing.assert_allclose(run.time, np.arange(6001) * 0.01, rtol=1e-13)
    nodes = np.asarray(run.sheets["paper"].nodes)
    np.testing.assert_allclose(np.linalg.norm(np.diff(nodes, axis=1), axis=2), 15.0, rtol=1e-11)
    assert np.hypot(*np.moveaxis(nodes, -1, 0)).max() < RADIUS + 1.0

    turned = np.unwrap(np.arctan2(nodes[:, 0, 1], nodes[:, 0, 0]))
    early, late = turned[1500] - turned[500], turned[-1] - turned[-1001]
    assert late == pytest.approx(early, rel=1e-5)  # not whole turns of a chain that ripples by 1e-5 of the way
    polygon = (
        (15.0 / 2.0) ** 2 / (2.0 * RADIUS) / RADIUS
    )  # how far from the drum a bar's middle may lie, over the radius
    assert turned[-1] - turned[0] == pytest.approx(2.0 * np.pi * 60.0 / TURN, rel=polygon)
    headings = np.asarray(run.sheets["paper"].headings)
    assert headings[-1, 0] - headings[0, 0] == pytest.approx(turned[-1] - turned[0], abs=0.3 / 15.0), (
        "they never wrap; a bar may tilt by the clearance over its length"
    )

    book = ledger(scene, jax.tree.map(lambda v: v[::20], run.states))
    energy = np.asarray(book.energy)
    # Bars ripple: samples scatter by 7 %, so that means of 50 differ by 2 % at two sigma.
    assert energy[-50:].mean() == pytest.approx(energy[25:75].mean(), rel=0.02)


@pytest.mark.long
def test_memory_does_not_grow_with_the_time():
    """Of the compiled run with the same frames: what it works in, one second against a minute, which is 118 000 steps more."""

    def working(duration):
        run = jax.jit(lambda s: diffeed.simulate(s, duration=duration, dt=DT, frames=11))
        return run.lower(drum()).compile().memory_analysis().temp_size_in_bytes

    assert working(60.0) <= working(1.0)


PRINT_BITS = """
import jax
jax.config.update("jax_enable_x64", True)
import diffeed
from tests.test_long_runs import hashed
print(hashed(diffeed.simulate(diffeed.load_scene("film_feeder"), duration=0.05, dt=2e-4, frames=6)))
"""


def bits(cores: set[int]) -> str:
    """The hash of a run in a process of its own, on these cores."""
    done = subprocess.run(
        [sys.executable, "-c", f"import os; os.sched_setaffinity(0, {cores!r})\n" + PRINT_BITS],
        capture_output=True, text=True, cwd=ROOT, check=True,
    )  # fmt: skip
    return done.stdout.strip()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_the_same_bits_in_every_process():
    """Two processes on all cores, one on a single core."""
    cores = os.sched_getaffinity(0)
    assert bits(cores) == bits(cores) == bits({min(cores)})


def hashed(run) -> str:
    leaves = jax.tree.leaves(jax.device_get((run.sheets, run.rollers, run.final)))
    return hashlib.sha256(b"".join(np.ascontiguousarray(v).tobytes() for v in leaves)).hexdigest()


@pytest.mark.slow
def test_the_same_bits_again_and_in_chunks():
    """Run twice; and in two halves, which end where the whole does to rounding: their searches fall on other steps."""
    scene = drum()
    whole = diffeed.simulate(scene, duration=0.32, dt=DT, frames=3)
    assert hashed(diffeed.simulate(scene, duration=0.32, dt=DT, frames=3)) == hashed(whole)
    first = diffeed.simulate(scene, duration=0.16, dt=DT, frames=2)
    second = diffeed.simulate(scene, duration=0.16, dt=DT, frames=2, initial=first.final)
    np.testing.assert_allclose(second.sheets["paper"].nodes[-1], whole.sheets["paper"].nodes[-1], rtol=0.0, atol=1e-11)
