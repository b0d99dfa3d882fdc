"""Statistics of a sample of runs: exact intervals, known variances, slopes in closed form."""

import math

import numpy as np
import pytest
from scipy import stats

from optimize.tolerance import statistics


def test_proportion_of_no_failures_has_the_closed_form():
    for n in (1, 10, 300):
        value, low, high = statistics.proportion(0, n)
        assert (value, low) == (0.0, 0.0)
        assert high == pytest.approx(1.0 - 0.025 ** (1.0 / n), rel=1e-9)
        mirrored = statistics.proportion(n, n)
        assert mirrored == pytest.approx((1.0, 1.0 - high, 1.0), rel=1e-9)


def test_proportion_solves_its_tails():
    value, low, high = statistics.proportion(7, 50, level=0.9)
    assert value == 0.14
    assert stats.binom.sf(6, 50, low) == pytest.approx(0.05, rel=1e-6)
    assert stats.binom.cdf(7, 50, high) == pytest.approx(0.05, rel=1e-6)


def test_proportion_without_runs_is_unknown():
    value, low, high = statistics.proportion(0, 0)
    assert math.isnan(value)
    assert (low, high) == (0.0, 1.0)
    with pytest.raises(ValueError, match="not be greater"):
        statistics.proportion(3, 2)


@pytest.mark.parametrize("p", [0.01, 0.2])
def test_proportion_covers(p):
    runs, repeats = 200, 4000
    failures = np.random.default_rng(1).binomial(runs, p, repeats)
    intervals = {k: statistics.proportion(int(k), runs) for k in np.unique(failures)}
    covered = np.mean([intervals[k].low <= p <= intervals[k].high for k in failures])
    assert 0.95 <= covered < 0.99


@pytest.mark.parametrize(("share", "n"), [(0.5, 40), (0.95, 200), (0.95, 20)])
def test_percentile_covers(share, n):
    truth = stats.gumbel_r.ppf(share)
    draws = stats.gumbel_r.rvs(size=(1200, n), random_state=2)
    estimates = [statistics.percentile(row, share) for row in draws]
    covered = np.mean([e.low <= truth <= e.high for e in estimates])
    assert 0.95 <= covered < 0.99
    assert all(e.low <= e.value <= e.high for e in estimates)


def test_percentile_takes_infinite_values():
    values = np.arange(1.0, 201.0)
    finite = statistics.percentile(values, 0.5)
    assert finite.value == 100.5
    values[-20:] = math.inf  # never arrived
    assert statistics.percentile(values[::-1], 0.5) == finite
    value, low, high = statistics.percentile(values, 0.95)
    assert (value, high) == (math.inf, math.inf)
    assert low == math.inf
    value, low, high = statistics.percentile(values, 0.9)
    assert value == math.inf
    assert low < 180.0
    assert high == math.inf


def test_percentile_at_a_value_ignores_an_infinite_next():
    for count in range(2, 40):
        values = np.append(np.arange(float(count)), math.inf)
        assert statistics.percentile(values, (count - 1) / count).value == pytest.approx(count - 1.0)


def test_percentile_of_too_few_values_is_open():
    assert statistics.percentile([3.0], 0.95) == (3.0, -math.inf, math.inf)


@pytest.mark.parametrize("values", [[], [1.0, math.nan]])
def test_percentile_refuses(values):
    with pytest.raises(ValueError, match="at least one value, and no NaN"):
        statistics.percentile(values, 0.5)


def test_capability_of_known_numbers():
    values = [9.0, 10.0, 11.0]  # mean 10, s = 1
    assert statistics.capability(values, 4.0, 13.0) == pytest.approx((1.5, 1.0))
    assert statistics.capability(values, 7.0, 16.0) == pytest.approx((1.5, 1.0))
    assert statistics.capability(values, None, 16.0) == (None, pytest.approx(2.0))
    assert statistics.capability(values, 11.5, None) == (None, pytest.approx(-0.5))
    assert statistics.capability(values, None, None) == (None, None)


def test_capability_without_spread_or_knowledge():
    assert statistics.capability([0.1, 0.1, 0.1], 0.0, 1.0) == (math.inf, math.inf)
    assert statistics.capability([0.1, 0.1, 0.1], 0.2, 1.0) == (math.inf, -math.inf)
    for values in ([1.0, math.inf], [1.0, math.nan], [1.0], []):
        cp, cpk = statistics.capability(values, 0.0, None)
        assert cp is None
        assert cpk is not None
        assert math.isnan(cpk)
        assert np.isnan(np.array(statistics.capability(values, 0.0, 2.0), dtype=float)).all()


def test_convergence_ends_at_the_whole():
    failed = np.random.default_rng(3).random(5000) < 0.07
    counts, value, low, high = statistics.convergence(failed)
    assert 30 <= len(counts) <= 40
    assert (np.diff(counts) > 0).all()
    assert (counts[0], counts[-1]) == (1, 5000)
    assert (value[-1], low[-1], high[-1]) == statistics.proportion(int(failed.sum()), 5000)
    np.testing.assert_allclose(value, [failed[:c].mean() for c in counts])
    steps = np.diff(np.log(counts[counts > 100]))
    assert np.ptp(steps) < 0.02
    assert [len(part) for part in statistics.convergence([])] == [0, 0, 0, 0]


SLOPES = np.array([2.0, -1.0, 0.5, 0.0])
SIGMA = np.array([0.1, 1.0, 3.0, 2.0])
PARTS = (SLOPES * SIGMA) ** 2


def _orthogonal(n: int) -> np.ndarray:
    """Normal inputs (n, 4), made uncorrelated and of deviation SIGMA within the sample."""
    z = np.random.default_rng(4).normal(size=(n, len(SIGMA)))
    q, _ = np.linalg.qr(z - z.mean(axis=0))
    return q * math.sqrt(n) * SIGMA


def test_shares_of_a_linear_measure_are_exact():
    z = 5.0 + _orthogonal(64)
    shares, explained = statistics.regression_shares(z, 3.0 + z @ SLOPES)
    np.testing.assert_allclose(shares, PARTS / PARTS.sum(), atol=1e-12)
    assert explained == pytest.approx(1.0, abs=1e-12)
    variance, linear = statistics.linear_shares(SLOPES, SIGMA)
    assert variance == pytest.approx(PARTS.sum())
    np.testing.assert_allclose(linear, shares, atol=1e-12)
    value, derivative = statistics.derivative_measure(np.tile(SLOPES, (5, 1)), SIGMA)
    np.testing.assert_allclose(value, PARTS)
    np.testing.assert_allclose(derivative, shares, atol=1e-12)


def test_regression_leaves_the_rest_unexplained():
    n = 40_000
    rng = np.random.default_rng(5)
    z = rng.normal(size=(n, 4)) * SIGMA
    y = z @ SLOPES + rng.normal(size=n)
    shares, explained = statistics.regression_shares(z, y)
    np.testing.assert_allclose(shares, PARTS / (PARTS.sum() + 1.0), atol=0.015)
    assert explained == pytest.approx(PARTS.sum() / (PARTS.sum() + 1.0), abs=0.015)


def test_regression_leaves_out_what_is_not_finite():
    z = _orthogonal(64)
    y = z @ SLOPES
    whole = statistics.regression_shares(z, y)
    z, y = np.vstack([z, z[:2]]), np.append(y, [math.inf, math.nan])
    np.testing.assert_array_equal(statistics.regression_shares(z, y).shares, whole.shares)


def test_regression_of_too_few_or_of_nothing():
    z = _orthogonal(64)
    shares, explained = statistics.regression_shares(z[:5], z[:5] @ SLOPES)
    assert np.isnan(shares).all()
    assert shares.shape == (4,)
    assert math.isnan(explained)
    assert statistics.regression_shares(z[:6], z[:6] @ SLOPES).explained == pytest.approx(1.0)
    shares, explained = statistics.regression_shares(z, np.full(64, 0.1))
    assert not shares.any()
    assert math.isnan(explained)
    z[:, 1] = 7.0  # an input that is held
    held = statistics.regression_shares(z, z @ SLOPES).shares[1]
    np.testing.assert_allclose(held, 0.0, atol=1e-20)  # the square of a rounding error of its mean


def test_linear_shares_of_no_variance_are_zero():
    variance, shares = statistics.linear_shares(np.zeros(3), np.ones(3))
    assert variance == 0.0
    assert not shares.any()


def test_derivative_measure_is_the_mean_square_of_finite_rows():
    gradients = np.array([[1.0, 2.0], [3.0, 0.0], [math.nan, 9.0], [1.0, math.inf]])
    value, shares = statistics.derivative_measure(gradients, [2.0, 1.0])
    np.testing.assert_allclose(value, [20.0, 2.0])
    np.testing.assert_allclose(shares, [10.0 / 11.0, 1.0 / 11.0])
    assert np.isnan(statistics.derivative_measure(gradients[2:], [2.0, 1.0])).all()


def _ishigami(u: np.ndarray) -> np.ndarray:
    x = math.pi * (2.0 * u - 1.0)
    return np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])


def test_sobol_indices_of_ishigami():
    """Ishigami and Homma 1990: V1 = (1 + b pi^4/5)^2/2, V2 = a^2/8, V13 = 8 b^2 pi^8/225, the rest is nil."""
    first = np.array([0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 49.0 / 8.0, 0.0])
    both = 8.0 * 0.01 * math.pi**8 / 225.0
    variance = first.sum() + both
    first, total = first / variance, (first + np.array([both, 0.0, both])) / variance
    a, b, ab = statistics.saltelli(2048, 3, seed=6)
    found = statistics.sobol(_ishigami(a), _ishigami(b), _ishigami(ab), seed=7)
    np.testing.assert_allclose(found.first, first, atol=0.03)
    np.testing.assert_allclose(found.total, total, atol=0.03)
    for value, low, high, truth in (
        (found.first, found.first_low, found.first_high, first),
        (found.total, found.total_low, found.total_high, total),
    ):
        assert (low <= truth).all()
        assert (truth <= high).all()
        assert (low <= value).all()
        assert (value <= high).all()
        assert (high - low < 0.25).all()
        assert (high - low > 0.005).all()


@pytest.mark.long
def test_sobol_intervals_cover_independent_points():
    """y = z0 + 2 z1 with normal inputs, points drawn independently: shares 0.2 and 0.8, first and total alike."""
    rng = np.random.default_rng(8)
    weights, truth = np.array([1.0, 2.0]), np.array([0.2, 0.8])
    inside = []
    for seed in range(40):
        a, b = rng.normal(size=(2, 128, 2))
        ab = np.stack([np.where(np.arange(2) == i, b, a) for i in range(2)])
        found = statistics.sobol(a @ weights, b @ weights, ab @ weights, seed)
        inside.append([found.first_low <= truth, truth <= found.first_high])
        inside.append([found.total_low <= truth, truth <= found.total_high])
    assert 0.96 <= np.mean(inside) <= 0.99  # 0.975 on either side


@pytest.mark.long
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_runs_that_fail_give_no_input_a_share(share):
    """The measure follows the first input alone, at random some runs fail: filled in, those would count for the second."""
    a, b, ab = statistics.saltelli(4096, 2, seed=0)
    failed = np.random.default_rng(1).random((4, 4096)) < share
    f_a, f_b, *f_ab = (np.where(f, math.nan, stats.norm.ppf(u[:, 0])) for f, u in zip(failed, (a, b, *ab), strict=True))
    found = statistics.sobol(f_a, f_b, np.array(f_ab), seed=2)
    np.testing.assert_allclose(found.first, [1.0, 0.0], atol=0.06)
    np.testing.assert_allclose(found.total, [1.0, 0.0], atol=0.06)
    assert np.all((found.total_low <= [1.0, 0.0]) & (found.total_high >= [1.0, 0.0]))
    assert found.points == np.sum(~failed.any(axis=0))
    if not share:
        given = {"f_A": f_a[None], "f_B": f_b[None], "f_AB": np.array(f_ab)[:, None]}
        theirs = stats.sobol_indices(func=given, n=4096)
        np.testing.assert_allclose(found.first, theirs.first_order.ravel(), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.total, theirs.total_order.ravel(), rtol=1e-9, atol=1e-12)


def test_sobol_of_one_input_of_a_constant_and_of_a_failed_run():
    a, b, ab = statistics.saltelli(256, 1, seed=9)
    alone = statistics.sobol(a[:, 0], b[:, 0], ab[..., 0], seed=1)
    np.testing.assert_allclose([alone.first, alone.total], 1.0, atol=0.02)
    assert alone.first_low.shape == (1,)
    again = [statistics.sobol(a[:, 0], b[:, 0], ab[..., 0], seed) for seed in (1, 2)]
    np.testing.assert_array_equal(again[0][:-1], alone[:-1])
    assert again[1].first_low != alone.first_low
    f = np.full(16, 0.1)
    assert not np.any(statistics.sobol(f, f, np.tile(f, (3, 1)), seed=1)[:-1])
    nothing = statistics.sobol(f, np.full(16, math.nan), np.tile(f, (3, 1)), seed=1)
    assert np.isnan(nothing[:-1]).all()
    assert np.shape(nothing[:-1]) == (6, 3)
    assert nothing.points == 0
    with pytest.raises(ValueError, match=r"must be \(16,\)"):
        statistics.sobol(f, f[:8], np.tile(f, (3, 1)), seed=1)


def test_saltelli_exchanges_one_column_at_a_time():
    a, b, ab = statistics.saltelli(64, 5, seed=10)
    assert a.shape == b.shape == (64, 5)
    assert ab.shape == (5, 64, 5)
    for i in range(5):
        np.testing.assert_array_equal(ab[i][:, i], b[:, i])
        others = np.arange(5) != i
        np.testing.assert_array_equal(ab[i][:, others], a[:, others])
    both = np.hstack([a, b])
    # Balance: every one of 64 cells of every column holds one point.
    np.testing.assert_array_equal(np.sort((both * 64).astype(int), axis=0), np.arange(64)[:, None].repeat(10, axis=1))
    assert both.min() >= 0.5**31  # 0 would be an infinite normal
    assert (both * 2.0**30 % 1.0 == 0.5).all()
    np.testing.assert_array_equal(statistics.saltelli(64, 5, seed=10).ab, ab)
    assert not np.array_equal(statistics.saltelli(64, 5, seed=11).a, a)


@pytest.mark.parametrize("n", [0, 3, 100])
def test_saltelli_refuses(n):
    with pytest.raises(ValueError, match=f"power of two.*it is {n}"):
        statistics.saltelli(n, 2, seed=0)


LIMIT = 0.7


def _normal(n: int, rng: np.random.Generator) -> statistics.Slope:
    eps = rng.normal(size=n)
    return statistics.yield_slope(np.abs(0.4 * eps) < LIMIT, eps, "normal", 0.4)


def _uniform(n: int, rng: np.random.Generator) -> statistics.Slope:
    eps = rng.uniform(-1.0, 1.0, n)
    return statistics.yield_slope(np.abs(0.9 * eps) < LIMIT, eps, "uniform", 0.9)


def _uneven(n: int, rng: np.random.Generator) -> statistics.Slope:
    """Another input scatters too: each edge has its own chance to pass."""
    eps = rng.uniform(-1.0, 1.0, n)
    chance = np.where(eps > 0.9, 0.3, np.where(eps < -0.9, 0.8, 0.6))
    return statistics.yield_slope(rng.random(n) < chance, eps, "uniform", 2.0)


CASES = [
    (_normal, -2.0 * LIMIT / 0.4**2 * stats.norm.pdf(LIMIT / 0.4)),  # d/ds (2 Phi(L/s) - 1)
    (_uniform, -LIMIT / 0.9**2),  # d/da L/a
    (_uneven, (-(0.05 * 0.3 + 0.05 * 0.8 + 0.9 * 0.6) + 0.55) / 2.0),
]


@pytest.mark.parametrize(("case", "truth"), CASES, ids=["normal", "uniform", "uneven"])
def test_yield_slope_is_the_closed_form(case, truth):
    value, error = case(1_000_000, np.random.default_rng(12))
    assert value == pytest.approx(truth, abs=4.0 * error)
    assert error < 0.01


@pytest.mark.parametrize(("case", "truth"), CASES, ids=["normal", "uniform", "uneven"])
def test_yield_slope_error_is_its_scatter(case, truth):
    rng = np.random.default_rng(13)
    values, errors = np.array([case(400, rng) for _ in range(1500)]).T
    assert values.std() == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.08)
    assert values.mean() == pytest.approx(truth, abs=4.0 * values.std() / math.sqrt(1500) + abs(truth) / 200)


def test_yield_slope_that_is_not_known():
    eps = np.linspace(-1.0, 1.0, 101)
    passed = eps > 0.0
    for family in ("triangular", "data", ""):
        assert np.isnan(statistics.yield_slope(passed, eps, family, 1.0)).all()
    assert np.isnan(statistics.yield_slope(passed, eps, "normal", 0.0)).all()
    assert np.isnan(statistics.yield_slope(passed[:1], eps[:1], "normal", 1.0)).all()
    assert np.isnan(statistics.yield_slope(passed, 0.5 * eps, "uniform", 1.0)).all()  # nothing at the edges
    for family in ("normal", "uniform"):
        assert statistics.yield_slope(np.ones(101, bool), eps, family, 1.0) == (0.0, 0.0)


def test_inputs_that_are_drawn_together_share_what_they_share():
    """Var(x + 2 y) = 1 + 4 + 4 rho for unit normals: x has 1 + 2 rho of it, y the rest."""
    rho, rng = 0.6, np.random.default_rng(0)
    r = np.array([[1.0, rho], [rho, 1.0]])
    found = statistics.linear_shares([1.0, 2.0], [1.0, 1.0], r)
    assert found.variance == pytest.approx(5.0 + 4.0 * rho)
    assert found.shares == pytest.approx(np.array([1.0 + 2.0 * rho, 4.0 + 2.0 * rho]) / (5.0 + 4.0 * rho))
    z = rng.multivariate_normal([0.0, 0.0], r, 40_000)
    seen = statistics.regression_shares(z, z @ [1.0, 2.0], r)
    assert seen.shares == pytest.approx(found.shares, abs=0.01)
    assert seen.explained == pytest.approx(1.0)


@pytest.mark.parametrize("rho", [0.0, 0.8, 1.0])
def test_slope_of_a_group_is_that_of_its_sum(rho):
    """Pass if |x + y| < L with both of scale s: the sum has deviation s sqrt(2 + 2 rho), so s dP/ds = -2 u phi(u)."""
    rng, limit = np.random.default_rng(1), 1.5
    r = np.array([[1.0, rho], [rho, 1.0]])
    eps = rng.multivariate_normal([0.0, 0.0], r, 200_000)
    u = limit / np.sqrt(2.0 + 2.0 * rho)
    found = statistics.normal_slope(np.abs(eps.sum(axis=1)) < limit, eps, r, [0, 1])
    assert found.value == pytest.approx(-2.0 * u * stats.norm.pdf(u), abs=4.0 * found.error)
    assert found.error < 0.01
