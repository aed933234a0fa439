"""6σ by regression on the inputs: narrower, of the coverage that it claims, and silent where it does not hold."""

from types import SimpleNamespace

import numpy as np
import pytest

from mic.statistics.regression import Regression

P = 6
SLOPES = np.array([3.0, 2.0, 1.0, 0.5, 0.2, 0.1])


def response(t):
    """Nearly linear, with a gap that closes."""
    return t @ SLOPES + 0.1 * (t[:, 0] ** 2 + t[:, 0] * t[:, 1]) + 0.1 * np.abs(t[:, 2])


# Variances of t², t u and |t| of normal t, u are 2, 1 and 1 − 2/π; the terms are uncorrelated.
TRUTH = np.sqrt((SLOPES**2).sum() + 0.1**2 * (2 + 1 + 1 - 2 / np.pi))


def of(x, y, groups=3):
    """The regression on samples that come in blocks."""
    found = Regression(np.zeros(x.shape[1]), np.ones(x.shape[1]), np.full(x.shape[1], 3.0))
    for own in np.array_split(np.arange(len(x)), groups):
        found.add(own, x[own], y[own].reshape(len(own), -1))
    return found.estimates()


def repeated(n, times):
    rng = np.random.default_rng(1)
    for _ in range(times):
        x = rng.standard_normal((n, P))
        yield x, response(x)


@pytest.mark.slow
def test_the_intervals_cover_as_often_as_they_claim():
    found = [of(x, y) for x, y in repeated(100, 200)]
    assert {one.kind[0] for one in found} <= {"linear", "quadratic"}
    assert 0.92 <= np.mean([one.sigma[1, 0] <= TRUTH <= one.sigma[2, 0] for one in found]) <= 0.985


@pytest.mark.slow
def test_sixty_samples_with_regression_equal_thousands_without():
    """Without regression, σ of 60 samples errs by 1/√120 = 9.1 %."""
    errors = np.array([(of(x, y).sigma[0, 0] / TRUTH - 1, y.std(ddof=1) / TRUTH - 1) for x, y in repeated(60, 200)])
    improved, plain = np.sqrt((errors**2).mean(axis=0))
    assert plain == pytest.approx(0.09, abs=0.01)
    assert improved < plain / np.sqrt(10)  # a tenth of the samples
    assert abs(errors[:, 0].mean()) < 0.2 * improved + 3 * improved / np.sqrt(200)  # no bias beyond its own scatter


def test_with_too_few_samples_none_is_offered():
    """Three for each slope and ten more."""
    for n, kind in ((3 * P + 9, "plain"), (3 * P + 10, "linear")):
        x, y = next(repeated(n, 1))
        assert of(x, y).kind[0] == kind
    assert np.isnan(of(*next(repeated(3 * P + 9, 1))).sigma).all()


@pytest.mark.slow
def test_where_nothing_is_explained_it_is_not_taken():
    """The plain interval of pure noise is as narrow."""
    rng, taken = np.random.default_rng(2), []
    for _ in range(50):
        x, y = rng.standard_normal((100, P)), rng.standard_normal(100)
        found = of(x, y)
        taken.append(found.sigma[0, 0] / y.std(ddof=1) if found.kind[0] != "plain" else 1.0)
    np.testing.assert_allclose(taken, 1.0, atol=0.1)


def test_results_do_not_depend_on_blocks_and_failed_samples_are_excluded():
    x, y = next(repeated(120, 1))
    y[7] = np.nan
    one, many = of(x, y, 1), of(x, y, 11)
    np.testing.assert_allclose(one.sigma, many.sigma, rtol=1e-9)
    known = np.isfinite(y)
    own = Regression(np.zeros(P), np.ones(P), np.full(P, 3.0))
    own.add(np.flatnonzero(known), x[known], y[known, None])
    np.testing.assert_allclose(own.estimates().sigma, one.sigma, rtol=1e-9)


@pytest.mark.slow
def test_a_mean_is_that_of_the_population_and_not_of_the_draw():
    errors = np.array([of(x, y).mean[0, 0] for x, y in repeated(100, 50)]) - 0.1 * (1 + np.sqrt(2 / np.pi))
    assert np.sqrt((errors**2).mean()) < 0.1 * TRUTH / np.sqrt(100)


def scene(correlations=(), design="independent", **keys):
    item = {"mean": 0.0, "sigma": 1.0, "distribution": "normal", "truncated": None, "scores": None} | keys
    return SimpleNamespace(
        deviations=[SimpleNamespace(**item)],
        correlations=list(correlations),
        monte_carlo=SimpleNamespace(design=design, values=None),
    )


@pytest.mark.parametrize(
    "unknown",
    [
        {"correlations": [1]},
        {"design": "sobol"},
        {"distribution": "lognorm"},
        {"truncated": (-1, 1)},
        {"scores": [1.0, -1.0]},
    ],
)
def test_inputs_of_moments_that_are_not_known_are_none(unknown):
    assert Regression.of(scene()) is not None
    assert Regression.of(scene(**unknown)) is None
