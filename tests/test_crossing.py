"""Bars across a guide, against plane geometry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffeed import ArcGuide, LineGuide
from diffeed.base.records import replace
from diffeed.chain.kinematics import nodes, pose
from diffeed.chain.state import initial_state
from diffeed.contact.crossing import misplaced
from diffeed.input.parts import normalise
from diffeed.model.build import build
from tests.test_faults import machine, strip

RADIUS, BARS, DEPTH = 15.0, 6, 2.0
LINE = (np.array([-10.0, 3.0]), np.array([12.0, -4.0]))


def crossed(ends: np.ndarray, deep: float, sweep: float, side: str) -> tuple[np.ndarray, np.ndarray]:
    """(bars,) whether each bar, (bars, 2 ends, xy), crosses the arc and whether the line, with one end `deep` behind."""
    a, b = ends[:, 0], ends[:, 1]
    # The arc: where |a + t (b - a)| = R, and at what angle that is from the middle of the arc.
    height = (np.linalg.norm(ends, axis=2) - RADIUS) * (1.0 if side == "outside" else -1.0)
    way = b - a
    square, half, rest = np.sum(way**2, 1), np.sum(a * way, 1), np.sum(a**2, 1) - RADIUS**2
    root = np.sqrt(np.maximum(half**2 - square * rest, 0.0))
    t = np.where(rest > 0, -half - root, -half + root) / square
    x, y = (a + t[:, None] * way).T
    off = np.abs((np.degrees(np.arctan2(y, x)) - (-89.0 + 0.5 * sweep) + 180.0) % 360.0 - 180.0)
    on_arc = (height[:, 0] * height[:, 1] < 0) & (height.min(1) < -deep) & (off <= 0.5 * sweep)
    # The line bears on its left.
    start, along = LINE[0], (LINE[1] - LINE[0]) / np.linalg.norm(LINE[1] - LINE[0])
    height = (ends - start) @ np.array([-along[1], along[0]])
    t = height[:, 0] / (height[:, 0] - height[:, 1])
    place = (a + t[:, None] * way - start) @ along
    there = (place >= 0) & (place <= np.linalg.norm(LINE[1] - LINE[0]))
    return on_arc, (height[:, 0] * height[:, 1] < 0) & (height.min(1) < -deep) & there


@pytest.mark.parametrize("side", ["inside", "outside"])
@pytest.mark.parametrize("sweep", [40.0, 200.0, 355.0, 360.0])
def test_bars_across_a_guide_are_those_that_cross_its_face(sweep, side):
    guides = {
        "arc": ArcGuide(center=(0.0, 0.0), radius=RADIUS, start_angle=-89.0, sweep=sweep, side=side, depth=DEPTH),
        "line": LineGuide(start=tuple(LINE[0]), end=tuple(LINE[1]), depth=DEPTH),
    }
    scene = normalise(machine(strip(lead=(0.0, 22.0), heading=90.0, length=60.0, bars=BARS), guides=guides))
    model = build(scene)
    start, rng, count = initial_state(model, scene), np.random.default_rng(0), 2000

    def seen(x, y, heading):
        state = replace(start, x=x[None], y=y[None], heading=heading)
        found = misplaced(model, state)
        return found.across, jnp.stack(nodes(model, pose(model, state)), axis=-1)

    places = [jnp.asarray(rng.uniform(-40.0, 40.0, count)) for _ in range(2)]
    across, corners = jax.jit(jax.vmap(seen))(*places, jnp.asarray(rng.uniform(-4.0, 4.0, (count, BARS))))
    ends = np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 2)
    for name, wanted in zip(("arc", "line"), crossed(ends, 0.75 * DEPTH, sweep, side), strict=True):
        found = np.any(wanted.reshape(count, BARS), axis=1)
        assert 0 < found.sum() < count
        np.testing.assert_array_equal(across[:, model.guides.names.index(name)], found, name)
