"""What is computed once and read many times, where the compiler would compute it again for each reader.

Up to JAX 0.10, XLA on the processor merges cheap operations into each of their readers. Dozens of sums read the forces of a
contact, in the reverse of a run still more, and each gets all that they are made of: code that is larger, slow to compile and to
run. A division stops that, since it counts as dear; so what is read is divided by a one of which the compiler cannot know that
it is one. (`lax.optimization_barrier` does not serve: it is gone before operations are merged.)
"""

from typing import Any

import jax
from jax import Array


def computed_once(values: Any, known: Array) -> Any:
    """The same arrays, not merged into what reads them, nor their derivatives. `known` is any finite number of the scene."""
    one = 1.0 + 0.0 * known
    return jax.tree.map(lambda v: v / one, values)


@jax.custom_jvp
def derived_once(values: Any, known: Array) -> Any:
    """The same arrays, with derivatives that are not merged into what reads them."""
    return values


@derived_once.defjvp
def _derived_once_jvp(primals: tuple[Any, Array], tangents: tuple[Any, Array]) -> tuple[Any, Any]:
    values, known = primals
    return values, computed_once(tangents[0], known)
