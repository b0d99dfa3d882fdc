"""The records a user writes: a scene in the engineer's own words.

Units: mm, s, kg, N, N/mm2, rad/s; degrees for angles. Angles, rotations and speeds are positive counter-clockwise.
Every number is a leaf of the pytree, so the gradient of a scene is a scene; kinds, names and counts are static.
"""

import warnings
from contextlib import nullcontext
from importlib import import_module
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from diffeed.base.records import fields, number, part, record, replace, word

T = TypeVar("T")


OF_THE_FIELD = "that of the field"
"""Unit of a profile's values."""


@record
class Profile:
    """A value over time, piecewise linear, constant before the first and after the last point."""

    times: Any = number(unit="s", doc="increasing times", shape=("points",))
    values: Any = number(unit=OF_THE_FIELD, doc="value at each time", shape=("points",))


@record
class Motion:
    """A prescribed rigid movement of a guide or fixed roller (a diverter that swings), piecewise linear in time."""

    times: Any = number(unit="s", doc="increasing times", shape=("points",))
    displacement: Any = number(unit="mm", doc="shift at each time", shape=("points", 2))
    rotation: Any = number(unit="deg", doc="turn about `pivot` at each time", shape=("points",))
    pivot: Any = number(default=(0.0, 0.0), unit="mm", doc="point about which the part turns", shape=(2,))


@record
class Contact:
    """A named set of contact properties: f = stiffness D^exponent + damping D^damping_exponent d', clipped at zero.

    With `damping_exponent` 0 the force jumps at the first touch, by damping times speed, and so do its derivatives.
    `friction_law` "sqrt" and "tanh" regularise friction over `stick_speed`: a load below the limit makes the contact creep.
    "stick" holds it by a tangential deflection of the size of `stick_displacement`, at rest; two rollers on each other and
    the search for the rest state use the square-root law then. "none" has no friction, whatever the parts say, and
    `damped = false` no indentation damping: what all sets of a scene lack is not computed.
    """

    stiffness: Any = number(default=200.0, unit="N/mm^exponent", doc="normal stiffness", bound="positive")
    exponent: Any = number(default=1.0, unit="1", doc="indentation exponent", bound="positive")
    damping: Any = number(
        default=4.0, unit="N s/mm^(1+damping_exponent)", doc="indentation damping", bound="nonnegative"
    )
    damping_exponent: Any = number(default=1.0, unit="1", doc="exponent of the damping term", bound="nonnegative")
    smoothing: Any = number(default=2.0e-3, unit="mm", doc="length of the ramp D(d)", bound="nonnegative")
    stick_speed: Any = number(
        default=3.0, unit="mm/s", doc="speed where friction leaves its viscous ramp", bound="positive"
    )
    static_ratio: Any = number(
        default=None,
        unit="1",
        doc="static over dynamic friction; none: one coefficient",
        bound="positive",
        optional=True,
    )
    transition_speed: Any = number(
        default=30.0, unit="mm/s", doc="speed at which static friction has half gone", bound="positive"
    )
    stick_displacement: Any = number(
        default=2.0e-3,
        unit="mm",
        doc="tangential deflection at which the slope of stuck friction would reach its limit (it does at 1.5 of it)",
        bound="positive",
    )
    friction_law: str = word(
        default="sqrt",
        doc="regularisation of friction: over a speed, or over a displacement; or no friction",
        choices=("sqrt", "tanh", "stick", "none"),
    )
    damped: bool = word(default=True, doc="whether indentation is damped", type=bool)


@record
class Sheet:
    """A sheet of paper or film: a chain of rigid bars. Node 0 is the leading edge.

    Sheets meet rollers and guides only: they pass through themselves and through each other, and a joint may turn as far as
    it likes.
    """

    length: Any = number(unit="mm", doc="length along the feed", bound="positive")
    thickness: Any = number(unit="mm", doc="full thickness; a surface lies half of it off the axis", bound="positive")
    width: Any = number(unit="mm", doc="size out of plane", bound="positive")
    density: Any = number(unit="kg/mm3", doc="density", bound="positive")
    youngs_modulus: Any = number(unit="N/mm2", doc="Young's modulus in bending", bound="nonnegative")
    structural_damping: Any = number(
        default=0.0, unit="s", doc="joint damping over joint stiffness", bound="nonnegative"
    )
    bars: int = word(default=20, doc="number of rigid bars", type=int)
    lead: Any = number(default=(0.0, 0.0), unit="mm", doc="leading edge at the start", shape=(2,))
    heading: Any = number(default=0.0, unit="deg", doc="direction of travel at the start")
    curl: Any = number(default=0.0, unit="1/mm", doc="curvature at rest; positive turns left along the travel")
    speed: Any = number(default=0.0, unit="mm/s", doc="initial speed along the heading of the lead bar")
    friction_factor: Any = number(
        default=1.0, unit="1", doc="scales the friction of every part it touches", bound="nonnegative"
    )
    headings: Any = number(
        default=None,
        unit="deg",
        doc="initial heading bar by bar, lead to tail, instead of `heading`",
        shape=("bars",),
        optional=True,
    )
    rates: Any = number(default=None, unit="rad/s", doc="initial rate of each heading", shape=("bars",), optional=True)
    velocity: Any = number(
        default=None,
        unit="mm/s",
        doc="initial velocity of the leading edge, instead of `speed`",
        shape=(2,),
        optional=True,
    )


_SPEED = "constant or a profile; with neither speed the roller idles"


@record
class FixedRoller:
    """A roller on a fixed shaft: driven if a speed is given, idle if not."""

    center: Any = number(unit="mm", doc="centre", shape=(2,))
    radius: Any = number(unit="mm", doc="radius", bound="positive")
    friction: Any = number(default=0.5, unit="1", doc="friction against the reference sheet", bound="nonnegative")
    angular_speed: Any = number(default=None, unit="rad/s", doc=f"shaft speed, {_SPEED}", optional=True)
    surface_speed: Any = number(default=None, unit="mm/s", doc=f"surface speed at any radius, {_SPEED}", optional=True)
    inertia: Any = number(
        default=1.0, unit="kg mm2", doc="inertia about the shaft (an idle roller's)", bound="positive"
    )
    bearing_drag: Any = number(
        default=0.0, unit="N mm s", doc="drag torque per spin (an idle roller's)", bound="nonnegative"
    )
    spin: Any = number(default=0.0, unit="rad/s", doc="initial spin (an idle roller's)")
    motion: Motion | None = part(default=None, doc="prescribed movement", kinds=(Motion,))
    contact: str = word(default="default", doc="name of the contact set")


@record
class MovableRoller:
    """A spring-loaded pinch roller that travels along a line and turns freely unless a speed is given.

    It is stopped by sheets, other rollers, `travel_min` and `travel_max`, not by guides: a pick roller above a pad needs a stop.
    """

    center: Any = number(unit="mm", doc="centre at travel 0", shape=(2,))
    direction: Any = number(unit="1", doc="direction of its travel; the spring pushes the other way", shape=(2,))
    radius: Any = number(unit="mm", doc="radius", bound="positive")
    mass: Any = number(unit="kg", doc="mass of roller and retainer", bound="positive")
    inertia: Any = number(default=1.0, unit="kg mm2", doc="inertia about the shaft", bound="positive")
    spring: Any = number(default=0.0, unit="N/mm", doc="spring stiffness", bound="nonnegative")
    preload: Any = number(default=0.0, unit="N", doc="spring force at travel 0, against `direction`")
    damper: Any = number(default=0.0, unit="N s/mm", doc="damper along the travel", bound="nonnegative")
    friction: Any = number(default=0.5, unit="1", doc="friction against the reference sheet", bound="nonnegative")
    angular_speed: Any = number(default=None, unit="rad/s", doc=f"shaft speed, {_SPEED}", optional=True)
    surface_speed: Any = number(default=None, unit="mm/s", doc=f"surface speed at any radius, {_SPEED}", optional=True)
    bearing_drag: Any = number(default=0.0, unit="N mm s", doc="drag torque per spin", bound="nonnegative")
    spin: Any = number(default=0.0, unit="rad/s", doc="initial spin if it turns freely")
    travel: Any = number(default=0.0, unit="mm", doc="initial travel")
    travel_min: Any = number(default=None, unit="mm", doc="lower stop; none: no stop", optional=True)
    travel_max: Any = number(default=None, unit="mm", doc="upper stop; none: no stop", optional=True)
    stop_stiffness: Any = number(default=1000.0, unit="N/mm", doc="stiffness of the stops", bound="positive")
    contact: str = word(default="default", doc="name of the contact set")


_DEPTH = "how far behind the face a bar axis is still pushed back"


@record
class LineGuide:
    """A straight guide that bears the sheet on the left of start -> end, with rounded tips."""

    start: Any = number(unit="mm", doc="first end of the bearing face", shape=(2,))
    end: Any = number(unit="mm", doc="second end of the bearing face", shape=(2,))
    friction: Any = number(default=0.2, unit="1", doc="friction against the reference sheet", bound="nonnegative")
    depth: Any = number(default=3.0, unit="mm", doc=_DEPTH, bound="positive")
    tip_radius: Any = number(default=0.5, unit="mm", doc="radius of the rounded ends", bound="nonnegative")
    motion: Motion | None = part(default=None, doc="prescribed movement", kinds=(Motion,))
    contact: str = word(default="default", doc="name of the contact set")


@record
class ArcGuide:
    """A circular arc that bears the sheet on its inside or outside, with rounded tips."""

    center: Any = number(unit="mm", doc="centre of the arc", shape=(2,))
    radius: Any = number(unit="mm", doc="radius of the bearing face", bound="positive")
    start_angle: Any = number(unit="deg", doc="direction of its first end seen from the centre")
    sweep: Any = number(unit="deg", doc="angle from first to second end, positive counter-clockwise")
    friction: Any = number(default=0.2, unit="1", doc="friction against the reference sheet", bound="nonnegative")
    depth: Any = number(default=3.0, unit="mm", doc=_DEPTH, bound="positive")
    tip_radius: Any = number(default=0.5, unit="mm", doc="radius of the rounded ends", bound="nonnegative")
    motion: Motion | None = part(default=None, doc="prescribed movement", kinds=(Motion,))
    side: str = word(default="inside", doc="where the sheet runs", choices=("inside", "outside"))
    contact: str = word(default="default", doc="name of the contact set")


@record
class CircleGuide:
    """A full circle that does not turn; bar faces and end circles both touch it."""

    center: Any = number(unit="mm", doc="centre", shape=(2,))
    radius: Any = number(unit="mm", doc="radius", bound="positive")
    friction: Any = number(default=0.2, unit="1", doc="friction against the reference sheet", bound="nonnegative")
    motion: Motion | None = part(default=None, doc="prescribed movement", kinds=(Motion,))
    contact: str = word(default="default", doc="name of the contact set")


@record
class Clamp:
    """Holds a point of a sheet.

    kind "pin": a node is held, its bars turn freely. "wall": the node at an end is held by a wall joint of twice the joint
    stiffness, so that the free length counts from the node, and the curl too (not with `headings`: there it is at rest as
    written). "bar": a whole bar is held.
    `displacement` and `rotation` are reached at once from the initial position; `motion` moves the clamp in time.
    """

    sheet: str = word(doc="name of the sheet")
    at: Any = word(default="tail", doc='"lead", "tail" or the number of a node (for kind "bar": of a bar)', type=object)
    kind: str = word(default="pin", doc="what is held", choices=("pin", "wall", "bar"))
    free: str = word(default="none", doc="a direction in which it may slide", choices=("none", "x", "y"))
    displacement: Any = number(default=(0.0, 0.0), unit="mm", doc="shift from the initial position", shape=(2,))
    rotation: Any = number(default=0.0, unit="deg", doc="turn of a wall or a held bar from the initial heading")
    motion: Motion | None = part(default=None, doc="prescribed movement (its pivot is not used)", kinds=(Motion,))


@record
class Load:
    """A dead force on a node and a moment on the bar that ends there."""

    sheet: str = word(doc="name of the sheet")
    at: Any = word(default="lead", doc='"lead", "tail" or the number of a node', type=object)
    force: Any = number(default=(0.0, 0.0), unit="N", doc="force", shape=(2,))
    moment: Any = number(default=0.0, unit="N mm", doc="moment, counter-clockwise")


@record
class Sensor:
    """A gate across the path: an edge arrives when it crosses the line through `position` across `direction`."""

    position: Any = number(unit="mm", doc="a point of the path", shape=(2,))
    direction: Any = number(unit="1", doc="direction of travel there", shape=(2,))
    range: Any = number(
        default=20.0, unit="mm", doc="how far off the point the gate still sees the edge", bound="positive"
    )


SECTIONS: dict[str, dict[str, type]] = {
    "sheets": {"sheet": Sheet},
    "rollers": {"fixed": FixedRoller, "movable": MovableRoller},
    "guides": {"line": LineGuide, "arc": ArcGuide, "circle": CircleGuide},
    "contacts": {"contact": Contact},
    "clamps": {"clamp": Clamp},
    "loads": {"load": Load},
    "sensors": {"sensor": Sensor},
}
"""Section of a scene -> word written in a file -> record. A section with one record needs no word."""


@record
class Scene:
    """A machine and the sheets in it. Dictionaries are keyed by part name: letters, digits and underscores."""

    sheets: dict[str, Sheet] = part(doc="sheets", kinds=(Sheet,), many=True, default_factory=dict)
    rollers: dict[str, Any] = part(doc="rollers", kinds=(FixedRoller, MovableRoller), many=True, default_factory=dict)
    guides: dict[str, Any] = part(
        doc="guides", kinds=(LineGuide, ArcGuide, CircleGuide), many=True, default_factory=dict
    )
    contacts: dict[str, Contact] = part(doc="contact sets", kinds=(Contact,), many=True, default_factory=dict)
    clamps: dict[str, Clamp] = part(doc="clamps", kinds=(Clamp,), many=True, default_factory=dict)
    loads: dict[str, Load] = part(doc="nodal loads", kinds=(Load,), many=True, default_factory=dict)
    sensors: dict[str, Sensor] = part(doc="gates across the path", kinds=(Sensor,), many=True, default_factory=dict)
    gravity: Any = number(
        default=(0.0, -9810.0), unit="mm/s2", doc="gravity, on sheets and movable rollers", shape=(2,)
    )
    duration: float = word(default=1.0, doc="length of the run, s", type=float)
    initial: str = word(
        default="settled",
        doc='start from the rest state ("settled") or from the records ("given")',
        choices=("settled", "given"),
    )
    skin: str = word(
        default="bars",
        doc='what touches: bars with round joints ("bars") or the smooth curve through their midpoints ("smooth")',
        choices=("bars", "smooth"),
    )
    crowded: bool = word(
        default=False,
        doc="whether sheets fly to and fro between walls so close that they touch both within a millisecond or two: twice as"
        " many contacts are kept at hand and looked for twice as often, and a step takes longer",
        type=bool,
    )
    goal: str = word(default="", doc="sensor that the tail must pass for the run to count as passed; empty: none")

    def _repr_html_(self) -> str:
        """The machine as a drawing: what a notebook shows for a cell that ends with a scene."""
        # Pictures are made floors above this one, and only a notebook asks for them here.
        return import_module("diffeed.show.scene_html").scene_html(self)


def normalise(scene: Scene) -> Scene:
    """The one door: leaves become float arrays of the default dtype, vectors arrays of shape (2,), names sorted.

    Runs in Python and inside a trace alike. Gives every scene a contact set named "default". TypeError for what is no scene.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"a Scene is needed here, but this is a {type(scene).__name__}: are the arguments in order?")
    contacts = {"default": Contact()} | dict(scene.contacts)
    return _normalise_record(replace(scene, contacts=contacts))


class SinglePrecision(UserWarning):
    """A run in float32: good for looking, not for figures."""


def warn_if_single(scene: Scene) -> None:
    """Say that a normalised scene will run in float32."""
    if scene.gravity.dtype == jnp.float32:
        message = (
            "diffeed runs in float32: forces are good to about three digits. "
            'For figures call jax.config.update("jax_enable_x64", True) first'
        )
        warnings.warn(message, SinglePrecision, stacklevel=3)


def _normalise_record(instance: T) -> T:
    changes: dict[str, Any] = {}
    for f in fields(instance):
        value, role = getattr(instance, f.name), f.metadata["role"]
        if role == "number":
            changes[f.name] = _normalise_number(value)
        elif f.metadata["role"] == "word":
            kind = f.metadata["type"]
            changes[f.name] = value if kind is object else kind(value)
        elif f.metadata["many"]:
            changes[f.name] = {name: _normalise_record(value[name]) for name in sorted(value)}
        elif value is not None:
            changes[f.name] = _normalise_record(value)
    return replace(instance, **changes)


def _normalise_number(value: Any) -> Any:
    if value is None:
        return None
    if isinstance(value, Profile):
        return _normalise_record(value)
    dtype = jnp.result_type(float)
    if isinstance(value, jax.Array) and value.dtype == dtype and not value.weak_type:
        return value
    if isinstance(value, (jax.Array, np.ndarray, np.generic, float, int, list, tuple)):
        known = not any(isinstance(v, Tracer) for v in jax.tree.leaves(value))
        with jax.ensure_compile_time_eval() if known else nullcontext():  # what is known stays known inside a trace
            if isinstance(value, (list, tuple)):
                return jnp.stack([_normalise_number(v) for v in value])
            return jnp.asarray(value, dtype)
    # Anything else is a stand-in that JAX itself put there (a sentinel of tree_map, a ShapeDtypeStruct).
    return value
