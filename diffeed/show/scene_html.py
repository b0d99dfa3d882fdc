"""A scene as it shows itself in a notebook: the machine as a drawing, and what is in it."""

import base64
import io
from html import escape
from typing import Any

import jax
from jax.core import Tracer

from diffeed import plot
from diffeed.base.record_html import record_table, table
from diffeed.input.check_records import check_records
from diffeed.input.parts import MovableRoller, Scene, normalise
from diffeed.model.rollers import is_driven

SHOWN_PROBLEMS = 5


def scene_html(scene: Scene) -> str:
    """Drawing and list of parts; of a batch its first scene; of what cannot be a machine, a gradient say, the reason."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene)):
        return record_table(scene)
    many = _batch(scene)
    one = jax.tree.map(lambda leaf: leaf[0], scene) if many else scene
    problems = check_records(one)
    if problems:
        return record_table(scene) + _why_not(problems)
    one = normalise(one)
    title = f"Batch of {many} scenes, the first drawn" if many else "Scene"
    return table(title, ("", ""), _contents(one)) + _drawing(one)


def _batch(scene: Scene) -> int:
    """How many scenes are stacked in this one; 0: it is one."""
    shape = getattr(scene.gravity, "shape", ())
    return shape[0] if len(shape) == 2 else 0


def _why_not(problems: list[str]) -> str:
    count = "one problem" if len(problems) == 1 else f"{len(problems)} problems"
    lines = "".join(f"<li>{escape(p)}</li>" for p in problems[:SHOWN_PROBLEMS])
    more = "<li>…</li>" if len(problems) > SHOWN_PROBLEMS else ""
    return f"<p>Not drawn. As a machine it has {count} (a gradient is a scene in form only):</p><ul>{lines}{more}</ul>"


def _contents(scene: Scene) -> list[tuple[str, ...]]:
    rows = [
        (name, f"{float(s.length):g} × {float(s.width):g} × {float(s.thickness):g} mm, {s.bars} bars")
        for name, s in scene.sheets.items()
    ]
    driven = [n for n, r in scene.rollers.items() if is_driven(r)]
    sprung = [n for n, r in scene.rollers.items() if isinstance(r, MovableRoller) and n not in driven]
    idle = [n for n in scene.rollers if n not in driven and n not in sprung]
    for kind, names in (
        ("driven rollers", driven),
        ("spring-loaded rollers", sprung),
        ("idle rollers", idle),
        ("guides", list(scene.guides)),
        ("sensors", list(scene.sensors)),
        ("clamps", list(scene.clamps)),
    ):
        if names:
            rows.append((kind, ", ".join(names)))
    return [*rows, ("run", f"{scene.duration:g} s, from the {scene.initial} state")]


def _drawing(scene: Scene) -> str:
    from matplotlib import pyplot

    figure: Any = plot.machine(scene).get_figure(root=True)
    pyplot.close(figure)  # a notebook would show an open figure once more
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130)
    data = base64.b64encode(picture.getvalue()).decode("ascii")
    return f'<img alt="the machine" style="max-width:100%;width:720px" src="data:image/png;base64,{data}">'
