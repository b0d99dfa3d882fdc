"""Small vibrations of clamped and free sheets: frequencies and their slopes by linearisation, decay of runs."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.reference import cantilever, half_period, linearised, reference, rest
from scipy.interpolate import CubicSpline

import diffeed

CASE = "c04_vibration"
QUICK = [("cfA", 10), ("cfB", 10), ("ff", 10), ("ff", 80)]
CHAINS = [
    pytest.param(ends, bars, marks=[pytest.mark.slow] * ((ends, bars) not in QUICK))
    for ends in ("cfA", "cfB", "ff")
    for bars in (10, 20, 40, 80)
]


def entry(ends: str) -> dict[str, Any]:
    return next(e for e in reference(CASE)["reference"] if e["kind"] == ends[:2])


def exact_chain(ends: str, bars: int) -> dict[str, Any]:
    return next(c for c in entry(ends)["discrete_chain"] if (c["ends"], c["n_bars"]) == (ends, bars))


def straight(ends: str, bars: int) -> diffeed.Scene:
    given = reference(CASE)["parameters"]
    scene = cantilever(given, bars, ends[2:] or "B", given["L"], damping=given["xi"])
    clamps = scene.clamps if ends != "ff" else {}
    return diffeed.Scene(sheets=scene.sheets, clamps=clamps, gravity=(0.0, 0.0), initial="given")


def elastic(ends: str, frequencies: np.ndarray) -> np.ndarray:
    """Frequencies without the three rigid motions of a free sheet."""
    return frequencies[3:] if ends == "ff" else frequencies


@functools.cache
def model(ends: str, bars: int) -> diffeed.Linearisation:
    return linearised(straight(ends, bars))


@pytest.mark.parametrize(("ends", "bars"), CHAINS)
def test_frequencies(ends: str, bars: int) -> None:
    found, exact = elastic(ends, model(ends, bars).modes()[0])[:3], exact_chain(ends, bars)
    np.testing.assert_allclose(found, exact["omega"], rtol=1e-5)
    off = np.abs(found / entry(ends)["omega"] - 1.0)
    assert np.all(off <= 1.01 * np.abs(exact["rel_err"]) + 1e-9)


def test_frequencies_have_derivatives() -> None:
    """By a stiffer sheet, of which each frequency of a cantilever is the root: d omega/dE = omega / 2 E."""
    scene = straight("cfA", 10)
    state, modulus = diffeed.settle(scene), float(scene.sheets["strip"].youngs_modulus)

    def lowest(modulus: Any) -> Any:
        return diffeed.linearise(diffeed.put(scene, "sheets.strip.youngs_modulus", modulus), state).modes()[0][:3]

    found, slope = jax.jvp(lowest, (modulus,), (1.0,))
    np.testing.assert_allclose(found, model("cfA", 10).modes()[0][:3], rtol=1e-9)
    np.testing.assert_allclose(slope, found / (2.0 * modulus), rtol=1e-6)


def test_free_sheet_has_three_rigid_motions() -> None:
    frequencies = model("ff", 10).modes()[0]
    assert np.max(np.abs(frequencies[:3])) < 1e-3 * frequencies[3]


@pytest.mark.parametrize(("ends", "bars"), CHAINS)
def test_damping_is_proportional(ends: str, bars: int) -> None:
    """C = xi K, so that zeta_j = xi omega_j / 2 in every mode."""
    found, xi = model(ends, bars), reference(CASE)["parameters"]["xi"]
    size = np.max(np.abs(found.stiffness))
    np.testing.assert_allclose(found.damping, xi * np.asarray(found.stiffness), rtol=0, atol=1e-12 * xi * size)
    frequencies, shapes = found.modes()
    modal = np.asarray(found.basis).T @ shapes
    losses = elastic(ends, np.diag(modal.T @ np.asarray(found.damping) @ modal))[:3]
    zeta = losses / (2.0 * elastic(ends, frequencies)[:3])
    np.testing.assert_allclose(zeta, exact_chain(ends, bars)["zeta"], rtol=1e-5)


# --- slopes of frequencies -------------------------------------------------------------------------------------------

FIELDS = ("youngs_modulus", "density", "thickness", "length")


@functools.cache
def frequency_slopes(ends: str, bars: int) -> tuple[np.ndarray, np.ndarray]:
    """Three frequencies and (3, fields) their slopes, differentiated through the linearised model."""
    scene = straight(ends, bars)
    state = rest(scene.sheets["strip"])

    def squares(values: jax.Array) -> jax.Array:
        changed = scene
        for name, value in zip(FIELDS, values, strict=True):
            changed = diffeed.put(changed, f"sheets.strip.{name}", value)
        found = diffeed.linearise(changed, state)
        root = jnp.linalg.cholesky(found.mass)
        half = jax.scipy.linalg.solve_triangular(root, found.stiffness, lower=True)
        matrix = jax.scipy.linalg.solve_triangular(root, half.T, lower=True)
        return jnp.linalg.eigvalsh(0.5 * (matrix + matrix.T))

    values = jnp.array([getattr(scene.sheets["strip"], name) for name in FIELDS])
    by_field = jax.jit(jax.jacfwd(lambda v: (squares(v),) * 2, has_aux=True))(values)
    slopes, square = (elastic(ends, np.asarray(v))[:3] for v in by_field)
    frequencies = np.sqrt(square)
    return frequencies, slopes / (2.0 * frequencies[:, None])


@pytest.mark.parametrize(("ends", "bars"), [("cfA", 10), ("cfB", 10), ("ff", 80)])
def test_frequency_slopes_at_given_bars(ends: str, bars: int) -> None:
    """The chain obeys the continuum's laws: omega goes as sqrt(E / rho), and as 1 / size at one shape."""
    given, (frequencies, slopes) = reference(CASE)["parameters"], frequency_slopes(ends, bars)
    np.testing.assert_allclose(frequencies, exact_chain(ends, bars)["omega"], rtol=1e-5)
    np.testing.assert_allclose(slopes[:, 0], frequencies / (2.0 * given["E"]), rtol=1e-4)
    np.testing.assert_allclose(slopes[:, 1], -frequencies / (2.0 * given["rho"]), rtol=1e-4)
    length = straight(ends, bars).sheets["strip"].length
    np.testing.assert_allclose(given["t"] * slopes[:, 2] + length * slopes[:, 3], -frequencies, rtol=1e-4)


def test_frequency_slopes_against_continuum() -> None:
    """80 bars, free. The slopes by thickness and length are stored for a beam without rotary inertia.

    That takes a share of order (t/L)^2 off the frequency, omega = omega_BE (1 - a t^2/L^2), as t/L^2 (1 - a t^2/L^2).
    """
    exact, (_, slopes) = entry("ff"), frequency_slopes("ff", 80)
    share = 1.0 - np.array(exact["omega"]) / np.array(exact["omega_bernoulli_euler"])
    np.testing.assert_allclose(slopes[:, 0], exact["domega_dE"], rtol=1e-4)
    np.testing.assert_allclose(slopes[:, 1], exact["domega_drho"], rtol=1e-4)
    np.testing.assert_allclose(slopes[:, 2], exact["d_omegaBE_dt"] * (1.0 - 3.0 * share), rtol=1e-4)
    np.testing.assert_allclose(slopes[:, 3], exact["d_omegaBE_dL"] * (1.0 - 2.0 * share), rtol=1e-4)


# --- runs ------------------------------------------------------------------------------------------------------------


def plucked(ends: str, bars: int) -> diffeed.Scene:
    """Bent in its first mode by 1e-3 rad and let go."""
    scene, shapes = straight(ends, bars), model(ends, bars).modes()[1]
    shape = shapes[2:, 3 if ends == "ff" else 0]
    headings = 1e-3 * shape / np.max(np.abs(shape))
    sheet = scene.sheets["strip"]
    rise = sheet.length * np.array([np.mean(np.cos(headings)) - 1.0, np.mean(np.sin(headings))])
    # The root stays where it is, and level: a wall stands at the heading that its bar is written with.
    bent = dataclasses.replace(sheet, lead=np.array(sheet.lead) + rise, headings=np.degrees(headings))
    level = -float(np.degrees(headings[-1]))
    clamps = {name: dataclasses.replace(clamp, rotation=level) for name, clamp in scene.clamps.items()}
    return diffeed.Scene(sheets={"strip": bent}, clamps=clamps, gravity=(0.0, 0.0), initial="given")


def decrement(time: np.ndarray, track: np.ndarray) -> float:
    """Mean loss of the logarithm of the amplitude over a period."""
    curve = CubicSpline(time, track)
    peaks = np.abs(curve(curve.derivative().roots(extrapolate=False)[1:]))
    return float(-2.0 * np.mean(np.diff(np.log(peaks))))


RUNS = {
    "cfA": ("runge_kutta", 0.4, 5e-5),
    "cfB": ("runge_kutta", 0.4, 5e-5),
    "ff": ("runge_kutta", 0.06, 5e-5),
    "ff, linear_euler": ("linear_euler", 0.06, 1e-6),
}
"""Run -> method, duration, step. Linear Euler adds omega dt / 2 to zeta: its step is taken small enough for 1 %."""


@pytest.mark.parametrize("run", RUNS)
def test_plucked(run: str) -> None:
    """The lead's heading crosses zero and decays as the mode does."""
    method, duration, dt = RUNS[run]
    ends = run.split(",")[0]
    exact = exact_chain(ends, 10)
    found = diffeed.simulate(plucked(ends, 10), duration, dt, 401, method)
    assert found.ok
    time, track = np.asarray(found.time), np.asarray(found.sheets["strip"].headings[:, 0])
    np.testing.assert_allclose(2.0 * half_period(time, track), exact["damped_period"][0], rtol=1e-3)
    np.testing.assert_allclose(decrement(time, track), exact["log_decrement"][0], rtol=1e-2)
