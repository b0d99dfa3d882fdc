"""Scalar maths at the points where a plain derivative would be infinite or not a number."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed.base.smooth import divide, polar, powers, ramp


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
