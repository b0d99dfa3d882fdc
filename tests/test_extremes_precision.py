"""The extremes in float32: what it can give, and what it says where it cannot."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import extremes as ex
from cases.extremes import EXPLICIT, Run

import diffeed
from diffeed import Clamp, FixedRoller, Scene, Sheet
from diffeed.chain.state import initial_state
from diffeed.faults.causes import FROZEN, REMEDIES
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.readings.snapshot import snapshot
from diffeed.run.rollout import Plan, _simulate

FIRST_ORDER = "linear_euler"


@functools.cache
def single(rows: str, method: str) -> dict[str, Run]:
    """The rows of a structure in float32."""
    with jax.enable_x64(False):
        return ex.run(getattr(ex, rows)(), method)


@pytest.mark.long
@ex.by_method(FIRST_ORDER)
def test_two_bars_in_float32(method):
    """Every row as in float64, but for three digits; gradients finite."""
    double = ex.sheets(method)
    for name, run in single("sheet_rows", method).items():
        assert run.sheet.nodes.dtype == np.float32
        assert run.ok, (name, run.why)
        assert ex.is_finite(run.slopes), name
        moved = np.ptp(double[name].sheet.nodes, axis=0).max()
        off = np.abs(run.sheet.nodes - double[name].sheet.nodes).max()
        assert off < 2e-3 * moved, name


@pytest.mark.slow
@pytest.mark.parametrize("method", ex.METHODS)
def test_contacts_in_float32(method):
    """Finite everywhere, gradients too where a run holds and `check` allows its step; and a fault that float64 finds is found."""
    double = ex.contacts(method)
    for name, run in single("contact_rows", method).items():
        assert np.isfinite(run.sheet.nodes).all(), name
        assert run.ok == double[name].ok or run.cause == FROZEN, (name, run.why, double[name].why)
        if run.ok and (method != EXPLICIT or not name.startswith("friction")):
            assert ex.is_finite(run.slopes), name


# --- statics ----------------------------------------------------------------------------------------------------------


def wall(thickness: float, modulus: float, length: float) -> Scene:
    """A sheet out of a wall."""
    sheet = Sheet(
        length=length,
        thickness=thickness,
        width=210.0,
        density=8e-7,
        youngs_modulus=modulus,
        bars=10,
        lead=(length, 0.0),
    )
    return Scene(sheets={"paper": sheet}, clamps={"wall": Clamp(sheet="paper", at="tail", kind="wall")})


@functools.partial(jax.jit, static_argnames="single")
def _settled(scene: Scene, single: bool) -> Any:
    """Headings at rest, and the derivative of their sum; a word keeps the programs of both precisions apart."""

    def turned(scene: Scene) -> tuple[jax.Array, jax.Array]:
        heading = diffeed.settle(scene).heading
        return jnp.sum(heading), heading

    (_, heading), slopes = jax.value_and_grad(turned, has_aux=True)(scene)
    return heading, slopes


@pytest.mark.filterwarnings("ignore::diffeed.SinglePrecision")
def test_statics_keep_four_digits():
    """Card, copy paper and film; joint angles are differences of absolute ones, so that the stiffest lose most."""
    for given in ((0.8, 4000.0, 60.0), (0.1, 4000.0, 100.0), (0.1, 3000.0, 200.0)):
        double = np.asarray(_settled(normalise(wall(*given)), False)[0])
        with jax.enable_x64(False):
            found, slopes = jax.device_get(_settled(normalise(wall(*given)), True))
        assert found.dtype == np.float32
        assert np.abs(found - double).max() < 1e-4 * np.abs(double).max()
        assert ex.is_finite(slopes)


# --- far from the origin ------------------------------------------------------------------------------------------------


def test_a_nip_far_from_the_origin_is_rough_but_right():
    """200 mm away a gap is known to 1e-5 mm: a thousandth of its depth in a nip."""

    def pressed(x: jax.Array) -> jax.Array:
        sheet = Sheet(
            length=40.0, thickness=ex.THICK, width=30.0, density=8e-7, youngs_modulus=3000.0, bars=4,
            lead=jnp.stack([x + 13.0, x]),
        )  # fmt: skip
        y = x + ex.RADIUS + 0.5 * ex.THICK - ex.BITE
        roller = FixedRoller(center=jnp.stack([x, y]), radius=ex.RADIUS)
        scene = normalise(Scene(sheets={"paper": sheet}, rollers={"roller": roller}, initial="given"))
        model = build(scene)
        return snapshot(model, initial_state(model, scene))[1]["roller"].force

    at = np.linspace(190.0, 210.0, 101)
    expected = float(jax.jit(pressed)(jnp.zeros(())))
    with jax.enable_x64(False):
        found = jax.device_get(jax.jit(jax.vmap(pressed))(jnp.asarray(at)))
    assert found.dtype == np.float32
    assert np.abs(found / expected - 1.0).max() < 5e-3


# --- too short --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ex.METHODS)
def test_a_sheet_that_can_no_longer_move_is_told(method):
    """300 mm/s in steps of 1 ns, 200 mm from the origin: 3e-7 mm a step, a fiftieth of the last digit of the place. In
    float64 it moves."""
    scene = ex.two_bars(0.0, lead=(200.0, 0.0), velocity=(300.0, 0.0))

    def run(scene: Scene) -> Any:
        found = _simulate(normalise(scene), 1e-9, None, Plan(2, 1, 10), method, ())
        return found.sheets["paper"].nodes[-1, 0, 0] - found.sheets["paper"].nodes[0, 0, 0], found.failure.cause

    moved, cause = run(scene)
    assert int(cause) == 0
    assert float(moved) == pytest.approx(3e-6, rel=1e-6)
    with jax.enable_x64(False):
        _, cause = run(scene)
    assert int(cause) == FROZEN
    assert "float64" in REMEDIES[FROZEN]
