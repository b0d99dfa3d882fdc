"""What must not depend on how a run is computed: candidates, bars, steps, batches, chunks, modes of differentiation.

Rows of the list of properties: 7, 19, 22, 23, 25 and 26.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.differentials import backward, forward, inner, random_change
from cases.ledger import ledger
from cases.scenes import DT, DURATION, METHODS, ORDER, ROUNDING, beam, draw, free_sheet, posts, run, slide
from cases.transforms import difference, map_numbers, outputs
from scipy.optimize import brentq

import diffeed
from diffeed.base.records import replace
from diffeed.bench.transport import transport
from diffeed.chain.state import initial_state
from diffeed.contact import candidates
from diffeed.contact.candidates import search
from diffeed.contact.kept import keep_all
from diffeed.contact.sweep import sheet_contacts
from diffeed.forces.contacts import pair_terms
from diffeed.forces.terms import Step
from diffeed.input.parts import (
    ArcGuide,
    CircleGuide,
    Contact,
    FixedRoller,
    LineGuide,
    MovableRoller,
    Scene,
    Sheet,
    normalise,
)
from diffeed.model.build import build
from diffeed.pair.law import NEWTON
from diffeed.readings.snapshot import look
from diffeed.run.rollout import _simulate, plan

SEEDS = (0, 1, 2)


@jax.jit
def begin(scene: Scene):
    """The state that a scene describes."""
    return initial_state(build(scene), scene)


# --- candidates: which pairs are looked at ---------------------------------------------------------------------------


@jax.jit
def _forces_both_ways(scene: Scene, span):
    """Forces on bars from kept candidates and from all bodies, and whether the search found room for all."""
    model, state = build(scene), begin(scene)
    at, world, _ = look(model, state)
    found = search(model, state, span)
    forces = [
        pair_terms(model, sheet_contacts(model, at, world, kept), at, Step(jnp.ones(()), False), kept)
        for kept in (found.kept, keep_all(model))
    ]
    return [jnp.stack([f.fx, f.fy, f.fw]) for f in forces], found.complete


@pytest.mark.long
@pytest.mark.parametrize("structure", ["posts", "guided"])
@pytest.mark.parametrize("span", [1e-5, 1e-3])
@pytest.mark.parametrize("seed", SEEDS)
def test_candidates_leave_no_force_out(structure, span, seed):
    scene = posts(np.random.default_rng(seed)) if structure == "posts" else draw(structure, seed)
    assert candidates.capacities(build(scene)).listed, "the scene must be large enough for a search"
    (kept, whole), complete = _forces_both_ways(scene, jnp.asarray(span))
    assert bool(complete)
    assert float(jnp.max(jnp.abs(whole))) > 0.01 * NEWTON
    # Two programs: the compiler may round a gap in another way, by eps times a place of 80 mm, of a depth of some 0.1 mm.
    assert np.max(np.abs(kept - whole)) < 2e-13 * float(jnp.max(jnp.abs(whole)))


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_search_changes_no_run(method, monkeypatch):
    """A sheet that meets post after post, with the search and with every pair looked at in every step."""
    scene = posts(np.random.default_rng(0))
    searched = run(scene, method)
    assert np.count_nonzero(np.max(searched.guides.block.force, axis=0) > 0) > 3
    whole = _run_with_every_pair(scene, method, monkeypatch)
    # Rounding only: pairs are summed in another order; 1e-14 of a force in each of 200 steps.
    assert difference(outputs(whole), outputs(searched)) < 1e-14 * 200


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "backed"),
    [
        ({"nips": 8}, True),
        pytest.param({"nips": 8}, False, marks=pytest.mark.slow),
        pytest.param({"nips": 2, "driven": 16}, False, marks=pytest.mark.slow),
        pytest.param({"nips": 8, "bars": 110}, False, marks=pytest.mark.slow),
    ],
)
def test_search_among_rollers_changes_no_run(path, backed, monkeypatch):
    """Pinches that lie on their drives, and the first of them opened by the sheet; `backed`: one pressed on by another pinch,
    and one that lies on an idle roller."""
    scene = replace(transport(**path, duration=DURATION), gravity=(0.0, 0.0))
    if backed:
        one, other = scene.rollers["pinch_4"], scene.rollers["drive_6"]
        more = {
            "backup": replace(one, center=(one.center[0], one.center[1] + 2.0 * one.radius - 0.1), spin=3.0),
            "drive_6": replace(other, surface_speed=None, spin=2.0),
        }
        scene = replace(scene, rollers=scene.rollers | more)
    scene = normalise(scene)
    searched = run(scene, "linear_euler")
    assert searched.ok, searched.failure.describe()
    partners = candidates.capacities(build(scene)).partners
    assert partners is not None
    assert partners * path["nips"] < 0.5 * len(build(scene).pairs)
    whole = _run_with_every_pair(scene, "linear_euler", monkeypatch)
    assert difference(outputs(whole), outputs(searched)) < 1e-14 * 200
    lying = np.asarray(searched.rollers.block.travel)
    assert np.ptp(lying) > 1e-3
    if backed:
        spins = {name: np.asarray(searched.rollers[name].angular_velocity) for name in ("backup", "drive_6")}
        assert all(np.ptp(v) > 0.01 for v in spins.values()), "they must be felt"


@pytest.mark.slow
def test_many_pinches_have_one_derivative_in_both_modes_and_in_a_batch():
    """In a batch all take one way: that of rollers which touch each other, if any does."""
    path = normalise(replace(transport(nips=4, bars=6, duration=DURATION), gravity=(0.0, 0.0)))
    pinch = path.rollers["pinch_4"]

    def way(height: jax.Array) -> jax.Array:
        """mm that the pinch of another nip travels, lowered on it with its own."""
        over = replace(path.rollers["pinch_5"], center=jnp.stack([jnp.asarray(pinch.center[0]), height]))
        scene = replace(path, rollers=path.rollers | {"pinch_5": over})
        found = diffeed.simulate(scene, duration=20 * DT, dt=DT, frames=2)
        return found.rollers["pinch_4"].travel[-1] + 1e-3 * found.rollers["pinch_4"].angle[-1]

    heights = jnp.asarray([pinch.center[1] + 2.0 * pinch.radius - 0.05, 3.0 * pinch.center[1] + 5.0])
    one = jax.jit(jax.value_and_grad(way))  # few programs: each takes seconds to compile
    values, alone = np.array([one(h) for h in heights]).T
    batched, backward = jax.jit(jax.vmap(jax.value_and_grad(way)))(heights)
    assert abs(alone[0]) > 1e-6
    assert alone[1] == 0.0, "out of reach"
    for found in (backward, jax.jit(jax.vmap(jax.jacfwd(way)))(heights)):
        np.testing.assert_allclose(found, alone, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(batched, values, rtol=1e-11)
    eps = 1e-6
    quotient = (one(heights[0] + eps)[0] - one(heights[0] - eps)[0]) / (2.0 * eps)
    np.testing.assert_allclose(alone[0], float(quotient), rtol=1e-5)


@pytest.mark.parametrize(("movable", "fixed"), [(0, 3), (1, 2), (2, 0), (5, 3), (6, 1)])
def test_each_pair_of_rollers_belongs_to_one_movable_roller(movable, fixed):
    rollers = {
        f"m{k}": MovableRoller(center=(50.0 * k, 0.0), direction=(0, 1), radius=5.0, mass=0.1) for k in range(movable)
    }
    rollers |= {f"f{k}": FixedRoller(center=(50.0 * k, -99.0), radius=5.0) for k in range(fixed)}
    model = build(normalise(replace(transport(), guides={}, rollers=rollers)))
    partner, which = model.pairs_by_roller
    found = [(min(i, j), max(i, j)) for i, row in enumerate(partner) for j in row if j >= 0]
    assert sorted(found) == sorted(model.pairs)
    assert [model.pairs[p] for p in which.ravel() if p >= 0] == found
    rows = np.sum(which >= 0, axis=1)
    assert np.ptp(rows) <= 1 if movable else rows.size == 0


@pytest.mark.long
def test_search_among_the_bodies_close_by_changes_no_run(monkeypatch):
    """A path of lines and arcs, of which the sheet lies on a few."""
    path = transport(bars=5, guides=240, driven=8, duration=DURATION)
    guides = {}
    for k in range(120):
        guides[f"line_{k}"] = LineGuide(start=(100.0 * k + 15.0, -0.09), end=(100.0 * k + 40.0, -0.09))
        guides[f"arc_{k}"] = ArcGuide(
            center=(100.0 * k + 65.0, -20.09), radius=20.0, start_angle=45.0, sweep=90.0, side="outside"
        )
    scene = normalise(replace(path, guides=guides))
    model = build(scene)
    most = 2 * (candidates.AT_LEAST + candidates.PER_BAR * 5)
    assert len(model.guides.names) > most
    searched = run(scene, "linear_euler")
    pressed = {
        n.split("_")[0]
        for n, f in zip(searched.guides.names, searched.guides.block.force.T, strict=True)
        if f.max() > 0
    }
    assert pressed == {"line", "arc"}
    whole = _run_with_every_pair(scene, "linear_euler", monkeypatch)
    assert difference(outputs(whole), outputs(searched)) < 1e-14 * 200


def _run_with_every_pair(scene: Scene, method: str, monkeypatch):
    monkeypatch.setattr(candidates, "capacities", lambda *_: candidates.Capacities())
    counts = plan(DURATION, DT, 3)
    return jax.jit(lambda s: _simulate.__wrapped__(s, DURATION / counts.total, None, counts, method, ()))(scene)


# --- bars ------------------------------------------------------------------------------------------------------------

BARS = (8, 16, 32)
SMALL = 1e-2  # mm/s2: the tip sags by 4e-7 of the length, so that the linear answer is exact to 1e-12


@functools.cache
def _refined(bars: int):
    """Tip of the cantilever under its small weight, its vibration and that of the free sheet."""

    @jax.jit
    def solve(held: Scene, loose: Scene):
        model = build(held)
        state = diffeed.settle(held)
        at = look(model, state)[0]
        tip = at.y[0] + model.bars.half_length[0] * at.s[0]
        return tip, diffeed.linearise(held, begin(held)), diffeed.linearise(loose, begin(loose))

    tip, held, loose = solve(beam(bars, True, SMALL), beam(bars, False, 0.0))
    return float(tip), held.modes()[0][:2], loose.modes()[0][3:5]


def _beam_numbers() -> tuple[float, float, float, float]:
    """Length, mass per length, bending stiffness (kg mm3/s2), rotary inertia per length of the strip."""
    length, thickness, width, density, modulus = 100.0, 0.1, 20.0, 1e-6, 3000.0
    mass = density * thickness * width
    return length, mass, NEWTON * modulus * width * thickness**3 / 12.0, mass * thickness**2 / 12.0


def _ratios(errors: list[float]) -> np.ndarray:
    return np.array(errors[:-1]) / np.array(errors[1:])


@pytest.mark.slow
def test_statics_converge_with_the_square_of_the_bar():
    length, mass, bending, _ = _beam_numbers()
    exact = -mass * SMALL * length**4 / (8.0 * bending)
    errors = [abs(_refined(n)[0] / exact - 1.0) for n in BARS]
    assert _ratios(errors) == pytest.approx(4.0, abs=0.3)


@pytest.mark.long
def test_clamped_frequencies_converge_with_the_square_of_the_bar():
    length, mass, bending, _ = _beam_numbers()
    exact = 1.8751040687119611**2 * np.sqrt(bending / mass) / length**2
    errors = [abs(_refined(n)[1][0] / exact - 1.0) for n in BARS]
    assert _ratios(errors) == pytest.approx(4.0, abs=0.3)


def _rayleigh_free_free() -> float:
    """First angular frequency of a free beam with rotary inertia J: EI w'''' + J omega^2 w'' = m omega^2 w, with
    EI w'' = 0 and EI w''' + J omega^2 w' = 0 at both ends (even shapes cos a x + B cosh b x about the middle)."""
    length, mass, bending, rotary = _beam_numbers()

    def mismatch(omega: float) -> float:
        p, q = rotary * omega**2 / bending, mass * omega**2 / bending
        root = np.sqrt(0.25 * p * p + q)
        a, b = np.sqrt(root + 0.5 * p), np.sqrt(root - 0.5 * p)
        half = 0.5 * length
        share = a * a * np.cos(a * half) / (b * b * np.cosh(b * half))  # no moment at the ends
        shear = a**3 * np.sin(a * half) + share * b**3 * np.sinh(b * half)
        return shear + p * (-a * np.sin(a * half) + share * b * np.sinh(b * half))

    guess = 4.730040744862704**2 * np.sqrt(bending / mass) / length**2
    return float(brentq(mismatch, 0.9 * guess, 1.1 * guess, xtol=1e-12 * guess))


def test_free_frequencies_converge_with_the_fourth_power_of_the_bar():
    exact = _rayleigh_free_free()
    errors = [abs(_refined(n)[2][0] / exact - 1.0) for n in BARS]
    coarse, fine = _ratios(errors)
    # 19.6 and 16.9: the next power of the bar's length dies out.
    assert fine == pytest.approx(16.0, abs=1.5)
    assert abs(fine - 16.0) < 0.5 * abs(coarse - 16.0)
    assert errors[-1] < 1e-5


@pytest.mark.parametrize("bars", [1, 2, 7, 8, 16, 64])
def test_mass_and_inertia_do_not_depend_on_the_bars(bars):
    scene = beam(bars, False, 0.0)
    model = build(scene)
    at = look(model, begin(scene))[0]
    x, masses = np.asarray(at.x), np.asarray(model.bars.mass)
    mass, inertia = np.sum(masses), np.sum(masses * (x - np.mean(x)) ** 2 + np.asarray(model.bars.inertia))
    assert mass == pytest.approx(1e-6 * 100.0 * 0.1 * 20.0, rel=1e-14)
    assert inertia == pytest.approx(mass * (100.0**2 + 0.1**2) / 12.0, rel=1e-13)


# --- a contact that slides along the sheet ---------------------------------------------------------------------------


def _strip(bend: float, radius: float) -> Scene:
    """A sheet of four bars, bent by `bend` (deg) at its middle joint, and one post."""
    sheet = Sheet(
        length=40.0, thickness=0.4, width=30.0, density=1e-5, youngs_modulus=300.0, bars=4, lead=(20.0, 0.0),
        headings=(0.0, 0.0, bend, bend),
    )  # fmt: skip
    contact = Contact(stiffness=30.0, exponent=1.3, smoothing=5e-3)
    guides = {"post": CircleGuide(center=(0.0, 0.0), radius=radius)}
    return normalise(
        Scene(
            sheets={"paper": sheet}, guides=guides, contacts={"default": contact}, gravity=(0.0, 0.0), initial="given"
        )
    )


@jax.jit
def _felt(scene: Scene, x, y):
    """Force (N) and moment about the origin (N mm) of posts at these places on the sheet, (places, 3)."""

    def one(x, y):
        post = replace(scene.guides["post"], center=jnp.stack([x, y]))
        moved = replace(scene, guides={"post": post})
        model = build(moved)
        at, _, touching = look(model, begin(moved))
        terms = pair_terms(model, touching.sheets, at, Step(jnp.ones(()), False), keep_all(model))
        moment = jnp.sum(terms.fw + at.x * terms.fy - at.y * terms.fx)
        return jnp.stack([jnp.sum(terms.fx), jnp.sum(terms.fy), moment]) / NEWTON

    return jax.vmap(one)(x, y)


DEPTH = 0.02


def _way(scene: Scene, side: float):
    """Places of the post that slides along the chord of the sheet, at the bent joint DEPTH deep, from end to end."""
    radius = float(scene.guides["post"].radius)
    bend = np.deg2rad(float(scene.sheets["paper"].headings[2]))
    along = np.array([np.cos(0.5 * bend), np.sin(0.5 * bend)])
    across = side * np.array([-along[1], along[0]])

    def at(s):
        place = s[:, None] * along + (radius + 0.2 - DEPTH) * across
        return _felt(scene, jnp.asarray(place[:, 0]), jnp.asarray(place[:, 1]))

    return at


def _largest_jumps(at, low, high):
    """Halve every interval many times, keeping the half across which the force changes more: what is left of a change
    is a jump. (intervals, 3)."""
    f_low, f_high = at(low), at(high)
    while np.max(high - low) > 1e-11:
        middle = 0.5 * (low + high)
        f_middle = at(middle)
        left, right = (np.max(np.abs(d), axis=1) for d in (f_middle - f_low, f_high - f_middle))
        go = left > right
        low, f_low = np.where(go, low, middle), np.where(go[:, None], f_low, f_middle)
        high, f_high = np.where(go, middle, high), np.where(go[:, None], f_middle, f_high)
    return np.abs(f_high - f_low)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("radius", [0.8, 30.0])
def test_straight_sheet_feels_one_constant_force(side, radius):
    """Over faces, joints and end circles: neither a hole nor a double count."""
    force = np.asarray(_way(_strip(0.0, radius), side)(np.linspace(-19.9, 19.9, 512)))
    expected = 30.0 * (DEPTH - 0.5 * 5e-3) ** 1.3
    assert np.max(np.abs(force[:, 0])) < 1e-9
    assert np.max(np.abs(force[:, 1] + side * expected)) < 1e-9


# Bends away from and towards the post. At the sharpest only the joint is passed: further on the straight way would leave
# the sheet, or lead through it.
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("bend", "radius", "reach"),
    [
        (0.0, 3.0, 22.0),
        (0.05, 30.0, 22.0),
        (0.5, 10.0, 22.0),
        (-0.5, 10.0, 22.0),
        (6.0, 3.0, 22.0),
        (-40.0, 1.0, 1.0),
        (40.0, 1.0, 1.0),
    ],
)
def test_force_is_continuous_along_a_bent_sheet(side, bend, radius, reach):
    """1e-9 N per step: over the last 1e-11 mm a contact of 30 N/mm changes by 3e-10 N; moments have arms of 20 mm."""
    edges = np.linspace(-reach, reach, 513) + 1e-3
    at = _way(_strip(bend, radius), side)
    assert np.max(np.abs(at(edges))) > 0.05
    jumps = _largest_jumps(at, edges[:-1], edges[1:])
    assert np.max(jumps[:, :2]) < 1e-9
    assert np.max(jumps[:, 2]) < 1e-9 * 20.0


# --- gradients -------------------------------------------------------------------------------------------------------

GRADIENTS = [("free_sheet", m) for m in METHODS]
GRADIENTS += [pytest.param(s, m, marks=pytest.mark.slow) for s in ("clamped", "nip") for m in METHODS]
with_gradients = pytest.mark.parametrize(("structure", "method"), GRADIENTS)


@pytest.mark.long
@with_gradients
def test_reverse_mode_equals_forward_mode(structure, method):
    """<w, J d> = <J' w, d> for random weights of all outputs and random directions of all numbers."""
    rng, scene = np.random.default_rng(0), draw(structure, 1)
    change = random_change(scene, rng, 1.0)
    _, slope = forward(scene, change, jnp.zeros(()), method)
    # Outputs have sizes of their own: weigh each by the inverse of its slope.
    weights = jax.tree.map(lambda d: rng.normal(size=d.shape) / (1.0 + np.max(np.abs(np.asarray(d)))), slope)
    gradient = backward(scene, weights, method)
    size = sum(
        np.linalg.norm(np.asarray(a) * np.asarray(b))
        for a, b in zip(*map(jax.tree.leaves, (gradient, change)), strict=True)
    )
    assert size > 0.1
    assert abs(inner(weights, slope) - inner(gradient, change)) < 1e-10 * size


@with_gradients
def test_forward_mode_equals_central_differences(structure, method):
    # Steps this small lie between the kinks of ramps and stops: with more than one kink the error falls as `step` only.
    rng, scene, step = np.random.default_rng(1), draw(structure, 1), 1e-7
    change = random_change(scene, rng, 1.0)
    _, slope = forward(scene, change, jnp.zeros(()), method)
    ahead, behind = (
        outputs(run(jax.tree.map(lambda v, d, k=k: v + k * step * jnp.asarray(d), scene, change), method))
        for k in (1, -1)
    )
    quotient = jax.tree.map(lambda a, b: (np.asarray(a) - np.asarray(b)) / (2.0 * step), ahead, behind)
    assert difference(slope, quotient) < 1e-6


def _only(scene: Scene, *wanted: str) -> Scene:
    """The direction in which only the sheet's numbers of these names grow, in proportion."""
    return map_numbers(scene, lambda owner, name, v: v if isinstance(owner, Sheet) and name in wanted else 0.0 * v)


@pytest.mark.parametrize("method", METHODS)
def test_momentum_has_no_derivative_by_stiffness(method):
    scene = draw("free_sheet", 1)
    _, slope = forward(scene, _only(scene, "youngs_modulus"), jnp.zeros(()), method)
    velocities = np.asarray(slope["sheets.paper"].velocities)
    assert np.max(np.abs(velocities)) > 1.0
    mean = np.mean(0.5 * (velocities[:, 1:] + velocities[:, :-1]), axis=1)
    assert np.max(np.abs(mean)) < 1e-12 * np.max(np.abs(velocities))


def test_energy_drift_has_no_derivative():
    """Without damping, energy stays, whatever the numbers are: for a shift exactly, else as far as the method errs."""
    scene = draw("free_sheet", 1)
    paper = replace(scene.sheets["paper"], structural_damping=jnp.zeros(()))
    scene = replace(scene, sheets={"paper": paper}, gravity=jnp.zeros(2))

    @jax.jit
    def drift_along(scene: Scene, change: Scene):
        def energies(scene: Scene):
            return ledger(scene, diffeed.simulate(scene, 4e-3, 2e-5, 2, "runge_kutta").states).energy

        return jax.jvp(lambda s: energies(s)[1] - energies(s)[0], (scene,), (change,)), energies(scene)[0]

    for names, bound in ((("lead",), 1e-12), (("youngs_modulus", "rates", "curl", "length"), 1e-6)):
        (drift, slope), energy = drift_along(scene, jax.tree.map(jnp.asarray, _only(scene, *names)))
        assert abs(float(drift)) < 1e-6 * float(energy)
        assert abs(float(slope)) < bound * float(energy)


@pytest.mark.parametrize("method", METHODS)
def test_gradients_are_finite_at_rest(method):
    """A straight sheet at rest without gravity: nothing moves, and nothing divides by that."""
    scene, zero = free_sheet(np.random.default_rng(0)), jnp.zeros(6)
    paper = replace(scene.sheets["paper"], headings=zero, rates=zero, velocity=jnp.zeros(2), curl=jnp.zeros(()))
    scene = replace(scene, sheets={"paper": paper}, gravity=jnp.zeros(2))
    weights = jax.tree.map(jnp.ones_like, outputs(run(scene, method)))
    gradient = backward(scene, weights, method)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(gradient))
    assert float(jnp.max(jnp.abs(gradient.sheets["paper"].velocity))) > 0.0


# --- batches, chunks, compilation ------------------------------------------------------------------------------------

BATCHED = [(s, m) for s in ("free_sheet", "clamped") for m in METHODS]
BATCHED += [pytest.param("nip", "linear_euler", marks=pytest.mark.slow)]


@pytest.mark.parametrize(("structure", "method"), BATCHED)
def test_batch_equals_single_runs(structure, method):
    scenes = [draw(structure, seed) for seed in SEEDS]
    batch = jax.vmap(lambda s: diffeed.simulate(s, DURATION, DT, 3, method))(diffeed.stack(scenes))
    for k, scene in enumerate(scenes):
        together = jax.tree.map(lambda v, k=k: v[k], outputs(batch))
        assert difference(outputs(run(scene, method)), together) < 1e-12 * ROUNDING.get(method, 1.0)


@pytest.mark.parametrize("method", METHODS)
def test_outer_jit_changes_nothing(method):
    scene = draw("clamped", 0)
    compiled = jax.jit(lambda s: diffeed.simulate(s, DURATION, DT, 3, method))(scene)
    assert difference(outputs(run(scene, method)), outputs(compiled)) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_without_jit(method):
    """Two steps, one operation at a time."""
    scene = draw("free_sheet", 0)
    options = {"duration": 2 * DT, "dt": DT, "frames": 2}
    compiled = run(scene, method, **options)
    with jax.disable_jit():
        plain = run(scene, method, **options)
    assert difference(outputs(compiled), outputs(plain)) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_frames_and_chunks_do_not_matter(method):
    """400 steps in one frame, in four, or in two runs, the second from where the first ended: checkpoints and searches
    fall on other steps."""
    scene, steps = posts(np.random.default_rng(1)), 400
    whole = run(scene, method, duration=steps * DT / 2, dt=DT / 2, frames=2)
    fine = run(scene, method, duration=steps * DT / 2, dt=DT / 2, frames=5)
    half = run(scene, method, duration=steps * DT / 4, dt=DT / 2, frames=3)
    rest = run(scene, method, duration=steps * DT / 4, dt=DT / 2, frames=3, initial=half.final)
    first, *others = ({"": jax.tree.map(lambda v: v[-1:], t.sheets["paper"])} for t in (whole, fine, rest))
    for other in others:
        assert difference(first, other) < 1e-12


# --- steps -----------------------------------------------------------------------------------------------------------


def _final_nodes(scene: Scene, method: str, dt: float, runs: int):
    """Nodes after `runs` runs of 200 steps each, one begun where the other ended: one compilation for every step."""
    state = begin(scene)
    for _ in range(runs):
        trajectory = run(scene, method, duration=200 * dt, dt=dt, initial=state)
        state = trajectory.final.state
    (track,) = trajectory.sheets.values()
    return np.asarray(track.nodes[-1])


def _orders(scene: Scene, method: str, dt: float, parts: tuple[int, ...]) -> np.ndarray:
    """Orders of convergence between steps dt / parts, each half of the one before, against the most accurate method."""
    best = max(METHODS, key=ORDER.__getitem__)
    exact = _final_nodes(scene, best, dt / (4 * parts[-1]), 4 * parts[-1])
    return np.log2(_ratios([np.max(np.abs(_final_nodes(scene, method, dt / k, k) - exact)) for k in parts]))


@pytest.mark.parametrize("method", METHODS)
def test_error_falls_with_the_order_in_smooth_motion(method):
    """Free flight of a bent sheet (0.3: steps are not yet infinitely small)."""
    scene = draw("free_sheet", 0)
    assert _orders(scene, method, 5e-5, (2, 4))[-1] == pytest.approx(ORDER[method], abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_error_falls_at_least_as_the_step_across_contacts(method, seed):
    """On average over three halvings: an event falls before or after a step, so that single ratios scatter."""
    scene = slide(np.random.default_rng(seed))
    assert np.mean(_orders(scene, method, 2.5e-5, (1, 2, 4, 8))) > 0.9
