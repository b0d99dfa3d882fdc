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
