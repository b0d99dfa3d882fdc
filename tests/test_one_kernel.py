"""Where loops are cheap: the same numbers by sums and loops, and a loop of steps that is one kernel."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed.base.add_at import add_at, summed_at
from diffeed.base.factor import factor, solve_triangular
from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.products import product
from diffeed.base.smooth import solve_positive
from diffeed.input.parts import normalise
from diffeed.run.examine import prepare
from diffeed.run.rollout import BLOCK

RANDOM = np.random.default_rng(3)
INDEX, VALUES = jnp.asarray(RANDOM.integers(0, 5, 9), jnp.int32), jnp.asarray(RANDOM.normal(size=(9, 3)))
POSITIVE = RANDOM.normal(size=(7, 7))
POSITIVE = jnp.asarray(POSITIVE @ POSITIVE.T + np.eye(7))
RIGHT = jnp.asarray(RANDOM.normal(size=(7, 2)))


@pytest.fixture(params=["cheap", "dear"])
def loops(request):
    """Whether loops are taken to be cheap; what was traced before is forgotten."""
    if request.param == "dear":
        request.getfixturevalue("loops_are_dear")
    jax.clear_caches()
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


def test_so_are_their_derivatives_and_those_of_a_batch(loops):
    def of_squares(summed):
        return lambda values, index=INDEX: jnp.sum(summed(values**2, index) ** 3)

    ours, known = of_squares(columns), of_squares(scattered)
    for derivative in (jax.grad, jax.jacfwd, jax.hessian):
        np.testing.assert_allclose(derivative(ours)(VALUES), derivative(known)(VALUES), rtol=1e-13)
    values, index = jnp.stack([VALUES, 2.0 * VALUES]), jnp.stack([INDEX, INDEX[::-1]])
    for batched in (ours, jax.grad(ours)):
        alone = [batched(v, i) for v, i in zip(values, index, strict=True)]
        np.testing.assert_allclose(jax.vmap(batched)(values, index), jnp.stack(alone), rtol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(ours))(values)[1], jax.grad(known)(values[1]), rtol=1e-13)


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


@pytest.mark.parametrize("name", ["film_feeder", pytest.param("gap_bridge", marks=pytest.mark.slow)])
def test_a_run_is_the_same_either_way(monkeypatch, name):
    scene = diffeed.load_scene(name)

    def end():
        jax.clear_caches()
        state = diffeed.simulate(scene, duration=0.01, dt=1e-4, frames=2).final.state
        return np.concatenate([np.ravel(v) for v in (state.x, state.y, state.heading, state.travel, state.spin)])

    cheap = end()
    monkeypatch.delenv("XLA_FLAGS")
    dear = end()
    assert (cheap != dear).any(), "two ways"
    np.testing.assert_allclose(cheap, dear, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("method", ["linear_euler", pytest.param("midpoint", marks=pytest.mark.slow)])
def test_a_run_is_one_kernel(method):
    """Of all its blocks of steps, with their searches: else a step calls a hundred, a search as many, and all takes twice as long:
    something in it calls a library."""
    scene = normalise(diffeed.load_scene("film_feeder"))
    start, blocks = prepare(scene).state, 10

    def end(scene):
        run = diffeed.simulate(scene, duration=blocks * BLOCK * 1e-4, dt=1e-4, frames=2, method=method, initial=start)
        return run.final.state

    text = jax.jit(end).lower(scene).compile().as_text()
    assert len(re.findall(rf'known_trip_count":{{"n":"{BLOCK}"', text)) == 1
    # What a loop that became a kernel has for itself is a computation that is nothing but it.
    assert re.search(rf'ROOT %while[^\n]*known_trip_count":{{"n":"{blocks}"', text)
