"""What observers see in a step, with the pairs that may touch alone, against a full look at the same state."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed.base.records import replace
from diffeed.contact.candidates import capacities, search
from diffeed.contact.kept import keep_all
from diffeed.forces.contacts import at_own_time
from diffeed.forces.energy import powers
from diffeed.input.parts import Scene, normalise
from diffeed.model.build import build
from diffeed.readings.observe import commanded_speed
from diffeed.readings.snapshot import look, on_rollers
from diffeed.steppers import STEPPERS

H = 1e-4
FEEDER = diffeed.load_scene("film_feeder")


def _sticking() -> Scene:
    return replace(FEEDER, contacts={k: replace(c, friction_law="stick") for k, c in FEEDER.contacts.items()})


SCENES = {
    "regularised": FEEDER,
    "sticking": _sticking(),
    "smooth skin": replace(FEEDER, skin="smooth"),
    "drives that run up": diffeed.load_scene("jam_layout"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", ["linear_euler", "runge_kutta"])
def test_observers_see_what_a_full_look_shows(name: str, method: str):
    scene = normalise(SCENES[name])
    model = build(scene)
    # In the last of the scenes shafts turn faster at the end of a step than where it begins.
    run = diffeed.simulate(scene, duration=0.06, dt=H, frames=7)
    assert capacities(model).listed

    def both(state):
        found = search(model, state, 16 * H)
        seen = at_own_time(model, state, STEPPERS[method](model, state, jnp.asarray(H), found.kept)[1], found.kept)
        return tuple(
            (
                on_rollers(model, touching, kept),
                powers(model, state, touching, kept),
                commanded_speed(model, touching, kept),
            )
            for touching, kept in ((seen, found.kept), (look(model, state)[2], keep_all(model)))
        )

    (nips, power, feed), (all_nips, all_power, all_feed) = jax.jit(lambda states: jax.lax.map(both, states))(run.states)
    assert np.asarray(all_nips.force).max() > 0.1
    assert np.asarray(all_power.drives).max() > 0.0
    # Alike but for the order of sums.
    for now, then in ((nips, all_nips), (power, all_power), (feed, all_feed)):
        for a, b in zip(now, then, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(np.asarray(b)).max()))
