"""Friction of a sheet that lands within a step or two: its impulse is mu times that of the normal force, in any steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed.base.records import replace
from diffeed.contact.kept import by_contact, keep, keep_all
from diffeed.input.parts import normalise
from diffeed.model.build import build

FALL, SPEED, FRICTION, GRAVITY = 0.39, 600.0, 0.2, 9810.0
"""mm above the table, mm/s, and mm/s2."""
DUE = SPEED**2 / (2.0 * FRICTION * GRAVITY) + FRICTION * FALL
"""mm: while it falls nothing brakes it, and the landing makes up for that: mu times all normal impulse, which is m g t."""


def thrown(speed=SPEED, **contact) -> diffeed.Scene:
    """A banknote thrown flat above a table."""
    note = diffeed.Sheet(length=133.0, thickness=0.11, width=72.0, density=0.85e-6, youngs_modulus=3000.0,
                         structural_damping=1e-3, bars=14, lead=(5.0, 0.0), speed=speed)  # fmt: skip
    table = diffeed.LineGuide(
        start=(-140.0, -0.055 - FALL), end=(330.0, -0.055 - FALL), friction=FRICTION, contact="table"
    )
    contacts = {"table": diffeed.Contact(**contact)}
    return diffeed.scene(
        sheets={"note": note}, guides={"table": table}, contacts=contacts, initial="given", duration=0.35
    )


def way(run) -> jax.Array:
    """mm that the front has come."""
    return run.sheets["note"].nodes[-1, 0, 0] - 5.0


@pytest.mark.long
@pytest.mark.parametrize(
    "how",
    [
        {"dt": 4e-4},
        {"dt": 1e-4},
        {"dt": 1e-4, "method": "extrapolated_euler"},
        {"tolerance": 1e-2},
        {"tolerance": 1e-2, "method": "extrapolated_euler"},
    ],
    ids=str,
)
def test_a_thrown_sheet_slides_as_far_as_it_must(how):
    """With the force at the start of a step it came 6 to 36 mm. Measured: 0.2 to 1.5 % off, most by `extrapolated_euler`."""
    run = diffeed.simulate(thrown(), frames=3, **how)
    assert run.ok
    assert float(way(run)) == pytest.approx(DUE, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("dt", [1e-3, pytest.param(4e-4, marks=pytest.mark.slow)])
def test_midpoint_steps_that_do_not_resolve_a_landing_brake_as_much_as_they_must(dt):
    """By forces of passes that had not come together it was turned about, from 600 to -187 mm/s, and held: 21 and 35 mm of 92.
    Measured: 6 and 3 % off."""
    run = diffeed.simulate(thrown(), frames=3, dt=dt, method="midpoint")
    assert run.ok
    assert float(way(run)) == pytest.approx(DUE, rel=0.1)


@pytest.mark.parametrize("tilt", [1.0, 3.0])
def test_a_sheet_that_lands_on_its_edge_is_braked_by_mu_times_the_normal_impulse(tilt):
    """It rocks and bounces; what gravity and its way down leave is the impulse of the table. Held to 0.8 % at this step; without
    what `let_through` takes off for pulled bars 2 to 4 % are missed."""
    note = replace(
        thrown().sheets["note"], heading=tilt, lead=(5.0, 133.0 * np.sin(np.radians(tilt))), velocity=(SPEED, 0.0)
    )
    run = diffeed.simulate(replace(thrown(), sheets={"note": note}), dt=1e-4, frames=6, duration=0.1)
    assert run.ok
    for k in (2, 5):
        normal = GRAVITY * float(run.time[k]) + float(run.states.vy[k, 0])
        assert SPEED - float(run.states.vx[k, 0]) == pytest.approx(FRICTION * normal, rel=0.02)


@pytest.mark.parametrize("dt", [1e-3, 4e-4])
def test_bars_that_a_step_pulls_back_do_not_brake(dt):
    """A sheet that falls onto the crown of a roller flaps on it, bar by bar, within single steps. Measured: 5 % too little in
    steps of 1e-3 s, 1 % too much in 4e-4 s; 3.6 times and 1.15 times as much without what `let_through` takes off."""
    note = replace(thrown(0.0).sheets["note"], lead=(66.5, 0.0))
    roller = diffeed.FixedRoller(
        center=(0.0, -0.055 - FALL - 3000.0), radius=3000.0, angular_speed=2000.0 / 3000.0, friction=FRICTION
    )
    scene = diffeed.scene(sheets={"note": note}, rollers={"drum": roller}, initial="given", duration=0.1)
    run = diffeed.simulate(scene, dt=dt, frames=2)
    assert run.ok
    normal = GRAVITY * 0.1 + float(run.states.vy[-1, 0])
    assert -float(run.states.vx[-1, 0]) == pytest.approx(FRICTION * normal, rel=0.1)


def test_what_a_contact_has_in_all_is_the_same_of_listed_pairs():
    """Of every body with every sheet; pairs stand in rows of bodies, or one after the other in any order of features."""
    sheet = thrown().sheets["note"]
    scene = diffeed.scene(
        sheets={"a": replace(sheet, bars=3), "b": replace(sheet, bars=2, lead=(5.0, 50.0))},
        rollers={"r": diffeed.FixedRoller(center=(0.0, -90.0), radius=5.0)},
        guides={
            "hump": diffeed.CircleGuide(center=(0.0, -60.0), radius=5.0),
            "low": diffeed.LineGuide(start=(0.0, -20.0), end=(9.0, -20.0)),
            "high": diffeed.LineGuide(start=(0.0, 70.0), end=(9.0, 70.0)),
            "bend": diffeed.ArcGuide(center=(0.0, 0.0), radius=200.0, start_angle=0.0, sweep=90.0),
        },
        initial="given",
        duration=0.1,
    )
    model = build(normalise(scene))
    bodies, features = len(model.body_names), len(model.layout.tail)
    counts = (len(model.circle_names), len(model.guides.names))
    values = np.random.default_rng(1).normal(size=(2, bodies, features))
    due = np.stack([values[:, :, own].sum(axis=2) for own in model.layout.sheet_of_feature.T], axis=2)
    due = due @ model.layout.sheet_of_feature.T
    np.testing.assert_allclose(by_contact(model, keep_all(model), values), due, rtol=1e-12)
    body, feature = (v.ravel() for v in np.indices((bodies, features)))
    index = np.split(body, np.cumsum(counts)[:-1] * features)
    index = [v - first for v, first in zip(index, np.cumsum([0, *counts]), strict=False)]
    kept = keep(model, *(jnp.asarray(v, jnp.int32) for v in index), feature=jnp.asarray(feature))
    listed = by_contact(model, kept, jnp.asarray(values.reshape(2, -1)))
    np.testing.assert_allclose(listed, due.reshape(2, -1), rtol=1e-12)


def test_sticking_friction_too():
    run = diffeed.simulate(thrown(friction_law="stick"), frames=3, dt=1e-4)
    assert run.ok
    assert float(way(run)) == pytest.approx(DUE, rel=0.02)


@pytest.mark.long
def test_in_a_batch_as_alone():
    """Whoever lands in it, and with the bits of whatever company. Another program than alone: equal to rounding."""
    fast, slow = thrown(), thrown(0.0)
    alone = [diffeed.simulate(scene, dt=1e-4, frames=3, duration=0.02) for scene in (fast, slow)]
    together = jax.jit(jax.vmap(lambda s: diffeed.simulate(s, dt=1e-4, frames=3, duration=0.02).sheets["note"].nodes))
    mixed, calm = together(diffeed.stack([fast, slow])), together(diffeed.stack([slow, slow]))
    for nodes, run in zip(mixed, alone, strict=True):
        np.testing.assert_allclose(nodes, run.sheets["note"].nodes, atol=1e-9)
    np.testing.assert_array_equal(mixed[1], calm[1])


@pytest.mark.long
def test_its_gradient_is_that_of_sliding():
    """Further by v / (mu g) for each mm/s more. Measured: 0.2 % less."""

    def far(speed):
        return way(diffeed.simulate(thrown(speed), dt=1e-4, frames=3))

    slope = jax.jit(jax.jacfwd(far))(SPEED)
    assert float(slope) == pytest.approx(SPEED / (FRICTION * GRAVITY), rel=0.02)
