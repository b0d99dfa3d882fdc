"""Contact taken to its ends: no friction and glue, no gap and a deep start, 5 m/s into a wall, normals that are not defined.

One short sheet between two rollers, a floor (or wall) and a post, all rows in one batch per method (`cases.extremes`).
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import extremes as ex
from cases.extremes import EXPLICIT, METHODS, Run

import diffeed
from diffeed import ArcGuide, CircleGuide, Contact, FixedRoller, LineGuide, Scene, Sheet
from diffeed.base.records import replace
from diffeed.chain.state import initial_state
from diffeed.faults.causes import ACROSS, FROM_NOWHERE, LEAPT, TOO_DEEP, TOO_FAST, TURNED_ABOUT, UNRESOLVED
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.pair.law import contact_law
from diffeed.readings.snapshot import look, snapshot

FIRST_ORDER = "linear_euler"
IMPLICIT = tuple(m for m in METHODS if m != EXPLICIT)
DAMPING = tuple(m for m in IMPLICIT if m != "midpoint")
"""Methods that damp what their step does not resolve."""
EACH = ex.by_method(FIRST_ORDER)


def mass(run: Run) -> float:
    """kg."""
    return ex.BARS * ex.bar_mass(run.scene.sheets["paper"])


def middle(values: np.ndarray) -> np.ndarray:
    """(frames, bars + 1, 2) of nodes -> (frames, 2) of the mass centre."""
    return 0.5 * (values[:, 1:] + values[:, :-1]).mean(axis=1)


REFUSED = {EXPLICIT: ("friction 5", "friction 50", "friction 1000", "fast, 1e-3", "fast, 1e-4")}
"""Rows whose step `check` refuses, or that fail."""


@pytest.mark.long
@EACH
def test_every_run_has_a_finite_gradient(method):
    for name, run in ex.contacts(method).items():
        assert np.isfinite(run.sheet.nodes).all(), name
        if run.ok and name not in REFUSED.get(method, ()):
            assert ex.is_finite(run.slopes), name


@EACH
@pytest.mark.parametrize("name", ["tissue on a floor", "film on a floor", "card on a floor"])
def test_a_sheet_on_a_floor_weighs_what_it_weighs(name, method):
    """From 20 um of tissue to 0.8 mm of card on the same contact."""
    run = ex.contacts(method)[name]
    assert run.ok, run.why
    weight = 9.81 * mass(run)  # mN from kg: N are kg m/s2
    assert run.sheet.force[-1].sum() == pytest.approx(weight, rel=1e-3)
    assert run.guides["floor"].force[-1] == pytest.approx(weight, rel=1e-3)
    assert (run.sheet.force >= 0.0).all()


@EACH
def test_forces_of_two_floors_in_one_place_add(method):
    """As one floor of twice the stiffness and damping; each carries half."""
    two, one = (ex.contacts(method)[name] for name in ("two floors", "one floor twice"))
    assert two.ok, two.why
    assert one.ok, one.why
    np.testing.assert_allclose(two.sheet.nodes, one.sheet.nodes, atol=1e-12)
    np.testing.assert_allclose(two.sheet.force, one.sheet.force, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(two.guides["floor"].force, two.guides["other"].force, rtol=1e-9)


# --- friction ---------------------------------------------------------------------------------------------------------


@EACH
def test_without_friction_nothing_is_driven(method):
    """The sheet stays where it is to the last digit, and neither roller's speed has any influence."""
    run = ex.contacts(method)["no friction"]
    assert run.ok, run.why
    assert diffeed.check(run.scene, dt=run.dt, method=method) == []
    assert run.rollers["lower"].force[-1] > 1.0
    assert (run.sheet.nodes[:, :, 0] == run.sheet.nodes[0, :, 0]).all()
    assert (run.sheet.velocities[:, :, 0] == 0.0).all()
    for name in ("lower", "upper"):
        assert float(run.slopes.rollers[name].surface_speed) == 0.0
    assert float(run.slopes.rollers["lower"].friction) > 0.0  # but friction would have one


def slip(run: Run, mu: float) -> float:
    """mm/s: the linear ramp of friction under the pull, F v_s/(mu N) with N from both rollers."""
    force = run.rollers["lower"].force[-1] + run.rollers["upper"].force[-1]
    return (
        ex.PULL
        * float(run.scene.contacts["default"].stick_speed if "default" in run.scene.contacts else 3.0)
        / (mu * force)
    )


@ex.by_method(FIRST_ORDER, of=DAMPING)
@pytest.mark.parametrize("mu", ex.GLUE)
def test_glue_feeds_with_the_slip_of_the_linear_ramp(mu, method):
    """The speed of sheet and roller becomes one within 1e-8 s or less, ten thousandths of a step."""
    run = ex.contacts(method)[f"friction {mu:g}"]
    assert run.ok, run.why
    speed = run.sheet.velocities[1:, 0, 0]
    np.testing.assert_allclose(speed - ex.SPEED, np.full(speed.shape, slip(run, mu)), rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("mu", ex.GLUE)
def test_glue_feeds_by_the_midpoint_rule_too(mu):
    """Which does not damp what it does not resolve: the speed rings about the roller's, so that it is the way that counts."""
    run = ex.contacts("midpoint")[f"friction {mu:g}"]
    assert run.ok, run.why
    way = run.sheet.nodes[-1, 0, 0] - run.sheet.nodes[0, 0, 0]
    assert way / run.time[-1] - ex.SPEED == pytest.approx(slip(run, mu), rel=0.01)
    assert (np.abs(run.sheet.velocities[:, 0, 0] - ex.SPEED) <= ex.SPEED * (1.0 + 1e-9)).all()


@EACH
def test_glue_at_resolved_steps(method):
    """5 ns: every method, the explicit one among them, sees speeds become one."""
    run = ex.contacts(method)["friction 5 resolved"]
    assert run.ok, run.why
    assert diffeed.check(run.scene, dt=run.dt, method=method) == []
    assert run.sheet.velocities[-1, 0, 0] - ex.SPEED == pytest.approx(slip(run, 5.0), rel=1e-3)


@pytest.mark.parametrize("mu", ex.GLUE)
def test_an_explicit_method_on_glue_is_refused(mu):
    row = ex.contact_rows()[f"friction {mu:g}"]
    (problem,) = diffeed.check(row.scene, dt=row.explicit_dt, method=EXPLICIT)
    assert "friction below the stick speed" in problem
    assert "linear_euler takes larger steps" in problem
    assert diffeed.check(row.scene, dt=row.dt, method=FIRST_ORDER) == []


@pytest.mark.slow
@pytest.mark.parametrize("mu", ex.GLUE)
def test_an_explicit_run_on_glue_that_nobody_checked_fails(mu):
    """It would feed the sheet at 76 mm/s instead of 100, as long as rounding keeps it in the middle of the nip."""
    run = ex.contacts(EXPLICIT)[f"friction {mu:g}"]
    assert run.cause == TURNED_ABOUT, run.why


# --- first touch ------------------------------------------------------------------------------------------------------


@EACH
@pytest.mark.parametrize("name", ["lifted", "touching, 0.5", "touching, 0"])
def test_an_open_nip_does_nothing(name, method):
    """Half a millimetre off, or touching but for a hair: powers 1.5, 0.5 and 0 of nothing, without a rounded ramp."""
    run = ex.contacts(method)[name]
    assert run.ok, run.why
    gap = run.rollers["upper"].gap
    np.testing.assert_allclose(gap, np.full(gap.shape, 0.5 if name == "lifted" else ex.HAIR), atol=1e-14)
    assert (run.rollers["upper"].force == 0.0).all()
    assert (run.sheet.push == 0.0).all()
    assert (run.sheet.nodes == run.sheet.nodes[0]).all()
    assert ex.is_finite(run.slopes)
    assert float(run.slopes.rollers["upper"].surface_speed) == 0.0


@pytest.mark.parametrize(("exponent", "damping_exponent"), [(1.5, 0.5), (1.5, 0.0), (1.5, 1.5), (1.0, 0.0), (1.0, 0.5)])
@pytest.mark.parametrize("speed", [-100.0, 0.0, 100.0])
def test_the_law_at_exactly_no_depth(exponent, damping_exponent, speed):
    """No force, and finite derivatives by everything, the exponents too: 0 to the power of 0 with them."""
    contact = Contact(**ex.BARE | {"exponent": exponent, "damping_exponent": damping_exponent})
    scene = normalise(
        Scene(sheets=ex.contact_rows()["lifted"].scene.sheets, rollers=ex.contact_rows()["lifted"].scene.rollers)
    )

    def force(contact: Contact, depth: jax.Array, leaving: jax.Array) -> jax.Array:
        surface = jax.tree.map(lambda v: v[:1], build(replace(scene, contacts={"default": contact})).surface)
        return contact_law(surface, depth[None], leaving[None], jnp.ones(1), 1.0).force[0]

    contact = normalise(Scene(contacts={"default": contact})).contacts["default"]
    at = (contact, jnp.zeros(()), jnp.asarray(speed))
    assert float(force(*at)) == 0.0
    assert ex.is_finite(jax.grad(force, argnums=(0, 1, 2))(*at))


def test_damping_from_the_first_touch_on_jumps_and_never_pulls():
    """Exponents 1 and 0, Kelvin-Voigt: the force jumps to damping times speed, is zero before it would pull, and has finite
    slopes on both sides of the jump and in it."""
    scene = normalise(ex.contact_rows()["dropped"].scene)
    one = jax.tree.map(lambda v: v[:1], build(scene).surface)

    def force(depth: jax.Array, leaving: jax.Array) -> jax.Array:
        return contact_law(one, depth[None], leaving[None], jnp.zeros(1), 1.0).force[0]

    damping = 1e3 * float(scene.contacts["default"].damping)
    assert float(force(jnp.asarray(-1e-12), jnp.asarray(-100.0))) == 0.0
    assert float(force(jnp.asarray(1e-12), jnp.asarray(-100.0))) == pytest.approx(100.0 * damping, rel=1e-6)
    assert float(force(jnp.asarray(1e-3), jnp.asarray(1e4))) == 0.0
    for depth in (-1e-3, 0.0, 1e-12, 1e-3):
        for leaving in (-100.0, 0.0, 100.0):
            slopes = jax.grad(force, argnums=(0, 1))(jnp.asarray(depth), jnp.asarray(leaving))
            assert np.isfinite(np.asarray(slopes)).all()


@EACH
def test_a_drop_on_such_a_floor(method):
    """It comes back slower than it went, and is never held."""
    run = ex.contacts(method)["dropped"]
    assert run.ok, run.why
    assert run.guides["floor"].force.max() > 0.0
    assert (run.sheet.force >= 0.0).all()
    assert 0.0 < middle(run.sheet.velocities)[-1, 1] < 100.0


# --- a deep start -----------------------------------------------------------------------------------------------------


def test_a_deep_start_is_named():
    (problem,) = diffeed.check(ex.contact_rows()["deep"].scene)
    assert "guides.floor: sheet paper starts 1 mm deep in it" in problem
    assert f"half the thickness, {0.5 * ex.THICK:g} mm" in problem


@EACH
def test_a_deep_start_gives_back_what_its_springs_hold_and_no_more(method):
    """1 mm, sixteen times half the thickness: every node is pushed out on the side where it is. The mass centre is never
    faster than all the energy of the springs could make it; steps that resolve the way out come near that."""
    runs = ex.contacts(method)
    assert runs["deep"].ok or runs["deep"].cause in (LEAPT, FROM_NOWHERE, TOO_FAST)
    run = runs["deep resolved"]
    springs = (ex.BARS + 1) * 1e3 * ex.HARD["stiffness"] * ex.DEEP**2.5 / 2.5
    most = (2.0 * springs / mass(run)) ** 0.5
    for each in (runs["deep"], run):
        rise = middle(each.sheet.velocities)[:, 1]
        assert (rise >= 0.0).all()
        assert (rise <= most).all()
        assert (np.diff(middle(each.sheet.nodes)[:, 1]) >= 0.0).all()
    assert run.ok, run.why
    assert middle(run.sheet.velocities)[-1, 1] > 0.9 * most
    assert run.guides["floor"].gap[-1] > 0.0


# --- fast -------------------------------------------------------------------------------------------------------------


@EACH
@pytest.mark.parametrize("step", ["1e-3", "1e-4", "1e-5", "1e-6"])
def test_at_5_metres_per_second_no_sheet_goes_through_a_wall(step, method):
    """0.5 mm, four times the thickness, in a step of 0.1 ms: in front of the wall in every frame, never faster than it came,
    or failed for a cause that asks for shorter steps. At 1 ms no method can."""
    run = ex.contacts(method)[f"fast, {step}"]
    if step == "1e-3":
        assert not run.ok
    if step == "1e-6":
        assert run.ok, run.why
        assert abs(run.sheet.velocities[-1, 0, 0]) < 0.05 * ex.FAST
    if not run.ok:
        assert run.cause in (UNRESOLVED, LEAPT, TOO_DEEP, TOO_FAST, FROM_NOWHERE, ACROSS), run.why
        return
    assert run.sheet.nodes[:, :, 0].max() < ex.WALL + ex.THICK
    energy = np.sum(middle(run.sheet.velocities) ** 2, axis=1)
    assert (energy <= ex.FAST**2 * (1.0 + 1e-9)).all()


# --- places without a direction ------------------------------------------------------------------------------------------


@EACH
@pytest.mark.parametrize("name", ["post on the axis", "post on the lead", "post on a joint"])
def test_a_centre_on_the_axis_has_a_force_and_a_gradient(name, method):
    """No direction is the right one: it pushes to some side, with the force of its depth, and everything stays finite."""
    run = ex.contacts(method)[name]
    assert run.ok, run.why
    assert run.guides["post"].gap[0] == pytest.approx(-(0.2 + 0.5 * ex.THICK))
    depth = 0.2 + 0.5 * ex.THICK - 0.5 * float(Contact().smoothing)
    assert run.guides["post"].force[0] == pytest.approx(ex.SOFT["stiffness"] * depth, rel=1e-9)  # once, at a joint too
    assert run.guides["post"].gap[-1] > run.guides["post"].gap[0]
    assert ex.is_finite(run.slopes)


@pytest.mark.parametrize("bars", [4, 5, 8])
def test_a_roller_over_a_joint_presses_once(bars):
    """Exactly over it, where the foot lies on both bars and on neither: a straight sheet feels what it feels elsewhere."""

    @jax.jit
    @jax.vmap
    def pressed(x: jax.Array) -> jax.Array:
        y = ex.RADIUS + 0.5 * ex.THICK - ex.BITE
        sheet = Sheet(length=40.0, thickness=ex.THICK, width=30.0, density=8e-7, youngs_modulus=3000.0, bars=bars)
        roller = FixedRoller(center=jnp.stack([x, jnp.asarray(y)]), radius=ex.RADIUS)
        scene = normalise(Scene(sheets={"paper": sheet}, rollers={"roller": roller}, initial="given"))
        model = build(scene)
        return snapshot(model, initial_state(model, scene))[1]["roller"].force

    joints = -40.0 / bars * np.arange(1, bars)
    found = np.asarray(pressed(jnp.asarray(np.concatenate([joints, joints + 1e-9, joints - 1e-9, [-11.0]]))))
    assert found[-1] > 1.0
    np.testing.assert_allclose(found, np.full(found.shape, found[-1]), rtol=1e-9)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_shares_over_a_joint_add_up_to_one_whatever_rounding_makes_of_its_place(dtype):
    """Two bars that meet in a joint each find by themselves where it is: off by a last digit, a contact was lost or doubled."""
    rng = np.random.default_rng(1)
    bars, count, long = 10, 400, 100.0
    kink = 10.0 ** rng.uniform(-17, -1, count) * (np.arange(count) % 2)
    heading = kink[:, None] * rng.normal(size=(count, bars))
    steps = long / bars * np.stack([np.cos(heading), np.sin(heading)])
    node = -np.cumsum(steps, axis=2)[:, np.arange(count), rng.integers(0, bars - 1, count)]
    off = 10.0 ** rng.uniform(-18, -2, count) * rng.normal(size=count)
    turn = 0.5 * np.pi + kink * rng.normal(size=count)
    way = ex.RADIUS * np.stack([np.cos(turn), np.sin(turn)])

    @jax.jit
    @jax.vmap
    def total(heading: jax.Array, place: jax.Array) -> jax.Array:
        sheet = Sheet(
            length=long, thickness=ex.THICK, width=30.0, density=8e-7, youngs_modulus=3000.0, bars=bars,
            headings=jnp.rad2deg(heading),
        )  # fmt: skip
        post = CircleGuide(center=place, radius=ex.RADIUS)
        scene = normalise(Scene(sheets={"paper": sheet}, guides={"post": post}, initial="given"))
        model = build(scene)
        pairs = look(model, initial_state(model, scene))[2].sheets
        return jnp.sum(pairs.weight)

    # A place is off by some last digits of 100 mm, 1e-13 and 6e-5 mm; the steepest slope of a share is 1.5 over the hand-over.
    allowed = {"float64": 2.0 * 1.5 * 1e-13 / 1e-6, "float32": 2.0 * 1.5 * 6e-5 / 1e-2}[dtype]
    for side in (1.0, -1.0):
        with jax.enable_x64(dtype == "float64"):
            found = total(jnp.asarray(heading), jnp.asarray((node + off + side * way).T))
        assert found.dtype == dtype
        np.testing.assert_allclose(found, 1.0, rtol=0.0, atol=allowed)


# --- ends of guides ---------------------------------------------------------------------------------------------------

PRESS = 0.02
"""mm."""


def _end_scene(lead: jax.Array, shape: str, tip: jax.Array) -> Scene:
    """A sheet of two bars pressed against the face of a guide that ends at the origin."""
    sheet = Sheet(length=20.0, thickness=ex.THICK, width=30.0, density=8e-7, youngs_modulus=3000.0, bars=2, lead=lead)
    line = LineGuide(start=(-100.0, 0.0), end=(0.0, 0.0), tip_radius=tip)
    arc = ArcGuide(center=(0.0, -80.0), radius=80.0, start_angle=90.0, sweep=60.0, side="outside", tip_radius=tip)
    more = {"more": LineGuide(start=(0.0, 0.0), end=(50.0, -10.0), tip_radius=tip)} if shape == "joined" else {}
    return Scene(sheets={"paper": sheet}, guides={"guide": arc if shape == "arc" else line} | more, initial="given")


@pytest.mark.parametrize("shape", ["line", "arc", "joined"])
def test_force_does_not_jump_as_a_bar_passes_the_end_of_a_guide(shape):
    """Ten times finer steps of the way change the force by a fifth at most, where a jump would stay: lead, joint and tail
    each pass the end, where the face becomes a tip, round or sharp, that bars roll on."""

    @jax.jit
    @jax.vmap
    def push(x: jax.Array, tip: jax.Array) -> tuple[jax.Array, jax.Array]:
        def total(x: jax.Array) -> tuple[jax.Array, jax.Array]:
            scene = normalise(_end_scene(jnp.stack([x, jnp.asarray(0.5 * ex.THICK - PRESS)]), shape, tip))
            model = build(scene)
            force = jnp.sum(snapshot(model, initial_state(model, scene))[0]["paper"].push, axis=0)
            return jnp.sum(force), force

        slope, force = jax.grad(total, has_aux=True)(x)
        return force, slope

    way = np.stack([node + np.arange(-0.6, 0.6, 1e-4) for node in (0.0, 10.0, 20.0)])
    for tip in (0.0, 0.5):
        force, slope = jax.device_get(push(jnp.asarray(way.ravel()), jnp.full(way.size, tip)))
        assert np.isfinite(force).all()
        assert np.isfinite(slope).all()
        force = force.reshape(*way.shape, 2)
        coarse, fine = (float(np.abs(np.diff(force[:, ::every], axis=1)).max()) for every in (10, 1))
        assert 0.0 < fine < 0.2 * coarse
