"""Several results of one sweep over arrays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed.base.sweeps import largest, sums, totals

NUMBERS = jnp.sin(jnp.arange(3 * 67.0)).reshape(3, 67)


def test_numbers_are_summed_and_booleans_asked_whether_any_is_true():
    a, b, c, d = totals(NUMBERS, NUMBERS > 0.9999, NUMBERS > 2.0, NUMBERS**2)
    np.testing.assert_allclose([a, d], [np.sum(NUMBERS), np.sum(np.square(NUMBERS))], rtol=1e-12)
    assert (bool(b), bool(c)) == (bool(np.any(NUMBERS > 0.9999)), False) == (True, False)


def test_of_a_batch_each_sample_has_its_own():
    batch = jnp.stack([NUMBERS, -2.0 * NUMBERS - 1.0])
    of_each = jax.vmap(lambda v: (*totals(v, v < -1.5), *largest(v)))(batch)
    np.testing.assert_allclose(of_each[0], np.sum(batch, axis=(1, 2)), rtol=1e-12)
    np.testing.assert_array_equal(of_each[1], [False, True])
    np.testing.assert_array_equal(of_each[2], np.max(np.abs(batch), axis=(1, 2)))
    assert not np.allclose(of_each[2], np.max(batch, axis=(1, 2)))  # whatever their sign


def test_what_is_no_number_is_not_lost():
    hurt = NUMBERS.at[1, 40].set(jnp.nan)
    assert all(np.isnan(v) for v in (*largest(hurt), *sums(hurt)))
    assert not np.isnan(largest(NUMBERS)[0])


def test_sums_have_derivatives_of_both_orders():
    def f(v):
        a, b = sums(v**2, jnp.sin(v))
        return a * b

    def plain(v):
        return jnp.sum(v**2) * jnp.sum(jnp.sin(v))

    v = NUMBERS[0, :5]
    for order in (jax.grad, jax.jacfwd, jax.hessian):
        np.testing.assert_allclose(order(f)(v), order(plain)(v), rtol=1e-12)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="what the compiler for processors makes of it")
def test_one_call_makes_them_all():
    def calls(f):
        entry = jax.jit(f).lower(NUMBERS).compile().as_text().split("ENTRY")[1]
        return (
            entry.count(" fusion(") + entry.count(" reduce(") + entry.count(" reduce-window(") + entry.count(" call(")
        )

    assert calls(lambda v: totals(jnp.sin(v), jnp.sin(v) ** 2, v > 0.5)) == 1
    assert calls(lambda v: (jnp.sum(jnp.sin(v)), jnp.sum(jnp.sin(v) ** 2), jnp.any(v > 0.5))) > 1
