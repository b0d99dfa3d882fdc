"""How a batch is computed, and what it decides together: a choice that each sample made for itself would cost all of them both
ways."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.custom_batching import custom_vmap

from diffeed.base.one_kernel import loops_are_cheap


def for_each(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one sample's arguments as one of stacked ones, (samples, ...): one sample after the other where a run is
    one kernel, for that is faster than side by side (`tests.one_kernel_cost`); elsewhere `jax.vmap`."""

    def one_by_one(*given: Any) -> Any:
        return lax.map(lambda each: function(*each), given)

    return one_by_one if loops_are_cheap() else jax.vmap(function)


@custom_vmap
def any_of_batch(flag: Array) -> Array:
    """The flag itself; under `vmap` whether any sample has it set, one and the same for all, so that `lax.cond` on it stays a
    choice."""
    return flag


@any_of_batch.def_vmap
def _any_of_batch(size: int, batched: list[bool], flag: Array) -> tuple[Any, bool]:
    return any_of_batch(jnp.any(flag)), False
