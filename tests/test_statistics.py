"""Statistics against textbook numbers, scipy's distributions, and the coverage that an interval promises."""

import warnings

import numpy as np
import pytest
import scipy.stats

from mic.statistics import estimates as st
from mic.statistics.capability import capability, centred_capability, outside

TEN = np.arange(1.0, 11.0)  # mean 5.5, s = 3.0276504


def test_mean_and_sigma_of_ten_numbers():
    mean, sigma = st.mean(TEN), st.sigma(TEN)
    # t(0.975, 9) = 2.262157, chi2(0.025, 9) = 2.700389, chi2(0.975, 9) = 19.022768 from printed tables
    s = 3.0276504
    assert mean.value == 5.5
    half, low, high = 2.262157 * s / 10**0.5, s * (9 / 19.022768) ** 0.5, s * (9 / 2.700389) ** 0.5
    assert [mean.low, mean.high] == pytest.approx([5.5 - half, 5.5 + half], rel=1e-6)
    assert [sigma.value, sigma.low, sigma.high] == pytest.approx([s, low, high], rel=1e-6)
    assert (mean.used, mean.excluded) == (10, 0)


def test_level_of_confidence_is_honoured():
    mean = st.mean(TEN, level=0.9)
    low, high = scipy.stats.t.interval(0.9, 9, 5.5, scipy.stats.sem(TEN))
    assert [mean.low, mean.high] == pytest.approx([low, high], rel=1e-12)


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
    interval = cp.value * np.sqrt(scipy.stats.chi2.ppf([0.025, 0.975], 99) / 99)
    assert [cp.low, cp.high] == pytest.approx(interval, rel=1e-10)
    assert cpk.value == pytest.approx(6 / (3 * s), rel=1e-12)
    half = 1.959964 * (1 / 900 + cpk.value**2 / 198) ** 0.5
    assert [cpk.low, cpk.high] == pytest.approx([cpk.value - half, cpk.value + half], rel=1e-6)


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


@pytest.mark.parametrize("x", [[], [np.nan], [3.0], [3.0] * 5, [0.1] * 7])
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


# Coverage is checked by repetition: over R sets its standard deviation is sqrt(0.95 0.05 / R).
REPEATED, TRUE_MEAN, TRUE_SIGMA = 8000, 2.0, 0.7
TOLERANCE = 4 * (0.95 * 0.05 / REPEATED) ** 0.5


def _sets(n):
    return np.random.default_rng(n).normal(TRUE_MEAN, TRUE_SIGMA, (n, REPEATED))


def _coverage(low, high, truth):
    return np.mean((low <= truth) & (truth <= high))


EXACT = {
    "mean": (st.mean, TRUE_MEAN),
    "six_sigma": (st.six_sigma, 6 * TRUE_SIGMA),
    "cp": (lambda x: capability(x, 0, 5), 5 / (6 * TRUE_SIGMA)),
}


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("n", [3, 50])
def test_exact_intervals_cover_the_truth_as_often_as_they_promise(name, n):
    estimate, truth = EXACT[name]
    found = estimate(_sets(n))
    assert abs(_coverage(found.low, found.high, truth) - 0.95) < TOLERANCE


def test_bissells_interval_covers_to_its_own_accuracy():
    found = centred_capability(_sets(100), 0, 5)  # limits to one side, where the approximation is meant to hold
    assert abs(_coverage(found.low, found.high, TRUE_MEAN / (3 * TRUE_SIGMA)) - 0.95) < TOLERANCE + 0.005


def test_intervals_hold_for_skewed_samples_with_heavy_tails():
    """Zone slips look like this; the intervals of a normal population would cover 0.82 and 0.78 of the time."""
    shape = 2.2
    mean, sigma = shape, shape**0.5
    x = np.random.default_rng(4).gamma(shape, 1.0, (500, 4000))
    found, cpk = st.sigma(x), centred_capability(x, mean - 20 * sigma, mean + 4 * sigma)
    assert 0.91 < _coverage(found.low, found.high, sigma) < 0.97
    assert 0.91 < _coverage(cpk.low, cpk.high, 4 / 3) < 0.97


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
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12)
        assert (other.used == one.used).all() and (other.excluded == one.excluded).all()
    for one, other in zip(st.tails(x), st.tails(pieces)):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-14)
    assert st.tails(x)[2].any(), "no heavy tail, so Bonett's interval was not compared"
    cpk, same = centred_capability(x, -2, 2e6), centred_capability(pieces, -2, 2e6)
    np.testing.assert_allclose([same.value, same.low, same.high], [cpk.value, cpk.low, cpk.high], rtol=1e-12)
    np.testing.assert_array_equal(whole.n, pieces.n)


def test_moments_of_many_million_samples_do_not_overflow():
    one = st.Moments.of(TEN)
    for _ in range(30):
        one = one.merged(one)
    assert one.n == 10 * 2**30 and one.mean == 5.5
    assert one.m2 == 82.5 * 2**30 and one.m3 == 0 and one.m4 == pytest.approx(1208.625 * 2**30, rel=1e-14)


@pytest.mark.parametrize("value", [0.1, 3.0, -1e-7])
def test_a_constant_has_no_spread_however_many_samples_there_are(value):
    assert st.sigma(pieces_together(np.full((30_000, 2), value), 31)).value.tolist() == [0.0, 0.0]
    assert st.sigma(np.full((30_000, 2), value)).value.tolist() == [0.0, 0.0]
