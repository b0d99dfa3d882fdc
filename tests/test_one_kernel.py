"""Where loops are cheap: the same numbers by sums and loops, and a run that is one kernel."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import tuning
from diffeed.base.factor import factor, solve_triangular
from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.places import PLACE, add_at, add_within, at_places, put_at, summed_at
from diffeed.base.products import product
from diffeed.base.smallest import smallest
from diffeed.base.smooth import solve_positive
from diffeed.bench.jaxprs import equations

RANDOM = np.random.default_rng(3)
INDEX, VALUES = jnp.asarray(RANDOM.integers(0, 5, 9), jnp.int32), jnp.asarray(RANDOM.normal(size=(9, 3)))
POSITIVE = RANDOM.normal(size=(7, 7))
POSITIVE = jnp.asarray(POSITIVE @ POSITIVE.T + np.eye(7))
RIGHT = jnp.asarray(RANDOM.normal(size=(7, 2)))


@pytest.fixture(params=["cheap", "dear"])
def loops(request):
    """Whether loops are taken to be cheap."""
    request.getfixturevalue(f"loops_are_{request.param}")
    return request.param


def scattered(values, index=INDEX):
    return jnp.zeros((5, 3)).at[index].add(values)


def columns(values, index):
    return jnp.stack(add_at(5, index, list(values.T)), axis=1)


def test_these_tests_know_both(loops):
    assert loops_are_cheap() == (loops == "cheap")


def test_rows_are_summed_at_their_places(loops):
    np.testing.assert_allclose(columns(VALUES, INDEX), scattered(VALUES), rtol=1e-15)
    np.testing.assert_allclose(summed_at(5, INDEX, VALUES.T), scattered(VALUES).T, rtol=1e-15)


@pytest.mark.parametrize("known", [True, False])
def test_rows_past_the_last_place_are_left_out(loops, known):
    """Places with one, several and no rows."""
    index, values = np.array([3, 6, 0, 3, 3, 5, 9, 0, 3, 5, 5]), jnp.asarray(RANDOM.normal(size=11))
    wanted = np.bincount(index, np.asarray(values), minlength=10)[:6]

    def summed(v):
        return add_within(6, index if known else jnp.asarray(index, PLACE), v)

    np.testing.assert_allclose(summed(values), wanted, rtol=1e-15)
    slope = jax.grad(lambda v: jnp.sum(summed(v) ** 3))(values)
    np.testing.assert_allclose(slope, 3.0 * np.append(wanted, np.zeros(4))[index] ** 2, rtol=1e-15)


def test_so_are_their_derivatives_and_those_of_a_batch(loops):
    def of_squares(summed):
        return lambda values, index=INDEX: jnp.sum(summed(values**2, index) ** 3)

    ours, known = of_squares(columns), of_squares(scattered)
    for derivative in (jax.grad, jax.jacfwd, jax.hessian):
        np.testing.assert_allclose(derivative(ours)(VALUES), derivative(known)(VALUES), rtol=1e-13)
    for derivative in (jax.grad, jax.jacfwd):  # of some columns only
        alone = derivative(lambda v: jnp.sum(jnp.stack(add_at(5, INDEX, [VALUES[:, 0], v])) ** 3))(VALUES[:, 1])
        np.testing.assert_allclose(alone, derivative(lambda v: jnp.sum(scattered(v) ** 3))(VALUES)[:, 1], rtol=1e-13)
    values, index = jnp.stack([VALUES, 2.0 * VALUES]), jnp.stack([INDEX, INDEX[::-1]])
    for batched in (ours, jax.grad(ours)):
        alone = [batched(v, i) for v, i in zip(values, index, strict=True)]
        np.testing.assert_allclose(jax.vmap(batched)(values, index), jnp.stack(alone), rtol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(ours))(values)[1], jax.grad(known)(values[1]), rtol=1e-13)


def test_what_stands_at_places_is_taken_from_there():
    index = np.array([[4, 0], [2, 4]])
    rows = jnp.stack([VALUES.T, 2.0 * VALUES.T])
    for values in (VALUES[:, 0], VALUES.T, rows):
        np.testing.assert_array_equal(at_places(values, index), np.asarray(values)[..., index])
        slope = jax.grad(lambda v: jnp.sum(at_places(v, index.ravel()) ** 3))(values)
        np.testing.assert_allclose(slope, jax.grad(lambda v: jnp.sum(v[..., index.ravel()] ** 3))(values), rtol=1e-15)
    taken = jax.vmap(at_places)(rows, jnp.asarray(index, PLACE))
    np.testing.assert_array_equal(taken, [row[:, at] for row, at in zip(np.asarray(rows), index, strict=True)])


def test_rows_that_stand_alone_are_put_at_their_places(loops):
    """Several share the place of what is not asked for, and are left out."""
    index = np.array([4, 6, 0, 6, 2, 6])
    values = np.random.default_rng(5).normal(size=(6, 2))
    wanted = np.zeros((6, 2))
    wanted[index[index < 6]] = values[index < 6]

    def put(v):
        return jnp.stack(put_at(6, jnp.asarray(index, PLACE), list(v.T)), axis=1)

    np.testing.assert_array_equal(put(jnp.asarray(values)), wanted)
    np.testing.assert_array_equal(jax.vmap(put)(jnp.asarray([values, 2.0 * values])), [wanted, 2.0 * wanted])
    for derivative in (jax.grad, jax.jacfwd):
        slope = derivative(lambda v: jnp.sum(put(v) ** 3))(jnp.asarray(values))
        np.testing.assert_allclose(slope, 3.0 * values**2 * (index < 6)[:, None], rtol=1e-15)


def test_factors_solve(loops):
    lower = factor(jnp.tril(POSITIVE))
    np.testing.assert_allclose(lower, np.linalg.cholesky(POSITIVE), atol=1e-14)
    np.testing.assert_allclose(lower @ solve_triangular(lower, RIGHT), RIGHT, atol=1e-13)
    np.testing.assert_allclose(lower.T @ solve_triangular(lower, RIGHT, transposed=True), RIGHT, atol=1e-13)
    known = jax.jacfwd(lambda m: jnp.linalg.solve(jnp.tril(m) + jnp.tril(m, -1).T, RIGHT))(POSITIVE)
    np.testing.assert_allclose(jax.jacrev(lambda m: solve_positive(m, RIGHT))(POSITIVE), known, atol=1e-12)
    assert np.isnan(np.asarray(factor(-POSITIVE))).any(), "not positive"


def test_products(loops):
    for a, b in ((POSITIVE, RIGHT), (POSITIVE[0], RIGHT), (POSITIVE, RIGHT[:, 0]), (POSITIVE[None], RIGHT)):
        np.testing.assert_allclose(product(a, b), np.asarray(a) @ np.asarray(b), atol=1e-13)


@pytest.mark.parametrize(("n", "count"), [(189, 27), (30, 29), (5, 1)])
def test_places_of_the_smallest(loops, n, count):
    """All apart, many alike, and some that are infinite or no number: alone and in a batch."""
    plain = RANDOM.normal(size=n)
    mixed = np.where(np.arange(n) % 4 == 1, np.inf, np.where(np.arange(n) % 5 == 2, -np.inf, plain))
    lacking = np.where(np.arange(n) % 7 == 3, np.nan, mixed) if n > count + 5 else mixed
    values = jnp.asarray([plain, np.round(plain), mixed, lacking])
    alone = [smallest(v, count) for v in values]
    for places in (alone, jax.vmap(lambda v: smallest(v, count))(values)):
        for own, given in zip(np.asarray(places), np.asarray(values), strict=True):
            assert len(set(own)) == count
            assert places is not alone or loops == "dear" or (np.diff(own) > 0).all(), "in their order"
            np.testing.assert_allclose(np.sort(given[own]), np.sort(given)[:count], rtol=0.01)


def test_no_array_of_a_search_grows_faster_than_its_list(loops):
    """A list of 20,000 pairs: at most twice as many numbers anywhere, and the last window."""
    n = 20_000
    made = equations(lambda v: smallest(v, 8), jnp.zeros(n))
    assert n <= max(out.aval.size for equation in made for out in equation.outvars) <= 2 * (n + 32)


@pytest.mark.parametrize(
    "name",
    [
        "film_feeder",
        pytest.param("long_path", marks=pytest.mark.slow),
        pytest.param("gap_bridge", marks=pytest.mark.slow),
        pytest.param("jam_layout", marks=pytest.mark.slow),
    ],
)
def test_a_run_is_the_same_either_way(request, name):
    scene = diffeed.load_scene(name)

    def end():
        state = diffeed.simulate(scene, duration=0.01, dt=1e-4, frames=2).final.state
        return np.concatenate([np.ravel(v) for v in (state.x, state.y, state.heading, state.travel, state.spin)])

    ends = []
    for way in ("dear", "cheap"):
        request.getfixturevalue(f"loops_are_{way}")
        assert loops_are_cheap() == (way == "cheap")
        ends.append(end())
    assert (ends[0] != ends[1]).any(), "two ways"
    np.testing.assert_allclose(*ends, rtol=1e-9, atol=1e-9)


PROGRAM = """
import re
import diffeed
from diffeed import tuning
tuning.compile_for_speed()
import jax
from diffeed.input.parts import normalise
from diffeed.run.examine import prepare
from diffeed.run.rollout import BLOCK
jax.config.update("jax_enable_x64", True)
scene = normalise(diffeed.load_scene("film_feeder"))
start, blocks = prepare(scene).state, 10
def end(scene):
    run = diffeed.simulate(scene, duration=blocks * BLOCK * 1e-4, dt=1e-4, frames=2, method={method!r}, initial=start)
    return run.final.state
text = jax.jit(end).lower(scene).compile().as_text()
assert len(re.findall(f'known_trip_count":{{{{"n":"{{BLOCK}}"', text)) == 1
# What a loop that became a kernel has for itself is a computation that is nothing but it.
assert re.search(f'ROOT %while[^\\n]*known_trip_count":{{{{"n":"{{blocks}}"', text)
"""


@pytest.mark.skipif(tuning._jaxlib() not in tuning.KNOWN[tuning.EXTRA], reason="this compiler takes no such flag")
@pytest.mark.parametrize("method", ["linear_euler", pytest.param("midpoint", marks=pytest.mark.slow)])
def test_a_run_is_one_kernel(method):
    """Of all its blocks of steps, with their searches: else a step calls a hundred, a search as many, and all takes twice as
    long: something in it calls a library. In a process of its own, for a compiler reads its flags only once."""
    env = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | {
        "XLA_FLAGS": "--xla_backend_optimization_level=0"
    }
    code = PROGRAM.format(method=method)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, env=env)
    assert done.returncode == 0, done.stderr
