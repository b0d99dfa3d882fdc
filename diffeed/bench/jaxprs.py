"""The size of a traced program: what the compiler is given."""

from collections.abc import Callable, Iterator
from typing import Any

import jax


def count_equations(function: Callable[..., Any], *arguments: Any) -> int:
    """Equations of the program that JAX traces, those of all loops, branches and calls within it included."""
    return sum(1 for _ in operations(function, *arguments))


def operations(function: Callable[..., Any], *arguments: Any) -> Iterator[str]:
    """Names of those equations' operations, one by one."""
    yield from _operations(jax.make_jaxpr(function)(*arguments).jaxpr)


def _operations(jaxpr: Any) -> Iterator[str]:
    for eqn in jaxpr.eqns:
        yield eqn.primitive.name
        for inner in _inner(eqn.params.values()):
            yield from _operations(inner)


def _inner(values: Any) -> Iterator[Any]:
    """Programs among the parameters of an equation, bare or closed, alone or in a list."""
    for value in values:
        if isinstance(value, (list, tuple)):
            yield from _inner(value)
        elif hasattr(value, "eqns"):
            yield value
        elif hasattr(value, "jaxpr") and hasattr(value.jaxpr, "eqns"):
            yield value.jaxpr
