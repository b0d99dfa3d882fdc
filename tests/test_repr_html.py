"""What a notebook shows for a record: a scene as a drawing, any other record as a table of its fields."""

import base64
import io
import re
from html import escape

import jax
import jax.numpy as jnp
import matplotlib.image
import numpy as np
import pytest
from matplotlib import pyplot

import diffeed
from diffeed.base.records import fields, replace
from diffeed.readings.trajectory import Failure


@pytest.fixture(scope="module")
def feeder():
    return diffeed.load_scene("film_feeder")


def drawn(html: str) -> np.ndarray:
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return matplotlib.image.imread(io.BytesIO(base64.b64decode(data)))


def test_a_scene_is_drawn_and_its_parts_are_named(feeder):
    html = feeder._repr_html_()
    picture = drawn(html)
    assert picture.shape[1] > 600
    assert picture[..., :3].std() > 0.05  # lines on white, not an empty page
    for name in (*feeder.sheets, *feeder.rollers, *feeder.guides):
        assert name in html
    assert pyplot.get_fignums() == []


def test_the_drawing_follows_the_scene(feeder):
    moved = diffeed.put(feeder, "rollers.idle.center[1]", 60.0)
    assert not np.array_equal(drawn(feeder._repr_html_()), drawn(moved._repr_html_()))


def test_a_batch_shows_its_first_scene(feeder):
    html = diffeed.stack([feeder, diffeed.put(feeder, "rollers.idle.center[1]", 60.0)])._repr_html_()
    assert "Batch of 2 scenes" in html
    np.testing.assert_array_equal(drawn(html), drawn(feeder._repr_html_()))


def test_what_is_no_machine_says_why(feeder):
    html = diffeed.put(feeder, "rollers.pinch_1.radius", -2.0)._repr_html_()
    assert "<img" not in html
    assert "rollers.pinch_1.radius must be &gt; 0 mm, but is -2.0" in html
    gradient = jax.tree.map(lambda leaf: -jnp.ones_like(leaf), feeder)
    assert "a gradient is a scene in form only" in gradient._repr_html_()


def test_within_a_trace_nothing_is_asked_of_the_numbers(feeder):
    shown = []

    @jax.jit
    def look(scene):
        shown.append(scene._repr_html_() + scene.rollers["pinch_1"]._repr_html_())
        return scene.gravity

    look(feeder)
    assert "traced float64[2]" in shown[0]


@pytest.mark.parametrize("part", ["sheets.film", "rollers.pinch_1", "guides.turn", "contacts.default"])
def test_a_part_shows_every_field_with_its_unit(feeder, part):
    section, name = part.split(".")
    record = getattr(feeder, section)[name]
    html = record._repr_html_()
    for f in fields(record):
        assert f'<td style="text-align:left">{f.name}</td>' in html
        unit = f.metadata.get("unit", "")
        assert unit == "1" or f">{unit}<" in html


@pytest.mark.long
def test_a_run_shows_whether_it_holds(feeder):
    run = diffeed.simulate(feeder, duration=1e-3, dt=5e-4, frames=2)
    html = run._repr_html_()
    assert ">True<" in html
    assert ">film<" in html
    assert "drive_1, drive_2, drive_3" in html
    told = Failure(time=0.1, cause=1, part=0, parts=run.failure.parts)
    assert escape(told.describe()) in replace(run, failure=told)._repr_html_()


def test_names_cannot_break_the_page(feeder):
    film = feeder.sheets["film"]
    html = replace(feeder, sheets={"<script>": film}, rollers={}, guides={})._repr_html_()
    assert "<script>" not in html
