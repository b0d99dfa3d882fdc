"""Which pairs a search lists, how long they last, and what tells that they did not; and that a rest is of all that touches."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.scenes import draw

import diffeed
from diffeed import FixedRoller, Sheet
from diffeed.base.records import replace
from diffeed.chain.kinematics import nodes, pose
from diffeed.chain.state import initial_state
from diffeed.contact import candidates
from diffeed.contact.bodies import bodies
from diffeed.contact.candidates import Capacities, _most_urgent, capacities, touching_now
from diffeed.contact.features import features
from diffeed.contact.kept import keep_all
from diffeed.contact.near import circles_near, guides_near
from diffeed.contact.watched import Watched, used_up, watch, ways
from diffeed.faults.causes import CAUSES, TOO_MANY_NEAR
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.statics import rest
from diffeed.statics.coordinates import generalised_force, positions, with_positions


def watched(gap) -> Watched:
    zero = jnp.zeros_like(gap)
    return Watched(gap, zero, zero + 1.0, zero == 0.0, jnp.arange(len(gap))[:, None], None, 0.0)


@pytest.mark.parametrize("count", [1, 7, 40])
@pytest.mark.parametrize("seed", range(3))
def test_the_most_urgent_pairs_are_listed(count, seed):
    """Those whose gap is the smallest share of what may close; pairs that are not there come last."""
    rng = np.random.default_rng(seed)
    gap = rng.normal(size=(9, 11))
    gap[rng.random(gap.shape) < 0.3] = np.inf
    reach = rng.uniform(0.5, 3.0, gap.shape)
    chosen, rest, last = jax.jit(_most_urgent, static_argnums=2)(watched(jnp.asarray(gap)), reach, count)
    order = np.argsort((gap / reach).ravel())
    assert sorted(np.asarray(chosen)) == sorted(order[:count])
    assert float(last) == (gap / reach).ravel()[order[count]]
    left = np.asarray(rest.gap).ravel()
    assert np.all(left[order[:count]] == np.inf)
    np.testing.assert_array_equal(left[order[count:]], gap.ravel()[order[count:]])


def test_no_pair_is_listed_twice():
    """None within reach: twice the same pair would be felt twice."""
    chosen, _, last = _most_urgent(watched(jnp.full((8, 3), jnp.inf)), jnp.ones((8, 3)), 10)
    assert len(set(np.asarray(chosen))) == 10
    assert float(last) == np.inf


def seen(model, state):
    """All pairs of all families as a search sees them, and whether they touch."""
    at, world, kept = pose(model, state), bodies(model, state, state.time, state.time), keep_all(model)
    rows = features(model, at)
    near = {"circles": circles_near(rows, world, kept)}
    if kept.guides is not None:
        near["guides"] = guides_near(rows, world, kept)
    return {k: (watch(model, at, world, v, kept, k), (v.gap < 0) & (v.weight > 0)) for k, v in near.items()}


def bed(pieces: int, motion=None) -> diffeed.Scene:
    """A limp strip above a bed of short lines that join."""
    at = np.linspace(-40.0, 40.0, pieces + 1)
    points = np.stack([at, 1.0 - (at / 40.0) ** 2], axis=1)
    lines = {
        f"bed_{k}": diffeed.LineGuide(start=a, end=b, motion=motion)
        for k, (a, b) in enumerate(itertools.pairwise(points))
    }
    limp = Sheet(length=60.0, thickness=0.1, width=50.0, density=8e-7, youngs_modulus=10.0, bars=6, lead=(30.0, 1.4))
    return diffeed.scene(sheets={"strip": limp}, guides=lines)


def rocking_bed(seed: int) -> diffeed.Scene:
    rng = np.random.default_rng(seed)
    motion = diffeed.Motion(
        times=(0.0, 0.2), displacement=((0.0, 0.0), (5.0 * rng.normal(), 2.0)), rotation=(0.0, 10.0 * rng.normal())
    )
    low = bed(24, motion)
    return replace(low, sheets={"strip": replace(low.sheets["strip"], lead=(30.0, -0.6))})


@pytest.mark.long
@pytest.mark.parametrize("skin", ["bars", "smooth"])
@pytest.mark.parametrize("structure", [functools.partial(draw, "guided"), rocking_bed], ids=["guided", "bed"])
def test_no_pair_touches_unless_its_normal_says_so(structure, skin):
    """Sheets carried and bent at random among moving lines, arcs and circles: whatever touches then had come near enough along
    the normal of before."""
    missed, touched, warned, pairs = np.sum([_counted(structure(seed), skin, seed) for seed in range(24)], axis=0)
    assert missed == 0
    assert touched > 50, "or nothing could have been missed"
    assert warned < 0.5 * pairs, "a warning that is always given says nothing"


def _counted(scene, skin, seed):
    """Pairs that touch anew without a warning, that touch anew, that were warned of, and all."""
    scene = normalise(replace(scene, skin=skin))
    model, rng = jax.jit(build)(scene), np.random.default_rng(seed)
    start = initial_state(model, scene)
    n = model.layout.n_bars
    counts = np.zeros(4, int)
    for size in (0.3, 3.0, 10.0):
        state = replace(start, y=start.y + 2.0, heading=start.heading + 0.2 * rng.normal(size=n))
        after = replace(
            state,
            x=state.x + size * rng.normal(),
            y=state.y + size * rng.normal(),
            heading=state.heading + 0.03 * size * rng.normal(size=n),
            time=state.time + 0.02 * size,
        )
        (x0, y0), (x1, y1) = (nodes(model, pose(model, s)) for s in (state, after))
        way = (x1 - x0, y1 - y0)
        for warned, touches, touches_then in jax.device_get(_warned(model, state, after, way)):
            new = touches_then & ~touches
            counts += [np.sum(new & ~warned), new.sum(), warned.sum(), warned.size]
    return counts


@jax.jit
def _warned(model, state, after, way):
    motions = ways(*(bodies(model, s, s.time, s.time) for s in (state, after)))
    after, found = seen(model, after), []
    for family, (before, touches) in seen(model, state).items():
        found.append((used_up(model, before, way, motions[family]), touches, after[family][1]))
    return found


def pressed() -> diffeed.Scene:
    """Both faces of all bars touch."""
    rollers = {
        "lower": FixedRoller(center=(-10.0, -10.1), radius=10.0, surface_speed=-2000.0),
        "upper": FixedRoller(center=(-10.0, 10.1), radius=10.0, surface_speed=2000.0),
    }
    sheet = Sheet(length=8.0, width=10.0, thickness=0.2, density=1e-6, youngs_modulus=3000.0, bars=2, lead=(-6.0, 0.0))
    contacts = {"default": diffeed.Contact()}
    return diffeed.Scene(
        sheets={"strip": sheet}, rollers=rollers, contacts=contacts, gravity=(0.0, 0.0), initial="given"
    )


@pytest.fixture
def forgotten():
    """Programs know nothing of what a test changes: none from before is used, and none is left."""
    jax.clear_caches()
    yield
    jax.clear_caches()


@pytest.mark.long
@pytest.mark.parametrize("tolerance", [None, 1e-2])
def test_a_list_that_was_too_short_is_told(tolerance, monkeypatch, forgotten):
    scene = normalise(pressed())
    assert not capacities(build(scene)).listed, "so few are kept whole"
    monkeypatch.setattr(candidates, "capacities", lambda *_: Capacities(4, 0))
    run = diffeed.simulate(scene, duration=2e-4, dt=1e-5, frames=2, tolerance=tolerance, most_steps=100)
    assert not bool(run.ok)
    assert int(run.failure.cause) == TOO_MANY_NEAR, CAUSES[int(run.failure.cause)]


def test_a_list_that_is_too_short_for_long_steps_lasts_for_shorter_ones():
    found = candidates.Candidates(*[None] * 10)._replace(lasts=jnp.asarray(0.25))
    then, span = candidates.for_as_long_as_they_last(found, jnp.asarray(8e-3))
    assert float(span) == 2e-3
    assert bool(then.complete)
    then, span = candidates.for_as_long_as_they_last(found._replace(lasts=jnp.asarray(-0.1)), jnp.asarray(8e-3))
    assert float(span) == 0.0
    assert not bool(then.complete)


@pytest.mark.parametrize("seed", range(4))
def test_what_touches_at_a_state_is_listed(seed):
    """A feeder with its sheet carried and bent at random: as many forces from the list as from all pairs."""
    scene = normalise(diffeed.load_scene("film_feeder"))
    model = build(scene)
    assert capacities(model).listed
    start, rng = initial_state(model, scene), np.random.default_rng(seed)
    moved = positions(model, start) + rng.normal(0.0, 0.03, positions(model, start).shape)
    state = with_positions(model, start, jnp.asarray(moved), jnp.zeros(moved.shape))
    kept, whole = jax.jit(touching_now)(model, state)
    listed, every = (jax.jit(generalised_force)(model, state, k) for k in (kept, keep_all(model)))
    assert bool(whole)
    assert np.abs(every).max() > 1e3, "or nothing touches"
    np.testing.assert_allclose(listed, every, rtol=1e-11, atol=1e-11 * np.abs(every).max())


def thick_in_a_nip() -> diffeed.Scene:
    """Both bars touch both rollers."""
    scene = pressed()
    return replace(scene, sheets={"strip": replace(scene.sheets["strip"], thickness=0.24)}, initial="settled")


@pytest.mark.parametrize(("count", "enough"), [(6, True), (4, True), (3, False)])
def test_a_list_at_a_state_says_whether_it_holds_all_that_touches(count, enough, monkeypatch):
    scene = normalise(thick_in_a_nip())
    model = build(scene)
    monkeypatch.setattr(candidates, "capacities", lambda *_: Capacities(count, 0))
    assert bool(touching_now(model, initial_state(model, scene))[1]) == enough


@pytest.mark.parametrize("whole", [True, False])
def test_a_rest_that_a_list_does_not_hold_is_none(whole, monkeypatch, forgotten):
    monkeypatch.setattr(rest, "touching_now", lambda *given: (touching_now(*given)[0], jnp.asarray(whole)))
    assert np.isfinite(np.asarray(diffeed.settle(thick_in_a_nip()).x)).all() == whole


@pytest.fixture(scope="module")
def lying():
    """A strip at rest on many short lines. Most of them are near and bear nothing: behind the slope of one that ends before."""
    scene = bed(24)
    assert capacities(build(normalise(scene))).listed
    return scene, diffeed.settle(scene)


def test_a_rest_on_many_short_lines_is_found(lying):
    at = 30.0 - 10.0 * np.arange(7)
    below = np.interp(at, np.linspace(-40.0, 40.0, 25), 1.0 - (np.linspace(-40.0, 40.0, 25) / 40.0) ** 2)
    assert float(lying[1].y[0]) == pytest.approx(0.05 + np.mean(0.5 * (below[1:] + below[:-1])), abs=0.01)


@pytest.mark.long
def test_a_run_on_many_short_lines_lists_those_that_bear(lying, monkeypatch, forgotten):
    """Lines that end before a node, and others that begin behind it, do not wait to be felt, in front or behind."""
    scene, rest = lying
    settings = {"duration": 0.05, "dt": 1e-4, "frames": 2, "initial": rest}
    run = diffeed.simulate(scene, **settings)
    assert bool(run.ok), run.failure.describe()
    jax.clear_caches()
    monkeypatch.setattr(candidates, "capacities", lambda *_: Capacities())
    whole = diffeed.simulate(scene, **settings)
    np.testing.assert_allclose(run.final.state.x, whole.final.state.x, atol=1e-9)
    assert float(run.final.state.x[0]) != float(rest.x[0])


def fast_film(bars: int) -> Sheet:
    """Halfway up a channel of 0.3 mm, at 1 m/s."""
    at = {"lead": (120.0, 0.15), "speed": 1e3}
    return Sheet(length=100.0, thickness=0.1, width=50.0, density=8e-7, youngs_modulus=2000.0, bars=bars, **at)


def narrow(**other) -> diffeed.Scene:
    """A film at 1 m/s through a channel of 0.3 mm into its bend: thrown to and fro between the walls."""
    width, radius, end = 0.3, 40.0, 140.0
    walls = {
        "low": diffeed.LineGuide(start=(-20.0, 0.0), end=(end, 0.0)),
        "high": diffeed.LineGuide(start=(end, width), end=(-20.0, width)),
    }
    for name, out in (("inside", 0.5 * width), ("outside", -0.5 * width)):
        walls[name] = diffeed.ArcGuide(
            center=(end, 0.5 * width + radius), radius=radius + out, start_angle=-90.0, sweep=90.0, side=name
        )
    return diffeed.scene(sheets={"film": fast_film(20)}, guides=walls, initial="given", **other)


@pytest.mark.long
def test_a_crowded_scene_says_so_or_fails_and_is_told_to():
    run = diffeed.simulate(narrow(), duration=0.025, dt=1e-4, frames=2)
    assert int(run.failure.cause) == TOO_MANY_NEAR, CAUSES[int(run.failure.cause)]
    assert "crowded = true" in run.failure.remedy()
    done = diffeed.simulate(narrow(crowded=True), duration=0.025, dt=1e-4, frames=2)
    assert done.ok, done.failure.describe()


def test_steps_of_equal_length_have_briefer_lists_unless_the_scene_is_crowded():
    """A nip and what lies before it take fewer pairs than a channel, which keeps two for each node on guides."""
    feeder = normalise(diffeed.load_scene("film_feeder"))
    model, crowded = build(feeder), build(replace(feeder, crowded=True))
    brief, whole = capacities(model, brief=True), capacities(model)
    assert capacities(crowded, brief=True) == whole
    assert sum(brief[:2]) < 0.65 * sum(whole[:2])
    assert whole.guides >= 2 * model.layout.tail.shape[0]


@pytest.mark.long
def test_a_fast_sheet_between_short_guides_that_go_on_in_each_other():
    """A channel of 0.3 mm of lines and flat arcs in turn, 10 mm each, at 1 m/s: at a joint both walls have two near."""
    radius = 2000.0
    height, half = np.sqrt(radius**2 - 25.0), np.degrees(np.arcsin(5.0 / radius))
    guides = {}
    for k in range(30):
        a, b = 10.0 * k, 10.0 * (k + 1)
        ends = {"low": ((a, 0.0), (b, 0.0)), "high": ((b, 0.3), (a, 0.3))}
        middle = {"low": ((0.5 * (a + b), -height), 90.0), "high": ((0.5 * (a + b), 0.3 + height), 270.0)}
        for wall in ("low", "high"):
            centre, angle = middle[wall]
            guides[f"{wall}_{k}"] = (
                diffeed.LineGuide(start=ends[wall][0], end=ends[wall][1])
                if k % 2 == 0
                else diffeed.ArcGuide(
                    center=centre, radius=radius, start_angle=angle - half, sweep=2.0 * half, side="outside"
                )
            )
    scene = diffeed.scene(sheets={"film": fast_film(40)}, guides=guides, initial="given", crowded=True)
    done = diffeed.simulate(scene, duration=0.05, dt=1e-4, frames=2)
    assert done.ok, done.failure.describe()
    assert float(done.sheets["film"].nodes[-1, 0, 0]) == pytest.approx(167.5, abs=1.0)
