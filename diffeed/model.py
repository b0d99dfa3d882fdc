"""Model: a scene turned into arrays by component, in kg, mm, s. `build` is pure jax.numpy, so gradients pass through it.

Nothing of this is stored in a scene. Bars of all sheets stand in one row, sheet after sheet in sorted order, and so do
rollers (grouped by kind), circles, lines and arcs: one sweep serves them all, and a missing kind is an empty array.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.contact_law import Surface
from diffeed.packing import stacked
from diffeed.parts import (
    ArcGuide,
    CircleGuide,
    Clamp,
    FixedRoller,
    LineGuide,
    Motion,
    MovableRoller,
    Profile,
    Scene,
    Sheet,
)
from diffeed.records import record, word
from diffeed.shapes import Face

NEWTON = 1000.0
"""kg mm/s2 in one newton: the one place where forces change unit."""
JOIN_TOLERANCE = 1e-3
"""mm: guide ends closer than this are one end."""


@dataclass(frozen=True)
class Layout:
    """Static bookkeeping of the row of bars: names, bar counts, index arrays."""

    names: tuple[str, ...]
    bars: tuple[int, ...]

    @cached_property
    def starts(self) -> tuple[int, ...]:
        return tuple(int(v) for v in np.cumsum((0, *self.bars)))

    @cached_property
    def n_bars(self) -> int:
        return sum(self.bars)

    @cached_property
    def sheet_of_bar(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.bars)), self.bars)

    @cached_property
    def first(self) -> np.ndarray:
        """(bars,) bool: the bar leads its sheet."""
        return np.isin(np.arange(self.n_bars), self.starts[:-1])

    @cached_property
    def last(self) -> np.ndarray:
        return np.isin(np.arange(self.n_bars) + 1, self.starts[1:])

    @cached_property
    def tail(self) -> np.ndarray:
        """(features,) bool: the feature is a tail's end circle; the others are bars (on the smooth skin: pieces)."""
        return np.concatenate([np.arange(n + 1) == n for n in self.bars])

    @cached_property
    def sheet_of_feature(self) -> np.ndarray:
        """(features, sheets) bool."""
        owner = np.repeat(np.arange(len(self.bars)), np.array(self.bars) + 1)
        return owner[:, None] == np.arange(len(self.bars))[None, :]

    @cached_property
    def first_feature(self) -> np.ndarray:
        return np.concatenate([np.arange(n + 1) == 0 for n in self.bars])

    @cached_property
    def last_feature(self) -> np.ndarray:
        """(features,) bool: the feature is the last bar of its sheet."""
        return np.concatenate([np.arange(n + 1) == n - 1 for n in self.bars])

    def slices(self) -> list[slice]:
        return [slice(a, b) for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]

    def bar(self, sheet: str, at: Any, whole: bool = False) -> tuple[int, float]:
        """Bar in the row and which end of it (+1 front, -1 rear, 0 for a whole bar) that `at` names."""
        k = self.names.index(sheet)
        count, start = self.bars[k], self.starts[k]
        node = 0 if at == "lead" else count if at == "tail" else int(at)
        if whole:
            return start + min(node, count - 1), 0.0
        return (start + node, 1.0) if node < count else (start + count - 1, -1.0)


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
class Lines:
    """Line guides, (lines,)."""

    x: Any
    y: Any
    tx: Any
    ty: Any
    length: Any
    faces: Face
    names: tuple[str, ...] = word(default=(), doc="names", type=tuple)


@record
class Arcs:
    """Arc guides, (arcs,)."""

    x: Any
    y: Any
    radius: Any
    mid_x: Any
    mid_y: Any
    cos_quarter: Any  # of a quarter of the sweep; 0 for a full turn, which has no ends
    sin_quarter: Any
    side: Any
    faces: Face
    names: tuple[str, ...] = word(default=(), doc="names", type=tuple)


@record
class Circles:
    """What any place of a sheet can touch: rollers first, then circle guides, then the free tips of lines and arcs; (circles,).

    Positions here are those of guides and tips only; a roller's come from the state.
    """

    x: Any
    y: Any
    radius: Any
    active: Any  # 0 for a tip that is joined to another guide
    tip_of: tuple[tuple[str, int, int], ...] = word(default=(), doc="(family, index, end) of each tip", type=tuple)


@record
class Path:
    """A prescribed rigid movement, piecewise linear; (points,)."""

    times: Any
    x: Any
    y: Any
    angle: Any  # rad
    pivot_x: Any
    pivot_y: Any


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
    lines: Lines
    arcs: Arcs
    surface: Surface  # of circles, lines and arcs, in that order
    pair_surface: Surface  # roller against roller
    paths: dict[str, Path]  # of moving guides and rollers, by "family.index"
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
    sticks: tuple[bool, bool] = word(
        default=(False, False), doc="whether any circle, and any line or arc, has friction that sticks", type=tuple
    )

    @property
    def grips(self) -> tuple[int, int]:
        """Tangential deflections that a state holds: one per circle and sheet, and one per feature on lines and arcs."""
        circles = len(self.circle_names) * len(self.layout.names)
        return circles * self.sticks[0], self.layout.tail.shape[0] * self.sticks[1]

    @property
    def body_names(self) -> tuple[str, ...]:
        """Of all bodies, in the order of the contact sweep; a guide's own face and its two tips bear the same name."""
        return (*self.circle_names, *self.lines.names, *self.arcs.names)

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


def build(scene: Scene) -> Model:
    """Model of a normalised scene; inside a trace or outside."""
    names = sorted(scene.sheets)
    sheets = [scene.sheets[name] for name in names]
    layout = Layout(tuple(names), tuple(sheet.bars for sheet in sheets))
    rollers, roller_parts = _rollers(scene)
    lines, arcs = _named(scene.guides, LineGuide), _named(scene.guides, ArcGuide)
    circle_guides = _named(scene.guides, CircleGuide)
    line_set, arc_set = _lines_and_arcs(lines, arcs)
    circles, circle_owners = _circles(rollers, roller_parts, circle_guides, (lines, line_set), (arcs, arc_set))
    owners = circle_owners + lines + arcs
    pairs = tuple((i, j) for i in range(rollers.n_movable) for j in range(i + 1, rollers.n))
    return Model(
        bars=_bars(sheets, layout),
        rollers=rollers,
        circles=circles,
        lines=line_set,
        arcs=arc_set,
        surface=_surface(scene, owners),
        pair_surface=_pair_surface(scene, roller_parts, pairs),
        paths=_paths(roller_parts, circle_guides, lines, arcs, len(roller_parts)),
        holds=tuple(_hold(scene, layout, scene.clamps[name]) for name in sorted(scene.clamps)),
        pushes=tuple(_push(scene, layout, name) for name in sorted(scene.loads)),
        gravity=scene.gravity,
        wall_stiffness=_per_bar(sheets, layout, _joint_stiffness),
        wall_damping=_per_bar(sheets, layout, lambda s: s.structural_damping * _joint_stiffness(s)),
        layout=layout,
        pairs=pairs,
        n_circle_guides=len(circle_guides),
        circle_names=tuple(name for name, _ in circle_owners),
        sticks=(_sticks(scene, circle_owners), _sticks(scene, lines + arcs)),
        skin=scene.skin,
    )


def _named(parts: dict[str, Any], kind: type) -> list[tuple[str, Any]]:
    return [(name, parts[name]) for name in sorted(parts) if isinstance(parts[name], kind)]


def _columns(values: Sequence[Any]) -> tuple[Array, Array]:
    """x and y, (n,) each, of points."""
    points = stacked(values, (2,))
    return points[:, 0], points[:, 1]


# --- sheets -----------------------------------------------------------------------------------------------------------


def _joint_stiffness(sheet: Sheet) -> Array:
    """k = E t^3 w/(12 Ls) (source paper, eq. 4, with the width explicit), kg mm2/s2."""
    return NEWTON * sheet.youngs_modulus * sheet.thickness**3 * sheet.width * sheet.bars / (12.0 * sheet.length)


def _per_bar(sheets: list[Sheet], layout: Layout, value: Callable[[Sheet], Array]) -> Array:
    return jnp.concatenate([jnp.broadcast_to(value(s), (n,)) for s, n in zip(sheets, layout.bars, strict=True)])


def _bars(sheets: list[Sheet], layout: Layout) -> Bars:
    """Mass and inertia of a bar: m = rho Ls t w, I = m (t^2 + Ls^2)/12 (source paper, eqs. 1 and 2)."""

    def mass(s: Sheet) -> Array:
        return s.density * s.length * s.thickness * s.width / s.bars

    def inertia(s: Sheet) -> Array:
        return mass(s) * (s.thickness**2 + (s.length / s.bars) ** 2) / 12.0

    def row(value: Callable[[Sheet], Array]) -> Array:
        return _per_bar(sheets, layout, value)

    joint = jnp.asarray(~layout.last, jnp.result_type(float))
    return Bars(
        mass=row(mass),
        inertia=row(inertia),
        half_length=row(lambda s: 0.5 * s.length / s.bars),
        half_thickness=row(lambda s: 0.5 * s.thickness),
        friction_factor=row(lambda s: s.friction_factor),
        joint_stiffness=joint * row(_joint_stiffness),
        joint_damping=joint * row(lambda s: s.structural_damping * _joint_stiffness(s)),
        # Curvature turns left along the travel, and a bar leads the next one: theta_i - theta_(i+1) = curl Ls.
        rest_angle=joint * row(lambda s: s.curl * s.length / s.bars),
    )


# --- rollers ----------------------------------------------------------------------------------------------------------


def is_driven(roller: FixedRoller | MovableRoller) -> bool:
    return roller.angular_speed is not None or roller.surface_speed is not None


def _rollers(scene: Scene) -> tuple[Rollers, list[tuple[str, Any]]]:
    movable, fixed = _named(scene.rollers, MovableRoller), _named(scene.rollers, FixedRoller)
    groups = [
        [p for p in movable if is_driven(p[1])],
        [p for p in movable if not is_driven(p[1])],
        [p for p in fixed if not is_driven(p[1])],
        [p for p in fixed if is_driven(p[1])],
    ]
    parts = [p for group in groups for p in group]
    moving = [p[1] for p in groups[0] + groups[1]]
    free = [p[1] for p in groups[1] + groups[2]]
    (x, y), ways = _columns([r.center for _, r in parts]), _columns([r.direction for r in moving])
    long = jnp.sqrt(ways[0] ** 2 + ways[1] ** 2)
    radius = stacked([r.radius for _, r in parts])
    low = [-jnp.inf if r.travel_min is None else r.travel_min for r in moving]
    high = [jnp.inf if r.travel_max is None else r.travel_max for r in moving]
    rollers = Rollers(
        x=x,
        y=y,
        radius=radius,
        dir_x=ways[0] / long,
        dir_y=ways[1] / long,
        mass=stacked([r.mass for r in moving]),
        spring=NEWTON * stacked([r.spring for r in moving]),
        preload=NEWTON * stacked([r.preload for r in moving]),
        damper=NEWTON * stacked([r.damper for r in moving]),
        stop_low=stacked(low),
        stop_high=stacked(high),
        stop_stiffness=NEWTON * stacked([r.stop_stiffness for r in moving]),
        inertia=stacked([r.inertia for r in free]),
        drag=NEWTON * stacked([r.bearing_drag for r in free]),
        travel=stacked([r.travel for r in moving]),
        spin=stacked([r.spin for r in free]),
        drives=(
            _drives([r for _, r in groups[0]], radius[: len(groups[0])]),
            _drives([r for _, r in groups[3]], radius[len(parts) - len(groups[3]) :]),
        ),
        names=tuple(name for name, _ in parts),
        counts=(len(groups[0]), len(groups[1]), len(groups[2]), len(groups[3])),
    )
    return rollers, parts


def _drives(rollers: list[Any], radius: Array) -> Drives:
    """Spins of driven rollers; a surface speed is divided by the radius. Shorter profiles repeat their last point."""
    given = [r.angular_speed if r.angular_speed is not None else r.surface_speed for r in rollers]
    of_surface = np.array([r.angular_speed is None for r in rollers], dtype=bool)
    if not any(isinstance(g, Profile) for g in given):
        times, values = np.zeros((len(rollers), 1)), stacked(given)[:, None]
    else:
        both = [(g.times, g.values) if isinstance(g, Profile) else (jnp.zeros((1,)), stacked([g])) for g in given]
        points = max(t.shape[0] for t, _ in both)
        times, values = (jnp.stack([_pad(p[k], points) for p in both]) for k in (0, 1))
    return Drives(
        times=jnp.asarray(times, values.dtype),
        values=jnp.where(of_surface[:, None], values / radius[:, None], values),
    )


def _pad(values: Array, points: int) -> Array:
    return jnp.concatenate([values, jnp.broadcast_to(values[-1], (points - values.shape[0],))])


# --- guides -----------------------------------------------------------------------------------------------------------


def _lines_and_arcs(lines: list[tuple[str, LineGuide]], arcs: list[tuple[str, ArcGuide]]) -> tuple[Lines, Arcs]:
    (sx, sy), (ex, ey) = _columns([g.start for _, g in lines]), _columns([g.end for _, g in lines])
    length = jnp.sqrt((ex - sx) ** 2 + (ey - sy) ** 2)
    tx, ty = (ex - sx) / length, (ey - sy) / length
    cx, cy = _columns([g.center for _, g in arcs])
    radius = stacked([g.radius for _, g in arcs])
    start, sweep = (jnp.deg2rad(stacked([getattr(g, f) for _, g in arcs])) for f in ("start_angle", "sweep"))
    side = stacked([1.0 if g.side == "inside" else -1.0 for _, g in arcs])
    # The ends of an arc in the order of increasing angle, so that a clockwise sweep is the same arc.
    low, high = start + jnp.minimum(sweep, 0.0), start + jnp.maximum(sweep, 0.0)
    ends = [(sx, sy), (ex, ey)] + [(cx + radius * jnp.cos(a), cy + radius * jnp.sin(a)) for a in (low, high)]
    # A full turn has no ends: nothing is fitted to them, and nothing fades there.
    closed = high - low > 2.0 * jnp.pi - JOIN_TOLERANCE / radius
    motions = [g.motion for _, g in lines] * 2 + [g.motion for _, g in arcs] * 2
    is_end = jnp.concatenate([jnp.ones((2 * len(lines),), bool), ~closed, ~closed])
    joined = _joined(ends, _move_alike(motions) & is_end[:, None] & is_end[None, :])
    line_tip, arc_tip = (stacked([g.tip_radius for _, g in guides]) for guides in (lines, arcs))
    normals = [(-ty, tx)] * 2 + [(-side * jnp.cos(a), -side * jnp.sin(a)) for a in (low, high)]

    def face(guides: list[Any], tip: Array, k: int) -> Face:
        depth = stacked([g.depth for _, g in guides])
        # A tip circle is set back behind the face by its radius, so that it is tangent to the face at the end.
        tips = [(ends[j][0] - tip * normals[j][0], ends[j][1] - tip * normals[j][1]) for j in (k, k + 1)]
        return Face(depth, tip, (tips[0][0], tips[1][0]), (tips[0][1], tips[1][1]), (joined[k], joined[k + 1]))

    mid = 0.5 * (low + high)
    quarter = 0.25 * (high - low)
    cos_quarter, sin_quarter = jnp.where(closed, 0.0, jnp.cos(quarter)), jnp.where(closed, 1.0, jnp.sin(quarter))
    line_set = Lines(
        x=sx, y=sy, tx=tx, ty=ty, length=length, faces=face(lines, line_tip, 0), names=tuple(n for n, _ in lines)
    )
    arc_set = Arcs(
        x=cx, y=cy, radius=radius, mid_x=jnp.cos(mid), mid_y=jnp.sin(mid), cos_quarter=cos_quarter,
        sin_quarter=sin_quarter, side=side, faces=face(arcs, arc_tip, 2), names=tuple(n for n, _ in arcs),
    )  # fmt: skip
    return line_set, arc_set


def _joined(ends: list[tuple[Array, Array]], may: Array) -> list[Array]:
    """1 for each end that coincides with another one to which it `may` be joined. A yes or no: no gradient."""
    counts = [x.shape[0] for x, _ in ends]
    x, y = jnp.concatenate([e[0] for e in ends]), jnp.concatenate([e[1] for e in ends])
    n = sum(counts)
    near = (x[:, None] - x[None, :]) ** 2 + (y[:, None] - y[None, :]) ** 2 < JOIN_TOLERANCE**2
    flags = jnp.any(near & may & ~np.eye(n, dtype=bool), axis=1).astype(x.dtype)
    return jnp.split(flags, np.cumsum(counts)[:-1].tolist())


def _move_alike(motions: list[Motion | None]) -> Array:
    """(ends, ends) bool: whether two guides stay together, at rest or by the same movement. A diverter that only starts flush
    with its neighbour leaves an end open."""
    still = np.array([m is None for m in motions], dtype=bool)
    alike = jnp.asarray(still[:, None] & still[None, :])
    moving = [(k, _path(m)) for k, m in enumerate(motions) if m is not None]
    for i, a in moving:
        for j, b in moving:
            alike = alike.at[i, j].set(_same(a, b))
    return alike


def _same(a: Path, b: Path) -> Array:
    """Whether two movements are one, number for number."""
    if a.times.shape != b.times.shape:
        return jnp.zeros((), bool)
    return jnp.all(jnp.stack([jnp.all(getattr(a, f) == getattr(b, f)) for f in Path.__dataclass_fields__]))


def _circles(
    roller_set: Rollers,
    rollers: list[tuple[str, Any]],
    guides: list[tuple[str, CircleGuide]],
    lines: tuple[list[tuple[str, Any]], Lines],
    arcs: tuple[list[tuple[str, Any]], Arcs],
) -> tuple[Circles, list[tuple[str, Any]]]:
    tips = [
        (family, parts, faces.faces, end)
        for family, (parts, faces) in (("lines", lines), ("arcs", arcs))
        for end in (0, 1)
        if parts
    ]
    of_arcs = arcs[1].cos_quarter
    has_ends = {"lines": jnp.ones(()), "arcs": (of_arcs > 0).astype(of_arcs.dtype)}
    zeros = jnp.zeros((len(rollers),))
    owners = rollers + guides + [p for _, parts, _, _ in tips for p in parts]
    x, y = _columns([g.center for _, g in guides])
    circles = Circles(
        x=jnp.concatenate([zeros, x, *[f.tip_x[e] for _, _, f, e in tips]]),
        y=jnp.concatenate([zeros, y, *[f.tip_y[e] for _, _, f, e in tips]]),
        radius=jnp.concatenate(
            [roller_set.radius, stacked([p.radius for _, p in guides]), *[f.tip_radius for _, _, f, _ in tips]]
        ),
        active=jnp.concatenate(
            [jnp.ones((len(rollers) + len(guides),)), *[(1.0 - f.joined[e]) * has_ends[k] for k, _, f, e in tips]]
        ),
        tip_of=tuple((family, k, end) for family, parts, _, end in tips for k in range(len(parts))),
    )
    return circles, owners


# --- contact properties -----------------------------------------------------------------------------------------------


def _surface(scene: Scene, parts: list[tuple[str, Any]]) -> Surface:
    once = {id(part): part for _, part in parts}  # a guide owns its tips too
    place = {key: k for k, key in enumerate(once)}
    friction = stacked([part.friction for part in once.values()])[np.array([place[id(p)] for _, p in parts], dtype=int)]
    return _surface_of(scene, [p.contact for _, p in parts], friction, tuple(name for name, _ in parts))


def _pair_surface(scene: Scene, rollers: list[tuple[str, Any]], pairs: tuple[tuple[int, int], ...]) -> Surface:
    """Two rollers use the smaller of their frictions and the contact set of the first movable one.

    They never stick: each turns freely or drives the other, and what they carry tangentially is a bearing's drag.
    """
    each, index = stacked([r.friction for _, r in rollers]), np.array(pairs, dtype=int).reshape(-1, 2)
    friction = jnp.minimum(each[index[:, 0]], each[index[:, 1]])
    names = tuple(f"{rollers[i][0]}+{rollers[j][0]}" for i, j in pairs)
    return _surface_of(scene, [rollers[i][1].contact for i, _ in pairs], friction, names, can_stick=False)


def _sticks(scene: Scene, parts: list[tuple[str, Any]]) -> bool:
    return any(scene.contacts[p.contact].friction_law == "stick" for _, p in parts)


def _surface_of(
    scene: Scene, sets: list[str], friction: Array, names: tuple[str, ...], can_stick: bool = True
) -> Surface:
    known = sorted(scene.contacts)
    index = np.array([known.index(s) for s in sets], dtype=int)
    contacts = [scene.contacts[name] for name in known]

    def per_body(values: list[Any]) -> Array:
        return stacked(values)[index]

    used = [contacts[k] for k in sorted(set(index.tolist()))]
    excess = None
    if any(c.static_ratio is not None for c in used):
        excess = per_body([0.0 if c.static_ratio is None else c.static_ratio - 1.0 for c in contacts])
    tanh, stick = (np.array([contacts[k].friction_law == law for k in index], dtype=bool) for law in ("tanh", "stick"))
    sticks = can_stick and bool(stick.any())
    slick = np.array([contacts[k].friction_law == "none" for k in index], dtype=bool)
    damped = np.array([c.damped for c in contacts])
    damping = NEWTON * per_body([c.damping for c in contacts])
    return Surface(
        friction=None if len(index) and slick.all() else jnp.where(slick, 0.0, friction) if slick.any() else friction,
        stiffness=NEWTON * per_body([c.stiffness for c in contacts]),
        exponent=per_body([c.exponent for c in contacts]),
        damping=damping if damped.all() else jnp.where(damped[index], damping, 0.0) if damped[index].any() else None,
        damping_exponent=per_body([c.damping_exponent for c in contacts]),
        smoothing=per_body([c.smoothing for c in contacts]),
        stick_speed=per_body([c.stick_speed for c in contacts]),
        static_excess=excess,
        transition_speed=per_body([c.transition_speed for c in contacts]),
        tanh=jnp.asarray(tanh) if tanh.any() else None,
        stick=jnp.asarray(stick) if sticks else None,
        stick_displacement=per_body([c.stick_displacement for c in contacts]) if sticks else None,
        names=names,
    )


# --- movements, clamps, loads -----------------------------------------------------------------------------------------


def _path(motion: Motion) -> Path:
    return Path(
        times=motion.times,
        x=motion.displacement[:, 0],
        y=motion.displacement[:, 1],
        angle=jnp.deg2rad(motion.rotation),
        pivot_x=motion.pivot[0],
        pivot_y=motion.pivot[1],
    )


def _paths(
    rollers: list[Any], circles: list[Any], lines: list[Any], arcs: list[Any], n_rollers: int
) -> dict[str, Path]:
    """Movements by "family.index"; a circle's index counts rollers first."""
    families = {"circles": rollers + circles, "lines": lines, "arcs": arcs}
    return {
        f"{family}.{k}": _path(p.motion)
        for family, parts in families.items()
        for k, (_, p) in enumerate(parts)
        if getattr(p, "motion", None) is not None
    }


def _hold(scene: Scene, layout: Layout, clamp: Clamp) -> Hold:
    whole = clamp.kind == "bar"
    bar, end = layout.bar(clamp.sheet, clamp.at, whole)
    sheet = scene.sheets[clamp.sheet]
    local = bar - layout.starts[layout.names.index(clamp.sheet)]
    headings = initial_headings(sheet)
    nodes = initial_nodes(sheet, headings)
    at = 0.5 * (nodes[local] + nodes[local + 1]) if whole else nodes[local + (0 if end > 0 else 1)]
    rows = tuple(d for d in ("x", "y") if clamp.free != d) + (("heading",) if whole else ())
    return Hold(
        x=at[0] + clamp.displacement[0],
        y=at[1] + clamp.displacement[1],
        angle=headings[local] + jnp.deg2rad(clamp.rotation),
        path=None if clamp.motion is None else _path(clamp.motion),
        bar=bar,
        end=end,
        rows=rows,
        wall=clamp.kind == "wall",
    )


def _push(scene: Scene, layout: Layout, name: str) -> Push:
    load = scene.loads[name]
    bar, end = layout.bar(load.sheet, load.at)
    force, moment = NEWTON * load.force, NEWTON * load.moment
    return Push(x=force[0], y=force[1], moment=moment, bar=bar, end=end)


def initial_headings(sheet: Sheet) -> Array:
    """(bars,) rad."""
    given = sheet.heading if sheet.headings is None else sheet.headings
    return jnp.deg2rad(jnp.broadcast_to(given, (sheet.bars,)))


def initial_nodes(sheet: Sheet, headings: Array) -> Array:
    """(bars + 1, 2) mm, node 0 the leading edge."""
    along = jnp.stack([jnp.cos(headings), jnp.sin(headings)], axis=1) * (sheet.length / sheet.bars)
    return sheet.lead[None, :] - jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(along, axis=0)])
