"""What the sheet carries between driven nips: tension, and compression against the Euler load of the free span."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.products import product
from diffeed.base.records import number, record, replace
from diffeed.base.smooth import divide
from diffeed.chain.state import State
from diffeed.contact.kept import by_circle
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.pair.law import NEWTON

PEAK = 4.0
"""Exponent of the time mean that stands for a peak: smooth, and not ruled by one step."""


@record
class SpanStats:
    """Per sheet, over the time in which two driven nips hold it; zeros if none ever did."""

    held: Any = number(unit="s", doc="time in which at least two driven nips held the sheet")
    tension: Any = number(unit="N", doc="mean tension of the spans between them, negative in compression")
    tension_peak: Any = number(unit="N", doc="fourth-power mean over time of the tension of the tightest span")
    buckling: Any = number(
        unit="1",
        doc="fourth-power mean over time of the largest compression of a span over its Euler load (hinged ends)",
    )


@record
class SpanSums:
    """Time integrals per sheet, (sheets,)."""

    held: Any
    tension: Any
    tight: Any
    buckling: Any


def start(model: Model, scene: Scene, state: State) -> SpanSums:
    zero = jnp.zeros((len(model.layout.names),))
    return SpanSums(held=zero, tension=zero, tight=zero, buckling=zero)


def update(model: Model, scene: Scene, sums: SpanSums, seen: Any) -> SpanSums:
    if seen.touching.sheets is None or model.rollers.n < 2:
        return sums
    tension = seen.after.stretch / (2.0 * model.bars.half_length) / NEWTON
    kept, driven = seen.kept, np.flatnonzero(model.rollers.driven)
    force = by_circle(model, kept, [[seen.touching.sheets.touch.force[: kept.n_circles]]], driven)[0]
    found = [_spans(model, scene, k, name, tension, force) for k, name in enumerate(model.layout.names)]
    weight, pull, ratio = (jnp.stack(v) for v in zip(*found, strict=True))  # (sheets, pairs) each
    # What joints pull is a number of the step, not of its ends: it counts for all of it.
    h = jnp.where(jnp.sum(weight, axis=1) > 0, seen.h, 0.0)
    count = jnp.sum(weight, axis=1)
    return SpanSums(
        held=sums.held + h,
        tension=sums.tension + h * divide(jnp.sum(weight * pull, axis=1), count),
        # The largest, for a span counts once, however many rollers hold its ends.
        tight=sums.tight + h * jnp.max(weight * jnp.maximum(pull, 0.0), axis=1, initial=0.0) ** PEAK,
        buckling=sums.buckling + h * jnp.max(weight * jnp.maximum(ratio, 0.0), axis=1, initial=0.0) ** PEAK,
    )


def _spans(model: Model, scene: Scene, k: int, name: str, tension: Array, pressed: Array) -> tuple[Array, Array, Array]:
    """For every pair of driven rollers: 1 if they hold the sheet as neighbours, mean tension between, compression over the Euler
    load. Each (pairs,). `pressed` are the forces of the driven rollers, (driven, features)."""
    layout, sheet = model.layout, scene.sheets[name]
    bars = layout.slices()[k]
    features = slice(bars.start + k, bars.stop + k + 1)
    force = pressed[:, features]
    bar = sheet.length / sheet.bars
    count = layout.bars[k]
    middle = 0.0 if model.skin == "smooth" else 0.5  # a feature is centred on its node or on its bar
    place = jnp.asarray(np.arange(count + 1) + middle, bar.dtype) * bar
    total = jnp.sum(force, axis=1)
    at = divide(product(force, place), total)  # mm behind the lead where each nip holds
    holds = (total > 0).astype(at.dtype)
    i, j = np.triu_indices(len(pressed), 1)
    low, high = jnp.minimum(at[i], at[j]), jnp.maximum(at[i], at[j])
    inner = (at[None] > low[:, None] + 0.5 * bar) & (at[None] < high[:, None] - 0.5 * bar)
    between = jnp.sum(jnp.where(inner, holds[None], 0.0), axis=1)
    apart = (between == 0) & (high - low > 2.0 * bar)
    neighbours = jnp.where(apart, holds[i] * holds[j], 0.0)
    centres = jnp.asarray(np.arange(count) + 0.5, bar.dtype) * bar
    inside = ((centres[None] > low[:, None]) & (centres[None] < high[:, None])).astype(at.dtype)
    mean = divide(product(inside, tension[bars]), jnp.sum(inside, axis=1))
    stiffness = sheet.youngs_modulus * sheet.thickness**3 * sheet.width / 12.0  # N mm2
    euler = np.pi**2 * stiffness / jnp.maximum(high - low, bar) ** 2
    return neighbours, mean, divide(-mean, euler)


def close(model: Model, scene: Scene, sums: SpanSums, end: Any) -> dict[str, SpanStats]:
    held = sums.held
    peak = [_root(divide(v, held)) for v in (sums.tight, sums.buckling)]
    every = SpanStats(held=held, tension=divide(sums.tension, held), tension_peak=peak[0], buckling=peak[1])
    names = SpanStats.__dataclass_fields__  # type: ignore[attr-defined]
    return {
        sheet: replace(every, **{n: getattr(every, n)[k] for n in names}) for k, sheet in enumerate(model.layout.names)
    }


def _root(x: Array) -> Array:
    """Fourth root with gradient 0 at 0."""
    positive = x > 0
    return jnp.where(positive, jnp.where(positive, x, 1.0) ** (1.0 / PEAK), 0.0)
