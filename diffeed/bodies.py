"""Where rollers and guides are at a time, and how fast they move. Still parts cost nothing here."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from diffeed.model import Arcs, Circles, Drives, Lines, Model, Path
from diffeed.records import replace
from diffeed.shapes import Face
from diffeed.state import State


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
    lines: Lines
    arcs: Arcs
    line_motion: Rigid | None  # None: all still
    arc_motion: Rigid | None
    spin: Array  # (rollers,) rad/s


class Shift(NamedTuple):
    """A rigid movement at one time."""

    dx: Array
    dy: Array
    angle: Array
    vx: Array
    vy: Array
    w: Array
    pivot_x: Array
    pivot_y: Array


def interpolate(times: Array, values: Array, time: Array) -> tuple[Array, Array]:
    """Value and slope of one piecewise linear profile, constant outside."""
    if times.shape[0] == 1:
        return values[0], jnp.zeros_like(values[0])
    k = jnp.clip(jnp.searchsorted(times, time, side="right") - 1, 0, times.shape[0] - 2)
    span = times[k + 1] - times[k]
    slope = jnp.where(span > 0, (values[k + 1] - values[k]) / jnp.where(span > 0, span, 1.0), 0.0)
    inside = (time >= times[0]) & (time < times[-1])
    value = values[k] + slope * (jnp.clip(time, times[0], times[-1]) - times[k])
    return value, jnp.where(inside, slope, 0.0)


def shift_at(path: Path, time: Array) -> Shift:
    """Displacement and turn of a prescribed movement, and their rates."""
    (dx, vx), (dy, vy), (a, w) = (interpolate(path.times, v, time) for v in (path.x, path.y, path.angle))
    return Shift(dx, dy, a, vx, vy, w, path.pivot_x, path.pivot_y)


def _moved(shift: Shift, x: Array, y: Array) -> tuple[Array, Array]:
    c, s = jnp.cos(shift.angle), jnp.sin(shift.angle)
    rx, ry = x - shift.pivot_x, y - shift.pivot_y
    return shift.pivot_x + shift.dx + c * rx - s * ry, shift.pivot_y + shift.dy + s * rx + c * ry


def _turned(shift: Shift, x: Array, y: Array) -> tuple[Array, Array]:
    c, s = jnp.cos(shift.angle), jnp.sin(shift.angle)
    return c * x - s * y, s * x + c * y


def _velocity(shift: Shift, x: Array, y: Array) -> tuple[Array, Array]:
    """Velocity of the moved point (x, y)."""
    rx, ry = x - shift.pivot_x - shift.dx, y - shift.pivot_y - shift.dy
    return shift.vx - shift.w * ry, shift.vy + shift.w * rx


def drive_spins(drives: Drives, time: Array) -> Array:
    """(drives,) rad/s."""
    if drives.times.shape[1] == 1:
        return drives.values[:, 0]
    return jax.vmap(lambda t, v: interpolate(t, v, time)[0])(drives.times, drives.values)


def spins(model: Model, state: State, time: Array) -> Array:
    """(rollers,) rad/s: the prescribed spins at `time`, the free ones from the state."""
    moving, fixed = model.rollers.drives
    return jnp.concatenate([drive_spins(moving, time), state.spin, drive_spins(fixed, time)])


def bodies(model: Model, state: State, time: Array, drive_time: Array) -> Bodies:
    """Pose of every body at `time`; driven shafts turn as prescribed at `drive_time` (the end of an implicit step)."""
    spin = spins(model, state, drive_time)
    circles = _circles_at(model, state, spin)
    lines, arcs, line_motion, arc_motion = model.lines, model.arcs, None, None
    shifts = {key: shift_at(path, time) for key, path in model.paths.items()}
    if any(key.startswith("lines.") for key in shifts):
        line_motion = _still(lines.x, lines.y)
    if any(key.startswith("arcs.") for key in shifts):
        arc_motion = _still(arcs.x, arcs.y)
    for key, shift in shifts.items():
        family, k = key.split(".")
        if family == "circles":
            circles = _move_circle(circles, int(k), shift)
        elif family == "lines" and line_motion is not None:
            lines, line_motion = _move_line(lines, line_motion, int(k), shift)
        elif arc_motion is not None:
            arcs, arc_motion = _move_arc(arcs, arc_motion, int(k), shift)
        if family != "circles":
            circles = _move_tips(model.circles, circles, family, int(k), shift)
    return Bodies(circles, lines, arcs, line_motion, arc_motion, spin)


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


def _put(rigid: Rigid, k: int, x: Array, y: Array, shift: Shift, spin: bool = True) -> Rigid:
    vx, vy = _velocity(shift, x, y)
    w = rigid.w.at[k].add(shift.w) if spin else rigid.w
    return Rigid(rigid.x.at[k].set(x), rigid.y.at[k].set(y), rigid.vx.at[k].set(vx), rigid.vy.at[k].set(vy), w)


def _move_circle(circles: Rigid, k: int, shift: Shift) -> Rigid:
    x, y = _moved(shift, circles.x[k], circles.y[k])
    return _put(circles, k, x, y, shift)


def _move_tips(model: Circles, circles: Rigid, family: str, k: int, shift: Shift) -> Rigid:
    offset = circles.x.shape[0] - len(model.tip_of)
    for j, (owner, index, _) in enumerate(model.tip_of):
        if (owner, index) == (family, k):
            circles = _move_circle(circles, offset + j, shift)
    return circles


def _move_face(face: Face, k: int, shift: Shift) -> Face:
    tips = [_moved(shift, face.tip_x[e][k], face.tip_y[e][k]) for e in (0, 1)]
    tip_x = (face.tip_x[0].at[k].set(tips[0][0]), face.tip_x[1].at[k].set(tips[1][0]))
    tip_y = (face.tip_y[0].at[k].set(tips[0][1]), face.tip_y[1].at[k].set(tips[1][1]))
    return face._replace(tip_x=tip_x, tip_y=tip_y)


def _move_line(lines: Lines, motion: Rigid, k: int, shift: Shift) -> tuple[Lines, Rigid]:
    x, y = _moved(shift, lines.x[k], lines.y[k])
    tx, ty = _turned(shift, lines.tx[k], lines.ty[k])
    moved = replace(
        lines, x=lines.x.at[k].set(x), y=lines.y.at[k].set(y), tx=lines.tx.at[k].set(tx), ty=lines.ty.at[k].set(ty),
        faces=_move_face(lines.faces, k, shift),
    )  # fmt: skip
    return moved, _put(motion, k, x, y, shift)


def _move_arc(arcs: Arcs, motion: Rigid, k: int, shift: Shift) -> tuple[Arcs, Rigid]:
    x, y = _moved(shift, arcs.x[k], arcs.y[k])
    mx, my = _turned(shift, arcs.mid_x[k], arcs.mid_y[k])
    moved = replace(
        arcs, x=arcs.x.at[k].set(x), y=arcs.y.at[k].set(y), mid_x=arcs.mid_x.at[k].set(mx),
        mid_y=arcs.mid_y.at[k].set(my), faces=_move_face(arcs.faces, k, shift),
    )  # fmt: skip
    return moved, _put(motion, k, x, y, shift)
