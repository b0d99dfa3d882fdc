"""Which pairs can touch soon: the nearest bodies of every feature, searched once per block of steps.

Contact forces have compact support, so leaving out pairs that are further apart than they can close is exact. The search
is a full sweep of gaps; it keeps a fixed number of bodies per feature (`slots`). Two things would make it wrong, and both
are told as data: more bodies within reach than slots, and a sheet that moved further than the reach (`check_reach`).
Where the steps are not given, the first can be helped: the next search is made earlier (`for_as_long_as_they_last`).
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.once import computed_once
from diffeed.chain.kinematics import Pose, node_velocities, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import Bodies, bodies, spins
from diffeed.contact.features import features
from diffeed.contact.kept import Kept, keep, keep_all
from diffeed.contact.near import Closest, circles_near, guides_near
from diffeed.contact.roller_pairs import roller_gaps
from diffeed.model.arrays import Model, Path

MOST_SLOTS = 12
REACH = 0.5
"""mm that everything may move beyond what its present speed explains."""
MARGIN = 2.0
"""Times the distance that the present speed covers until the next search."""


SIZE = 100.0
"""mm from its pivot to the far end of a swinging guide; larger ones are caught by the margin."""


RANKED = 40
"""Bodies up to which every one is compared with every other: sorting them is dearer (measured, one CPU core)."""


PAIRS = 4
"""Partners kept for each movable roller: a pinch has its drive, and room for what else may come near."""


class Slots(NamedTuple):
    """Bodies kept per feature and family, and partners of each movable roller; None: few enough to be kept whole."""

    circles: int | None
    lines: int | None
    arcs: int | None
    pairs: int | None = None

    @property
    def any(self) -> bool:
        return any(n is not None for n in self)


def slots(model: Model) -> Slots:
    """Static choice from counts: more bodies per bar need more slots."""

    def choose(count: int) -> int | None:
        wanted = min(MOST_SLOTS, 4 + -(-2 * count // model.layout.n_bars))
        return wanted if count > wanted else None

    return Slots(
        circles=choose(len(model.circle_names)),
        lines=choose(len(model.lines.names)),
        arcs=choose(len(model.arcs.names)),
        pairs=PAIRS if len(model.pairs) > 2 * PAIRS * model.rollers.n_movable else None,
    )


AT_LEAST, PER_BAR = 32, 2
"""Bodies of a family that a search looks at closely: so many, and so many for each bar. Families of up to twice that are
looked at whole."""


class Candidates(NamedTuple):
    """Kept bodies, the reach that they were chosen for, and the reach within which no other body is."""

    kept: Kept
    reach: Array  # mm
    free: Array  # mm
    x: Array  # node positions at the search
    y: Array
    travel: Array
    pace: Array  # mm/s: no surface of a roller or guide moves faster
    run_up: Array  # mm by which two movable rollers may come nearer beyond `reach`

    @property
    def complete(self) -> Array:
        """Bool: all bodies within reach found a slot."""
        return self.reach <= self.free


def search(model: Model, state: State, span: Array) -> Candidates:
    """Candidates for the next `span` seconds. What is kept has derivatives, how it was chosen has none."""
    index, measured = _choose(lax.stop_gradient(model), lax.stop_gradient(state), span)
    return Candidates(keep_all(model) if index is None else keep(model, *index), *measured)


def _choose(model: Model, state: State, span: Array) -> tuple[list[Array | None] | None, tuple[Array, ...]]:
    """Indices of what to keep (None: everything), and all else that `Candidates` hold."""
    at = pose(model, state)
    x, y = nodes(model, at)
    size, pace = slots(model), _fastest_surface(model, state, span)
    if not model.has_bodies or not size.any:
        always = jnp.full((), jnp.inf)
        return None, (always, always, x, y, state.travel, pace, always)
    world, rows = bodies(model, state, state.time, state.time), features(model, at)
    close = _close_by(model, world, x, y)
    looked_at = keep(model, *[c if c is None else c.which[:, None] for c in close])
    reach = REACH + MARGIN * span * (_fastest_node(model, at) + pace)
    found, free = [], []
    families = (
        lambda: circles_near(model, rows, world, looked_at),
        lambda: guides_near(model, rows, world, looked_at._replace(arcs=None)),
        lambda: guides_near(model, rows, world, looked_at._replace(lines=None)),
    )
    depths = (None, model.lines.faces.depth, model.arcs.faces.depth)
    for near, depth, count, of in zip(families, depths, size[:3], close, strict=True):
        index, next_gap = None, jnp.inf
        if count is not None:
            index, next_gap = _nearest(near(), depth, count, model, of)
        found.append(index)
        free.append(next_gap)
    run_up = jnp.full((), jnp.inf, reach.dtype)
    if size.pairs is not None:
        run_up = _run_up(model, state, span)
        partner, which = model.pairs_by_roller
        mine = np.broadcast_to(np.arange(len(partner))[:, None], partner.shape)
        gap = jnp.where(which < 0, jnp.inf, roller_gaps(model, world, (mine, partner))[3])
        closest, index = lax.top_k(-gap, size.pairs + 1)
        found.append(index[:, :-1])
        next_gap = -jnp.max(closest[:, -1])
        free.append(next_gap * reach / (reach + run_up))  # the two shrink together where a search is made earlier
    limit = functools.reduce(jnp.minimum, free)
    limit = jnp.asarray(limit, reach.dtype)
    return found, (reach, limit, x, y, state.travel, pace, run_up)


def for_as_long_as_they_last(found: Candidates, span: Array) -> tuple[Candidates, Array]:
    """Candidates for the part of `span` in which no further body can come near, and that time (s)."""
    reach = jnp.minimum(found.reach, found.free)
    share = jnp.where(jnp.isfinite(found.reach), reach / found.reach, 1.0)
    share = jnp.maximum(share, 0.0)
    run_up = jnp.where(jnp.isfinite(found.run_up), share * found.run_up, found.run_up)
    return found._replace(reach=reach, run_up=run_up), span * share


class Close(NamedTuple):
    """Which bodies of a family are close to a sheet, and a bound below the gaps of all others (mm)."""

    which: Array
    free: Array


def _close_by(model: Model, world: Bodies, x: Array, y: Array) -> tuple[Close | None, ...]:
    """By the circles about bodies, and the nodes: for circles, lines and arcs. None: the whole family.

    No point of a sheet is further from a node than half a bar, and no point of a curve through the bars than a whole one.
    """
    lines, arcs, r = world.lines, world.arcs, model.circles.radius
    thick = 2.0 * jnp.max(model.bars.half_length) + jnp.max(model.bars.half_thickness)
    half = 0.5 * lines.length
    circle = jnp.where(model.circles.active > 0, r, -jnp.inf)
    families = (
        (world.circles.x, world.circles.y, circle),
        (lines.x + half * lines.tx, lines.y + half * lines.ty, half + model.lines.faces.depth),
        (arcs.x, arcs.y, arcs.radius + model.arcs.faces.depth),
    )
    count = AT_LEAST + PER_BAR * model.layout.n_bars
    return tuple(_closest(*f, x, y, thick, count) if f[0].shape[0] > 2 * count else None for f in families)


def _closest(cx: Array, cy: Array, radius: Array, x: Array, y: Array, thick: Array, count: int) -> Close:
    squared = jnp.min((cx[:, None] - x[None]) ** 2 + (cy[:, None] - y[None]) ** 2, axis=1)
    closest, index = lax.top_k(-(jnp.sqrt(squared) - radius - thick), count + 1)
    return Close(index[:-1], -closest[-1])


def _nearest(near: Closest, depth: Array | None, count: int, model: Model, of: Close | None) -> tuple[Array, Array]:
    """(slots, features) indices of the nearest bodies, and the smallest gap of all others."""
    gap, every = near.gap, slice(None) if of is None else of.which
    if depth is None:
        gap = jnp.where(model.circles.active[every, None] > 0, gap, jnp.inf)
    else:
        # Behind a thin guide a sheet is felt again as soon as it is within `depth` of the face.
        gap = gap - jnp.where(near.weight > 0, 0.0, depth[every, None])
    index, free = _smallest(gap, count)
    return (index, free) if of is None else (of.which[index], jnp.minimum(free, of.free))


def _smallest(gap: Array, count: int) -> tuple[Array, Array]:
    """(count, features) rows of the smallest gaps of each feature, and the smallest gap of all others. Equals in their order."""
    n = gap.shape[0]
    if n > RANKED:
        closest, index = lax.top_k(-gap.T, count + 1)
        return index[:, :count].T, -jnp.max(closest[:, count])
    gap = computed_once(gap)
    rows, earlier = np.arange(n, dtype=np.int32)[None, :, None], np.tri(n, k=-1, dtype=bool)[:, :, None]
    is_ahead = (gap[None] < gap[:, None]) | ((gap[None] == gap[:, None]) & earlier)
    rank = jnp.sum(is_ahead, axis=1, dtype=np.int32)
    index = jnp.sum(jnp.where(rank[None] == rows[0, :count, None], rows, 0), axis=1, dtype=np.int32)
    return index, jnp.min(jnp.where(rank >= count, gap, jnp.inf))


def _fastest_node(model: Model, at: Pose) -> Array:
    vx, vy = node_velocities(model, at)
    return jnp.max(jnp.abs(vx) + jnp.abs(vy))


def _fastest_surface(model: Model, state: State, span: Array) -> Array:
    """A bound on the speed of any surface: of pinches on their way, of shafts (now or after `span`: they can set a sheet
    going) and of guides on their paths, mm/s."""
    speeds = [jnp.max(jnp.abs(state.travel_rate), initial=0.0)]
    surface = [jnp.abs(spins(model, state, time) * model.rollers.radius) for time in (state.time, state.time + span)]
    speeds.append(jnp.max(jnp.maximum(*surface), initial=0.0))
    for path in model.paths.values():
        speeds.append(_path_speed(path))
    return sum(speeds[1:], speeds[0])


def _run_up(model: Model, state: State, span: Array) -> Array:
    """mm: what two movable rollers close while their springs set them going, with the margin."""
    r = model.rollers
    push = (jnp.abs(r.preload) + r.spring * jnp.abs(state.travel)) / r.mass
    return MARGIN * span**2 * jnp.max(push, initial=0.0)


def _path_speed(path: Path) -> Array:
    """A bound on the speed of a moving guide: shift, and turn about its pivot at up to `SIZE` mm."""
    span = jnp.diff(path.times)
    rate = [
        jnp.max(jnp.abs(jnp.diff(v)) / jnp.where(span > 0, span, jnp.inf), initial=0.0)
        for v in (path.x, path.y, path.angle)
    ]
    return rate[0] + rate[1] + SIZE * rate[2]


def check_reach(model: Model, found: Candidates, after: State) -> Array:
    """Whether the candidates were good until `after`: nothing moved further than the search reached."""
    x, y = nodes(model, pose(model, after))
    travel = jnp.max(jnp.abs(after.travel - found.travel), initial=0.0)
    moved = jnp.max(jnp.abs(x - found.x) + jnp.abs(y - found.y)) + travel
    return found.complete & ~(moved > found.reach) & ~(2.0 * travel > found.reach + found.run_up)
