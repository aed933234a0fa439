"""Error rates of the verdict on populations of known capability, drawn many times."""

import numpy as np
import pytest
from scipy.stats import norm

from mic.statistics import estimates
from mic.statistics.capability import centred_capability, looks_normal, normal_share_outside
from mic.statistics.decision import CAPABLE, NOT_CAPABLE, NOT_DECIDED, decide, decide_share

TARGET, WRONG = 1.33, 0.05  # wrong verdicts at most
REPEATED = 1500
MARGIN = 3 * (WRONG * (1 - WRONG) / REPEATED) ** 0.5


def kinked(z):
    """A quantity that follows a deviation on one side of a contact, and a third of it on the other."""
    return np.maximum(z, 0) + np.minimum(z, 0) / 3


#: Draws of a population with their mean and standard deviation.
POPULATIONS = {
    "normal": (lambda rng, size: rng.standard_normal(size), 0.0, 1.0),
    "uniform": (lambda rng, size: rng.uniform(-1, 1, size), 0.0, 3**-0.5),
    "long tail": (lambda rng, size: rng.exponential(size=size), 1.0, 1.0),
    "long tail away": (lambda rng, size: -rng.exponential(size=size), -1.0, 1.0),
    "contact": (
        lambda rng, size: kinked(rng.standard_normal(size)),
        2 / 3 / (2 * np.pi) ** 0.5,
        (5 / 9 - (2 / 3) ** 2 / (2 * np.pi)) ** 0.5,
    ),
}


def drawn(population, samples, characteristics=1, seed=0):
    """(n, REPEATED, k) samples of mean 0 and standard deviation 1."""
    draw, mean, sigma = POPULATIONS[population]
    return (draw(np.random.default_rng(seed), (samples, REPEATED, characteristics)) - mean) / sigma


def verdicts(x, upper):
    """The verdict of each repetition, with the upper limit (k,) near and the lower far away."""
    cpk = centred_capability(x, -1e3, np.broadcast_to(upper, x.shape[1:]))
    return [decide(*ends, TARGET, len(x)).verdict for ends in zip(cpk.value, cpk.low, cpk.high)]


@pytest.mark.parametrize("samples", [10, 100, 300])
@pytest.mark.parametrize("population", POPULATIONS)
def test_at_the_required_capability_either_verdict_is_given_as_rarely_as_claimed(population, samples):
    """The worst case: a hair below the requirement "capable" is wrong, a hair above it "not capable"."""
    found = verdicts(drawn(population, samples), 3 * TARGET)
    assert found.count(CAPABLE) <= (WRONG + MARGIN) * REPEATED
    assert found.count(NOT_CAPABLE) <= (WRONG + MARGIN) * REPEATED


@pytest.mark.slow
def test_many_characteristics_do_not_add_up_to_a_wrong_verdict():
    """20 just capable characteristics are not called incapable for one of them; one incapable among 19 good ones
    does not pass."""
    found = verdicts(drawn("normal", 100, 20), 3 * TARGET)
    assert found.count(NOT_CAPABLE) <= (WRONG + MARGIN) * REPEATED
    found = verdicts(drawn("normal", 100, 20), np.r_[3 * TARGET, np.full(19, 9.0)])
    assert found.count(CAPABLE) <= (WRONG + MARGIN) * REPEATED


def test_clear_cases_are_decided():
    x = drawn("normal", 100)
    assert set(verdicts(x, 3 * 2.6)) == {CAPABLE} and set(verdicts(x, 3 * 0.7)) == {NOT_CAPABLE}


@pytest.mark.parametrize("population, cpk", [("normal", 1.2), ("normal", 1.5), ("contact", 1.5)])
def test_the_stated_number_of_samples_decides_where_the_estimate_is_true(population, cpk):
    """Samples whose Cpk is the true one state a number; that many decide nine times in ten."""
    x = drawn(population, 60)[:, :, 0]
    x = (x - x.mean(axis=0)) / x.std(axis=0, ddof=1)
    estimate = centred_capability(x, -1e3, 3 * cpk)
    assert np.allclose(estimate.value, cpk)
    needed = [decide(*ends, TARGET, 60).needed for ends in zip(estimate.value, estimate.low, estimate.high)]
    typical = int(np.nanmedian(needed))
    found = verdicts(drawn(population, typical, seed=1), 3 * cpk)
    right = CAPABLE if cpk > TARGET else NOT_CAPABLE
    assert found.count(right) >= 0.85 * REPEATED and typical < 5000


def test_needed_samples_by_hand():
    """Half-width 0.2 at 100 samples, 0.1 from the requirement: with n samples the half-width is 2/√n, and the estimate
    scatters by 2/(1.96 √n): 0.1 = 2 (1 + 1.2816/1.96)/√n, n = 1094."""
    decision = decide([1.43, 3.0], [1.23, 2.5], [1.63, 3.5], 1.33, 100)
    assert decision.verdict == NOT_DECIDED and decision.each == [NOT_DECIDED, CAPABLE]
    assert decision.needed == pytest.approx(400 * (1 + 1.281552 / 1.959964) ** 2, rel=1e-5)


def test_without_spread_and_without_interval():
    nan, inf = np.nan, np.inf
    assert decide([inf], [nan], [nan], 1.33, 9).verdict == CAPABLE
    assert decide([-inf, 3.0], [nan, 2.0], [nan, 4.0], 1.33, 9).verdict == NOT_CAPABLE
    unknown = decide([2.0], [nan], [nan], 1.33, 9)
    assert unknown.verdict == NOT_DECIDED and np.isnan(unknown.needed)
    assert decide([1.33], [1.0], [1.7], 1.33, 9).needed == inf
    one = centred_capability([0.5], 0, 1)
    assert decide(one.value, one.low, one.high, 1.33, 1).verdict == NOT_DECIDED


def test_a_share_is_decided_by_its_interval():
    """None of 100 outside bounds the share by 3.6 %; 0.1 % needs ln 0.025 / ln 0.999 = 3687 samples."""
    few = decide_share(estimates.share(0, 100), 0.001)
    assert few.verdict == NOT_DECIDED and few.needed == pytest.approx(3687, abs=1)
    assert decide_share(estimates.share(0, 3700), 0.001).verdict == CAPABLE
    assert decide_share(estimates.share(0, 100), 0.04).verdict == CAPABLE
    assert decide_share(estimates.share(30, 100), 0.04).verdict == NOT_CAPABLE
    undecided = decide_share(estimates.share(3, 100), 0.04)
    assert undecided.verdict == NOT_DECIDED and 1000 < undecided.needed < 10_000


def test_the_share_outside_by_a_normal_distribution_covers_the_true_one():
    x = drawn("normal", 100)[:, :, 0]
    for lower, upper in ((-1e3, 3.0), (-2.5, 2.5), (-3.5, 4.0), (-np.inf, 2.0)):
        found = normal_share_outside(x, lower, upper)
        true = norm.cdf(lower) + norm.sf(upper)
        assert np.mean((found.low <= true) & (true <= found.high)) > 1 - WRONG - MARGIN
    by_hand = normal_share_outside(np.tile([-1.0, 1.0], 50), -3.0, np.inf)
    assert by_hand.value == pytest.approx(norm.cdf(-3 * (99 / 100) ** 0.5), rel=1e-12)


@pytest.mark.slow
def test_only_normal_samples_are_extrapolated():
    normal = looks_normal(drawn("normal", 100)[:, :, 0]).all()
    share = np.mean([looks_normal(one) for one in drawn("normal", 100)[:, :, 0].T])
    assert share > 1 - WRONG - MARGIN and (normal or share < 1)
    assert np.mean([looks_normal(one) for one in drawn("long tail", 300)[:, :, 0].T]) < 0.01
    assert not looks_normal(drawn("normal", 49)[:, 0, 0])
