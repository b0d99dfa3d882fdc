"""Gradient-safe scalar maths. Each guard says which gradient it saves; tests visit every bad point.

Algebraic forms only (square roots, polynomials): cheaper than exp and tanh, and no overflow in float32.
"""

import jax
import jax.numpy as jnp
from jax import Array, lax

ROOT_STEPS = 3
"""Steps of Newton's method for a root of a cubic: from the chord, round-off on pieces that bend by up to half a radian."""


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


def powers(x: Array, exponents: tuple[Array, ...]) -> tuple[Array, ...]:
    """x^p for x > 0, else 0, for several p at the price of one logarithm.

    Saves the gradient of x^p at 0 (infinite for p < 1, NaN for traced p).
    """
    positive = x > 0
    log = jnp.log(jnp.where(positive, x, 1.0))
    return tuple(jnp.where(positive, jnp.exp(p * log), 0.0) for p in exponents)


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


@jax.custom_jvp
def cubic_root(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Where a + b u + c u^2 + d u^3 goes from negative to positive within [0, 1]; 0 where it is positive at both ends, 1
    where negative at both.

    Newton's method from the chord between the ends, kept in the bracket by bisection. The derivative is
    that of the root by the implicit-function theorem, and 0 at the ends: the iterations never see a tangent.
    """
    end = a + b + c + d
    low, high = jnp.minimum(a, 0.0), jnp.maximum(end, 0.0)
    u = divide(-low, high - low)
    left, right = jnp.zeros_like(u), jnp.ones_like(u)
    for _ in range(ROOT_STEPS):
        value, slope = _cubic(a, b, c, d, u)
        left, right = jnp.where(value < 0, u, left), jnp.where(value < 0, right, u)
        step = u - divide(value, slope)
        u = jnp.where((slope > 0) & (step >= left) & (step <= right), step, 0.5 * (left + right))
    return jnp.where(end <= 0, 1.0, jnp.where(a >= 0, 0.0, u))


def _cubic(a: Array, b: Array, c: Array, d: Array, u: Array) -> tuple[Array, Array]:
    return a + u * (b + u * (c + u * d)), b + u * (2.0 * c + u * 3.0 * d)


@cubic_root.defjvp
def _cubic_root_jvp(given: tuple[Array, ...], moved: tuple[Array, ...]) -> tuple[Array, Array]:
    a, b, c, d = given
    u = cubic_root(a, b, c, d)
    slope = _cubic(a, b, c, d, u)[1]
    free = (u > 0) & (u < 1) & (slope > 0)
    da, db, dc, dd = moved
    return u, -jnp.where(free, da + u * (db + u * (dc + u * dd)), 0.0) / jnp.where(free, slope, 1.0)


def solve_positive(matrix: Array, sides: Array) -> Array:
    """Solve matrix x = sides, (n, n) and (n, k), for a symmetric positive matrix.

    Differentiated as a solution (one more solve with the same factor), not through the factorisation.
    """
    root = lax.linalg.cholesky(lax.stop_gradient(matrix), symmetrize_input=False)

    def solve(_: object, rhs: Array) -> Array:
        half = lax.linalg.triangular_solve(root, rhs, left_side=True, lower=True)
        return lax.linalg.triangular_solve(root, half, left_side=True, lower=True, transpose_a=True)

    return lax.custom_linear_solve(lambda x: matrix @ x, sides, solve, symmetric=True)


def step_down(x: Array, half_width: float) -> Array:
    """1 below -half_width, 0 above +half_width, a cubic between; step_down(x) + step_down(-x) = 1."""
    u = jnp.clip(0.5 - 0.5 * x / half_width, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def soft_max(x: Array, axis: int, width: float) -> Array:
    """Largest entry along an axis, smoothed over `width` (in the unit of x); at most width*log(n) above the maximum."""
    return width * jax.nn.logsumexp(x / width, axis=axis)
