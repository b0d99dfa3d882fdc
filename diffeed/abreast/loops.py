"""Loops and choices for samples abreast. What a loop carries differs between samples if it ever comes to."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from diffeed.abreast.values import Abreast, Value, differs, of_all, repeated

Walk = Callable[[Any, int, list[Value]], list[Value]]
"""From a closed jaxpr, how many samples there are and what it is given to its results."""
Differing = Callable[[Any, list[bool]], list[bool]]
"""From a closed jaxpr and what of that differs between samples to which results do."""


def held(values: Any, differing: list[bool]) -> list[Value]:
    """Arrays of a loop as what a walk is given."""
    return [Abreast(v) if d else v for v, d in zip(values, differing, strict=True)]


def laid_out(values: list[Value], differing: list[bool], size: int) -> list[Any]:
    """And back."""
    return [of_all(v, size) if d else v for v, d in zip(values, differing, strict=True)]


def in_the_end(differing: list[bool], once_more: Callable[[list[bool]], list[bool]]) -> list[bool]:
    """Which of the carried values come to differ."""
    while (then := [a or b for a, b in zip(differing, once_more(differing), strict=True)]) != differing:
        differing = then
    return differing


def scan(
    walk: Walk, which: Differing, size: int, given: list[Value], *,
    jaxpr: Any, length: int, reverse: bool, unroll: int, **params: Any,
) -> list[Value]:  # fmt: skip
    """`lax.scan`."""
    n_consts, n_carry = _counts(params)
    flags = [differs(v) for v in given]
    consts, carry, rows = given[:n_consts], given[n_consts:][:n_carry], given[n_consts + n_carry :]
    carried, every = scan_differing(which, flags, jaxpr=jaxpr, **params)
    of_rows = flags[n_consts + n_carry :]

    def one(so_far: list[Any], row: list[Any]) -> tuple[list[Any], list[Any]]:
        found = walk(jaxpr, size, [*consts, *held(so_far, carried), *held(row, of_rows)])
        return laid_out(found[:n_carry], carried, size), laid_out(found[n_carry:], every, size)

    bare = [v.values if isinstance(v, Abreast) else v for v in rows]
    last, made = lax.scan(one, laid_out(carry, carried, size), bare, length=length, reverse=reverse, unroll=unroll)
    return held(last, carried) + held(made, every)


def scan_differing(which: Differing, flags: list[bool], *, jaxpr: Any, **params: Any) -> tuple[list[bool], list[bool]]:
    """Of a scan what it carries, and what it makes at every turn."""
    n_consts, n_carry = _counts(params)
    consts, carry, rows = flags[:n_consts], flags[n_consts:][:n_carry], flags[n_consts + n_carry :]
    carried = in_the_end(carry, lambda c: which(jaxpr, [*consts, *c, *rows])[:n_carry])
    return carried, which(jaxpr, [*consts, *carried, *rows])[n_carry:]


def _counts(params: dict[str, Any]) -> tuple[int, int]:
    """Of a scan how many of its operands are constants, and how many it carries: JAX 0.12 says so by what it was given."""
    if "ft_in" in params:
        consts, carry, _ = params["ft_in"].unpack()
        return len(consts), len(carry)
    return params["num_consts"], params["num_carry"]


def while_loop(
    walk: Walk, which: Differing, size: int, given: list[Value], *,
    cond_jaxpr: Any, cond_nconsts: int, body_jaxpr: Any, body_nconsts: int,
) -> list[Value]:  # fmt: skip
    """`lax.while_loop`: as long as any sample goes on; the others keep what they have."""
    asked, consts, carry = (
        given[:cond_nconsts],
        given[cond_nconsts:][:body_nconsts],
        given[cond_nconsts + body_nconsts :],
    )
    carried, each = while_differing(
        which, [differs(v) for v in given],
        cond_jaxpr=cond_jaxpr, cond_nconsts=cond_nconsts, body_jaxpr=body_jaxpr, body_nconsts=body_nconsts,
    )  # fmt: skip

    def goes_on(so_far: list[Any]) -> Value:
        return walk(cond_jaxpr, size, [*asked, *held(so_far, carried)])[0]

    def any_goes_on(so_far: list[Any]) -> Any:
        found = goes_on(so_far)
        return jnp.any(found.values) if isinstance(found, Abreast) else found

    def one(so_far: list[Any]) -> list[Any]:
        then = laid_out(walk(body_jaxpr, size, [*consts, *held(so_far, carried)]), carried, size)
        if not each:
            return then
        more = of_all(goes_on(so_far), size)
        return [jnp.where(repeated(more, new.shape), new, old) for new, old in zip(then, so_far, strict=True)]

    return held(lax.while_loop(any_goes_on, one, laid_out(carry, carried, size)), carried)


def while_differing(
    which: Differing, flags: list[bool], *, cond_jaxpr: Any, cond_nconsts: int, body_jaxpr: Any, body_nconsts: int
) -> tuple[list[bool], bool]:
    """Of a loop what it carries, and whether each sample ends by itself: then all that it carries differs."""
    asked, consts, carry = (
        flags[:cond_nconsts],
        flags[cond_nconsts:][:body_nconsts],
        flags[cond_nconsts + body_nconsts :],
    )
    carried = in_the_end(carry, lambda c: which(body_jaxpr, [*consts, *c]))
    each = which(cond_jaxpr, [*asked, *carried])[0]
    return [True] * len(carried) if each else carried, each


def cond(walk: Walk, which: Differing, size: int, given: list[Value], *, branches: Any, **_: Any) -> list[Value]:
    """`lax.cond` and `lax.switch`: where samples choose for themselves, all branches are computed."""
    index, *given = given
    flags = [differs(v) for v in given]
    if isinstance(index, Abreast):
        every = [[of_all(v, size) for v in walk(branch, size, given)] for branch in branches]
        chosen = index.values.astype(bool) if len(branches) == 2 else index.values
        return [Abreast(lax.select_n(repeated(chosen, v[0].shape), *v)) for v in zip(*every, strict=True)]
    differing = cond_differing(which, flags, branches=branches)

    def one_of(branch: Any) -> Callable[..., list[Any]]:
        return lambda *values: laid_out(walk(branch, size, held(values, flags)), differing, size)

    bare = [v.values if isinstance(v, Abreast) else v for v in given]
    return held(lax.switch(index, [one_of(branch) for branch in branches], *bare), differing)


def cond_differing(which: Differing, flags: list[bool], *, branches: Any, **_: Any) -> list[bool]:
    """Of a choice that all samples make together: what any branch gives."""
    return [any(of_each) for of_each in zip(*(which(branch, flags) for branch in branches), strict=True)]
