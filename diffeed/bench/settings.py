"""The settings that trade speed for accuracy: a sweep of methods and steps, then one knob at a time.

A setting is plain data. A knob is a function from a scene and a base setting to changed settings; it gives none where
the library or the scene has no such choice.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from diffeed.base.records import fields
from diffeed.input.parts import Contact, Scene
from diffeed.run.rollout import LONGEST
from diffeed.steppers import DEFAULT, ESTIMATING, METHODS

STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
QUICK_STEPS = (5e-4, 2e-4, 1e-4)
TOLERANCES = (1e-1, 1e-2, 1e-3)
"""mm in one step, of error-controlled runs."""
LIGHTER = 1000.0
"""How many times, where inertia is as good as left out."""
NUMERICAL = ("step", "tolerance")
"""Groups that change how the scene is solved; all others change what is solved, and differ by their model."""


@dataclass(frozen=True)
class Setting:
    """How to run a scene: a time stepper, its step, a precision, and changes of the scene as PATH=VALUE."""

    group: str
    method: str
    dt: float  # s; with a tolerance the longest step
    tolerance: float | None = None  # mm in one step
    precision: str = "float64"
    changes: tuple[str, ...] = ()
    label: str = ""  # of a knob, in words

    @property
    def name(self) -> str:
        return f"{self.label} ({self.short})" if self.label else self.short

    @property
    def short(self) -> str:
        return f"{self.method}, {self.size}"

    @property
    def size(self) -> str:
        """What is made smaller for a smaller error."""
        return f"{power(self.dt)} s" if self.tolerance is None else f"{power(self.tolerance)} mm"

    @property
    def numerical(self) -> bool:
        return self.group in NUMERICAL

    def options(self) -> dict[str, Any]:
        """Keyword arguments of `simulate`."""
        chosen = {"dt": self.dt, "method": self.method}
        return chosen if self.tolerance is None else chosen | {"tolerance": self.tolerance}


def power(value: float) -> str:
    """2e-4, 2.5e-4, 0.1: short, and the same in tables, pictures and commands."""
    if value >= 0.01:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def sweep(steps: tuple[float, ...], methods: tuple[str, ...] = METHODS) -> list[Setting]:
    """Every method at every step, coarsest first; then error-controlled runs."""
    found = [Setting("step", method, dt) for method in methods for dt in sorted(steps, reverse=True)]
    chosen = [method for method in methods if method in ESTIMATING]
    return found + [Setting("tolerance", m, LONGEST, tolerance=t) for m in chosen for t in TOLERANCES]


def knobs(scene: Scene, steps: tuple[float, ...], names: tuple[str, ...] | None = None) -> list[Setting]:
    """One change at a time of the default method at the middle step."""
    base = Setting("step", DEFAULT, sorted(steps)[len(steps) // 2])
    return [made for name in (KNOBS if names is None else names) for made in KNOBS[name](scene, base)]


def _bars(scene: Scene, base: Setting) -> Iterator[Setting]:
    for word, factor in (("half the bars", 0.5), ("twice the bars", 2.0)):
        counts = {name: max(2, round(factor * sheet.bars)) for name, sheet in sorted(scene.sheets.items())}
        if all(counts[name] == sheet.bars for name, sheet in scene.sheets.items()):
            continue
        changes = tuple(f"sheets.{name}.bars={count}" for name, count in counts.items())
        yield replace(base, group="bars", label=word, changes=changes)


def _precision(scene: Scene, base: Setting) -> Iterator[Setting]:
    yield replace(base, group="precision", precision="float32", label="float32")


def _skin(scene: Scene, base: Setting) -> Iterator[Setting]:
    for choice in _choices(Scene, "skin"):
        if choice != getattr(scene, "skin", choice):
            yield replace(base, group="skin", label=f"skin {choice}", changes=(f"skin={choice}",))


def _friction(scene: Scene, base: Setting) -> Iterator[Setting]:
    laws = [law for law in _choices(Contact, "friction_law") if law != "none"]  # that would be another machine
    for choice in laws:
        changes = tuple(
            f"contacts.{name}.friction_law={choice}"
            for name, contact in sorted(scene.contacts.items())
            if contact.friction_law != choice
        )
        if changes:
            yield replace(base, group="friction", label=f"friction {choice}", changes=changes)


def _inertia(scene: Scene, base: Setting) -> Iterator[Setting]:
    """As good as quasi-static: a thousandth of all masses under the same weight."""
    parts = [(f"sheets.{n}", s, ("density",)) for n, s in sorted(scene.sheets.items())]
    parts += [(f"rollers.{n}", r, ("mass", "inertia")) for n, r in sorted(scene.rollers.items())]
    light = [
        f"{where}.{name}={float(value) / LIGHTER!r}"
        for where, part, names in parts
        for name in names
        if (value := getattr(part, name, None)) is not None
    ]
    weight = ", ".join(repr(float(v) * LIGHTER) for v in scene.gravity)
    yield replace(base, group="inertia", label="hardly any inertia", changes=(*light, f"gravity=[{weight}]"))


def _choices(kind: type, name: str) -> tuple[str, ...]:
    """The words that a field of a record takes; none if there is no such field."""
    return next((f.metadata["choices"] for f in fields(kind) if f.name == name), ())


KNOBS: dict[str, Callable[[Scene, Setting], Iterator[Setting]]] = {
    "bars": _bars,
    "precision": _precision,
    "skin": _skin,
    "friction": _friction,
    "inertia": _inertia,
}
