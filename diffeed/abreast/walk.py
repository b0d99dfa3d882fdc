"""From a function of one sample to one of a group: its operations one after the other, each by its rule."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.extend.core import ClosedJaxpr, Literal

from diffeed.abreast import loops
from diffeed.abreast.arrays import RULES, by_vmap
from diffeed.abreast.values import Abreast, Value, differs, of_all
from diffeed.base.one_kernel import loops_are_cheap

CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat": "jaxpr",
    "remat2": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vmap_call": "call",
}
"""Operations that stand for others, by the parameter that holds these: a walk goes through them."""
TOGETHER = ("least_of_group", "any_of_batch")
"""What one group has once."""
GROUP = 8
"""Samples of a group: as many numbers as one line of the processor's memory holds; of twice as many a step no longer fits its
second memory (4, 16 and 32 take 1.05 to 1.14 of the time: script)."""


def for_many(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one sample's arguments as one of stacked ones, (samples, ...): groups of `GROUP` abreast, one group after
    the other, where a run is one kernel (`diffeed.tuning.compile_for_many`); elsewhere `jax.vmap`.

    ```python
    last = for_many(lambda scene: diffeed.simulate(scene, 0.1).sheets["film"].nodes[-1])
    jax.jit(last)(diffeed.stack(scenes))
    ```

    For results without derivatives: asked for one, it raises TypeError. ValueError if the arrays do not hold equally many
    samples, one at least. What a sample gives does not depend on the others of its group, unless together they ask for more
    pairs than a search lists (fixed by `crowded` in the scene): then runs fail for that reason, and hold by themselves.
    """

    def of_groups(*given: Any) -> Any:
        count = _count(given)
        size = min(GROUP, count)
        groups = -(-count // size)

        def grouped(v: Array) -> Array:
            filled = jnp.concatenate([v, jnp.repeat(v[:1], groups * size - count, axis=0)])
            return jnp.moveaxis(filled.reshape(groups, size, *v.shape[1:]), 1, -1)

        def apart(v: Array) -> Array:
            return jnp.moveaxis(v, -1, 1).reshape(groups * size, *v.shape[1:-1])[:count]

        return jax.tree.map(apart, lax.map(lambda group: abreast(function)(*group), jax.tree.map(grouped, given)))

    return _without_derivatives(of_groups) if loops_are_cheap() else jax.vmap(function)


def _count(given: Any) -> int:
    """How many samples the arrays hold."""
    lengths = {jnp.shape(v)[:1] for v in jax.tree.leaves(given)}
    if len(lengths) != 1 or lengths & {(), (0,)}:
        found = ", ".join("none" if n == () else str(n[0]) for n in sorted(lengths)) or "none"
        raise ValueError(f"every array must hold as many samples, one at least, along its first axis; found {found}")
    return lengths.pop()[0]


def abreast(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one sample's arguments as one of a group's: every array with a last axis more, (..., samples)."""

    def of_group(*given: Any) -> Any:
        values, structure = jax.tree.flatten(given)
        size = values[0].shape[-1]
        one = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(v.shape[:-1], v.dtype) for v in values])
        jaxpr, result = jax.make_jaxpr(function, return_shape=True)(*one)
        found = _walk(jaxpr, size, [Abreast(jnp.asarray(v)) for v in values])
        return jax.tree.unflatten(jax.tree.structure(result), [of_all(v, size) for v in found])

    return of_group


def _without_derivatives(function: Callable[..., Any]) -> Callable[..., Any]:
    guarded = jax.custom_jvp(function)

    @guarded.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        raise TypeError("samples abreast have no derivatives: use `for_each`")

    return guarded


def _walk(jaxpr: Any, size: int, given: list[Value]) -> list[Value]:
    """Results of a closed jaxpr."""
    known: dict[Any, Value] = dict(zip(jaxpr.jaxpr.constvars, jaxpr.consts, strict=True))
    known |= dict(zip(jaxpr.jaxpr.invars, given, strict=True))

    def read(v: Any) -> Value:
        return v.val if isinstance(v, Literal) else known[v]

    for eqn in jaxpr.jaxpr.eqns:
        known |= dict(zip(eqn.outvars, _one(eqn, size, [read(v) for v in eqn.invars]), strict=True))
    return [read(v) for v in jaxpr.jaxpr.outvars]


def _one(eqn: Any, size: int, given: list[Value]) -> list[Value]:
    """Results of one operation."""
    name, primitive, params = eqn.primitive.name, eqn.primitive, dict(eqn.params)
    if name == "custom_vmap_call" and any(differs(v) for v in given):
        return _by_its_rule(size, given, **params)
    if name in CALLS:
        return _walk(_closed(params[CALLS[name]]), size, given)
    if not any(differs(v) for v in given):
        found = primitive.bind(*given, **params)
        return list(found) if primitive.multiple_results else [found]
    if name in LOOPS:
        return LOOPS[name](_walk, _which, size, given, **params)
    return RULES.get(name, by_vmap)(primitive, size, given, **params)


LOOPS = {"scan": loops.scan, "while": loops.while_loop, "cond": loops.cond}


def _closed(jaxpr: Any) -> Any:
    return jaxpr if hasattr(jaxpr, "jaxpr") else ClosedJaxpr(jaxpr, ())


def _by_its_rule(size: int, given: list[Value], *, rule: Any, in_tree: Any, **_: Any) -> list[Value]:
    """What says itself how a batch is computed, with samples first."""
    moved = [jnp.moveaxis(v.values, -1, 0) if isinstance(v, Abreast) else v for v in given]
    found, differing = rule(size, jax.tree.unflatten(in_tree, [differs(v) for v in given]), *in_tree.unflatten(moved))
    of_each = zip(jax.tree.leaves(found), jax.tree.leaves(differing), strict=True)
    return [Abreast(jnp.moveaxis(v, 0, -1)) if d else v for v, d in of_each]


def _which(jaxpr: Any, given: list[bool]) -> list[bool]:
    """Which results of a closed jaxpr differ between samples, if of what it is given these do."""
    known: dict[Any, bool] = dict.fromkeys(jaxpr.jaxpr.constvars, False)
    known |= dict(zip(jaxpr.jaxpr.invars, given, strict=True))

    def read(v: Any) -> bool:
        return not isinstance(v, Literal) and known[v]

    for eqn in jaxpr.jaxpr.eqns:
        known |= dict(zip(eqn.outvars, _which_of_one(eqn, [read(v) for v in eqn.invars]), strict=True))
    return [read(v) for v in jaxpr.jaxpr.outvars]


def _which_of_one(eqn: Any, given: list[bool]) -> list[bool]:
    name = eqn.primitive.name
    if not any(given) or name in TOGETHER:
        return [False] * len(eqn.outvars)
    if name in CALLS and name != "custom_vmap_call":
        return _which(_closed(eqn.params[CALLS[name]]), given)
    if name == "scan":
        carried, every = loops.scan_differing(_which, given, **eqn.params)
        return carried + every
    if name == "while":
        return loops.while_differing(_which, given, **eqn.params)[0]
    if name == "cond" and not given[0]:
        return loops.cond_differing(_which, given[1:], **eqn.params)
    return [True] * len(eqn.outvars)
