"""Gradient-safe scalar maths. Each guard says which gradient it saves; tests visit every bad point.

Algebraic forms (square roots, polynomials) wherever a step needs them: cheaper than exp and tanh, and no overflow in float32.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.batching import any_of_batch
from diffeed.base.factor import factor, solve_triangular
from diffeed.base.products import product


def ramp(x: Array, width: Array) -> tuple[Array, Array]:
    """The ramp D(x) and its slope: 0 for x <= 0, x^2/(2 width) up to width, then x - width/2. Shapes of x.

    Zero has compact support, so discarding far pairs is exact. width = 0 gives max(x, 0); the division is made safe
    because its untaken branch would still send NaN into the gradient.
    """
    safe = jnp.where(width > 0, width, 1.0)
    bent = x < width
    value = jnp.where(bent, 0.5 * x * x / safe, x - 0.5 * width)
    slope = jnp.where(bent, x / safe, 1.0)
    touching = x > 0
    return jnp.where(touching, value, 0.0), jnp.where(touching, slope, 0.0)


@jax.custom_jvp
def powers(x: Array, exponents: tuple[Array, ...]) -> tuple[Array, ...]:
    """x^p for x > 0, else 0, for several p. Where every p is 1, 1.5 or 2 (linear springs, spheres, cones, as almost always),
    products and a root give it, else a logarithm and an exponential for each.

    Its derivatives are p x^p / x and x^p log(x), and 0 for x <= 0: saves the gradient of x^p at 0 (infinite for p < 1, NaN
    for traced p).
    """
    shape = jnp.broadcast_shapes(x.shape, *(p.shape for p in exponents))
    base, exponents = jnp.where(x > 0, x, 0.0), tuple(jnp.broadcast_to(p, shape) for p in exponents)
    plain = [(p == 1.0) | (p == 1.5) | (p == 2.0) for p in exponents]
    others = any_of_batch(~jnp.all(jnp.stack([jnp.all(p) for p in plain])))
    return lax.cond(others, _by_logarithm, _by_products, jnp.broadcast_to(base, shape), exponents)


def _by_logarithm(x: Array, exponents: tuple[Array, ...]) -> tuple[Array, ...]:
    positive = x > 0
    log = jnp.log(jnp.where(positive, x, 1.0))
    return tuple(jnp.where(positive, jnp.exp(p * log), 0.0) for p in exponents)


def _by_products(x: Array, exponents: tuple[Array, ...]) -> tuple[Array, ...]:
    root = jnp.sqrt(x)
    return tuple(x * jnp.where(p == 1.0, 1.0, jnp.where(p == 2.0, x, root)) for p in exponents)


@powers.defjvp
def _powers_jvp(
    given: tuple[Array, tuple[Array, ...]], moved: tuple[Array, tuple[Array, ...]]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    (x, exponents), (dx, dps) = given, moved
    values = powers(x, exponents)
    safe = jnp.where(x > 0, x, 1.0)
    change, log = jnp.where(x > 0, dx, 0.0) / safe, jnp.log(safe)
    return values, tuple(v * (p * change + log * dp) for v, p, dp in zip(values, exponents, dps, strict=True))


def power(x: Array, exponent: Array) -> Array:
    """x^exponent for x > 0, else 0."""
    return powers(x, (exponent,))[0]


def divide(a: Array, b: Array) -> Array:
    """a/b, and 0 where b is 0. Saves both gradients of 0/0."""
    zero = b == 0
    return jnp.where(zero, 0.0, a / jnp.where(zero, 1.0, b))


@jax.custom_jvp
def polar(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Length and direction (length, ux, uy) of (x, y). At the origin the direction is (0, 1) and all gradients are 0.

    Its derivative is written out (a move along the direction changes the length, one across it turns): a third of the
    operations of what the square root and two divisions would give.
    """
    square = x * x + y * y
    zero = square == 0
    inverse = 1.0 / jnp.sqrt(jnp.where(zero, 1.0, square))
    return square * inverse, x * inverse, jnp.where(zero, 1.0, y * inverse)


@polar.defjvp
def _polar_jvp(
    given: tuple[Array, Array], moved: tuple[Array, Array]
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    length, ux, uy = polar(*given)
    dx, dy = moved
    zero = length == 0
    along = jnp.where(zero, 0.0, ux * dx + uy * dy)
    turn = jnp.where(zero, 0.0, ux * dy - uy * dx) / jnp.where(zero, 1.0, length)
    return (length, ux, uy), (along, -uy * turn, ux * turn)


def solve_positive(matrix: Array, sides: Array) -> Array:
    """Solve matrix x = sides, (n, n) and (n, k), for a symmetric positive matrix, of which the lower triangle is read."""
    k = sides.shape[1]
    below = jnp.concatenate([sides.T, beside_sides(k, matrix.dtype)], axis=1)
    return solve_bordered(jnp.concatenate([jnp.pad(matrix, ((0, 0), (0, k))), below]), k)


def beside_sides(k: int, dtype: Any) -> Array:
    """(k, k): what stands beside the sides, as last rows of a bordered matrix."""
    return jnp.asarray(0.25 * jnp.finfo(dtype).max * np.eye(k), dtype)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def solve_bordered(whole: Array, k: int) -> Array:
    """The same of a lower triangle whose last k rows are the sides, and `beside_sides`: (n + k, n + k) -> (n, k). For who builds
    the matrix anyway: joining the sides to it afterwards would copy all of it.

    Differentiated as a solution (one more solve with the same factor), not through the factorisation.
    """
    return _factored(whole, k)[1]


def _factored(whole: Array, k: int) -> tuple[Array, Array]:
    """The lower factor of all of it, and the solution. Factored along with the matrix the sides are solved half way, which saves
    a call in every step: what stands beside them is larger than anything taken from it. Its factor is then the right-hand side
    for which the transposed factor answers with minus one there, and above with the solution: nothing needs to be cut out."""
    n = whole.shape[0] - k
    root = factor(whole)
    right = jnp.pad(-root[n:, n:].T, ((n, 0), (0, 0)))
    return root, solve_triangular(root, right, transposed=True)[:n]


@solve_bordered.defjvp
def _solve_bordered_jvp(k: int, given: tuple[Array], moved: tuple[Array]) -> tuple[Array, Array]:
    n, (change,) = given[0].shape[0] - k, moved
    root, x = _factored(given[0], k)
    root, change, more = root[:n, :n], change[:n, :n], change[n:, :n].T
    right = more - product(jnp.tril(change) + jnp.tril(change, -1).T, x)
    return x, solve_triangular(root, solve_triangular(root, right), transposed=True)


def step_down(x: Array, half_width: float) -> Array:
    """1 below -half_width, 0 above +half_width, a cubic between; step_down(x) + step_down(-x) = 1."""
    u = jnp.clip(0.5 - 0.5 * x / half_width, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def soft_max(x: Array, axis: int, width: float) -> Array:
    """Largest entry along an axis, smoothed over `width` (in the unit of x); at most width*log(n) above the maximum."""
    return width * jax.nn.logsumexp(x / width, axis=axis)
