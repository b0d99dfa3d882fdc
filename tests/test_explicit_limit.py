"""The largest stable step of the explicit stepper: found by bisection, against theory, and against what `check` refuses.

Classical Runge-Kutta is stable on the imaginary axis up to 2 sqrt(2), on the negative real axis up to 2.785.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import FixedRoller, LineGuide, Scene, Sheet
from diffeed.base.records import replace
from diffeed.input.parts import Contact, normalise
from diffeed.pair.law import NEWTON
from diffeed.readings.trajectory import Resume
from diffeed.run.examine import explicit_limit, prepare
from diffeed.run.progress import begin
from diffeed.run.rollout import STEP, go_on

WAVE, DECAY = 2.0 * np.sqrt(2.0), 2.785
LENGTH, THICKNESS, WIDTH, DENSITY, MODULUS = 100.0, 0.1, 200.0, 1e-6, 2000.0


def chain(bars: int = 10, damping: float = 0.0, **other) -> Sheet:
    given = {
        "length": LENGTH, "thickness": THICKNESS, "width": WIDTH, "density": DENSITY, "youngs_modulus": MODULUS,
        "structural_damping": damping, "bars": bars,
    }  # fmt: skip
    return Sheet(**given | other)


def zig_zag(bars: int) -> float:
    """1/s: sqrt(48 k/(m L^2)) of bars of length L: they turn against each other, and only their own inertia bears it."""
    bar = LENGTH / bars
    stiffness = MODULUS * THICKNESS**3 * WIDTH / (12.0 * bar) * NEWTON
    return float(np.sqrt(48.0 * stiffness / (DENSITY * bar * THICKNESS * WIDTH * bar**2)))


def finite(bars: int) -> float:
    """1/s: the highest mode of a free chain of so many bars, from mass and stiffness matrices in headings and the height of
    the first node. Its ends make it a little slower than an endless one."""
    bar = LENGTH / bars
    mass = DENSITY * bar * THICKNESS * WIDTH
    stiffness = MODULUS * THICKNESS**3 * WIDTH / (12.0 * bar) * NEWTON
    heights = np.hstack([np.ones((bars, 1)), bar * (np.tri(bars, k=-1) + 0.5 * np.eye(bars))])
    turns = np.hstack([np.zeros((bars, 1)), np.eye(bars)])
    bends = np.diff(turns, axis=0)
    matrix = mass * heights.T @ heights + mass * (THICKNESS**2 + bar**2) / 12.0 * turns.T @ turns
    return float(np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(matrix, stiffness * bends.T @ bends)).real)))


def free(bars: int, damping: float = 0.0) -> Scene:
    return Scene(sheets={"a": chain(bars, damping)}, gravity=(0.0, 0.0), initial="given")


def growth(scene: Scene, kick: np.ndarray):
    """By what factor a small kick has grown after some hundred steps: the fastest bar of the last twenty (a mode swings),
    as a function of the step; and what `explicit_limit` says."""
    scene = normalise(scene)
    model, _, state, *_ = prepare(scene)
    start = begin(model, scene, replace(state, rate=jnp.asarray(kick)), ())

    @jax.jit
    def factor(dt: jax.Array) -> jax.Array:
        def one(resume: Resume, _: None) -> tuple[Resume, jax.Array]:
            after = go_on(scene, resume, dt, 1, "runge_kutta").final
            return after, jnp.max(jnp.abs(after.state.rate - state.rate))

        last, fastest = jax.lax.scan(one, start, None, length=400)
        return jnp.where(last.cause > 0, jnp.inf, jnp.max(fastest[-20:]) / np.max(np.abs(kick)))

    return factor, explicit_limit(model, state)


def largest_step(factor, around: float) -> float:
    """s: by bisection between 0.3 and 4 times a guess, to 0.3 %. Grown is threefold: a kick that is not quite the
    mode swings among the bars, and comes to more on one of them."""
    low, high = np.log(0.3 * around), np.log(4.0 * around)
    assert float(factor(np.exp(low))) <= 3.0 < float(factor(np.exp(high)))
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if float(factor(np.exp(middle))) > 3.0 else (middle, high)
    return float(np.exp(low))


def agree(found: float, theory: float, limit: float, least: float = 0.99) -> None:
    """`least`: how much of the largest stable step `check` must allow."""
    assert found == pytest.approx(theory, rel=0.01)
    assert least * found <= limit <= 1.01 * found, "what check allows is stable, and not much of it is given away"


def alternating(bars: int) -> np.ndarray:
    return 1e-3 * (-1.0) ** np.arange(bars)


@pytest.mark.long
@pytest.mark.parametrize(("bars", "ends"), [(10, 0.04), (40, 0.01)])
def test_bending_of_a_free_chain(bars, ends):
    theory = WAVE / finite(bars)
    assert theory == pytest.approx(WAVE / zig_zag(bars), rel=ends)
    factor, (limit, cause) = growth(free(bars), alternating(bars))
    assert cause == "bending of the chain"
    agree(largest_step(factor, theory), theory, limit)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 5.0])
def test_a_damped_chain(ratio):
    """The damping of the mode: half of critical, where a pair of rates lies between the axes; critical; overdamped."""
    omega = finite(10)
    factor, (limit, _) = growth(free(10, 2.0 * ratio / omega), alternating(10))
    rate = omega * (-ratio + np.emath.sqrt(ratio**2 - 1.0))
    fastest = omega * (-ratio - np.emath.sqrt(ratio**2 - 1.0))
    theory = min(reach(complex(z)) / abs(z) for z in (rate, fastest))
    agree(largest_step(factor, theory), theory, limit)


def reach(rate: complex) -> float:
    """|z| up to which 1 + z + z^2/2 + z^3/6 + z^4/24 stays within the unit circle, in the direction of a rate."""
    for size in np.arange(1.0, 4.0, 1e-3):
        z = size * rate / abs(rate)
        if abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) > 1.0:
            return float(size)
    raise AssertionError("no limit")


def test_reach_on_the_axes():
    assert reach(-1.0 + 0.0j) == pytest.approx(DECAY, abs=2e-3)
    assert reach(-1e-9 + 1.0j) == pytest.approx(WAVE, abs=2e-3)


def test_a_contact_spring():
    """One bar lies on a guide by its end circles: each end bears on its spring, and a quarter of the mass swings on it where
    it turns: omega = sqrt(6 k/m), of heaving sqrt(2 k/m)."""
    stiffness, mass = 50.0, DENSITY * LENGTH * THICKNESS * WIDTH
    contact = Contact(stiffness=stiffness, damped=False, friction_law="none", smoothing=1e-6)
    scene = Scene(
        sheets={"a": chain(1, lead=(50.0, 0.04))}, contacts={"default": contact}, initial="settled",
        guides={"bed": LineGuide(start=(-200.0, 0.0), end=(200.0, 0.0))},
    )  # fmt: skip
    theory = WAVE / np.sqrt(6.0 * stiffness * NEWTON / mass)
    factor, (limit, cause) = growth(scene, np.array([1e-6]))
    assert cause == "contact stiffness"
    agree(largest_step(factor, theory), theory, limit, least=0.5)  # check thinks of a nip


def nip(**contact) -> Scene:
    """A sheet between two shafts that drive it; both press 2 N."""
    pressed = 2.0 / contact["stiffness"]
    height = 10.0 + 0.5 * THICKNESS - pressed
    return Scene(
        sheets={"a": chain(10, lead=(55.0, 0.0))},
        rollers={
            "lower": FixedRoller(center=(0.0, -height), radius=10.0, surface_speed=-300.0),
            "upper": FixedRoller(center=(0.0, height), radius=10.0, surface_speed=300.0),
        },
        contacts={"default": Contact(**contact)},
        gravity=(0.0, 0.0),
        initial="given",
    )


def test_a_start_off_the_nip_does_not_hide_it():
    """A sheet that runs towards the nip: the limit is that of its lead edge in it, m/(2 sqrt 3) between two springs."""
    scene = nip(stiffness=50.0, damped=False, stick_speed=1e3, smoothing=1e-6)
    scene = diffeed.put(scene, "sheets.a.lead", (-30.0, 0.0))
    model, _, state, *_ = prepare(normalise(scene))
    limit, cause = explicit_limit(model, state)
    bar = DENSITY * LENGTH / 10 * THICKNESS * WIDTH
    assert cause == "contact stiffness"
    assert limit == pytest.approx(WAVE / np.sqrt(2.0 * 50.0 * NEWTON * 2.0 * np.sqrt(3.0) / bar), rel=1e-3)


def test_friction_below_the_stick_speed():
    """Two rollers hold a sheet by mu N/v_s each: the whole sheet moves, not one bar. The start, at which the drives slip at
    full speed, does not hide it."""
    scene = nip(stiffness=50.0, damped=False, stick_speed=1.0, smoothing=1e-6)
    model, _, state, *_ = prepare(normalise(scene))
    limit, cause = explicit_limit(model, state)
    held = 2.0 * 0.5 * 2.0 * NEWTON / 1.0
    assert cause == "friction below the stick speed"
    assert limit == pytest.approx(DECAY * DENSITY * LENGTH * THICKNESS * WIDTH / held, rel=0.05)


def test_check_refuses_what_lies_above_the_limit_and_nothing_below():
    scene = free(10)
    theory = WAVE / finite(10)
    assert diffeed.check(scene, 0.99 * theory, "runge_kutta") == []
    (problem,) = diffeed.check(scene, 1.01 * theory, "runge_kutta")
    assert "bending of the chain" in problem


def test_a_step_that_nobody_gave_is_judged_too():
    """A run takes 1e-4 s if none is given; `frames` or a method say that a run is meant."""
    scene = free(40)
    assert WAVE / finite(40) < STEP, "or this shows nothing"
    (problem,) = diffeed.check(scene, None, "runge_kutta", frames=11)
    assert "dt must be at most" in problem
    assert "but is 0.0001;" in problem
    assert diffeed.check(scene, None, "runge_kutta") == [problem]
    assert diffeed.check(scene) == []
