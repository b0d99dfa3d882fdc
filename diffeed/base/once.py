"""What is computed once and read many times, where the compiler would compute it again for each reader.

Up to JAX 0.10, XLA on the processor merges cheap operations into each of their readers. Dozens of sums read the forces of a
contact, in the reverse of a run still more, and each gets all that they are made of: code that is larger, slow to compile and to
run. A division stops that, since it counts as dear; so what is read is divided by a one of which the compiler cannot know that
it is one. It must have the shape of what it divides: a division by one number becomes a product with its inverse, which is cheap
again. (`lax.optimization_barrier` does not serve: it is gone before operations are merged.)
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax


def computed_once(values: Any) -> Any:
    """The same arrays, not merged into what reads them, nor their derivatives."""
    return jax.tree.map(lambda v: v / _one(v), values)


@jax.custom_jvp
def derived_once(values: Any) -> Any:
    """The same arrays, with derivatives that are not merged into what reads them."""
    return values


@derived_once.defjvp
def _derived_once_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    (values,), (slopes,) = primals, tangents
    return values, jax.tree.map(lambda v, slope: slope / _one(v), values, slopes)


def _one(value: Array) -> Array:
    """1, of the shape of `value`; where that is not a number, neither is this."""
    return jnp.where(jnp.isnan(lax.stop_gradient(value)), jnp.asarray(jnp.nan, value.dtype), jnp.ones((), value.dtype))
