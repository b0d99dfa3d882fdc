"""Gradients of runs: the two modes, the check against differences and trend, and what breaks one."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stand_in_nip import nip

import diffeed
from diffeed.bench.jaxprs import operations
from diffeed.gradients import trust
from diffeed.gradients.faults import BadStep
from diffeed.pair import law

SETTLED = nip(initial="settled")
"""From a start that closes the nip by an impact, the gradient is exact and useless."""
PATHS = ("rollers.drive.radius", "rollers.pinch.preload", "sheets.strip.youngs_modulus")


def fed(scene, run):
    return run.sheets["strip"].nodes[-1, 0, 0]


@pytest.mark.slow
def test_both_modes_agree_and_a_scene_of_derivatives_holds_the_same():
    kept = {
        mode: diffeed.value_and_gradient(fed, SETTLED, PATHS, mode=mode, dt=5e-4, frames=2)
        for mode in ("forward", "reverse")
    }
    whole = diffeed.value_and_gradient(fed, SETTLED, dt=5e-4, frames=2)[1]
    for path in PATHS:
        forward, reverse = (float(kept[m][1][path]) for m in kept)
        assert forward == pytest.approx(reverse, rel=1e-9)
        assert float(diffeed.get(whole, path)) == pytest.approx(reverse, rel=1e-9)
    # The drive turns 0.8 rad in 0.03 s: that is what the lead gains per mm of radius, creep aside.
    assert float(kept["forward"][1][PATHS[0]]) == pytest.approx(0.8, rel=0.05)


@pytest.mark.long
def test_a_step_that_is_computed_again_is_not_judged_again():
    """Only a verdict asks whether speeds are finite."""

    def run(scene):
        return jnp.sum(diffeed.simulate(scene, dt=5e-4, frames=2).states.x)

    forward, both = (list(operations(f, nip())).count("is_finite") for f in (run, jax.grad(run)))
    assert both == forward == 1


def test_the_mode_follows_the_counts():
    few, many = (diffeed.gradient_plan(nip(), n, dt=5e-4) for n in (2, 50))
    assert (few.mode, many.mode) == ("forward", "reverse")
    assert many.steps == 60
    assert many.stored == 60
    assert "reverse mode for 50 numbers through 60 steps" in many.sentence()
    with pytest.raises(ValueError, match="mode must be one of"):
        diffeed.gradient_plan(nip(), 2, mode="backwards")
    with pytest.raises(ValueError, match="reverse"):
        diffeed.value_and_gradient(fed, nip(), mode="forward")


@pytest.mark.slow
def test_the_check_calls_a_good_gradient_useful():
    found = diffeed.gradient_check(SETTLED, PATHS[:1], dt=5e-4, frames=4, samples=16)
    (row,) = found.rows
    assert row.verdict == "useful"
    assert row.forward == pytest.approx(row.reverse, rel=1e-9)
    assert row.difference == pytest.approx(row.forward, rel=1e-5)
    assert row.trend == pytest.approx(row.forward, rel=0.02)
    assert "useful" in str(found)
    assert found.plot().get_xlabel() == "Time (s)"


def jittery(x):
    """Slope 2 by trend, but a fine ripple rules the local derivative: like a lead edge after an unresolved impact."""
    return jnp.stack([2.0 * x[0], 2.0 * x[0] + 1e-3 * jnp.sin(1e5 * x[0])])


def test_the_check_calls_an_exact_gradient_useless_where_it_is():
    clock = np.array([0.1, 0.2])
    found = trust.check_function(
        jittery, np.array([1.0]), ("radius",), ("mm",), np.array([0.05]), clock, times=clock, samples=64
    )
    good, bad = found.rows
    assert (good.verdict, bad.verdict) == ("useful", "useless")
    assert bad.trend == pytest.approx(2.0, abs=0.05)
    assert bad.forward == pytest.approx(2.0 + 100.0 * np.cos(1e5), rel=1e-9)
    assert bad.signal == pytest.approx(0.1 / (1e-3 / np.sqrt(2)), rel=0.3)


def test_a_number_without_effect_is_flat():
    found = trust.check_function(
        lambda x: jnp.stack([3.0 + 0.0 * x[0]]), np.array([1.0]), ("idle",), ("mm",), np.array([0.1]), np.array([1.0])
    )
    assert found.rows[0].verdict == "flat"


@pytest.mark.slow
def test_a_sound_gradient_has_nothing_to_explain():
    found = diffeed.explain_gradient(nip(), duration=0.005, dt=5e-4)
    assert found.step == -1
    assert "finite" in found.sentence()


def test_what_has_no_gradient_is_said():
    scene = nip()
    with pytest.raises(ValueError, match="method must be one of linear_euler"):
        diffeed.explain_gradient(scene, method="euler")
    for path, said in (
        ("contacts.default.static_ratio", "is not a number: it is not given"),
        ("sheets.strip.bars", "is not a number"),
        ("rollers.drive", "is not a number"),
    ):
        for use in (
            lambda path: diffeed.gradient_check(scene, [path]),
            lambda path: diffeed.value_and_gradient(fed, scene, [path]),
        ):
            with pytest.raises(ValueError, match=f'"{re.escape(path)}" {said}'):
                use(path)


@pytest.mark.parametrize(
    ("paths", "said"),
    [
        ("rollers.pinch.preload", 'must be a list of paths, but is one word: write ["rollers.pinch.preload"]'),
        ((), "names no number"),
    ],
)
def test_paths_are_a_list(paths, said):
    for use in (diffeed.gradient_check, functools.partial(diffeed.value_and_gradient, fed)):
        with pytest.raises(ValueError, match=re.escape(said)):
            use(nip(), paths)


def test_a_vector_is_checked_entry_by_entry():
    with pytest.raises(ValueError, match=re.escape('"rollers.pinch.center" is a vector: name its entries')):
        diffeed.gradient_check(nip(), ["rollers.pinch.center"])


def test_a_span_of_no_path_is_refused():
    path = "rollers.pinch.preload"
    with pytest.raises(ValueError, match=r'spans names "rollers.pinch.preld", .* did you mean "rollers.pinch.preload"'):
        diffeed.gradient_check(nip(), [path], spans={"rollers.pinch.preld": 0.1})


@pytest.mark.long
def test_a_measure_gives_one_number_with_a_fraction():
    def forgot(scene, run):
        fed(scene, run)

    measures = {
        "forgot gives nothing: is its return missing?": forgot,
        "<lambda> gives one of bool": lambda scene, run: run.ok,
        "<lambda> gives 3 of float64": lambda scene, run: run.time,
    }
    for said, measure in measures.items():
        with pytest.raises(TypeError, match=re.escape(said)):
            diffeed.value_and_gradient(measure, nip(), ["rollers.pinch.preload"], duration=0.002, dt=5e-4, frames=3)


def test_a_start_without_derivative_is_said_in_a_sentence():
    said = BadStep(0, 0.0, "", "", "", ("rollers.drive.radius",)).sentence()
    assert said == "the derivative of the start (settling) is not finite; numbers concerned: rollers.drive.radius"


@pytest.mark.slow
def test_the_first_bad_step_pair_and_term_are_named(monkeypatch):
    """Friction without its guard: the square root of v^2 has no slope where a contact does not slide."""

    def unguarded(surface, v_t):
        return surface.friction / jnp.sqrt(v_t * v_t)

    scene = nip(speed=0.0)  # at rest: nothing slides
    jax.clear_caches()
    monkeypatch.setattr(law, "friction_secant", unguarded)
    found = diffeed.explain_gradient(scene, duration=0.0025, dt=5e-4)
    jax.clear_caches()
    assert found.step == 1
    assert found.part in ("drive", "pinch")
    assert found.feature.startswith("strip")
    assert "friction" in found.term or "secant" in found.term
    assert found.part in found.sentence()


@pytest.mark.long
def test_a_guide_that_nothing_has_reached_has_a_gap_with_a_gradient():
    scene = diffeed.put(nip(), "guides", {"wall": diffeed.LineGuide(start=(30.0, -5.0), end=(30.0, 5.0))})
    scene = diffeed.scene(**vars(scene))

    traced = []

    def gap(scene, run):
        traced.append(scene)
        return run.guides["wall"].gap[-1]

    near, slope = diffeed.value_and_gradient(gap, scene, ["guides.wall.start"], dt=5e-4, frames=2)
    assert float(jnp.abs(slope["guides.wall.start"][0])) > 0.1
    # The same measure of a changed machine: another value, nothing compiled.
    count = len(traced)
    moved = diffeed.put(diffeed.put(scene, "guides.wall.start", (31.0, -5.0)), "guides.wall.end", (31.0, 5.0))
    far, _ = diffeed.value_and_gradient(gap, moved, ["guides.wall.start"], dt=5e-4, frames=2)
    assert float(far - near) == pytest.approx(1.0, abs=1e-6)
    assert len(traced) == count
    with pytest.raises(ValueError, match="tolerance must be a positive number of mm, but is -1"):
        diffeed.value_and_gradient(gap, scene, ["guides.wall.start"], frames=2, tolerance=-1.0)
