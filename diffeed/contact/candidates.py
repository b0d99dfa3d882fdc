"""Which pairs can touch soon: the most urgent ones, searched once per block of steps and listed.

Contact forces have compact support, so leaving out pairs that do not touch is exact. The search is a full sweep of gaps and
of the speeds at which they close; it lists a fixed number of pairs of each family (`capacities`), those first whose gap is
soonest used up. When the block is done every pair that was left out is looked at again (`check_reach`): bodies are convex (an
arc that is nearly so), so a gap shrinks at most by what the sheet has come nearer along the normal that it had. Had one been used
up, that is told as data. Where the steps are not given, the next search is made before (`for_as_long_as_they_last`).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.batching import for_each, least_of_group
from diffeed.base.places import PLACE, add_at, at_places
from diffeed.base.smallest import smallest
from diffeed.chain.kinematics import Pose, node_velocities, nodes, pose
from diffeed.chain.state import State
from diffeed.contact.bodies import Bodies, bodies, spins
from diffeed.contact.features import features
from diffeed.contact.kept import Kept, keep, keep_all
from diffeed.contact.near import Closest, circles_near, guides_near
from diffeed.contact.roller_pairs import roller_gaps
from diffeed.contact.watched import Watched, approach, speeds, used_up, watch, ways
from diffeed.model.arrays import Model

REACH = 0.5
"""mm by which any gap may shrink beyond what its present speed explains."""
MARGIN = 2.0
"""Times the distance by which a gap closes at its present speed until the next search."""
TURNING = 0.25
"""Of the way that the fastest part makes until then: what may turn towards a body that it now passes."""


SIZE = 100.0
"""mm from its pivot to the far end of a swinging guide; larger ones are caught by the margin."""


MANY_CIRCLES = 32
"""Circles that a few long bars may touch, each with one of them."""
SMALL = 24
"""Pairs of a family that are listed even where one wall needs fewer: sheets of few bars may meet both walls."""
WORTH = 0.75
"""Of all pairs: a longer list would hardly be worth the gathering (estimated)."""
FAMILIES = ("circles", "guides")


PAIRS = 4
"""Partners kept for each movable roller: a pinch has its drive, and room for what else may come near."""


class Capacities(NamedTuple):
    """Pairs listed with circles and guides, and partners of each movable roller; None: few enough to be kept whole."""

    circles: int | None = None
    guides: int | None = None
    partners: int | None = None

    @property
    def listed(self) -> bool:
        return self.circles is not None

    @property
    def any(self) -> bool:
        return self.listed or self.partners is not None


def capacities(model: Model, brief: bool = False) -> Capacities:
    """Static choice from counts: whether pairs are listed, and how many; `brief`: no more than most scenes need, unless the scene
    says that it is crowded."""
    f, (circles, guides) = model.layout.tail.shape[0], (len(v) for v in (model.circle_names, model.guides.names))
    whole, most = (f * circles, f * guides), _both_walls(f, circles, guides)
    if brief and not model.crowded:
        most = tuple(min(pair) for pair in zip(most, _one_wall(f, circles, guides), strict=True))
    few = [min(pair) for pair in zip(whole, most, strict=True)]
    partners = PAIRS if len(model.pairs) > 2 * PAIRS * model.rollers.n_movable else None
    return Capacities._make([*few, partners]) if sum(few) < WORTH * sum(whole) else Capacities(partners=partners)


def _one_wall(features: int, circles: int, guides: int) -> tuple[int, int]:
    """Room for one circle and one guide for each feature, and for what nips and guides that go on in each other have beyond."""
    on_circles = max(features + min(circles, features) // 4, min(circles, MANY_CIRCLES))
    on_guides = features + max(features // 4, min(guides, 2 * features))
    return max(on_circles, SMALL), max(on_guides, SMALL)


def _both_walls(features: int, circles: int, guides: int) -> tuple[int, int]:
    """Room for both walls of a channel for each feature."""
    on_circles = features + min(circles, max(2 * features, MANY_CIRCLES))
    return on_circles, 2 * features + min(guides, 2 * features)


AT_LEAST, PER_BAR = 32, 2
"""Bodies of a family that a search looks at closely: so many, and so many for each bar. Families of up to twice that are
looked at whole."""


class Candidates(NamedTuple):
    """Kept pairs, and what tells whether they were enough."""

    kept: Kept
    lasts: Array  # of the time that was asked for: how long no other pair can come to touch; 1 or more: all of it
    watched: dict[str, Watched]  # by family
    free: Array  # mm: no body that was not looked at is nearer
    apart: Array  # mm: no roller that was left out is nearer to a movable one
    at: Pose  # at the search
    world: Bodies
    travel: Array
    pace: Array  # mm/s: no surface of a roller or guide moves faster
    moved: Array  # mm that guides may move until the next search

    @property
    def complete(self) -> Array:
        """Bool: all pairs that can come to touch were listed."""
        return self.lasts >= 1.0


def search(model: Model, state: State, span: Array, brief: bool = False) -> Candidates:
    """Candidates for the next `span` seconds, in lists as long as `capacities` says. What is kept has derivatives, how it was
    chosen has none."""
    index, measured = _choose(lax.stop_gradient(model), lax.stop_gradient(state), span, capacities(model, brief))
    return Candidates(keep_all(model) if index is None else keep(model, **index), *measured)


def touching_now(model: Model, state: State) -> tuple[Kept, Array]:
    """The pairs that touch at a state, and few others; and whether all that touch are listed (bool). Derivatives as `search`."""
    size = capacities(model)
    if not model.has_bodies or not size.listed:
        return keep_all(model), jnp.ones((), bool)
    alike, there = lax.stop_gradient(model), lax.stop_gradient(state)
    at, world = pose(alike, there), bodies(alike, there, there.time, there.time)
    found: dict[str, tuple[Array, Array]] = {}
    first = jnp.full((), jnp.inf, there.x.dtype)  # the smallest gap that is left out
    for family, one in _families(alike, at, world, size).items():
        bears = one.near.weight > 0  # else it does not touch, behind the face or not
        chosen, others = _first_few(jnp.where(bears, one.near.gap, jnp.inf).ravel(), one.most)
        found[family] = one.pairs(chosen)
        first = jnp.minimum(jnp.minimum(first, one.free), jnp.min(others))
    return keep(model, **_index(found)), first > 0.0


def _choose(
    model: Model, state: State, span: Array, size: Capacities
) -> tuple[dict[str, Array | None] | None, tuple[Any, ...]]:
    """Indices of what to keep (None: everything), and all else that `Candidates` hold."""
    at, world = pose(model, state), bodies(model, state, state.time, state.time)
    pace, moved = _fastest_surface(model, state, span), span * _fastest_guide(model)
    never = jnp.full((), jnp.inf, state.x.dtype)
    if not model.has_bodies or not size.any:
        return None, (never, {}, never, never, at, world, state.travel, pace, moved)
    index: dict[str, Array | None] = dict.fromkeys(FAMILIES)
    lasts, watched, free, apart = never, {}, never, never
    if size.listed:
        index, lasts, watched, free = _list(model, at, world, span, pace, size)
    if size.partners is not None:
        index["partners"], apart = _partners(model, world, size.partners)
        reach = REACH + MARGIN * span * (_fastest_node(model, at) + pace)
        lasts = jnp.minimum(lasts, apart / (reach + _run_up(model, state, span)))
    return index, (lasts, watched, free, apart, at, world, state.travel, pace, moved)


class Family(NamedTuple):
    """Bodies of a family that are looked at, against every feature, and how many pairs of them may be listed."""

    near: Closest
    looked_at: Kept
    most: int
    which: Array | None  # of the family; None: all of it
    free: Array | float  # mm: no body that is not looked at is nearer

    def pairs(self, chosen: Array) -> tuple[Array, Array]:
        """Places in (bodies, features), one after the other -> which body of the family, and which feature."""
        features = PLACE(self.near.gap.shape[1])
        body, feature = chosen // features, chosen % features
        return body if self.which is None else at_places(self.which, body), feature


def _families(model: Model, at: Pose, world: Bodies, size: Capacities) -> dict[str, Family]:
    """Those of which pairs may be listed."""
    close = _close_by(model, world, *nodes(model, at))
    looked_at = keep(model, *[c if c is None else c.which[:, None] for c in close])
    rows = features(model, at)
    return {
        family: Family(closest(rows, world, looked_at), looked_at, count, *((None, np.inf) if of is None else of))
        for family, closest, count, of in zip(FAMILIES, (circles_near, guides_near), size[:2], close, strict=True)
        if count
    }


def _index(pairs: dict[str, tuple[Array, Array]]) -> dict[str, Array | None]:
    """Which body and which feature, of each family -> what `keep` asks for."""
    bodies_of: dict[str, Array | None] = dict.fromkeys(FAMILIES)
    bodies_of |= {family: body for family, (body, _) in pairs.items()}
    return bodies_of | {"feature": jnp.concatenate([feature for _, feature in pairs.values()])}


def _list(
    model: Model, at: Pose, world: Bodies, span: Array, pace: Array, size: Capacities
) -> tuple[dict[str, Array | None], Array, dict[str, Watched], Array]:
    """Indices of the pairs to list, how long they last, all others, and how near what was not even looked at may be."""
    velocity, motions, fastest = node_velocities(model, at), speeds(world), _fastest_node(model, at) + pace
    unasked = REACH + TURNING * span * fastest
    listed: dict[str, tuple[Array, Array]] = {}
    watched: dict[str, Watched] = {}
    lasts = free = jnp.full((), jnp.inf, velocity[0].dtype)
    for family, one in _families(model, at, world, size).items():
        seen = watch(model, at, world, one.near, one.looked_at, family)
        closing = jnp.maximum(approach(model, seen, velocity, motions[family]), 0.0)
        chosen, watched[family], last = _most_urgent(seen, unasked + MARGIN * span * closing, one.most)
        listed[family] = one.pairs(chosen)
        lasts, free = jnp.minimum(lasts, last), jnp.minimum(free, one.free)
    lasts = jnp.minimum(lasts, free / (REACH + MARGIN * span * fastest))
    return _index(listed), lasts, watched, free


def _most_urgent(seen: Watched, reach: Array, count: int) -> tuple[Array, Watched, Array]:
    """Places of the pairs whose gaps are soonest used up; all others, and how long they last."""
    chosen, others = _first_few((seen.gap / reach).ravel(), count)
    left = jnp.where(jnp.isposinf(others), jnp.inf, seen.gap.ravel()).reshape(seen.gap.shape)
    return chosen, seen._replace(gap=left), jnp.min(others)


def _first_few(values: Array, count: int) -> tuple[Array, Array]:
    """Places of the smallest values, (count,) or all, and the values with those at infinity. Samples abreast choose together."""
    if count >= values.shape[0]:
        return jnp.arange(values.shape[0], dtype=PLACE), jnp.full_like(values, jnp.inf)
    chosen = smallest(least_of_group(values), count)
    taken = add_at(values.shape[0], chosen, [jnp.ones((count,), values.dtype)])[0] > 0  # a scatter would be no loop
    return chosen, jnp.where(taken, jnp.inf, values)


def _partners(model: Model, world: Bodies, count: int) -> tuple[Array, Array]:
    """(movable, count) which partners of each movable roller are nearest, and the smallest gap of all others."""
    partner, which = model.pairs_by_roller
    mine = np.broadcast_to(np.arange(len(partner))[:, None], partner.shape)
    gap = jnp.where(which < 0, jnp.inf, roller_gaps(model, world, (mine, partner))[3])
    nearest, others = for_each(lambda of_one: _first_few(of_one, count))(gap)
    return nearest, jnp.min(others)


def for_as_long_as_they_last(found: Candidates, span: Array) -> tuple[Candidates, Array]:
    """Candidates for the part of `span` in which no further pair can come to touch, and that time (s)."""
    share = jnp.clip(found.lasts, 0.0, 1.0)
    return found._replace(lasts=found.lasts / share), span * share


class Close(NamedTuple):
    """Which bodies of a family are close to a sheet, and a bound below the gaps of all others (mm)."""

    which: Array
    free: Array


def _close_by(model: Model, world: Bodies, x: Array, y: Array) -> tuple[Close | None, ...]:
    """By the circles about bodies, and the nodes: for circles and guides. None: the whole family.

    No point of a sheet is further from a node than half a bar, and no point of a curve through the bars than a whole one.
    """
    guides, r = world.guides, model.circles.radius
    thick = 2.0 * jnp.max(model.bars.half_length) + jnp.max(model.bars.half_thickness)
    circle = jnp.where(model.circles.active > 0, r, -jnp.inf)
    families = (
        (world.circles.x, world.circles.y, circle),
        (guides.x, guides.y, guides.reach + guides.faces.depth),
    )
    count = AT_LEAST + PER_BAR * model.layout.n_bars
    return tuple(_closest(*f, x, y, thick, count) if f[0].shape[0] > 2 * count else None for f in families)


def _closest(cx: Array, cy: Array, radius: Array, x: Array, y: Array, thick: Array, count: int) -> Close:
    squared = jnp.min((cx[:, None] - x[None]) ** 2 + (cy[:, None] - y[None]) ** 2, axis=1)
    nearest, others = _first_few(jnp.sqrt(squared) - radius - thick, count)
    return Close(nearest, jnp.min(others))


def _fastest_node(model: Model, at: Pose) -> Array:
    vx, vy = node_velocities(model, at)
    return jnp.max(jnp.abs(vx) + jnp.abs(vy))


def _fastest_surface(model: Model, state: State, span: Array) -> Array:
    """A bound on the speed of any surface: of pinches on their way, of shafts (now or after `span`: they can set a sheet
    going) and of guides on their paths, mm/s."""
    speeds = [jnp.max(jnp.abs(state.travel_rate), initial=0.0)]
    surface = [jnp.abs(spins(model, state, time) * model.rollers.radius) for time in (state.time, state.time + span)]
    speeds.append(jnp.max(jnp.maximum(*surface), initial=0.0))
    return speeds[0] + speeds[1] + _fastest_guide(model)


def _fastest_guide(model: Model) -> Array:
    """A bound on the speed of guides and rollers on their paths, mm/s: shift, and turn about a pivot at up to `SIZE` mm."""
    path = model.movements.path
    span = jnp.diff(path.times)
    x, y, turn = (
        jnp.max(jnp.abs(jnp.diff(v)) / jnp.where(span > 0, span, jnp.inf), axis=1, initial=0.0)
        for v in (path.x, path.y, path.angle)
    )
    return jnp.max(x + y + SIZE * turn, initial=0.0)


def _run_up(model: Model, state: State, span: Array) -> Array:
    """mm: what two movable rollers close while their springs set them going, with the margin."""
    r = model.rollers
    push = (jnp.abs(r.preload) + r.spring * jnp.abs(state.travel)) / r.mass
    return MARGIN * span**2 * jnp.max(push, initial=0.0)


def check_reach(model: Model, found: Candidates, after: State, at: Pose, world: Bodies) -> Array:
    """Whether the candidates were good until `after`, with its pose and bodies: no pair that was left out has come to touch."""
    (x, y), (then_x, then_y) = nodes(model, at), nodes(model, found.at)
    way, travel = (x - then_x, y - then_y), jnp.max(jnp.abs(after.travel - found.travel), initial=0.0)
    furthest = jnp.max(jnp.abs(way[0]) + jnp.abs(way[1])) + travel + found.moved
    good = ~(furthest > found.free) & ~(2.0 * travel > found.apart)
    if not found.watched:
        return good
    motions = ways(found.world, world)
    for family, seen in found.watched.items():
        good &= ~jnp.any(used_up(model, seen, way, motions[family]))
    return good
