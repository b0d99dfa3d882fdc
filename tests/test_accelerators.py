"""Without an accelerator at hand: that the programs are made for one unchanged, out of what each kind can do."""

import jax
import pytest
from jax import export
from stand_in_nip import nip

import diffeed


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
@pytest.mark.parametrize("platform", ["cuda", "rocm", "tpu"])
@pytest.mark.parametrize("function", [run, slope, chosen_steps])
def test_programs_are_lowered_for_accelerators(function, platform):
    """Alone and in a batch: `export` refuses what a platform has no rule for, and nothing calls what the processor alone has."""
    for many in (False, True):
        scene = diffeed.stack([nip(), nip()]) if many else nip()
        made = export.export(jax.jit(jax.vmap(function) if many else function), platforms=(platform,))(scene)
        assert "lapack" not in made.mlir_module()
    assert "lapack" in export.export(jax.jit(function), platforms=("cpu",))(nip()).mlir_module(), "or this says nothing"
