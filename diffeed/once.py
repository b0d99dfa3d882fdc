"""Derivatives that are computed once and read many times, where the compiler would compute them again for each reader.

Up to JAX 0.10, XLA on the processor merges cheap operations into each of their readers. In the reverse of a contact dozens of
sums read the same products, and each gets them all: code that is larger by 40 %, slow to compile and to run. A division stops
that, since it counts as dear; so the derivative is divided by a one of which the compiler cannot know that it is one.
(`lax.optimization_barrier` does not serve: it is gone before operations are merged.)
"""

from typing import Any

import jax
from jax import Array


@jax.custom_jvp
def derived_once(values: Any, known: Array) -> Any:
    """The same arrays, with derivatives that are not merged into what reads them. `known` is any finite number of the scene."""
    return values


@derived_once.defjvp
def _derived_once_jvp(primals: tuple[Any, Array], tangents: tuple[Any, Array]) -> tuple[Any, Any]:
    values, known = primals
    one = 1.0 + 0.0 * known
    return values, jax.tree.map(lambda v: v / one, tangents[0])
