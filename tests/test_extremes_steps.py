"""Steps far too long, far too short, and found by their error: right, or failed for a cause that says what helps."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import extremes as ex
from cases.extremes import EXPLICIT

import diffeed
from diffeed import Scene
from diffeed.faults.causes import CAUSES, NO_REST, REMEDIES
from diffeed.input.parts import normalise
from diffeed.run import error_control
from diffeed.run.rollout import Plan, _simulate, _simulate_to
from diffeed.steppers import ESTIMATING

FIRST_ORDER = "linear_euler"

# --- too long ---------------------------------------------------------------------------------------------------------


@pytest.mark.long
@ex.by_method(FIRST_ORDER)
def test_the_film_feeder_in_steps_of_10_ms_fails_and_says_what_helps(method):
    """A whole nip is 13 mm of feeding away, contacts are 0.01 mm deep: nothing in between can be right."""
    run = diffeed.simulate(diffeed.load_scene("film_feeder"), duration=0.2, dt=1e-2, frames=2, method=method)
    assert not bool(run.ok)
    assert int(run.failure.cause) > NO_REST
    assert "step" in run.failure.remedy()
    assert np.isfinite(np.asarray(run.sheets["film"].nodes)).all()


def test_every_cause_that_a_step_can_have_names_a_setting():
    assert all(REMEDIES[1:])
    assert all(CAUSES[1:])


# --- too short --------------------------------------------------------------------------------------------------------

BRIEF = 1e-5
"""s."""


@functools.partial(jax.jit, static_argnames=("steps", "method"))
def _brief(scene: Scene, steps: int, method: str) -> Any:
    found = _simulate(scene, BRIEF / steps, None, Plan(2, steps // 10, 10), method, ())
    return found.sheets["paper"].nodes, found.sheets["paper"].velocities, found.ok


@ex.by_method(FIRST_ORDER, EXPLICIT)
def test_steps_of_a_nanosecond_agree_with_steps_of_a_microsecond(method):
    """Ten thousand steps against ten: what differs is the error of the long ones and the rounding of the many."""
    sheet = {"lead": (200.0, 0.0), "velocity": (300.0, 0.0)}
    scene = normalise(ex.two_bars(0.3, 20.0, gravity=9810.0, **sheet))
    many, few = 10_000, 10
    nodes, velocities, ok = jax.device_get(_brief(scene, many, method))
    other, others, also = jax.device_get(_brief(scene, few, method))
    assert ok
    assert also
    gained = np.abs(velocities[-1] - velocities[0]).max()
    assert gained > 0.01
    step = BRIEF / few
    rounding = many * np.finfo(float).eps
    share = 1.0 if method == FIRST_ORDER else 1e-3
    assert np.abs(nodes[-1] - other[-1]).max() < share * gained * step + rounding * np.abs(nodes).max()
    assert (
        np.abs(velocities[-1] - others[-1]).max() < share * gained * step / BRIEF + rounding * np.abs(velocities).max()
    )


# --- by their error ---------------------------------------------------------------------------------------------------

CHOSEN = (
    "fast, 1e-4",
    "deep",
    "friction 5",
    "friction 1000",
    "no friction",
    "touching, 0.5",
    "touching, 0",
    "film on a floor",
)
CONTROL = {"frames": 4, "most": 1200}
LASTS = 4e-4
"""s."""


@functools.cache
def _controlled(method: str) -> dict[str, Any]:
    control = error_control.Control(
        CONTROL["frames"], error_control.blocks(CONTROL["most"], CONTROL["frames"] + 1), method, ()
    )
    limits = error_control.Limits(LASTS / CONTROL["frames"], 1e-3, 2e-3)

    @jax.jit
    @jax.vmap
    def run(scene: Scene) -> Any:
        def lead(scene: Scene) -> Any:
            found = _simulate_to(scene, limits, None, control)
            sheet = found.sheets["paper"]
            return jnp.sum(sheet.nodes[-1, 0]), (sheet, found.failure.cause, found.steps)

        return jax.value_and_grad(lead, has_aux=True)(scene)

    scenes = [normalise(ex.contact_rows()[name].scene) for name in CHOSEN]
    (_, shown), slopes = jax.device_get(run(diffeed.stack(scenes)))
    return {name: jax.tree.map(lambda v, k=k: v[k], (*shown, slopes)) for k, name in enumerate(CHOSEN)}


@pytest.mark.slow
@pytest.mark.parametrize("method", ESTIMATING)
@pytest.mark.parametrize("name", CHOSEN)
def test_steps_by_a_tolerance_come_through(name, method):
    """Walls at 5 m/s, a start 1 mm deep, glue: the tolerance finds the steps that each needs."""
    sheet, cause, steps, slopes = _controlled(method)[name]
    assert cause == 0, CAUSES[int(cause)]
    assert ex.is_finite(slopes)
    assert steps < CONTROL["most"]
    mass = ex.BARS * ex.bar_mass(ex.contact_rows()[name].scene.sheets["paper"])
    if name.startswith("fast"):
        assert sheet.nodes[:, :, 0].max() < ex.WALL + ex.THICK
        assert abs(sheet.velocities[-1, :, 0].mean()) < 0.1 * ex.FAST
    elif name == "deep":
        springs = (ex.BARS + 1) * 1e3 * ex.HARD["stiffness"] * ex.DEEP**2.5 / 2.5
        ends = sheet.velocities[-1, :, 1]
        rise = 0.5 * (ends[1:] + ends[:-1]).mean()  # of the mass centre
        assert 0.0 < rise <= (2.0 * springs / mass) ** 0.5 * 1.01
    elif name.startswith("friction"):
        np.testing.assert_allclose(sheet.velocities[1:, 0, 0], np.full(CONTROL["frames"], ex.SPEED), rtol=1e-3)
    elif name == "no friction" or name.startswith("touching"):
        assert (sheet.velocities[:, :, 0] == 0.0).all()
