"""Reference cases of contact computed independently of this package, and small tools that pose them."""

import functools
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

import diffeed

DATA = Path(__file__).parent.parent / "validation"
NEWTON = 1000.0
"""kg mm/s2 in one newton."""


@functools.cache
def case(name: str) -> dict[str, Any]:
    """A case: statement, parameters, reference, tolerance."""
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def plate(mass: float, length: float, **more: Any) -> diffeed.Sheet:
    """A sheet of a given mass: the density follows."""
    given = {"thickness": 0.1, "width": 10.0, "youngs_modulus": 2000.0, "bars": 1} | more
    return diffeed.Sheet(length=length, density=mass / (length * given["thickness"] * given["width"]), **given)


def power_law(stiffness: float, exponent: float, **more: Any) -> diffeed.Contact:
    """The bare power law: no ramp, which would bias a comparison with one, but what a linear one must have at least."""
    given = {"damping": 0.0, "damping_exponent": exponent, "smoothing": 0.0 if exponent > 1.0 else 1e-9} | more
    return diffeed.Contact(stiffness=stiffness, exponent=exponent, **given)


def penetration(force: float, contact: diffeed.Contact) -> float:
    """mm at rest under a force (N), by the power law."""
    return (force / contact.stiffness) ** (1.0 / contact.exponent)


def run(scene: diffeed.Scene, duration: float, steps: int, **options: Any) -> diffeed.Trajectory:
    """A run in a given number of steps. One structure, one compilation: durations and step lengths are traced."""
    trajectory = diffeed.simulate(scene, duration, duration / steps, **options)
    assert bool(trajectory.ok), trajectory.failure.describe()
    return trajectory


def extrapolated(coarse: Any, fine: Any) -> Any:
    """Limit of a first-order method from step lengths h and h/2."""
    return jax.tree.map(lambda a, b: 2.0 * np.asarray(b) - np.asarray(a), coarse, fine)
