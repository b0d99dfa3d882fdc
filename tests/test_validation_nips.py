"""Nips against independent references: slip of one and of two, an idle roller that spins up, a sprung roller's load
and vibration."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.contact_cases import NEWTON, case, extrapolated, penetration, plate, power_law, run
from scipy.optimize import brentq

import diffeed

ORDER_FOUR, ORDER_ONE = "runge_kutta", "linear_euler"
SINGLE, DOUBLE, SPUN, SPRUNG = "c08a_single_nip", "c08b_two_nips", "c08c_idle_roller_spinup", "c10_movable_roller"
RADIUS = 20.0


def grip(name: str, law: str = "tanh", **more: Any) -> diffeed.Contact:
    """Linear springs, with the stick speed of a case."""
    given = {"damping": 0.02, "damping_exponent": 0.0} | more
    return power_law(200.0, 1.0, stick_speed=case(name)["parameters"]["vs"], friction_law=law, **given)


def nip(
    name: str,
    x: float,
    speed: float,
    force: float,
    friction: float,
    follower: float,
    sheet: diffeed.Sheet,
    contact: Any,
) -> dict[str, Any]:
    """A drive below and a sprung follower above, already spinning, both pressed in as far as the force takes."""
    away = RADIUS + 0.5 * sheet.thickness - penetration(force, contact)
    drive = diffeed.FixedRoller(center=(x, -away), radius=RADIUS, friction=friction, surface_speed=-speed)
    pinch = diffeed.MovableRoller(
        center=(x, away),
        direction=(0.0, 1.0),
        radius=RADIUS,
        mass=0.01,
        inertia=0.05,
        preload=force,
        friction=follower,
        spin=sheet.speed / RADIUS,
    )
    return {f"drive{name}": drive, f"pinch{name}": pinch}


def slip_at(share: float, law: str) -> float:
    """Slip over stick speed at which friction has this share of its largest value."""
    return float(np.arctanh(share)) if law == "tanh" else share / float(np.sqrt(1.0 - share**2))


@pytest.mark.long
@pytest.mark.parametrize("bars", [2, 5, 10, 20])
def test_a_weightless_sheet_rests_in_a_nip_wherever_its_joints_are(bars):
    """With a joint exactly between the rollers too, where rounding alone says which bar they press."""

    @jax.jit
    @jax.vmap
    def rest(lead: jax.Array) -> tuple[jax.Array, jax.Array]:
        sheet = diffeed.Sheet(
            length=100.0, thickness=0.2, width=50.0, density=1e-6, youngs_modulus=2000.0, bars=bars,
            lead=jnp.stack([lead, jnp.zeros(())]),
        )  # fmt: skip
        contact = power_law(200.0, 1.0)
        rollers = nip("", 0.0, 100.0, 1.0, 0.5, 0.5, sheet, contact)
        scene = diffeed.Scene(sheets={"s": sheet}, rollers=rollers, contacts={"default": contact}, gravity=(0.0, 0.0))
        state = diffeed.settle(scene)
        return state.travel[0], jnp.max(jnp.abs(state.heading))

    travel, turned = rest(jnp.asarray(np.concatenate([100.0 / bars * np.arange(bars + 1), [33.3]])))
    np.testing.assert_allclose(travel, np.full(travel.shape, travel[-1]), atol=1e-9)
    assert np.max(np.abs(turned)) < 1e-9


def steady(values: Any) -> float:
    """Mean over the last frames."""
    return float(np.mean(np.asarray(values)[-5:]))


# --- one nip against a drag ---------------------------------------------------------------------------------------

FEW, MANY, TWICE = (20 * n for n in (400, 2560, 5120))
"""Steps of a run; frames are 21."""


def dragged(entry: dict[str, Any], speed: float = 0.0, follower: float = 0.0, **law: Any) -> diffeed.Scene:
    """A sheet so long that it hardly turns under the friction on one of its faces; a push forwards acts on its lead."""
    given, contact = case(SINGLE)["parameters"], grip(SINGLE, **law)
    sheet = plate(given["sheet_mass"], 2000.0, thickness=0.02, lead=(1000.0, 0.0), speed=speed)
    drag, push = max(entry["F_N"], 0.0), max(-entry["F_N"], 0.0)
    return diffeed.Scene(
        sheets={"sheet": sheet},
        rollers=nip("", 0.0, given["V"], given["N"], given["mu"], follower, sheet, contact),
        loads={
            "drag": diffeed.Load(sheet="sheet", at="tail", force=(-drag, 0.0)),
            "push": diffeed.Load(sheet="sheet", at="lead", force=(push, 0.0)),
        },
        contacts={"default": contact},
        gravity=(0.0, 0.0),
        initial="given",
    )


def started(entry: dict[str, Any], steps: int, method: str) -> np.ndarray:
    """Speeds at the reference's times, from rest. A follower without friction stands for one without inertia."""
    trajectory = run(dragged(entry), entry["t"][-1], steps, frames=21, method=method)
    np.testing.assert_allclose(trajectory.time, entry["t"], rtol=1e-9)
    np.testing.assert_allclose(trajectory.rollers["drive"].force, case(SINGLE)["parameters"]["N"], rtol=1e-4)
    return np.asarray(trajectory.sheets["sheet"].velocities[:, 0, 0])


def assert_started(found: Any, entry: dict[str, Any]) -> None:
    np.testing.assert_allclose(found, entry["v"], rtol=0, atol=1e-3 * case(SINGLE)["parameters"]["V"])


def test_start_of_a_nip() -> None:
    """The last parameter set is overloaded: the sheet is pulled out backwards."""
    for entry in case(SINGLE)["reference"]:
        assert_started(started(entry, FEW, ORDER_FOUR), entry)


@pytest.mark.slow
def test_start_of_a_nip_at_first_order() -> None:
    for entry in case(SINGLE)["reference"]:
        assert_started(extrapolated(started(entry, MANY, ORDER_ONE), started(entry, TWICE, ORDER_ONE)), entry)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "method", "steps", "duration"),
    [("tanh", ORDER_FOUR, FEW, 3e-3), ("tanh", ORDER_ONE, MANY, 0.2), ("sqrt", ORDER_ONE, MANY, 0.2)],
)
def test_slip_of_a_nip(law: str, method: str, steps: int, duration: float) -> None:
    """A rubbing follower on a bearing without drag comes along and takes nothing."""
    given, key = case(SINGLE)["parameters"], {"tanh": "slip_steady", "sqrt": "slip_steady_sqrt_law"}[law]
    for entry in case(SINGLE)["reference"]:
        if entry[key] is None:
            continue
        damping = 0.02 if method == ORDER_FOUR else 0.5
        scene = dragged(entry, given["V"] - 0.98 * entry[key], given["mu"], law=law, damping=damping)
        trajectory = run(scene, duration, steps, frames=21, method=method)
        slip, force = (steady(getattr(trajectory.rollers["drive"], k)) for k in ("slip", "force"))
        exact = given["vs"] * slip_at(entry["F_N"] / (given["mu"] * force), law)
        np.testing.assert_allclose(slip, exact, rtol=0, atol=1e-4 * given["vs"])
        np.testing.assert_allclose(force, given["N"], rtol=1e-4)
        turning = steady(trajectory.rollers["pinch"].angular_velocity) * RADIUS
        np.testing.assert_allclose(turning, steady(trajectory.sheets["sheet"].velocities[:, 0, 0]), rtol=1e-6)


@pytest.mark.slow
def test_slopes_of_slip() -> None:
    """By drag and by friction coefficient."""
    given = case(SINGLE)["parameters"]
    entries = [e for e in case(SINGLE)["reference"] if 0.0 < e["F_over_muN"] < 0.95]

    def slip(drag: Any, friction: Any, scene: diffeed.Scene) -> Any:
        scene = diffeed.put(scene, "loads.drag.force[0]", -drag)
        scene = diffeed.put(scene, "rollers.drive.friction", friction)
        return diffeed.simulate(scene, 0.01, 1e-5, 2, ORDER_ONE).rollers["drive"].slip[-1]

    scenes = diffeed.stack([dragged(e, e["v_steady"], damping=0.5) for e in entries])
    drags, frictions = (np.array(v) for v in zip(*((e["F_N"], given["mu"]) for e in entries), strict=True))
    slopes = jax.jit(jax.vmap(jax.jacfwd(slip, argnums=(0, 1))))(drags, frictions, scenes)
    np.testing.assert_allclose(slopes[0], [e["dslip_dF_per_N"] for e in entries], rtol=1e-3)
    np.testing.assert_allclose(slopes[1], [e["dslip_dmu"] for e in entries], rtol=1e-3)


# --- two nips on one sheet ----------------------------------------------------------------------------------------


def paced(entry: dict[str, Any]) -> diffeed.Scene:
    """A stiff sheet, so that the slower second nip of the last parameter set does not buckle it."""
    given, contact = case(DOUBLE)["parameters"], grip(DOUBLE, damping=0.05)
    sheet = plate(
        2.2e-3, 400.0, thickness=0.02, width=200.0, youngs_modulus=4e7, bars=8, lead=(200.0, 0.0), speed=entry["v"]
    )
    first = nip("1", -75.0, entry["V1"], entry["N1"], given["mu"], given["mu"], sheet, contact)
    second = nip("2", 75.0, entry["V2"], entry["N2"], given["mu"], given["mu"], sheet, contact)
    return diffeed.Scene(
        sheets={"sheet": sheet},
        rollers=first | second,
        loads={"drag": diffeed.Load(sheet="sheet", at="tail", force=(-entry["F_N"], 0.0))},
        contacts={"default": contact},
        gravity=(0.0, 0.0),
        initial="given",
    )


def balanced(entry: dict[str, Any], forces: list[float]) -> float:
    """Speed at which the two frictions carry the drag, at these nip forces."""
    given, speeds = case(DOUBLE)["parameters"], (entry["V1"], entry["V2"])

    def excess(v: float) -> float:
        pulls = [n * np.tanh((s - v) / given["vs"]) for n, s in zip(forces, speeds, strict=True)]
        return given["mu"] * sum(pulls) - entry["F_N"]

    return brentq(excess, min(speeds) - 20.0, max(speeds) + 20.0, xtol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "dt", "duration"),
    [pytest.param(ORDER_FOUR, 5e-7, 0.01, marks=pytest.mark.slow), (ORDER_ONE, 1e-5, 0.05)],
)
def test_two_nips(method: str, dt: float, duration: float) -> None:
    for entry in case(DOUBLE)["reference"]:
        trajectory = run(paced(entry), duration, round(duration / dt), frames=11, method=method)
        drives = [trajectory.rollers[f"drive{k}"] for k in (1, 2)]
        forces, frictions = ([steady(getattr(d, k)) for d in drives] for k in ("force", "friction"))
        speed = steady(np.mean(trajectory.sheets["sheet"].velocities[:, :, 0], axis=1))
        atol = 1e-3 * case(DOUBLE)["parameters"]["vs"]
        np.testing.assert_allclose(forces, [entry["N1"], entry["N2"]], rtol=2e-4)
        np.testing.assert_allclose(speed, balanced(entry, forces), rtol=0, atol=atol)
        np.testing.assert_allclose(speed, entry["v"], rtol=0, atol=atol)
        np.testing.assert_allclose(frictions, [entry["force1_N"], entry["force2_N"]], rtol=1e-2)


# --- an idle roller on a passing sheet ----------------------------------------------------------------------------


def passing(kind: str) -> diffeed.Scene:
    """A held bar moves along under a roller that is pressed on it: by its place, or by its preload."""
    given, contact = case(SPUN)["parameters"], grip(SPUN)
    sheet = plate(1e-4, 20.0, lead=(10.0, 0.0), speed=given["V"])
    away = given["R"] + 0.5 * sheet.thickness - penetration(given["N"], contact)
    own = {"center": (0.0, away), "radius": given["R"], "friction": given["mu"], "inertia": given["J"]}
    roller = diffeed.FixedRoller(**own)
    if kind == "movable":
        roller = diffeed.MovableRoller(**own, direction=(0.0, 1.0), mass=0.01, preload=given["N"])
    feed = diffeed.Motion(times=[0.0, 1.0], displacement=[[0.0, 0.0], [given["V"], 0.0]], rotation=[0.0, 0.0])
    return diffeed.Scene(
        sheets={"sheet": sheet},
        rollers={"idle": roller},
        clamps={"feed": diffeed.Clamp(sheet="sheet", at=0, kind="bar", motion=feed)},
        contacts={"default": contact},
        gravity=(0.0, 0.0),
        initial="given",
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "method", "steps"), [("fixed", ORDER_FOUR, 30 * 50), ("movable", ORDER_ONE, 30 * 1000)]
)
def test_spin_up(kind: str, method: str, steps: int) -> None:
    """Half of the work goes into heat, half into the roller."""
    given, exact = case(SPUN)["parameters"], case(SPUN)["reference"]
    trajectory = run(passing(kind), exact["t"][-1], steps, frames=31, method=method, observe=("energy",))
    np.testing.assert_allclose(trajectory.time, exact["t"], rtol=1e-9)
    track = trajectory.rollers["idle"]
    surface = np.asarray(track.angular_velocity) * given["R"]
    np.testing.assert_allclose(surface, exact["u"], rtol=0, atol=1e-3 * given["V"])
    early, exactly = (np.interp(0.9 * given["V"], u, exact["t"]) for u in (surface, exact["u"]))
    np.testing.assert_allclose(early, exactly, rtol=1e-3)
    np.testing.assert_allclose(track.force, given["N"], rtol=1e-6)
    kinetic = 0.5 * given["J"] * track.angular_velocity[-1] ** 2 / NEWTON
    np.testing.assert_allclose(trajectory.observed["energy"]["friction"], kinetic, rtol=1e-3)


# --- a sprung roller ----------------------------------------------------------------------------------------------

CORE = 8.0
"""Radius of its rollers."""


def sprung(entry: dict[str, Any], below: str) -> diffeed.Scene:
    """A sprung roller that just touches, at travel 0, a fixed roller, a held bar, or a loose bar on a fixed roller."""
    thickness = 0.0 if below == "roller" else 0.1
    lead = (1000.0, 0.0) if below == "roller" else (10.0, 0.0)  # far off: not part of the case
    pinch = diffeed.MovableRoller(
        center=(0.0, CORE + 0.5 * thickness),
        direction=(0.0, 1.0),
        radius=CORE,
        mass=entry["m_r"],
        inertia=0.1,
        spring=entry["k_s"],
        preload=entry["P0"],
        friction=0.0,
    )
    base = diffeed.FixedRoller(center=(0.0, -CORE - 0.5 * thickness), radius=CORE, friction=0.0, angular_speed=0.0)
    return diffeed.Scene(
        sheets={"bar": plate(entry["m_bar"], 20.0, lead=lead)},
        rollers={"pinch": pinch} if below == "held bar" else {"pinch": pinch, "base": base},
        clamps={"grip": diffeed.Clamp(sheet="bar", at=0, kind="bar")} if below == "held bar" else {},
        contacts={"default": power_law(entry["k_c"], entry["m"], damping=entry["c"], damping_exponent=entry["n"])},
        gravity=(0.0, 0.0),
        initial="given",
    )


def nip_load(entry: dict[str, Any], travel: Any) -> Any:
    """Force of the spring, N."""
    return entry["P0"] + entry["k_s"] * travel


@functools.cache
def settled(below: str) -> tuple[np.ndarray, list[diffeed.Linearisation]]:
    """Travel at rest and small vibrations about it, per parameter set."""

    @jax.jit
    @jax.vmap
    def rest(scene: diffeed.Scene) -> tuple[Any, diffeed.Linearisation]:
        state = diffeed.settle(scene)
        return state.travel[0], diffeed.linearise(scene, state)

    travels, about = rest(diffeed.stack([sprung(e, below) for e in case(SPRUNG)["reference"]]))
    return np.asarray(travels), [jax.tree.map(lambda v, k=k: v[k], about) for k in range(len(travels))]


@pytest.mark.parametrize("below", ["roller", pytest.param("held bar", marks=pytest.mark.slow), "loose bar"])
def test_nip_load_and_frequency(below: str) -> None:
    travels, about = settled(below)
    for k, entry in enumerate(case(SPRUNG)["reference"]):
        exact = entry["with_bar_between"] if below == "loose bar" else entry["one_contact"]
        depth = 2.0 * exact["delta_each"] if below == "loose bar" else exact["delta"]
        np.testing.assert_allclose(-travels[k], depth, rtol=1e-6)
        np.testing.assert_allclose(nip_load(entry, travels[k]), exact["nip_load_N"], rtol=1e-6)
        found = about[k].modes()[0]
        for frequency in exact.get("omegas", [exact.get("omega")]):
            np.testing.assert_allclose(found[np.argmin(np.abs(found - frequency))], frequency, rtol=1e-3)


@pytest.mark.slow
def test_nip_load_that_a_run_reports() -> None:
    """Both faces of a loose bar carry it."""
    scenes = diffeed.stack([sprung(e, "loose bar") for e in case(SPRUNG)["reference"]])

    def forces(scene: diffeed.Scene) -> tuple[Any, Any]:
        rollers = diffeed.simulate(scene, 1e-6, 1e-6, 2, initial=diffeed.settle(scene)).rollers
        return rollers["pinch"].force[0], rollers["base"].force[0]

    for found in jax.jit(jax.vmap(forces))(scenes):
        exact = [e["with_bar_between"]["nip_load_N"] for e in case(SPRUNG)["reference"]]
        np.testing.assert_allclose(found, exact, rtol=1e-6)


@pytest.mark.slow
def test_slopes_of_nip_load() -> None:
    """By preload and by spring stiffness, through the rest state."""

    def load(preload: Any, spring: Any, scene: diffeed.Scene) -> Any:
        scene = diffeed.put(diffeed.put(scene, "rollers.pinch.preload", preload), "rollers.pinch.spring", spring)
        return preload + spring * diffeed.settle(scene).travel[0]

    entries = case(SPRUNG)["reference"]
    scenes = diffeed.stack([sprung(e, "held bar") for e in entries])
    values = (np.array([e[k] for e in entries]) for k in ("P0", "k_s"))
    slopes = jax.jit(jax.vmap(jax.grad(load, argnums=(0, 1))))(*values, scenes)
    np.testing.assert_allclose(slopes[0], [e["one_contact"]["dN_dP0"] for e in entries], rtol=1e-6)
    np.testing.assert_allclose(slopes[1], [e["one_contact"]["dN_dks_mm"] for e in entries], rtol=1e-6)


def released(entry: dict[str, Any], steps: int, method: str, below: str) -> np.ndarray:
    """Depth at the reference's times, from first touch at rest."""
    exact = entry["release_from_touch_one_contact"]
    trajectory = run(sprung(entry, below), exact["t"][-1], steps, frames=61, method=method)
    np.testing.assert_allclose(trajectory.time, exact["t"], rtol=1e-9)
    return -np.asarray(trajectory.rollers["pinch"].travel)


def assert_released(entry: dict[str, Any], found: np.ndarray) -> None:
    exact = entry["release_from_touch_one_contact"]["delta"]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-3 * entry["one_contact"]["delta"])


@pytest.mark.parametrize("below", ["roller", pytest.param("held bar", marks=pytest.mark.slow)])
def test_release_from_touch(below: str) -> None:
    for entry in case(SPRUNG)["reference"]:
        found = released(entry, 60 * 50, ORDER_FOUR, below)
        assert_released(entry, found)
        if entry["c"] == 0.0:
            exact = entry["release_from_touch_one_contact"]["max_penetration_undamped"]
            # Ten frames per period miss the deepest point by up to (pi/20)^2/2 of its half.
            np.testing.assert_allclose(np.max(found), exact, rtol=7e-3)


@pytest.mark.long
def test_release_from_touch_at_first_order() -> None:
    for entry in case(SPRUNG)["reference"]:
        coarse, fine = (released(entry, 60 * n, ORDER_ONE, "roller") for n in (400, 800))
        assert_released(entry, extrapolated(coarse, fine))
