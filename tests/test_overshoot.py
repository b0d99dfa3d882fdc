"""Explicit steps longer than friction allows: bounded as it is, the sheet goes on at a wrong speed, and the run must say so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import extremes as ex

from diffeed import Contact, FixedRoller, LineGuide, MovableRoller
from diffeed.base.records import replace
from diffeed.faults.causes import TURNED_ABOUT
from diffeed.faults.overshoot import DAMPED, SWINGS
from diffeed.input.parts import normalise
from diffeed.pair.law import BRISTLE_LAG
from diffeed.run.rollout import Plan, _simulate

COUNTS = Plan(frames=5, blocks=4, steps=40)
FRICTION, BARE = 0.5, {"damping": 0.0, "smoothing": 0.0}
RATIOS = (0.6, 0.9, 1.1, 2.0, 10.0, 100.0)
"""Steps over the largest stable one."""


def feeder(**contact):
    """A nip that feeds at 100 mm/s a sheet of 100 mm/s less 3."""
    return ex.machine(
        sheet={"velocity": (ex.SPEED - 3.0, 0.0)},
        bite=ex.BITE,
        speed=ex.SPEED,
        friction=FRICTION,
        contact=BARE | contact,
    )


def held():
    """mu N of both rollers together, kg mm/s2."""
    contact = Contact()
    return 2.0 * FRICTION * 1e3 * contact.stiffness * ex.BITE**contact.exponent


def mass():
    return ex.BARS * ex.bar_mass(feeder().sheets["paper"])


def runs(scene, steps):
    scene = normalise(scene)
    return jax.vmap(lambda dt: _simulate(scene, dt, None, COUNTS, "runge_kutta", ()))(jnp.asarray(steps))


def judged(found, speed, reads, ratios=RATIOS):
    """Below the limit the run is right, above it fails."""
    for k, ratio in enumerate(ratios):
        cause = int(found.failure.cause[k])
        assert cause == (0 if ratio < 1.0 else TURNED_ABOUT), f"{ratio} of the limit: {cause}"
        if ratio < 1.0:
            assert float(speed[k]) == pytest.approx(reads, rel=2e-3)


@pytest.mark.long
@pytest.mark.parametrize("law", ["sqrt", "tanh"])
def test_friction_that_is_regularised(law):
    """A rate of mu N/(M v_s), where classical Runge-Kutta bears 2.785 per step."""
    limit = DAMPED * mass() * Contact().stick_speed / held()
    found = runs(feeder(friction_law=law), [ratio * limit for ratio in RATIOS])
    judged(found, found.sheets["paper"].velocities[:, -1, 0, 0], ex.SPEED)


@pytest.mark.long
def test_a_part_without_friction_hides_nothing():
    """Far away and untouched: it takes no part in the sums."""
    limit, scene = DAMPED * mass() * Contact().stick_speed / held(), feeder()
    far = LineGuide(start=(0.0, -400.0), end=(9.0, -400.0), friction=0.0)
    found = runs(replace(scene, guides=dict(scene.guides) | {"far": far}), [ratio * limit for ratio in RATIOS])
    judged(found, found.sheets["paper"].velocities[:, -1, 0, 0], ex.SPEED)


@pytest.mark.long
def test_friction_that_sticks():
    """A circular frequency of sqrt(mu N/(M u_s)), where it bears sqrt(8), and the lag's damping on top. Told a little early:
    the lag is added to the swing, though it would hold it back."""
    spring = held() / (mass() * Contact().stick_displacement)
    rates = np.roots([1.0, spring * BRISTLE_LAG, spring])
    limit = SWINGS / np.abs(rates[0]) if np.iscomplex(rates[0]) else DAMPED / np.max(np.abs(rates))
    ratios = (0.4, 0.8, *RATIOS[2:])
    found = runs(feeder(friction_law="stick"), [ratio * limit for ratio in ratios])
    judged(found, found.sheets["paper"].velocities[:, -1, 0, 0], ex.SPEED, ratios)


@pytest.mark.long
def test_an_idler_lighter_than_the_sheet():
    """mu N (1/M + R^2/I)/v_s: of a roller that weighs nearly nothing the sheet itself hardly tells."""
    inertia = 1e-3
    scene = feeder()
    idler = FixedRoller(
        center=scene.rollers["upper"].center, radius=ex.RADIUS, friction=FRICTION, inertia=inertia, spin=9.5
    )
    scene = replace(scene, rollers=scene.rollers | {"upper": idler})
    rate = 0.5 * held() * (1.0 / mass() + ex.RADIUS**2 / inertia) / Contact().stick_speed
    found = runs(scene, [ratio * DAMPED / rate for ratio in RATIOS])
    sheet = found.sheets["paper"].velocities[:, -1, 0, 0]
    judged(found, found.states.spin[:, -1, 0] * ex.RADIUS / sheet, 1.0)


@pytest.mark.long
def test_an_idler_on_its_drive():
    """No sheet between: mu N R^2/(I v_s)."""
    inertia, scene = 1e-3, ex.machine(friction=FRICTION, contact=BARE)
    scale = Contact().stiffness * ex.BITE ** Contact().exponent * 1e3 * FRICTION
    y = 0.5 * (2.0 * ex.RADIUS - ex.BITE)
    drive = FixedRoller(center=(0.0, 100.0 - y), radius=ex.RADIUS, friction=FRICTION, surface_speed=-ex.SPEED)
    idler = MovableRoller(
        center=(0.0, 100.0 + y),
        direction=(1.0, 0.0),
        radius=ex.RADIUS,
        friction=FRICTION,
        inertia=inertia,
        spin=9.5,
        mass=1e6,
    )
    scene = replace(scene, rollers={"drive": drive, "idler": idler})
    rate = scale * ex.RADIUS**2 / inertia / Contact().stick_speed
    found = runs(scene, [ratio * DAMPED / rate for ratio in RATIOS])
    judged(found, found.states.spin[:, -1, 0] * ex.RADIUS, ex.SPEED)


def test_a_sheet_that_slips_for_good_is_no_failure():
    """Pulled through a nip that stands still, friction is what it is; also at steps that it would not bear at rest."""
    speed = 2e4
    scene = ex.machine(sheet={"velocity": (speed, 0.0)}, bite=ex.BITE, friction=FRICTION, contact=BARE)
    limit = DAMPED * mass() * Contact().stick_speed / held()
    found = runs(scene, [1.2 * limit])
    assert int(found.failure.cause[0]) == 0
    braked = held() / mass() * float(found.time[0, -1])
    assert float(found.sheets["paper"].velocities[0, -1, 0, 0]) == pytest.approx(speed - braked, rel=1e-3)
    assert 0.1 * speed < braked < 0.9 * speed
