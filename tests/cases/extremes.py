"""Two structures whose numbers are taken to their ends: two bars and their joint, and a short sheet in a machine.

All rows of a structure run in one compiled batch per method, each with its own step, forwards and backwards. What a row
does not need stands far away.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import CircleGuide, Contact, FixedRoller, LineGuide, Load, Scene, Sheet
from diffeed.faults.causes import CAUSES
from diffeed.input.parts import normalise
from diffeed.run.rollout import Plan, _simulate

METHODS = diffeed.METHODS
EXPLICIT = "runge_kutta"
COUNTS = Plan(frames=9, blocks=2, steps=16)
STEPS = COUNTS.total
AWAY = -500.0
"""mm: where parts stand that a row does not need."""


def by_method(*fast: str, of: tuple[str, ...] = METHODS) -> pytest.MarkDecorator:
    """All methods; those that are not named are asked among the slow tests."""
    return pytest.mark.parametrize("method", [m if m in fast else pytest.param(m, marks=pytest.mark.slow) for m in of])


class Row(NamedTuple):
    """A scene and the step with which it is run, s; an explicit method may need a shorter one."""

    scene: Scene
    dt: float
    explicit_dt: float | None = None


class Run(NamedTuple):
    """What came of a row: plain arrays, and the derivative of the lead's x + y at the end by every number of the scene."""

    scene: Scene
    dt: float
    time: np.ndarray
    sheet: Any
    rollers: Any
    guides: Any
    cause: int
    slopes: Scene

    @property
    def ok(self) -> bool:
        return self.cause == 0

    @property
    def why(self) -> str:
        return CAUSES[self.cause]


@functools.partial(jax.jit, static_argnames="method")
def _run(scenes: Scene, dt: Any, method: str) -> Any:
    def one(scene: Scene, dt: Any) -> Any:
        found = _simulate(scene, dt, None, COUNTS, method, ())
        (sheet,) = found.sheets.values()
        return jnp.sum(sheet.nodes[-1, 0]), (found.time, sheet, found.rollers, found.guides, found.failure.cause)

    return jax.vmap(jax.value_and_grad(one, has_aux=True))(scenes, dt)


def run(rows: dict[str, Row], method: str) -> dict[str, Run]:
    """All rows of one structure by one method."""
    scenes = [normalise(row.scene) for row in rows.values()]
    steps = [row.explicit_dt or row.dt if method == EXPLICIT else row.dt for row in rows.values()]
    (_, shown), slopes = jax.device_get(_run(diffeed.stack(scenes), jnp.asarray(steps), method))

    def cut(tree: Any, k: int) -> Any:
        return jax.tree.map(lambda v: v[k], tree)

    found = {}
    for k, name in enumerate(rows):
        time, sheet, rollers, guides, cause = cut(shown, k)
        found[name] = Run(scenes[k], steps[k], time, sheet, rollers, guides, int(cause), cut(slopes, k))
    return found


def is_finite(tree: Any) -> bool:
    """Every number of a tree."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


# --- two bars ---------------------------------------------------------------------------------------------------------

BAR = 20.0


def bar_mass(sheet: Sheet) -> float:
    """kg."""
    return float(sheet.density * sheet.length * sheet.thickness * sheet.width / sheet.bars)


def bar_inertia(sheet: Sheet) -> float:
    """kg mm2 about the centre, of a bar of finite thickness."""
    return bar_mass(sheet) * float(sheet.thickness**2 + (sheet.length / sheet.bars) ** 2) / 12.0


def joint_stiffness(sheet: Sheet) -> float:
    """kg mm2/s2 per radian: E I / bar length."""
    return 1e3 * float(sheet.youngs_modulus * sheet.width * sheet.thickness**3 / 12.0 / (sheet.length / sheet.bars))


def scissors_frequency(sheet: Sheet) -> float:
    """1/s: two free bars that open and close about their joint, whose centres stay on one line: omega^2 = 2 k/I."""
    return (2.0 * joint_stiffness(sheet) / bar_inertia(sheet)) ** 0.5


def two_bars(angle: float, rate: float = 0.0, *, gravity: float = 0.0, **other: Any) -> Scene:
    """Both bars turned by `angle` (rad) against the line between them, one left, one right."""
    given = {"length": 2.0 * BAR, "thickness": 0.1, "width": 30.0, "density": 8e-7, "youngs_modulus": 3000.0}
    turn = np.degrees(angle)
    sheet = Sheet(bars=2, headings=(turn, -turn), rates=(rate, -rate), **given | other)
    return Scene(sheets={"paper": sheet}, gravity=(0.0, -gravity), initial="given")


OVERDAMPED = 20.0
"""Structural damping of the foil in 2/omega: its share of critical damping."""


def _per_period(scene: Scene, steps: int = STEPS) -> Row:
    return Row(scene, 2.0 * np.pi / scissors_frequency(scene.sheets["paper"]) / steps)


@functools.cache
def sheet_rows() -> dict[str, Row]:
    """Two bars alone. The steps of "fine" rows are half as long."""
    foil = two_bars(0.5, youngs_modulus=2e5, thickness=0.05, density=7.85e-6)
    creep = 2.0 * OVERDAMPED / scissors_frequency(foil.sheets["paper"])
    damped = two_bars(0.5, youngs_modulus=2e5, thickness=0.05, density=7.85e-6, structural_damping=creep)
    rows = {
        "film": _per_period(two_bars(1e-3)),
        "as thick as long": _per_period(two_bars(1e-3, thickness=BAR)),
        "crossing": _per_period(two_bars(np.radians(100.0), youngs_modulus=1.0)),
        "no stiffness": Row(two_bars(0.3, 10.0, youngs_modulus=0.0), 0.2 / STEPS),
        "tissue": _per_period(two_bars(0.5, youngs_modulus=200.0, thickness=0.02)),
    }
    rows |= {f"{name}, fine": Row(row.scene, 0.5 * row.dt) for name, row in rows.items()}
    return rows | {
        "overdamped foil": Row(damped, 2.0 * creep / STEPS, 0.5 / STEPS * creep / OVERDAMPED**2),
        "empty": Row(two_bars(0.0, gravity=9810.0), 1e-4),
    }


@functools.cache
def sheets(method: str) -> dict[str, Run]:
    """The runs of `sheet_rows`."""
    return run(sheet_rows(), method)


# --- a short sheet in a machine ----------------------------------------------------------------------------------------

THICK, RADIUS = 0.125, 10.0
"""mm: powers of two, so that surfaces can just touch without rounding."""
BARS, LENGTH = 4, 40.0
NIP = 5.0 - 0.5 * LENGTH
"""mm: the nip holds the middle of a bar."""


def machine(
    *,
    sheet: dict[str, Any] | None = None,
    contact: dict[str, Any] | None = None,
    bite: float | None = None,
    speed: float = 0.0,
    friction: float = 0.5,
    floor: tuple[tuple[float, float], tuple[float, float]] | None = None,
    floors: int = 1,
    post: tuple[float, float, float] | None = None,
    pull: float = 0.0,
    gravity: float = 0.0,
) -> Scene:
    """A sheet along x with its lead at the origin. `bite` (mm) is how deep the two rollers of the nip stand in it."""
    given = {
        "length": LENGTH,
        "thickness": THICK,
        "width": 30.0,
        "density": 8e-7,
        "youngs_modulus": 3000.0,
        "bars": BARS,
    }
    paper = Sheet(**given | {"velocity": (0.0, 0.0)} | (sheet or {}))
    y = AWAY if bite is None else RADIUS + 0.5 * float(paper.thickness) - bite
    x = AWAY if bite is None else NIP
    rollers = {
        "lower": FixedRoller(center=(x, -y), radius=RADIUS, friction=friction, surface_speed=-speed),
        "upper": FixedRoller(center=(x, y), radius=RADIUS, friction=friction, surface_speed=speed),
    }
    away = ((-600.0, AWAY), (-500.0, AWAY))
    lines = [away if floor is None or k >= floors else floor for k in range(2)]
    guides = {
        "floor": LineGuide(start=lines[0][0], end=lines[0][1], friction=friction),
        "other": LineGuide(start=lines[1][0], end=lines[1][1], friction=friction),
        "post": CircleGuide(
            center=(AWAY, AWAY) if post is None else post[:2], radius=1.0 if post is None else post[2], friction=0.2
        ),
    }
    return Scene(
        sheets={"paper": paper},
        rollers=rollers,
        guides=guides,
        contacts={"default": Contact(**contact or {})},
        loads={"pull": Load(sheet="paper", at="lead", force=(pull, 0.0))},
        gravity=(0.0, -gravity),
        initial="given",
    )


def under(thickness: float, bite: float = 0.0) -> tuple[tuple[float, float], tuple[float, float]]:
    """A floor under the whole sheet, `bite` (mm) deep in it."""
    y = bite - 0.5 * thickness
    return (-100.0, y), (60.0, y)


def wall(x: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """A wall across the way of the sheet."""
    return (x, -50.0), (x, 50.0)


HARD = {"stiffness": 200.0, "exponent": 1.5, "damping": 0.0}
STEADY = {"stiffness": 200.0, "exponent": 1.0, "damping_exponent": 0.0}
"""Damped from the first touch on (Kelvin-Voigt), so that a sheet comes to rest within a run."""
HAIR = 1e-12
"""mm: touching, but for more than rounding, which would decide on which side of a first touch it is."""
BARE = {"stiffness": 200.0, "exponent": 1.5, "damping": 1.0, "smoothing": 0.0}
GLUE = (5.0, 50.0, 1000.0)
BITE, SPEED, PULL = 0.02, 100.0, 0.05
FAST, WALL = 5000.0, 1.0
DEEP = 1.0
SOFT = {"stiffness": 2.0, "exponent": 1.0, "damping": 0.0}


def _laid(thickness: float, modulus: float, damping: float, **more: Any) -> Scene:
    sheet = {"thickness": thickness, "youngs_modulus": modulus}
    contact = STEADY | {"damping": damping}
    return machine(sheet=sheet, contact=contact | more, floor=under(thickness), gravity=9810.0, friction=0.0)


@functools.cache
def contact_rows() -> dict[str, Row]:
    """Everything that needs contact."""
    nip = functools.partial(machine, bite=BITE, speed=SPEED)
    shot = machine(
        sheet={"velocity": (FAST, 0.0), "curl": 1e-3},
        floor=wall(WALL),
        contact={"stiffness": 200.0, "damping": 4.0, "exponent": 1.0},
    )
    dropped = machine(
        sheet={"velocity": (0.0, -100.0)}, contact=STEADY | {"damping": 1e-3}, floor=under(THICK, -0.01), friction=0.2
    )
    deep = machine(floor=under(THICK, DEEP), contact=HARD, friction=0.0)
    return {
        "tissue on a floor": Row(_laid(0.02, 200.0, 1e-4), 1e-4, 1e-5),
        "card on a floor": Row(_laid(0.8, 4000.0, 2e-3), 2e-5, 1e-5),
        "film on a floor": Row(_laid(THICK, 3000.0, 4e-4), 1e-4, 1e-5),
        "two floors": Row(
            machine(contact=STEADY | {"damping": 4e-4}, floor=under(THICK), floors=2, gravity=9810.0, friction=0.0),
            1e-5,
        ),
        "one floor twice": Row(_laid(THICK, 3000.0, 8e-4, stiffness=400.0), 1e-5),
        "no friction": Row(nip(friction=0.0), 1e-4, 1.5e-7),
        **{f"friction {mu:g}": Row(nip(friction=mu, pull=PULL), 1e-4, 1e-5) for mu in GLUE},
        "friction 5 resolved": Row(nip(friction=5.0, pull=PULL), 5e-9),
        "lifted": Row(machine(bite=-0.5, speed=SPEED, contact=BARE | {"damping_exponent": 0.5}), 1e-4),
        "touching, 0.5": Row(machine(bite=-HAIR, speed=SPEED, contact=BARE | {"damping_exponent": 0.5}), 1e-4),
        "touching, 0": Row(machine(bite=-HAIR, speed=SPEED, contact=BARE | {"damping_exponent": 0.0}), 1e-4),
        "dropped": Row(dropped, 2e-6),
        "deep": Row(deep, 1e-4),
        "deep resolved": Row(deep, 1e-7),
        "fast, 1e-3": Row(shot, 1e-3),
        "fast, 1e-4": Row(shot, 1e-4),
        "fast, 1e-5": Row(shot, 1e-5),
        "fast, 1e-6": Row(shot, 1e-6),
        "post on the axis": Row(machine(post=(NIP, 0.0, 0.2), contact=SOFT), 1e-5),
        "post on the lead": Row(machine(post=(0.0, 0.0, 0.2), contact=SOFT), 1e-5),
        "post on a joint": Row(machine(post=(-0.5 * LENGTH, 0.0, 0.2), contact=SOFT), 1e-5),
    }


@functools.cache
def contacts(method: str) -> dict[str, Run]:
    """The runs of `contact_rows`."""
    return run(contact_rows(), method)
