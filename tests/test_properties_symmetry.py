"""What must not depend on where the machine stands, who numbers its parts and which units are used.

Rows of the list of properties: 1 to 6, 8 to 10 and 24.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.differentials import change_of, forward
from cases.scenes import DT, DURATION, FRAMES, HIGH_ORDER, METHODS, ROUNDING, STRUCTURES, clamped, draw, run
from cases.transforms import (
    carried,
    difference,
    dimensions,
    in_units,
    map_numbers,
    mirrored,
    outputs,
    rescaled,
    reversed_sheets,
    shifted,
    turned,
    width_exponents,
)

import diffeed
from diffeed.base.records import replace

TIMES = np.linspace(0.0, DURATION, FRAMES)
SEEDS = (0, 1, 2)
every_case = pytest.mark.parametrize(
    ("structure", "method", "seed"), [(s, m, k) for s in STRUCTURES for m in METHODS for k in SEEDS]
)


@pytest.mark.long
@every_case
def test_place_does_not_matter(structure, method, seed):
    # 1e-9: coordinates of 1e3 mm are rounded to 1e-13 mm, a penetration of 0.01 mm to 1e-11 of itself.
    scene = draw(structure, seed)
    by = np.random.default_rng(seed).uniform(-1e3, 1e3, 2)
    expected = shifted(outputs(run(scene, method)), by)
    assert difference(expected, outputs(run(shifted(scene, by), method))) < 1e-9


@pytest.mark.long
@every_case
@pytest.mark.parametrize("angle", [0.7, np.pi, -8.0])
def test_direction_does_not_matter(structure, method, seed, angle):
    scene = draw(structure, seed)
    expected = turned(outputs(run(scene, method)), angle)
    assert difference(expected, outputs(run(turned(scene, angle), method))) < 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_rolled_up_sheet_does_not_wrap(method):
    """Two turns from lead to tail: headings keep counting, and turn with the scene."""
    scene = draw("free_sheet", 3)
    paper = replace(scene.sheets["paper"], headings=jnp.linspace(0.0, 800.0, 6), curl=jnp.deg2rad(-160.0) / 10.0)
    scene = replace(scene, sheets={"paper": paper})
    out = outputs(run(scene, method))
    headings = np.asarray(out["sheets.paper"].headings)
    assert np.ptp(headings[-1]) > 4.0 * np.pi
    for angle in (0.7, np.pi):
        assert difference(turned(out, angle), outputs(run(turned(scene, angle), method))) < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("structure", ["free_sheet", "guided"])
@pytest.mark.parametrize("seed", SEEDS)
def test_common_velocity_does_not_matter(structure, method, seed):
    """Sheets, guides and shafts all move on with one velocity (a sprung roller cannot, so no nip here)."""
    scene, velocity = draw(structure, seed), np.random.default_rng(seed).uniform(-500.0, 500.0, 2)
    expected = carried(outputs(run(scene, method)), velocity, TIMES)
    assert difference(expected, outputs(run(carried(scene, velocity, None), method))) < 1e-9


@pytest.mark.long
@every_case
def test_mirror_image(structure, method, seed):
    scene = draw(structure, seed)
    expected = mirrored(outputs(run(scene, method)))
    assert difference(expected, outputs(run(mirrored(scene), method))) < 1e-10


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_free_sheet_numbered_from_the_other_end(method, seed):
    scene = draw("free_sheet", seed)
    assert _reversal_error(scene, method) < 1e-9 * 60.0


def _frictionless(scene):
    sheets = {name: replace(sheet, friction_factor=jnp.zeros(())) for name, sheet in scene.sheets.items()}
    return replace(scene, sheets=sheets)


def _reversal_error(scene, method, **options):
    """mm: largest distance between a node and the same node numbered from the other end."""
    one = outputs(run(scene, method, **options))
    other = outputs(run(reversed_sheets(scene), method, **options))
    names = [key for key in one if key.startswith("sheets")]
    return max(float(jnp.max(jnp.abs(one[k].nodes - other[k].nodes[:, ::-1]))) for k in names)


# Friction is left out: a joint's end circle belongs to one of its two bars, which alone feels its friction's moment
# f t/2, and that bar is another one when numbered from the other end.
@pytest.mark.parametrize("method", HIGH_ORDER)
@pytest.mark.parametrize("structure", ["guided", "nip"])
@pytest.mark.parametrize("seed", SEEDS)
def test_sheet_in_contact_numbered_from_the_other_end(structure, method, seed):
    assert _reversal_error(_frictionless(draw(structure, seed)), method) < 1e-9 * 60.0


@pytest.mark.parametrize("structure", ["guided", "nip"])
def test_implicit_step_forgets_the_numbering_as_it_shrinks(structure):
    """The implicit terms of an end circle's contact are those of its own bar; what this does falls at least as dt."""
    scene = _frictionless(draw(structure, 0))
    coarse, fine = (_reversal_error(scene, "linear_euler", duration=DURATION * k, dt=DT * k) for k in (1.0, 0.1))
    assert coarse < 1e-3
    assert fine < 0.1 * coarse + 1e-9


def _renamed(scene):
    """The scene with names whose order is the reverse, and the names to look results up by."""

    def names(parts):
        return {old: f"p{len(parts) - k}" for k, old in enumerate(sorted(parts))}

    new = {section: names(getattr(scene, section)) for section in ("sheets", "rollers", "guides")}
    new["contacts"] = {name: {"default": "default"}.get(name, f"a_{name}") for name in scene.contacts}

    def moved(section, part):
        return replace(part, contact=new["contacts"][part.contact]) if section in ("rollers", "guides") else part

    parts = {s: {new[s][k]: moved(s, p) for k, p in getattr(scene, s).items()} for s in new}
    return replace(scene, **parts), new


@pytest.mark.slow
@pytest.mark.parametrize(("structure", "method"), [("nip", m) for m in METHODS] + [("guided", "linear_euler")])
def test_names_do_not_matter(structure, method):
    """Parts are summed in the order of their names. 1e-12 per step, of which some digits of every step survive."""
    scene = draw(structure, 0)
    other, new = _renamed(scene)
    a, b = run(scene, method), run(other, method)
    for name, track in a.sheets.items():
        assert difference({"": track}, {"": b.sheets[new["sheets"][name]]}) < 1e-12 * 200
    for section in ("rollers", "guides"):
        for name, track in getattr(a, section).items():
            assert difference({"": track}, {"": getattr(b, section)[new[section][name]]}) < 1e-12 * 200


def test_order_of_writing_does_not_matter():
    """Names given in another order are the same scene: nothing at all changes."""
    scene = draw("nip", 0)
    backwards = replace(
        scene, **{s: dict(reversed(getattr(scene, s).items())) for s in ("sheets", "rollers", "guides", "contacts")}
    )
    assert difference(outputs(run(scene, "linear_euler")), outputs(run(backwards, "linear_euler"))) == 0.0


def _without_joints(scene):
    """The arc stands off the line, so that both have tips: the length over which joined ends overlap has no unit."""
    turn = scene.guides["turn"]
    return replace(scene, guides=scene.guides | {"turn": replace(turn, center=turn.center + jnp.array([0.1, -0.05]))})


@pytest.mark.parametrize(
    ("structure", "method", "seed"),
    # Steps of another length are another program for each seed.
    [pytest.param(s, m, k, marks=[pytest.mark.slow] if k else []) for s in STRUCTURES for m in METHODS for k in SEEDS],
)
def test_units_do_not_matter(structure, method, seed):
    scene = draw(structure, seed)
    scene = _without_joints(scene) if structure == "guided" else scene
    # Nothing is faster in the new units: from what speed on a lost rebound matters is said in mm/s.
    length, time, mass = units = np.exp(np.sort(np.random.default_rng(seed).uniform(-2.0, 2.0, 3)))[[0, 2, 1]]
    assert length < mass < time
    expected = in_units(outputs(run(scene, method)), units)
    actual = outputs(run(in_units(scene, units), method, duration=DURATION * time, dt=DT * time))
    # Differences are relative to floors in mm, s and N, so compare in the old units.
    assert difference(in_units(expected, 1.0 / units), in_units(actual, 1.0 / units)) < 1e-10


@every_case
def test_width_does_not_matter(structure, method, seed):
    """All that carries mass or force grows with the width: the trajectory stays, forces grow."""
    scene = draw(structure, seed)
    wider = rescaled(scene, lambda owner, name: 3.7 ** width_exponents(owner, name))
    expected = rescaled(outputs(run(scene, method)), lambda owner, name: 3.7 ** dimensions(owner, name)[2])
    assert difference(expected, outputs(run(wider, method))) < 1e-11


_settle = jax.jit(diffeed.settle)


def _cantilever(seed, stiffer=1.0, longer=1.0, thicker=1.0):
    """A heavy sheet held at its tail: G = w L^3/(E I) is 12 density g L^3/(E t^2), whatever the factors."""
    scene = clamped(np.random.default_rng(seed))
    strip = scene.sheets["strip"]
    softness = stiffer * thicker**2 / longer**3
    strip = replace(
        strip, youngs_modulus=stiffer * strip.youngs_modulus, density=softness * strip.density,
        curl=strip.curl / longer, length=longer * strip.length, thickness=thicker * strip.thickness,
        headings=jnp.full((5,), 20.0),
    )  # fmt: skip
    return replace(scene, sheets={"strip": strip}, loads={})


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "factors", [{"stiffer": 30.0}, {"longer": 2.5}, {"stiffer": 0.2, "longer": 0.4, "thicker": 0.7}]
)
def test_static_shape_depends_on_load_over_stiffness_alone(seed, factors):
    expected, actual = _settle(_cantilever(seed)).heading, _settle(_cantilever(seed, **factors)).heading
    assert np.ptp(expected) > 0.05
    assert np.max(np.abs(actual - expected)) < 1e-8


# --- the same symmetries on derivatives: exact identities of the differentiated code ----------------------------------

DIFFERENTIATED = [pytest.param("nip", m, marks=pytest.mark.slow) for m in METHODS] + [("clamped", m) for m in METHODS]
differentiated = pytest.mark.parametrize(("structure", "method"), DIFFERENTIATED)


@functools.cache
def _scene(structure):
    return draw(structure, 1)


def _along(structure, method, change, dt_change=0.0):
    return forward(_scene(structure), change, jnp.asarray(dt_change), method)


def _close(value, expected, actual, tolerance=1e-8):
    """Equal derivatives, in the size of what is differentiated: rounding is relative to that, and many are zero."""
    expected, changed = (jax.tree.map(lambda v, d: np.asarray(v) + np.asarray(d), value, d) for d in (expected, actual))
    assert difference(expected, changed) < tolerance
    assert difference(value, actual) > 1e-3, "the derivative must not be trivial"


@differentiated
@pytest.mark.parametrize("group", [0, 1, 2], ids=["length", "time", "mass"])
def test_homogeneity_in_units(structure, method, group):
    """Euler: the sum of a_i p_i dy/dp_i over all numbers of a scene is b y, for every output y of a run."""
    scene = _scene(structure)
    weighted = map_numbers(scene, lambda owner, name, v: v * dimensions(owner, name)[group])
    value, actual = _along(structure, method, weighted, DT if group == 1 else 0.0)
    expected = map_numbers(value, lambda owner, name, v: v * dimensions(owner, name)[group])
    _close(value, expected, actual, 1e-8 * ROUNDING.get(method, 1.0))


@differentiated
def test_homogeneity_in_width(structure, method):
    scene = _scene(structure)
    value, actual = _along(structure, method, map_numbers(scene, lambda o, name, v: v * width_exponents(o, name)))
    _close(value, map_numbers(value, lambda o, name, v: v * dimensions(o, name)[2]), actual)


@differentiated
@pytest.mark.parametrize("by", [(1.0, 0.0), (0.0, 1.0)])
def test_derivative_by_a_shift(structure, method, by):
    """The derivative of a place by a shift of everything is that shift, that of all else is zero."""
    scene = _scene(structure)
    value, actual = _along(structure, method, change_of(scene, shifted(scene, by)))
    expected = map_numbers(value, lambda owner, name, v: 0.0 * v)
    _close(value, shifted(expected, by), actual)


@differentiated
def test_derivative_by_a_turn(structure, method):
    """Directions and places turn, lengths and forces do not change."""
    scene, quarter = _scene(structure), 0.5 * np.pi

    def rate(record):
        # turned() is affine in (cos, sin) but for the angle itself: its slope at 0 from quarter turns, exactly.
        ahead, behind = turned(record, quarter), turned(record, -quarter)
        zero = map_numbers(record, lambda owner, name, v: 0.0 * v)
        nudge = map_numbers(turned(zero, 1.0), lambda owner, name, v: v)
        halves = jax.tree.map(lambda a, b: 0.5 * (np.asarray(a) - np.asarray(b)), ahead, behind)
        small = turned(zero, quarter)
        return jax.tree.map(lambda h, s, n: h - np.asarray(s) + np.asarray(n), halves, small, nudge)

    value, actual = _along(structure, method, rate(scene))
    _close(value, rate(value), actual)
