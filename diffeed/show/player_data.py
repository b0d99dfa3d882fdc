"""A run as plain data for the player: words as JSON, numbers as base64 float32."""

import base64
from typing import Any

import jax
import numpy as np

from diffeed.input.parts import Scene
from diffeed.model.rollers import is_driven
from diffeed.show import outlines

SPARSE_BELOW = 1 / 3  # an array with a smaller share of non-zeros is stored as (index, value) pairs


def run_data(scene: Scene, trajectory: Any) -> dict[str, Any]:
    """All that the player shows of one run."""
    trajectory = jax.device_get(trajectory)
    low, high = outlines.extent(scene, trajectory)
    sheets = {name: _sheet(scene.sheets[name], trajectory.sheets[name]) for name in sorted(scene.sheets)}
    return {
        "failure": "" if trajectory.ok else trajectory.failure.describe(),
        "time": pack(trajectory.time),
        "extent": _rounded([*low, *high]),
        "limits": _limits(scene, trajectory),
        "sheets": sheets,
        "rollers": {name: _roller(scene.rollers[name], trajectory.rollers[name]) for name in sorted(scene.rollers)},
        "guides": {name: _guide(scene, name, trajectory.guides[name]) for name in sorted(scene.guides)},
        "sensors": {name: _rounded(outlines.gate(scene.sensors[name])) for name in sorted(scene.sensors)},
        "clamps": {name: _clamp(scene, name) for name in sorted(scene.clamps)},
    }


def pack(values: Any) -> dict[str, Any]:
    """An array as little-endian float32 in base64, row by row; of one mostly zero only the rest, with its index."""
    array = np.asarray(values, dtype="<f4")
    flat = array.ravel()
    index = np.flatnonzero(flat)
    if index.size < SPARSE_BELOW * flat.size:
        return {"shape": array.shape, "f32": _base64(flat[index]), "index": _base64(index.astype("<u4"))}
    return {"shape": array.shape, "f32": _base64(flat)}


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")


def _rounded(values: Any) -> Any:
    return np.round(outlines.vector(values), 4).tolist()


def _sheet(sheet: Any, track: Any) -> dict[str, Any]:
    return {
        "bars": sheet.bars,
        "barLength": float(sheet.length) / sheet.bars,
        "thickness": float(sheet.thickness),
        "width": float(sheet.width),
        "nodes": pack(track.nodes),
        "force": pack(track.force),
        "push": pack(track.push),
    }


def _roller(roller: Any, track: Any) -> dict[str, Any]:
    direction = outlines.travel_direction(roller)
    return {
        "radius": float(roller.radius),
        "driven": is_driven(roller),
        "turning": outlines.turning(roller),
        "home": _rounded(roller.center),
        "direction": None if direction is None else _rounded(direction),
        "center": pack(track.center),
        "angle": pack(track.angle),
        "force": pack(track.force),
        "slip": pack(track.slip),
        "gap": pack(track.gap),
    }


def _guide(scene: Scene, name: str, track: Any) -> dict[str, Any]:
    outline = outlines.guide(scene, name)
    return {
        "face": _rounded(outline.face),
        "ticks": _rounded(outline.ticks.reshape(-1, 4)),
        "tips": _rounded(outline.tips),
        "pivot": _rounded(outlines.pivot(scene.guides[name])),
        "displacement": pack(track.displacement),
        "rotation": pack(track.rotation),
        "force": pack(track.force),
        "gap": pack(track.gap),
    }


def _clamp(scene: Scene, name: str) -> dict[str, Any]:
    clamp = scene.clamps[name]
    return {"sheet": clamp.sheet, "node": outlines.clamp_node(scene, name), "kind": clamp.kind}


def _limits(scene: Scene, trajectory: Any) -> dict[str, float]:
    """Ends of the colour scales, and the force that an arrow of full length stands for; robust against single peaks."""
    curvature, load, push = [np.zeros(1)], [np.zeros(0)], [np.zeros(0)]
    for name, sheet in scene.sheets.items():
        track = trajectory.sheets[name]
        bent = outlines.curvature(outlines.vector(track.headings), float(sheet.length) / sheet.bars)
        curvature.append(np.abs(bent).ravel())
        load.append(_positive(track.force) / float(sheet.width))
        push.append(_positive(np.hypot(*np.moveaxis(outlines.vector(track.push), -1, 0))))
    return {
        "curvature": _short(outlines.top(np.concatenate(curvature))),
        "load": _short(outlines.top(np.concatenate(load))),
        "push": _short(outlines.top(np.concatenate(push), 95.0)),
    }


def _short(value: float) -> float:
    return float(f"{value:.2g}")


def _positive(values: Any) -> np.ndarray:
    array = outlines.vector(values).ravel()
    return array[array > 0.0]
