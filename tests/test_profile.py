"""Profiles over time: values, and derivatives where steps end, at corners too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed.contact.profile import interpolate

TIMES, VALUES = jnp.array([0.1, 0.2, 0.4]), jnp.array([1.0, 3.0, -1.0])


def _value(times, values, time):
    """As a profile among longer ones: its last point is repeated."""
    return interpolate(*(jnp.concatenate([v, v[-1:]]) for v in (times, values)), time)[0]


@pytest.mark.parametrize("time", [0.0, 0.1, 0.13, 0.2, 0.31, 0.4, 0.7])
def test_value_and_its_derivatives(time):
    """Against central differences: at a corner they are the mean of both sides."""
    given = TIMES, VALUES, jnp.asarray(time)
    assert float(_value(*given)) == pytest.approx(np.interp(time, TIMES, VALUES), abs=1e-15)
    for k, slopes in enumerate(jax.grad(_value, argnums=(0, 1, 2))(*given)):
        for place in np.ndindex(np.shape(given[k])):
            high, low = (
                float(_value(*[v.at[place].add(by) if i == k else v for i, v in enumerate(given)]))
                for by in (1e-7, -1e-7)
            )
            assert float(slopes[place]) == pytest.approx((high - low) / 2e-7, abs=1e-5)  # they are off by their square


@pytest.mark.long
def test_steps_that_end_at_corners_do_not_count_one_side_for_both():
    """A shaft turns up from the 0.1 s mark, that a step ends at, to the 0.2 s mark: by a later start it turns less by half of its
    speed. With one side's derivative at the mark it would be 2 % more."""

    def turned(start):
        profile = diffeed.Profile(times=jnp.array([0.0, start, 0.2]), values=(0.0, 0.0, 100.0))
        drive = diffeed.FixedRoller(center=(0.0, -50.0), radius=8.0, surface_speed=profile)
        sheet = diffeed.Sheet(
            length=60.0, thickness=0.2, width=30.0, density=1e-6, youngs_modulus=3000.0, bars=3, lead=(20.0, 0.0)
        )
        scene = diffeed.scene(sheets={"a": sheet}, rollers={"drive": drive}, gravity=(0.0, 0.0), initial="given")
        return 8.0 * diffeed.simulate(scene, duration=0.3, dt=2e-3, frames=4).rollers["drive"].angle[-1]

    assert float(jax.jit(jax.grad(turned))(0.1)) == pytest.approx(-50.0, rel=1e-9)
