"""A made-up run of the film feeder for tests of pictures: shapes and units of a real one, no physics."""

import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from diffeed.input.parts import SECTIONS, Scene, normalise
from diffeed.model.rollers import is_driven
from diffeed.show.outlines import guide, turning, vector

FEEDER = Path(__file__).parent.parent / "diffeed" / "scenes" / "film_feeder.toml"
BEND, STRAIGHT, RADIUS = np.deg2rad(60.0), 140.0, 79.0  # mm: the sheet's path is straight, bent, straight


def film_feeder(**changes: Any) -> Scene:
    """The shipped film feeder read without the scene file module; `changes` go to the sheet."""
    table = tomllib.loads(FEEDER.read_text())
    table["sheets"]["film"] |= changes
    sections = {key: _parts(key, table.pop(key)) for key in SECTIONS if key in table}
    return normalise(Scene(**sections, **table))


def run(scene: Scene, frames: int = 101, speed: float = 300.0, ok: bool = True) -> Any:
    """A run in which the sheet follows the path at `speed` (mm/s)."""
    time = np.linspace(0.0, 1.0, frames)
    sheets = {name: _sheet(sheet, time, speed) for name, sheet in scene.sheets.items()}
    nodes = next(iter(sheets.values())).nodes
    rollers = {name: _roller(roller, time, nodes) for name, roller in scene.rollers.items()}
    guides = {name: _guide(scene, name, time, nodes) for name in scene.guides}
    failure = SimpleNamespace(describe=lambda: "" if ok else "at 0.6 s, at turn: <b>something</b>")
    return SimpleNamespace(time=time, dt=1e-4, sheets=sheets, rollers=rollers, guides=guides, ok=ok, failure=failure)


def _parts(section: str, rows: dict[str, Any]) -> dict[str, Any]:
    kinds = SECTIONS[section]
    return {name: _part(kinds, dict(row)) for name, row in rows.items()}


def _part(kinds: dict[str, Any], row: dict[str, Any]) -> Any:
    return (kinds[row.pop("kind")] if len(kinds) > 1 else next(iter(kinds.values())))(**row)


def _sheet(sheet: Any, time: np.ndarray, speed: float) -> Any:
    travelled = float(vector(sheet.lead)[0]) + speed * np.maximum(time - 0.02, 0.0)
    places = travelled[:, None] - np.linspace(0.0, float(sheet.length), sheet.bars + 1)
    nodes = _on_path(places)
    steps = nodes[:, :-1] - nodes[:, 1:]
    headings = np.arctan2(steps[..., 1], steps[..., 0])
    middle = 0.5 * (places[:, :-1] + places[:, 1:])
    bent = (middle > STRAIGHT) & (middle < STRAIGHT + RADIUS * BEND)
    force = np.where(bent, 0.02 + 0.05 * np.sin(0.3 * middle) ** 2, 0.0)
    normal = np.stack([-np.sin(headings), np.cos(headings)], axis=-1)
    velocities, rates = np.gradient(nodes, time, axis=0), np.gradient(headings, time, axis=0)
    push = force[..., None] * normal
    return SimpleNamespace(nodes=nodes, velocities=velocities, headings=headings, rates=rates, force=force, push=push)


def _on_path(places: np.ndarray) -> np.ndarray:
    turned = np.clip((places - STRAIGHT) / RADIUS, 0.0, BEND)
    beyond = np.maximum(places - STRAIGHT - RADIUS * BEND, 0.0)
    x = np.minimum(places, STRAIGHT) + RADIUS * np.sin(turned) + beyond * np.cos(BEND)
    y = RADIUS * (1.0 - np.cos(turned)) + beyond * np.sin(BEND)
    return np.stack([x, y], axis=-1)


def _roller(roller: Any, time: np.ndarray, nodes: np.ndarray) -> Any:
    gap = _distance(nodes, vector(roller.center)[None]) - float(roller.radius) - 0.25
    touching = gap < 2.0
    travel = 0.25 * touching if hasattr(roller, "travel") else np.zeros_like(time)
    direction = vector(getattr(roller, "direction", (0.0, 0.0)))
    spin = np.full_like(time, 30.0 * (turning(roller) or 1))
    slip = np.where(touching, 3.0 * np.sin(40.0 * time) * np.exp(-3.0 * time), 0.0) if is_driven(roller) else 0.0 * time
    return SimpleNamespace(
        center=vector(roller.center) + travel[:, None] * direction,
        travel=travel,
        angle=spin * time,
        angular_velocity=spin,
        force=np.where(touching, 5.0 + 0.3 * np.sin(60.0 * time), 0.0),
        friction=0.1 * touching,
        torque=1.0 * touching,
        slip=slip,
        gap=gap,
    )


def _guide(scene: Scene, name: str, time: np.ndarray, nodes: np.ndarray) -> Any:
    gap = _distance(nodes, guide(scene, name).face) - 0.25
    still = np.zeros_like(time)
    return SimpleNamespace(displacement=np.zeros((len(time), 2)), rotation=still, force=0.1 * (gap < 1.0), gap=gap)


def _distance(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Smallest distance of any node to any of some points, frame by frame."""
    return np.min([np.hypot(*(nodes - point).transpose(2, 0, 1)).min(axis=1) for point in points], axis=0)
