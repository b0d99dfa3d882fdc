"""What a scene is turned into: arrays by component, in kg, mm, s.

Nothing of this is stored in a scene. Bars of all sheets stand in one row, sheet after sheet in sorted order, and so do
rollers (grouped by kind), circles and guides: one sweep serves them all, and a missing kind is an empty array.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from diffeed.base.records import record, word
from diffeed.model.layout import Layout
from diffeed.pair.law import Surface
from diffeed.pair.shapes import Bend, Face


@record
class Bars:
    """Everything per bar, (bars,). The joint of a bar is the one behind it; the last bar of a sheet has none (zeros)."""

    mass: Any  # kg
    inertia: Any  # kg mm2
    half_length: Any  # mm
    half_thickness: Any  # mm
    friction_factor: Any
    joint_stiffness: Any  # kg mm2/s2 per rad
    joint_damping: Any  # kg mm2/s per rad
    rest_angle: Any  # rad: heading of this bar minus heading of the next at rest


@record
class Drives:
    """Prescribed spins: piecewise linear, (drives, points)."""

    times: Any  # s
    values: Any  # rad/s


@record
class Rollers:
    """Rollers, grouped: movable driven, movable free, fixed idle, fixed driven; (rollers,) unless said otherwise."""

    x: Any
    y: Any
    radius: Any
    dir_x: Any  # (movable,) unit direction of travel
    dir_y: Any
    mass: Any  # (movable,)
    spring: Any  # (movable,) kg/s2
    preload: Any  # (movable,) kg mm/s2
    damper: Any  # (movable,) kg/s
    stop_low: Any  # (movable,) mm
    stop_high: Any
    stop_stiffness: Any  # (movable,) kg/s2
    inertia: Any  # (free,) kg mm2
    drag: Any  # (free,) kg mm2/s
    travel: Any  # (movable,) initial
    spin: Any  # (free,) initial
    drives: tuple[Drives, Drives]  # of the movable and of the fixed driven rollers
    names: tuple[str, ...] = word(doc="names in the model's order", type=tuple)
    counts: tuple[int, int, int, int] = word(doc="rollers in each group", type=tuple)

    @property
    def movable(self) -> slice:
        return slice(0, self.counts[0] + self.counts[1])

    @property
    def driven(self) -> np.ndarray:
        """(rollers,) bool: the shaft is prescribed."""
        return np.repeat([True, False, False, True], self.counts)

    @property
    def free(self) -> slice:
        return slice(self.counts[0], self.counts[0] + self.counts[1] + self.counts[2])

    @property
    def n(self) -> int:
        return sum(self.counts)

    @property
    def n_movable(self) -> int:
        return self.counts[0] + self.counts[1]

    @property
    def n_free(self) -> int:
        return self.counts[1] + self.counts[2]


@record
class Guides:
    """Line guides, then arc guides, (guides,): faces that bear on the left of their tangent."""

    x: Any  # mm, the middle of the face
    y: Any
    tx: Any  # unit tangent there
    ty: Any
    reach: Any  # mm from there to an end
    bend: Bend | None  # None: there are no arcs
    faces: Face
    names: tuple[str, ...] = word(default=(), doc="names", type=tuple)

    @property
    def shape(self) -> tuple[Any, ...]:
        """What `point_face` and `where_met` ask for, after the points."""
        return self.x, self.y, self.tx, self.ty, self.reach, self.bend


@record
class Circles:
    """What any place of a sheet can touch: rollers first, then circle guides, then the tips of other guides, all their first ones
    and all their second ones; (circles,).

    Positions here are those of guides and tips only; a roller's come from the state.
    """

    x: Any
    y: Any
    radius: Any
    active: Any  # 0 for a tip that is joined to another guide


@record
class Path:
    """A prescribed rigid movement, piecewise linear; (points,), or several, (moved, points)."""

    times: Any
    x: Any
    y: Any
    angle: Any  # rad
    pivot_x: Any
    pivot_y: Any


@record
class Movements:
    """Of moving guides and rollers. Shorter ones repeat their last point."""

    path: Path  # (moved, points)
    parts: tuple[tuple[str, int], ...] = word(
        doc="(family, index) of each; a circle's index counts rollers first", type=tuple
    )

    def of(self, parts: Iterable[tuple[str, int]]) -> np.ndarray:
        """(parts,) which movement each has; -1: none."""
        number = {part: m for m, part in enumerate(self.parts)}
        return np.array([number.get(part, -1) for part in parts], int)


@record
class Hold:
    """One clamp: rows that hold a node or a bar."""

    x: Any  # mm, where the held point belongs
    y: Any
    angle: Any  # rad, where the held heading belongs
    path: Path | None
    bar: int = word(doc="bar in the row", type=int)
    end: float = word(doc="+1 front node, -1 rear node, 0 centre", type=float)
    rows: tuple[str, ...] = word(doc="held directions: x, y, heading", type=tuple)
    wall: bool = word(doc="a wall joint of twice the joint stiffness turns it", type=bool)


@record
class Push:
    """One dead load, in kg mm/s2 and kg mm2/s2."""

    x: Any
    y: Any
    moment: Any
    bar: int = word(doc="bar in the row", type=int)
    end: float = word(doc="+1 front node, -1 rear node", type=float)


@record
class Model:
    """All that never changes during a run."""

    bars: Bars
    rollers: Rollers
    circles: Circles
    guides: Guides
    surface: Surface  # of circles and guides, in that order
    pair_surface: Surface  # roller against roller
    movements: Movements
    holds: tuple[Hold, ...]
    pushes: tuple[Push, ...]
    gravity: Any
    wall_stiffness: Any  # (bars,) joint stiffness of the bar's own sheet, kg mm2/s2
    wall_damping: Any
    layout: Layout = word(doc="static bookkeeping", type=object)
    pairs: tuple[tuple[int, int], ...] = word(default=(), doc="roller pairs that may meet", type=tuple)
    n_circle_guides: int = word(default=0, doc="circle guides among the circles", type=int)
    circle_names: tuple[str, ...] = word(default=(), doc="part behind each circle", type=tuple)
    skin: str = word(default="bars", doc="what of the sheets touches: bars or smooth")
    crowded: bool = word(default=False, doc="whether long lists of contacts are kept", type=bool)
    sticks: tuple[bool, bool] = word(
        default=(False, False), doc="whether any circle, and any guide, has friction that sticks", type=tuple
    )

    @property
    def grips(self) -> tuple[int, int]:
        """Tangential deflections that a state holds: one per circle and sheet, and one per feature on guides."""
        circles = len(self.circle_names) * len(self.layout.names)
        return circles * self.sticks[0], self.layout.tail.shape[0] * self.sticks[1]

    @property
    def body_names(self) -> tuple[str, ...]:
        """Of all bodies, in the order of the contact sweep; a guide's own face and its two tips bear the same name."""
        return (*self.circle_names, *self.guides.names)

    @property
    def has_bodies(self) -> bool:
        return bool(self.body_names)

    @property
    def pair_index(self) -> tuple[np.ndarray, np.ndarray]:
        """First and second roller of each pair."""
        table = np.array(self.pairs, dtype=int).reshape(-1, 2)
        return table[:, 0], table[:, 1]

    @property
    def pairs_by_roller(self) -> tuple[np.ndarray, np.ndarray]:
        """The same pairs, each with one movable roller: (movable, partners) the partner, and which pair it is; -1: none.

        Movable ones are partners of the half of all movable rollers that comes before them in a ring, so that rows are about
        as long.
        """
        m, n = self.rollers.n_movable, self.rollers.n
        number = np.full((n, n), -1)
        i, j = self.pair_index
        number[i, j] = number[j, i] = np.arange(len(self.pairs))
        ahead = (np.arange(m)[:, None] + 1 + np.arange(m // 2)) % max(m, 1)
        fixed = np.broadcast_to(np.arange(m, n), (m, n - m))
        partner = np.concatenate([ahead, fixed], axis=1)
        if m % 2 == 0:  # the one right across the ring is asked by one of the two
            partner[m // 2 :, m // 2 - 1] = -1
        which = np.where(partner < 0, -1, number[np.arange(m)[:, None], partner])
        return partner, which

    @property
    def n_border(self) -> int:
        """Unknowns beside the chain: travels and free spins."""
        return self.rollers.n_movable + self.rollers.n_free
