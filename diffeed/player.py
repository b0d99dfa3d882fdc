"""One HTML file that plays a run: it opens from disk in any browser and loads nothing from elsewhere."""

import html
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

from diffeed.base.files import write_whole
from diffeed.input.parts import Scene
from diffeed.show.player_data import run_data

SCRIPTS = ("data.js", "view.js", "labels.js", "paint.js", "charts.js", "app.js")


def write_player(
    path: str | Path,
    scene: Scene,
    trajectory: Any,
    compare: tuple[Scene, Any] | None = None,
    title: str | None = None,
    labels: tuple[str, str] = ("before", "after"),
) -> Path:
    """Write the player of a run to `path` and return it.

    `compare` is (scene, trajectory) of a second run, drawn over the first; `labels` names the first and the second.
    """
    target = Path(path)
    write_whole(target, page(scene, trajectory, compare, title, labels))
    return target


def page(
    scene: Scene,
    trajectory: Any,
    compare: tuple[Scene, Any] | None = None,
    title: str | None = None,
    labels: tuple[str, str] = ("before", "after"),
) -> str:
    """The text of the player's HTML file (for a notebook, or a server)."""
    runs = [run_data(scene, trajectory)]
    if compare is not None:
        runs.append(run_data(*compare))
    data = {"labels": labels[: len(runs)], "runs": runs}
    parts = {
        "title": html.escape(title or "Sheet run"),
        "style": _read("uplot/uPlot.min.css") + _read("page.css"),
        "licence": _read("uplot/LICENSE"),
        "uplot": _read("uplot/uPlot.iife.min.js"),
        "data": _json(data),
        "script": "".join(_read(name) for name in SCRIPTS),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], _read("page.html"))


def _json(data: Any) -> str:
    """Compact JSON in which nothing can end the script element that holds it."""
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


def _read(name: str) -> str:
    return (resources.files("diffeed") / "show" / "player_page" / name).read_text(encoding="utf-8")
