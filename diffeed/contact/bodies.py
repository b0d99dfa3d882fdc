"""Where rollers and guides are at a time, and how fast they move. Still parts cost nothing here."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.records import replace
from diffeed.chain.state import State
from diffeed.contact.profile import interpolate
from diffeed.model.arrays import Arcs, Circles, Drives, Lines, Model, Path
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
    lines, arcs = model.lines, model.arcs
    line_motion, arc_motion = _still(lines.x, lines.y), _still(arcs.x, arcs.y)
    moves = False
    for key, path in model.paths.items():
        family, k = key.split(".")
        shift, moves = shift_at(path, time), moves or family != "circles"
        mask = _circles_of(model.circles, family, int(k))
        circles = _move(circles, mask, shift, mask & ~_turns_freely(model))
        if family == "lines":
            lines, line_motion = _move_line(lines, line_motion, int(k), shift)
        elif family == "arcs":
            arcs, arc_motion = _move_arc(arcs, arc_motion, int(k), shift)
    return Bodies(circles, lines, arcs, Guides(line_motion, arc_motion) if moves else None, spin)


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


# All entries are moved and a mask keeps the others: writing single entries would chain copies, which the compiler unrolls.


def _circles_of(circles: Circles, family: str, k: int) -> np.ndarray:
    """(circles,) bool: the circles that a movement of one part carries along: itself, or a guide's tips."""
    mask = np.zeros(circles.x.shape[0], bool)
    if family == "circles":
        mask[k] = True
    tips = [(owner, index) == (family, k) for owner, index, _ in circles.tip_of]
    mask[len(mask) - len(tips) :] |= np.array(tips, bool)
    return mask


def _chosen(mask: np.ndarray, new: tuple[Array, Array], old: tuple[Array, Array]) -> tuple[Array, Array]:
    return jnp.where(mask, new[0], old[0]), jnp.where(mask, new[1], old[1])


def _turns_freely(model: Model) -> np.ndarray:
    """(circles,) bool: an arm that turns takes the place of such a roller along, but does not turn it."""
    found = np.zeros(model.circles.x.shape[0], bool)
    found[: model.rollers.n][model.rollers.free] = True
    return found


def arm_spins(model: Model, time: Array) -> Array | float:
    """(free,) rad/s of what carries the bearings of freely turning rollers; 0 where none of them is moved."""
    free = range(*model.rollers.free.indices(model.rollers.n))
    found = {k: shift_at(model.paths[f"circles.{k}"], time).w for k in free if f"circles.{k}" in model.paths}
    return jnp.stack([found.get(k, jnp.zeros(())) for k in free]) if found else 0.0


def _move(rigid: Rigid, mask: np.ndarray, shift: Shift, turned: np.ndarray) -> Rigid:
    place = _moved(shift, rigid.x, rigid.y)
    x, y = _chosen(mask, place, (rigid.x, rigid.y))
    vx, vy = _chosen(mask, _velocity(shift, *place), (rigid.vx, rigid.vy))
    return Rigid(x, y, vx, vy, jnp.where(turned, rigid.w + shift.w, rigid.w))


def _move_face(face: Face, mask: np.ndarray, shift: Shift) -> Face:
    tips = [_chosen(mask, _moved(shift, x, y), (x, y)) for x, y in zip(face.tip_x, face.tip_y, strict=True)]
    return face._replace(tip_x=(tips[0][0], tips[1][0]), tip_y=(tips[0][1], tips[1][1]))


def _move_line(lines: Lines, motion: Rigid, k: int, shift: Shift) -> tuple[Lines, Rigid]:
    mask = np.arange(lines.x.shape[0]) == k
    motion = _move(motion, mask, shift, mask)
    tx, ty = _chosen(mask, _turned(shift, lines.tx, lines.ty), (lines.tx, lines.ty))
    faces = _move_face(lines.faces, mask, shift)
    return replace(lines, x=motion.x, y=motion.y, tx=tx, ty=ty, faces=faces), motion


def _move_arc(arcs: Arcs, motion: Rigid, k: int, shift: Shift) -> tuple[Arcs, Rigid]:
    mask = np.arange(arcs.x.shape[0]) == k
    motion = _move(motion, mask, shift, mask)
    mid_x, mid_y = _chosen(mask, _turned(shift, arcs.mid_x, arcs.mid_y), (arcs.mid_x, arcs.mid_y))
    faces = _move_face(arcs.faces, mask, shift)
    return replace(arcs, x=motion.x, y=motion.y, mid_x=mid_x, mid_y=mid_y, faces=faces), motion
