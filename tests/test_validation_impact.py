"""Impacts and sliding against independent references: restitution, a bar that lands obliquely, a block on an incline.

All of these are one rigid bar over one floor, so that they share compiled programs: same names, same number of steps.
A first-order method reaches these tolerances only by extrapolation from two step lengths, which also shows its order.
"""

import functools
from typing import Any

import jax
import numpy as np
import pytest
from cases.contact_cases import NEWTON, case, extrapolated, penetration, plate, power_law, run

import diffeed

ORDER_FOUR, ORDER_ONE = "runge_kutta", "linear_euler"
DROPPED, OBLIQUE, INCLINE = "c07a_hunt_crossley", "c07b_bar_oblique_impact", "c07c_incline_friction"
FRAMES = 41
FEW, MANY, TWICE = ((FRAMES - 1) * n for n in (100, 1280, 2560))
"""Steps of a run."""


def over_floor(
    bar: diffeed.Sheet, contact: diffeed.Contact, friction: float, gravity: tuple[float, float]
) -> diffeed.Scene:
    return diffeed.Scene(
        sheets={"bar": bar},
        guides={"floor": diffeed.LineGuide(start=(-500.0, 0.0), end=(3000.0, 0.0), friction=friction)},
        contacts={"default": contact},
        gravity=gravity,
        initial="given",
    )


# --- a bar that falls flat: each of its two end circles carries half of it ------------------------------------------


def dropped(entry: dict[str, Any]) -> diffeed.Scene:
    """Just touching, so that a damping force that does not vanish at first touch acts from the start."""
    law = power_law(entry["k_c_N_per_mm_m"], entry["m"], damping=entry["c_N_s_per_mm_n1"], damping_exponent=entry["n"])
    bar = plate(2.0 * entry["m_eff"], 20.0, lead=(10.0, 0.05 - 1e-12), velocity=(0.0, -entry["v_impact"]))
    return over_floor(bar, law, 0.0, (0.0, 0.0))


def restitution(trajectory: diffeed.Trajectory) -> Any:
    speed = trajectory.sheets["bar"].velocities[:, 0, 1]
    return -speed[-1] / speed[0]


@functools.cache
def bounces(method: str, steps_per_contact: int, steps: int) -> np.ndarray:
    """(sets,) restitutions."""
    found = []
    for entry in case(DROPPED)["reference"]:
        duration = entry["contact_time"] * steps / steps_per_contact
        found.append(restitution(run(dropped(entry), duration, steps, frames=FRAMES, method=method)))
    return np.array(found)


def exact_restitutions() -> np.ndarray:
    return np.array([e["restitution_clipped"] for e in case(DROPPED)["reference"]])


@pytest.mark.parametrize(("steps_per_contact", "tolerance"), [(200, 1e-3), (2000, 1e-5)])
def test_restitution(steps_per_contact: int, tolerance: float) -> None:
    found = bounces(ORDER_FOUR, steps_per_contact, FEW)
    np.testing.assert_allclose(found, exact_restitutions(), rtol=0, atol=tolerance)


@pytest.mark.slow
def test_restitution_at_first_order() -> None:
    exact = exact_restitutions()
    coarse, fine, finest = (bounces(ORDER_ONE, n, MANY) for n in (200, 400, 2000))
    np.testing.assert_allclose(extrapolated(coarse, fine), exact, rtol=0, atol=1e-3)
    assert np.all(np.abs(finest - exact) < 0.12 * np.abs(coarse - exact))


def test_deepest_penetration() -> None:
    """Forty frames per contact miss the deepest point by up to (pi/80)^2/2 of it."""
    for entry in case(DROPPED)["reference"]:
        track = run(dropped(entry), entry["contact_time"], FEW, frames=FRAMES, method=ORDER_FOUR).sheets["bar"].nodes
        np.testing.assert_allclose(0.05 - np.min(track[:, 0, 1]), entry["max_penetration"], rtol=1.5e-3)


@pytest.mark.slow
def test_restitution_slopes() -> None:
    """By damping and by impact speed, through the whole bounce."""
    entries = [e for e in case(DROPPED)["reference"] if e["m"] == e["n"]]

    def bounce(damping: Any, speed: Any, scene: diffeed.Scene) -> Any:
        scene = diffeed.put(scene, "contacts.default.damping", damping)
        scene = diffeed.put(scene, "sheets.bar.velocity[1]", -speed)
        return restitution(diffeed.simulate(scene, 2e-3, 1.5e-6, 3, ORDER_FOUR))

    scenes = diffeed.stack([dropped(e) for e in entries])
    speeds = -scenes.sheets["bar"].velocity[:, 1]
    slopes = jax.jit(jax.vmap(jax.jacfwd(bounce, argnums=(0, 1))))(scenes.contacts["default"].damping, speeds, scenes)
    np.testing.assert_allclose(slopes[0], [e["de_dc"] for e in entries], rtol=1e-2)
    np.testing.assert_allclose(slopes[1], [e["de_dv"] for e in entries], rtol=1e-2)


# --- a bar that lands on one end ----------------------------------------------------------------------------------


def tilted() -> diffeed.Scene:
    """Heights count from the bar's centre less half its thickness; its left end touches at the start."""
    given = case(OBLIQUE)["parameters"]
    half, angle = 0.5 * given["L"], given["th0"]
    law = power_law(given["k_c"], given["m"], damping=given["c"], damping_exponent=given["n"])
    bar = plate(
        given["mass"],
        given["L"],
        thickness=given["t"],
        lead=(half * np.cos(angle), 2.0 * half * np.sin(angle) + 0.5 * given["t"]),
        heading=np.degrees(angle),
        velocity=(0.0, -given["v"]),
    )
    return over_floor(bar, law, 0.0, (0.0, 0.0))


def landing(method: str, steps: int) -> dict[str, np.ndarray]:
    """What the reference lists, and the speed along the floor."""
    exact, half_thickness = case(OBLIQUE)["reference"], 0.5 * case(OBLIQUE)["parameters"]["t"]
    trajectory = run(tilted(), exact["t"][-1], steps, frames=FRAMES, method=method)
    np.testing.assert_allclose(trajectory.time, exact["t"], rtol=1e-12)
    track = trajectory.sheets["bar"]
    found = {
        "y": np.mean(track.nodes[:, :, 1], axis=1) - half_thickness,
        "th": track.headings[:, 0],
        "vy": np.mean(track.velocities[:, :, 1], axis=1),
        "omega": track.rates[:, 0],
        "vx": np.mean(track.velocities[:, :, 0], axis=1),
    }
    return {k: np.asarray(v) for k, v in found.items()}


def test_oblique_impact() -> None:
    """At 200 steps per contact; nothing pushes along the floor, and nothing moves along it."""
    exact, found = case(OBLIQUE)["reference"], landing(ORDER_FOUR, (FRAMES - 1) * 640)
    for name in ("y", "th", "vy", "omega"):
        # Relative to the largest value of the run: all of them pass through zero.
        atol = 1e-3 * np.max(np.abs(exact[name]))
        np.testing.assert_allclose(found[name], exact[name], rtol=0, atol=atol, err_msg=name)
        np.testing.assert_allclose(found[name][-1], exact[name][-1], rtol=1e-3, err_msg=name)
    np.testing.assert_allclose(found["vx"], 0.0, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_oblique_impact_at_first_order() -> None:
    exact, found = case(OBLIQUE)["reference"], extrapolated(landing(ORDER_ONE, MANY), landing(ORDER_ONE, TWICE))
    for name in ("y", "th", "vy", "omega"):
        np.testing.assert_allclose(found[name][-1], exact[name][-1], rtol=1e-3, err_msg=name)
    np.testing.assert_allclose(found["vx"], 0.0, rtol=0, atol=1e-9)


# --- a block on an incline ----------------------------------------------------------------------------------------

LAWS = ("tanh", "sqrt")
STIFFNESS = 1.0
"""N/mm: the block's own friction tilts it by 1e-6 rad."""


def sliding(entry: dict[str, Any]) -> diffeed.Scene:
    """Gravity leans instead of the floor; the block starts at its static penetration."""
    given, lean = case(INCLINE)["parameters"], np.radians(entry["angle_deg"])
    contact = power_law(STIFFNESS, 1.0, stick_speed=given["vs"], friction_law=entry["law"])
    on_each_end = 0.5 * given["m"] * given["g"] * np.cos(lean) / NEWTON
    height = 0.5 * given["t"] - penetration(on_each_end, contact)
    block = plate(given["m"], given["L"], thickness=given["t"], lead=(0.0, height), velocity=(0.0, 0.0))
    return over_floor(block, contact, given["mu"], (given["g"] * np.sin(lean), -given["g"] * np.cos(lean)))


def inclines(law: str) -> list[dict[str, Any]]:
    return [e for e in case(INCLINE)["reference"] if e["law"] == law]


def slide(entry: dict[str, Any], steps: int, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Travel and speed of the block at the reference's times: every other frame."""
    trajectory = run(sliding(entry), entry["t"][-1], steps, frames=FRAMES, method=method)
    np.testing.assert_allclose(trajectory.time[::2], entry["t"], rtol=1e-9)
    track = trajectory.sheets["bar"]
    return np.asarray(track.nodes[::2, 0, 0]), np.asarray(track.velocities[::2, 0, 0])


def assert_slid(entry: dict[str, Any], travel: np.ndarray, speed: np.ndarray) -> None:
    np.testing.assert_allclose(travel, entry["x"], rtol=0, atol=1e-4 * entry["x"][-1])
    np.testing.assert_allclose(speed, entry["v"], rtol=0, atol=1e-4 * entry["v"][-1])


@pytest.mark.parametrize("law", LAWS)
def test_incline(law: str) -> None:
    for entry in inclines(law):
        assert_slid(entry, *slide(entry, FEW, ORDER_FOUR))


@pytest.mark.slow
def test_incline_at_first_order() -> None:
    for entry in inclines("sqrt"):
        assert_slid(entry, *extrapolated(slide(entry, MANY, ORDER_ONE), slide(entry, TWICE, ORDER_ONE)))


@pytest.mark.parametrize(
    ("law", "method", "steps"), [*((law, ORDER_FOUR, FEW) for law in LAWS), ("sqrt", ORDER_ONE, MANY)]
)
def test_creep_and_slip(law: str, method: str, steps: int) -> None:
    """Held, the block creeps at a speed that the step does not change; slipping, it accelerates as Coulomb has it."""
    for entry in inclines(law):
        trajectory = run(sliding(entry), 0.8, steps, frames=FRAMES, method=method)
        speed = trajectory.sheets["bar"].velocities[:, 0, 0]
        if entry["regime"] == "slip":
            acceleration = (speed[-1] - speed[-5]) / (trajectory.time[-1] - trajectory.time[-5])
            np.testing.assert_allclose(acceleration, entry["a_slip"], rtol=1e-4)
        else:
            np.testing.assert_allclose(speed[-1], entry["v_creep"], rtol=1e-4)


@pytest.mark.slow
def test_creep_slope() -> None:
    """Creep speed by friction coefficient."""

    def creep(friction: Any, scene: diffeed.Scene) -> Any:
        scene = diffeed.put(scene, "guides.floor.friction", friction)
        return diffeed.simulate(scene, 0.8, 2e-4, 3, ORDER_ONE).sheets["bar"].velocities[-1, 0, 0]

    entries = [e for e in inclines("sqrt") if e["regime"] != "slip"]
    scenes = diffeed.stack([sliding(e) for e in entries])
    slopes = jax.jit(jax.vmap(jax.jacfwd(creep)))(scenes.guides["floor"].friction, scenes)
    np.testing.assert_allclose(slopes, [e["dv_creep_dmu"] for e in entries], rtol=1e-4)
