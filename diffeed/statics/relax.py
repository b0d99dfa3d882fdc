"""The search for a rest: where an imbalance vanishes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.products import product

ITERATIONS = 500
WARY, BOLD, BOLDER = 0.5, 4.0, 1.05
"""How far what a step of the search leaves may be off what was foreseen, as a share of what there was: at first and after a
step refused, at most, and its growth with each step taken. (Contacts that open and close want 0.5; with it alone a
sheet that only bends takes up to twenty times as many steps.)"""
LONGER = 4.0
"""Largest growth of the squared length of a step of the search from one to the next."""
SHORTEST, LONGEST = 1e-14, 1e14
"""s2: squared lengths of steps. The shortest, 0.1 us, follows bars of 1 mm past a friction that lets go; 10 us did not."""

Look = Callable[["Rest"], tuple[Any, Array]]
"""Of a point: what the imbalance is asked with there, and whether that is all of it: where something is not looked at is no
rest. (It has no slope, and is left out of what the slope is made of.)"""
Imbalance = Callable[["Rest", Any], "Rest"]
Limit = Callable[[Array, Array], Array]
"""Of positions and a step from there: the share of it that is safe."""


class Rest(NamedTuple):
    """Unknowns of a static solve: generalised positions and clamp reactions."""

    q: Array
    reaction: Array


class Found(NamedTuple):
    """What the search for a rest found: the rest, 1.0 if it is one, else 0.0, and the slope of the imbalance there."""

    rest: Rest
    found: Array
    slope: Array


class _Search(NamedTuple):
    """Carry of the search: the point reached, what is left over there and its slope, and the step to try next."""

    tries: Array
    rest: Rest
    gap: Rest
    slope: Array
    left: Array  # size of the gap
    span2: Array  # s2: squared length of the next step
    allowed: Array  # how far the next step may be off, as a share of `left`
    done: Array


def relaxed(look: Look, imbalance: Imbalance, guess: Rest, inertia: Array, limit: Limit, first: float) -> Found:
    """Pseudo-transient continuation: linearly implicit steps from rest, as long as their linearisation foresees what they
    leave, so that contacts that open and close do not throw the search to and fro; near the rest it ends in Newton's
    method."""

    def carry_on(at: _Search) -> Array:
        return (at.tries < ITERATIONS) & ~at.done

    def improve(at: _Search) -> _Search:
        step = _newton_step(at.slope, at.gap, inertia / at.span2)
        share = limit(at.rest.q, step.q)
        trial = jax.tree.map(lambda r, d: r + share * d, at.rest, step)
        seen, whole = look(trial)
        jacobian, gap = jax.jacfwd(lambda r: (imbalance(r, seen),) * 2, has_aux=True)(trial)
        foreseen = Rest((1.0 - share) * at.gap.q + share * inertia / at.span2 * step.q, (1.0 - share) * at.gap.reaction)
        slope = dense(jacobian)
        noise = _noise(slope, trial, inertia)
        left = jnp.maximum(_size(gap, inertia), noise)
        # A step too short to count, that was not held back, surprises nobody: light bars flicker at a friction that lets go.
        small = 1e-11 if guess.q.dtype == jnp.float64 else 2e-5
        close = jnp.max(jnp.abs(step.q)) < small * (1.0 + jnp.max(jnp.abs(trial.q)))
        off = jnp.maximum(_size(jax.tree.map(jnp.subtract, gap, foreseen), inertia) - noise, 0.0)
        surprise = jnp.where(close & (at.span2 > first), 0.0, off / at.left)
        # What no shorter step would better is taken: clamps that move at once may leave nothing else.
        taken = (surprise <= at.allowed) | (left <= at.left) | (at.span2 <= SHORTEST)
        good = jnp.isfinite(left) & taken
        span2 = _next_span(at, surprise, good, share >= 1.0, left)
        done = good & whole & (share >= 1.0) & close & (at.span2 > 1e2)
        bolder = jnp.minimum(BOLDER * at.allowed, BOLD)
        reached = _Search(at.tries, trial, gap, slope, left, span2, bolder, done)
        stayed = at._replace(span2=span2, allowed=jnp.full_like(at.allowed, WARY))
        return jax.tree.map(lambda a, b: jnp.where(good, a, b), reached, stayed)._replace(tries=at.tries + 1)

    last = lax.while_loop(carry_on, improve, _begun(guess, first))
    return Found(last.rest, last.done.astype(guess.q.dtype), last.slope)


def _size(gap: Rest, inertia: Array) -> Array:
    """Both kinds of imbalance as a displacement: forces as what 1 ms of free motion would make of them."""
    return jnp.max(jnp.abs(gap.q) / inertia) * 1e-6 + jnp.sum(jnp.abs(gap.reaction))


def _noise(slope: Array, at: Rest, inertia: Array) -> Array:
    """Size of the round-off of stiff springs on light bars, which must neither hold steps back nor refuse any. (A few roundings
    each: 8. What lies at 0 is rounded as well, as radii and centres are that place it: 1 mm.)"""
    eps = jnp.finfo(slope.dtype).eps
    return 8.0 * eps * _size(as_rest(product(jnp.abs(slope), 1.0 + jnp.abs(jnp.concatenate(at))), at), inertia)


def _next_span(at: _Search, surprise: Array, good: Array, whole: Array, left: Array) -> Array:
    """s2: what a linearisation leaves out grows as the square of the step; the next one aims at half of what is allowed."""
    tiny = jnp.finfo(left.dtype).tiny
    change = jnp.clip(jnp.sqrt(0.5 * at.allowed / jnp.maximum(surprise, tiny)), 0.1, LONGER)
    change = jnp.minimum(change, jnp.where(good, jnp.where(whole, LONGER, 1.0), 0.5))
    return jnp.clip(jnp.where(jnp.isfinite(left), change, 0.1) * at.span2, SHORTEST, LONGEST)


def _begun(guess: Rest, first: float) -> _Search:
    """A search that has not looked yet: it finds nothing left over, so that its first step stays and looks. (A look outside
    the loop would be compiled again.)"""
    dtype, none = guess.q.dtype, jax.tree.map(jnp.zeros_like, guess)
    slope = -jnp.eye(guess.q.shape[0] + guess.reaction.shape[0], dtype=dtype)
    left, span2, allowed = (jnp.full((), v, dtype) for v in (jnp.inf, first / LONGER, WARY))
    return _Search(jnp.zeros((), jnp.int32), guess, none, slope, left, span2, allowed, jnp.zeros((), bool))


def _newton_step(slope: Array, gap: Rest, shift: Array) -> Rest:
    """Solve (shift - dG/dy) step = G; `shift` acts on positions only."""
    diagonal = jnp.concatenate([shift, jnp.zeros_like(gap.reaction)])
    step = jnp.linalg.solve(jnp.diag(diagonal) - slope, jnp.concatenate([gap.q, gap.reaction]))
    return as_rest(step, gap)


def as_rest(values: Array, like: Rest) -> Rest:
    """One row of unknowns, split as in `like`."""
    n = like.q.shape[0]
    return Rest(values[:n], values[n:])


def dense(jacobian: Any) -> Array:
    """The Jacobian of a `Rest` by a `Rest` as one matrix."""
    return jnp.block([[jacobian.q.q, jacobian.q.reaction], [jacobian.reaction.q, jacobian.reaction.reaction]])
