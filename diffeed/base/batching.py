"""How a batch is computed, and what it decides together: a choice that each sample made for itself would cost all of them both
ways."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

from diffeed.base.one_kernel import loops_are_cheap


def for_each(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one sample's arguments as one of stacked ones, (samples, ...): one sample after the other where a run is
    one kernel, for that is faster than `jax.vmap` (`tests.one_kernel_cost`), which it is elsewhere. Results have derivatives;
    for such as need none `diffeed.abreast` is faster still."""

    def one_by_one(*given: Any) -> Any:
        return lax.map(lambda each: function(*each), given)

    return one_by_one if loops_are_cheap() else jax.vmap(function)


def any_of_batch(flag: Array) -> Array:
    """The flag itself; of samples side by side whether any of them has it set, one and the same for all, so that `lax.cond` on it
    stays a choice."""
    return _any_of_batch.bind(flag)


def least_of_group(values: Array) -> Array:
    """The values themselves; of samples abreast (`diffeed.abreast`), not of those of `jax.vmap`, the least of all, one and the
    same for all, so that what is chosen by them serves every one."""
    return _least_of_group.bind(values)


def _itself(name: str) -> Primitive:
    """What does nothing to one sample."""
    made = Primitive(name)
    made.def_impl(lambda values: values)
    made.def_abstract_eval(lambda values: values)
    mlir.register_lowering(made, lambda ctx, values: [values])
    return made


_any_of_batch, _least_of_group = _itself("any_of_batch"), _itself("least_of_group")
batching.primitive_batchers[_any_of_batch] = lambda given, axes: (any_of_batch(jnp.any(given[0], axis=axes[0])), None)
batching.primitive_batchers[_least_of_group] = lambda given, axes: (least_of_group(given[0]), axes[0])
