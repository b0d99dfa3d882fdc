"""Cosine and sine by polynomials, against the library's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed.base.angles import cos_sin

SPANS = {"float64": (1.0, 20.0, 1e5), "float32": (1.0, 20.0, 100.0)}


@pytest.fixture(autouse=True)
def _by_polynomials(loops_are_cheap):
    pass


@pytest.mark.parametrize("kind", SPANS)
def test_both_are_right_to_the_last_digits(kind):
    """In units in the last place of 1; for single precision against the double one."""
    for span in SPANS[kind]:
        angle = np.linspace(-span, span, 20_001).astype(kind)
        for found, known in zip(cos_sin(jnp.asarray(angle)), (np.cos, np.sin), strict=True):
            assert found.dtype == kind
            np.testing.assert_allclose(found, known(angle.astype(float)), rtol=0, atol=np.finfo(kind).eps)


@pytest.mark.parametrize("quarters", range(-5, 6))
def test_whole_quarters_leave_what_the_angle_has_lost(quarters):
    """Next to a zero all digits of the small one are right."""
    angle = quarters * np.pi / 2
    for found, known in zip(cos_sin(jnp.asarray(angle)), (np.cos(angle), np.sin(angle)), strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-15)


def test_derivatives_are_each_other():
    angle = jnp.linspace(-7.0, 7.0, 41)
    c, s = cos_sin(angle)
    for k, (first, second) in enumerate([(-s, -c), (c, -s)]):
        for derivative in (jax.grad, jax.jacfwd):
            slope = derivative(lambda a, k=k: cos_sin(a)[k])
            np.testing.assert_allclose(jax.vmap(slope)(angle), first, atol=1e-15)
            np.testing.assert_allclose(jax.vmap(jax.grad(slope))(angle), second, atol=1e-15)


@pytest.mark.parametrize("kind", SPANS)
def test_angles_of_no_meaning_stay_in_bounds(kind):
    huge = jnp.asarray([1e9, -3e15, np.finfo(kind).max], kind)
    for found in cos_sin(huge):
        assert (jnp.abs(found) <= 1.0 + 1e-6).all()
    for found in cos_sin(jnp.asarray(jnp.nan, kind)):
        assert jnp.isnan(found)
