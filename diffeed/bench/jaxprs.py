"""The size of a traced program: what the compiler is given."""

from collections.abc import Callable, Iterator
from typing import Any

import jax


def count_equations(function: Callable[..., Any], *arguments: Any) -> int:
    """Equations of the program that JAX traces, those of all loops, branches and calls within it included."""
    return sum(1 for _ in operations(function, *arguments))


def operations(function: Callable[..., Any], *arguments: Any) -> Iterator[str]:
    """Names of those equations' operations, one by one."""
    return (equation.primitive.name for equation in equations(function, *arguments))


def equations(function: Callable[..., Any], *arguments: Any) -> Iterator[Any]:
    """Those equations themselves."""
    return _equations(jax.make_jaxpr(function)(*arguments).jaxpr)


def _equations(jaxpr: Any) -> Iterator[Any]:
    for equation in jaxpr.eqns:
        yield equation
        for inner in _inner(equation.params.values()):
            yield from _equations(inner)


def _inner(values: Any) -> Iterator[Any]:
    """Programs among the parameters of an equation, bare or closed, alone or in a list."""
    for value in values:
        if isinstance(value, (list, tuple)):
            yield from _inner(value)
        elif hasattr(value, "eqns"):
            yield value
        elif hasattr(value, "jaxpr") and hasattr(value.jaxpr, "eqns"):
            yield value.jaxpr
