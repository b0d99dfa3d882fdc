"""What each feature of a scene costs: a scene that has them all, and the same with one taken away.

Most features are kinds, and cost nothing where they are absent; some are values (gravity, structural damping), and a
program with a zero for them is as long.
"""

from collections.abc import Callable
from typing import Any

from diffeed.base.records import replace
from diffeed.bench.jaxprs import count_equations
from diffeed.bench.timing import Timed, in_turns, once
from diffeed.input.parts import (
    ArcGuide,
    CircleGuide,
    FixedRoller,
    LineGuide,
    Load,
    Motion,
    MovableRoller,
    Profile,
    Scene,
    Sensor,
    normalise,
)
from diffeed.input.scene_file import load_scene
from diffeed.run.rollout import simulate

STEPS, DT = 200, 1e-4
OBSERVERS = ("nips", "arrivals", "energy", "gaps", "curvature", "feed")

Given = tuple[Scene, tuple[str, ...]]
"""A scene and its observers."""
Show = Callable[[int, int, str], None]


def full_scene() -> Scene:
    """The film feeder with what it lacks: speeds that ramp up, a guide that moves, a load, sensors, two friction laws,
    static friction."""
    scene = load_scene("film_feeder")
    ramp = Profile(times=[0.0, 0.02], values=[0.0, -30.0])
    rollers = {n: replace(r, angular_speed=ramp) if _driven(r) else r for n, r in scene.rollers.items()}
    swing = Motion(
        times=[0.0, 0.5], displacement=[[0.0, 0.0], [1.0, 0.0]], rotation=[0.0, 2.0], pivot=(241.5, 84.1)
    )  # fmt: skip
    guides = {**scene.guides, "deflector": replace(scene.guides["deflector"], motion=swing)}
    base = scene.contacts["default"]
    contacts = {"default": replace(base, static_ratio=1.2), "soft": replace(base, friction_law="tanh", exponent=1.5)}
    rollers["idle"] = replace(rollers["idle"], contact="soft")
    return normalise(
        replace(
            scene,
            rollers=rollers,
            guides=guides,
            contacts=contacts,
            loads={"drag": Load(sheet="film", at="tail", force=(-0.01, 0.0))},
            sensors={"gate": Sensor(position=(60.0, 0.0), direction=(1.0, 0.0))},
            initial="given",
        )
    )


def _driven(roller: Any) -> bool:
    return roller.angular_speed is not None


def _without(section: str, kind: type) -> Callable[[Given], Given]:
    """Without the parts of a kind."""

    def change(given: Given) -> Given:
        scene, observers = given
        kept = {n: p for n, p in getattr(scene, section).items() if not isinstance(p, kind)}
        return replace(scene, **{section: kept}), observers

    return change


def _each(section: str, **changes: Any) -> Callable[[Given], Given]:
    """With other values in every part of a section that has such fields."""

    def change(given: Given) -> Given:
        scene, observers = given
        parts = {
            n: replace(p, **{k: v for k, v in changes.items() if hasattr(p, k)})
            for n, p in getattr(scene, section).items()
        }
        return replace(scene, **{section: parts}), observers

    return change


def _fixed_pinches(given: Given) -> Given:
    """Movable rollers on fixed shafts; contacts between rollers go with them."""
    scene, observers = given
    rollers = {
        n: FixedRoller(center=r.center, radius=r.radius, friction=r.friction, inertia=r.inertia)
        if isinstance(r, MovableRoller)
        else r
        for n, r in scene.rollers.items()
    }
    return replace(scene, rollers=rollers), observers


def _without_idle(given: Given) -> Given:
    scene, observers = given
    return replace(scene, rollers={n: r for n, r in scene.rollers.items() if n != "idle"}), observers


def _steady(given: Given) -> Given:
    scene, observers = given
    rollers = {n: replace(r, angular_speed=-30.0) if _driven(r) else r for n, r in scene.rollers.items()}
    return replace(scene, rollers=rollers), observers


def _unseen(name: str) -> Callable[[Given], Given]:
    return lambda given: (given[0], tuple(o for o in given[1] if o != name))


FEATURES: dict[str, Callable[[Given], Given]] = {
    "movable rollers": _fixed_pinches,
    "idle roller": _without_idle,
    "speeds that ramp": _steady,
    "line guides": _without("guides", LineGuide),
    "arc guides": _without("guides", ArcGuide),
    "circle guides, the moving one": _without("guides", CircleGuide),
    "a guide that moves": _each("guides", motion=None),
    "loads": lambda given: (replace(given[0], loads={}), given[1]),
    "sensors": lambda given: (replace(given[0], sensors={}), given[1]),
    "static friction": _each("contacts", static_ratio=None),
    "tanh friction law": _each("contacts", friction_law="sqrt"),
    "uneven exponents": _each("contacts", exponent=1.0, damping_exponent=1.0),
    "gravity": lambda given: (replace(given[0], gravity=(0.0, 0.0)), given[1]),
    "friction": _each("contacts", friction_law="none"),
    "contact damping": _each("contacts", damped=False),
    "structural damping": _each("sheets", structural_damping=0.0),
    **{f"observing {name}": _unseen(name) for name in OBSERVERS},
    "observing anything": lambda given: (given[0], ()),
}
"""What is taken away -> how."""


def features(
    names: tuple[str, ...] | None = None,
    given: Given | None = None,
    times: bool = True,
    show: Show = lambda done, total, text: None,
) -> list[dict[str, Any]]:
    """A row for the full scene, then one for each feature taken away: equations, compile time, time per step."""
    full = (full_scene(), OBSERVERS) if given is None else given
    chosen = tuple(FEATURES) if names is None else names
    rows: list[dict[str, Any]] = []
    made: list[Timed] = []
    for name in ("", *chosen):
        show(len(rows), len(chosen) + 1, f"without {name}" if name else "the full scene")
        scene, observers = full if not name else FEATURES[name](full)
        scene, program = normalise(scene), _program(observers)
        rows.append({"without": name, "equations": count_equations(program, scene)})
        rows[-1]["saved"] = rows[0]["equations"] - rows[-1]["equations"]
        if times:
            made.append(once(program, scene))
    for row, each in zip(rows, in_turns(made), strict=False):  # none is made where no times are asked for
        row.update(compile_seconds=each.compile, us_per_step=1e6 * each.run / STEPS)
    return rows


def _program(observers: tuple[str, ...]) -> Callable[[Scene], Any]:
    return lambda scene: simulate(scene, duration=STEPS * DT, dt=DT, frames=2, observe=observers)


def free_of_charge(rows: list[dict[str, Any]]) -> tuple[list[str], list[str]]:
    """Features that shorten the program when they are absent, and those that do not: values, not kinds."""
    gone = [r for r in rows if r["without"]]
    return [r["without"] for r in gone if r["saved"] > 0], [r["without"] for r in gone if r["saved"] <= 0]
