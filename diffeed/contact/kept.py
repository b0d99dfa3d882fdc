"""The pairs that are looked at: every feature against every body, or a list of those that may touch."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.places import PLACE, at_places, put_at, summed_at
from diffeed.base.products import product
from diffeed.contact.features import Listed, Own, listed, own
from diffeed.model.arrays import Guides, Model
from diffeed.pair.law import Surface

DEEPEST = 3.0
"""mm: a bar axis further inside a roller or circle guide than this (or than half its radius) went through it."""
SHALLOWEST = 0.25
"""mm that a bar axis may always lie in a circle, a tip of radius 0 too."""
DEEP_IN_GUIDES = 0.75
"""Of the depth of a guide, behind which it lets go: a bar axis further behind its face is on the way through."""


class Kept(NamedTuple):
    """The pairs that are looked at: every body, (bodies, 1), against every feature, or listed ones, (pairs,) each.

    A list holds pairs with circles, then with guides; an index says which body of the family is in each. An index of None keeps
    a family whole. Rollers are the first circles; `travel` and `spin` say how a circle moves.
    """

    pairs: Listed | None  # which feature is in each pair; None: every body meets every feature
    own: Own  # of the features, (1, features) or (pairs,)
    circle_index: Array | None
    guide_index: Array | None
    radius: Array
    active: Array
    travel_x: Array  # unit direction of a movable roller's travel, 0 for all other circles
    travel_y: Array
    spin_lever: Array  # radius of a freely turning roller, 0 for all other circles
    guides: Guides | None  # None: there are none
    surface: Surface
    allowed: Array  # mm that a bar axis may lie inside
    approach: Array  # mm that a sheet may come nearer in one step
    pair_index: tuple[Any, Any]  # rollers of the pairs that are looked at, (pairs,) or (movable, partners)
    pair_surface: Surface

    @property
    def n_circles(self) -> int:
        """How many rows or pairs hold circles; they come first."""
        return self.radius.shape[0]


def pick(values: Array, index: Array | None) -> Array:
    """(bodies,) -> (bodies, 1), or of the shape of the index."""
    return values[:, None] if index is None else at_places(values, index)


def picked(values: tuple[Array, ...], index: Array | None) -> tuple[Array, ...]:
    """`pick` for several at once: one gather instead of many."""
    return tuple(v[:, None] for v in values) if index is None else tuple(at_places(jnp.stack(values), index))


def kept_guides(guides: Guides, index: Array | None) -> Guides:
    """`pick` for every value of guides."""
    return jax.tree.map(lambda v: pick(v, index), guides)


def part(values: Any, pairs: Listed | None, which: slice) -> Any:
    """Of values of features, (1, features) or (pairs,), those of some of the pairs: of a list a part, else all."""
    return values if pairs is None else jax.tree.map(lambda v: v[which], values)


def in_rows(families: list[Any]) -> Any:
    """Families of bodies one after the other: (bodies, 1), (bodies, features) or (pairs,) each."""
    if len(families) == 1:
        return families[0]

    def joined(*parts: Array) -> Array:
        width = np.broadcast_shapes(*(v.shape[1:] for v in parts))
        return jnp.concatenate([jnp.broadcast_to(v, (v.shape[0], *width)) for v in parts])

    return jax.tree.map(joined, *families)


def keep_all(model: Model) -> Kept:
    """Every body against every feature."""
    return keep(model, None, None)


def allowed_in_circles(radius: Array) -> Array:
    """mm that a bar axis may lie inside circles."""
    return jnp.maximum(jnp.minimum(DEEPEST, 0.5 * radius), SHALLOWEST)


def allowed_depths(model: Model) -> Array:
    """(bodies,) mm that a bar axis may lie inside: deeper, the sheet is on its way to the other side."""
    return jnp.concatenate([allowed_in_circles(model.circles.radius), DEEP_IN_GUIDES * model.guides.faces.depth])


def allowed_approaches(model: Model) -> Array:
    """(bodies,) mm that a sheet may come nearer in one step: half of what takes it out of a body on the other side, so that
    it is seen inside. That is the depth of a guide, and the way to the centre and as far beyond as an axis may lie in a
    small circle; in a large one it is seen to be too deep before."""
    circles = jnp.minimum(0.5 * (model.circles.radius + allowed_in_circles(model.circles.radius)), 0.5 * DEEPEST)
    return jnp.concatenate([circles, 0.5 * allowed_depths(model)[model.circles.radius.shape[0] :]])


def keep(
    model: Model,
    circles: Array | None,
    guides: Array | None,
    partners: Array | None = None,
    feature: Array | None = None,
) -> Kept:
    """The bodies of the given indices, (bodies, 1) each against every feature, or with a `feature` for each, (pairs,); and of
    each movable roller the given partners."""
    circles, guides, feature = (v if v is None else v.astype(PLACE) for v in (circles, guides, feature))
    rollers, n = model.rollers, len(model.circle_names)
    still = jnp.zeros((n - rollers.n_movable,))
    levers = jnp.zeros((n,)).at[rollers.free].set(rollers.radius[rollers.free])
    pairs = None if feature is None else listed(model, feature)

    def surface(values: Array) -> Array:
        parts = [(values[:n], circles), (values[n:], guides)]
        return in_rows([pick(v, index) for v, index in parts if v.shape[0]] or [pick(values, None)])

    pair_index, pair_surface = model.pair_index, model.pair_surface
    if partners is not None:
        partner, which = (jnp.take_along_axis(jnp.asarray(v), partners, axis=1) for v in model.pairs_by_roller)
        mine = jnp.broadcast_to(jnp.arange(rollers.n_movable)[:, None], partner.shape)
        pair_index, pair_surface = (mine, partner), jax.tree.map(lambda v: v[which], pair_surface)
    return Kept(
        pairs=pairs,
        own=(own(model) if pairs is None else pairs.own)[-1],
        circle_index=circles,
        guide_index=guides,
        radius=pick(model.circles.radius, circles),
        active=pick(model.circles.active, circles),
        travel_x=pick(jnp.concatenate([rollers.dir_x, still]), circles),
        travel_y=pick(jnp.concatenate([rollers.dir_y, still]), circles),
        spin_lever=pick(levers, circles),
        guides=kept_guides(model.guides, guides) if model.guides.names else None,
        surface=jax.tree.map(surface, model.surface),
        allowed=surface(allowed_depths(model)),
        approach=surface(allowed_approaches(model)),
        pair_index=pair_index,
        pair_surface=pair_surface,
    )


def by_circle(
    model: Model, kept: Kept, values: Sequence[Sequence[Array]], which: np.ndarray, kind: np.ndarray | int = 0
) -> Array:
    """Of each value its kinds, (circles, features) or (pairs,) of circles, -> (values, which, features): of one kind each, what
    a circle has with every feature."""
    n_kinds, kinds = len(values[0]), np.broadcast_to(np.asarray(kind, int), which.shape)
    if kept.pairs is None or kept.circle_index is None:
        rows = [jnp.concatenate(list(each)) for each in values]
        return jnp.stack(rows)[:, rows[0].shape[0] // n_kinds * kinds + which]
    feature, n_features = kept.pairs.feature[: kept.n_circles], model.layout.tail.shape[0]
    if loops_are_cheap():
        # All kinds of each circle that is asked for, in a last place of all others.
        asked, slot = np.unique(which, return_inverse=True)
        place = np.full((len(model.circle_names),), len(asked), PLACE)
        place[asked] = np.arange(len(asked))
        places = len(asked) * n_features
        at = at_places(jnp.asarray(place), kept.circle_index) * n_features + feature
        found = put_at(places, jnp.minimum(at, PLACE(places)), [v for each in values for v in each])
        # What stands together there and is of one kind is taken at once: of travels, then of spins.
        starts = np.flatnonzero((np.diff(slot, prepend=-2) != 1) | (np.diff(kinds, prepend=-1) != 0))
        runs = [(kinds[k[0]], slice(slot[k[0]], slot[k[-1]] + 1)) for k in np.split(np.arange(len(which)), starts[1:])]
        rows = [v.reshape(-1, n_features) for v in found]
        parts = [rows[v * n_kinds + kind][run] for v in range(len(values)) for kind, run in runs]
        return jnp.concatenate(parts).reshape(len(values), len(which), n_features)
    rows = [jnp.concatenate(list(each)) for each in values]
    # Where each circle belongs by each kind, in a last place what is not asked for.
    place = np.full((n_kinds, len(model.circle_names)), len(which))
    place[kinds, which] = np.arange(len(which))
    at = jnp.asarray(place, PLACE)[:, kept.circle_index].ravel()
    feature, places = jnp.tile(feature, n_kinds), len(which) + 1
    # One value after the other, for of values side by side, as in `by_feature`, each would be computed in every place.
    start = places * np.arange(len(values), dtype=PLACE)[:, None]
    found = jnp.zeros((len(values) * places * n_features,), rows[0].dtype)
    found = found.at[((start + at[None]) * n_features + feature[None]).ravel()].add(
        jnp.concatenate(rows), mode="promise_in_bounds"
    )
    return found.reshape(len(values), places, n_features)[:, :-1]


def by_roller(model: Model, kept: Kept, values: Array) -> Array:
    """(k, bodies, features) or (k, pairs) -> (k, rollers): summed over all that a roller touches."""
    n = model.rollers.n
    if kept.pairs is None or kept.circle_index is None:
        return jnp.sum(values[:, :n], axis=2)
    return summed_at(len(model.circle_names), kept.circle_index, values[:, : kept.n_circles])[:, :n]


def by_body(model: Model, kept: Kept, values: Array) -> Array:
    """(k, bodies, features) or (k, pairs) -> (k, bodies): summed over all that a body touches."""
    if kept.pairs is None:
        return jnp.sum(values, axis=2)
    return summed_at(len(model.body_names), _body_of_pairs(model, kept), values)


def _body_of_pairs(model: Model, kept: Kept) -> Array:
    """(pairs,) which of all bodies is in each."""
    found = ((0, kept.circle_index), (len(model.circle_names), kept.guide_index))
    return jnp.concatenate([first + index for first, index in found if index is not None])


def by_contact(model: Model, kept: Kept, values: Array) -> Array:
    """(k, bodies, features) or (k, pairs) -> the same shape: each value's sum over all that its sheet has with its body."""
    layout = model.layout
    if kept.pairs is None:
        own = jnp.asarray(layout.sheet_of_feature, values.dtype)
        return product(product(values, own), own.T)
    sheet = at_places(jnp.asarray(layout.owner_of_feature, PLACE), kept.pairs.feature)
    contact = _body_of_pairs(model, kept) * len(layout.bars) + sheet
    return at_places(summed_at(len(model.body_names) * len(layout.bars), contact, values), contact)
