"""What a batch decides together: a choice that each sample made for itself would cost all of them both ways."""

from typing import Any

import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap


@custom_vmap
def any_of_batch(flag: Array) -> Array:
    """The flag itself; under `vmap` whether any sample has it set, one and the same for all, so that `lax.cond` on it stays a
    choice."""
    return flag


@any_of_batch.def_vmap
def _any_of_batch(size: int, batched: list[bool], flag: Array) -> tuple[Any, bool]:
    return any_of_batch(jnp.any(flag)), False
