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
from diffeed.readings.pressed_guides import on_guides
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
@pytest.mark.parametrize("name", [pytest.param(k, marks=[pytest.mark.slow] * (k == "sticking")) for k in SCENES])
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
                on_guides(model, touching, kept),
                powers(model, state, touching, kept),
                commanded_speed(model, touching, kept),
            )
            for touching, kept in ((seen, found.kept), (look(model, state)[2], keep_all(model)))
        )

    (nips, guides, power, feed), (all_nips, all_guides, all_power, all_feed) = jax.jit(
        lambda states: jax.lax.map(both, states)
    )(run.states)
    assert np.asarray(all_nips.force).max() > 0.1
    assert np.asarray(all_guides).max() > 0.01
    np.testing.assert_allclose(guides, all_guides, rtol=1e-9, atol=1e-9)
    assert np.asarray(all_power.drives).max() > 0.0
    # Alike but for the order of sums.
    for now, then in ((nips, all_nips), (power, all_power), (feed, all_feed)):
        for a, b in zip(now, then, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(np.asarray(b)).max()))


def test_forces_on_guides_are_those_of_every_step():
    """A strip that lies on a table, and a guide that nothing reaches: in a run where each step is a frame."""
    sheet = diffeed.Sheet(
        length=40.0, thickness=0.1, width=210.0, density=8e-7, youngs_modulus=4000.0, bars=4, lead=(20.0, 0.3)
    )
    guides = {
        "table": diffeed.LineGuide(start=(-99.0, -0.05), end=(99.0, -0.05)),
        "lid": diffeed.LineGuide(start=(99.0, 50.0), end=(-99.0, 50.0)),
    }
    scene = diffeed.scene(sheets={"strip": sheet}, guides=guides, initial="given")
    run = diffeed.simulate(scene, duration=0.03, dt=2e-4, frames=151, observe=("guides",))
    seen, force = run.observed["guides"], np.asarray(run.guides["table"].force)
    table = seen["table"]
    assert float(table.force_peak) == pytest.approx(force.max(), rel=1e-12)
    assert force.max() > 2.0 * 8e-7 * 40.0 * 0.1 * 210.0 * 9.81  # it has dropped
    weights = np.full(151, 2e-4)
    weights[[0, -1]] *= 0.5
    assert float(table.contact_time) == pytest.approx(weights[force > 0].sum(), rel=1e-9)
    assert float(table.force_mean) == pytest.approx((weights * force).sum() / weights[force > 0].sum(), rel=1e-9)
    for field in ("contact_time", "force_mean", "force_peak"):
        assert float(getattr(seen["lid"], field)) == 0.0


def test_guides_are_observed_where_there_are_none():
    strip = diffeed.Sheet(length=40.0, thickness=0.1, width=210.0, density=8e-7, youngs_modulus=4000.0, bars=2)
    scene = diffeed.scene(sheets={"strip": strip}, gravity=(0.0, 0.0), initial="given")
    assert dict(diffeed.simulate(scene, duration=1e-3, dt=5e-4, frames=2, observe=("guides",)).observed["guides"]) == {}
