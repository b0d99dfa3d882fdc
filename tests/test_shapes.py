"""Points against the faces of guides: lines and arcs by one formula."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import ArcGuide, LineGuide
from diffeed.input.parts import normalise
from diffeed.model.build import build
from diffeed.pair.shapes import Bend, point_face

SHEET = diffeed.Sheet(length=20.0, thickness=0.1, width=50.0, density=8e-7, youngs_modulus=2000.0, bars=2)
POINTS = np.random.default_rng(5).uniform(-30.0, 30.0, (2, 200))


def faced(points, **guides):
    """Points against guides, (guides, points)."""
    own = build(normalise(diffeed.scene(sheets={"s": SHEET}, guides=guides))).guides
    rows = jax.tree.map(lambda v: v[:, None], own)
    return point_face(*(v[None, :] for v in points), *rows.shape)


@pytest.mark.parametrize("side", ["inside", "outside"])
@pytest.mark.parametrize("sweep", [140.0, -140.0, 300.0])
def test_an_arc_is_its_circle_between_its_ends(side, sweep):
    centre, radius, start = (3.0, -4.0), 12.0, 20.0
    seen = faced(POINTS, arc=ArcGuide(center=centre, radius=radius, start_angle=start, sweep=sweep, side=side))
    x, y = POINTS[0] - centre[0], POINTS[1] - centre[1]
    distance, inwards = np.hypot(x, y), 1.0 if side == "inside" else -1.0
    np.testing.assert_allclose(seen.gap[0], inwards * (radius - distance), atol=1e-12)
    np.testing.assert_allclose(seen.nx[0], -inwards * x / distance, atol=1e-12)
    np.testing.assert_allclose(seen.ny[0], -inwards * y / distance, atol=1e-12)
    turned = np.rad2deg(np.arctan2(y, x)) - start - 0.5 * sweep
    on = np.abs((turned + 180.0) % 360.0 - 180.0) < 0.5 * abs(sweep)
    np.testing.assert_array_equal((np.asarray(seen.beyond[0][0]) < 0) & (np.asarray(seen.beyond[1][0]) < 0), on)
    assert 0 < on.sum() < on.size


def test_past_an_end_of_an_arc_counts_in_mm():
    """To first order, on either side and whichever way the arc was given."""
    for side in ("inside", "outside"):
        for start, sweep in ((0.0, 90.0), (90.0, -90.0)):
            turn = np.deg2rad(0.01)
            points = 50.0 * np.array(
                [[np.cos(-turn), np.cos(np.pi / 2 + turn)], [np.sin(-turn), np.sin(np.pi / 2 + turn)]]
            )
            arc = ArcGuide(center=(0.0, 0.0), radius=50.0, start_angle=start, sweep=sweep, side=side)
            past = np.stack([v[0] for v in faced(points, arc=arc).beyond])
            # What second order leaves is the turn over two, 1e-4 of it.
            np.testing.assert_allclose(np.max(past, axis=0), 50.0 * turn, rtol=2e-4)
            assert np.argmax(past, axis=0).tolist() in ([0, 1], [1, 0])


def test_a_line_beside_an_arc_is_the_line_alone():
    line = LineGuide(start=(-5.0, 2.0), end=(9.0, 6.0))
    arc = ArcGuide(center=(0.0, 0.0), radius=5.0, start_angle=0.0, sweep=90.0)
    alone, beside = faced(POINTS, line=line), faced(POINTS, line=line, arc=arc)
    for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(beside), strict=True):
        np.testing.assert_allclose(one[0], other[0], atol=1e-13)


def test_a_flat_arc_keeps_its_digits_in_single_precision():
    """Radius minus distance would be wrong by 1e-2 mm."""
    k, zero = jnp.float32(1e-5), jnp.zeros((1, 1), jnp.float32)
    u, v = (jnp.asarray(w, jnp.float32)[None, :] for w in POINTS)
    seen = point_face(u, v, zero, zero, zero + 1.0, zero, zero + 50.0, Bend(zero + k, zero + 1.0))
    exact = 1e5 - np.hypot(np.float64(u), 1e5 - np.float64(v))
    assert np.max(np.abs(np.float64(seen.gap) - exact)) < 1e-5


@pytest.mark.parametrize("curvature", [0.0, 0.1, -0.1])
def test_gradients_are_finite_everywhere(curvature):
    """At the middle of a face, at the centre of an arc and opposite its middle."""
    one = jnp.ones((1, 1))

    def total(x, y, k):
        found = point_face(x, y, 0.0 * one, 0.0 * one, one, 0.0 * one, 5.0 * one, Bend(k * one, 0.9 * one))
        return sum(jnp.sum(v) for v in jax.tree.leaves(found))

    for height in (0.0, 10.0, 20.0, -10.0, -20.0):
        slopes = jax.grad(total, argnums=(0, 1, 2))(jnp.zeros(()), jnp.asarray(height), jnp.asarray(curvature))
        assert np.all(np.isfinite(slopes)), (height, slopes)
