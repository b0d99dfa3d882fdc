"""Why a sheet did not pass, in words: where it is, what drives it, which rollers never reached it, what may be the wrong way."""

import jax
import jax.numpy as jnp
import numpy as np

from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.frames import Feeding, approach
from diffeed.readings.gate import crosses, passes
from diffeed.readings.trajectory import Trajectory

BACK = 0.1
"""Of a sheet's length: driven backwards by more is told."""
AT_ODDS = 0.1
"""Of the faster one's speed, and of the frames in which a sheet is driven: rollers that drive it either way are told."""
OFF = (0.01, 3.0)
"""mm that a roller which is meant to hold a sheet may stay off it: less touches, more is another path."""
TOLD = 3
"""Rollers of a kind that are named."""


def reasons(scene: Scene, trajectory: Trajectory, name: str, fed: Feeding, stalled: int | None) -> str:
    """What goes behind the words of a verdict. `fed`: of this sheet, (frames, ...); `stalled`: since which frame, if it is."""
    model = jax.eval_shape(build, scene)  # names and counts only
    told = "" if stalled is None else _slipping(model, *(np.asarray(v)[stalled:] for v in (fed.surface, fed.speed)))
    if model.has_bodies:
        told += _missed(model, scene, trajectory, name)
    return told + _wrong_way(model, scene, trajectory, name, fed)


def still_to_go(scene: Scene, trajectory: Trajectory, name: str, fed: Feeding) -> str:
    """Where the tail is at the end, and how fast its sheet moves: a run that is only too short is seen at once."""
    way = np.asarray(trajectory.sheets[name].nodes)[-1, -1] - np.asarray(scene.sensors[scene.goal].position)
    return f": it is {np.hypot(*way):.3g} mm away, and its sheet moves at {float(fed.speed[-1]):.3g} mm/s"


def _slipping(model: Model, surface: np.ndarray, speed: np.ndarray) -> str:
    """Which rollers turn on under a sheet that stands, those first that do so longest: their (frames, rollers) surface speeds,
    and the sheet's own."""
    turning = surface != 0
    slip = np.sum(np.where(turning, surface - speed[:, None], 0.0), axis=0) / np.maximum(turning.sum(axis=0), 1)
    order = [k for k in np.argsort(-turning.sum(axis=0), kind="stable") if turning[:, k].any()]
    return "".join(f"; {model.rollers.names[k]} slips on it at {abs(slip[k]):.3g} mm/s" for k in order[:TOLD])


def _missed(model: Model, scene: Scene, trajectory: Trajectory, name: str) -> str:
    """Which driven or movable rollers stay just off a sheet that runs past them."""
    rollers, mine = model.rollers, model.layout.owner_of_feature == model.layout.names.index(name)
    gap = np.asarray(approach(scene, trajectory.states).gap)[:, : rollers.n, mine].min(axis=0)
    holding = np.flatnonzero(rollers.driven | (np.arange(rollers.n) < rollers.n_movable))
    found = [
        f"; {rollers.names[i]} stays {gap[i].min():.2g} mm off it"
        for i in holding
        if OFF[0] < gap[i].min() < OFF[1] and gap[i].argmin() > 0  # 0: the lead has not come through
    ]
    return "".join(found[:TOLD])


def _wrong_way(model: Model, scene: Scene, trajectory: Trajectory, name: str, fed: Feeding) -> str:
    """What of the directions that a user gives may be why a sheet did not pass, in words. `fed`: of this sheet, (frames, ...)."""
    told, turns = "", "the angles and speeds of rollers are positive counter-clockwise"
    back = -float(np.trapezoid(np.asarray(fed.wanted), np.asarray(trajectory.time)))
    if back > BACK * float(scene.sheets[name].length):
        told = f", driven backwards by {back:.3g} mm ({turns})"
    elif pair := _against_each_other(np.asarray(fed.surface)):
        forwards, backwards = (model.rollers.names[k] for k in pair)
        told = f"; {forwards} drives it forwards and {backwards} backwards at the same time ({turns})"
    if scene.goal and bool(jnp.any(crosses(scene, trajectory, name, -1.0))):
        told += f"; its tail passed sensor {scene.goal} against the sensor's direction"
    return told + _beside(scene, trajectory, name)


def _beside(scene: Scene, trajectory: Trajectory, name: str) -> str:
    """Whether the tail passed the goal's gate, but out of its range: no longer run would help."""
    if not scene.goal:
        return ""
    through, across = (np.asarray(v) for v in passes(scene, trajectory, name, 1.0))
    nearest, reach = float(across[through].min(initial=np.inf)), float(scene.sensors[scene.goal].range)
    if not reach <= nearest < np.inf:
        return ""
    return f"; its tail passed {nearest:.3g} mm beside sensor {scene.goal}, whose range is {reach:g} mm"


def _against_each_other(speed: np.ndarray) -> tuple[int, int] | None:
    """Of the (frames, rollers) surface speeds of what drives a sheet two that pull it either way, in a good part of the frames
    in which any does."""
    least, most = speed.min(axis=1, initial=0.0), speed.max(axis=1, initial=0.0)
    at_odds = np.minimum(-least, most) > AT_ODDS * np.maximum(-least, most)
    if at_odds.sum() <= AT_ODDS * np.any(speed != 0, axis=1).sum():
        return None
    mean = speed[at_odds].mean(axis=0)
    return int(mean.argmax()), int(mean.argmin())


def place(scene: Scene, trajectory: Trajectory, name: str, frame: int) -> str:
    """Where the lead edge is at a frame, and the part nearest to it."""
    lead = np.asarray(trajectory.sheets[name].nodes)[frame, 0]
    where = f"lead edge at ({lead[0]:.1f}, {lead[1]:.1f}) mm"
    model = jax.eval_shape(build, scene)  # names and counts only
    if not model.has_bodies:
        return where
    k = model.layout.names.index(name)
    gap = np.asarray(approach(scene, trajectory.states).gap)[frame, :, model.layout.starts[k] + k]
    return f"{where}, nearest part {model.body_names[int(np.argmin(np.abs(gap)))]}"
