"""The player is one file that needs nothing else, holds the run's numbers and cannot be broken by a title."""

import dataclasses
import json
import re

import numpy as np
import pytest
from packed import unpack
from stand_in import film_feeder, run

from diffeed import plot
from diffeed.player import page, write_player
from diffeed.run.rollout import simulate
from diffeed.show.player_data import pack

SCENE = film_feeder()
RUN = run(SCENE)


def _embedded(text: str) -> dict:
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_writes_one_file_and_returns_its_path(tmp_path):
    target = write_player(tmp_path / "run.html", SCENE, RUN, title="Film feeder")
    assert target == tmp_path / "run.html"
    assert target.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert [path.name for path in tmp_path.iterdir()] == ["run.html"]


def test_loads_nothing_from_elsewhere():
    text = page(SCENE, RUN)
    assert not re.search(r"<(script|link|img|iframe)[^>]*\b(src|href)\s*=\s*[\"']?(?!data:)\w", text)
    assert not re.search(r"url\(|@import|\bfetch\(|XMLHttpRequest|WebSocket|\bimport\(", text)


def test_keeps_the_licence_of_the_chart_library():
    assert "Permission is hereby granted, free of charge" in page(SCENE, RUN)


def test_holds_the_numbers_of_the_run():
    held = _embedded(page(SCENE, RUN))["runs"][0]
    np.testing.assert_array_equal(unpack(held["time"]), RUN.time.astype(np.float32))
    for key in ("nodes", "force", "push"):
        wanted = getattr(RUN.sheets["film"], key).astype(np.float32)
        np.testing.assert_array_equal(unpack(held["sheets"]["film"][key]), wanted)
    for name, roller in RUN.rollers.items():
        for key in ("center", "angle", "force", "slip", "gap"):
            np.testing.assert_array_equal(unpack(held["rollers"][name][key]), getattr(roller, key).astype(np.float32))
    for name, guide in RUN.guides.items():
        for key in ("displacement", "rotation", "force", "gap"):
            np.testing.assert_array_equal(unpack(held["guides"][name][key]), getattr(guide, key).astype(np.float32))


def test_holds_both_runs_of_a_comparison():
    slower = run(SCENE, frames=51, speed=250.0)
    held = _embedded(page(SCENE, RUN, compare=(SCENE, slower), labels=("old", "new")))
    assert held["labels"] == ["old", "new"]
    wanted = slower.sheets["film"].nodes.astype(np.float32)
    np.testing.assert_array_equal(unpack(held["runs"][1]["sheets"]["film"]["nodes"]), wanted)


def test_sparse_arrays_come_back_whole():
    values = np.zeros((40, 30), dtype=np.float32)
    values[3, 7], values[39, 29] = -1.5, np.nan
    packed = pack(values)
    assert "index" in packed
    np.testing.assert_array_equal(unpack(packed), values)
    np.testing.assert_array_equal(unpack(pack(values + 1.0)), values + 1.0)


def test_titles_and_labels_cannot_leave_their_place():
    nasty = "</title></script><script>alert(1)</script>{{data}} & more"
    text = page(SCENE, RUN, compare=(SCENE, RUN), title=nasty, labels=(nasty, "b"))
    assert "<script>alert" not in text
    assert "{{data}} &amp; more" in text
    assert _embedded(text)["labels"][0] == nasty
    assert text.count("</script>") == 3


def test_a_failed_run_can_be_played():
    broken = run(SCENE, ok=False)
    broken.sheets["film"].nodes[60:] = np.nan
    broken.sheets["film"].headings[60:] = np.nan
    held = _embedded(page(SCENE, broken))["runs"][0]
    assert held["failure"] == "at 0.6 s, at turn: <b>something</b>"
    assert np.all(np.isfinite(held["extent"]))
    assert np.all(np.isfinite(list(held["limits"].values())))


@pytest.mark.slow
def test_a_long_run_stays_a_few_megabytes():
    scene = film_feeder(bars=200)
    assert len(page(scene, run(scene, frames=1000))) < 6e6


def test_a_scene_without_rollers_or_guides_has_a_player():
    bare = dataclasses.replace(SCENE, rollers={}, guides={})
    assert _embedded(page(bare, run(bare)))["runs"][0]["rollers"] == {}


@pytest.mark.slow
def test_a_real_run_can_be_played_and_drawn():
    real = simulate(SCENE, duration=0.01, dt=5e-4, frames=3)
    held = _embedded(page(SCENE, real))["runs"][0]
    assert held["failure"] == ""
    wanted = np.asarray(real.sheets["film"].nodes, dtype=np.float32)
    np.testing.assert_array_equal(unpack(held["sheets"]["film"]["nodes"]), wanted)
    for draw in (plot.machine, plot.slip, plot.paths, plot.nip_forces, plot.sheet_state):
        draw(SCENE, real)
