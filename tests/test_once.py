"""What is computed once: the same numbers, less code."""

import jax
import jax.numpy as jnp
import pytest
from stand_in_nip import nip

import diffeed
from diffeed import tuning
from diffeed.base.once import computed_once, derived_once
from diffeed.chain import kinematics
from diffeed.contact import sweep


def plain(x):
    return jnp.stack([x * x, x**3])


def guarded(x):
    return derived_once(plain(x))


def kept(x):
    return computed_once(plain(x))


@pytest.mark.parametrize("guarded", [guarded, kept])
@pytest.mark.parametrize("by", [jax.jacfwd, jax.jacrev, lambda f: jax.jacfwd(jax.jacrev(f))])
def test_values_and_derivatives_are_the_same_bits(by, guarded):
    x = jnp.asarray([0.3, -1.7, 1e-300])
    assert jnp.array_equal(by(guarded)(x), by(plain)(x))
    assert jnp.array_equal(guarded(x), plain(x))


def operations(function, *given, kind=" = "):
    """Of the compiled program, those that were merged into several readers counted in each."""
    jax.clear_caches()  # what was traced before knows nothing of the change
    return jax.jit(function).lower(*given).compile().as_text().count(kind)


def at_the_end(scene):
    return diffeed.simulate(scene, dt=5e-4, frames=2).sheets["strip"].nodes[-1, 0, 0]


def many(scene):
    return jax.tree.map(lambda v: jnp.stack([v, v]), scene)


@pytest.mark.long
@pytest.mark.parametrize(("function", "given"), [(at_the_end, nip()), (jax.vmap(at_the_end), many(nip()))])
def test_the_compiled_run_is_smaller_alone_and_in_a_batch(monkeypatch, function, given):
    """By the law that each reader would have for itself: 295 operations with JAX 0.10, now that sums are stacked (569 while each
    of the nine stood alone). JAX 0.12 merges the readers too, and has none twice: there it must not cost more."""
    with_it = operations(function, given)
    monkeypatch.setattr(sweep, "computed_once", lambda values: values)
    without = operations(function, given)
    assert with_it < (without - 250 if tuning._jaxlib() < (0, 11) else 1.01 * without)


@pytest.mark.long
def test_the_axes_of_bars_are_found_once(monkeypatch):
    """Cosines in the program: 11, and 32 where each loop that reads one takes its own (JAX 0.10)."""
    with_it = operations(at_the_end, nip(), kind=" cosine(")
    monkeypatch.setattr(kinematics, "computed_once", lambda values: values)
    without = operations(at_the_end, nip(), kind=" cosine(")
    assert 0 < with_it <= (0.5 if tuning._jaxlib() < (0, 11) else 1.0) * without


@pytest.mark.slow
def test_the_compiled_gradient_of_a_run_is_smaller(monkeypatch):
    """0.93 of the operations with JAX 0.10."""
    with_it = operations(jax.grad(at_the_end), nip())
    monkeypatch.setattr(sweep, "derived_once", lambda values: values)
    assert with_it < (0.95 if tuning._jaxlib() < (0, 11) else 1.01) * operations(jax.grad(at_the_end), nip())
