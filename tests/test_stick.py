"""Friction that sticks: a tangential deflection that holds at rest, slips at the limit, and belongs to the contact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stand_in_nip import nip

import diffeed
from diffeed import (
    CircleGuide,
    Clamp,
    Contact,
    FixedRoller,
    LineGuide,
    Load,
    Motion,
    Scene,
    Sheet,
    measures,
)
from diffeed.base.records import replace
from diffeed.chain.state import initial_state
from diffeed.contact import stick
from diffeed.contact.candidates import search
from diffeed.contact.kept import keep_all
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.pair.law import BRISTLE_LAG, SLIDES, Grip, Surface, stick_deflection, stick_friction
from diffeed.steppers import linear_euler

G, FRICTION, REACH = 9810.0, 0.3, 2e-3
"""mm/s2; of the table; mm, the stick displacement."""
WEIGHT = 8e-7 * 40.0 * 0.1 * 210.0 * G
"""kg mm/s2."""
STUCK = Contact(friction_law="stick", stick_displacement=REACH)


def psi(z):
    """Friction over its limit at a deflection over the stick displacement."""
    z = np.clip(z, -1.5, 1.5)
    return z - 4.0 / 27.0 * z**3


def paper(**changes) -> Sheet:
    given = {"length": 40.0, "bars": 4, "thickness": 0.1, "width": 210.0, "density": 8e-7, "youngs_modulus": 3000.0}
    return Sheet(**(given | {"structural_damping": 1e-4} | changes))


def inclined(angle: float, contact: Contact = STUCK, initial: str = "given", **parts) -> Scene:
    """A sheet that lies on a table; gravity leans instead of the table."""
    lean = np.deg2rad(angle)
    return Scene(
        sheets={"a": paper()},
        guides={"table": LineGuide(start=(-300.0, -0.05), end=(300.0, -0.05), friction=FRICTION)},
        contacts={"default": contact},
        gravity=(G * np.sin(lean), -G * np.cos(lean)),
        initial=initial,
        **parts,
    )


def sticking(scene: Scene, **changes) -> Scene:
    """The scene with friction that sticks in all its contact sets."""
    sets = {name: replace(c, friction_law="stick", **changes) for name, c in normalise(scene).contacts.items()}
    return diffeed.scene(**(vars(scene) | {"contacts": sets}))


STEPS = 2000
"""Of nearly every run: one plan, so that scenes of one structure share a compiled program."""


def run_from(start: diffeed.State, scene: Scene, duration: float = 1.0, method: str = "linear_euler"):
    run = diffeed.simulate(scene, duration, duration / STEPS, 11, method, initial=start)
    assert run.ok, run.failure.describe()
    return run


def run_of(scene: Scene, duration: float = 1.0):
    scene = normalise(scene)
    return run_from(initial_state(build(scene), scene), scene, duration)


# --- the law ---------------------------------------------------------------------------------------------------------


def surface() -> Surface:
    """Of the table's face."""
    return jax.tree.map(lambda v: v[-1], build(normalise(inclined(0.0))).surface)


def test_the_law_has_the_shape_and_the_slopes_that_it_says():
    of = surface()
    z = jnp.linspace(-3.0, 3.0, 601)

    def share(z):
        return stick_friction(of, jnp.zeros_like(z), Grip(z, 0.0))[0] / FRICTION

    np.testing.assert_allclose(share(z), psi(np.asarray(z)), atol=1e-15)
    slope = np.asarray(jax.vmap(jax.grad(share))(z))
    assert slope[300] == pytest.approx(1.0)
    np.testing.assert_allclose(slope[np.abs(z) > SLIDES], 0.0, atol=1e-15)
    assert np.max(np.abs(np.diff(slope))) < 1.1 * 0.01 * 2.0 / SLIDES  # no corner where sliding begins
    some = np.linspace(-0.99, 0.99, 99)
    np.testing.assert_allclose(psi(np.asarray(stick_deflection(jnp.asarray(some)))), some, atol=1e-14)


def test_the_secant_leads_from_no_deflection_to_the_force():
    """The force is the secant times what the deflection will be, at the speed at which it was taken; a static ratio
    multiplies it by its function of the speed."""
    of = surface()
    v, start, ahead = jnp.asarray([-50.0, -1.0, 0.0, 2.0, 80.0]), jnp.asarray([1.5, 0.2, 0.0, -1.5, 0.7]), 2e-4
    held, secant = stick_friction(of, v, Grip(start, ahead))
    later = (ahead + BRISTLE_LAG) / REACH
    np.testing.assert_allclose(held, FRICTION * psi(np.asarray(start + later * v)), atol=1e-15)
    np.testing.assert_allclose(held, secant * (start / later + v), atol=1e-13)
    raised, _ = stick_friction(
        replace(of, static_excess=jnp.asarray(0.5), transition_speed=jnp.asarray(2.0)), v, Grip(start, ahead)
    )
    np.testing.assert_allclose(raised, held * (1.0 + 0.5 / (1.0 + (v / 2.0) ** 2)))


# --- an incline ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_below_the_friction_angle_it_stands_still_and_above_it_slides():
    """The friction angle is 16.7 degrees. What holds is a deflection; the regularised law creeps down instead."""
    for angle, most in ((5.0, 1.0), (10.0, 1.0), (16.0, 20.0)):  # near the limit it slips a little as it sinks in
        track = run_of(inclined(angle)).sheets["a"]
        assert np.max(np.abs(track.velocities[5:, :, 0])) < 1e-9  # rounding
        assert np.max(np.abs(track.nodes[-1] - track.nodes[0])) < most * REACH
    lean = np.deg2rad(20.0)
    speed = np.asarray(run_of(inclined(20.0)).sheets["a"].velocities[:6, 0, 0])
    # The secant lags by one step, as that of the regularised law does.
    np.testing.assert_allclose(np.diff(speed)[1:] / 0.1, G * (np.sin(lean) - FRICTION * np.cos(lean)), rtol=2e-2)

    share = np.tan(np.deg2rad(10.0)) / FRICTION
    creeping = run_of(inclined(10.0, Contact(stick_speed=3.0))).sheets["a"].velocities[5:, 0, 0]
    np.testing.assert_allclose(creeping, 3.0 * share / np.sqrt(1.0 - share**2), rtol=1e-6)


def test_a_settled_start_holds_what_settling_found():
    """The deflections carry the weight's share from the first step on: nothing jumps."""
    scene = inclined(12.0)
    share = np.tan(np.deg2rad(12.0)) / FRICTION
    state = diffeed.settle(scene)
    np.testing.assert_allclose(psi(np.asarray(state.grip)), [0.0, 0.0, *[-share] * 5], atol=1e-5)
    run = run_from(state, scene, 0.05)
    nodes = np.asarray(run.sheets["a"].nodes)
    assert np.max(np.abs(nodes - nodes[0])) < 1e-3 * REACH
    np.testing.assert_allclose(-run.guides["table"].friction, FRICTION * share * run.guides["table"].force, rtol=1e-4)


@pytest.mark.slow
def test_an_explicit_method_slides_as_far_and_stops():
    """Slopes of the deflections and a bound after each step, beside the implicit step, after a kick from rest."""
    scene = inclined(12.0)
    lean = np.deg2rad(12.0)
    start = replace(diffeed.settle(scene), vx=jnp.asarray([10.0]))
    explicit, implicit = (run_from(start, scene, 0.04, m).sheets["a"] for m in ("runge_kutta", "linear_euler"))
    way = [np.asarray(t.nodes[:, 0, 0] - t.nodes[0, 0, 0]) for t in (explicit, implicit)]
    assert way[0][-1] == pytest.approx(0.5 * 10.0**2 / (G * (FRICTION * np.cos(lean) - np.sin(lean))), rel=0.05)
    np.testing.assert_allclose(way[0], way[1], atol=REACH)
    assert np.max(np.abs(explicit.velocities[-1, :, 0])) < 2.0  # rings on, much slower than it slid


# --- to and fro ------------------------------------------------------------------------------------------------------


def pulled(places) -> tuple[np.ndarray, np.ndarray, float]:
    """A sheet on a level table, its lead moved along: its way over z_s, friction and what that took over mu N (z_s)."""
    displacement = np.stack([np.asarray(places) * REACH, np.zeros(len(places))], axis=1)
    motion = Motion(times=(0.0, 0.1, 0.3, 0.5), displacement=displacement, rotation=np.zeros(len(places)))
    puller = Clamp(sheet="a", at="lead", kind="pin", free="y", motion=motion)
    scene = inclined(0.0, initial="settled", clamps={"puller": puller})
    run = diffeed.simulate(scene, 0.5, 1.25e-4, 201, observe=("energy",))
    assert run.ok
    limit = FRICTION * WEIGHT / 1000.0
    taken = float(run.observed["energy"]["friction"]) / (limit * REACH)
    return np.asarray(run.sheets["a"].nodes[:, 0, 0]) / REACH, -np.asarray(run.guides["table"].friction) / limit, taken


@pytest.mark.long
def test_to_and_fro_is_a_loop_with_an_elastic_part():
    """Friction saturates at mu N, turns back along psi, and a cycle between -A and A takes 4 mu N (A - 1.5 z_s)."""
    far, n = 15.0, 40
    place, force, taken = pulled((0.0, far, -far, far))
    assert np.max(np.abs(force)) == pytest.approx(1.0, abs=1e-6)
    back = slice(n, 3 * n)
    np.testing.assert_allclose(force[back], psi(1.5 - (far - place[back])), atol=0.02)
    cycle = 4.0 * (far - 1.5)
    loop = slice(n, 5 * n + 1)
    assert np.trapezoid(force[loop], place[loop]) == pytest.approx(cycle, rel=5e-3)
    # The first way out stores 0.9375 in the deflection, which the account counts as taken; what came back it does not.
    assert taken == pytest.approx(cycle + far - 0.5625, rel=5e-3)


def test_small_movements_are_elastic():
    """Within the bound friction follows psi of the way, with slope mu N / z_s at zero, and takes nothing in the end."""
    place, force, taken = pulled((0.0, 1.0, -1.0, 0.0))
    np.testing.assert_allclose(force, psi(place), atol=1e-2)
    near = np.abs(place) < 0.2
    assert np.polyfit(place[near], force[near], 1)[0] == pytest.approx(1.0, rel=2e-2)
    assert abs(taken) < 0.02


# --- nips and mixtures -----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_nip_feeds_without_slip():
    """Once the shaft turns steadily nothing lasts, whether or not a load pulls: what is left is the deflection following
    the load, a spike where a joint passes. The regularised law creeps by 0.14 mm under this load. And no creep floor."""
    for pull in (0.0, -1.0):
        scene = sticking(nip(initial="settled", speed=-10.0))
        scene = replace(scene, loads={"brake": Load(sheet="strip", at="tail", force=(pull, 0.0))})
        run = diffeed.simulate(scene, duration=0.1, dt=2e-4, frames=11, observe=("nips",))
        assert run.ok
        drive = run.rollers["drive"]
        assert float(drive.force[-1]) > 2.9
        assert np.max(np.abs(drive.slip[5:])) < 1e-3
        assert np.median(np.abs(drive.slip[5:])) < 1e-5
        stats = run.observed["nips"]["drive"]
        assert abs(float(stats.slip_mean * stats.contact_time)) < REACH
        # It alone carries the brake, of 2.4 N that it could: the pinch turns freely.
        assert float(drive.friction[-1]) == pytest.approx(-pull, abs=0.02)
        assert float(measures.creep_floor(scene, run)["drive"]) == 0.0


@pytest.mark.long
def test_sets_of_both_laws_stand_side_by_side():
    """One table sticks, the other is regularised; a bridging post has nothing to hold."""
    lean = np.deg2rad(10.0)
    spots = {"a": (0.0, "stuck"), "b": (50.0, "loose")}
    scene = Scene(
        sheets={n: paper(lead=(0.0, y)) for n, (y, _) in spots.items()},
        guides={
            n: LineGuide(start=(-99.0, y - 0.05), end=(99.0, y - 0.05), friction=FRICTION, contact=kind)
            for n, (y, kind) in spots.items()
        },
        contacts={"stuck": STUCK, "loose": Contact()},
        gravity=(G * np.sin(lean), -G * np.cos(lean)),
        initial="given",
    )
    run = diffeed.simulate(scene, duration=0.2, dt=5e-4, frames=3)
    share = np.tan(lean) / FRICTION
    assert float(jnp.max(jnp.abs(run.sheets["a"].velocities[-1, :, 0]))) < 1e-6
    assert float(run.sheets["b"].velocities[-1, 0, 0]) == pytest.approx(3.0 * share / np.sqrt(1 - share**2), rel=1e-6)


def test_what_does_not_stick_is_not_there():
    """A scene without sticking sets keeps no deflections; guides alone keep none for circles; states fit either."""
    loose = build(normalise(inclined(0.0, Contact())))
    assert (loose.grips, loose.surface.stick, loose.surface.stick_displacement) == ((0, 0), None, None)
    free = initial_state(loose, normalise(inclined(0.0, Contact())))
    assert free.grip is None
    scene = inclined(0.0)
    post = CircleGuide(center=(0.0, 90.0), radius=5.0, contact="stuck")
    scene = replace(scene, guides={"table": scene.guides["table"], "post": post}, contacts={"stuck": STUCK})
    model = build(normalise(scene))
    assert model.grips == (3, 0)  # the post and the two tips of the table, which is regularised
    stuck = build(normalise(inclined(0.0)))
    assert stick.fitted(stuck, free).grip.shape == (2 + 5,)
    assert stick.fitted(loose, stick.fitted(stuck, free)).grip is None


@pytest.mark.parametrize("sheets", [("film",), pytest.param(("film", "other"), marks=pytest.mark.slow)])
def test_pruned_pairs_move_the_same_deflections(sheets):
    """The few bodies kept for each feature against all of them, on the film feeder with random deflections."""
    scene = sticking(diffeed.load_scene("film_feeder"))
    film = scene.sheets["film"]
    scene = replace(
        scene, sheets={n: replace(film, lead=film.lead + jnp.asarray([120.0 * k, 0.0])) for k, n in enumerate(sheets)}
    )

    @jax.jit
    def both(scene):
        model, h = build(scene), jnp.asarray(1e-4)
        state = initial_state(model, scene)
        grip = jax.random.uniform(jax.random.key(0), state.grip.shape, state.grip.dtype, -1.0, 1.0)
        wave = 0.15 * jnp.cos(0.3 * jnp.pi * jnp.arange(20.0 * len(sheets)))  # it reaches the guides above and below
        state = replace(state, grip=grip, travel=state.travel - 0.02, heading=wave)
        found = search(model, state, 16 * h).kept
        assert found.circle_index is not None
        return [linear_euler.step(model, state, h, kept)[0] for kept in (found, keep_all(model))]

    few, every = both(scene)
    for a, b in zip(jax.tree.leaves(few), jax.tree.leaves(every), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    assert np.sum(np.asarray(few.grip) != 0) > 4


@pytest.mark.long
def test_each_sheet_has_its_own_deflection_on_a_roller():
    """Two sheets on one roller, one above and held back, one below and pulled on."""
    sheets = {n: paper(lead=(20.0, y)) for n, y in (("a", 5.05), ("b", -5.05))}
    scene = Scene(
        sheets=sheets,
        rollers={"drum": FixedRoller(center=(0.0, 0.0), radius=5.0, friction=0.5, angular_speed=-4.0)},
        clamps={n: Clamp(sheet=n, at="tail", kind="bar", free="x") for n in sheets},
        loads={n: Load(sheet=n, at=2, force=(-0.2, s * -1.0)) for n, s in (("a", 1.0), ("b", -1.0))},
        contacts={"default": STUCK},
        gravity=(0.0, 0.0),
    )
    run = diffeed.simulate(scene, duration=0.1, dt=5e-4, frames=6)
    assert run.ok
    assert abs(float(run.rollers["drum"].slip[-1])) < 1e-2
    for name in sheets:
        assert float(jnp.sum(run.sheets[name].push[-1, :, 0])) == pytest.approx(0.2, rel=0.02)
    above, below = np.asarray(run.states.grip[-1])
    assert above > 0.2
    assert below < -0.2


def test_stick_counts_as_a_spring_in_small_motions():
    """Sliding along the table, the lowest mode: mu N psi'(z)/z_s over the mass."""
    scene = inclined(10.0)
    frequencies = diffeed.linearise(scene, diffeed.settle(scene)).modes()[0]
    share = np.tan(np.deg2rad(10.0)) / FRICTION
    slope = 1.0 - (float(stick_deflection(jnp.asarray(share))) / SLIDES) ** 2
    wanted = FRICTION * G * np.cos(np.deg2rad(10.0)) * slope / REACH
    assert frequencies[0] == pytest.approx(np.sqrt(wanted), rel=1e-3)


# --- gradients and batches -------------------------------------------------------------------------------------------


def slid(scene: Scene):
    """Where the lead ends that was set going, slipped and came to a stop."""
    return diffeed.simulate(scene, duration=0.06, dt=5e-4, frames=2).sheets["a"].nodes[-1, 0, 0]


@pytest.mark.slow
def test_gradients_and_batches():
    """Through slip and stop both modes and central differences agree; a batch is what each run is alone; and all numbers
    have finite derivatives, also before anything touches, and where it lies still."""
    scene = normalise(replace(inclined(8.0), sheets={"a": paper(speed=20.0)}))
    paths = {"guides.table.friction": 1e-7, "contacts.default.stick_displacement": 1e-9, "sheets.a.speed": 1e-5}

    def changed(values):
        new = scene
        for path, value in zip(paths, values, strict=True):
            new = diffeed.put(new, path, value)
        return new

    at = jnp.asarray([float(diffeed.get(scene, p)) for p in paths])
    forward = jax.jit(jax.jacfwd(lambda values: slid(changed(values))))(at)
    backward = jax.jit(jax.grad(slid))
    reverse = backward(scene)
    np.testing.assert_allclose(forward, [float(diffeed.get(reverse, p)) for p in paths], rtol=1e-9)
    assert float(forward[2]) > 0.0 > float(forward[0])

    steps = np.diag(list(paths.values()))
    still, above = (normalise(replace(inclined(0.0), sheets={"a": paper(lead=lead)})) for lead in ((0, 0), (0, 0.5)))
    several = [scene, *[changed(at + s * d) for d in steps for s in (1.0, -1.0)]]
    ends = np.asarray(jax.jit(jax.vmap(slid))(diffeed.stack(several)))
    assert ends[0] == pytest.approx(float(slid(scene)), abs=1e-12)
    np.testing.assert_allclose((ends[1::2] - ends[2::2]) / (2.0 * np.diag(steps)), forward, rtol=1e-4)
    for other in (still, above):
        assert all(np.all(np.isfinite(v)) for v in jax.tree.leaves(backward(other)))


@pytest.mark.slow
def test_a_run_goes_on_where_another_stopped():
    scene = inclined(16.0)
    whole = diffeed.simulate(scene, 0.04, 5e-4, 5, observe=("energy",))
    half = diffeed.simulate(scene, 0.02, 5e-4, 3, observe=("energy",))
    rest = diffeed.simulate(scene, 0.02, 5e-4, 3, initial=half.final, observe=("energy",))
    np.testing.assert_allclose(rest.states.grip[-1], whole.states.grip[-1], atol=1e-12)
    np.testing.assert_allclose(rest.sheets["a"].nodes[-1], whole.sheets["a"].nodes[-1], atol=1e-12)
    assert float(rest.observed["energy"]["friction"]) == pytest.approx(float(whole.observed["energy"]["friction"]))


def test_a_bad_stick_displacement_is_named():
    for value in (0.0, -1e-3):
        (problem,) = diffeed.check(inclined(0.0, replace(STUCK, stick_displacement=value)))
        assert "contacts.default.stick_displacement must be > 0 mm" in problem


@pytest.mark.slow
def test_the_film_feeder_sticks():
    """All sets stick: it settles and runs, within the creep of the regularised run and without a slip of its own."""
    shipped = diffeed.load_scene("film_feeder")
    lead = {}
    for name, scene in {"creeps": shipped, "sticks": sticking(shipped)}.items():
        run = diffeed.simulate(scene, duration=0.3, dt=2e-4, frames=4)
        assert run.ok, run.failure.describe()
        lead[name] = float(run.sheets["film"].nodes[-1, 0, 0])
        assert abs(float(run.rollers["drive_1"].slip[-1])) < {"creeps": 1e-2, "sticks": 5e-4}[name]
    assert lead["sticks"] == pytest.approx(lead["creeps"], abs=0.05)
