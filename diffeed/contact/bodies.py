"""Where rollers and guides are at a time, and how fast they move. Still parts cost nothing here."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.records import replace
from diffeed.chain.state import State
from diffeed.contact.movement import Carried, carried, moved, shift_at, turned, velocity
from diffeed.contact.profile import interpolate
from diffeed.model.arrays import Arcs, Drives, Lines, Model
from diffeed.pair.shapes import Face


class Rigid(NamedTuple):
    """Velocity field of bodies: that of the point (x, y), and the spin about it."""

    x: Array
    y: Array
    vx: Array
    vy: Array
    w: Array


class Guides(NamedTuple):
    """Motions of line guides and of arc guides."""

    lines: Rigid
    arcs: Rigid


class Bodies(NamedTuple):
    """Everything a sheet can touch, posed."""

    circles: Rigid  # (circles,): rollers, circle guides, tips
    lines: Lines
    arcs: Arcs
    guide_motion: Guides | None  # of line and arc guides; None: all still
    spin: Array  # (rollers,) rad/s


def drive_spins(drives: Drives, time: Array) -> Array:
    """(drives,) rad/s."""
    return interpolate(drives.times, drives.values, time)[0]


def spins(model: Model, state: State, time: Array) -> Array:
    """(rollers,) rad/s: the prescribed spins at `time`, the free ones from the state."""
    moving, fixed = model.rollers.drives
    return jnp.concatenate([drive_spins(moving, time), state.spin, drive_spins(fixed, time)])


def bodies(model: Model, state: State, time: Array, drive_time: Array) -> Bodies:
    """Pose of every body at `time`; driven shafts turn as prescribed at `drive_time` (the end of an implicit step)."""
    spin = spins(model, state, drive_time)
    circles = _circles_at(model, state, spin)
    lines, arcs, movements = model.lines, model.arcs, model.movements
    if not movements.parts:
        return Bodies(circles, lines, arcs, None, spin)
    shift = shift_at(movements.path, time)
    circles = _move(circles, carried(shift, _of_circles(model)), ~_turns_freely(model))
    if all(family == "circles" for family, _ in movements.parts):
        return Bodies(circles, lines, arcs, None, spin)
    of_lines, of_arcs = (
        carried(shift, movements.of((family, k) for k in range(len(guides.names))))
        for family, guides in (("lines", lines), ("arcs", arcs))
    )
    lines, line_motion = _move_lines(lines, of_lines)
    arcs, arc_motion = _move_arcs(arcs, of_arcs)
    return Bodies(circles, lines, arcs, Guides(line_motion, arc_motion), spin)


def _circles_at(model: Model, state: State, spin: Array) -> Rigid:
    """Circles without prescribed movements: rollers from the state, the rest still."""
    rollers, n = model.rollers, model.rollers.n_movable
    rest = model.circles.x.shape[0] - rollers.n
    still = jnp.zeros((rollers.n - n + rest,))
    return Rigid(
        x=jnp.concatenate([rollers.x[:n] + rollers.dir_x * state.travel, rollers.x[n:], model.circles.x[rollers.n :]]),
        y=jnp.concatenate([rollers.y[:n] + rollers.dir_y * state.travel, rollers.y[n:], model.circles.y[rollers.n :]]),
        vx=jnp.concatenate([rollers.dir_x * state.travel_rate, still]),
        vy=jnp.concatenate([rollers.dir_y * state.travel_rate, still]),
        w=jnp.concatenate([spin, jnp.zeros((rest,))]),
    )


def _still(x: Array, y: Array) -> Rigid:
    zero = jnp.zeros_like(x)
    return Rigid(x, y, zero, zero, zero)


def _of_circles(model: Model) -> np.ndarray:
    """(circles,) which movement carries each along: its own, or that of the guide of which it is a tip; -1: none."""
    tips = model.circles.tip_of
    own = [("circles", k) for k in range(model.circles.x.shape[0] - len(tips))]
    return model.movements.of([*own, *(tip[:2] for tip in tips)])


def _turns_freely(model: Model) -> np.ndarray:
    """(circles,) bool: an arm that turns takes the place of such a roller along, but does not turn it."""
    found = np.zeros(model.circles.x.shape[0], bool)
    found[: model.rollers.n][model.rollers.free] = True
    return found


def arm_spins(model: Model, time: Array) -> Array | float:
    """(free,) rad/s of what carries the bearings of freely turning rollers; 0 where none of them is moved."""
    which = _of_circles(model)[: model.rollers.n][model.rollers.free]
    if np.all(which < 0):
        return 0.0
    return jnp.where(which >= 0, shift_at(model.movements.path, time).w[np.maximum(which, 0)], 0.0)


def _move(rigid: Rigid, by: Carried, turns: np.ndarray | bool = True) -> Rigid:
    x, y = moved(by, rigid.x, rigid.y)
    vx, vy = velocity(by, x, y, (rigid.vx, rigid.vy))
    return Rigid(x, y, vx, vy, jnp.where(by.mask & turns, rigid.w + by.shift.w, rigid.w))


def _move_face(face: Face, by: Carried) -> Face:
    tips = [moved(by, x, y) for x, y in zip(face.tip_x, face.tip_y, strict=True)]
    return face._replace(tip_x=(tips[0][0], tips[1][0]), tip_y=(tips[0][1], tips[1][1]))


def _move_lines(lines: Lines, by: Carried) -> tuple[Lines, Rigid]:
    motion, (tx, ty) = _move(_still(lines.x, lines.y), by), turned(by, lines.tx, lines.ty)
    return replace(lines, x=motion.x, y=motion.y, tx=tx, ty=ty, faces=_move_face(lines.faces, by)), motion


def _move_arcs(arcs: Arcs, by: Carried) -> tuple[Arcs, Rigid]:
    motion, (mid_x, mid_y) = _move(_still(arcs.x, arcs.y), by), turned(by, arcs.mid_x, arcs.mid_y)
    faces = _move_face(arcs.faces, by)
    return replace(arcs, x=motion.x, y=motion.y, mid_x=mid_x, mid_y=mid_y, faces=faces), motion
