"""Sheets alone, taken to the ends of stiffness, thickness, damping and number of bars: right, or refused with the cause.

What is asked elsewhere and not again here:

| extreme | where |
|---|---|
| a bar thicker than long, a roller without mass, numbers below zero or not finite: refused | test_check |
| a sheet of one bar moves as a rigid rod; static friction; momentum | test_properties_balance |
| headings beyond a full turn are not wrapped; scales and units do not matter | test_properties_symmetry |
| the chain has the frequencies of its closed form; damping is proportional | test_validation_vibration |
| derivatives of roots and powers at zero | test_smooth |
| contact only pushes, whatever its exponents and speeds | test_properties_balance |
| a sheet wrapped round, squeezed, shot at guides: energy, symmetry, candidates | test_properties_* |
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import extremes as ex
from cases.extremes import EXPLICIT, METHODS, Row, Run
from scipy.integrate import solve_ivp

import diffeed
from diffeed import Clamp, Scene, Sheet
from diffeed.base.records import replace
from diffeed.input.parts import normalise
from diffeed.run.examine import explicit_limit, prepare
from diffeed.run.rollout import Plan, _simulate

FIRST_ORDER = "linear_euler"
IMPLICIT = tuple(m for m in METHODS if m != EXPLICIT)
CONSERVING = ("midpoint", EXPLICIT)
"""Methods that claim no damping of their own (to their order)."""
EACH = ex.by_method(FIRST_ORDER, EXPLICIT)


# --- two bars ---------------------------------------------------------------------------------------------------------


def opening(run: Run) -> np.ndarray:
    """(frames,) rad: half the angle between the two bars."""
    return 0.5 * (run.sheet.headings[:, 0] - run.sheet.headings[:, 1])


def exact_opening(scene: Scene, time: np.ndarray) -> np.ndarray:
    """Of two free bars, whose one freedom this is: (I + m (L/2)^2 sin^2 a) a'' + m (L/2)^2 sin a cos a a'^2 + 2 k a = 0."""
    sheet = scene.sheets["paper"]
    inertia, stiffness = ex.bar_inertia(sheet), ex.joint_stiffness(sheet)
    swing = ex.bar_mass(sheet) * (0.5 * ex.BAR) ** 2

    def slope(_: float, y: np.ndarray) -> list[float]:
        a, v = y
        pull = -2.0 * stiffness * a - swing * np.sin(a) * np.cos(a) * v * v
        return [v, pull / (inertia + swing * np.sin(a) ** 2)]

    start = [np.radians(float(sheet.headings[0])), float(sheet.rates[0])]
    span = (0.0, float(time[-1]))
    return solve_ivp(slope, span, start, method="DOP853", t_eval=time, rtol=1e-11, atol=1e-14).y[0]


FREE = ("film", "as thick as long", "crossing", "no stiffness", "tissue")
AGREES = {FIRST_ORDER: 2e-3, "extrapolated_euler": 1e-3, "midpoint": 1e-3, EXPLICIT: 2e-6}
"""Of the largest opening. With a half step h w = 0.012: (h w)^2 times a phase of 3 for order two, far less for order four."""


@pytest.mark.long
@EACH
@pytest.mark.parametrize("name", FREE)
def test_two_bars_move_as_their_one_freedom_does(name, method):
    """From a sheet as thick as its bars are long, over one that folds through itself, to one without stiffness.

    Each joint turns as far as it likes: at "crossing" the bars start at 200 degrees and pass through each other, which a
    sheet may. A first-order method is taken to its limit from two step lengths.
    """
    coarse, fine = (ex.sheets(method)[n] for n in (name, f"{name}, fine"))
    assert coarse.ok, coarse.why
    assert fine.ok, fine.why
    expected = exact_opening(fine.scene, fine.time[::2])
    found = opening(fine)[::2]
    if method == FIRST_ORDER:
        found = 2.0 * found - opening(coarse)[:5]
    assert np.abs(found - expected).max() < AGREES[method] * np.abs(expected).max()
    if name == "crossing":
        assert np.ptp(fine.sheet.headings[0]) > np.pi


@EACH
@pytest.mark.parametrize("name", ["film", "as thick as long"])
def test_scissors_have_the_frequency_of_two_inertias_on_one_spring(name, method):
    """omega^2 = 2 k/I exactly, with I = m (t^2 + L^2)/12: a sheet as thick as its bars are long has twice that of a thin one.
    Both bars' centres stay on one line, so that the mass does not matter."""
    run = ex.sheets(method)[f"{name}, fine"]
    sheet = run.scene.sheets["paper"]
    thickness, length = float(sheet.thickness), ex.BAR
    assert ex.bar_inertia(sheet) == pytest.approx(ex.bar_mass(sheet) * (thickness**2 + length**2) / 12.0)
    quarter = len(run.time) // 2
    speed = (run.sheet.rates[quarter, 0] - run.sheet.rates[quarter, 1]) / 2.0
    # Where the spring is relaxed all energy is motion: the speed is omega times the opening at the start.
    damped = 0.03 if method == FIRST_ORDER else 1e-3
    assert -speed == pytest.approx(1e-3 * ex.scissors_frequency(sheet), rel=damped)
    centres = 0.5 * (run.sheet.nodes[:, 1:, 1] + run.sheet.nodes[:, :-1, 1])
    assert np.ptp(centres) < 1e-6


@ex.by_method(EXPLICIT, of=CONSERVING)
def test_without_damping_nothing_decays(method):
    """The logarithmic decrement of the only mode."""
    for name in ("film", "as thick as long"):
        opened = opening(ex.sheets(method)[name])
        assert abs(np.log(opened[0] / opened[-1])) < 1e-4


@EACH
def test_overdamped_steel_foil_creeps(method):
    """Damping of 20 times the critical: monotone, never beyond rest, at the rate of spring over damper. An explicit method
    needs steps below what `check` names, and runs there."""
    row, run = ex.sheet_rows()["overdamped foil"], ex.sheets(method)["overdamped foil"]
    assert run.ok, run.why
    opened = opening(run)
    assert (np.diff(opened) < 0.0).all()
    assert (opened > 0.0).all()
    if method != EXPLICIT:
        # A thin sheet far from straight has more inertia than the linear mode, which creeping does not feel.
        lag = float(run.scene.sheets["paper"].structural_damping)
        late = np.log(opened[4] / opened[8]) / (run.time[8] - run.time[4])
        assert late == pytest.approx(1.0 / lag, rel=0.01)
        return
    assert diffeed.check(run.scene, dt=run.dt, method=EXPLICIT) == []
    (problem,) = diffeed.check(run.scene, dt=row.dt, method=EXPLICIT)
    assert "structural damping" in problem
    assert "linear_euler takes larger steps" in problem


@EACH
def test_nothing_around_a_sheet_is_free_fall(method):
    run = ex.sheets(method)["empty"]
    assert run.ok, run.why
    fallen = run.sheet.nodes[:, :, 1] - run.sheet.nodes[0, :, 1]
    late = 0.5 * 9810.0 * run.time * run.dt if method == FIRST_ORDER else 0.0
    np.testing.assert_allclose(fallen, (-0.5 * 9810.0 * run.time**2 - late)[:, None] + 0.0 * fallen, atol=1e-9)


@EACH
def test_every_run_of_two_bars_has_a_finite_gradient(method):
    for name, run in ex.sheets(method).items():
        assert run.ok, (name, run.why)
        assert ex.is_finite(run.slopes), name
    assert float(ex.sheets(method)["film"].slopes.sheets["paper"].youngs_modulus) != 0.0


# --- one bar ----------------------------------------------------------------------------------------------------------


@functools.cache
def rods(method: str) -> dict[str, Run]:
    """One bar: no joint at all."""
    rod = Sheet(length=20.0, thickness=0.1, width=30.0, density=8e-7, youngs_modulus=3000.0, bars=1)
    turning = replace(rod, rates=(30.0,), velocity=(100.0, 0.0))
    return ex.run({"rod": Row(Scene(sheets={"paper": turning}, gravity=(0.0, -9810.0), initial="given"), 1e-4)}, method)


@ex.by_method(FIRST_ORDER)
def test_a_single_bar_has_a_gradient(method):
    """By position, velocity and turning rate, which are known; by stiffness exactly none."""
    run = rods(method)["rod"]
    assert run.ok, run.why
    assert ex.is_finite(run.slopes)
    found, duration = run.slopes.sheets["paper"], run.time[-1]
    np.testing.assert_allclose(found.lead, (1.0, 1.0), rtol=1e-9)
    np.testing.assert_allclose(found.velocity, (duration, duration), rtol=1e-9)
    angle = 30.0 * duration
    # The centre starts with the lead's velocity less that of the turning; the lead then goes round it.
    by_rate = 10.0 * (np.array([-np.sin(angle), np.cos(angle)]) * duration - np.array([0.0, 1.0]) * duration).sum()
    assert float(found.rates[0]) == pytest.approx(by_rate, rel=1e-6)
    assert float(found.youngs_modulus) == 0.0


# --- thick card -------------------------------------------------------------------------------------------------------

CARD_BARS, CARD_BAR, CARD_LAG = 8, 7.5, 4e-3


def card(damping: float = CARD_LAG) -> Scene:
    """0.8 mm thick, out of a wall."""
    length = CARD_BARS * CARD_BAR
    sheet = Sheet(
        length=length, thickness=0.8, width=210.0, density=8e-7, youngs_modulus=4000.0, bars=CARD_BARS,
        lead=(length, 0.0), structural_damping=damping,
    )  # fmt: skip
    return Scene(
        sheets={"paper": sheet}, clamps={"wall": Clamp(sheet="paper", at="tail", kind="wall")}, initial="given"
    )


def card_at_rest() -> np.ndarray:
    """(nodes,) mm, lead to tail: the chain's own small deflection, joint by joint."""
    sheet = card().sheets["paper"]
    weight, spring = 9810.0 * ex.bar_mass(sheet), ex.joint_stiffness(sheet)
    n = CARD_BARS
    beyond = np.arange(n)[:, None] - np.arange(n)[None, :]  # bar k from the wall lies this far beyond joint j
    moment = weight * CARD_BAR * np.where(beyond >= 0, beyond + 0.5, 0.0).sum(axis=0)
    turn = moment / np.where(np.arange(n) == 0, 2.0 * spring, spring)
    headings = np.cumsum(turn)
    return -np.concatenate([[0.0], np.cumsum(headings * CARD_BAR)])[::-1]


@functools.cache
def card_limit() -> tuple[float, str]:
    found = prepare(normalise(card(0.0)))
    return explicit_limit(found.model, found.state)


@functools.cache
def cards(method: str) -> dict[str, Run]:
    """At steps far above the explicit limit, and around it."""
    limit, _ = card_limit()
    return ex.run(
        {"at rest": Row(card(), 1e-4), "below": Row(card(0.0), 0.9 * limit), "above": Row(card(0.0), 1.5 * limit)},
        method,
    )


@pytest.mark.long
@ex.by_method(FIRST_ORDER, of=IMPLICIT)
def test_card_comes_to_rest_in_its_static_shape(method):
    """Joint torques are small differences of large numbers here. Steps are 1.3 times the explicit limit without damping, and
    thousands of times that with it."""
    run = cards(method)["at rest"]
    assert run.ok, run.why
    expected = card_at_rest()
    assert np.abs(run.sheet.nodes[-1, :, 1] - expected).max() < 1e-3 * np.abs(expected).max()
    for name, each in cards(method).items():
        assert each.ok, name
        assert ex.is_finite(each.slopes), name


def test_an_explicit_method_on_card_is_refused_above_the_limit_of_its_bending():
    limit, cause = card_limit()
    sheet = card().sheets["paper"]
    zigzag = (48.0 * ex.joint_stiffness(sheet) / (ex.bar_mass(sheet) * CARD_BAR**2)) ** 0.5
    assert cause == "bending of the chain"
    assert 1.0 < limit * zigzag / 2.78 < 1.1  # the fastest mode of a few bars lies below that of endlessly many
    for damping in (0.0, CARD_LAG):
        (problem,) = diffeed.check(card(damping), dt=1.01 * limit, method=EXPLICIT)
        assert "dt must be at most" in problem
    assert diffeed.check(card(0.0), dt=limit, method=EXPLICIT) == []


@pytest.mark.slow
def test_an_explicit_method_on_card_runs_below_the_named_limit_and_fails_above():
    runs = cards(EXPLICIT)
    assert not runs["at rest"].ok
    assert not runs["above"].ok
    assert runs["below"].ok, runs["below"].why
    assert ex.is_finite(runs["below"].slopes)
    assert -2.1 * np.abs(card_at_rest()[0]) < runs["below"].sheet.nodes[:, 0, 1].min() < 0.0


# --- hanging chains ---------------------------------------------------------------------------------------------------

LINKS = 10


def hammock(modulus: float) -> Scene:
    """Tissue pinned at both ends, slack between them."""
    headings = np.linspace(40.0, -40.0, LINKS)
    sheet = Sheet(
        length=200.0, thickness=0.02, width=210.0, density=5e-7, youngs_modulus=modulus, bars=LINKS, headings=headings
    )
    clamps = {name: Clamp(sheet="paper", at=name) for name in ("lead", "tail")}
    return normalise(Scene(sheets={"paper": sheet}, clamps=clamps))


@jax.jit
def _hung(scene: Scene) -> tuple[jax.Array, Scene]:
    def lowest(scene: Scene) -> tuple[jax.Array, jax.Array]:
        state = diffeed.settle(scene)
        return jnp.sum(jnp.sin(state.heading) ** 2), state.heading

    slopes, headings = jax.grad(lowest, has_aux=True)(scene)
    return headings, slopes


@pytest.mark.parametrize(("modulus", "tolerance"), [(0.0, 1e-6), (200.0, 0.03)], ids=["no stiffness", "tissue"])
def test_the_thinnest_hangs_as_a_chain(modulus, tolerance):
    """A chain of equal links under its weight: the horizontal pull is the same everywhere, so that the slopes of the links
    rise by equal steps. Tissue differs by its bending, over a hundredth of its length."""
    headings, slopes = _hung(hammock(modulus))
    rise = np.diff(np.tan(np.asarray(headings)))
    np.testing.assert_allclose(rise, rise.mean() * np.ones(LINKS - 1), rtol=tolerance)
    assert ex.is_finite(slopes)


# --- very many bars ---------------------------------------------------------------------------------------------------

MANY = 500


def long_chain(bars: int) -> Scene:
    """Copy paper in the air, bent once, with a roller and a guide near it."""
    headings = 10.0 * np.cos(np.pi * (np.arange(bars) + 0.5) / bars)
    sheet = Sheet(
        length=297.0, thickness=0.1, width=210.0, density=8e-7, youngs_modulus=4000.0, bars=bars, headings=headings
    )
    return Scene(
        sheets={"paper": sheet},
        rollers={"idle": diffeed.FixedRoller(center=(0.0, -80.0), radius=5.0)},
        guides={"floor": diffeed.LineGuide(start=(-300.0, -90.0), end=(10.0, -90.0))},
        gravity=(0.0, 0.0),
        initial="given",
    )


def _inside(jaxpr) -> list:
    """All equations, those of inner programs too."""
    found = []
    for equation in jaxpr.eqns:
        found.append(equation)
        for inner in _inner(equation):
            found += _inside(inner)
    return found


def _inner(equation) -> list:
    leaves = jax.tree.leaves(
        list(equation.params.values()), is_leaf=lambda v: hasattr(v, "eqns") or hasattr(v, "jaxpr")
    )
    return [getattr(v, "jaxpr", v) for v in leaves if hasattr(v, "eqns") or hasattr(v, "jaxpr")]


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_cost_grows_with_the_bars_not_with_their_square(method):
    """The program of 500 bars has the equations of that of 250, and no array in it has two sides of the number of bars."""

    def equations(bars: int) -> list:
        scene = normalise(long_chain(bars))
        run = jax.make_jaxpr(lambda s: _simulate(s, 1e-6, None, Plan(2, 1, 2), method, ()).states.x)
        return _inside(run(scene).jaxpr)

    fewer, more = equations(MANY // 2), equations(MANY)
    assert len(fewer) == len(more)
    assert len(more) > 100
    shapes = [v.aval.shape for e in more for v in e.outvars if hasattr(v.aval, "shape")]
    assert max(sum(side >= MANY for side in shape) for shape in shapes) == 1


@pytest.mark.slow
@pytest.mark.parametrize("method", IMPLICIT)
def test_five_hundred_bars_keep_their_energy(method):
    """Steps of 300 times what an explicit method could take: none is gained, and the midpoint rule keeps it."""
    scene = normalise(long_chain(MANY))
    (problem,) = diffeed.check(scene, dt=5e-4, method=EXPLICIT)
    assert "bending of the chain" in problem

    @jax.jit
    def swing(scene: Scene):
        found = _simulate(scene, 5e-4, None, Plan(5, 2, 10), method, ("energy",))
        return jnp.sum(found.sheets["paper"].nodes[-1, 0]), found

    (_, found), slopes = jax.jit(jax.value_and_grad(swing, has_aux=True))(scene)
    assert bool(found.ok), found.failure.describe()
    assert ex.is_finite(slopes)
    sheet = scene.sheets["paper"]
    mass, inertia, spring = ex.bar_mass(sheet), ex.bar_inertia(sheet), ex.joint_stiffness(sheet)
    v = 0.5 * (found.sheets["paper"].velocities[:, 1:] + found.sheets["paper"].velocities[:, :-1])
    motion = 0.5 * (mass * np.sum(v**2, axis=(1, 2)) + inertia * np.sum(found.sheets["paper"].rates ** 2, axis=1))
    energy = motion + 0.5 * spring * np.sum(np.diff(found.sheets["paper"].headings, axis=1) ** 2, axis=1)
    assert (np.diff(energy) < 1e-6 * energy[0]).all()
    assert float(motion[-1]) > 0.1 * energy[0]
    if method == "midpoint":
        assert np.abs(energy / energy[0] - 1.0).max() < 1e-6
