"""Which bodies a search keeps: the nearest, in the order of a stable sort, few compared with each other, many sorted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed.contact.candidates import RANKED, _smallest


@pytest.mark.parametrize("n", [7, RANKED, RANKED + 1])
@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_are_kept(n, seed):
    """Equal gaps among them, and bodies that are not there."""
    rng = np.random.default_rng(seed)
    gap = rng.integers(-3, 4, size=(n, 11)).astype(float)
    gap[rng.random(gap.shape) < 0.3] = np.inf
    count = 5
    order = np.argsort(gap, axis=0, kind="stable")
    index, free = jax.jit(_smallest, static_argnums=1)(jnp.asarray(gap), count)
    np.testing.assert_array_equal(index, order[:count])
    assert index.dtype == jnp.int32
    assert float(free) == np.take_along_axis(gap, order, axis=0)[count].min()


def test_no_body_is_kept_twice():
    """None within reach: twice the same body would be felt twice."""
    index, free = _smallest(jnp.full((8, 3), jnp.inf), 4)
    np.testing.assert_array_equal(index, np.tile(np.arange(4)[:, None], (1, 3)))
    assert float(free) == np.inf
