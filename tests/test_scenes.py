"""Every shipped scene is sound, settles, runs, and does what its comment promises."""

import functools

import numpy as np
import pytest

import diffeed
from diffeed.input.parts import Scene

OUTCOMES: dict[str, list[tuple[dict[str, float], str]]] = {
    "film_feeder": [({}, "passed")],
    "gap_bridge": [
        ({}, "passed"),
        ({"sheets.paper.youngs_modulus": 2000.0}, "passed"),
        ({"sheets.paper.youngs_modulus": 1000.0}, "jammed"),
    ],
    "jam_layout": [
        ({}, "jammed"),
        ({"guides.deflector.start[0]": 35.0}, "passed"),
        ({"guides.deflector.end[0]": 47.0}, "passed"),
        ({"guides.deflector.friction": 0.12}, "passed"),
        ({"rollers.pinch_1.preload": 0.6}, "passed"),
    ],
    "long_path": [({}, "passed")],
}
"""Scene -> changes by path, and what comes of them (without a goal, "passed" means: still moving at the end)."""


def changed(name: str, changes: dict[str, float]) -> Scene:
    scene = diffeed.load_scene(name)
    for path, value in changes.items():
        scene = diffeed.put(scene, path, value)
    return scene


@functools.cache
def run(name: str, **changes: float) -> tuple[Scene, diffeed.Trajectory]:
    """A scene and its run; one compilation per scene serves every change and every test."""
    scene = changed(name, changes)
    return scene, diffeed.simulate(scene, dt=1e-4, observe=("nips", "arrivals"))


def only_sheet(scene: Scene) -> str:
    (name,) = scene.sheets
    return name


def test_every_shipped_scene_has_an_outcome():
    assert set(diffeed.shipped_scenes()) == set(OUTCOMES)


@pytest.mark.parametrize("name", OUTCOMES)
def test_first_paragraph_says_what_it_is_for(name):
    words = diffeed.shipped_scenes()[name].split()
    assert 20 < len(words) < 100


@pytest.mark.slow
@pytest.mark.parametrize("name", OUTCOMES)
def test_is_sound(name):
    assert diffeed.check(diffeed.load_scene(name)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", OUTCOMES)
def test_settles_without_deep_contact(name):
    """The first frame is the rest state: nips closed, and nothing pressed in by half the thickness."""
    scene, trajectory = run(name)
    half = float(scene.sheets[only_sheet(scene)].thickness) / 2
    parts = [*trajectory.rollers.items(), *trajectory.guides.items()]
    depths = {part: -float(track.gap[0]) for part, track in parts if float(track.force[0]) > 0}
    assert {"drive_1", "pinch_1"} <= set(depths)
    assert max(depths.values()) < half


@pytest.mark.slow
@pytest.mark.parametrize("name", OUTCOMES)
def test_outcome_is_the_promised_one(name):
    for changes, outcome in OUTCOMES[name]:
        scene, trajectory = run(name, **changes)
        assert bool(trajectory.ok), (changes, trajectory.failure.describe())
        verdict = diffeed.measures.verdict(scene, trajectory)
        assert verdict.status == outcome, (changes, verdict.sentence())
        if outcome == "passed" and scene.goal:
            assert verdict.time is not None
            assert verdict.time < 0.97 * scene.duration  # with room to spare


@pytest.mark.slow
def test_jam_is_one_of_a_slipping_drive():
    """The card stands still on the deflector while the first drive slips under it; nothing folds or is crushed."""
    scene, trajectory = run("jam_layout")
    late = np.asarray(trajectory.time) > 0.5 * scene.duration
    nodes = np.asarray(trajectory.sheets["card"].nodes)[late]
    assert np.ptp(nodes[:, 0], axis=0).max() < 2.0
    assert np.asarray(trajectory.rollers["drive_1"].slip)[late].min() > 250.0  # of 300 mm/s
    assert min(float(np.asarray(g.gap).min()) for g in trajectory.guides.values()) > -0.05


@pytest.mark.slow
def test_long_path_hands_over_without_slip():
    """Five nips at 1500 mm/s: each takes the sheet at its speed, and no contact is crushed."""
    scene, trajectory = run("long_path")
    half = float(scene.sheets["paper"].thickness) / 2
    for name, slip in diffeed.measures.slip(scene, trajectory).items():
        assert abs(float(slip.mean)) < 1.0, name  # mm/s
        assert float(slip.rms) < 3.0, name
    for name, track in trajectory.rollers.items():
        pressed = np.asarray(track.force) > 0
        assert pressed.any(), name
        assert -np.asarray(track.gap)[pressed].min() < half, name
    lead, tail = (
        float(diffeed.measures.arrival(scene, trajectory, "paper", "exit", edge)) for edge in ("lead", "tail")
    )
    assert tail - lead == pytest.approx(297.0 / 1500.0, rel=0.01)
