"""What a sheet carries between two nips, and how far a run is from a jam."""

import functools

import jax
import numpy as np
import pytest

import diffeed
from diffeed import measures


def two_nips(ratio: float) -> diffeed.Scene:
    """A strip in two nips, 40 mm apart; the second turns `ratio` times as fast."""
    rollers = {}
    for k, (x, speed) in enumerate(((0.0, -40.0), (40.0, -40.0 * ratio))):
        profile = diffeed.Profile(times=(0.0, 0.02), values=(0.0, speed))
        rollers[f"drive_{k}"] = diffeed.FixedRoller(center=(x, -5.1), radius=5.0, friction=0.3, angular_speed=profile)
        rollers[f"pinch_{k}"] = diffeed.MovableRoller(
            center=(x, 5.1),
            direction=(0.0, 1.0),
            radius=5.0,
            mass=0.01,
            spring=0.5,
            preload=2.0,
            damper=0.01,
            friction=0.3,
        )
    sheet = diffeed.Sheet(
        length=80.0, thickness=0.2, width=20.0, density=1e-6, youngs_modulus=3000.0, structural_damping=1e-3, bars=16,
        lead=(50.0, 0.0),
    )  # fmt: skip
    return diffeed.scene(
        sheets={"strip": sheet}, rollers=rollers, gravity=(0.0, 0.0), duration=0.06, initial="given",
        sensors={"gate": diffeed.Sensor(position=(52.0, 0.0), direction=(1.0, 0.0))},
    )  # fmt: skip


@functools.cache
def run(ratio: float):
    scene = two_nips(ratio)
    observe = ("spans", "feed")
    return scene, diffeed.simulate(scene, dt=2e-4, frames=7, observe=observe)


def test_a_faster_second_nip_pulls_and_a_slower_one_pushes():
    pulled, pushed = (run(r)[1].observed["spans"]["strip"] for r in (1.2, 0.95))
    assert float(pulled.held) == pytest.approx(0.06, rel=0.05)
    assert float(pulled.tension) > 0.1
    assert float(pulled.buckling) < float(pushed.buckling)
    assert float(pushed.tension) < 0.0
    # Both nips slide at most with friction: 0.3 on two rollers of 2 N each.
    assert float(pulled.tension_peak) < 1.3


@pytest.mark.long
@pytest.mark.parametrize("method", [name for name in diffeed.METHODS if name != "linear_euler"])
def test_every_stepper_says_what_the_sheet_carries(method):
    """Explicit steps do not need the pull of the joints for themselves: they said none."""
    scene = diffeed.put(two_nips(1.2), "sheets.strip.structural_damping", 1e-5)  # with more, explicit steps are tiny
    how = {"duration": 3e-3, "frames": 2, "observe": ("spans",)}
    dt = 2.5e-7 if method == "runge_kutta" else 5e-6
    found = diffeed.simulate(scene, dt=dt, method=method, **how).observed["spans"]["strip"]
    known = diffeed.simulate(scene, dt=2e-6, **how).observed["spans"]["strip"]
    assert float(known.tension) > 0.05
    assert float(found.tension) == pytest.approx(float(known.tension), rel=0.02)
    assert float(found.tension_peak) == pytest.approx(float(known.tension_peak), rel=0.02)


def test_the_margin_is_the_smallest_part_and_has_a_sign():
    scene, done = run(1.2)
    parts = {k: float(v) for k, v in measures.jam_margins(scene, done).items()}
    smallest, margin = min(parts.values()), float(measures.jam_margin(scene, done))
    assert smallest - 0.05 * np.log(len(parts)) - 1e-9 <= margin <= smallest
    assert margin > 0.0
    assert measures.verdict(scene, done).status == "passed"
    # A goal that 60 ms of feeding cannot reach: 80 mm and 2 mm, of which some 9 mm are fed.
    far = diffeed.put(scene, "goal", "gate")
    fed = float(done.observed["feed"]["strip"].fed)
    assert float(measures.jam_margins(far, done)["progress"]) == pytest.approx(fed / (80.0 + 2.0) - 1.0, rel=1e-6)


def test_margins_must_be_observed():
    scene, _ = run(1.2)
    bare = jax.tree.map(lambda v: v, run(1.2)[1])
    bare = type(bare)(**{**vars(bare), "observed": {}})
    with pytest.raises(ValueError, match="feed"):
        measures.jam_margins(scene, bare)


@pytest.mark.long
def test_a_span_counts_once_however_many_rollers_hold_its_ends():
    """Pulled evenly the peak is the tension itself: of one span held by a drive on either side of the sheet, of two in a row."""
    film = {"thickness": 0.1, "width": 200.0, "density": 1e-6, "youngs_modulus": 3000.0, "structural_damping": 1e-4}

    def ratio(places, speeds, both):
        rollers = {}
        for k, (x, v) in enumerate(zip(places, speeds, strict=True)):
            rollers[f"lower_{k}"] = diffeed.FixedRoller(
                center=(-x, -10.05), radius=10.0, friction=0.8, surface_speed=-v
            )
            rollers[f"upper_{k}"] = diffeed.MovableRoller(
                center=(-x, 10.05), direction=(0.0, 1.0), radius=10.0, mass=0.02, preload=4.0, damper=0.02, friction=0.8,
                surface_speed=v if both else None,
            )  # fmt: skip
        sheet = diffeed.Sheet(length=200.0, bars=20, **film)
        scene = diffeed.scene(sheets={"s": sheet}, rollers=rollers, gravity=(0.0, 0.0))
        found = diffeed.simulate(scene, duration=0.02, dt=2e-4, frames=2, observe=("spans",)).observed["spans"]["s"]
        return float(found.tension_peak / found.tension)

    assert ratio((33.0, 103.0), (100.2, 100.0), True) == pytest.approx(1.0, abs=0.03)
    assert ratio((33.0, 73.0, 113.0), (100.4, 100.2, 100.0), False) == pytest.approx(1.0, abs=0.04)


@pytest.mark.long
@pytest.mark.parametrize(("speed", "goal", "way"), [(200.0, -10.0, 1.0), (-200.0, -41.0, -1.0)])
def test_progress_agrees_with_the_verdict(speed, goal, way):
    """Where the sheet lies in the gate at the start, and where it runs tail first: what the tail has still to go counts."""
    rollers = {
        "lower": diffeed.FixedRoller(center=(0.0, -10.05), radius=10.0, friction=0.5, surface_speed=-speed),
        "upper": diffeed.MovableRoller(
            center=(0.0, 10.05), direction=(0.0, 1.0), radius=10.0, mass=0.02, preload=4.0, damper=0.02, friction=0.5
        ),
    }
    sheet = diffeed.Sheet(
        length=80.0, bars=8, thickness=0.1, width=200.0, density=1e-6, youngs_modulus=3000.0, lead=(40.0, 0.0)
    )
    sensor = diffeed.Sensor(position=(goal, 0.0), direction=(way, 0.0))
    scene = diffeed.scene(sheets={"s": sheet}, rollers=rollers, gravity=(0.0, 0.0), sensors={"g": sensor}, goal="g")
    done = diffeed.simulate(scene, duration=0.18, dt=2e-4, frames=10, observe=("feed", "spans", "arrivals"))
    left = abs(goal + 40.0)  # from the tail at the start
    fed = abs(float(done.observed["feed"]["s"].fed))
    assert measures.verdict(scene, done).status == "passed"
    assert fed > left
    assert float(measures.jam_margins(scene, done)["progress"]) == pytest.approx(min(fed / left - 1.0, 1.0), rel=1e-6)
