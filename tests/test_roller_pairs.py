"""What rollers add to the system when they touch each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed.chain.state import initial_state
from diffeed.contact.bodies import bodies
from diffeed.contact.kept import keep_all
from diffeed.contact.roller_pairs import roller_contacts
from diffeed.forces.rollers import _as_product, _one_by_one
from diffeed.forces.terms import Step
from diffeed.input.parts import normalise
from diffeed.model.build import build


@pytest.mark.parametrize("known", [True, False], ids=["known", "found"])
def test_rollers_on_rollers_add_alike_in_both_ways(known):
    """Pairs known beforehand, or found in the run; of rollers that travel and turn freely, turn only, or do neither."""
    scene = normalise(diffeed.load_scene("film_feeder"))
    model = build(scene)
    assert model.rollers.counts == (0, 3, 1, 3)  # travel alone, both, turn alone, neither
    start = initial_state(model, scene)
    pairs = roller_contacts(model, bodies(model, start, start.time, start.time), keep_all(model))
    rng = np.random.default_rng(4)
    shape = pairs.gap.shape
    angle, touch = (
        rng.uniform(0.0, 6.0, shape),
        jax.tree.map(lambda v: jnp.asarray(rng.uniform(1.0, 2.0, shape)), pairs.touch),
    )
    pairs = pairs._replace(touch=touch, nx=jnp.cos(angle), ny=jnp.sin(angle), v_n=jnp.asarray(rng.normal(size=shape)))
    step = Step(jnp.asarray(1e-2), True)
    if not known:
        pairs = pairs._replace(between=tuple(jnp.asarray(v) for v in pairs.between))
    ours, wanted = _one_by_one(model, pairs, step), _as_product(model, pairs, step)
    np.testing.assert_allclose(np.tril(ours[0]), np.tril(wanted[0]), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ours[1], wanted[1], rtol=1e-12, atol=1e-12)
    assert np.count_nonzero(np.tril(wanted[0], -1)) > 10
