"""From the unit vector that the search moves to the scene that is simulated, and back.

Each variable is one entry u of the vector. It stands for the physical value x(u) = lower + u (upper - lower), or the same
in the logarithm; the search keeps u in [0, 1], either by projection or through u = (1 + z/sqrt(1 + z^2))/2.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from optimize.records import Moved
from optimize.study import Variable

PLACES = ("center", "start", "end")
"""Fields that say where a part stands."""


def physical(variables: Sequence[Variable], unit: Array) -> Array:
    """(..., n) unit values -> (..., n) values in the variables' own units."""
    low, high, log = _bounds(variables)
    straight = low + unit * (high - low)
    safe = np.where(log, low, 1.0)
    ratio = np.where(log, high / safe, 1.0)
    return jnp.where(log, safe * ratio**unit, straight)


def unit(variables: Sequence[Variable], values: Any) -> Array:
    """The inverse of `physical`."""
    low, high, log = _bounds(variables)
    values = jnp.asarray(values, float)
    safe = jnp.where(log, values, 1.0)
    straight = (values - low) / (high - low)
    base = np.where(log, low, 1.0)
    return jnp.where(log, jnp.log(safe / base) / np.log(np.where(log, high / base, math.e)), straight)


def _bounds(variables: Sequence[Variable]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    low, high = np.array([v.bounds for v in variables], dtype=float).T
    return low, high, np.array([v.transform == "log" for v in variables])


def opened(u: Any) -> Any:
    """[0, 1] -> the whole line, for searches that cannot project. The ends are pulled in by 1e-3."""
    s = 2.0 * jnp.clip(u, 1e-3, 1.0 - 1e-3) - 1.0
    return s / jnp.sqrt(1.0 - s * s)


def closed(z: Any) -> Any:
    """The inverse of `opened`: algebraic, so that it neither overflows nor saturates early."""
    return 0.5 * (1.0 + z / jnp.sqrt(1.0 + z * z))


def start_of(variable: Variable, scene: diffeed.Scene) -> float:
    """Where a variable starts: its `start`, else the value in the scene (the mean of several), else no movement."""
    if variable.start is not None:
        return variable.start
    if not variable.paths:
        return 0.0
    return float(np.mean([float(diffeed.get(scene, p)) for p in variable.paths]))


def applied(scene: diffeed.Scene, variables: Sequence[Variable], values: Array) -> diffeed.Scene:
    """The scene with every variable at its value, (n,). Movements add up: a nip may shift and turn."""
    for variable, value in zip(variables, values, strict=True):
        for path in variable.paths:
            scene = diffeed.put(scene, path, value)
        scene = moved(scene, variable, value)
    return scene


def moved(scene: diffeed.Scene, what: Moved, value: Array) -> diffeed.Scene:
    """The scene with parts shifted or turned, or times delayed, by `value`; unchanged where `what` names numbers."""
    for part in what.shift or ():
        scene = shifted(scene, part, what.direction, value)
    for part in what.turn or ():
        scene = turned(scene, part, what.about, value)
    for path in what.delay or ():
        scene = diffeed.put(scene, path, diffeed.get(scene, path) + value)
    return scene


def refuse_moves(scene: diffeed.Scene, what: Moved) -> None:
    """Raises ValueError for a part without a place, and for a delay of what is no time."""
    for part in (*(what.shift or ()), *(what.turn or ())):
        if not places(scene, part):
            raise ValueError(f"{part} has no place that could move; name rollers or guides")
    for path in what.delay or ():
        if (unit := diffeed.unit(scene, path)) != "s" or ".times" not in path:
            raise ValueError(f"delay must name times of profiles or motions, but {path} is none (its unit is {unit})")


def shifted(scene: diffeed.Scene, part: str, direction: Any, value: Array) -> diffeed.Scene:
    """The scene with a roller or guide moved by `value` mm along a direction."""
    way = np.asarray(direction, dtype=float)
    way = way / np.linalg.norm(way)
    for path in [*places(scene, part), *_pivot(scene, part)]:
        scene = diffeed.put(scene, path, diffeed.get(scene, path) + value * way)
    return scene


def turned(scene: diffeed.Scene, part: str, about: Any, value: Array) -> diffeed.Scene:
    """The scene with a roller or guide turned by `value` degrees about a point."""
    centre, angle, pivot = np.asarray(about, dtype=float), jnp.deg2rad(value), _pivot(scene, part)
    c, s = jnp.cos(angle), jnp.sin(angle)

    def by_angle(way: Array) -> Array:
        x, y = way[..., 0], way[..., 1]
        return jnp.stack([c * x - s * y, s * x + c * y], axis=-1)

    for path in [*places(scene, part), *pivot]:
        scene = diffeed.put(scene, path, centre + by_angle(diffeed.get(scene, path) - centre))
    held = diffeed.get(scene, part)
    if hasattr(held, "start_angle"):
        scene = diffeed.put(scene, f"{part}.start_angle", held.start_angle + value)
    if hasattr(held, "direction"):  # the travel of a pinch roller turns with its nip
        scene = diffeed.put(scene, f"{part}.direction", by_angle(held.direction))
    if pivot:  # and so does the way that a part is moved
        path = f"{part}.motion.displacement"
        scene = diffeed.put(scene, path, by_angle(diffeed.get(scene, path)))
    return scene


def places(scene: diffeed.Scene, part: str) -> list[str]:
    """Paths of the points that place a roller or guide."""
    held = diffeed.get(scene, part)
    return [f"{part}.{name}" for name in PLACES if hasattr(held, name)]


def _pivot(scene: diffeed.Scene, part: str) -> list[str]:
    """The path of the point about which a part swings, if it does."""
    return [f"{part}.motion.pivot"] if getattr(diffeed.get(scene, part), "motion", None) is not None else []


def unit_text(scene: diffeed.Scene, variable: Moved) -> str:
    """The unit of a variable."""
    if variable.shift:
        return "mm"
    if variable.delay:
        return "s"
    return "deg" if variable.turn else diffeed.unit(scene, variable.paths[0])
