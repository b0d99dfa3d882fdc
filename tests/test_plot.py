"""The pictures for print: each returns its axes, says its units and shows what the run holds."""

import dataclasses

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from stand_in import film_feeder, run

import diffeed
from diffeed import plot
from diffeed.input.parts import ArcGuide, Clamp, LineGuide, Motion, Profile, Scene, Sensor, normalise
from diffeed.model.build import build
from diffeed.show import labels, outlines
from optimize.blame_map import Blame
from optimize.pictures import blame_map

SCENE = film_feeder()
RUN = run(SCENE)
PICTURES = {
    "machine": plot.machine,
    "slip": plot.slip,
    "paths": plot.paths,
    "nip_forces": plot.nip_forces,
    "sheet_state": plot.sheet_state,
}


@pytest.mark.parametrize("name", PICTURES)
def test_every_axis_has_a_unit(name):
    ax = PICTURES[name](SCENE, RUN)
    assert isinstance(ax, Axes)
    assert all("(mm" in text or "(s)" in text or "(N" in text for text in (ax.get_xlabel(), ax.get_ylabel()))


@pytest.mark.parametrize("name", PICTURES)
def test_draws_into_given_axes(name):
    _, ax = pyplot.subplots()
    assert PICTURES[name](SCENE, RUN, ax=ax) is ax
    assert len(pyplot.get_fignums()) == 1


def test_machine_names_every_part_and_draws_every_roller():
    ax = plot.machine(SCENE)
    assert {text.get_text() for text in ax.texts} >= set(SCENE.rollers) | set(SCENE.guides)
    circles = [patch.center for patch in ax.patches if isinstance(patch, Circle)]
    for roller in SCENE.rollers.values():
        assert np.min(np.hypot(*(np.array(circles) - np.asarray(roller.center)).T)) < 1e-9
    assert ax.get_aspect() == 1.0


def test_parts_of_one_name_are_all_named():
    """A roller, a guide and a sensor, as `exit` may be."""
    name = next(iter(SCENE.rollers))
    gate = Sensor(position=(100.0, 0.0), direction=(1.0, 0.0))
    scene = dataclasses.replace(SCENE, sensors={name: gate})
    texts = [text.get_text() for text in plot.machine(scene).texts]
    assert texts.count(name) == 2


def test_machine_draws_the_chosen_frames():
    ax = plot.machine(SCENE, RUN, frames=(0, -1))
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["sheet at 0 s", "1 s"]


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        (lambda: plot.machine(SCENE, RUN, frames=(0, 101)), "frames must be from 0 to 100, but one is 101"),
        (lambda: plot.paths(SCENE, RUN, bars=(0, 99)), "bars must be from 0 to 19, but one is 99"),
        (lambda: plot.paths(SCENE, RUN, sheet="note"), 'no sheet named "note"; known: "film"'),
    ],
)
def test_what_is_not_there_is_not_drawn(draw, said):
    with pytest.raises(ValueError, match=said):
        draw()


def test_a_failed_run_is_drawn_until_it_stands():
    """Its last frames are all alike; the last one drawn says so."""
    failed = run(SCENE, ok=False)
    failed.time = np.minimum(failed.time, 0.6)
    texts = [text.get_text() for text in plot.machine(SCENE, failed).get_legend().get_texts()]
    assert texts == ["sheet at 0 s", "0.15 s", "0.3 s", "0.45 s", "0.6 s: failed"]


def test_machine_draws_sensors_and_clamps():
    gate = Sensor(position=(50.0, 0.0), direction=(1.0, 0.0))
    clamps = {"hold": Clamp(sheet="film"), "wall": Clamp(sheet="film", at="tail", kind="wall")}
    ax = plot.machine(normalise(dataclasses.replace(SCENE, sensors={"gate": gate}, clamps=clamps)), RUN)
    assert {"gate", "hold", "wall"} <= {text.get_text() for text in ax.texts}


def test_slip_shows_driven_rollers_only_and_only_in_contact():
    lines = {line.get_label(): line for line in plot.slip(SCENE, RUN).get_lines()}
    shown = {str(name) for name in lines if not str(name).startswith("_")}
    assert shown == {"drive_1", "drive_2", "drive_3"}
    drawn = np.asarray(lines["drive_3"].get_ydata(), dtype=float)
    np.testing.assert_array_equal(np.isnan(drawn), RUN.rollers["drive_3"].force == 0.0)


def test_a_peak_does_not_flatten_the_slip():
    peaked = run(SCENE)
    peaked.rollers["drive_1"].slip[0] = 300.0
    ax = plot.slip(SCENE, peaked)
    assert ax.get_ylim()[1] < 10.0
    assert "to 300 lie off the scale" in ax.texts[0].get_text()
    assert not plot.slip(SCENE, RUN).texts


def test_paths_are_those_of_bar_centres():
    lines = {line.get_label(): line for line in plot.paths(SCENE, RUN, bars=(2,)).get_lines()}
    nodes = RUN.sheets["film"].nodes
    np.testing.assert_array_equal(np.asarray(lines["centre of bar 2"].get_xydata()), 0.5 * (nodes[:, 2] + nodes[:, 3]))


def test_sheet_state_draws_force_too():
    assert "mm" in plot.sheet_state(SCENE, RUN, "force").get_ylabel()


def test_labels_avoid_each_other_and_obstacles():
    wall = np.column_stack([np.linspace(0.0, 100.0, 60), np.full(60, 50.0)])
    wanted = [labels.Label(f"part_{i}", (30.0, 9.0), np.array([[40.0 + 3.0 * i, 50.0]])) for i in range(5)]
    places = labels.place(wanted, wall, (0.0, 0.0, 100.0, 100.0))
    centers = np.array([spot.center for spot in places])
    assert np.all(np.abs(centers[:, 1] - 50.0) >= 4.5)
    for i in range(5):
        away = np.abs(centers - centers[i]) >= np.array([29.99, 8.99])
        away[i] = True
        assert np.all(away.any(axis=1))


def test_no_leader_line_strikes_a_name_through(monkeypatch):
    """Of the long path, whose guides and nips stand close together."""
    placed, place = [], labels.place
    monkeypatch.setattr(
        labels, "place", lambda wanted, *given: placed.append((wanted, place(wanted, *given))) or placed[-1][1]
    )
    plot.machine(diffeed.load_scene("long_path"))
    ((wanted, spots),) = placed
    for label, name in zip(wanted, spots, strict=True):
        for other in (spot for spot in spots if spot is not name):
            line = other.anchor + np.linspace(0.0, 1.0, 200)[:, None] * (other.center - other.anchor)
            inside = np.all(np.abs(line - name.center) < 0.5 * np.array(label.size) - 1.0, axis=1)
            assert not inside.any(), (label.text, other)


def test_turning_reads_speeds_and_profiles():
    drive = SCENE.rollers["drive_1"]
    later = Profile(times=(0.0, 0.1), values=(0.0, 20.0))
    assert outlines.turning(drive) == -1
    assert outlines.turning(dataclasses.replace(drive, angular_speed=later)) == 1
    assert outlines.turning(SCENE.rollers["idle"]) == 0


def test_joined_guides_have_no_tips_where_they_meet():
    corner = {
        "a": LineGuide(start=(0.0, 0.0), end=(10.0, 0.0)),
        "b": LineGuide(start=(10.0, 0.0), end=(20.0, 5.0)),
    }
    scene = normalise(Scene(guides=corner))
    np.testing.assert_allclose(outlines.guide(scene, "a").tips, [[0.0, -0.5, 0.5]])


def test_tips_are_drawn_where_the_model_has_them():
    """A guide that only starts flush with its neighbour has an end there, and so has the neighbour; a drum has none."""
    swing = Motion(times=[0.0, 1.0], displacement=[[0.0, 0.0]] * 2, rotation=[0.0, 20.0], pivot=(10.0, 0.0))
    guides = {
        "still": LineGuide(start=(0.0, 0.0), end=(10.0, 0.0)),
        "diverter": LineGuide(start=(10.0, 0.0), end=(30.0, 0.0), motion=swing),
        "along": LineGuide(start=(30.0, 0.0), end=(40.0, 0.0), motion=swing),
        "drum": ArcGuide(center=(0.0, -60.0), radius=15.0, start_angle=0.0, sweep=-360.0, side="outside"),
    }
    scene = normalise(Scene(sheets=SCENE.sheets, guides=guides, contacts=SCENE.contacts))
    model = build(scene)
    names = [model.circle_names[k] for k in np.flatnonzero(np.asarray(model.circles.active))]
    drawn = {name: len(outlines.guide(scene, name).tips) for name in guides}
    assert drawn == {name: names.count(name) for name in guides} == {"still": 2, "diverter": 1, "along": 1, "drum": 0}


def test_ticks_lie_behind_the_bearing_face():
    arc = ArcGuide(center=(0.0, 0.0), radius=20.0, start_angle=0.0, sweep=90.0)
    line = LineGuide(start=(0.0, 50.0), end=(30.0, 50.0))
    scene = normalise(Scene(guides={"arc": arc, "line": line}))
    assert np.all(np.hypot(*outlines.guide(scene, "arc").ticks[:, 1].T) > 20.5)
    assert np.all(outlines.guide(scene, "line").ticks[:, 1, 1] < 49.0)


def test_moved_turns_about_the_pivot():
    turned = outlines.moved(np.array([[2.0, 1.0]]), (0.0, 3.0), np.pi / 2, (1.0, 1.0))
    np.testing.assert_allclose(turned, [[1.0, 5.0]], atol=1e-12)
    still = Motion(times=(0.0,), displacement=((0.0, 0.0),), rotation=(0.0,), pivot=(4.0, 5.0))
    np.testing.assert_array_equal(outlines.pivot(LineGuide(start=(0, 0), end=(1, 0), motion=still)), [4.0, 5.0])


def test_curvature_of_a_circle():
    headings = np.deg2rad(90.0 - 6.0 * np.arange(8.0))  # turns left along the travel, lead bar first
    np.testing.assert_allclose(outlines.curvature(headings, 2.0), np.deg2rad(6.0) / 2.0)


def test_initial_nodes_lie_behind_the_leading_edge():
    nodes = outlines.initial_nodes(SCENE.sheets["film"])
    np.testing.assert_allclose(nodes[[0, -1]], [[15.0, 0.0], [-185.0, 0.0]], atol=1e-5)


def test_a_blame_map_has_no_arrow_for_what_does_not_matter():
    scene = film_feeder()
    slopes = {
        "rollers.drive_1.center": (3.0, 4.0),
        "rollers.idle.center": (0.0, -1.0),
        "guides.turn.center": (1e-12, 0.0),
    }
    found = Blame(1.0, {path: np.array(slope) for path, slope in slopes.items()}, {})
    arrows = [a for a in blame_map(scene, run(scene), found).texts if a.get_text() == "" and a.get_zorder() == 9]
    starts, tips = ([np.array(place(a)) for a in arrows] for place in (lambda a: a.xyann, lambda a: a.xy))
    assert len(arrows) == 2
    np.testing.assert_allclose(starts[0], diffeed.get(scene, "rollers.drive_1.center"))
    way = tips[0] - starts[0]
    np.testing.assert_allclose(way / np.linalg.norm(way), (-0.6, -0.8))  # downhill


def test_a_name_is_not_put_nearer_to_another_part():
    """Two parts side by side: on its free side each name is as near, and not to be taken for the other's."""
    boxes = [
        labels.Label("one", (30.0, 10.0), np.array([[0.0, 0.0]])),
        labels.Label("two", (30.0, 10.0), np.array([[14.0, 0.0]])),
    ]
    places = labels.place(boxes, np.zeros((0, 2)), (-200.0, -200.0, 200.0, 200.0))
    for mine, other in ((0, 1), (1, 0)):
        center = places[mine].center
        own, foreign = (np.abs(center[0] - boxes[k].anchors[0, 0]) for k in (mine, other))
        assert own <= foreign


def test_a_blame_map_draws_no_gain_that_is_none():
    """Nobody gains ten times what there is by a tenth of a millimetre."""
    slope = {f"rollers.{name}.center": np.array([1e9, 0.0]) for name in SCENE.rollers}
    drawn = blame_map(SCENE, RUN, Blame(12.8, slope, {}))
    assert drawn.get_title(loc="left") == "No gradient to believe: it promises 1e+08 per 0.1 mm of an objective of 12.8"
    assert not [t for t in drawn.texts if "1e+08" in t.get_text()]
    more = blame_map(SCENE, RUN, Blame(12.8, {k: v * 3e-7 for k, v in slope.items()}, {})).get_title(loc="left")
    assert more.endswith("(more than the whole objective, 12.8: directions at most, no amounts)")
    near = blame_map(SCENE, RUN, Blame(1e-9, {k: v * 1e-9 for k, v in slope.items()}, {}), size=12.8)
    assert near.get_title(loc="left").startswith("Which way to move what"), "near its least an objective is small"


def test_a_blame_map_without_arrows_says_why():
    nothing = Blame(0.0, {f"rollers.{name}.center": np.zeros(2) for name in SCENE.rollers}, {})
    assert blame_map(SCENE, RUN, nothing).get_title(loc="left") == "Moving parts does not change the objective"
