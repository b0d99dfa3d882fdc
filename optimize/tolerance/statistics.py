"""What a sample of runs says: proportions, percentiles, capability, and which input the scatter comes from.

n runs, d inputs. Every estimate carries its own uncertainty; intervals are two-sided at `level`.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

EDGE = 0.1
"""How much of a uniform input's range, at each end and of the half width, stands for its edge in `yield_slope`."""
COUNTS = 40
"""Points of a convergence curve."""
BITS = 30
"""Binary digits of a Sobol point."""


class Estimate(NamedTuple):
    """A value and the ends of its confidence interval, of one unit."""

    value: float
    low: float
    high: float


class Capability(NamedTuple):
    """None where the limits that it needs are not given."""

    cp: float | None
    cpk: float | None


class Convergence(NamedTuple):
    """(m,) each: over the first `counts` runs."""

    counts: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Shares(NamedTuple):
    """`shares` (d,) of the variance; `explained`: R^2 of the fit."""

    shares: np.ndarray
    explained: float


class Variance(NamedTuple):
    """`variance` in the measure's unit squared, `shares` (d,) of it."""

    variance: float
    shares: np.ndarray


class DerivativeMeasure(NamedTuple):
    """(d,) each: `value` in the measure's unit squared, `shares` of the sum of the values."""

    value: np.ndarray
    shares: np.ndarray


class Indices(NamedTuple):
    """(d,) each, as a share of the variance."""

    first: np.ndarray
    first_low: np.ndarray
    first_high: np.ndarray
    total: np.ndarray
    total_low: np.ndarray
    total_high: np.ndarray
    points: int  # of which all runs have a value


class Sample(NamedTuple):
    """Uniforms in (0, 1): `a` and `b` (n, d), `ab` (d, n, d)."""

    a: np.ndarray
    b: np.ndarray
    ab: np.ndarray


class Slope(NamedTuple):
    """`error`: standard error. Both per unit of the scale."""

    value: float
    error: float


def proportion(failures: int, runs: int, level: float = 0.95) -> Estimate:
    """Failures over runs, with the exact interval of Clopper and Pearson (1934); nan in [0, 1] without runs.

    ValueError for more failures than runs, or fewer than none.
    """
    if not 0 <= failures <= runs:
        raise ValueError(
            f"failures must not be greater than the number of runs, {runs}, nor negative, but are {failures}"
        )
    if runs == 0:
        return Estimate(math.nan, 0.0, 1.0)
    low, high = exact_interval(failures, runs, level)
    return Estimate(failures / runs, float(low), float(high))


def exact_interval(counts: Any, runs: int, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the interval of Clopper and Pearson (1934) for each of several counts out of so many runs."""
    k, tail = np.asarray(counts), 0.5 * (1.0 - level)
    low = np.where(k > 0, stats.beta.ppf(tail, np.maximum(k, 1), runs - k + 1), 0.0)
    return low, np.where(k < runs, stats.beta.ppf(1.0 - tail, k + 1, np.maximum(runs - k, 1)), 1.0)


def percentile(values: Any, share: float, level: float = 0.95) -> Estimate:
    """The value below which `share` (0 to 1, exclusive) of the population lies; values (n,), infinite ones included.

    The interval lies between order statistics, exact whatever the distribution (Thompson 1936); an end for which there
    are too few values is infinite. ValueError for no values, NaN among them, or a share out of range.
    """
    values = np.asarray(values, dtype=float)
    if values.size == 0 or np.isnan(values).any():
        raise ValueError("a percentile needs at least one value, and no NaN")
    with np.errstate(invalid="ignore"):
        value = np.quantile(values, share)
    if np.isnan(value):  # inf - inf, at one of the values or between two infinite ones: nothing to interpolate
        value = np.quantile(values, share, method="nearest")
    low, high = stats.quantile_test(values, p=share).confidence_interval(level)
    return Estimate(
        float(value), -math.inf if np.isnan(low) else float(low), math.inf if np.isnan(high) else float(high)
    )


def capability(values: Any, low: float | None, high: float | None) -> Capability:
    """Process capability (Kane 1986) of values (n,): Cp = (high - low)/(6 s); Cpk = the nearer limit's distance from
    the mean over 3 s.

    nan for fewer than two values or any that is not finite; infinite for values that are all the same.
    """
    values = np.asarray(values, dtype=float)
    known = values.size > 1 and bool(np.isfinite(values).all())
    mean, deviation = (values.mean(), values.std(ddof=1)) if known else (math.nan, math.nan)
    if known and np.ptp(values) == 0.0:
        mean, deviation = values[0], 0.0  # not what rounding makes of it
    room = [high - mean] if high is not None else []
    room += [mean - low] if low is not None else []
    with np.errstate(divide="ignore", invalid="ignore"):
        cp = float(np.divide(high - low, 6.0 * deviation)) if low is not None and high is not None else None
        cpk = float(np.divide(min(room), 3.0 * deviation)) if room else None
    return Capability(cp, cpk)


def convergence(failed: Any, level: float = 0.95) -> Convergence:
    """The proportion that failed (n,) over the first runs, at about `COUNTS` logarithmically spaced counts up to n."""
    total = np.cumsum(np.asarray(failed, dtype=bool))
    if total.size == 0:
        return Convergence(np.zeros(0, int), *np.zeros((3, 0)))
    counts = np.unique(np.round(np.geomspace(1, total.size, COUNTS)).astype(int))
    return Convergence(counts, *np.array([proportion(int(total[c - 1]), int(c), level) for c in counts]).T)


def regression_shares(z: Any, y: Any, correlation: Any = None) -> Shares:
    """Each input's share of Var(y), z (n, d) and y (n,), by linear regression.

    With y = c + b z, Var(y) = sum_i (b_i s_i) sum_j R_ij (b_j s_j) + what the fit leaves over: the squared standardised
    coefficients for independent inputs (Saltelli et al. 2008, Global Sensitivity Analysis, 1.2.5); with their `correlation`
    R (d, d), an input has its own part and half of what it shares with each of the others. Runs with values that are not
    finite are left out; nan unless more than d + 1 remain; zeros, and R^2 nan, for a constant y.
    """
    z, y = np.asarray(z, dtype=float), np.asarray(y, dtype=float)
    kept = np.isfinite(y) & np.isfinite(z).all(axis=1)
    z, y = z[kept], y[kept]
    n, d = z.shape
    if n <= d + 1:
        return Shares(np.full(d, math.nan), math.nan)
    if np.ptp(y) == 0.0:
        return Shares(np.zeros(d), math.nan)
    z, y = z - z.mean(axis=0), y - y.mean()
    spread = np.sqrt(np.mean(z**2, axis=0))
    z = z / np.where(spread > 0.0, spread, 1.0)  # alike in size, whatever their units; an input that is fixed stays 0
    slope, *_ = np.linalg.lstsq(z, y)
    variance = np.mean(y**2)
    return Shares(_parts(slope, correlation) / variance, float(1.0 - np.mean((y - z @ slope) ** 2) / variance))


def linear_shares(gradient: Any, sigma: Any, correlation: Any = None) -> Variance:
    """First-order variance sum_ij (g_i s_i) R_ij (g_j s_j) from the gradient (d,), the inputs' deviations (d,) and their
    `correlation` (none if not given), and each one's share. Shares are zero where the variance is."""
    parts = _parts(np.asarray(gradient, dtype=float) * np.asarray(sigma, dtype=float), correlation)
    return Variance(float(parts.sum()), _share(parts))


def derivative_measure(gradients: Any, sigma: Any) -> DerivativeMeasure:
    """s_i^2 E[g_i^2] from gradients (n, d) and deviations (d,): the derivative-based global sensitivity measure (Sobol
    and Kucherenko 2009, Math. Comput. Simul. 79, 3009), over the runs whose gradients are finite; nan without any.

    For normal inputs it bounds the variance in which the input takes part, Var(y) times its total index, from above.
    """
    gradients = np.asarray(gradients, dtype=float)
    gradients = gradients[np.isfinite(gradients).all(axis=1)]
    if not len(gradients):
        nothing = np.full(gradients.shape[1], math.nan)
        return DerivativeMeasure(nothing, nothing)
    value = np.asarray(sigma, dtype=float) ** 2 * np.mean(gradients**2, axis=0)
    return DerivativeMeasure(value, _share(value))


def _parts(effect: np.ndarray, correlation: Any) -> np.ndarray:
    """(d,) what each input adds to the variance, its effect being slope times deviation."""
    return effect**2 if correlation is None else effect * (np.asarray(correlation, dtype=float) @ effect)


def _share(parts: np.ndarray) -> np.ndarray:
    whole = parts.sum()
    return np.zeros_like(parts) if whole == 0.0 else parts / whole


def saltelli(n: int, d: int, seed: int) -> Sample:
    """Points for `sobol`: two independent halves of a scrambled Sobol sequence, and ab[i] = a with column i from b.

    Saltelli et al. 2010, Comput. Phys. Commun. 181, 259. ValueError unless n is a power of two.
    """
    if n < 1 or n & (n - 1):
        raise ValueError(f"n must be a power of two, for the balance of Sobol points; it is {n}")
    sequence = stats.qmc.Sobol(2 * d, bits=BITS, rng=seed)
    # The points are multiples of 2^-BITS, 0 among them, where a normal quantile is infinite: move to the cells' middle.
    points = sequence.random(n) + 0.5 ** (BITS + 1)
    a, b = points[:, :d], points[:, d:]
    ab = np.tile(a, (d, 1, 1))
    ab[range(d), :, range(d)] = b.T
    return Sample(a, b, ab)


def sobol(f_a: Any, f_b: Any, f_ab: Any, seed: int, level: float = 0.95) -> Indices:
    """First and total Sobol indices from the measure at `saltelli`'s points: f_a and f_b (n,), f_ab (d, n).

    The estimators of Saltelli et al. 2010 and of Jansen 1999. A point counts if all its d + 2 values are finite: one that were
    filled in would count as a change that its input made. Intervals from resampling the points; they take them as
    independent, and so are wide for a smooth measure. nan for fewer than two points, zeros for a constant measure; ValueError
    for other shapes.
    """
    f_a, f_b, f_ab = (np.asarray(f, dtype=float) for f in (f_a, f_b, f_ab))
    d, n = f_ab.shape
    if f_a.shape != (n,) or f_b.shape != (n,):
        raise ValueError(f"f_a and f_b must be ({n},) as f_ab is {f_ab.shape}; they are {f_a.shape} and {f_b.shape}")
    whole = np.isfinite(f_a) & np.isfinite(f_b) & np.isfinite(f_ab).all(axis=0)
    f_a, f_b, f_ab, n = f_a[whole], f_b[whole], f_ab[:, whole], int(whole.sum())
    if n < 2:
        none = np.full(d, math.nan)
        return Indices(none, none, none, none, none, none, n)

    # SciPy's own `sobol_indices` takes whole powers of two alone; the same estimators (a test holds them against it).
    def both(drawn: np.ndarray, axis: int = -1) -> np.ndarray:  # (..., n) points -> (2, d, ...)
        a, b, ab = f_a[drawn], f_b[drawn], f_ab[:, drawn]
        halves = np.concatenate([a, b], axis=-1)
        variance, mean = np.var(halves, axis=-1), np.mean(halves, axis=-1, keepdims=True)
        first, total = np.mean((b - mean) * (ab - a), axis=-1), 0.5 * np.mean((a - ab) ** 2, axis=-1)
        flat = np.ptp(halves, axis=-1) == 0
        return np.where(flat, 0.0, np.stack([first, total]) / np.where(flat, 1.0, variance))

    points = np.arange(n)
    first, total = both(points)
    # The result's own `bootstrap` takes no seed; this is the same one, by percentiles.
    resampled = stats.bootstrap(
        (points,), both, confidence_level=level, method="percentile", vectorized=True, batch=32, rng=seed
    )
    (first_low, total_low), (first_high, total_high) = resampled.confidence_interval
    return Indices(first, first_low, first_high, total, total_low, total_high, n)


def normal_slope(passed: Any, epsilon: Any, correlation: Any, members: Any) -> Slope:
    """s dP(pass)/ds for the common scale s of some of the normal inputs, epsilon (n, d) with `correlation` R (d, d).

    The density of x = s eps has d log p/d log s_i = eps_i (R^-1 eps)_i - 1, summed over the `members`; its mean is 0, so that
    h - E[h] serves as well as h and scatters less. Inputs of other kinds may be among the d: then eps is the normal number
    behind them. Where R is singular (inputs that are one) its pseudo-inverse serves; nan if they are not all members, for no
    sample has one scaled without the other.
    """
    h, eps, r = (np.asarray(v, dtype=float) for v in (passed, epsilon, correlation))
    if h.size < 2:
        return Slope(math.nan, math.nan)
    inverse = np.linalg.pinv(r, hermitian=True)
    scaled = np.zeros_like(r)
    scaled[members] = r[members]
    if not np.allclose(r @ inverse @ scaled, scaled):
        return Slope(math.nan, math.nan)
    score = eps * (eps @ inverse) - np.diag(inverse @ r)
    terms = (h - h.mean()) * score[:, members].sum(axis=1)
    return Slope(float(terms.mean()), float(stats.sem(terms)))


def yield_slope(passed: Any, epsilon: Any, family: str, scale: float) -> Slope:
    """d P(pass)/d scale from the same runs, passed (n,) at epsilon (n,), for an input x = nominal + scale epsilon.

    "normal" (scale: sigma): see `normal_slope`.
    "uniform" (scale: half width, |eps| <= 1): P = (1/2s) int_-s^s h dt, so dP/ds = (-E[h] + (E[h|1] + E[h|-1])/2)/s,
    with the edges' values from |eps| > 1 - EDGE (a bias, not in `error`, if h changes there), and E[h] as the mean of the
    edges and the middle M, weighted by their known probabilities: (1 - EDGE) ((E[h|1] + E[h|-1])/2 - E[h|M])/s.

    nan for other families, and for too few runs (two; for "uniform", at either edge and in the middle). If all passed or
    all failed, both are 0: such runs show no slope, which does not prove that there is none.
    """
    h, eps = np.asarray(passed, dtype=float), np.asarray(epsilon, dtype=float)
    if not scale > 0.0:
        return Slope(math.nan, math.nan)
    if family == "normal":
        found = normal_slope(h, eps[:, None], np.ones((1, 1)), [0])
        return Slope(found.value / scale, found.error / scale)
    if family == "uniform":
        left, right = eps < EDGE - 1.0, eps > 1.0 - EDGE
        bands = [h[left], h[right], h[~left & ~right]]
        if min(band.size for band in bands) > 1:
            weights = np.array([0.5, 0.5, -1.0]) * (1.0 - EDGE) / scale
            means, errors = np.array([(band.mean(), stats.sem(band)) for band in bands]).T
            return Slope(float(weights @ means), float(np.linalg.norm(weights * errors)))
    return Slope(math.nan, math.nan)
