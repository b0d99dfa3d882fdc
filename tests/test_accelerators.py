"""That the programs are made for accelerators unchanged, out of what each kind can do, and, where one is at hand, that it finds
what the processor does."""

from functools import partial

import jax
import numpy as np
import pytest
from jax import export
from stand_in_nip import nip

import diffeed
from diffeed import measures
from diffeed.base.products import ALL_DIGITS
from diffeed.base.records import replace
from diffeed.bench.jaxprs import equations
from diffeed.bench.timing import precision
from diffeed.input.parts import SinglePrecision
from diffeed.steppers import STEPPERS


def run(scene):
    done = diffeed.simulate(scene, duration=1e-3, dt=1e-4, frames=2, observe=("nips", "feed"))
    return done.ok, done.sheets["strip"].nodes[-1, 0], done.observed


def slope(scene):
    return jax.grad(lambda s: diffeed.simulate(s, duration=1e-3, dt=1e-4, frames=2).sheets["strip"].nodes[-1, 0, 0])(
        scene
    )


def chosen_steps(scene):
    return diffeed.simulate(scene, duration=1e-3, tolerance=1e-2, most_steps=100, frames=2).ok


@pytest.mark.long
@pytest.mark.usefixtures("loops_are_dear")
@pytest.mark.parametrize("function", [run, slope, chosen_steps])
def test_programs_are_lowered_for_accelerators(function):
    """Alone and in a batch: `export` refuses what a platform has no rule for, and nothing calls what the processor alone has."""
    for program, scene in ((jax.jit(function), nip()), (jax.jit(jax.vmap(function)), diffeed.stack([nip(), nip()]))):
        for platform in ("cuda", "rocm", "tpu"):
            assert "lapack" not in export.export(program, platforms=(platform,))(scene).mlir_module(), platform
        assert "lapack" in export.export(program, platforms=("cpu",))(scene).mlir_module(), "or this says nothing"


def several(bars: int) -> diffeed.Scene:
    """Two sheets, one of them held, and rollers that turn freely and stick to them: what needs products."""
    paper = diffeed.Sheet(
        length=60.0, thickness=0.1, width=200.0, density=1e-6, youngs_modulus=3000.0, structural_damping=1e-3, bars=bars,
        lead=(30.0, 0.0),
    )  # fmt: skip
    return diffeed.scene(
        sheets={"upper": replace(paper, lead=(30.0, 9.8)), "lower": paper},
        rollers={
            "between": diffeed.MovableRoller(
                center=(0.0, 4.9), direction=(0.0, 1.0), radius=4.9, mass=0.01, spring=0.5, preload=1.0, inertia=1e-2
            ),
            "upon": diffeed.MovableRoller(
                center=(0.0, 15.0), direction=(0.0, 1.0), radius=5.0, mass=0.01, spring=0.5, preload=1.0, inertia=1e-2
            ),
        },
        contacts={"default": diffeed.Contact(friction_law="stick")},
        clamps={"held": diffeed.Clamp(sheet="lower", at="tail")},
        initial="given",
    )  # fmt: skip


OBSERVERS = ("nips", "feed", "spans", "energy", "arrivals")


@pytest.mark.long
@pytest.mark.usefixtures("loops_are_dear")
@pytest.mark.parametrize("bars", [5, pytest.param(120, marks=pytest.mark.slow)], ids=["dense", "elimination"])
def test_products_keep_all_digits_everywhere(bars):
    """Accelerators take products of float32 in a third of their digits unless told otherwise: each equation is told."""
    scene = several(bars)

    def end(scene, **how):
        done = diffeed.simulate(scene, duration=1e-3, frames=2, observe=OBSERVERS, **how)
        return done.sheets["upper"].nodes[-1, 0, 0] + measures.jam_margin(scene, done)

    programs = [jax.jacfwd(end), jax.grad(end), partial(end, tolerance=1e-2, most_steps=20), diffeed.settle]
    programs += [partial(end, dt=1e-4, method=method) for method in STEPPERS]
    programs += [lambda s: diffeed.linearise(s, diffeed.settle(s)).stiffness]
    found = [e.params["precision"] for f in programs for e in equations(f, scene) if e.primitive.name == "dot_general"]
    assert len(found) > 50, len(found)
    assert all(p is not None and set(p) == {ALL_DIGITS} for p in found)


@pytest.mark.skipif(jax.default_backend() == "cpu", reason="no accelerator at hand")
@pytest.mark.filterwarnings("ignore", category=SinglePrecision)
@pytest.mark.parametrize(("name", "place", "share"), [("float64", 1e-10, 1e-8), ("float32", 1e-3, 1e-2)])
def test_an_accelerator_finds_what_the_processor_does(name, place, share):
    """Of 30 ms of a strip in a nip: places (mm) and the gradient by every number, as a share of the largest of its kind. Sums
    are made in another order there: rounding, some hundred times magnified in 300 steps, and more in a gradient."""

    def found(device):
        with jax.default_device(device):
            scene = jax.device_put(nip(), device)
            done = diffeed.simulate(scene, dt=1e-4, frames=4)
            return jax.device_get((done.ok, done.sheets["strip"].nodes, jax.tree.leaves(slope(scene))))

    with precision(name):
        (fine, nodes, slopes), (ok, others, also) = found(jax.devices()[0]), found(jax.devices("cpu")[0])
    assert fine
    assert ok
    np.testing.assert_allclose(nodes, others, rtol=0.0, atol=place)
    for mine, other in zip(slopes, also, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0.0, atol=share * np.max(np.abs(other), initial=1e-30))
