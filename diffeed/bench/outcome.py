"""What a run came to, in the numbers that are compared, and how far two runs lie apart."""

from typing import Any, NamedTuple

import jax
import numpy as np

from diffeed.input.parts import Scene
from diffeed.model.rollers import is_driven
from diffeed.readings.trajectory import Trajectory

MEASURES = {
    "lead": ("lead edge", "mm", "largest distance of a lead edge over the frames"),
    "slip": ("slip", "mm/s", "RMS slip of the worst driven roller"),
    "force": ("nip force", "N", "mean force of the worst roller over its time in contact"),
}
"""Name -> title, unit, meaning."""
OBSERVE = ("nips",)


class Outcome(NamedTuple):
    """Plain numbers of one run."""

    time: np.ndarray  # (frames,) s
    leads: dict[str, np.ndarray]  # (frames, 2) mm by sheet
    slip: dict[str, float]  # mm/s, RMS, driven rollers
    force: dict[str, float]  # N, mean over the time in contact


class Difference(NamedTuple):
    """How far two runs lie apart in one measure, and where."""

    value: float
    where: str


def outcome(scene: Scene, trajectory: Trajectory) -> Outcome:
    """The numbers of a finished run that observed `OBSERVE`."""
    trajectory = jax.device_get(trajectory)
    nips = trajectory.observed["nips"]
    driven = [name for name in sorted(scene.rollers) if is_driven(scene.rollers[name])]
    return Outcome(
        time=np.asarray(trajectory.time, float),
        leads={name: np.asarray(sheet.nodes[:, 0], float) for name, sheet in trajectory.sheets.items()},
        slip={name: float(nips[name].slip_rms) for name in driven},
        force={name: float(nips[name].force_mean) for name in sorted(scene.rollers)},
    )


def differences(found: Outcome, reference: Outcome) -> dict[str, Difference | None]:
    """By measure; None where the scene has no such thing."""
    return {
        "lead": _lead(found, reference),
        "slip": _worst(found.slip, reference.slip),
        "force": _worst(found.force, reference.force),
    }


def _lead(found: Outcome, reference: Outcome) -> Difference | None:
    rows = {name: np.linalg.norm(found.leads[name] - reference.leads[name], axis=1) for name in reference.leads}
    if not rows:
        return None
    name = max(rows, key=lambda n: float(np.max(rows[n])))
    frame = int(np.argmax(rows[name]))
    whose = f"{name}, " if len(rows) > 1 else ""
    return Difference(float(rows[name][frame]), f"{whose}{reference.time[frame]:.3g} s")


def _worst(found: dict[str, float], reference: dict[str, float]) -> Difference | None:
    apart: dict[str, Any] = {name: abs(found[name] - reference[name]) for name in reference}
    if not apart:
        return None
    name = max(apart, key=lambda n: apart[n])
    return Difference(apart[name], name)
