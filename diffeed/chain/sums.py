"""Sums along chains. Where loops are dear short chains use a product with a constant matrix: one call where a running sum takes
five."""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.products import product
from diffeed.model.layout import Layout

SHORT = 100
"""Bars up to which the product is faster where loops are dear (measured, one CPU core)."""


def same_sheet(layout: Layout) -> np.ndarray:
    """(bars, bars) bool."""
    return layout.sheet_of_bar[:, None] == layout.sheet_of_bar[None, :]


def membership(layout: Layout) -> np.ndarray:
    """(bars, sheets) 1 where the bar belongs to the sheet."""
    return np.asarray(layout.sheet_of_bar[:, None] == np.arange(len(layout.bars))[None, :], float)


def before(layout: Layout) -> np.ndarray:
    """(bars, bars) entry (j, i): 1 where bar j is in front of bar i in its sheet, a half at i itself."""
    n = layout.n_bars
    return (np.triu(np.ones((n, n)), 1) + 0.5 * np.eye(n)) * same_sheet(layout)


def apply(values: Array, table: np.ndarray) -> Array:
    """(..., bars) times a constant (bars, k)."""
    return product(values, jnp.asarray(table, values.dtype))


def up_to_centre(layout: Layout, values: Array) -> Array:
    """(k, bars) -> for each bar half its own value plus those of all in front of it in its sheet.

    For long chains one running sum serves all sheets: right where a sheet's values add up to nothing.
    """
    if loops_are_cheap():
        return running(layout, values)
    if layout.n_bars <= SHORT:
        return apply(values, before(layout))
    return jnp.cumsum(values, axis=1) - 0.5 * values


def from_mean(layout: Layout, values: Array) -> Array:
    """(k, bars) steps from front to rear of each bar -> places of the bars' centres about their sheet's mean."""
    cheap = loops_are_cheap()
    if layout.n_bars <= SHORT and not cheap:
        own = membership(layout)
        mean = (own / own.sum(axis=0)) @ own.T
        table = before(layout)
        return apply(values, table - table @ mean)
    places = running(layout, values) if cheap else jnp.cumsum(values, axis=1) - 0.5 * values
    if len(layout.bars) == 1:
        return places - jnp.mean(places, axis=1, keepdims=True)
    means = jnp.stack([jnp.mean(places[:, s], axis=1) for s in layout.slices()], axis=1)
    return places - means[:, layout.sheet_of_bar]


def running(layout: Layout, values: Array) -> Array:
    """The same as `up_to_centre`, of whatever values."""

    def bar(total: Array, row: tuple[Array, ...]) -> tuple[Array, Array]:
        value, *joined = row
        total = joined[0] * total if joined else total
        return total + value, total + 0.5 * value

    rows = (values.T, jnp.asarray(~layout.first, values.dtype)) if len(layout.bars) > 1 else (values.T,)
    return lax.scan(bar, jnp.zeros(values.shape[:1], values.dtype), rows)[1].T
