"""Runs of free and pinned chains against two independent formulations: nodes, sensitivities, balances, convergence."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.reference import reference

import diffeed
from diffeed import Clamp, Sheet

STEPS = {"f5": 5e-6, "p3": 1e-5, "p8": 4e-5, "p8d": 4e-5}
"""Case -> step at which Runge-Kutta has converged well below the tolerance."""


def chain(name: str) -> diffeed.Scene:
    """The references number bars from the base, so the base is the tail and the tip leads."""
    given = reference(f"c05_chain_{name}")["parameters"]
    angles, rates = np.array(given["th0"]), np.array(given["thdot0"], dtype=float)
    length = given["Lb"] * np.array([np.sum(np.cos(angles)), np.sum(np.sin(angles))])
    turning = given["Lb"] * np.array([-np.sum(np.sin(angles) * rates), np.sum(np.cos(angles) * rates)])
    sheet = diffeed.Sheet(
        length=given["n"] * given["Lb"],
        thickness=given["t"],
        width=given["width"],
        density=given["rho"],
        youngs_modulus=given["E"],
        structural_damping=given["xi"],
        bars=given["n"],
        lead=length,
        headings=np.degrees(angles[::-1]),
        rates=rates[::-1],
        velocity=np.array(given["v_base0"]) + turning,
    )
    return diffeed.Scene(
        sheets={"chain": sheet},
        clamps={"base": diffeed.Clamp(sheet="chain", at="tail")} if given["pinned"] else {},
        gravity=(0.0, -given["g"]),
        initial="given",
    )


class Run(NamedTuple):
    """A run from base to tip: (frames, bars + 1, 2), (frames, bars), and slopes of nodes by modulus and gravity."""

    nodes: np.ndarray
    velocities: np.ndarray
    headings: np.ndarray
    rates: np.ndarray
    by_modulus: np.ndarray
    by_gravity: np.ndarray


@functools.cache
def program(frames: int, duration: float, dt: float, method: str) -> Any:
    """A run and its slopes by forward mode, compiled once per number of bars."""

    def run(numbers: jax.Array, scene: diffeed.Scene) -> tuple[jax.Array, diffeed.Trajectory]:
        changed = diffeed.put(scene, "sheets.chain.youngs_modulus", numbers[0])
        changed = diffeed.put(changed, "gravity[1]", -numbers[1])
        trajectory = diffeed.simulate(changed, duration, dt, frames, method)
        return trajectory.sheets["chain"].nodes, trajectory

    return jax.jit(jax.jacfwd(run, has_aux=True))


@functools.cache
def exact_run(name: str) -> Run:
    """The run that is compared, by Runge-Kutta."""
    case = reference(f"c05_chain_{name}")
    times, given = case["reference"]["t"], case["parameters"]
    numbers = jnp.array([given["E"], given["g"]])
    # Every leaf an array of its own: cases with the same number of bars share one program.
    scene = diffeed.scene(**vars(chain(name)))
    slopes, run = program(len(times), times[-1], STEPS[name], "runge_kutta")(numbers, scene)
    assert run.ok
    np.testing.assert_allclose(run.time, times, rtol=0, atol=1e-12)
    track, slopes = run.sheets["chain"], np.asarray(slopes)[:, ::-1]
    ordered = [np.asarray(v)[:, ::-1] for v in (track.nodes, track.velocities, track.headings, track.rates)]
    return Run(*ordered, slopes[..., 0], slopes[..., 1])


def exact_nodes(name: str) -> np.ndarray:
    found = reference(f"c05_chain_{name}")["reference"]
    return np.stack([found["joint_x"], found["joint_y"]], axis=-1)


def tolerance(name: str) -> float:
    given = reference(f"c05_chain_{name}")["parameters"]
    return 1e-6 * given["n"] * given["Lb"]


@pytest.mark.parametrize("name", STEPS)
def test_nodes(name: str) -> None:
    np.testing.assert_allclose(exact_run(name).nodes, exact_nodes(name), rtol=0, atol=tolerance(name))


@pytest.mark.parametrize("name", STEPS)
def test_headings_and_rates(name: str) -> None:
    """Angles as the nodes: 1e-6 rad per bar; rates as well, over the largest one."""
    found, exact = exact_run(name), reference(f"c05_chain_{name}")["reference"]
    bars = found.headings.shape[1]
    np.testing.assert_allclose(found.headings, exact["th"], rtol=0, atol=1e-6 * bars)
    fastest = np.max(np.abs(exact["thdot"]))
    np.testing.assert_allclose(found.rates, exact["thdot"], rtol=0, atol=1e-5 * fastest)


@pytest.mark.parametrize("which", ["dtip_dE", "dtip_dg"])
@pytest.mark.parametrize("name", STEPS)
def test_tip_slopes(name: str, which: str) -> None:
    """Forward mode through a run against complex steps through the reference."""
    exact = reference(f"c05_chain_{name}")["reference"]
    frames = [int(np.argmin(np.abs(np.array(exact["t"]) - t))) for t in exact[which]["t"]]
    run = exact_run(name)
    found = (run.by_modulus if which == "dtip_dE" else run.by_gravity)[frames, -1]
    value = np.array(exact[which]["value"])
    np.testing.assert_allclose(found, value, rtol=0, atol=1e-4 * np.max(np.abs(value)))


@pytest.mark.slow
def test_tip_slope_by_reverse_mode() -> None:
    """The damped chain's tip position, pulled back to the modulus and to gravity in one sweep."""
    case = reference("c05_chain_p8d")
    end = case["reference"]["dtip_dE"]["t"][0]

    def tip_x(scene: diffeed.Scene) -> jax.Array:
        return diffeed.simulate(scene, end, 1e-4, 2, "runge_kutta").sheets["chain"].nodes[-1, 0, 0]

    slope = jax.jit(jax.grad(tip_x))(diffeed.scene(**vars(chain("p8d"))))
    by_modulus, by_gravity = (case["reference"][k]["value"] for k in ("dtip_dE", "dtip_dg"))
    np.testing.assert_allclose(
        slope.sheets["chain"].youngs_modulus, by_modulus[0][0], rtol=0, atol=1e-4 * np.max(np.abs(by_modulus))
    )
    np.testing.assert_allclose(-slope.gravity[1], by_gravity[0][0], rtol=0, atol=1e-4 * np.max(np.abs(by_gravity)))


# --- balances --------------------------------------------------------------------------------------------------------


def energy(name: str, run: Run) -> np.ndarray:
    """(frames,) kinetic, bending and gravity, kg mm2/s2."""
    given = reference(f"c05_chain_{name}")["parameters"]
    centres, speeds = (0.5 * (v[:, 1:] + v[:, :-1]) for v in (run.nodes, run.velocities))
    moving = 0.5 * given["m"] * np.sum(speeds**2, axis=(1, 2)) + 0.5 * given["I"] * np.sum(run.rates**2, axis=1)
    bending = 0.5e3 * given["k_Nmm"] * np.sum(np.diff(run.headings, axis=1) ** 2, axis=1)
    return moving + bending + given["m"] * given["g"] * np.sum(centres[..., 1], axis=1)


@pytest.mark.parametrize("name", STEPS)
def test_energy(name: str) -> None:
    """Kept without damping, lost at the right rate with it."""
    run, exact = exact_run(name), np.array(reference(f"c05_chain_{name}")["reference"]["energy_kg_mm2_s2"])
    given = reference(f"c05_chain_{name}")["parameters"]
    speeds = 0.5 * (run.velocities[:, 1:] + run.velocities[:, :-1])
    # Gravity's zero is arbitrary: a chain that starts level and at rest has no energy to compare with.
    scale = max(abs(exact[0]), np.max(0.5 * given["m"] * np.sum(speeds**2, axis=(1, 2))))
    np.testing.assert_allclose(energy(name, run), exact, rtol=0, atol=1e-6 * scale)


def momentum(name: str, nodes: np.ndarray, velocities: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(frames, 3): linear, and angular about the origin."""
    given = reference(f"c05_chain_{name}")["parameters"]
    centres, speeds = (0.5 * (v[:, 1:] + v[:, :-1]) for v in (nodes, velocities))
    crossed = centres[..., 0] * speeds[..., 1] - centres[..., 1] * speeds[..., 0]
    angular = given["m"] * np.sum(crossed, axis=1) + given["I"] * np.sum(rates, axis=1)
    return np.concatenate([given["m"] * np.sum(speeds, axis=1), angular[:, None]], axis=1)


def test_momentum() -> None:
    """The free chain keeps its linear momentum to round-off, the angular one as well as a step of order four can."""
    run = exact_run("f5")
    exact = np.array(reference("c05_chain_f5")["reference"]["linear_and_angular_momentum_about_origin"][0])
    found = momentum("f5", run.nodes, run.velocities, run.rates) / exact - 1.0
    assert np.max(np.abs(found[:, :2])) < 1e-12
    assert np.max(np.abs(found[:, 2])) < 1e-7


# --- convergence -----------------------------------------------------------------------------------------------------


def last_frame(name: str, method: str, frame: int, dt: float) -> Any:
    """The chain at one frame of the reference, (1, ...) each, base to tip."""
    end = reference(f"c05_chain_{name}")["reference"]["t"][frame]
    run = diffeed.simulate(chain(name), end, dt, 2, method)
    assert run.ok
    return jax.tree.map(lambda v: np.asarray(v)[-1:, ::-1], run.sheets["chain"])


def error(name: str, frame: int, nodes: np.ndarray) -> float:
    return float(np.max(np.abs(nodes - exact_nodes(name)[frame])))


EULER = {"f5": (1, 4e-7), "p8": (20, 4e-5), "p8d": (20, 4e-5)}
"""Case -> frame up to which it runs, and the longer of two steps that resolve its fastest mode so far."""


@pytest.mark.parametrize("name", EULER)
def test_linear_euler_converges(name: str) -> None:
    """With order one to the same motion: half the step, half the error, and little of it left when extrapolated."""
    frame, dt = EULER[name]
    coarse, fine = (last_frame(name, "linear_euler", frame, step) for step in (dt, 0.5 * dt))
    left = error(name, frame, fine.nodes[0])
    assert 1.9 < error(name, frame, coarse.nodes[0]) / left < 2.1
    assert error(name, frame, 2.0 * fine.nodes[0] - coarse.nodes[0]) < 0.05 * left
    if name == "f5":
        exact = reference("c05_chain_f5")["reference"]["linear_and_angular_momentum_about_origin"][0]
        found = momentum(name, fine.nodes, fine.velocities, fine.rates)[0]
        np.testing.assert_allclose(found[:2], exact[:2], rtol=1e-12)


def test_runge_kutta_order() -> None:
    """At twice the step that the other tests take, the free chain is at least 2^4 times as far off."""
    coarse = last_frame("f5", "runge_kutta", 25, 2.0 * STEPS["f5"])
    assert error("f5", 25, coarse.nodes[0]) > 16.0 * error("f5", 25, exact_run("f5").nodes[25])


@pytest.mark.long
@pytest.mark.parametrize(("method", "order"), [("linear_euler", 1.0), ("extrapolated_euler", 2.0), ("midpoint", 2.0)])
def test_a_pinned_end_costs_no_order(method: str, order: float) -> None:
    """A strip that swings from a pin, without contact, against the explicit method at small steps."""
    sheet = Sheet(
        length=80.0, thickness=0.1, width=20.0, density=1e-6, youngs_modulus=200.0, bars=4, lead=(40.0, 0.0),
        structural_damping=1e-3,
    )  # fmt: skip
    scene = diffeed.scene(sheets={"strip": sheet}, clamps={"pin": Clamp(sheet="strip", at="tail")}, initial="given")

    def nodes(method: str, dt: float) -> np.ndarray:
        run = diffeed.simulate(scene, duration=0.064, dt=dt, frames=5, method=method)
        assert bool(run.ok)
        return np.asarray(run.sheets["strip"].nodes)

    exact = nodes("runge_kutta", 1e-5)
    errors = [np.abs(nodes(method, dt) - exact).max() for dt in (5e-4, 2.5e-4, 1.25e-4)]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), order, atol=0.1)


def test_a_limp_strip_hangs_from_its_pin_and_has_a_slope() -> None:
    """Without stiffness there is no frequency that could close the pin's error; its root would have no slope."""
    sheet = Sheet(length=40.0, thickness=0.1, width=20.0, density=1e-6, youngs_modulus=0.0, bars=2, lead=(40.0, 0.0))
    scene = diffeed.scene(sheets={"strip": sheet}, clamps={"pin": Clamp(sheet="strip", at="tail")}, initial="given")

    def pin(modulus: jax.Array) -> jax.Array:
        stiff = diffeed.put(scene, "sheets.strip.youngs_modulus", modulus)
        return diffeed.simulate(stiff, duration=0.05, dt=1e-4, frames=2).sheets["strip"].nodes[-1]

    place, slope = pin(jnp.zeros(())), jax.jacfwd(pin)(jnp.zeros(()))
    np.testing.assert_allclose(place[-1], (0.0, 0.0), atol=0.01)
    assert np.isfinite(slope).all()
