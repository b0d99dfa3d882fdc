"""Prescribed movements of several parts at once: each goes by its own, and the program is as long for many as for few."""

import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import ArcGuide, CircleGuide, FixedRoller, LineGuide, Motion, Sheet
from diffeed.base.records import replace
from diffeed.bench.jaxprs import count_equations
from diffeed.chain.state import initial_state
from diffeed.contact.bodies import bodies
from diffeed.input.parts import normalise
from diffeed.model.build import build

TWO = Motion(times=(0.0, 0.2), displacement=((0.0, 0.0), (4.0, -2.0)), rotation=(0.0, 30.0), pivot=(3.0, 1.0))
ONE = Motion(times=(0.1,), displacement=((1.0, 2.0),), rotation=(-20.0,), pivot=(0.0, -5.0))
FOUR = Motion(
    times=(0.0, 0.05, 0.06, 0.1),
    displacement=((0.0, 0.0), (0.0, 3.0), (1.0, 3.0), (1.0, 0.0)),
    rotation=(0.0, 0.0, 5.0, 9.0),
)


def machine(**guides) -> diffeed.Scene:
    rollers = {"wheel": FixedRoller(center=(-50.0, 40.0), radius=5.0, surface_speed=100.0, motion=FOUR)}
    sheet = Sheet(length=60.0, thickness=0.1, width=50.0, density=8e-7, youngs_modulus=1000.0, bars=6, lead=(30.0, 9.0))
    return diffeed.scene(sheets={"strip": sheet}, rollers=rollers, guides=guides, initial="given")


def moved(motion: Motion | None, time: float, point) -> np.ndarray:
    """By hand, after the definition of a movement."""
    if motion is None:
        return np.array(point)
    shift = [np.interp(time, motion.times, np.array(motion.displacement)[:, k]) for k in (0, 1)]
    angle, pivot = np.deg2rad(np.interp(time, motion.times, motion.rotation)), np.array(motion.pivot)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return pivot + shift + turn @ (np.array(point) - pivot)


OF_TWO, OF_FOUR = {"d", "bend", "post"}, {"c", "wheel"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("time", "fast"),
    [(0.0, OF_TWO | OF_FOUR), (0.03, OF_TWO | OF_FOUR), (0.07, OF_TWO | OF_FOUR), (0.15, OF_TWO), (0.3, set())],
)
def test_every_part_goes_by_its_own_movement(time, fast):
    """Profiles of one, two and four points, parts that stand still among those that move."""
    lines = {
        "a": (ONE, (0.0, 0.0), (10.0, 1.0)),
        "b": (None, (20.0, 0.0), (30.0, 1.0)),
        "c": (FOUR, (40.0, 0.0), (50.0, 1.0)),
        "d": (TWO, (60.0, 0.0), (70.0, 1.0)),
    }
    guides = {name: LineGuide(start=start, end=end, motion=motion) for name, (motion, start, end) in lines.items()}
    arcs = {"bend": (TWO, (0.0, 30.0)), "turn": (None, (20.0, 30.0)), "veer": (ONE, (50.0, 30.0))}
    guides |= {k: ArcGuide(center=c, radius=6.0, start_angle=-90.0, sweep=40.0, motion=m) for k, (m, c) in arcs.items()}
    scene = normalise(machine(**guides, post=CircleGuide(center=(5.0, 60.0), radius=3.0, motion=TWO)))
    model = build(scene)
    world = bodies(model, initial_state(model, scene), jnp.asarray(time), jnp.asarray(time))
    assert model.guides.names == (*lines, *arcs)
    starts = [moved(motion, time, start) for motion, start, _ in lines.values()]
    ends = [moved(motion, time, end) for motion, _, end in lines.values()]
    at, faces = world.guides, len(lines)
    middle, half = (np.stack(v, axis=1) for v in ((at.x, at.y), (at.reach * at.tx, at.reach * at.ty)))
    np.testing.assert_allclose((middle - half)[:faces], starts, atol=1e-12)
    np.testing.assert_allclose((middle + half)[:faces], ends, atol=1e-12)
    centres = [moved(motion, time, centre) for motion, centre in arcs.values()]
    inwards = np.stack([-at.ty, at.tx], axis=1)[faces:] / np.asarray(at.bend.curvature)[faces:, None]
    np.testing.assert_allclose(middle[faces:] + inwards, centres, atol=1e-12)
    names, places = model.circle_names, np.stack([world.circles.x, world.circles.y], axis=1)
    np.testing.assert_allclose(places[names.index("wheel")], moved(FOUR, time, (-50.0, 40.0)), atol=1e-12)
    np.testing.assert_allclose(places[names.index("post")], moved(TWO, time, (5.0, 60.0)), atol=1e-12)
    # Tips go along with their guides, and nothing that stands still has a speed.
    moving = np.hypot(world.circles.vx, world.circles.vy) > 0
    assert {name for name, moves in zip(names, moving, strict=True) if moves} == fast


@pytest.mark.parametrize(
    ("first", "second", "together"),
    [
        (None, None, True),
        (TWO, TWO, True),
        (TWO, None, False),
        (None, TWO, False),
        (TWO, FOUR, False),
        (ONE, TWO, False),
    ],
)
def test_guides_join_where_they_move_alike(first, second, together):
    left = LineGuide(start=(-20.0, 0.0), end=(0.0, 0.0), motion=first)
    right = LineGuide(start=(0.0, 0.0), end=(20.0, 0.0), motion=second)
    model = build(normalise(machine(left=left, right=right)))
    assert np.asarray(model.guides.faces.joined[1]).tolist() == [float(together), 0.0]
    assert np.asarray(model.guides.faces.joined[0]).tolist() == [0.0, float(together)]


def test_the_program_is_as_long_for_many_movements():
    """One after the other, twelve swinging guides compiled for a minute."""

    def equations(count: int) -> int:
        guides = {
            f"g{k}": LineGuide(start=(20.0 * k, 0.0), end=(20.0 * k + 10.0, 0.0), motion=TWO) for k in range(count)
        }
        scene = replace(machine(**guides), rollers={})  # whose longer profile they would be padded to, one by one
        run = {"duration": 0.01, "dt": 1e-4, "frames": 2}
        return count_equations(lambda s: diffeed.simulate(s, **run), normalise(scene))

    assert equations(16) == equations(8)
