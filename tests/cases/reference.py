"""Reference cases computed independently of this package (tests/validation), and the scenes that pose them.

A sheet's node 0 is its leading edge, so a cantilever that leaves the origin along +x is held at its tail.
"""

import functools
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline

import diffeed

DATA = Path(__file__).parent.parent / "validation"
KINDS = {"A": "bar", "B": "wall"}


@functools.cache
def reference(name: str) -> dict[str, Any]:
    """A case: statement, parameters, reference, tolerance."""
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def chain_of(entry: dict[str, Any], bars: int, clamp: str) -> dict[str, Any]:
    """The discrete chain of a parameter set that has this many bars and this clamp."""
    return next(c for c in entry["discrete_chain"] if c["n_bars"] == bars and c["clamp"] == clamp)


def strip(given: dict[str, Any], bars: int, length: float, **more: Any) -> diffeed.Sheet:
    """A sheet of a case's material."""
    return diffeed.Sheet(
        length=length,
        thickness=given["t"],
        width=given["width"],
        density=given.get("rho", 2.2e-6),
        youngs_modulus=given["E"],
        bars=bars,
        **more,
    )


def cantilever(
    given: dict[str, Any],
    bars: int,
    clamp: str,
    length: float,
    *,
    down: float = 0.0,
    gravity: float = 0.0,
    force: tuple[float, float] = (0.0, 0.0),
    moment: float = 0.0,
    damping: float = 0.0,
) -> diffeed.Scene:
    """A sheet that leaves the origin at an angle (rad) below +x. Clamp A holds a bar at its centre, B is a wall."""
    whole = length * bars / (bars - 0.5) if clamp == "A" else length
    sheet = strip(
        given,
        bars,
        whole,
        lead=(length * np.cos(down), -length * np.sin(down)),
        heading=-np.degrees(down),
        structural_damping=damping,
    )
    return diffeed.Scene(
        sheets={"strip": sheet},
        clamps={"root": diffeed.Clamp(sheet="strip", at="tail", kind=KINDS[clamp])},
        loads={"tip": diffeed.Load(sheet="strip", force=force, moment=moment)},
        gravity=(0.0, -gravity),
    )


@functools.cache
def _rest(bars: int) -> Any:
    return jax.jit(diffeed.settle)


def rest(sheet: diffeed.Sheet) -> diffeed.State:
    """A stress-free sheet at rest; clamps do not change it, so that scenes with other clamps can share it."""
    return _rest(sheet.bars)(diffeed.scene(sheets={"strip": sheet}, gravity=(0.0, 0.0)))


@functools.cache
def _linearise() -> Any:
    return jax.jit(diffeed.linearise)


def linearised(scene: diffeed.Scene) -> diffeed.Linearisation:
    """The model about the stress-free sheet, under whatever loads the scene has."""
    return _linearise()(scene, rest(scene.sheets["strip"]))


def node_positions(sheet: diffeed.Sheet, state: diffeed.State) -> jax.Array:
    """(bars + 1, 2) of the only sheet of a scene, lead to tail, from its mass centre and headings."""
    bars = jnp.stack([jnp.cos(state.heading), jnp.sin(state.heading)], axis=1) * (sheet.length / sheet.bars)
    behind = -jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(bars, axis=0)])
    middles = 0.5 * (behind[1:] + behind[:-1])
    centre = jnp.stack([state.x[0], state.y[0]])
    return centre[None, :] + behind - jnp.mean(middles, axis=0)[None, :]


def zero_crossings(time: np.ndarray, track: np.ndarray) -> np.ndarray:
    """Times at which a smooth track is zero."""
    return CubicSpline(time, track).roots(extrapolate=False)


def half_period(time: np.ndarray, track: np.ndarray) -> float:
    """Mean time between zero crossings."""
    return float(np.mean(np.diff(zero_crossings(time, track))))
