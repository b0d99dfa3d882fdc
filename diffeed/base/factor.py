"""Triangular factors of positive matrices: by the library, or in loops where those are cheap and the matrix is small."""

import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.one_kernel import loops_are_cheap
from diffeed.base.places import PLACE

SMALL = 32
"""Rows up to which loops, where they are cheap, beat a call of the library, which no kernel of a whole run may have: 27 rows take
half of the time, 57 rows twice as much (`diffeed bench growth`: movable pinches)."""


def factor(matrix: Array) -> Array:
    """(n, n) of which the lower triangle is read -> its lower factor, above which all is zero."""
    if matrix.shape[0] > SMALL or not loops_are_cheap():
        return lax.linalg.cholesky(matrix, symmetrize_input=False)
    return _in_a_loop(matrix)


def solve_triangular(lower: Array, right: Array, transposed: bool = False) -> Array:
    """(n, n) and (n, k): what lower x = right, or its transpose, has as x."""
    if lower.shape[0] > SMALL or not loops_are_cheap():
        return lax.linalg.triangular_solve(lower, right, left_side=True, lower=True, transpose_a=transposed)
    return _row_by_row(lower, right, transposed)


def _in_a_loop(matrix: Array) -> Array:
    """Column by column: each takes its square from all that is behind it."""

    def column(left: Array, j: Array) -> tuple[Array, Array]:
        own = lax.dynamic_index_in_dim(left, j, axis=1, keepdims=False)
        own = own / jnp.sqrt(lax.dynamic_index_in_dim(own, j, keepdims=False))
        return left - own[:, None] * own[None, :], own

    # What stands above in a column changes nothing below it, and is left out at the end: in each turn that would take longer.
    return jnp.tril(lax.scan(column, matrix, jnp.arange(matrix.shape[0], dtype=PLACE))[1].T)


def _row_by_row(lower: Array, right: Array, transposed: bool) -> Array:
    columns = lower if transposed else lower.T  # each row of it is what one unknown has in all equations

    def unknown(left: Array, given: tuple[Array, Array]) -> tuple[Array, Array]:
        j, has = given
        x = lax.dynamic_index_in_dim(left, j, keepdims=False) / lax.dynamic_index_in_dim(has, j, keepdims=False)
        return left - has[:, None] * x[None, :], x

    place = jnp.arange(lower.shape[0], dtype=PLACE)
    return lax.scan(unknown, right, (place, columns), reverse=transposed)[1]
