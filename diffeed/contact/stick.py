"""Tangential deflections of sticking contacts: who holds them, what a pair feels of them, how they move on.

The deflection on a roller, a circle guide or a tip belongs to the sheet and that circle: one contact, which wanders from
bar to bar. On line and arc guides it belongs to the feature (an end circle touches one face at a time, and guides that
join hand it on). All stand in one row, over the stick displacement of the set: circles by sheets, then features; only
where some set of the kind sticks. A scene in which none does has no row (None) and the program that it had before.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.products import product
from diffeed.base.records import replace
from diffeed.base.smooth import divide
from diffeed.chain.state import State, initial_grip
from diffeed.chain.system import Solution
from diffeed.contact import gained
from diffeed.contact.features import by_feature
from diffeed.contact.kept import Kept, by_circle, part, pick
from diffeed.contact.sweep import Pairs
from diffeed.model.arrays import Model
from diffeed.pair.law import SLIDES, Grip, stick_deflection


def fitted(model: Model, state: State) -> State:
    """A state that may come from the same scene with other friction laws: where others stick, all deflections start at zero."""
    if not isinstance(state, State):
        kind = type(state).__name__
        more = {
            "Trajectory": ": give its `final` to go on with it, or `final.state`",
            "Resume": ": give its `state`",
        }.get(kind, "")
        raise TypeError(
            f"a state (of diffeed.settle, or `final.state` of a run) is needed here, but this is a {kind}{more}"
        )
    bars, has = model.layout.n_bars, jnp.shape(state.heading)[-1]
    if has != bars:
        raise ValueError(f"the state is of sheets with {has} bars in all, but those of the scene have {bars}")
    wanted = initial_grip(model)
    fits = jax.tree.map(jnp.shape, state.grip) == jax.tree.map(jnp.shape, wanted)
    return state if fits else replace(state, grip=wanted)


def of_pairs(
    model: Model, grip: Array | None, kept: Kept, ahead: Array | float, pressed: Array | None = None
) -> Grip | None:
    """What each kept pair feels. `ahead` (s) is the length of an implicit step, else 0."""
    if grip is None:
        return None
    n_features, n = model.layout.tail.shape[0], kept.n_circles
    others = kept.surface.stiffness.shape[0] - n
    on_circles, on_faces = jnp.split(grip, [model.grips[0]])
    rows = []
    if n:
        shape = (n, n_features) if kept.pairs is None else (n,)
        rows.append(_at_circles(model, on_circles, kept) if model.sticks[0] else jnp.zeros(shape))
    if others:
        row = on_faces if model.sticks[1] else jnp.zeros((n_features,))
        whole = jnp.broadcast_to(row[None, :], (others, n_features))
        rows.append(whole if kept.pairs is None else row[kept.pairs.feature[n:]])
    return Grip(jnp.concatenate(rows), ahead, pressed)


def _at_circles(model: Model, on_circles: Array, kept: Kept) -> Array:
    n_sheets, n_features = len(model.layout.names), model.layout.tail.shape[0]
    table, index = on_circles.reshape(-1, n_sheets), kept.circle_index
    if kept.pairs is not None and index is not None:
        owner = jnp.asarray(model.layout.owner_of_feature)
        return table[index, owner[kept.pairs.feature[: kept.n_circles]]]
    if n_sheets == 1:
        return jnp.broadcast_to(pick(table[:, 0], index)[: kept.n_circles], (kept.n_circles, n_features))
    owner = model.layout.owner_of_feature
    return table[: kept.n_circles, owner] if index is None else table[index, owner[None, :]]


def _gather(model: Model, kept: Kept, values: tuple[Array, ...]) -> Array:
    """(values, deflections): each value summed over the sticking pairs that share a deflection."""
    rows = [jnp.where(kept.surface.stick, v, 0.0) for v in values]
    n, found = kept.n_circles, []
    if model.sticks[0]:
        own = jnp.asarray(model.layout.sheet_of_feature, rows[0].dtype)
        sums = product(by_circle(model, kept, [[v[:n]] for v in rows], np.arange(len(model.circle_names))), own)
        found.append(sums.reshape(len(values), -1))
    if model.sticks[1]:
        found.append(by_feature(model, [v[n:] for v in rows], part(kept.pairs, kept.pairs, slice(n, None))))
    return jnp.concatenate(found, axis=1)


def pull(model: Model, pairs: Pairs, slide: Array, kept: Kept) -> tuple[Array, Array]:
    """1/s, how fast each deflection is dragged along at the sliding speeds `slide` (mm/s), the mean over its pairs by their
    normal force; and whether any force presses there at all."""
    force = pairs.touch.force
    pressed, dragged = _gather(model, kept, (force, force * slide / kept.surface.stick_displacement))
    return divide(dragged, pressed), pressed > 0


def moved(grip: Array, rate: Array, pressed: Array, h: Array | float) -> Array:
    """Deflections after a time h (s): bounded where the contact slides, none where nothing presses."""
    return jnp.where(pressed, jnp.clip(grip + h * rate, -SLIDES, SLIDES), 0.0)


def advance(model: Model, grip: Array | None, pairs: Pairs | None, a: Solution, h: Array, kept: Kept) -> Array | None:
    """Deflections at the end of an implicit step: dragged along at the sliding speeds that the step ends with."""
    if grip is None or pairs is None:
        return grip
    slide = pairs.v_t + h * gained.along(model, pairs, a, kept)
    return moved(grip, *pull(model, pairs, slide, kept), h)


def slope(model: Model, grip: Array | None, pairs: Pairs | None, h: Array, kept: Kept) -> Array | None:
    """Time derivative of the deflections, for an explicit step of length h, whose end is then `bounded`; where nothing
    presses they fade within a few steps."""
    if grip is None or pairs is None:
        return grip
    rate, pressed = pull(model, pairs, pairs.v_t, kept)
    return jnp.where(pressed, rate, -grip / h)


def bounded(grip: Array | None) -> Array | None:
    """What an explicit step has carried past the bound, brought back."""
    return None if grip is None else jnp.clip(grip, -SLIDES, SLIDES)


def pressed_only(model: Model, grip: Array | None, pairs: Pairs | None, kept: Kept) -> Array | None:
    """The deflections of what touches; none where nothing presses."""
    if grip is None or pairs is None:
        return grip
    return moved(grip, *pull(model, pairs, jnp.zeros_like(pairs.v_t), kept), 0.0)


def at_friction(model: Model, pairs: Pairs, kept: Kept) -> Array:
    """The deflections that hold the friction of `pairs`, which the regularised law gave."""
    surface = kept.surface
    coefficient = surface.friction
    if surface.static_excess is not None:
        coefficient = coefficient * (1.0 + surface.static_excess)
    limit = coefficient * kept.own.friction_factor * pairs.touch.force
    friction, most = _gather(model, kept, (pairs.touch.friction, limit))
    return stick_deflection(divide(friction, most))
