"""Design variables: from the unit vector to the scene and back, ties, movements."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stand_in_nip import nip

import diffeed
from optimize import variables as free
from optimize.study import Variable

RADIUS = Variable(path=["rollers.drive.radius", "rollers.pinch.radius"], bounds=(4.0, 6.0))
SPRING = Variable(path="rollers.pinch.spring", bounds=(0.1, 10.0), transform="log")
SHIFT = Variable(shift=["rollers.drive", "rollers.pinch"], direction=(3.0, 4.0), bounds=(-2.0, 2.0))
TURN = Variable(turn=["guides.table", "rollers.pinch"], about=(-3.0, -0.6), bounds=(-90.0, 90.0))
ALL = (RADIUS, SPRING, SHIFT, TURN)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4))
def test_unit_is_the_inverse_of_physical(unit):
    values = np.asarray(free.physical(ALL, jnp.asarray(unit)))
    np.testing.assert_allclose(free.unit(ALL, values), unit, atol=1e-12)
    low, high = np.array([v.bounds for v in ALL]).T
    assert (values >= low - 1e-12).all()
    assert (values <= high + 1e-12).all()


def test_a_log_variable_is_a_power_of_its_bounds():
    assert float(free.physical((SPRING,), jnp.array([0.5]))[0]) == pytest.approx(1.0)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.002, 0.998))
def test_closed_is_the_inverse_of_opened(u):
    assert float(free.closed(free.opened(u))) == pytest.approx(u, abs=1e-12)


def test_a_tie_sets_every_path_and_its_gradient_is_the_sum():
    scene = nip()

    def total(values):
        moved = free.applied(scene, (RADIUS,), values)
        return 2.0 * moved.rollers["drive"].radius + 3.0 * moved.rollers["pinch"].radius

    value, slope = jax.value_and_grad(total)(jnp.array([4.5]))
    assert float(value) == pytest.approx(5.0 * 4.5)
    assert float(slope[0]) == pytest.approx(5.0)


def test_a_nip_shifts_as_one():
    moved = free.applied(nip(), (SHIFT,), jnp.array([5.0]))
    np.testing.assert_allclose(moved.rollers["drive"].center, [3.0, -5.1 + 4.0])
    np.testing.assert_allclose(moved.rollers["pinch"].center, [3.0, 5.1 + 4.0])


def test_a_guide_and_a_nip_turn_about_a_point():
    moved = free.applied(nip(), (TURN,), jnp.array([90.0]))
    np.testing.assert_allclose(moved.guides["table"].end, [-3.0, -0.6], atol=1e-12)
    np.testing.assert_allclose(moved.guides["table"].start, [-3.0, -0.6 - 37.0], atol=1e-12)
    np.testing.assert_allclose(moved.rollers["pinch"].center, [-3.0 - 5.7, -0.6 + 3.0], atol=1e-12)
    np.testing.assert_allclose(moved.rollers["pinch"].direction, [-1.0, 0.0], atol=1e-12)


def test_an_arc_turns_with_its_start_angle():
    arc = diffeed.ArcGuide(center=(1.0, 0.0), radius=5.0, start_angle=10.0, sweep=30.0)
    scene = diffeed.put(nip(), "guides", {"arc": arc})
    turn = Variable(turn=["guides.arc"], about=(0.0, 0.0), bounds=(-90.0, 90.0))
    moved = free.applied(diffeed.scene(**{**vars(scene)}), (turn,), jnp.array([90.0]))
    np.testing.assert_allclose(moved.guides["arc"].center, [0.0, 1.0], atol=1e-12)
    assert float(moved.guides["arc"].start_angle) == pytest.approx(100.0)


def test_a_guide_that_swings_takes_its_pivot_along():
    """Moved and turned, it swings as before: the pivot stays at its end, and so does the way of its displacement."""
    motion = diffeed.Motion(
        times=[0.0, 1.0], displacement=[[0.0, 0.0], [2.0, 0.0]], rotation=[0.0, 20.0], pivot=(10.0, 0.0)
    )
    guide = diffeed.LineGuide(start=(10.0, 0.0), end=(30.0, 0.0), motion=motion)
    scene = diffeed.scene(**vars(diffeed.put(nip(), "guides", {"diverter": guide})))
    shift = Variable(shift=["guides.diverter"], direction=(0.0, 1.0), bounds=(-9.0, 9.0))
    turn = Variable(turn=["guides.diverter"], about=(0.0, 0.0), bounds=(-90.0, 90.0))
    moved = free.applied(scene, (shift, turn), jnp.array([5.0, 90.0])).guides["diverter"]
    np.testing.assert_allclose(moved.start, [-5.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(moved.motion.pivot, moved.start, atol=1e-12)
    np.testing.assert_allclose(moved.motion.displacement, [[0.0, 0.0], [0.0, 2.0]], atol=1e-12)


def test_where_a_variable_starts():
    scene = nip(radius=5.0)
    assert free.start_of(RADIUS, scene) == pytest.approx(5.0)
    assert free.start_of(SHIFT, scene) == 0.0
    assert free.start_of(RADIUS.model_copy(update={"start": 4.2}), scene) == 4.2


def test_units():
    scene = nip()
    assert [free.unit_text(scene, v) for v in ALL] == ["mm", "N/mm", "mm", "deg"]


def test_times_are_delayed_together():
    """One time of a profile, or all of a motion; what is moved otherwise stays, and so do the values."""
    motion = diffeed.Motion(times=[0.1, 0.2], displacement=[[0.0, 0.0], [2.0, 0.0]], rotation=[0.0, 20.0])
    gate = diffeed.LineGuide(start=(10.0, 0.0), end=(30.0, 0.0), motion=motion)
    scene = diffeed.scene(**vars(diffeed.put(nip(), "guides", {"gate": gate})))
    delay = Variable(delay=["guides.gate.motion.times", "rollers.drive.angular_speed.times[1]"], bounds=(-0.01, 0.01))
    assert (free.start_of(delay, scene), free.unit_text(scene, delay)) == (0.0, "s")
    later = free.applied(scene, (delay,), jnp.array([0.01]))
    np.testing.assert_allclose(later.guides["gate"].motion.times, [0.11, 0.21], atol=1e-15)
    np.testing.assert_allclose(later.rollers["drive"].angular_speed.times, [0.0, 0.03], atol=1e-15)
    np.testing.assert_array_equal(later.rollers["drive"].angular_speed.values, [0.0, -40.0])
