"""Sheets on guides against independent references: capstan, tip on an incline, curved channel, overhang of a table."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.contact_cases import case, penetration, power_law

import diffeed

CAPSTAN, TIP, CHANNEL, OVERHANG = "c06_capstan", "c09a_tip_on_guide", "c09b_curved_channel", "c11_overhang_liftoff"
DENSITY = 1.4e-6
LAW = power_law(200.0, 1.5)


def at_rest(scene: diffeed.Scene) -> diffeed.Trajectory:
    """What a run shows of the rest state."""
    return diffeed.simulate(scene, 1e-6, 1e-6, 2)


def each(look: Any, scenes: list[diffeed.Scene]) -> Any:
    """look(scene) of every scene, by one compiled program."""
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(look))(diffeed.stack(scenes)))


# --- a sheet drawn slowly around a cylinder -----------------------------------------------------------------------

BAR, STRAIGHT, DRAW, WHILE = 1.6, 30.0, 4.0, 2.0  # mm, mm, mm/s, s
"""A polygon of bars wraps less than the drum: 0.7 % less ratio with 2 mm, 0.4 % with 1.6; half the thickness takes 0.5 %."""
BARS, STEP = 70, 2.5e-3
FRAMES, PASSING = 161, 64  # 0.05 mm per frame, two bars
FLEXIBLE = 1e-6  # share of the bending stiffness


def wound(entry: dict[str, Any], stiffness: float) -> diffeed.Scene:
    """From its lead, drawn along +x at the top, back around the cylinder to its tail, which a dead load holds."""
    given, turn = case(CAPSTAN)["parameters"], entry["beta"]
    behind = (np.arange(BARS) + 0.5) * BAR - STRAIGHT
    sheet = diffeed.Sheet(
        length=BARS * BAR,
        thickness=given["t"],
        width=given["width"],
        density=DENSITY,
        youngs_modulus=stiffness * given["E"],
        structural_damping=2e-3,
        bars=BARS,
        lead=(STRAIGHT, given["R"]),
        headings=np.degrees(np.clip(behind / given["R"], 0.0, turn)),
    )
    motion = diffeed.Motion(times=[0.0, WHILE], displacement=[[0.0, 0.0], [DRAW * WHILE, 0.0]], rotation=[0.0, 0.0])
    # Much faster than the stick speed, and much slower than anything inertia would notice.
    contact = power_law(100.0, 1.5, damping=1.0, stick_speed=0.01)
    return diffeed.Scene(
        sheets={"sheet": sheet},
        guides={
            "drum": diffeed.CircleGuide(center=(0.0, 0.0), radius=given["R"] - 0.5 * given["t"], friction=entry["mu"])
        },
        clamps={"draw": diffeed.Clamp(sheet="sheet", at="lead", free="y", motion=motion)},
        loads={
            "hold": diffeed.Load(
                sheet="sheet", at="tail", force=-entry["T1_N"] * np.array([np.cos(turn), np.sin(turn)])
            )
        },
        contacts={"default": contact},
        gravity=(0.0, 0.0),
        initial="given",
    )


def pull_ratio(friction: Any, scene: diffeed.Scene) -> tuple[Any, Any]:
    """(drawing pull along and across its direction) over the holding pull, and whether the run holds.

    The mean over the last two bars that pass: at rest the clamp carries what contact and load leave.
    """
    scene = diffeed.put(scene, "guides.drum.friction", friction)
    trajectory = diffeed.simulate(scene, WHILE, STEP, FRAMES)
    held = scene.loads["hold"].force
    push = jnp.sum(trajectory.sheets["sheet"].push[-PASSING:], axis=(0, 1)) / PASSING
    return -(push + held) / jnp.sqrt(jnp.sum(held**2)), trajectory.ok


@functools.cache
def drawn() -> list[tuple[np.ndarray, np.ndarray]]:
    """Per stiffness (flexible, real): ratios (sets, 2), and their slopes by friction."""
    entries = case(CAPSTAN)["reference"]

    def with_slope(scene: diffeed.Scene) -> tuple[Any, Any, Any]:
        friction = scene.guides["drum"].friction
        value, slope, ok = jax.jvp(
            lambda f: pull_ratio(f, scene), (friction,), (jnp.ones_like(friction),), has_aux=True
        )
        return value, slope, ok

    ratios, slopes, ok = each(with_slope, [wound(e, s) for s in (FLEXIBLE, 1.0) for e in entries])
    assert np.all(ok)
    n = len(entries)
    return [(ratios[:n], slopes[:n]), (ratios[n:], slopes[n:])]


def assert_drawn_straight(ratios: np.ndarray) -> None:
    np.testing.assert_allclose(ratios[:, 1], 0.0, rtol=0, atol=1e-2)


@pytest.mark.slow
def test_flexible_capstan() -> None:
    """Friction acts on a surface half a thickness inside the axis."""
    entries, (ratios, slopes) = case(CAPSTAN)["reference"], drawn()[0]
    assert_drawn_straight(ratios)
    np.testing.assert_allclose(ratios[:, 0], [e["ratio_flexible_with_thickness_offset"] for e in entries], rtol=1e-2)
    np.testing.assert_allclose(ratios[:, 0], [e["ratio_flexible"] for e in entries], rtol=1e-2)
    np.testing.assert_allclose(slopes[:, 0] / ratios[:, 0], [e["dlnT2_dmu_flexible"] for e in entries], rtol=2e-2)


@pytest.mark.long
def test_capstan_with_bending() -> None:
    """Bending lowers the ratio: wrap is lost at both ends."""
    entries, (ratios, _) = case(CAPSTAN)["reference"], drawn()[1]
    assert_drawn_straight(ratios)
    np.testing.assert_allclose(ratios[:, 0], [e["ratio_with_bending"] for e in entries], rtol=2e-2)
    soft = drawn()[0][0]
    assert np.all(ratios[:3, 0] < soft[:3, 0])


# --- a leading edge that slides up an inclined guide --------------------------------------------------------------


def leaning(entry: dict[str, Any], bars: int, feed: diffeed.Motion | None = None) -> diffeed.Scene:
    """The guide lies so that the tip's axis, not its end circle, ends on the reference's line at the reference's force."""
    given, length = case(TIP)["parameters"], entry["free_length"]
    along = np.array([np.cos(given["guide_angle"]), np.sin(given["guide_angle"])])
    normal = np.array([-along[1], along[0]])
    foot = np.array([given["x0"], 0.0]) - (0.5 * given["t"] - penetration(entry["N_contact"], LAW)) * normal
    # Roughly the bent shape, or the search for the rest state would begin a centimetre deep in the guide.
    ahead = 1.0 - (np.arange(bars) + 0.5) / bars
    headings = entry["tip_angle"] * (2.0 * ahead - ahead**2)
    lead = length / bars * np.array([np.sum(np.cos(headings)), np.sum(np.sin(headings))])
    sheet = diffeed.Sheet(
        length=length,
        thickness=given["t"],
        width=given["width"],
        density=DENSITY,
        youngs_modulus=given["E"],
        bars=bars,
        lead=lead,
        headings=np.degrees(headings),
    )
    level = -float(np.degrees(headings[-1]))
    guide = diffeed.LineGuide(start=foot - 20.0 * along, end=foot + 40.0 * along, friction=entry["mu"])
    return diffeed.Scene(
        sheets={"sheet": sheet},
        guides={"incline": guide},
        clamps={"nip": diffeed.Clamp(sheet="sheet", at="tail", kind="wall", rotation=level, motion=feed)},
        contacts={"default": diffeed.put(LAW, "stick_speed", 0.05)},
        gravity=(0.0, 0.0),
    )


def tips(friction: float) -> list[dict[str, Any]]:
    return [e for e in case(TIP)["reference"] if e["mu"] == friction]


def on_incline(trajectory: diffeed.Trajectory) -> tuple[Any, Any, Any, Any]:
    """Force on the guide, force on the sheet, tip and success, at the last frame."""
    track = trajectory.sheets["sheet"]
    return trajectory.guides["incline"].force[-1], jnp.sum(track.push[-1], axis=0), track.nodes[-1, 0], trajectory.ok


@pytest.mark.parametrize("bars", [20, pytest.param(40, marks=pytest.mark.slow)])
def test_tip_on_incline(bars: int) -> None:
    force, push, tip, ok = each(lambda s: on_incline(at_rest(s)), [leaning(e, bars) for e in tips(0.0)])
    assert np.all(ok)
    np.testing.assert_allclose(force, [e["N_discrete_clampB"][str(bars)] for e in tips(0.0)], rtol=5e-3)
    np.testing.assert_allclose(push, [e["force_on_tip"] for e in tips(0.0)], rtol=5e-3)
    # The chain's own error: of second order, 1e-3 mm at 20 bars.
    np.testing.assert_allclose(tip, [e["tip"] for e in tips(0.0)], rtol=0, atol=1.5e-3 * (20 / bars) ** 2)


@pytest.mark.long
@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.slow), 0.2])
def test_tip_fed_slowly_up_an_incline(friction: float) -> None:
    """The last 3 mm, at 7.5 mm/s; friction takes its full share and points down the guide."""
    bars, duration = 20, 0.4
    feed = diffeed.Motion(times=[0.0, duration], displacement=[[-3.0, 0.0], [0.0, 0.0]], rotation=[0.0, 0.0])

    def fed(scene: diffeed.Scene) -> Any:
        return on_incline(diffeed.simulate(scene, duration, 2e-4, 3))

    force, push, _, ok = each(fed, [leaning(e, bars, feed) for e in tips(friction)])
    assert np.all(ok)
    np.testing.assert_allclose(force, [e["N_discrete_clampB"][str(bars)] for e in tips(friction)], rtol=2e-2)
    np.testing.assert_allclose(push, [e["force_on_tip"] for e in tips(friction)], rtol=2e-2)


# --- a straight sheet forced into a curved channel ----------------------------------------------------------------


def channelled(entry: dict[str, Any], bars: int, inner: str) -> diffeed.Scene:
    """Over the top of the inner guide, ends against the outer one; guides move in by what their contacts give way."""
    given, length = case(CHANNEL)["parameters"], entry["sheet_length"]
    outer_radius = given["Ro"] - penetration(entry["tip_force_N"], LAW)
    inner_radius = given["Ri"] + penetration(entry["middle_force_N"], LAW)
    headings = ((np.arange(bars) + 0.5) / bars - 0.5) * length / inner_radius
    half = length / bars * np.array([np.sum(np.cos(headings[: bars // 2])), np.sum(np.sin(headings[: bars // 2]))])
    sheet = diffeed.Sheet(
        length=length,
        thickness=given["t"],
        width=given["width"],
        density=DENSITY,
        youngs_modulus=given["E"],
        bars=bars,
        lead=np.array([0.0, inner_radius + 0.5 * given["t"] + 0.02]) + half,
        headings=np.degrees(headings),
    )
    place: dict[str, Any] = {"center": (0.0, 0.0), "friction": 0.0}
    span: dict[str, Any] = {"start_angle": 30.0, "sweep": 120.0}
    guides = {
        "outer": diffeed.ArcGuide(radius=outer_radius, side="inside", **place, **span),
        "inner": diffeed.CircleGuide(radius=inner_radius, **place)
        if inner == "circle"
        else diffeed.ArcGuide(radius=inner_radius, side="outside", **place, **span),
    }
    # Nothing else would keep a frictionless sheet from wandering along the channel; by symmetry the pin carries nothing.
    middle = diffeed.Clamp(sheet="sheet", at=bars // 2, kind="pin", free="y")
    return diffeed.Scene(
        sheets={"sheet": sheet},
        guides=guides,
        clamps={"middle": middle},
        contacts={"default": LAW},
        gravity=(0.0, 0.0),
    )


def in_channel(scene: diffeed.Scene) -> tuple[Any, Any, Any, Any]:
    """Forces on outer and inner guide, on each bar, and success."""
    trajectory = at_rest(scene)
    guides = trajectory.guides
    return guides["outer"].force[0], guides["inner"].force[0], trajectory.sheets["sheet"].force[0], trajectory.ok


@pytest.mark.long
@pytest.mark.parametrize(
    ("inner", "bars"), [("arc", 20), ("circle", 20), pytest.param("circle", 40, marks=pytest.mark.slow)]
)
def test_curved_channel(inner: str, bars: int) -> None:
    """Line and arc guides are touched by joints, as in the reference's chain; a circle by the faces beside the joint."""
    entries = case(CHANNEL)["reference"]
    outer, middle, on_bars, ok = each(in_channel, [channelled(e, bars, inner) for e in entries])
    assert np.all(ok)
    np.testing.assert_allclose(0.5 * outer, [e["tip_force_discrete"][str(bars)] for e in entries], rtol=1e-2)
    np.testing.assert_allclose(0.5 * outer, [e["tip_force_N"] for e in entries], rtol=1e-2)
    np.testing.assert_allclose(middle, [e["middle_force_N"] for e in entries], rtol=1e-2)
    between = np.ones(bars, bool)
    between[[0, *range(bars // 2 - 2, bars // 2 + 2), bars - 1]] = False
    assert np.all(on_bars[:, between] == 0.0)
    if inner == "arc":
        np.testing.assert_allclose(0.5 * outer, [e["tip_force_discrete"][str(bars)] for e in entries], rtol=1e-4)


# --- a sheet that lies on a table and hangs over its edge ----------------------------------------------------------

PER_OVERHANG, SHEET_BARS = 10, 44


def overhanging(entry: dict[str, Any], edge: str) -> diffeed.Scene:
    """The edge, at a joint, is the table's own rounded tip, or a circle where the table ends early under the lifted part."""
    given, reach = case(OVERHANG)["parameters"], entry["overhang"]
    length, radius = reach * SHEET_BARS / PER_OVERHANG, 0.015 * reach
    sheet = diffeed.Sheet(
        length=length,
        thickness=given["t"],
        width=given["width"],
        density=given["rho"],
        youngs_modulus=given["E"],
        bars=SHEET_BARS,
        lead=(reach, 0.5 * given["t"]),
    )
    own = edge == "tip"
    table = diffeed.LineGuide(
        start=(-2.0 * length, 0.0), end=(0.0 if own else -0.45 * reach, 0.0), friction=0.5, tip_radius=radius
    )
    guides: dict[str, Any] = {"table": table}
    if not own:
        guides["edge"] = diffeed.CircleGuide(center=(0.0, -radius), radius=radius, friction=0.5)
    return diffeed.Scene(
        sheets={"sheet": sheet},
        guides=guides,
        contacts={"default": power_law(2000.0, 1.5)},
        gravity=(0.0, -given["g"]),
    )


def lying(scene: diffeed.Scene) -> tuple[Any, Any, Any]:
    """Nodes, force on each bar, success."""
    trajectory = at_rest(scene)
    return trajectory.sheets["sheet"].nodes[0], trajectory.sheets["sheet"].force[0], trajectory.ok


@pytest.mark.long
@pytest.mark.parametrize("edge", ["tip", "circle"])
def test_overhang(edge: str) -> None:
    given, entries = case(OVERHANG)["parameters"], case(OVERHANG)["reference"]
    nodes, force, ok = each(lying, [overhanging(e, edge) for e in entries])
    assert np.all(ok)
    np.testing.assert_allclose(0.5 * given["t"] - nodes[:, 0, 1], [e["tip_drop"] for e in entries], rtol=2e-2)
    around = slice(PER_OVERHANG - 1, PER_OVERHANG + 1)
    np.testing.assert_allclose(np.sum(force[:, around], axis=1), [e["edge_force_N"] for e in entries], rtol=2e-2)
    assert np.all(force[:, : PER_OVERHANG - 1] == 0.0)
    for entry, at, carried in zip(entries, nodes, force, strict=True):
        first = PER_OVERHANG + 1 + np.flatnonzero(carried[PER_OVERHANG + 1 :])[0]
        off = abs(-at[first, 0] - entry["lifted_length"])
        assert off <= 1.5 * entry["overhang"] / PER_OVERHANG
    weight = given["weight_per_mm"] * np.array([e["overhang"] for e in entries]) * SHEET_BARS / PER_OVERHANG
    np.testing.assert_allclose(np.sum(force, axis=1), weight, rtol=1e-4)
