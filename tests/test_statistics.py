"""Statistics against textbook numbers and the distributions of SciPy."""

import math
import warnings

import numpy as np
import pytest
import scipy.stats

from mic.statistics import estimates as st
from mic.statistics.capability import capability, centred_capability, outside

TEN = np.arange(1.0, 11.0)  # mean 5.5, s = 3.0276504


def chi_squared_share(x, freedom):
    """Share of a chi-squared distribution below x, by Simpson's rule in √x."""
    r, step = np.linspace(0, x**0.5, 20001, retstep=True)
    density = 2 * r ** (freedom - 1) * np.exp(-(r**2) / 2) / (2 ** (freedom / 2) * math.gamma(freedom / 2))
    return step / 3 * (density[0] + density[-1] + 4 * density[1:-1:2].sum() + 2 * density[2:-1:2].sum())


def test_mean_and_sigma_of_ten_numbers():
    mean, sigma = st.mean(TEN), st.sigma(TEN)
    # t(0.975, 9) = 2.262157 from printed tables; no skewness
    s = 3.0276504
    assert mean.value == 5.5
    half = 2.262157 * s / 10**0.5
    assert [mean.low, mean.high] == pytest.approx([5.5 - half, 5.5 + half], rel=1e-6)
    assert sigma.value == pytest.approx(s, rel=1e-7)
    # Σ d² = 82.5, Σ d⁴ = 1208.625, and two more d = 4.5: κ = 2.98072
    freedom = 20 / (10 * (1208.625 + 2 * 4.5**4) / 82.5**2 - 3 + 20 / 9)
    for end, tail in ((sigma.low, 0.975), (sigma.high, 0.025)):
        assert chi_squared_share(freedom * (sigma.value / end) ** 2, freedom) == pytest.approx(tail, abs=1e-6)
    assert (mean.used, mean.excluded) == (10, 0)


def test_mean_of_skewed_numbers():
    """Hall's cubic of the studentised mean, g(T) = T + γT²/3√n + γ²T³/27n + γ/6√n, is Student's t at both ends."""
    x = TEN**3
    found, d = st.mean(x), x - x.mean()
    skewness, error = (d**3).mean() / (d**2).mean() ** 1.5, x.std(ddof=1) / 10**0.5
    assert found.high - found.value > 1.3 * (found.value - found.low), "the long tail is above"
    for end, quantile in ((found.low, 2.262157), (found.high, -2.262157)):
        T, a = (found.value - end) / error, skewness / 10**0.5
        assert T + a * T**2 / 3 + a**2 * T**3 / 27 + a / 6 == pytest.approx(quantile, rel=1e-6)


def test_extremes_bound_the_population_from_one_side_only():
    low, high = st.minimum(TEN), st.maximum(TEN)
    assert (low.value, low.low, low.high) == (1.0, -np.inf, 1.0)
    assert (high.value, high.low, high.high) == (10.0, 10.0, np.inf)


def test_wilks_needs_93_samples_for_95_per_cent_with_95_per_cent_confidence():
    assert st.covered_share(93) > 0.95 > st.covered_share(92)
    assert np.isnan(st.covered_share(1))


def test_capability_of_known_samples():
    x = 5 + 2 * np.tile([-1.0, 1.0], 50)  # mean 5, s = 2 sqrt(100/99)
    s = 2 * (100 / 99) ** 0.5
    cp, cpk = capability(x, -1, 17), centred_capability(x, -1, 17)
    assert cp.value == pytest.approx(18 / (6 * s), rel=1e-12)
    # κ = 1 of two values, and two more as far: 1.02 times (99/100)² (100/99)² = 1.02; no skewness
    freedom = 200 / (1.02 - 3 + 200 / 99)
    ends = np.sqrt(scipy.stats.chi2.ppf([0.025, 0.975], freedom) / freedom)
    assert [cp.low, cp.high] == pytest.approx(cp.value * ends, rel=1e-10)
    assert cpk.value == pytest.approx(6 / (3 * s), rel=1e-12)
    halves = np.hypot(1.984217 / 30, cpk.value * (ends - 1))  # t(0.975, 99) = 1.984217
    assert [cpk.low, cpk.high] == pytest.approx(cpk.value + [-1, 1] * halves, rel=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
def test_cpk_of_skewed_numbers(sign):
    """The covariance of mean and σ, t² Cpk γ / 3n, widens the interval if the long tail points to the nearer limit."""
    x = sign * TEN**3
    mean, s, d = x.mean(), st.sigma(x), TEN**3 - (TEN**3).mean()
    of_mean = 2.262157**2 / 10 * (1 / 9 + (d**3).mean() / (d**2).mean() ** 1.5 / 3)
    near, far = mean + sign * 3 * s.value, mean - sign * 30 * s.value
    found = centred_capability(x, min(near, far), max(near, far))
    assert found.value == pytest.approx(1.0)
    assert found.low == pytest.approx(1 - np.hypot(of_mean**0.5, 1 - s.value / s.high), rel=1e-6)
    assert found.high == pytest.approx(1 + np.hypot(of_mean**0.5, 1 - s.value / s.low), rel=1e-6)


@pytest.mark.parametrize("count, n", [(0, 1), (1, 1), (5, 10), (3, 500), (497, 500)])
def test_clopper_pearson_agrees_with_scipy(count, n):
    ours, theirs = st.share(count, n), scipy.stats.binomtest(count, n).proportion_ci(0.95, "exact")
    assert [ours.low, ours.high] == pytest.approx([theirs.low, theirs.high], rel=1e-9)


def test_samples_outside_are_counted_on_both_sides_and_failed_ones_excluded():
    assert outside([-2.0, 0.0, 0.5, 3.0, np.nan], -1, 1) == 2


def test_density_integrates_to_one_and_agrees_with_scipy():
    x = np.random.default_rng(1).gamma(3.0, size=300)
    grid = np.linspace(-3, 20, 4000)
    ours = st.density(np.append(x, np.nan), grid)
    assert ours.sum() * (grid[1] - grid[0]) == pytest.approx(1, rel=1e-6)
    np.testing.assert_allclose(ours, scipy.stats.gaussian_kde(x)(grid), rtol=1e-9, atol=1e-300)


def test_failed_samples_are_excluded_and_counted_column_by_column():
    x = np.column_stack([np.append(TEN, np.nan), np.append(np.nan, TEN), np.full(11, np.nan)])
    for estimate in (st.mean(x), st.sigma(x), capability(x, 0, 11), centred_capability(x, 0, 11)):
        assert list(estimate.used) == [10, 10, 0] and list(estimate.excluded) == [1, 1, 11]
        assert estimate.value[0] == pytest.approx(estimate.value[1], rel=1e-14) and np.isnan(estimate.value[2])
    assert st.mean(x).value[0] == pytest.approx(5.5)


@pytest.mark.parametrize("x", [[], [np.nan], [3.0], [3.0] * 5, [0.1] * 7, [np.nan, 1.0] * 3])
def test_degenerate_samples_claim_no_certainty(x):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mean, sigma, cp, cpk = st.mean(x), st.sigma(x), capability(x, 0, 10), centred_capability(x, 0, 10)
        smallest, share, curve = st.minimum(x), st.share(outside(x, 0, 10), mean.used), st.density(x, [3.0])
    used = int(np.isfinite(x).sum())
    for estimate in (mean, sigma, cp, cpk):
        assert np.isnan(estimate.low) and np.isnan(estimate.high)
    assert np.isnan(curve).all()
    assert np.isnan(mean.value) == np.isnan(smallest.value) == np.isnan(share.value) == (used == 0)
    if used > 1:
        assert sigma.value == 0 and cp.value == np.inf and cpk.value == np.inf
    else:
        assert np.isnan(sigma.value) and np.isnan(cp.value) and np.isnan(cpk.value)


def test_cpk_without_spread_is_infinite_with_the_sign_of_the_margin():
    assert centred_capability([2.0, 2.0], 0, 1).value == -np.inf
    assert np.isnan(centred_capability([1.0, 1.0], 0, 1).value)


def test_what_the_intervals_hold_for_follows_from_the_number_of_samples():
    assert st.confidence([0, 2, 3, 19, 20, 49, 50, 500]) == pytest.approx(
        [np.nan, np.nan, 0.8, 0.8, 0.9, 0.9, 0.95, 0.95], nan_ok=True
    )
    assert st.rarest_event([0, 3, 15, 60, 500]) == pytest.approx([1, 1, 1, 0.25, 0.03])
    two = np.array([1.0, 2.0])
    assert np.isnan([st.mean(two).low, st.sigma(two).high, centred_capability(two, 0, 9).low]).all()


def pieces_together(x, count):
    """Moments of samples that come in pieces, joined one after the other."""
    found = None
    for piece in np.array_split(x, count):
        moments = st.Moments.of(piece)
        found = moments if found is None else found.merged(moments)
    return found


@pytest.mark.parametrize("count", [2, 7, 300])
def test_samples_in_pieces_have_the_estimates_of_the_whole(count):
    rng = np.random.default_rng(5)
    x = np.column_stack([rng.normal(size=1000), 1e6 + rng.gamma(2.0, size=1000), rng.standard_t(5, size=1000) * 1e-9])
    x[rng.random(x.shape) < 0.01] = np.nan
    x[:500, 1] = np.nan  # whole pieces without a value
    whole, pieces = st.Moments.of(x), pieces_together(x, count)
    for estimate in (st.mean, st.sigma, st.six_sigma, st.minimum, st.maximum):
        one, other = estimate(x), estimate(pieces)
        for name in ("value", "low", "high"):
            np.testing.assert_allclose(
                getattr(other, name), getattr(one, name), rtol=1e-10
            )  # the extremes less the mean of 1e6
        assert (other.used == one.used).all() and (other.excluded == one.excluded).all()
    for one, other in zip(st.tails(x), st.tails(pieces)):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-14)
    cpk, same = centred_capability(x, -2, 2e6), centred_capability(pieces, -2, 2e6)
    np.testing.assert_allclose([same.value, same.low, same.high], [cpk.value, cpk.low, cpk.high], rtol=1e-10)
    np.testing.assert_array_equal(whole.n, pieces.n)


def test_moments_of_many_million_samples_do_not_overflow():
    one = st.Moments.of(TEN)
    for _ in range(30):
        one = one.merged(one)
    assert one.n == 10 * 2**30 and one.mean == 5.5
    assert one.m2 == 82.5 * 2**30 and one.m3 == 0 and one.m4 == pytest.approx(1208.625 * 2**30, rel=1e-14)


def test_a_constant_has_no_spread_however_many_samples_there_are():
    x = np.tile([0.1, 3.0, -1e-7], (30_000, 1))
    for samples in (x, pieces_together(x, 31)):
        assert st.sigma(samples).value.tolist() == [0.0] * 3
