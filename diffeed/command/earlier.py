"""The results of an earlier `diffeed run`, read back from their folder, to be shown beside those of a new one."""

import json
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from diffeed.base.folders import OutputError
from diffeed.command.outputs import SUMMARY, TRACKED
from diffeed.input.parts import Scene
from diffeed.input.scene_file import load_scene


class Earlier(NamedTuple):
    """A scene, its run as far as pictures need it (time, tracks by part, ok, failure), and its summary."""

    scene: Scene
    run: Any
    summary: dict[str, Any]


def read_run(folder: Path) -> Earlier:
    """What `diffeed run --out FOLDER` has written; OutputError if FOLDER does not hold it, or not whole."""
    if not (folder / SUMMARY).is_file():
        raise OutputError(f"{folder} holds no results of `diffeed run` (there is no {SUMMARY} in it)")
    try:
        summary = json.loads((folder / SUMMARY).read_text("utf-8"))
        with np.load(folder / "data.npz", allow_pickle=False) as data:
            tracks = {key: data[key] for key in data.files}
        if not all(isinstance(summary[key], dict) for key in ("run", "verdict", "sheets", "rollers")):
            raise TypeError(f"{SUMMARY} is not that of a run")
        float(summary["run"]["simulated"])  # what is compared must be there
        return Earlier(load_scene(folder / "scene.toml"), _run(tracks, summary["verdict"]), summary)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise OutputError(f"{folder} holds no whole results of `diffeed run`: {error}") from None


def _run(tracks: dict[str, np.ndarray], verdict: dict[str, Any]) -> Any:
    parts: dict[str, dict[str, Any]] = {section: {} for section in TRACKED}
    for key, values in tracks.items():
        if key != "time":
            section, name, field = key.split(".")
            setattr(parts[section].setdefault(name, SimpleNamespace()), field, values)
    failed, reason = verdict["status"] == "failed", verdict["reason"]
    failure = SimpleNamespace(describe=lambda: reason)
    return SimpleNamespace(time=tracks["time"], ok=not failed, failure=failure, **parts)
