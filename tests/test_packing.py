"""Scenes as few arrays: programs that do not grow with the number of parts, and runs that are those of loose numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.core import Tracer

import diffeed
from diffeed.base.records import replace
from diffeed.bench.transport import transport
from diffeed.input.packing import LOOSE, Row, pack, stacked
from diffeed.input.parts import FixedRoller, Motion, Profile, Scene, normalise
from diffeed.run.rollout import _simulate, plan

COUNTS = plan(2e-3, 1e-3, 2)


def instructions(run, scene) -> int:
    """What the compiler is given for a run of two steps."""
    lowered = jax.jit(lambda given: run(given, 1e-3, None, COUNTS, "linear_euler", ())).lower(scene)
    return len(lowered.as_text().splitlines())


@pytest.mark.long
@pytest.mark.parametrize(
    "of", [lambda n: transport(guides=n), lambda n: transport(driven=n)], ids=["guides", "rollers"]
)
def test_a_program_does_not_grow_with_the_number_of_parts(of):
    few, many = (normalise(of(n)) for n in (240, 480))
    assert len(jax.tree.leaves(pack(few))) == len(jax.tree.leaves(pack(many))) < 30
    assert instructions(_simulate.program, pack(few)) == instructions(_simulate.program, pack(many))
    assert instructions(_simulate, many) > instructions(_simulate, few) + 240  # traced, every number is by itself


@pytest.mark.long
def test_what_is_traced_stays_beside_the_tables():
    """In a function of one number the others are known, and go in as tables."""
    scene = normalise(diffeed.load_scene("film_feeder"))
    name = min(scene.rollers)
    inputs = []

    def run(radius):
        changed = diffeed.put(scene, f"rollers.{name}.radius", radius)
        inputs.append(len(jax.tree.leaves(pack(normalise(changed)).loose)))
        return diffeed.simulate(changed, 2e-3, 1e-3, 2).states.x[-1, 0]

    found = jax.jit(run)(scene.rollers[name].radius)
    assert inputs == [1]
    assert float(found) == pytest.approx(float(diffeed.simulate(scene, 2e-3, 1e-3, 2).states.x[-1, 0]), abs=1e-12)


@pytest.mark.parametrize("radius", [10.0, 10, np.float32(10.0)])
def test_numbers_of_any_kind_may_be_traced(radius):
    """A Python number is traced as one of weak type, which takes the type of what it meets. Others are known, as written."""
    traced = []

    def read(value):
        one = FixedRoller(center=(0.0, 0.0), radius=value, friction=0.4)
        roller = normalise(Scene(rollers={"one": one})).rollers["one"]
        traced.extend(isinstance(v, Tracer) for v in (roller.radius, roller.friction, roller.center))
        return roller.radius

    found = jax.jit(read)(radius)
    assert traced == [True, False, False]
    assert (found.dtype, found.weak_type, float(found)) == (jnp.float64, False, 10.0)


@pytest.mark.slow
def test_a_run_and_its_derivative_are_those_of_loose_numbers():
    """A roller with a profile and a guide that moves have arrays of their own, which stay loose. Two programs: what differs
    is rounding, grown over 20 steps."""
    scene = diffeed.load_scene("film_feeder")
    ramp = Profile(times=(0.0, 0.01), values=(0.0, scene.rollers["drive_1"].angular_speed))
    scene = diffeed.put(scene, "rollers.drive_1.angular_speed", ramp)
    moved = replace(
        scene.guides["ramp"],
        motion=Motion(times=(0.0, 1.0), displacement=((0.0, 0.0), (1.0, 0.0)), rotation=(0.0, 0.0)),
    )
    scene = normalise(replace(scene, guides=scene.guides | {"ramp": moved}, initial="given"))
    assert set(pack(scene).places) == {0, 1, LOOSE}
    path = "rollers.drive_1.center"

    def measure(s: diffeed.Scene) -> jax.Array:
        return jnp.sum(diffeed.simulate(s, 0.02, 1e-3, 2).states.x[-1] ** 2)

    by_all = jax.jit(jax.value_and_grad(measure))(scene)
    by_one = jax.jit(jax.value_and_grad(lambda v: measure(diffeed.put(scene, path, v))))(diffeed.get(scene, path))
    assert float(measure(scene)) == pytest.approx(float(by_all[0]), rel=1e-12)
    assert float(by_one[0]) == pytest.approx(float(by_all[0]), rel=1e-12)
    np.testing.assert_allclose(by_one[1], diffeed.get(by_all[1], path), rtol=1e-9, atol=1e-9)
    assert np.abs(by_one[1]).max() > 0


def test_numbers_are_stacked_in_their_order():
    table = jnp.asarray([10.0, 11.0, 12.0])
    values = [3.0, Row(table, 2), jnp.asarray(4.0), Row(table, 0)]
    np.testing.assert_array_equal(stacked(values), [3.0, 12.0, 4.0, 10.0])
    np.testing.assert_array_equal(stacked(values[1::2]), [12.0, 10.0])
    np.testing.assert_array_equal(stacked([5.0, 6.0]), [5.0, 6.0])
    assert stacked([]).shape == (0,)
    assert stacked([], (2,)).shape == (0, 2)
    points = jnp.asarray([[0.0, 1.0], [2.0, 3.0]])
    np.testing.assert_array_equal(stacked([Row(points, 1), jnp.zeros(2)], (2,)), [[2.0, 3.0], [0.0, 0.0]])


def test_a_batch_is_loose_as_it_was():
    scene = normalise(diffeed.load_scene("film_feeder"))
    seen = []
    jax.eval_shape(lambda s: seen.append(set(pack(normalise(s)).places)) or 0, scene)
    assert seen == [{LOOSE}]
    assert set(pack(scene).places) == {0, 1}
