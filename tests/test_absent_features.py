"""A scene costs only what it contains: what no contact set has is not computed, and the run is that of zeros."""

import jax
import numpy as np
import pytest

import diffeed
from diffeed.base.records import replace
from diffeed.bench.jaxprs import count_equations
from diffeed.bench.transport import transport
from diffeed.input.parts import normalise

SCENE = normalise(replace(diffeed.load_scene("jam_layout"), initial="given"))
RUN = {"duration": 0.02, "dt": 2e-4, "frames": 3}


def with_sets(scene: diffeed.Scene, **changes) -> diffeed.Scene:
    return normalise(replace(scene, contacts={k: replace(c, **changes) for k, c in scene.contacts.items()}))


def with_friction(scene: diffeed.Scene, value: float) -> diffeed.Scene:
    parts = {s: {k: replace(p, friction=value) for k, p in getattr(scene, s).items()} for s in ("rollers", "guides")}
    return normalise(replace(scene, **parts))


def nodes(scene: diffeed.Scene) -> np.ndarray:
    run = diffeed.simulate(scene, **RUN)
    assert run.ok, run.failure.describe()
    return np.asarray(next(iter(run.sheets.values())).nodes)


def equations(scene: diffeed.Scene) -> int:
    return count_equations(lambda s: diffeed.simulate(s, **RUN), scene)


CASES = {
    "friction": (with_sets(SCENE, friction_law="none"), with_friction(SCENE, 0.0)),
    "damping": (with_sets(SCENE, damped=False), with_sets(SCENE, damping=0.0)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_absent_is_zero_and_costs_less(name):
    absent, zero = CASES[name]
    assert nodes(absent) == pytest.approx(nodes(zero), abs=1e-9)
    assert np.max(np.abs(nodes(absent) - nodes(SCENE))) > 1e-6, "the feature must matter here"
    assert equations(absent) < equations(zero) == equations(SCENE)


@pytest.mark.long
def test_one_slick_set_among_others():
    """Only the parts of that set lose their friction."""
    slick = replace(SCENE.contacts["default"], friction_law="none")
    guides = {k: replace(g, contact="slick") for k, g in SCENE.guides.items()}
    mixed = normalise(replace(SCENE, contacts=SCENE.contacts | {"slick": slick}, guides=guides))
    zeros = normalise(replace(SCENE, guides={k: replace(g, friction=0.0) for k, g in SCENE.guides.items()}))
    assert nodes(mixed) == pytest.approx(nodes(zeros), abs=1e-9)


@pytest.mark.usefixtures("loops_are_dear")  # else small products are written out as sums and large ones are not
def test_the_program_is_as_long_for_many_parts_and_bars():
    """One operation on one part alone is compiled once for every part: with 600 parts they took two thirds of the time."""
    small = transport(guides=60, driven=20, nips=20, bars=20)
    large = transport(guides=120, driven=40, nips=40, bars=40)
    assert equations(large) == equations(small)


@pytest.mark.slow
def test_derivatives_without_them():
    def lead(scene: diffeed.Scene) -> jax.Array:
        return next(iter(diffeed.simulate(scene, **RUN).sheets.values())).nodes[-1, 0, 0]

    slope = jax.jit(jax.grad(lead))(with_sets(SCENE, friction_law="none", damped=False))
    assert all(np.isfinite(np.asarray(v)).all() for v in jax.tree.leaves(slope))
    assert float(np.abs(np.asarray(slope.contacts["default"].damping))) == 0.0
