"""Rest states against exact elasticas and exact chains: cantilevers, circle, buckling, post-buckling."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.reference import cantilever, chain_of, half_period, linearised, node_positions, reference, strip
from scipy.optimize import brentq
from stand_in_nip import nip

import diffeed

QUICK = [(10, "A"), (10, "B"), (80, "B")]
CHAINS = [
    pytest.param(bars, clamp, marks=[pytest.mark.slow] * ((bars, clamp) not in QUICK))
    for bars in (10, 20, 40, 80)
    for clamp in "AB"
]
HEAVY, LOADED, ROLLED = "c01_heavy_cantilever", "c02a_cantilever_end_load", "c02b_end_moment_circle"
PAST = "rolled past a full turn"
STRETCHED = {"c01 softer": 0.999, "c01 stiffer": 1.001}


def in_full(value: Any) -> Any:
    """A parameter that only the full set of tests runs."""
    return pytest.param(value, marks=pytest.mark.slow)


# --- cantilevers: gravity, end force, end moment ---------------------------------------------------------------------


def heavy(entry: dict[str, Any], bars: int, clamp: str, stretch: float = 1.0) -> diffeed.Scene:
    given = reference(HEAVY)["parameters"]
    given = given | {"E": stretch * given["E"]}
    return cantilever(given, bars, clamp, entry["L"], down=entry["clamp_angle_down"], gravity=given["g"])


def loaded(entry: dict[str, Any], bars: int, clamp: str) -> diffeed.Scene:
    given = reference(LOADED)["parameters"]
    return cantilever(given, bars, clamp, given["L"], force=(0.0, -entry["force_N"]))


def rolled(entry: dict[str, Any], bars: int, clamp: str, times: float = 1.0) -> diffeed.Scene:
    given = reference(ROLLED)["parameters"]
    return cantilever(given, bars, clamp, given["L"], moment=times * entry["moment_Nmm"])


def tip_and_headings(scene: diffeed.Scene) -> tuple[jax.Array, jax.Array]:
    state = diffeed.settle(scene)
    return node_positions(scene.sheets["strip"], state)[0], state.heading


@functools.cache
def settled(bars: int, clamp: str) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
    """Tip (2,) and headings (bars,) of every parameter set of every case, settled by one compiled program."""
    scenes = {(HEAVY, k): heavy(e, bars, clamp) for k, e in enumerate(reference(HEAVY)["reference"])}
    for name, stretch in STRETCHED.items():
        scenes |= {(name, k): heavy(e, bars, clamp, stretch) for k, e in enumerate(reference(HEAVY)["reference"])}
    scenes |= {(LOADED, k): loaded(e, bars, clamp) for k, e in enumerate(reference(LOADED)["reference"])}
    scenes |= {(ROLLED, k): rolled(e, bars, clamp) for k, e in enumerate(reference(ROLLED)["reference"])}
    scenes[PAST, 0] = rolled(reference(ROLLED)["reference"][0], bars, clamp, 10.0)
    tips, headings = jax.jit(jax.vmap(tip_and_headings))(diffeed.stack(list(scenes.values())))
    return dict(zip(scenes, zip(np.asarray(tips), np.asarray(headings), strict=True), strict=True))


@pytest.mark.parametrize(("bars", "clamp"), CHAINS)
def test_heavy_cantilever(bars: int, clamp: str) -> None:
    for k, entry in enumerate(reference(HEAVY)["reference"]):
        exact = chain_of(entry, bars, clamp)
        tip, headings = settled(bars, clamp)[HEAVY, k]
        np.testing.assert_allclose(tip, exact["tip"], rtol=0, atol=1e-9 * entry["L"])
        np.testing.assert_allclose(headings[0], exact["tip_angle"], rtol=0, atol=1e-9)
        off = np.hypot(*(tip - [entry["tip_x"], entry["tip_y"]])) / entry["L"]
        assert off <= 1.3 * entry["discretisation_error_over_L"][clamp][str(bars)]


@pytest.mark.parametrize(("bars", "clamp"), CHAINS)
def test_end_load(bars: int, clamp: str) -> None:
    length = reference(LOADED)["parameters"]["L"]
    for k, entry in enumerate(reference(LOADED)["reference"]):
        exact = chain_of(entry, bars, clamp)
        tip, headings = settled(bars, clamp)[LOADED, k]
        np.testing.assert_allclose(tip, exact["tip"], rtol=0, atol=1e-9 * length)
        np.testing.assert_allclose(headings[0], exact["tip_angle"], rtol=0, atol=1e-9)
        assert np.hypot(*(tip - entry["tip"])) / length <= 1.3 * exact["err"]


@pytest.mark.parametrize(("bars", "clamp"), CHAINS[:-2])
def test_rolled_to_a_circle(bars: int, clamp: str) -> None:
    """Every joint turns by M/k; at one turn the polygon closes, and headings go on past a full turn."""
    length = reference(ROLLED)["parameters"]["L"]
    for k, entry in enumerate(reference(ROLLED)["reference"]):
        exact = chain_of(entry, bars, clamp)
        tip, headings = settled(bars, clamp)[ROLLED, k]
        np.testing.assert_allclose(headings[:-1] - headings[1:], exact["joint_angle"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(headings[0], exact["tip_angle"], rtol=0, atol=1e-9 * bars)
        np.testing.assert_allclose(tip, exact["tip"], rtol=0, atol=1e-8 * length)


def test_rolled_past_a_full_turn() -> None:
    """Two turns and a half: headings do not wrap."""
    headings = settled(10, "B")[PAST, 0][1]
    turn = 10.0 * chain_of(reference(ROLLED)["reference"][0], 10, "B")["joint_angle"]
    np.testing.assert_allclose(headings, turn * np.arange(9.5, 0.0, -1.0), rtol=0, atol=1e-8)
    assert headings[0] > 4.5 * np.pi


def tip_by_modulus(scene: diffeed.Scene, modulus: jax.Array) -> jax.Array:
    return tip_and_headings(diffeed.put(scene, "sheets.strip.youngs_modulus", modulus))[0]


def tip_slopes(bars: int, derivative: Any) -> np.ndarray:
    """(sets, 2) d tip / d E of the heavy cantilevers."""
    scenes = diffeed.stack([heavy(e, bars, "B") for e in reference(HEAVY)["reference"]])
    modulus = jnp.asarray(reference(HEAVY)["parameters"]["E"])
    slope = jax.vmap(derivative(tip_by_modulus, argnums=1), in_axes=(0, None))
    return np.asarray(jax.jit(slope)(scenes, modulus))


@functools.cache
def forward_slopes(bars: int) -> np.ndarray:
    return tip_slopes(bars, jax.jacfwd)


def relative(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Largest error of each row over its largest entry."""
    return np.max(np.abs(found - exact), axis=1) / np.max(np.abs(exact), axis=1)


def test_modulus_slope_against_differences() -> None:
    tips = settled(80, "B")
    step = 2e-3 * reference(HEAVY)["parameters"]["E"]
    sets = range(len(reference(HEAVY)["reference"]))
    differences = np.array([(tips["c01 stiffer", k][0] - tips["c01 softer", k][0]) / step for k in sets])
    assert np.max(relative(forward_slopes(80), differences)) < 1e-4


@pytest.mark.slow
def test_modulus_slope_forward_is_reverse() -> None:
    assert np.max(relative(tip_slopes(80, jax.jacrev), forward_slopes(80))) < 1e-9


def test_modulus_slope_against_continuum() -> None:
    """The chain's own error in the slope is of second order, up to 5e-4 at 80 bars: extrapolate it away."""
    exact = np.array([e["dtip_dE_fixed_L"] for e in reference(HEAVY)["reference"]])
    assert np.max(relative((4.0 * forward_slopes(80) - forward_slopes(40)) / 3.0, exact)) < 1e-4
    assert np.max(relative(forward_slopes(80), exact)) < 6e-4


# --- buckling --------------------------------------------------------------------------------------------------------

ENDS = {"pp": ("pin", "pin"), "cf": ("wall", None), "cc": ("wall", "wall")}
"""Clamps at tail and lead."""


SLOPES = {"pp": lambda s: np.cos(np.pi * s), "cc": lambda s: np.sin(2.0 * np.pi * s)}
"""First buckling modes as slopes along the sheet, tail 0 to lead 1."""


def along(bars: int) -> np.ndarray:
    """Middles of the bars, lead to tail, as shares of the length from the tail."""
    return 1.0 - (np.arange(bars) + 0.5) / bars


def compressed(ends: str, bars: int, load: float, headings: np.ndarray | None = None) -> diffeed.Scene:
    """A straight (or slightly bent, rad) sheet from the origin along x, pushed at its lead by a dead load (N)."""
    given = reference("c03a_euler_loads")["parameters"]
    sheet = strip(given, bars, given["L"], lead=(given["L"], 0.0))
    if headings is not None:
        sheet = strip(given, bars, given["L"], lead=reach(given["L"], headings), headings=np.degrees(headings))
    tail, lead = ENDS[ends]
    clamps = {"tail": diffeed.Clamp(sheet="strip", at="tail", kind=tail)}
    if lead is not None:
        clamps["lead"] = diffeed.Clamp(sheet="strip", at="lead", kind=lead, free="x")
    return diffeed.Scene(
        sheets={"strip": sheet},
        clamps=clamps,
        loads={"push": diffeed.Load(sheet="strip", force=(-load, 0.0))},
        gravity=(0.0, 0.0),
        initial="given",
    )


def reach(length: float, headings: np.ndarray) -> np.ndarray:
    """(2,) from tail to lead."""
    return length * np.array([np.mean(np.cos(headings)), np.mean(np.sin(headings))])


def euler_load(ends: str, bars: int) -> float:
    entries = reference("c03a_euler_loads")["reference"]
    return next(e for e in entries if e["ends"] == ends)["discrete"][str(bars)]["P_N"]


@pytest.mark.parametrize("bars", [in_full(5), 10, in_full(20), in_full(40)])
@pytest.mark.parametrize("ends", ENDS)
def test_euler_load(ends: str, bars: int) -> None:
    exact = euler_load(ends, bars)
    free, pushed = (linearised(compressed(ends, bars, share * exact)) for share in (0.0, 0.5))
    np.testing.assert_allclose(free.buckling_factors(pushed, 0.5)[0], 1.0, rtol=1e-6)
    just_below, just_above = (
        linearised(compressed(ends, bars, exact * (1.0 + d))).modes()[0][0] for d in (-1e-6, 1e-6)
    )
    assert just_below > 0.0 > just_above


@pytest.mark.slow
def test_euler_load_from_a_vibrating_sheet() -> None:
    """Frequency squared falls linearly to zero at the Euler load, here in runs of a pinned sheet."""
    bars, exact, shares = 10, euler_load("pp", 10), np.array([0.0, 0.5])
    bent = 1e-4 * SLOPES["pp"](along(bars))
    scenes = diffeed.stack([compressed("pp", bars, share * exact, bent) for share in shares])
    run = jax.jit(jax.vmap(lambda scene: diffeed.simulate(scene, 0.1, 4e-5, 251, "runge_kutta")))(scenes)
    assert np.all(run.ok)
    tracks = np.asarray(run.sheets["strip"].headings[:, :, 0])
    squares = [half_period(np.asarray(run.time[0]), track) ** -2 for track in tracks]
    found = shares[1] * squares[0] / (squares[0] - squares[1])
    np.testing.assert_allclose(found, 1.0, rtol=1e-3)


# --- post-buckling ---------------------------------------------------------------------------------------------------


def buckled(ends: str, bars: int, shortening: float) -> diffeed.Sheet:
    """A sheet from the origin, bent in its first mode until it is shorter by this share."""
    given = reference("c03b_postbuckling")["parameters"]
    mode = SLOPES[ends](along(bars))
    headings = mode * brentq(lambda a: 1.0 - np.mean(np.cos(a * mode)) - shortening, 0.0, 2.0)
    return strip(given, bars, given["L"], lead=reach(given["L"], headings), headings=np.degrees(headings))


def held(sheet: diffeed.Sheet, ends: str, at: str, **more: Any) -> diffeed.Clamp:
    """A pin, or a wall that holds an end level: written bent, its bar must turn back there."""
    turn = -sheet.headings[-1 if at == "tail" else 0]
    return diffeed.Clamp(sheet="strip", at=at, kind=ENDS[ends][0], rotation=turn, **more)


def end_shortened(ends: str, bars: int, shortening: float) -> diffeed.Scene:
    """Written at four fifths of the shortening; its lead is pushed the rest of the way."""
    sheet = buckled(ends, bars, 0.8 * shortening)
    shift = (1.0 - shortening) * sheet.length - sheet.lead[0]
    clamps = {
        "tail": held(sheet, ends, "tail"),
        "lead": held(sheet, ends, "lead", displacement=(shift, 0.0)),
    }
    return diffeed.Scene(sheets={"strip": sheet}, clamps=clamps, gravity=(0.0, 0.0))


def bending_energy(sheet: diffeed.Sheet, headings: jax.Array, walls: bool) -> jax.Array:
    """N mm, of joints k = E t^3 w / (12 Ls) and of wall joints 2 k that hold both ends level."""
    k = sheet.youngs_modulus * sheet.thickness**3 * sheet.width * sheet.bars / (12.0 * sheet.length)
    energy = 0.5 * k * jnp.sum(jnp.diff(headings) ** 2)
    return energy + k * (headings[0] ** 2 + headings[-1] ** 2) if walls else energy


def energy_by_shift(scene: diffeed.Scene, shift: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Bending energy at a shift of the lead along x; beside it node positions and headings."""
    at = diffeed.put(scene, "clamps.lead.displacement[0]", shift)
    state = diffeed.settle(at)
    sheet = at.sheets["strip"]
    walls = at.clamps["lead"].kind == "wall"
    return bending_energy(sheet, state.heading, walls), (node_positions(sheet, state), state.heading)


@pytest.mark.parametrize("bars", [20, in_full(40), in_full(80)])
@pytest.mark.parametrize("ends", ["pp", "cc"])
def test_postbuckling(ends: str, bars: int) -> None:
    """Shape at a given shortening; the push is the slope of the stored energy (by the material's stiffness) over it."""
    entries = [e for e in reference("c03b_postbuckling")["reference"] if e["ends"] == ends]
    scenes = diffeed.stack([end_shortened(ends, bars, e["shortening_over_L"]) for e in entries])
    shifts = scenes.clamps["lead"].displacement[:, 0]
    pull, (nodes, headings) = jax.jit(jax.vmap(jax.grad(energy_by_shift, argnums=1, has_aux=True)))(scenes, shifts)
    exact = [e["discrete_chain"][str(bars)] for e in entries]
    np.testing.assert_allclose(-pull, [e["P_N"] for e in exact], rtol=1e-5)
    np.testing.assert_allclose(nodes[:, bars // 2, 1], [e["mid_deflection"] for e in exact], rtol=1e-5)
    steepest = np.max(np.abs(headings), axis=1)
    np.testing.assert_allclose(steepest, [e["max_abs_bar_angle"] for e in exact], rtol=1e-5)


def end_loaded(ends: str, bars: int, shortening: float, push: float) -> diffeed.Scene:
    """Written at nine tenths of the shortening; its lead slides under a dead push."""
    sheet = buckled(ends, bars, 0.9 * shortening)
    clamps = {"tail": held(sheet, ends, "tail"), "lead": held(sheet, ends, "lead", free="x")}
    loads = {"push": diffeed.Load(sheet="strip", force=(-push, 0.0))}
    return diffeed.Scene(sheets={"strip": sheet}, clamps=clamps, loads=loads, gravity=(0.0, 0.0))


@pytest.mark.parametrize("bars", [20, in_full(40), in_full(80)])
@pytest.mark.parametrize("ends", ["pp", "cc"])
def test_postbuckling_under_a_dead_push(ends: str, bars: int) -> None:
    """The push to the shortening: a relative change of the push moves it by nearly twice as much, never by less."""
    entries = [e for e in reference("c03b_postbuckling")["reference"] if e["ends"] == ends]
    pushes = [e["discrete_chain"][str(bars)]["P_N"] for e in entries]
    scenes = [end_loaded(ends, bars, e["shortening_over_L"], p) for e, p in zip(entries, pushes, strict=True)]

    def shortening(scene: diffeed.Scene) -> jax.Array:
        nodes = node_positions(scene.sheets["strip"], diffeed.settle(scene))
        return 1.0 - (nodes[0, 0] - nodes[-1, 0]) / scene.sheets["strip"].length

    found = jax.jit(jax.vmap(shortening))(diffeed.stack(scenes))
    np.testing.assert_allclose(found, [e["shortening_over_L"] for e in entries], rtol=0, atol=1e-5)


STOP = diffeed.Contact(stiffness=50.0, exponent=1.0, damping=0.0)


def pushed_to_a_stop(ends: str, bars: int, shortening: float, push: float) -> diffeed.Scene:
    """The tail pushes a lead that slides against a stop, which gives way under the push expected of it."""
    sheet = buckled(ends, bars, 0.98 * shortening)
    # The lead's end circle meets the face half a thickness early and sinks in by what the push takes.
    face = sheet.lead[0] + 0.5 * sheet.thickness - push / STOP.stiffness - 0.5 * STOP.smoothing
    advance = sheet.lead[0] - (1.0 - shortening) * sheet.length
    clamps = {
        "tail": held(sheet, ends, "tail", displacement=(advance, 0.0)),
        "lead": held(sheet, ends, "lead", free="x"),
    }
    guides = {"stop": diffeed.LineGuide(start=(face, -50.0), end=(face, 50.0), friction=0.0)}
    return diffeed.Scene(
        sheets={"strip": sheet}, clamps=clamps, guides=guides, contacts={"default": STOP}, gravity=(0.0, 0.0)
    )


@pytest.mark.slow
@pytest.mark.parametrize("ends", ["pp", "cc"])
def test_pushed_to_a_stop(ends: str) -> None:
    """The same push, felt by a guide."""
    entries = [e for e in reference("c03b_postbuckling")["reference"] if e["ends"] == ends]
    exact = np.array([e["discrete_chain"]["20"]["P_N"] for e in entries])
    scenes = [pushed_to_a_stop(ends, 20, e["shortening_over_L"], p) for e, p in zip(entries, exact, strict=True)]

    def force(scene: diffeed.Scene) -> jax.Array:
        start = diffeed.settle(scene)
        return diffeed.simulate(scene, 1e-6, 1e-6, 2, initial=start).guides["stop"].force[0]

    found = jax.jit(jax.vmap(force))(diffeed.stack(scenes))
    np.testing.assert_allclose(found, exact, rtol=1e-3)


@pytest.mark.slow
def test_a_search_from_a_near_rest_ends_at_the_same_rest_with_the_same_slope() -> None:
    scene = nip(initial="settled")
    near = diffeed.settle(scene)

    def travel(preload, near=None):
        return diffeed.settle(diffeed.put(scene, "rollers.pinch.preload", preload), near=near).travel[0]

    assert float(travel(3.4, near)) == pytest.approx(float(travel(3.4)), rel=1e-10)
    assert abs(float(travel(3.4)) - float(near.travel[0])) > 1e-5
    assert float(jax.grad(travel)(3.4, near)) == pytest.approx(float(jax.grad(travel)(3.4)), rel=1e-9)
    # Where it begins has no part in the answer.
    slopes = jax.grad(travel, argnums=1, allow_int=True)(3.4, near)
    assert max(float(np.max(np.abs(v), initial=0.0)) for v in jax.tree.leaves(slopes) if v.dtype.kind == "f") == 0.0


@pytest.mark.slow
def test_a_rest_has_second_derivatives() -> None:
    """A nip of contacts that stiffen: by both modes over the rule of the search, and by differences."""
    scene = nip(initial="settled")
    scene = diffeed.put(scene, "contacts.default.exponent", 1.5)

    def travel(preload):
        return diffeed.settle(diffeed.put(scene, "rollers.pinch.preload", preload)).travel[0]

    slope = jax.jit(jax.grad(travel))
    apart = float(slope(3.41) - slope(3.39)) / 0.02
    assert abs(apart) > 1e-4
    assert float(jax.grad(slope)(3.4)) == pytest.approx(apart, rel=1e-4)
    assert float(jax.jacfwd(slope)(3.4)) == pytest.approx(apart, rel=1e-4)
