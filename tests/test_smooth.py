"""Scalar maths at the points where a plain derivative would be infinite or not a number."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed.base.smooth import divide, polar, powers, ramp, solve_positive


def test_a_direction_has_the_derivative_of_root_and_quotient():
    def plain(x, y):
        length = jnp.sqrt(x * x + y * y)
        return jnp.stack([length, x / length, y / length])

    def ours(x, y):
        return jnp.stack(polar(x, y))

    for point in ((3.0, 4.0), (-1e-6, 2e-6), (0.0, -5.0)):
        np.testing.assert_allclose(ours(*point), plain(*point), rtol=1e-15, atol=1e-15)
        for take in (jax.jacfwd, jax.jacrev):
            found, expected = (np.stack(take(f, argnums=(0, 1))(*point)) for f in (ours, plain))
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("take", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize(
    ("function", "value"),
    [
        (lambda v: jnp.stack(polar(v, v)), (0.0, 0.0, 1.0)),  # the centre of a circle
        (lambda v: jnp.stack(powers(v, (jnp.asarray(0.5), jnp.asarray(1.5)))), (0.0, 0.0)),  # first touch
        (lambda v: jnp.stack(ramp(v, jnp.asarray(0.0))), (0.0, 0.0)),  # no smoothing
        (lambda v: divide(v, v)[None], (0.0,)),  # a roller that never slipped
    ],
    ids=["polar", "powers", "ramp", "divide"],
)
def test_at_its_bad_point_zero_a_function_has_the_gradient_zero(function, value, take):
    at = jnp.asarray(0.0)
    np.testing.assert_array_equal(function(at), value)
    np.testing.assert_array_equal(take(function)(at), np.zeros(len(value)))


DEPTHS = jnp.asarray([-1.0, 1e-9, 0.02, 1.0, 2.5])


@pytest.mark.parametrize("exponents", [(1.0, 1.5, 2.0), (1.0, 1.25, 2.0), (0.5, 3.0, 1.5)], ids=str)
def test_powers_and_their_derivatives_are_those_of_exponents(exponents):
    x, p = np.asarray(DEPTHS[1:]), np.asarray(exponents)
    expected = x ** p[:, None]
    found = jnp.stack(powers(DEPTHS[1:], tuple(jnp.asarray(p))))
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    for take in (jax.jacfwd, jax.jacrev):
        by_x, by_p = take(lambda x, p: jnp.stack(powers(x, tuple(p))), argnums=(0, 1))(DEPTHS[1:], jnp.asarray(p))
        rows, columns = np.indices(expected.shape)
        np.testing.assert_allclose(by_x[rows, columns, columns], p[:, None] * expected / x, rtol=1e-13)
        np.testing.assert_allclose(by_p[rows, columns, rows], np.log(x) * expected, rtol=1e-13)
    assert not np.any(jnp.stack(powers(DEPTHS[:1], tuple(jnp.asarray(p)))))


def test_powers_of_a_batch_with_one_uneven_exponent():
    exponents = jnp.asarray([1.0, 1.5, 1.4, 2.0])
    found = jax.vmap(lambda p: powers(DEPTHS, (p,))[0])(exponents)
    np.testing.assert_allclose(found, np.maximum(DEPTHS, 0.0) ** np.asarray(exponents)[:, None], rtol=1e-14)


def test_powers_that_need_no_logarithm_take_none_in_a_batch_either():
    """A choice, not both ways with one thrown away: the branches stay branches."""
    program = str(jax.make_jaxpr(jax.vmap(lambda p: powers(DEPTHS, (p,))))(jnp.ones(3)))
    assert "cond[" in program
    before, inside = program.split("cond[", 1)
    assert " log " not in before
    assert " log " in inside


@pytest.mark.parametrize("sides", [1, 3])
@pytest.mark.parametrize("size", [1e-8, 1.0, 1e12])
def test_a_positive_system_and_its_derivatives(sides, size):
    """Against NumPy, and the second derivative of x = b/a: 2 b/a^3. Whatever the size of the numbers: the sides are factored
    beside the matrix under a diagonal that must stay the largest."""
    rng = np.random.default_rng(sides)
    root = rng.normal(size=(7, 7))
    matrix, right = size * (root @ root.T + np.eye(7)), size * rng.normal(size=(7, sides))
    given = jnp.asarray(np.tril(matrix)), jnp.asarray(right)
    np.testing.assert_allclose(solve_positive(*given), np.linalg.solve(matrix, right), rtol=1e-10)

    def value(m, b):
        return jnp.sum(solve_positive(m, b) ** 2)

    for by in (0, 1):
        forward, backward = (d(value, argnums=by)(*given) for d in (jax.jacfwd, jax.jacrev))
        np.testing.assert_allclose(forward, backward, rtol=1e-9, atol=1e-9 * np.abs(backward).max())
        change = rng.normal(size=given[by].shape) if by else np.tril(rng.normal(size=(7, 7)))
        h = 1e-5 * size
        ends = [value(*[v + k * h * change if i == by else v for i, v in enumerate(given)]) for k in (1.0, -1.0)]
        assert float(jnp.sum(backward * change)) == pytest.approx(float(ends[0] - ends[1]) / (2.0 * h), rel=1e-6)

    def quotient(a):
        return solve_positive(a[None, None], jnp.full((1, 1), 3.0))[0, 0]

    assert float(jax.grad(jax.grad(quotient))(jnp.asarray(2.0))) == pytest.approx(2.0 * 3.0 / 2.0**3, rel=1e-12)
