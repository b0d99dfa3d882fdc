"""The files of a run in one folder."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from diffeed.base.folders import write_all
from diffeed.base.records import fields
from diffeed.input.parts import Scene
from diffeed.readings.trajectory import Trajectory

SUMMARY = "summary.json"
"""Written last: a folder with a summary is complete."""
TRACKED = ("sheets", "rollers", "guides")
"""Sections of a scene whose parts have tracks."""
PICTURES = ("machine.png", "paths.png", "slip.png", "nip_forces.png")
FILES = (*PICTURES, "player.html", "data.npz", "scene.toml", SUMMARY)


def write_files(
    draft: Path,
    folder: Path,
    scene: Scene,
    trajectory: Trajectory,
    summary: dict[str, Any],
    before: tuple[Scene, Any] | None = None,
) -> list[str]:
    """Write every file of the run and move them to `folder`; the names of the files. `before`: drawn under it in the player."""
    return write_all(draft, folder, _writers(scene, trajectory, summary, before), FILES)


def tracks(trajectory: Trajectory) -> dict[str, np.ndarray]:
    """Every track of a run as plain arrays: "time", "sheets.film.nodes", "rollers.drive_1.slip", "guides.turn.gap"."""
    found = {"time": np.asarray(trajectory.time)}
    for section in TRACKED:
        for name, track in getattr(trajectory, section).items():
            for f in fields(track):
                found[f"{section}.{name}.{f.name}"] = np.asarray(getattr(track, f.name))
    return found


def _writers(
    scene: Scene, trajectory: Trajectory, summary: dict[str, Any], before: tuple[Scene, Any] | None
) -> dict[str, Callable[[Path], Any]]:
    """File name -> what writes it. A run that failed in its first frame has no curves."""
    from diffeed import player, plot
    from diffeed.input.scene_file import save_scene

    writers: dict[str, Callable[[Path], Any]] = {
        "scene.toml": lambda path: save_scene(scene, path),
        "data.npz": lambda path: np.savez(path, **tracks(trajectory)),  # type: ignore[arg-type]
        "machine.png": picture(lambda: plot.machine(scene, trajectory)),
    }
    if len(np.asarray(trajectory.time)) > 1:
        title = summary["run"]["scene"]
        first, second = ((scene, trajectory), None) if before is None else (before, (scene, trajectory))
        writers["player.html"] = lambda path: player.write_player(path, *first, compare=second, title=title)
        writers["paths.png"] = picture(lambda: plot.paths(scene, trajectory, bars=_ends_and_middle(scene)))
        if scene.rollers:
            writers["slip.png"] = picture(lambda: plot.slip(scene, trajectory))
            writers["nip_forces.png"] = picture(lambda: plot.nip_forces(scene, trajectory))
    writers[SUMMARY] = lambda path: path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", "utf-8")
    return writers


def _ends_and_middle(scene: Scene) -> list[int]:
    bars = scene.sheets[min(scene.sheets)].bars
    return sorted({0, bars // 2, bars - 1})


def picture(draw: Callable[[], Any]) -> Callable[[Path], None]:
    """What writes a figure to a path."""
    from diffeed import plot_style

    return lambda path: plot_style.save(path, draw)
