"""Parts of the model that no reference case covers: moving guides, several sheets, stops, static friction, taut sheets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import (
    Clamp,
    Contact,
    FixedRoller,
    LineGuide,
    Load,
    Motion,
    MovableRoller,
    Profile,
    Scene,
    Sheet,
)

PAPER = {"thickness": 0.1, "width": 210.0, "density": 8e-7, "youngs_modulus": 3000.0}


def paper(length: float = 40.0, bars: int = 4, **changes) -> Sheet:
    return Sheet(**(PAPER | {"length": length, "bars": bars, "structural_damping": 1e-4} | changes))


@pytest.mark.long
def test_a_swinging_guide_lifts_the_sheet_that_lies_on_it():
    """A table under a whole sheet turns by 5 degrees about its left end within 50 ms; the sheet goes with it."""
    table = LineGuide(
        start=(-60.0, -0.05),
        end=(20.0, -0.05),
        friction=1.0,
        motion=Motion(
            times=(0.0, 0.05), displacement=((0.0, 0.0), (0.0, 0.0)), rotation=(0.0, 5.0), pivot=(-60.0, -0.05)
        ),
    )
    scene = Scene(sheets={"a": paper()}, guides={"table": table}, contacts={"default": Contact(damping=1.0)})
    run = diffeed.simulate(scene, duration=0.08, dt=1e-4, frames=9)
    assert run.ok
    np.testing.assert_allclose(np.rad2deg(run.sheets["a"].headings[-1]), 5.0, atol=0.1)
    assert float(run.guides["table"].rotation[-1]) == pytest.approx(np.deg2rad(5.0))
    # The lead edge, 60 mm from the pivot, has gone up with the face; it rests one penetration below t/2.
    assert float(run.sheets["a"].nodes[-1, 0, 1]) == pytest.approx(60.0 * np.tan(np.deg2rad(5.0)), abs=0.1)


@pytest.mark.long
def test_a_moving_belt_of_a_guide_drags_the_sheet_along():
    """A guide that moves along itself at 100 mm/s drags the sheet up to its own speed: friction sees the guide's velocity."""
    path = Motion(times=(0.0, 1.0), displacement=((0.0, 0.0), (100.0, 0.0)), rotation=(0.0, 0.0))
    belt = LineGuide(start=(-200.0, -0.05), end=(200.0, -0.05), friction=0.5, motion=path)
    run = diffeed.simulate(Scene(sheets={"a": paper()}, guides={"belt": belt}), duration=0.1, dt=2e-4, frames=3)
    assert float(run.sheets["a"].velocities[-1, 0, 0]) == pytest.approx(100.0, rel=1e-3)


@pytest.mark.long
def test_a_moving_roller_carries_its_surface_with_it():
    """A held roller under a clamped sheet, moved sideways: the sheet is dragged by the centre's velocity."""
    path = Motion(times=(0.0, 1.0), displacement=((0.0, 0.0), (50.0, 0.0)), rotation=(0.0, 0.0))
    rollers = {
        f"r{k}": FixedRoller(center=(x, -5.05), radius=5.0, friction=0.5, angular_speed=0.0, motion=path)
        for k, x in enumerate((-30.0, -10.0))
    }
    scene = Scene(sheets={"a": paper(youngs_modulus=30000.0)}, rollers=rollers)
    run = diffeed.simulate(scene, duration=0.1, dt=2e-4, frames=3)
    assert run.ok
    assert float(run.sheets["a"].velocities[-1, 0, 0]) == pytest.approx(50.0, rel=5e-3)
    assert float(run.rollers["r0"].center[-1, 0]) == pytest.approx(-25.0)


@pytest.mark.slow
def test_two_sheets_run_as_each_would_alone():
    table = {"table": LineGuide(start=(-200.0, -0.05), end=(200.0, -0.05), friction=0.3)}
    first = paper(lead=(0.0, 2.0), heading=3.0)
    second = paper(length=30.0, bars=3, lead=(100.0, 5.0), heading=-4.0, curl=1e-3)

    def run(**sheets):
        return diffeed.simulate(
            Scene(sheets=sheets, guides=table, initial="given"), duration=0.02, dt=1e-4, frames=3
        ).sheets

    together = run(a=first, b=second)
    for name, sheet in (("a", first), ("b", second)):
        alone = run(**{name: sheet})[name]
        np.testing.assert_allclose(together[name].nodes, alone.nodes, atol=1e-9)


def test_stops_end_the_travel_of_a_pinch():
    pinch = MovableRoller(
        center=(0.0, 0.0),
        direction=(0.0, 1.0),
        radius=5.0,
        mass=0.02,
        preload=3.0,
        damper=0.05,
        travel_min=-1.5,
        travel_max=2.0,
    )
    scene = Scene(sheets={"a": paper(lead=(100.0, 50.0))}, rollers={"p": pinch}, gravity=(0.0, 0.0), initial="given")
    down = diffeed.simulate(scene, duration=0.3, dt=2e-4, frames=2).rollers["p"].travel[-1]
    assert float(down) == pytest.approx(-1.5 - 3.0 / 1000.0, abs=1e-5)  # preload over stop stiffness
    up = diffeed.put(scene, "rollers.p.preload", -3.0)
    assert float(diffeed.simulate(up, duration=0.3, dt=2e-4, frames=2).rollers["p"].travel[-1]) == pytest.approx(
        2.003, abs=1e-5
    )


def test_a_pinch_rests_on_its_drive_and_is_driven_by_it():
    """No sheet in the nip: roller on roller. The pinch carries its preload and turns at the drive's surface speed."""
    rollers = {
        "drive": FixedRoller(center=(0.0, -10.0), radius=10.0, friction=0.8, angular_speed=-20.0),
        "pinch": MovableRoller(
            center=(0.0, 5.0), direction=(0.0, 1.0), radius=5.0, mass=0.02, preload=4.0, damper=0.02, friction=0.6
        ),
    }
    scene = Scene(sheets={"a": paper(lead=(200.0, 50.0))}, rollers=rollers, gravity=(0.0, 0.0), initial="given")
    run = diffeed.simulate(scene, duration=0.4, dt=2e-4, frames=3)
    pinch = run.rollers["pinch"]
    assert float(pinch.travel[-1]) == pytest.approx(-(4.0 / 200.0 + 1e-3), abs=1e-5)  # k (d - s/2) = preload
    assert float(pinch.angular_velocity[-1]) == pytest.approx(40.0, rel=1e-3)
    # The shaft of the drive supplies nothing once the pinch spins freely.
    assert abs(float(run.rollers["drive"].torque[-1])) < 0.1


def test_static_friction_holds_what_dynamic_friction_does_not():
    """Pulled by 1.2 of the dynamic limit: with a static ratio of 1.5 a resting sheet creeps, without it accelerates."""
    sheet = paper(bars=2)
    weight = 8e-7 * 40.0 * 0.1 * 210.0 * 9.81
    pull = Load(sheet="a", at="lead", force=(1.2 * 0.3 * weight, 0.0))
    table = {"table": LineGuide(start=(-200.0, -0.05), end=(200.0, -0.05), friction=0.3)}

    def speeds(ratio):
        contacts = {"default": Contact(stick_speed=0.1, static_ratio=ratio, transition_speed=20.0)}
        scene = Scene(sheets={"a": sheet}, guides=table, loads={"pull": pull}, contacts=contacts, initial="given")
        return np.asarray(diffeed.simulate(scene, duration=0.06, dt=1e-4, frames=4).sheets["a"].velocities[:, 0, 0])

    assert np.abs(speeds(1.5)).max() < 0.2
    # Once it has sunk into the table, it speeds up by what friction does not hold.
    assert np.diff(speeds(1.0))[-1] == pytest.approx(0.2 * 0.3 * 9810.0 * 0.02, rel=0.02)


def test_profiles_drive_shafts():
    """A shaft that ramps up linearly has turned by half the product of time and speed."""
    ramp = Profile(times=(0.0, 0.1), values=(0.0, 10.0))
    rollers = {"d": FixedRoller(center=(0.0, 100.0), radius=5.0, angular_speed=ramp)}
    scene = Scene(sheets={"a": paper()}, rollers=rollers, gravity=(0.0, 0.0), initial="given")
    angle = diffeed.simulate(scene, duration=0.2, dt=1e-3, frames=3).rollers["d"].angle
    np.testing.assert_allclose(angle, [0.0, 0.5, 1.5], atol=0.02)  # the implicit step sees the shaft at its end: h/2


TAUT = {
    "copy paper, 1.49 mm bars, 5 N": (paper(length=29.8, bars=20), 5.0),
    "copy paper, 20 bars of A4, 5 N": (paper(length=297.0, bars=20), 5.0),
    "steel foil, 20 N": (
        paper(length=200.0, bars=20, thickness=0.05, width=50.0, density=7.8e-6, youngs_modulus=2e5),
        20.0,
    ),
    "20 um tissue, 1 N": (paper(length=200.0, bars=20, thickness=0.02, density=5e-7, youngs_modulus=200.0), 1.0),
}


@pytest.mark.parametrize("case", TAUT)
def test_a_taut_sheet_holds(case):
    """Clamped at the tail and pulled at the lead, kicked sideways at one bar: without geometric stiffness the step diverges."""
    sheet, pull = TAUT[case]
    kick = np.zeros(20)
    kick[10] = 5.0
    scene = Scene(
        sheets={"a": diffeed.base.records.replace(sheet, rates=tuple(kick))},
        clamps={"wall": Clamp(sheet="a", at="tail", kind="pin")},
        loads={"pull": Load(sheet="a", at="lead", force=(pull, 0.0))},
        gravity=(0.0, 0.0),
        initial="given",
    )
    run = diffeed.simulate(scene, duration=0.1, dt=5e-4, frames=3)
    assert run.ok, run.failure.describe()
    assert np.abs(np.asarray(run.sheets["a"].nodes[-1, :, 1])).max() < 1e-3 * float(sheet.length)
    assert float(run.sheets["a"].nodes[-1, 0, 0]) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("method", ["linear_euler", "midpoint", "runge_kutta"])
def test_a_wall_that_turns_takes_its_sheet_along(method):
    """Evenly, without gravity: in the end the held bar follows without a lag, for a wall's damper feels the turning of the bar
    against the wall. A damper against the world would hold it back by damping/stiffness times the speed, 0.1 rad here."""
    speed, lasts = 2.0, 0.6
    motion = Motion(times=[0.0, 1.0], displacement=[[0.0, 0.0]] * 2, rotation=[0.0, np.rad2deg(speed)])
    scene = Scene(
        sheets={"a": paper(bars=2, structural_damping=0.05, rates=(speed, speed))},
        clamps={"wall": Clamp(sheet="a", at="tail", kind="wall", motion=motion)},
        gravity=(0.0, 0.0),
        initial="given",
    )
    dt = 1e-4 if method == "runge_kutta" else 1e-3
    run = diffeed.simulate(scene, duration=lasts, dt=dt, frames=4, method=method, observe=("energy",))
    assert run.ok, run.failure.describe()
    np.testing.assert_allclose(run.sheets["a"].headings[-1], speed * lasts, atol=2e-3)
    np.testing.assert_allclose(run.sheets["a"].rates[-1], speed, rtol=2e-2)
    assert 0.0 < float(run.observed["energy"]["joints"]) < 0.01  # N mm, of the start; a damper against the world: 0.6


@pytest.mark.parametrize("at", ["tail", "lead"])
def test_a_wall_holds_a_curled_sheet_by_its_tangent(at):
    """At rest it is the arc that leaves the wall straight on, off by the second order of a bar."""
    curl, length, off = 0.01, 100.0, []
    for bars in (10, 20):
        sheet = paper(bars=bars, length=length, curl=curl, lead=(length if at == "tail" else 0.0, 0.0))
        scene = Scene(sheets={"a": sheet}, clamps={"wall": Clamp(sheet="a", at=at, kind="wall")}, gravity=(0.0, 0.0))
        run = diffeed.simulate(scene, duration=1e-4, dt=1e-4, frames=2)
        free = np.asarray(run.sheets["a"].nodes[0, 0 if at == "tail" else -1])
        arc = np.array([np.sin(curl * length), 1.0 - np.cos(curl * length)]) / curl
        off.append(np.hypot(*(free - arc * np.array([1.0 if at == "tail" else -1.0, 1.0]))))
    assert off[0] < 0.05
    assert off[1] == pytest.approx(0.25 * off[0], rel=0.02)


@pytest.mark.long
def test_an_arm_that_turns_does_not_turn_idle_rollers():
    """Their bearings have no drag: each is turned about its own centre, and the sheet that lies on them stays. With drag they
    follow the arm."""

    def carried(drag):
        rollers = {
            f"roller_{k}": FixedRoller(
                center=(x, -5.05), radius=5.0, friction=0.5, inertia=1.0, bearing_drag=drag,
                motion=Motion(times=(0.0, 0.1), displacement=((0.0, 0.0),) * 2, rotation=(0.0, 90.0), pivot=(x, -5.05)),
            )
            for k, x in enumerate((-30.0, -10.0))
        }  # fmt: skip
        scene = Scene(sheets={"a": paper(bars=4, lead=(0.0, 0.0))}, rollers=rollers)
        return diffeed.simulate(scene, duration=0.05, dt=1e-4, frames=3, observe=("energy",))

    still, turned = carried(0.0), carried(50.0)
    assert np.abs(np.asarray(still.sheets["a"].velocities)).max() < 1e-6
    assert float(turned.rollers["roller_0"].angular_velocity[-1]) == pytest.approx(np.pi / 2 / 0.1, rel=0.05)
    assert float(turned.sheets["a"].velocities[-1, 0, 0]) < -10.0


def test_speed_is_along_the_lead_bar():
    scene = Scene(sheets={"a": paper(bars=2, headings=(90.0, 80.0), speed=100.0)}, initial="given", gravity=(0.0, 0.0))
    run = diffeed.simulate(scene, duration=0.01, dt=1e-3, frames=2)
    np.testing.assert_allclose(run.sheets["a"].velocities[0, 0], [0.0, 100.0], atol=1e-9)


def test_a_plain_second_call_traces_nothing():
    gate = diffeed.Sensor(position=(9.0, 0.0), direction=(1.0, 0.0))
    scene = Scene(sheets={"a": paper()}, sensors={"gate": gate}, initial="given")
    traced = []

    def counting(name, *_, **__):
        if name.endswith("jaxpr_trace_duration"):
            traced.append(name)

    diffeed.simulate(scene, duration=0.01, dt=1e-3, frames=2)
    jax.monitoring.register_event_duration_secs_listener(counting)
    try:
        diffeed.simulate(diffeed.put(scene, "sheets.a.length", 41.0), duration=0.01, dt=1e-3, frames=2)
        diffeed.simulate(diffeed.put(scene, "goal", "gate"), duration=0.01, dt=1e-3, frames=2)
        assert traced == []
        diffeed.simulate(scene, duration=0.01, dt=1e-3, frames=3)  # another static count: the listener works
        assert traced
    finally:
        jax.monitoring.clear_event_listeners()


def test_float32_runs_and_says_so():
    scene = Scene(sheets={"a": paper(bars=2)}, guides={"t": LineGuide(start=(-99.0, -0.05), end=(99.0, -0.05))})
    with jax.enable_x64(False), pytest.warns(diffeed.SinglePrecision, match="float32"):
        run = diffeed.simulate(scene, duration=0.01, dt=1e-4, frames=2)
    assert run.ok
    assert run.time.dtype == jnp.float32
    assert float(run.guides["t"].force[-1]) == pytest.approx(8e-7 * 40 * 0.1 * 210 * 9.81, rel=1e-2)


@pytest.mark.slow
def test_a_run_goes_on_where_another_stopped():
    scene = diffeed.load_scene("film_feeder")
    whole = diffeed.simulate(scene, duration=0.02, dt=5e-4, frames=3, observe=("nips", "energy"))
    half = diffeed.simulate(scene, duration=0.01, dt=5e-4, frames=2, observe=("nips", "energy"))
    rest = diffeed.simulate(scene, duration=0.01, dt=5e-4, frames=2, initial=half.final, observe=("nips", "energy"))
    np.testing.assert_allclose(rest.sheets["film"].nodes[-1], whole.sheets["film"].nodes[-1], atol=1e-9)
    for a, b in zip(jax.tree.leaves(rest.observed), jax.tree.leaves(whole.observed), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ({"dt": 0.0}, "dt must be a positive number of seconds, but is 0.0"),
        ({"duration": float("nan")}, "duration must be"),
        ({"frames": 1}, "frames must be a whole number of at least 2, but is 1"),
        ({"method": "euler"}, "method must be one of linear_euler, .*, but is 'euler'"),
        ({"observe": "nips"}, "observe must be a tuple of names"),
    ],
)
def test_senseless_arguments_are_refused(arguments, fragment):
    with pytest.raises(ValueError, match=fragment):
        diffeed.simulate(Scene(sheets={"a": paper()}), **arguments)


def test_what_is_traced_cannot_count_steps():
    scene = Scene(sheets={"a": paper()})
    for use in (
        lambda dt: diffeed.simulate(scene, duration=0.01, dt=dt).ok,
        lambda duration: diffeed.simulate(scene, duration=duration, dt=1e-3).ok,
    ):
        with pytest.raises(TypeError, match="is traced, but says how many steps there are"):
            jax.jit(use)(0.01)


def test_what_is_no_state_of_the_scene_is_told():
    scene = Scene(sheets={"a": paper(bars=2)}, gravity=(0.0, 0.0), initial="given")
    how = {"duration": 0.002, "dt": 1e-3, "frames": 2}
    run = diffeed.simulate(scene, **how)
    with pytest.raises(TypeError, match=r"this is a Trajectory: give its `final` to go on with it, or `final\.state`"):
        diffeed.simulate(scene, initial=run, **how)
    with pytest.raises(TypeError, match="this is a Resume: give its `state`"):
        diffeed.linearise(scene, run.final)
    other = Scene(sheets={"a": paper(bars=3)}, gravity=(0.0, 0.0), initial="given")
    with pytest.raises(ValueError, match="of sheets with 2 bars in all, but those of the scene have 3"):
        diffeed.simulate(other, initial=run.final.state, **how)


@pytest.mark.slow
def test_failure_is_a_value_and_spares_the_other_samples():
    """A sheet in free fall has no rest state; in a batch the others go on."""
    held = Scene(sheets={"a": paper(bars=2)}, guides={"t": LineGuide(start=(-99.0, -0.05), end=(99.0, -0.05))})
    falling = diffeed.put(diffeed.put(held, "guides.t.start", (900.0, 0.0)), "guides.t.end", (990.0, 0.0))
    runs = jax.vmap(lambda s: diffeed.simulate(s, duration=0.01, dt=1e-3, frames=2))(diffeed.stack([held, falling]))
    assert runs.ok.tolist() == [True, False]
    alone = diffeed.simulate(falling, duration=0.01, dt=1e-3, frames=2)
    assert "no rest state" in alone.failure.describe()
    assert np.isfinite(np.asarray(runs.sheets["a"].nodes)).all()
