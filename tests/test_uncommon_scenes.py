"""What few machines have: a full drum, a diverter that leaves its neighbour, drives that stop or turn back, dead loads, settings
that change between two runs."""

import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import measures
from diffeed.base.records import replace
from diffeed.chain.state import initial_state
from diffeed.input.parts import normalise
from diffeed.input.paths import PathError
from diffeed.model.build import build
from diffeed.readings.snapshot import look
from diffeed.run.rollout import at_start

FILM = {"thickness": 0.1, "width": 200.0, "density": 1e-6, "youngs_modulus": 3000.0, "structural_damping": 1e-4}


def drum(sweep: float) -> diffeed.Scene:
    """A short sheet pressed 0.01 mm into the inside of a drum."""
    arc = diffeed.ArcGuide(center=(0.0, 0.0), radius=30.0, start_angle=90.0, sweep=sweep)
    return diffeed.Scene(
        sheets={"s": diffeed.Sheet(**FILM, length=20.0, bars=4, lead=(10.0, -29.96))},
        guides={"d": arc},
        initial="given",
    )


def forces_in(scene: diffeed.Scene) -> np.ndarray:
    scene = normalise(scene)
    model = build(scene)
    pairs = look(model, initial_state(model, scene))[2].sheets
    return np.asarray(pairs.touch.force).sum(axis=0)


@pytest.mark.parametrize("sweep", [360.0, -360.0, 359.9999])
def test_a_full_turn_bears_all_around_as_a_part_of_it_does(sweep):
    """Where the seam is, at 90 degrees, no end fades and no tip is felt."""
    assert np.max(forces_in(drum(350.0))) > 1.0
    assert forces_in(drum(sweep)) == pytest.approx(forces_in(drum(350.0)), rel=1e-9)
    top = replace(
        drum(sweep), sheets={"s": diffeed.Sheet(**FILM, length=20.0, bars=4, lead=(-10.0, 29.96), heading=180.0)}
    )
    assert forces_in(top) == pytest.approx(forces_in(drum(350.0)), rel=1e-6)


def flush(movement: tuple[float, float], other: tuple[float, float] = (0.0, 0.0)) -> diffeed.Scene:
    """Two guides end to end; the second moves by `movement`, the first by `other`."""

    def motion(way):
        return (
            diffeed.Motion(times=(0.0, 2e-3), displacement=((0.0, 0.0), way), rotation=(0.0, 0.0)) if any(way) else None
        )

    guides = {
        "a": diffeed.LineGuide(start=(0.0, 0.0), end=(50.0, 0.0), motion=motion(other)),
        "b": diffeed.LineGuide(start=(50.0, 0.0), end=(120.0, 0.0), motion=motion(movement)),
    }
    return diffeed.Scene(
        sheets={"s": diffeed.Sheet(**FILM, length=60.0, bars=10, lead=(77.0, 0.05))},
        guides=guides,
        clamps={"c": diffeed.Clamp(sheet="s", at="tail", kind="bar")},
        loads={"l": diffeed.Load(sheet="s", at="lead", force=(0.0, -0.1))},
        initial="given",
    )


@pytest.mark.long
def test_only_guides_that_stay_together_are_joined():
    """What moves away from its neighbour leaves it a rounded end: nothing of it is missing where the sheet hangs over it."""
    away = (0.0, -40.0)
    for scene, joined in (
        (flush((0.0, 0.0)), 1.0),
        (flush(away), 0.0),
        (flush(away, away), 1.0),
        (flush(away, (1.0, 0.0)), 0.0),
    ):
        faces = build(normalise(scene)).guides.faces
        assert float(faces.joined[1][0]) == float(faces.joined[0][1]) == joined
    run = diffeed.simulate(flush(away), duration=0.05, dt=1e-4, frames=3)
    assert bool(run.ok), run.failure.describe()
    places = np.asarray(run.sheets["s"].nodes[-1])[::-1]
    assert np.interp(49.9, places[:, 0], places[:, 1]) > 0.0


def table(roller: dict, lead: float = 20.0) -> diffeed.Scene:
    return diffeed.Scene(
        sheets={"s": diffeed.Sheet(**FILM, length=60.0, bars=8, lead=(lead, 0.05))},
        guides={"g": diffeed.LineGuide(start=(-100.0, 0.0), end=(200.0, 0.0))},
        rollers={"d": diffeed.FixedRoller(center=(0.0, 10.09), radius=10.0, friction=1.0, **roller)},
        initial="given",
    )


def test_a_sheet_that_nothing_drives_has_stalled():
    """At rest beside the only driven roller it does not pass; beside one that stands still nothing was asked of it."""
    for speed, status in ((-300.0, "jammed"), (0.0, "passed")):
        scene = table({"surface_speed": speed}, lead=-30.0)
        run = diffeed.simulate(scene, duration=0.05, dt=1e-3, frames=11)
        found = measures.verdict(scene, run)
        assert found.status == status, found


def test_a_drive_that_stops_the_sheet_has_not_jammed_it():
    stop = diffeed.Profile(times=(0.0, 0.02, 0.04, 0.05), values=(0.0, 300.0, 300.0, 0.0))
    scene = table({"surface_speed": stop})
    run = diffeed.simulate(scene, duration=0.1, dt=1e-4, frames=41)
    assert float(run.sheets["s"].nodes[-1, 0, 0]) > 25.0
    found = measures.verdict(scene, run)
    assert found.status == "passed"
    assert found.reason == "s stood at the end, as the rollers that hold it did"


def test_progress_counts_the_way_that_is_commanded():
    for speed in (300.0, -300.0):
        scene = table({"surface_speed": speed})
        run = diffeed.simulate(scene, duration=0.05, dt=1e-4, frames=11, observe=("feed", "spans"))
        assert float(measures.progress(scene, run)["s"]) > 0.9
        assert 0.5 < float(measures.jam_margins(scene, run)["progress"]) < 1.0


@pytest.mark.long
def test_the_work_of_loads_is_no_numerical_gain():
    """A free sheet, drawn by 1 mN for 50 ms: the load's work is its kinetic energy, and the step loses none of it."""
    scene = diffeed.Scene(
        sheets={"s": diffeed.Sheet(**FILM, length=60.0, bars=8)}, loads={"l": diffeed.Load(sheet="s", force=(1e-3, 0.0))},
        initial="given", gravity=(0.0, 0.0),
    )  # fmt: skip
    run = diffeed.simulate(scene, duration=0.05, dt=1e-4, frames=3, observe=("energy",))
    found = measures.energy_balance(scene, run)
    assert float(found["stored"]) > 1e-4
    assert float(found["work of loads"]) == pytest.approx(float(found["stored"]), rel=1e-6)
    assert abs(float(found["numerical"])) < 1e-6 * float(found["stored"])
    other = table({"surface_speed": 0.0})
    assert "work of loads" not in measures.energy_balance(
        other, diffeed.simulate(other, 1e-3, frames=2, observe=("energy",))
    )


def test_a_run_goes_on_with_the_observers_it_has():
    scene = table({"surface_speed": -300.0})
    run = diffeed.simulate(scene, duration=2e-3, dt=1e-3, frames=2, observe=("feed", "spans"))
    with pytest.raises(
        ValueError, match=r"observe must be what it was in the run that goes on, feed, spans, but is nips"
    ):
        diffeed.simulate(scene, duration=2e-3, dt=1e-3, frames=2, initial=run.final, observe=("nips",))
    with pytest.raises(ValueError, match="but is nothing"):
        diffeed.simulate(scene, duration=2e-3, dt=1e-3, frames=2, initial=run.final)


def high(**contacts) -> diffeed.Scene:
    """A sheet 4.95 mm above a roller and a guide."""
    return diffeed.Scene(
        sheets={"s": diffeed.Sheet(**FILM, length=20.0, bars=4, lead=(10.0, 5.0))},
        rollers={"d": diffeed.FixedRoller(center=(0.0, -10.0), radius=10.0, surface_speed=0.0)},
        guides={"g": diffeed.LineGuide(start=(-50.0, -3.0), end=(100.0, -3.0), contact="plastic")},
        contacts={"default": diffeed.Contact(friction_law="stick"), "plastic": diffeed.Contact(**contacts)},
        initial="given", gravity=(0.0, 0.0),
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("method", diffeed.METHODS)
def test_a_deflection_that_nothing_presses_is_forgotten(method):
    scene = high()
    start = at_start(scene).state
    start = replace(start, grip=jnp.ones_like(start.grip))
    run = diffeed.simulate(scene, duration=2e-3, dt=1e-4, frames=2, method=method, initial=start)
    assert np.asarray(run.final.state.grip) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.long
def test_a_state_serves_where_more_sticks():
    """What the state does not hold starts at zero, in a run and in one that goes on."""
    few, more = high(), high(friction_law="stick")
    run = diffeed.simulate(few, duration=1e-3, dt=1e-4, frames=2)
    for initial in (run.final.state, run.final):
        assert bool(diffeed.simulate(more, duration=1e-3, dt=1e-4, frames=2, initial=initial).ok)
    assert np.all(np.isfinite(diffeed.linearise(more, run.final.state).mass))


@pytest.mark.long
def test_a_sheet_that_is_driven_backwards_is_told_so():
    """By a roller above it that turns clockwise, tail first; turned about it feeds the sheet to the sensor."""
    ahead = diffeed.Sensor(position=(30.0, 0.0), direction=(1.0, 0.0))
    for speed in (300.0, -300.0):
        scene = replace(table({"surface_speed": speed}), sensors={"exit": ahead}, goal="exit")
        scene = replace(scene, sheets={"s": replace(scene.sheets["s"], lead=(25.0, 0.05))})
        run = diffeed.simulate(scene, duration=0.3, dt=1e-4, frames=31)
        found = measures.verdict(scene, run)
        assert ("driven backwards by" in found.reason) == (speed < 0), found
        feed = diffeed.simulate(scene, duration=0.02, dt=1e-4, frames=2, observe=("feed",)).observed["feed"]["s"]
        assert np.sign(float(feed.driven)) == np.sign(speed)


def test_only_scenes_are_run():
    with pytest.raises(
        TypeError, match=r'simulate takes a Scene \(of diffeed.load_scene or diffeed.scene\), but this is "x"'
    ):
        diffeed.simulate("x")


def test_progress_counts_no_coasting():
    """What a sheet slides on by itself was not fed."""
    scene = replace(table({"surface_speed": 300.0}), duration=0.4)
    floor = replace(scene.guides["g"], friction=0.0)
    scene = replace(scene, guides={"g": floor})
    run = diffeed.simulate(scene, dt=1e-4, frames=5, observe=("feed",))
    feed = run.observed["feed"]["s"]
    assert float(feed.fed) > 1.5 * float(feed.commanded), "it coasts for most of the time"
    assert float(measures.progress(scene, run)["s"]) == pytest.approx(1.0, abs=0.1)


def test_what_cannot_be_is_said():
    """A start that a settled scene would forget, a wall within a sheet, a vector for one number."""
    settled = replace(table({"surface_speed": 0.0}), initial="settled")
    sheet = replace(settled.sheets["s"], velocity=(300.0, 0.0))
    (said,) = diffeed.check(replace(settled, sheets={"s": sheet}))
    assert said.startswith("sheets.s.velocity must be 0 mm/s in a scene that starts settled, but is [300.0, 0.0]")
    wall = replace(settled, clamps={"c": diffeed.Clamp(sheet="s", at=3, kind="wall")})
    (said,) = diffeed.check(wall)
    assert said == ('clamps.c.at must be "lead" or "tail" with kind "wall", but is 3: kind "bar" holds a sheet within')
    with pytest.raises(PathError, match=r'"rollers.d.center\[0\]" must be one number, but is'):
        diffeed.put(normalise(settled), "rollers.d.center[0]", [1.0, 2.0])
    turning = normalise(flush((0.0, -40.0)))
    with pytest.raises(PathError, match="must be 2 numbers, but is"):
        diffeed.put(turning, "guides.b.motion.displacement[1]", [1.0, 2.0, 3.0])
    moved = diffeed.put(turning, "guides.b.motion.displacement[1]", [1.0, 2.0])
    assert diffeed.get(moved, "guides.b.motion.displacement[1]") == pytest.approx([1.0, 2.0])


@pytest.mark.long
def test_whole_numbers_may_be_given_as_floats():
    scene = table({"surface_speed": 0.0})
    assert len(diffeed.simulate(scene, duration=1e-3, dt=1e-3, frames=3.0).time) == 3
    assert bool(diffeed.simulate(scene, duration=1e-3, tolerance=0.1, most_steps=1e2, frames=3).ok)
