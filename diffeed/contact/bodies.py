"""Where rollers and guides are at a time, and how fast they move. Still parts cost nothing here."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.records import replace
from diffeed.chain.state import State
from diffeed.contact.movement import Carried, carried, moved, shift_at, turned, velocity
from diffeed.contact.profile import interpolate
from diffeed.model.arrays import Drives, Guides, Model
from diffeed.pair.shapes import Face


class Rigid(NamedTuple):
    """Velocity field of bodies: that of the point (x, y), and the spin about it."""

    x: Array
    y: Array
    vx: Array
    vy: Array
    w: Array


class Bodies(NamedTuple):
    """Everything a sheet can touch, posed."""

    circles: Rigid  # (circles,): rollers, circle guides, tips
    guides: Guides
    guide_motion: Rigid | None  # None: all still
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
    guides, movements = model.guides, model.movements
    if not movements.parts:
        return Bodies(circles, guides, None, spin)
    shift = shift_at(movements.path, time)
    circles = _move(circles, carried(shift, _of_circles(model)), ~_turns_freely(model))
    if all(family == "circles" for family, _ in movements.parts):
        return Bodies(circles, guides, None, spin)
    by = carried(shift, movements.of(("guides", k) for k in range(len(guides.names))))
    return Bodies(circles, *_move_guides(guides, by), spin)


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
    tips = [("guides", k) for k in range(len(model.guides.names))] * 2
    own = [("circles", k) for k in range(model.circles.x.shape[0] - len(tips))]
    return model.movements.of(own + tips)


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


def _move_guides(guides: Guides, by: Carried) -> tuple[Guides, Rigid]:
    motion, (tx, ty) = _move(_still(guides.x, guides.y), by), turned(by, guides.tx, guides.ty)
    return replace(guides, x=motion.x, y=motion.y, tx=tx, ty=ty, faces=_move_face(guides.faces, by)), motion
