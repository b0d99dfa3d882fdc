"""Cosine and sine together: by the library, or by sums and products where loops of these are cheap.

There a library is called for every number by itself; a sixteenth of a batch went into the headings of twenty bars
(film feeder: script). Reduced to the nearest quarter turn in three parts (Cody and Waite), then by the polynomials of fdlibm's
`__kernel_cos` and `__kernel_sin` (double precision) or Cephes' `cosf` and `sinf` (single): at most one and a half units in the
last place off up to 1e5 rad (single: 100); where an angle is known to no fraction of a turn, of no meaning, but not above 1.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.one_kernel import loops_are_cheap

PARTS = {
    "float64": (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    "float32": (1.5703125, 4.837512969970703125e-4, 7.549789948768648e-8),
}
"""A quarter turn; the first ones have so few digits that whole multiples are exact."""
OF_COSINE = {
    "float64": (
        4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
        -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
    ),
    "float32": (4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5),
}  # fmt: skip
OF_SINE = {
    "float64": (
        -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
        2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
    ),
    "float32": (-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4),
}  # fmt: skip
"""Coefficients of z = x^2 within an eighth turn: cos x = 1 - z/2 + z^2 P(z), sin x = x + x z Q(z)."""


def cos_sin(angle: Array) -> tuple[Array, Array]:
    """Both of an angle in rad, of its shape."""
    return _by_polynomials(angle) if loops_are_cheap() else (jnp.cos(angle), jnp.sin(angle))


@jax.custom_jvp
def _by_polynomials(angle: Array) -> tuple[Array, Array]:
    kind = angle.dtype.name
    quarters = jnp.round(angle * (2.0 / math.pi))
    rest = angle
    for part in PARTS[kind]:
        rest = rest - quarters * _of(part, kind)
    rest = jnp.clip(rest, -1.0, 1.0)  # of an angle that has lost its fraction: what comes is as far as a cosine may be
    z = rest * rest
    half = 0.5 * z
    most = 1.0 - half
    c = most + (((1.0 - most) - half) + z * z * _polynomial(OF_COSINE[kind], z, kind))
    s = rest + rest * z * _polynomial(OF_SINE[kind], z, kind)
    turn = quarters - 4.0 * jnp.floor(0.25 * quarters)  # 0, 1, 2 or 3
    odd = (turn == 1.0) | (turn == 3.0)
    c, s = jnp.where(odd, s, c), jnp.where(odd, c, s)
    return jnp.where((turn == 1.0) | (turn == 2.0), -c, c), jnp.where(turn >= 2.0, -s, s)


@_by_polynomials.defjvp
def _by_polynomials_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    c, s = _by_polynomials(*primals)
    (turned,) = tangents
    return (c, s), (-s * turned, c * turned)


def _polynomial(coefficients: tuple[float, ...], z: Array, kind: str) -> Any:
    total = _of(coefficients[-1], kind)
    for coefficient in reversed(coefficients[:-1]):
        total = total * z + _of(coefficient, kind)
    return total


def _of(number: float, kind: str) -> np.ndarray:
    return np.asarray(number, kind)
