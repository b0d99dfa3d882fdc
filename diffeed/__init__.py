"""diffeed: a differentiable simulator of paper and film feeding.

Units: mm, s, kg, N, N/mm2, rad/s; degrees for angles in scenes. Importing this changes no JAX setting: turn on float64
yourself (`jax.config.update("jax_enable_x64", True)`) for results that can be trusted to more than three digits.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diffeed import measures
    from diffeed.chain.state import State
    from diffeed.faults.causes import CAUSES
    from diffeed.gradients.faults import explain_gradient
    from diffeed.gradients.modes import GradientPlan, gradient_plan, value_and_gradient
    from diffeed.gradients.trust import GradientCheck, check_function, gradient_check
    from diffeed.input.check_records import SceneError
    from diffeed.input.check_records import make_scene as scene
    from diffeed.input.parts import (
        ArcGuide,
        CircleGuide,
        Clamp,
        Contact,
        FixedRoller,
        LineGuide,
        Load,
        Motion,
        MovableRoller,
        Profile,
        Scene,
        Sensor,
        Sheet,
        SinglePrecision,
    )
    from diffeed.input.paths import PathError, get, numbers, put, unit
    from diffeed.input.remarks import remarks
    from diffeed.input.scene_file import load_scene, read_scene, save_scene, scene_text, shipped_scenes
    from diffeed.input.stacking import stack
    from diffeed.readings.agreement import Confirmation, confirm
    from diffeed.readings.observe import OBSERVERS
    from diffeed.readings.trajectory import Trajectory
    from diffeed.run.examine import check
    from diffeed.run.rollout import simulate
    from diffeed.statics.rest import settle
    from diffeed.statics.vibrations import Linearisation, linearise
    from diffeed.steppers import METHODS

__version__ = "0.1.0"

__all__ = [
    "CAUSES",
    "METHODS",
    "OBSERVERS",
    "ArcGuide",
    "CircleGuide",
    "Clamp",
    "Confirmation",
    "Contact",
    "FixedRoller",
    "GradientCheck",
    "GradientPlan",
    "LineGuide",
    "Linearisation",
    "Load",
    "Motion",
    "MovableRoller",
    "PathError",
    "Profile",
    "Scene",
    "SceneError",
    "Sensor",
    "Sheet",
    "SinglePrecision",
    "State",
    "Trajectory",
    "check",
    "check_function",
    "confirm",
    "explain_gradient",
    "get",
    "gradient_check",
    "gradient_plan",
    "linearise",
    "load_scene",
    "measures",
    "numbers",
    "put",
    "read_scene",
    "remarks",
    "save_scene",
    "scene",
    "scene_text",
    "settle",
    "shipped_scenes",
    "simulate",
    "stack",
    "unit",
    "value_and_gradient",
]

_MODULES = {
    "readings.agreement": ("Confirmation", "confirm"),
    "faults.causes": ("CAUSES",),
    "input.check_records": ("SceneError",),
    "run.examine": ("check",),
    "gradients.trust": ("GradientCheck", "check_function", "gradient_check"),
    "gradients.faults": ("explain_gradient",),
    "gradients.modes": ("GradientPlan", "gradient_plan", "value_and_gradient"),
    "readings.observe": ("OBSERVERS",),
    "input.parts": (
        "ArcGuide",
        "CircleGuide",
        "Clamp",
        "Contact",
        "FixedRoller",
        "LineGuide",
        "Load",
        "Motion",
        "MovableRoller",
        "Profile",
        "Scene",
        "Sensor",
        "Sheet",
        "SinglePrecision",
    ),
    "input.paths": ("PathError", "get", "numbers", "put", "unit"),
    "input.remarks": ("remarks",),
    "run.rollout": ("simulate",),
    "input.scene_file": ("load_scene", "read_scene", "save_scene", "scene_text", "shipped_scenes"),
    "input.stacking": ("stack",),
    "chain.state": ("State",),
    "statics.rest": ("settle",),
    "statics.vibrations": ("Linearisation", "linearise"),
    "steppers": ("METHODS",),
    "readings.trajectory": ("Trajectory",),
}
_HOMES = {name: (module, name) for module, names in _MODULES.items() for name in names}
_HOMES["scene"] = ("input.check_records", "make_scene")


def __getattr__(name: str) -> Any:
    """Import a name when it is first used: JAX takes most of a second, and a help text needs none of it."""
    if name in ("measures", "plot", "player"):
        return import_module(f"diffeed.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'diffeed' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = getattr(import_module(f"diffeed.{module}"), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "plot", "player", *(name for name in globals() if name.startswith("__"))})
