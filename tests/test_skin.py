"""The smooth skin: contact on the curve through the bars' middles, against exact geometry, balances and the bars' skin."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import ArcGuide, CircleGuide, FixedRoller, LineGuide, MovableRoller, Scene, Sheet
from diffeed.base.records import replace
from diffeed.chain import kinematics
from diffeed.chain.state import initial_state
from diffeed.contact import near
from diffeed.contact.candidates import capacities, search
from diffeed.contact.kept import keep_all
from diffeed.forces.contacts import Contacts, contacts, pair_terms
from diffeed.forces.rollers import border
from diffeed.forces.terms import Step
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.pair.law import NEWTON
from diffeed.readings.snapshot import contact_on_bars, look, on_rollers

PAPER = {"thickness": 0.1, "width": 50.0, "density": 1e-6, "youngs_modulus": 2000.0}
RADIUS, BAR = 6.0, 5.0


def bent(bars: int = 8, turn: float = 0.0, skin: str = "smooth", **more) -> Scene:
    """A sheet whose headings fall evenly by `turn` degrees from lead to tail, and a roller."""
    sheet = Sheet(length=BAR * bars, bars=bars, headings=tuple(np.linspace(0.5, -0.5, bars) * turn), **PAPER)
    rollers = {"r": FixedRoller(center=(0.0, 0.0), radius=RADIUS, angular_speed=0.0)}
    return normalise(
        Scene(sheets={"a": sheet}, rollers=rollers, gravity=(0.0, 0.0), initial="given", skin=skin, **more)
    )


def force(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    """N, normal force of the roller at (x, y) on the sheet as it stands."""
    scene = diffeed.put(scene, "rollers.r.center", jnp.stack([x, y]))
    model = build(scene)
    state = initial_state(model, scene)
    return on_rollers(model, look(model, state)[2], keep_all(model)).force[0]


def forces(scene: Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(jax.vmap(functools.partial(force, scene)))(jnp.asarray(x), jnp.asarray(y)))


def along_arc(scene: Scene, side: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres of a circle that rolls along the arc through the bars' middles, 20 um deep, on its inside (-1) or outside."""
    model = build(scene)
    at = look(model, initial_state(model, scene))[0]
    middles = np.stack([np.asarray(at.x), np.asarray(at.y)], axis=1)
    solved = np.linalg.lstsq(np.c_[2.0 * middles, np.ones(len(middles))], (middles**2).sum(axis=1), rcond=None)[0]
    centre = solved[:2]
    distance = np.sqrt(solved[2] + centre @ centre) + side * (RADIUS + 0.05 - 0.02)
    first, last = (np.arctan2(*(middles[k] - centre)[::-1]) for k in (1, -2))
    angle = np.linspace(first, last, count)
    return centre[0] + distance * np.cos(angle), centre[1] + distance * np.sin(angle)


@pytest.mark.parametrize("bars", [1, 2, 8])
def test_a_circle_pushed_along_a_straight_sheet_feels_one_constant_force(bars):
    """Also where the foot lies exactly at a bar's middle or end, with one bar, and with bars longer than the roller."""
    x = -np.linspace(0.0, BAR * bars, 400 * bars + 1)
    found = forces(bent(bars), x, np.full_like(x, -(RADIUS + 0.05 - 0.02)))
    np.testing.assert_allclose(found, 200.0 * (0.02 - 0.001), rtol=1e-12)


def test_the_ends_of_a_sheet_are_round():
    """Past lead and tail the force is that of a circle of half the thickness around the end."""
    out = np.linspace(1e-6, 0.4, 50)
    depth = RADIUS + 0.05 - np.hypot(out, RADIUS + 0.03)
    expected = np.where(depth > 0.002, 200.0 * (depth - 0.001), 200.0 * np.maximum(depth, 0.0) ** 2 / 0.004)
    for x in (out, -8 * BAR - out):
        np.testing.assert_allclose(forces(bent(8), x, np.full_like(x, -RADIUS - 0.03)), expected, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_circle_rolls_along_a_bent_sheet_without_the_noise_of_a_polygon(side):
    """Bars that turn by 8.6 degrees each: the force ripples by 0.25 % where the polygon's ripples by 40 % and more (measured
    ratios 166 outside, 675 inside). No jumps: half the spacing, half the largest difference."""
    smooth, bars = (bent(turn=60.0, skin=skin) for skin in ("smooth", "bars"))
    found = forces(smooth, *along_arc(smooth, side, 1201))
    assert found.std() < 3e-3 * found.mean()
    assert forces(bars, *along_arc(bars, side, 1201)).std() > 100.0 * found.std()
    largest = [np.abs(np.diff(forces(smooth, *along_arc(smooth, side, n)))).max() for n in (1201, 2401)]
    assert largest[0] / largest[1] == pytest.approx(2.0, rel=0.05)


def curve(nodes: np.ndarray, count: int) -> np.ndarray:
    """Points of the quadratic B-spline of the nodes, with its straight ends."""
    u = np.linspace(0.0, 1.0, count)[:, None]
    inner = [
        0.5 * (1.0 - u) ** 2 * a + (0.5 + u - u**2) * p + 0.5 * u**2 * b
        for a, p, b in zip(nodes[:-2], nodes[1:-1], nodes[2:], strict=True)
    ]
    ends = [nodes[0] + 0.5 * u * (nodes[1] - nodes[0]), nodes[-2] + 0.5 * (1.0 + u) * (nodes[-1] - nodes[-2])]
    return np.concatenate([ends[0], *inner, ends[1]])


@pytest.mark.parametrize("turn", [-100.0, 100.0])
def test_gaps_are_distances_to_the_curve(turn):
    """Joints of 25 degrees and circles from 2 to 10 mm off on either side, one on the curve's inside nearer than its radius."""
    scene = bent(5, turn)
    model = build(scene)
    start = initial_state(model, scene)
    nodes = np.stack(kinematics.nodes(model, look(model, start)[0]), axis=1)
    points = curve(nodes, 4001)
    rng = np.random.default_rng(1)
    centres = points[rng.integers(0, len(points), 60)] + rng.uniform(-1.0, 1.0, (60, 2)) * 5.0
    centres = centres[np.min(np.linalg.norm(points[None] - centres[:, None], axis=2), axis=1) > 0.5]

    def gap(centre):
        moved = build(diffeed.put(scene, "rollers.r.center", centre))
        pairs = look(moved, start)[2].sheets
        return jnp.min(pairs.gap), jnp.sum(pairs.weight), jnp.max(pairs.weight)

    gaps, weights, largest = jax.jit(jax.vmap(gap))(jnp.asarray(centres))
    exact = np.min(np.linalg.norm(points[None] - centres[:, None], axis=2), axis=1) - RADIUS - 0.05
    alone = np.asarray(largest) > 0.999999
    assert alone.sum() > 30
    np.testing.assert_allclose(np.asarray(gaps)[alone], exact[alone], atol=3e-6)
    np.testing.assert_allclose(gaps, exact, atol=0.02)  # where two pieces share it, a parabola is followed past its end
    np.testing.assert_allclose(weights, 1.0, rtol=1e-12)


def everything() -> Scene:
    """A bent sheet that touches a roller that moves, a circle, a line and an arc."""
    rng = np.random.default_rng(3)
    scene = bent(
        7,
        50.0,
        guides={
            "circle": CircleGuide(center=(-22.0, -0.3), radius=4.0),
            "line": LineGuide(start=(-8.0, -9.7), end=(2.0, -3.0)),
            "arc": ArcGuide(center=(-18.0, 36.0), radius=33.0, start_angle=-120.0, sweep=60.0),
        },
    )
    sheet = replace(scene.sheets["a"], rates=jnp.asarray(rng.normal(size=7)), velocity=jnp.asarray([20.0, -30.0]))
    scene = replace(scene, sheets={"a": sheet})
    scene = diffeed.put(scene, "rollers.r.center", jnp.asarray([-8.0, -1.0]))
    return diffeed.put(scene, "rollers.r.angular_speed", jnp.asarray(7.0))


@pytest.mark.long
def test_bars_feel_together_what_the_skin_feels():
    """Sum of forces, moment about the origin (at the body's surface) and power."""
    scene = everything()
    model = build(scene)
    state = initial_state(model, scene)
    at, world, touching = look(model, state)
    pairs = touching.sheets
    assert pairs is not None
    terms = pair_terms(model, pairs, at, Step(jnp.ones(()), False), keep_all(model))
    push, rub = pairs.touch.force, pairs.touch.friction
    fx, fy = push * pairs.nx + rub * pairs.ny, push * pairs.ny - rub * pairs.nx
    assert np.sum(np.asarray(push) > 0) >= 2
    np.testing.assert_allclose([terms.fx.sum(), terms.fy.sum()], [fx.sum(), fy.sum()], rtol=1e-12)
    n = len(model.circle_names)
    reach = model.circles.radius[:, None] + pairs.gap[:n]
    px, py = (c[:n, None] + k[:n] * reach for c, k in ((world.circles.x, pairs.nx), (world.circles.y, pairs.ny)))
    circles = jax.tree.map(lambda v: v if v.ndim == 0 else v.at[n:].set(0.0), pairs.touch)
    alone = pair_terms(model, pairs._replace(touch=circles), at, Step(jnp.ones(()), False), keep_all(model))
    moment = jnp.sum(at.x * alone.fy - at.y * alone.fx + alone.fw)
    assert float(moment) == pytest.approx(float(jnp.sum(px * fy[:n] - py * fx[:n])), rel=1e-10)
    # The bodies' own surface speeds: the roller turns.
    power = jnp.sum(terms.fx * at.vx + terms.fy * at.vy + terms.fw * at.w)
    turning = world.circles.w[:n, None] * model.circles.radius[:, None]
    given = jnp.sum(push * pairs.v_n - rub * pairs.v_t) - jnp.sum(rub[:n] * turning)
    assert float(power) == pytest.approx(float(given), rel=1e-10)


@pytest.mark.long
def test_frames_show_what_bars_feel():
    scene = everything()
    model = build(scene)
    state = initial_state(model, scene)
    at, _, touching = look(model, state)
    force, x, y = contact_on_bars(model, touching)
    terms = pair_terms(model, touching.sheets, at, Step(jnp.ones(()), False), keep_all(model))
    np.testing.assert_allclose(x, terms.fx / NEWTON, atol=1e-12)
    np.testing.assert_allclose(y, terms.fy / NEWTON, atol=1e-12)
    assert float(force.sum()) == pytest.approx(float(touching.sheets.touch.force.sum()) / NEWTON)


def test_gradients_of_a_contact_force():
    """By the circle's centre and every heading: forward, reverse and central differences."""
    scene = bent(5, 40.0)
    x, y = (np.asarray(v)[13] for v in along_arc(scene, -1.0, 40))

    def push(given):
        changed = diffeed.put(scene, "sheets.a.headings", given[2:])
        model = build(diffeed.put(changed, "rollers.r.center", given[:2]))
        pairs = look(model, initial_state(model, changed))[2].sheets
        return jnp.sum(pairs.touch.force * (1.0 + pairs.nx)) + jnp.sum(pairs.touch.force * pairs.levers[0].rt)

    given = jnp.concatenate([jnp.stack([jnp.asarray(x), jnp.asarray(y)]), scene.sheets["a"].headings])
    forward, backward = jax.jit(jax.jacfwd(push))(given), jax.jit(jax.jacrev(push))(given)
    value, h = jax.jit(jax.vmap(push)), 1e-5
    differences = (value(given[None] + h * jnp.eye(7)) - value(given[None] - h * jnp.eye(7))) / (2.0 * h)
    np.testing.assert_allclose(forward, backward, rtol=1e-9, atol=1e-9 * np.abs(forward).max())
    np.testing.assert_allclose(forward, differences, rtol=1e-6, atol=1e-6 * np.abs(forward).max())
    assert np.all(np.abs(np.asarray(forward))[:5] > 1.0)  # the bars behind hang from these


@pytest.mark.long
def test_a_pruned_search_finds_the_same_forces():
    """Many circles under two sheets: the list holds all that touch."""
    circles = {f"c{k}": CircleGuide(center=(3.0 * k - 40.0, -3.04), radius=3.0) for k in range(24)}
    sheets = {n: Sheet(length=20.0, bars=b, lead=(x, 0.0), **PAPER) for n, b, x in (("a", 5, 0.0), ("b", 3, 25.0))}
    scene = normalise(Scene(sheets=sheets, guides=circles, initial="given", skin="smooth"))
    model = build(scene)
    assert capacities(model).listed
    state = initial_state(model, scene)
    at, world, touching = look(model, state)
    found = search(model, state, jnp.asarray(1e-3))
    assert bool(found.complete)
    pruned = contacts(model, at, world, found.kept, None)
    step = Step(jnp.asarray(1e-4), True)
    whole = pair_terms(model, touching.sheets, at, step, keep_all(model))
    part = pair_terms(model, pruned.sheets, at, step, found.kept)
    for name, expected, actual in zip(whole._fields, whole, part, strict=True):
        np.testing.assert_allclose(actual, expected, atol=1e-12 * np.abs(expected).max(), err_msg=name)
    assert float(contact_on_bars(model, touching)[0].min()) > 0


def feeder(bars: int = 6, **more) -> Scene:
    """A sheet in one driven nip, its tail over a table."""
    sheet = Sheet(length=30.0, bars=bars, lead=(12.0, 0.0), structural_damping=1e-3, **(PAPER | {"density": 2e-6}))
    ramp = diffeed.Profile(times=(0.0, 0.02), values=(0.0, -10.0))
    rollers = {
        "drive": FixedRoller(center=(0.0, -8.04), radius=8.0, friction=0.8, angular_speed=ramp),
        "pinch": MovableRoller(
            center=(0.0, 8.04), direction=(0.0, 1.0), radius=8.0, mass=0.02, preload=3.0, damper=0.02, friction=0.6
        ),
    }
    guides = {"table": LineGuide(start=(-40.0, -0.6), end=(-6.0, -0.6))}
    return Scene(sheets={"a": sheet}, rollers=rollers, guides=guides, initial="given", skin="smooth", **more)


@functools.cache
def fed(dt: float) -> diffeed.Trajectory:
    return diffeed.simulate(feeder(), duration=0.05, dt=dt, frames=3, observe=("energy", "nips", "feed"))


@pytest.mark.long
def test_sheet_and_roller_that_move_together_feel_nothing():
    """The implicit coupling of a pinch's travel with the bars it lies on cancels what it adds to the pinch itself."""
    scene = normalise(replace(feeder(7), gravity=(0.0, 0.0)))
    model = build(scene)
    state = initial_state(model, scene)
    touching = look(model, state)[2]
    step, kept = Step(jnp.asarray(1e-4), True), keep_all(model)
    pressed = border(model, state, touching, step, kept)
    free = border(model, state, Contacts(None, None, touching.at, touching.spin), step, kept)
    added = pressed.matrix()[0, 0] - free.matrix()[0, 0]
    assert float(added) > 0
    assert float(jnp.sum(pressed.columns[0, 1])) == pytest.approx(-float(added))  # it travels along y
    assert np.sum(np.asarray(pressed.columns[0, 1]) != 0.0) == 2


@pytest.mark.long
def test_a_nip_feeds():
    """80 mm/s, a ramp of 20 ms before; the pinch carries its preload and weight."""
    run = fed(2e-4)
    assert bool(run.ok), run.failure.describe()
    assert float(run.sheets["a"].velocities[-1, 0, 0]) == pytest.approx(80.0, rel=0.01)
    assert float(run.rollers["pinch"].force[-1]) == pytest.approx(3.0 + 0.02 * 9.81, rel=0.02)
    assert float(run.observed["feed"]["a"].fed) == pytest.approx(80.0 * 0.04, rel=0.02)


@pytest.mark.long
def test_energy_is_accounted_for():
    """What the step itself loses of the work of the drive: a tenth at 2e-4 s, most of it while the nip closes."""
    balance = diffeed.measures.energy_balance(feeder(), fed(2e-4))
    assert abs(float(balance["numerical"])) < 0.15 * float(balance["work of drives"]), balance


@pytest.mark.slow
def test_a_batch_is_its_samples():
    scenes = [diffeed.put(normalise(feeder()), "rollers.pinch.preload", v) for v in (2.0, 3.0)]
    batch = jax.vmap(
        lambda s: diffeed.simulate(s, duration=0.05, dt=2e-4, frames=3, observe=("energy", "nips", "feed"))
    )
    found = batch(diffeed.stack(scenes))
    assert bool(found.ok.all())
    np.testing.assert_allclose(found.sheets["a"].nodes[1], fed(2e-4).sheets["a"].nodes, atol=1e-8)
    np.testing.assert_allclose(found.rollers["drive"].force[1], fed(2e-4).rollers["drive"].force, atol=1e-6)


def test_bars_never_pay_for_the_smooth_skin(monkeypatch):
    def forbidden(*_):
        raise AssertionError("the smooth skin in a scene of bars")

    monkeypatch.setattr(near, "piece_circle", forbidden)

    def trace(scene):
        model = build(scene)
        return jax.make_jaxpr(lambda s: look(model, s)[2].sheets)(initial_state(model, scene))

    trace(bent(skin="bars"))
    with pytest.raises(AssertionError, match="smooth skin"):
        trace(bent(skin="smooth"))


def test_another_word_is_refused():
    problems = diffeed.check(replace(bent(), skin="rough"))
    assert problems == ['skin must be "bars" or "smooth", but is "rough"']


@pytest.mark.slow
def test_the_film_feeder_runs_as_with_bars():
    """0.3 s from rest, through the entry of nip 1's exit guide: the lead edge of the two skins is within 0.2 mm all the way and
    within 0.01 mm along the path."""
    scene = diffeed.load_scene("film_feeder")
    lead = []
    for skin in ("smooth", "bars"):
        run = diffeed.simulate(replace(scene, skin=skin), duration=0.3, dt=2e-4, frames=31)
        assert bool(run.ok), run.failure.describe()
        lead.append(np.asarray(run.sheets["film"].nodes[:, 0]))
    apart = np.abs(lead[0] - lead[1])
    assert apart[:, 0].max() < 0.01
    assert apart[:, 1].max() < 0.2
