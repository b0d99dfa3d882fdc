"""A step as the forces feel it, and what they fill in for bars."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.chain.system import BarTerms
from diffeed.model.arrays import Model


class Step(NamedTuple):
    """Length of a step (s), and whether its end is felt: if not, these are the plain equations of motion."""

    h: Array
    implicit: bool


def bar_terms(model: Model, **given: Array) -> BarTerms:
    """Bar terms with the given entries and zeros elsewhere."""
    zero = jnp.zeros_like(model.bars.mass)
    return BarTerms(**{name: given.get(name, zero) for name in BarTerms._fields})


def summed(terms: list[BarTerms]) -> BarTerms:
    """The sum of terms of several causes."""
    return BarTerms(*(functools.reduce(jnp.add, entries) for entries in zip(*terms, strict=True)))


def on_bar(model: Model, bar: int, value: Array) -> Array:
    """(bars,) with a value at one bar and zeros elsewhere."""
    here = np.arange(model.layout.n_bars) == bar
    return jnp.where(here, value, jnp.zeros_like(model.bars.mass))
