"""A run that cannot be believed says so: when, why and where, inside the compiled run and for each sample by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import (
    ArcGuide,
    CircleGuide,
    Clamp,
    Contact,
    FixedRoller,
    LineGuide,
    Load,
    Motion,
    MovableRoller,
    Scene,
    Sheet,
    measures,
)
from diffeed.base.records import replace
from diffeed.chain.state import initial_state
from diffeed.contact.crossing import misplaced
from diffeed.faults.causes import (
    ACROSS,
    BEHIND,
    CAUSES,
    FROM_NOWHERE,
    FROZEN,
    LEAPT,
    LOST_REBOUND,
    NO_REST,
    NOT_FINITE,
    OUT_OF_ORDER,
    REMEDIES,
    SINGULAR,
    TOO_DEEP,
    TOO_FAST,
    UNRESOLVED,
)
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.readings.trajectory import join
from tests.search.oracle import across

METHODS = diffeed.METHODS
IMPLICIT = tuple(m for m in METHODS if m != "runge_kutta")


def strip(**given):
    """Two bars of 10 mm, 1e-3 kg."""
    values = {
        "length": 20.0, "thickness": 0.5, "width": 100.0, "density": 1e-6, "youngs_modulus": 300.0, "bars": 2,
        "structural_damping": 1e-4,
    }  # fmt: skip
    return Sheet(**values | given)


def machine(sheet, contact=None, **given):
    values = {"contacts": {"default": contact or Contact(stiffness=30.0, damping=0.05)}, "initial": "given"}
    return normalise(Scene(sheets={"strip": sheet}, **values | given))


def thrown(speed):
    """A strip that flies straight down at a post under its middle joint."""
    post = CircleGuide(center=(-10.0, -20.0), radius=5.0)
    return machine(strip(velocity=(0.0, -speed)), guides={"floor": post}, gravity=(0.0, 0.0))


def pressed(guide, force):
    """A strip pressed onto a guide by a force in its middle."""
    return machine(
        strip(lead=(10.0, 0.26)),
        Contact(stiffness=3.0, damping=1e-3, friction_law="none"),
        guides={"bed": guide},
        loads={"press": Load(sheet="strip", at=1, force=(0.0, -force))},
        gravity=(0.0, 0.0),
    )


def failed(run, cause, part=None):
    assert not bool(run.ok)
    assert CAUSES[int(run.failure.cause)] == CAUSES[cause], run.failure.describe()
    assert np.isfinite(run.failure.time)
    assert CAUSES[cause] in run.failure.describe()
    assert run.failure.remedy() == REMEDIES[cause]
    if part is not None:
        assert run.failure.parts[int(run.failure.part)] == part
    for leaf in jax.tree.leaves((run.sheets, run.states)):
        assert np.isfinite(leaf).all(), "the frames show the last good state"


def test_every_cause_has_words_and_a_remedy():
    assert len(set(CAUSES)) == len(CAUSES) == len(REMEDIES)
    assert all(remedy for remedy in REMEDIES[1:])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "guide", [CircleGuide(center=(0.0, -500.0), radius=500.0), LineGuide(start=(-50.0, 0.0), end=(50.0, 0.0))]
)
def test_pushed_deeper_than_a_body_allows(guide, method):
    """3 N/mm give way by more than 2.25 mm (guides) and 3 mm (circles) under 20 N; 1 N they bear."""
    run = diffeed.simulate(pressed(guide, 20.0), duration=0.02, dt=1e-5, frames=3, method=method)
    failed(run, TOO_DEEP, "guides.bed")
    assert bool(diffeed.simulate(pressed(guide, 1.0), duration=0.02, dt=1e-5, frames=3, method=method).ok)


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_approach_too_fast_to_be_resolved(method):
    """At 20 m/s a step of 1e-4 s moves 2 mm, of 2.5 mm that the post allows, half may be made in a step; at 5 m/s 0.5 mm."""
    run = diffeed.simulate(thrown(20e3), duration=0.01, dt=1e-4, frames=3, method=method)
    failed(run, UNRESOLVED, "guides.floor")
    slow = diffeed.simulate(thrown(5e3), duration=0.0029, dt=1e-4, frames=3, method=method)
    assert bool(slow.ok), slow.failure.describe()


@pytest.mark.parametrize("stepping", [{"dt": 1e-4}, {"tolerance": 1e-6, "most_steps": 12}])
def test_a_failed_run_says_how_many_steps_it_took(stepping):
    """Not how many were planned: what it reached, over those, would be a step that nobody took."""
    run = diffeed.simulate(thrown(20e3), duration=0.01, frames=3, **stepping)
    assert not run.ok
    assert 0 < int(run.steps) < 50
    gone = float(run.states.time[-1])
    assert gone < 2e-3
    assert float(join([run]).dt) == pytest.approx(gone / int(run.steps), rel=1e-9)
    assert float(run.dt) == pytest.approx(gone / int(run.steps), rel=1e-9)
    said = measures.verdict(thrown(20e3), run).sentence()
    assert said == f"failed: {run.failure.describe()}"
    assert said.count(f"at {float(run.failure.time):.6g} s") == 1


@pytest.mark.slow
def test_no_speed_passes_a_post_unseen():
    """Whatever the step, a run that holds has the strip above the post."""
    speeds = np.geomspace(100.0, 1e6, 64)
    scenes = diffeed.stack([thrown(v) for v in speeds])
    for dt in (1e-3, 1e-4):
        runs = jax.vmap(lambda s, dt=dt: diffeed.simulate(s, duration=0.02, dt=dt, frames=21))(scenes)
        middle = np.asarray(runs.sheets["strip"].nodes)[:, :, 1, 1]
        assert (middle[np.asarray(runs.ok)] > -20.0).all()
        assert 0 < np.asarray(runs.ok).sum() < len(speeds)


@pytest.mark.parametrize("method", METHODS)
def test_a_step_of_ten_milliseconds_is_refused(method):
    """Half a step at the speed gained under gravity: 0.5 mm."""
    run = diffeed.simulate(machine(strip()), duration=0.1, dt=1e-2, frames=3, method=method)
    failed(run, LEAPT)
    if method in IMPLICIT:
        assert bool(diffeed.simulate(machine(strip()), duration=0.1, dt=5e-3, frames=3, method=method).ok)


def bouncing(stiffness, **changes):
    """A strip that rests on a floor, undamped."""
    contact = Contact(stiffness=stiffness, damping=0.0, smoothing=1e-4, friction_law="none")
    floor = LineGuide(start=(-50.0, 0.0), end=(50.0, 0.0))
    return machine(strip(lead=(10.0, 0.2501), youngs_modulus=0.0, **changes), contact, guides={"floor": floor})


def test_energy_from_nowhere():
    """Contact springs of omega dt = 3.5 (4 k/m) under an explicit step of 2e-5 s, stable up to 2.8: the strip is thrown off
    at half a metre per second, which neither speed nor depth tells."""
    run = diffeed.simulate(bouncing(3e4), duration=0.02, dt=2e-5, frames=3, method="runge_kutta")
    failed(run, FROM_NOWHERE, "guides.floor")
    fine = diffeed.simulate(bouncing(30.0), duration=0.02, dt=2e-5, frames=3, method="runge_kutta")
    assert bool(fine.ok), fine.failure.describe()


@pytest.mark.parametrize("method", ["linear_euler", "extrapolated_euler"])
def test_stiff_contact_is_no_fault(method):
    """For steppers that damp what they do not resolve; the midpoint rule, which keeps it, throws the strip off and says so."""
    run = diffeed.simulate(bouncing(3e4), duration=0.02, dt=1e-4, frames=3, method=method)
    assert bool(run.ok), run.failure.describe()


@pytest.mark.parametrize("method", METHODS)
def test_clamps_that_contradict_each_other(method):
    """The same node held twice: the equations have no single solution."""
    clamps = {"one": Clamp(sheet="strip", at="tail"), "two": Clamp(sheet="strip", at=2, displacement=(1.0, 0.0))}
    failed(diffeed.simulate(machine(strip(), clamps=clamps), duration=0.01, dt=1e-5, frames=3, method=method), SINGULAR)


def test_numbers_that_stop_being_finite():
    """A modulus that is no number comes past no check; nothing touches, nothing is clamped."""

    @jax.jit
    def run(modulus):
        return diffeed.simulate(machine(strip(youngs_modulus=modulus)), duration=0.01, dt=1e-3, frames=3)

    failed(run(np.nan), NOT_FINITE)
    assert bool(run(300.0).ok)


def test_an_idle_roller_that_spins_ever_faster():
    """Drag over inertia of 1e5/s under an explicit step of 1e-4 s: each multiplies the spin by hundreds. Nothing touches."""
    idle = FixedRoller(center=(0.0, -500.0), radius=5.0, spin=10.0, inertia=1.0, bearing_drag=100.0)
    scene = machine(strip(), rollers={"idle": idle}, gravity=(0.0, 0.0))
    failed(diffeed.simulate(scene, duration=0.01, dt=1e-4, frames=3, method="runge_kutta"), TOO_FAST)
    assert bool(diffeed.simulate(scene, duration=0.01, dt=1e-4, frames=3).ok)


def test_rollers_that_are_pressed_through_each_other_are_blamed_themselves():
    """A pinch of 500 N on a contact of 100 N/mm gives way by more than half its radius, far from a strip that lies on a floor."""
    rollers = {
        "drive": FixedRoller(center=(0.0, -500.0), radius=5.0, angular_speed=0.0),
        "pinch": MovableRoller(center=(0.0, -489.5), direction=(0.0, 1.0), radius=5.0, mass=1.0, preload=500.0),
    }
    floor = LineGuide(start=(-50.0, 0.0), end=(50.0, 0.0))
    scene = machine(strip(lead=(10.0, 0.249)), Contact(stiffness=100.0), rollers=rollers, guides={"floor": floor})
    run = diffeed.simulate(scene, duration=0.2, dt=1e-4, frames=5)
    failed(run, TOO_DEEP)
    assert run.failure.parts[int(run.failure.part)] in ("rollers.drive", "rollers.pinch")


@pytest.mark.parametrize("clamps", [{}, {"pin": Clamp(sheet="strip", at="lead", free="y")}])
def test_a_start_from_a_rest_that_was_not_found(clamps):
    """A strip in free fall has none: the state of `settle` says so to the run that begins with it."""
    scene = machine(strip(), clamps=clamps)
    run = diffeed.simulate(scene, duration=0.01, dt=1e-3, frames=3, initial=diffeed.settle(scene))
    assert run.failure.describe() == f"at 0 s: {CAUSES[NO_REST]}"


@pytest.mark.slow
def test_times_that_pass_each_other_in_a_batch():
    """Numbers that are traced are not refused: of three samples only the one whose stop comes before its start is impossible.
    Alike with chosen steps, for a drive and for a guide that moves."""

    def run(stop, **how):
        times = jnp.stack([jnp.asarray(0.0), jnp.asarray(0.004), stop])
        motion = Motion(times=times, displacement=((0.0, 0.0), (0.0, 0.0), (0.0, -1.0)), rotation=(0.0, 0.0, 0.0))
        far = {"floor": LineGuide(start=(-50.0, -40.0), end=(50.0, -40.0), motion=motion)}
        turning = diffeed.Profile(times=times, values=(0.0, 0.0, 30.0))
        drive = {"drive": FixedRoller(center=(0.0, 40.0), radius=5.0, angular_speed=turning)}
        scene = machine(strip(), gravity=(0.0, 0.0), **({"guides": far} if how else {"rollers": drive}))
        return diffeed.simulate(scene, duration=0.01, frames=3, **how)

    for how in ({}, {"tolerance": 1e-3, "most_steps": 200}):
        runs = jax.vmap(lambda stop, how=how: run(stop, **how))(jnp.array([0.008, 0.003, 0.02]))
        assert runs.ok.tolist() == [True, False, True]
        failed(jax.tree.map(lambda v: v[1], runs), OUT_OF_ORDER)
        assert float(runs.failure.time[1]) == 0.0
        assert int(runs.failure.part[1]) == -1


@pytest.mark.slow
def test_what_was_observed_of_energy_from_nowhere_is_taken_back():
    """Of the block of steps that is not believed: all is as in a run that ends where that block began."""

    def run(duration: float, frames: int) -> diffeed.Trajectory:
        seen = ("feed", "energy")
        return diffeed.simulate(
            bouncing(3e4, speed=50.0), duration=duration, dt=2e-5, frames=frames, method="runge_kutta", observe=seen
        )

    whole = run(0.02, 3)
    failed(whole, FROM_NOWHERE)
    end = float(whole.final.state.time)
    assert 0.0 < end < float(whole.failure.time)
    shorter = run(end, 2)
    assert bool(shorter.ok)
    assert float(whole.final.open["feed"].fed[0]) > 0.01
    ours, theirs = ((r.final.state, r.final.open, r.final.error, r.final.half) for r in (whole, shorter))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12), ours, theirs)


@pytest.mark.filterwarnings("ignore::diffeed.SinglePrecision")
def test_single_precision_loses_short_steps():
    """300 mm/s in 1e-9 s are 3e-7 mm: at 200 mm a float32 does not notice."""
    with jax.enable_x64(False):
        sheet = strip(lead=(200.0, 0.0), speed=300.0)
        scene = normalise(Scene(sheets={"strip": sheet}, initial="given", gravity=(0.0, 0.0)))
        failed(diffeed.simulate(scene, duration=1e-7, dt=1e-9, frames=3), FROZEN)
        assert bool(diffeed.simulate(scene, duration=1e-4, dt=1e-6, frames=3).ok)


@pytest.mark.parametrize(
    "guide",
    [
        LineGuide(start=(5.0, -30.0), end=(5.0, 30.0)),
        ArcGuide(center=(-15.0, 0.0), radius=20.0, start_angle=-30.0, sweep=60.0),
    ],
)
def test_a_bar_across_a_guide_at_the_start(guide):
    """Its ends 5 mm and more to both sides feel nothing."""
    run = diffeed.simulate(machine(strip(lead=(10.0, 0.0)), guides={"wall": guide}), duration=0.01, dt=1e-4, frames=3)
    failed(run, ACROSS, "guides.wall")
    assert float(run.failure.time) == 0.0
    (problem,) = diffeed.check(machine(strip(lead=(10.0, 0.0)), guides={"wall": guide}))
    assert problem.startswith("guides.wall: a bar lies across it at the start")


UPWARDS = {
    "line": LineGuide(start=(5.0, 1.5), end=(60.0, 1.5)),
    "arc": ArcGuide(center=(5.0, 61.5), radius=60.0, start_angle=-90.0, sweep=40.0),
}
TURNED = {
    "line": replace(UPWARDS["line"], start=(60.0, 1.5), end=(5.0, 1.5)),
    "arc": replace(UPWARDS["arc"], side="outside"),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", UPWARDS)
def test_a_sheet_that_comes_behind_a_guide_past_its_end(kind):
    """It slides under the guide's rounded end without touching it, into where the guide would throw it out."""

    def sent(guide, **more):
        sheet = strip(velocity=(500.0, 0.0), bars=4, **more)
        scene = machine(sheet, guides={"roof": guide}, gravity=(0.0, 0.0))
        return scene, diffeed.simulate(scene, duration=0.02, dt=1e-4, frames=11)

    failed(sent(UPWARDS[kind])[1], BEHIND, "guides.roof")
    assert bool(sent(TURNED[kind])[1].ok), "turned about it bears the sheet"
    assert bool(sent(replace(UPWARDS[kind], depth=1.0))[1].ok), "further behind than its depth a sheet is not felt"
    scene, run = sent(UPWARDS[kind], lead=(9.0, 0.0))
    failed(run, BEHIND, "guides.roof")
    assert float(run.failure.time) == 0.0
    assert any(p.startswith("guides.roof: a bar lies behind its face at the start") for p in diffeed.check(scene))


@pytest.mark.long
def test_a_sheet_over_the_edge_of_a_table_is_not_behind_it():
    """Most of it beyond the edge: it tips over and slides down around the rounded end."""
    table = LineGuide(start=(-100.0, 0.0), end=(0.0, 0.0))
    sheet = strip(lead=(70.0, 0.26), length=80.0, bars=16, youngs_modulus=30.0)
    run = diffeed.simulate(machine(sheet, guides={"table": table}), duration=0.15, dt=1e-4, frames=16)
    assert bool(run.ok), run.failure.describe()
    assert float(run.sheets["strip"].nodes[-1, :, 1].max()) < 0.0


def test_a_long_bar_that_enters_an_arc_is_not_across_it():
    """Its front is on the arc, its rear far outside the arc's circle, which it meets 2.5 mm before the arc begins."""
    turn = ArcGuide(center=(0.0, 14.75), radius=15.0, start_angle=-90.0, sweep=40.0)
    floor = LineGuide(start=(-80.0, -0.25), end=(0.0, -0.25))
    assert not diffeed.check(machine(strip(lead=(1.0, 0.0)), guides={"floor": floor, "turn": turn}))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_crossing_is_what_plain_geometry_says(seed):
    """Random bars against a line and arcs of both sides; some cross, some do not."""
    rng = np.random.default_rng(seed)
    guides = {
        "line": LineGuide(start=rng.uniform(-10.0, 10.0, 2), end=rng.uniform(-10.0, 10.0, 2), depth=1.0),
        "inside": ArcGuide(center=rng.uniform(-9.0, 9.0, 2), radius=8.0, start_angle=30.0, sweep=-200.0, depth=1.0),
        "outside": ArcGuide(
            center=rng.uniform(-9.0, 9.0, 2), radius=7.0, start_angle=-70.0, sweep=120.0, side="outside", depth=1.0
        ),
    }
    draws = [
        machine(strip(lead=rng.uniform(-10.0, 10.0, 2), headings=rng.uniform(0.0, 360.0, 2)), guides=guides)
        for _ in range(200)
    ]

    def crossed(scene):
        model = build(scene)
        return misplaced(model, initial_state(model, scene)).across

    found = np.asarray(jax.jit(jax.vmap(crossed))(diffeed.stack(draws)))
    names = build(draws[0]).guides.names
    expected = np.zeros_like(found)
    for i, scene in enumerate(draws):
        nodes = np.asarray(diffeed.simulate(scene, duration=1e-9, dt=1e-9, frames=2).sheets["strip"].nodes[:1])
        for k, name in enumerate(names):
            guide = replace(scene.guides[name], depth=0.75)
            expected[i, k] = bool(across(name, guide, nodes))
    assert (found == expected).all()
    assert 0.05 < found.mean() < 0.95


def test_each_sample_of_a_batch_by_itself():
    """One flies, one arrives too fast, one starts with a nonsensical modulus: each has its own end."""
    good, fast, odd = thrown(100.0), thrown(20e3), diffeed.put(thrown(100.0), "sheets.strip.youngs_modulus", np.nan)
    runs = jax.vmap(lambda s: diffeed.simulate(s, duration=0.01, dt=1e-4, frames=5))(diffeed.stack([good, fast, odd]))
    assert np.asarray(runs.ok).tolist() == [True, False, False]
    assert np.asarray(runs.failure.cause).tolist() == [0, UNRESOLVED, NOT_FINITE]
    assert np.isinf(runs.failure.time[0])
    assert float(runs.failure.time[2]) == pytest.approx(float(runs.dt[2]))
    alone = diffeed.simulate(good, duration=0.01, dt=1e-4, frames=5)
    np.testing.assert_array_equal(runs.sheets["strip"].nodes[0], alone.sheets["strip"].nodes)


@pytest.mark.long
def test_what_the_checks_find_has_no_derivative():
    """Nothing of them is carried through a gradient, which would pay for it."""

    def told(speed):
        scene = diffeed.put(thrown(1.0), "sheets.strip.velocity", jnp.stack([jnp.zeros(()), -speed]))
        return diffeed.simulate(scene, duration=0.15, dt=1e-4, frames=2).error

    # Half a step at the speed that the hit takes away: about half as much again at half as much speed more.
    assert float(told(180.0)) > 1.3 * float(told(120.0)) > 0.0
    assert float(jax.grad(told)(120.0)) == 0.0


def test_a_run_goes_on_with_its_book():
    """Stopped and gone on, the energy so far counts on."""
    whole = diffeed.simulate(bouncing(3e4), duration=0.02, dt=2e-5, frames=3, method="runge_kutta")
    first = diffeed.simulate(bouncing(3e4), duration=0.01, dt=2e-5, frames=2, method="runge_kutta")
    second = diffeed.simulate(
        bouncing(3e4), duration=0.01, dt=2e-5, frames=2, method="runge_kutta", initial=first.final
    )
    assert float(second.failure.time) == float(whole.failure.time)


@pytest.mark.long
@pytest.mark.parametrize("method", IMPLICIT)
def test_a_guide_that_strikes_puts_energy_in(method):
    """A post that comes at 2 m/s hits a sheet at rest within one step, in which no work is seen: no fault. Damped, lest it lose a
    rebound."""
    motion = Motion(times=[0.0, 1.0], displacement=[(0.0, 0.0), (0.0, 2000.0)], rotation=[0.0, 0.0])
    post = CircleGuide(center=(-10.0, -6.0), radius=5.0, motion=motion)
    contact = Contact(stiffness=300.0, damping=3.0)
    scene = machine(strip(), contact, guides={"post": post}, gravity=(0.0, 0.0))
    run = diffeed.simulate(scene, duration=0.004, dt=1e-4, frames=3, method=method)
    assert bool(run.ok), run.failure.describe()
    assert float(run.states.vy[-1, 0]) > 500.0


@pytest.mark.slow
def test_a_driven_roller_puts_energy_in():
    """A sheet that a roller sets going gains energy from the shaft, not from nowhere."""
    rollers = {
        "lower": FixedRoller(center=(-10.0, -10.24), radius=10.0, surface_speed=-2000.0),
        "upper": FixedRoller(center=(-10.0, 10.24), radius=10.0, surface_speed=2000.0),
    }
    for method in METHODS:
        run = diffeed.simulate(
            machine(strip(), rollers=rollers, gravity=(0.0, 0.0)), duration=0.004, dt=1e-5, frames=3, method=method
        )
        assert bool(run.ok), run.failure.describe()
        assert float(run.states.vx[-1, 0]) > 1000.0


@pytest.mark.parametrize("sweep", [359.0, 360.0])
def test_a_bar_across_a_drum_is_seen_whether_or_not_the_drum_has_ends(sweep):
    drum = ArcGuide(center=(0.0, 0.0), radius=15.0, start_angle=-89.0, sweep=sweep, side="outside")
    scene = machine(
        strip(lead=(0.0, 22.0), heading=90.0, length=60.0, bars=6), guides={"drum": drum}, gravity=(0.0, 0.0)
    )
    assert any(p.startswith("guides.drum: a bar lies across it at the start") for p in diffeed.check(scene))
    failed(diffeed.simulate(scene, duration=0.01, dt=1e-3, frames=3), ACROSS, "guides.drum")
    beside = replace(scene, sheets={"strip": replace(scene.sheets["strip"], lead=jnp.array([20.0, 22.0]))})
    assert diffeed.check(beside) == []


def struck(speed, damping=0.0, lead=-0.4):
    """A strip that flies flat at a table, and is thrown back within 7e-5 s or not at all."""
    contact = Contact(stiffness=3000.0, damping=damping, smoothing=1e-4, friction_law="none")
    table = LineGuide(start=(-50.0, -2.0), end=(20.0, -2.0))
    return machine(
        strip(velocity=(0.0, -speed), lead=(0.0, lead)), contact, guides={"table": table}, gravity=(0.0, 0.0)
    )


@pytest.mark.parametrize("method", IMPLICIT)
def test_a_rebound_that_the_steps_take_away(method):
    """400 mm/s, of which steps of four times the hit leave nothing: in 20 ms that is 8 mm."""
    run = diffeed.simulate(struck(400.0), duration=0.01, dt=5e-4, frames=3, method=method)
    failed(run, LOST_REBOUND, "guides.table")


@pytest.mark.parametrize(
    ("speed", "damping", "stepping", "comes_back"),
    [
        (400.0, 0.0, {"dt": 1e-6}, True),
        (400.0, 0.0, {"dt": 2e-6, "method": "runge_kutta"}, True),
        (200.0, 0.0, {"tolerance": 1e-3, "dt": 5e-4}, True),
        (400.0, 50.0, {"dt": 5e-4}, False),
        (80.0, 0.0, {"dt": 5e-4}, False),
    ],
)
def test_a_rebound_that_is_resolved_or_damped_or_small_is_no_fault(speed, damping, stepping, comes_back):
    run = diffeed.simulate(struck(speed, damping), duration=4.0 / speed, frames=3, **stepping)
    assert bool(run.ok), run.failure.describe()
    assert (float(run.states.vy[-1, 0]) > 0.65 * speed) == comes_back


@pytest.mark.long
@pytest.mark.parametrize("stepping", [{"dt": 5e-4}, {"tolerance": 1e-2, "dt": 5e-4}])
def test_rebounds_add_up_where_a_run_goes_on(stepping):
    """Two hits of 80 mm/s, 17 ms apart: each alone is too little to be told."""
    scene = struck(80.0)
    first = diffeed.simulate(scene, duration=0.018, frames=3, **stepping)
    assert bool(first.ok), first.failure.describe()
    anew = replace(initial_state(build(scene), scene), time=first.final.state.time)
    again = diffeed.simulate(scene, duration=0.018, frames=3, initial=anew, **stepping)
    assert bool(again.ok), again.failure.describe()
    both = diffeed.simulate(scene, duration=0.018, frames=3, initial=replace(first.final, state=anew), **stepping)
    failed(both, LOST_REBOUND, "guides.table")


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_no_step_by_a_tolerance_passes_the_surface_it_hits(tolerance):
    """Nothing touches where such a step begins, nor in its middle: both ways through it are alike, and go too deep. Wherever in a
    step the surface is."""
    batch = diffeed.stack([struck(80.0, lead=-0.4 - 0.02 * k) for k in range(8)])
    run = jax.vmap(lambda s: diffeed.simulate(s, duration=0.03, tolerance=tolerance, frames=3))(batch)
    assert run.ok.all(), np.asarray(run.failure.cause)
    back = np.asarray(run.states.vy[:, -1, 0])
    assert back.min() > -1.0
    assert back.max() < 81.0


def test_lost_rebounds_are_of_each_sample_alone():
    batch = diffeed.stack([struck(speed) for speed in (50.0, 400.0, 80.0)])
    run = jax.vmap(lambda scene: diffeed.simulate(scene, duration=0.01, dt=5e-4, frames=3))(batch)
    assert np.asarray(run.failure.cause).tolist() == [0, LOST_REBOUND, 0]
