"""Statistics from few samples with surrogates and a cheap model: closed forms, coverage, rare jumps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import norm, qmc

from mic.statistics.control_variate import FOLDS, LEAST, LEAST_ALONE, surrogate_estimates
from mic.statistics.surrogate import best_surrogate

P = 3
DIRECTION = np.array([0.6, 0.0, 0.8])
INFINITE = np.full(1, np.inf)


def population(points: int = 512, p: int = P) -> np.ndarray:
    """Standard normal inputs for each fold."""
    sequences = [qmc.Sobol(p, seed=fold).random(points) for fold in range(FOLDS)]
    return ndtri(np.clip(sequences, 1e-9, 1 - 1e-9))


def normal(rng, n: int) -> np.ndarray:
    return rng.standard_normal((n, P))


def hinge(x: np.ndarray, start: float = 0.5, slope: float = 1.0) -> np.ndarray:
    """A contact that closes beyond `start`: (n, 1)."""
    return (0.8 * x[:, 0] + slope * np.maximum(x @ DIRECTION - start, 0.0))[:, None]


def hinge_moments(start: float = 0.5) -> tuple[float, float]:
    """Mean and σ of :func:`hinge`, from E max(t - s, 0) = φ(s) - s Φ(-s) and the like."""
    density, above = norm.pdf(start), ndtr(-start)
    mean = density - start * above
    square = (1 + start**2) * above - start * density
    variance = 0.64 + square - mean**2 + 2 * 0.8 * DIRECTION[0] * above
    return mean, np.sqrt(variance)


def test_linear_outputs_are_exact():
    x = normal(np.random.default_rng(1), LEAST_ALONE)
    found = surrogate_estimates(x, 2.0 + x @ np.array([[1.0], [2.0], [2.0]]), population(4096))
    assert found.mean().value == pytest.approx([2.0], abs=2e-3)
    assert found.sigma().value == pytest.approx([3.0], rel=2e-3)
    assert found.explained == pytest.approx([1.0], abs=1e-9)
    upper = np.array([8.0])
    assert found.centred_capability(-INFINITE, upper).value == pytest.approx([2 / 3], rel=3e-3)
    share = found.share_outside(-INFINITE, upper)
    assert share.low[0] < ndtr(-2.0) < share.high[0]
    quantile = found.quantile(0.99865)
    assert quantile.low[0] < 2.0 + 3.0 * ndtri(0.99865) < quantile.high[0]


def test_inputs_that_determine_each_other_count_once():
    """Fully correlated inputs: the estimates are those of the one that they share."""
    x, wide = np.random.default_rng(3).standard_normal((LEAST_ALONE, 1)), np.array([[1.0, -1.0, 1.0]])
    one, all_three = (surrogate_estimates(x @ a, hinge(x @ wide), population(512, 1) @ a) for a in (wide[:, :1], wide))
    assert one.kind == all_three.kind
    assert all_three.sigma().value == pytest.approx(one.sigma().value, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("cheap", [0, 160], ids=["samples alone", "with a cheap model"])
def test_estimates_of_a_kink_are_unbiased_and_their_intervals_cover_it(cheap):
    """At least 93 % of 40 intervals of 95 % hold the closed form; they are far narrower than those of the samples."""
    mean, sigma = hinge_moments()
    limit, points, rng, covered, widths, errors = np.array([3.0]), population(), np.random.default_rng(5), [], [], []
    n = LEAST if cheap else LEAST_ALONE
    for _ in range(40):
        x = normal(rng, n + cheap)
        y, o = hinge(x[:n]), hinge(x, 0.6, 0.8)
        found = surrogate_estimates(x[:n], y, points, (x, o) if cheap else None)
        estimates = found.mean(), found.sigma(), found.centred_capability(-INFINITE, limit)
        truths = mean, sigma, (3.0 - mean) / (3 * sigma)
        covered.append([e.low[0] <= truth <= e.high[0] for e, truth in zip(estimates, truths)])
        widths.append(np.log(estimates[1].high[0] / estimates[1].low[0]))
        errors.append([estimates[0].value[0] - mean, estimates[1].value[0] ** 2 - sigma**2])
    assert (np.mean(covered, axis=0) >= 0.93).all()
    assert np.median(widths) < 0.4 * 2 * 1.96 / np.sqrt(2 * n)
    assert (np.abs(np.mean(errors, axis=0)) < 4 * np.std(errors, axis=0) / np.sqrt(40)).all()


def test_rare_jumps_of_the_cheap_model_widen_the_interval():
    """A jump in 1 of 100 that no followed sample shows: those in one step show half of it, and the interval holds σ."""
    rng = np.random.default_rng(0)
    x = normal(rng, 1000)
    jump = (x[:, 1] > ndtri(0.99)).astype(float)
    jump[:50], x[:50, 1] = 0.0, np.minimum(x[:50, 1], 2.0)
    (y, o), points = (np.column_stack([x[:, 0] + height * jump]) for height in (6.0, 3.0)), population(2048)
    with_cheap = surrogate_estimates(x[:50], y[:50], points, (x, o)).sigma()
    truth = np.sqrt(1 + 36 * 0.01 * 0.99)
    without = surrogate_estimates(x[:50], y[:50], points, (x[:50], o[:50])).sigma()
    assert without.high[0] < truth  # nothing can tell
    assert with_cheap.low[0] < truth < with_cheap.high[0]


def test_an_output_without_a_pattern_is_not_explained():
    rng = np.random.default_rng(2)
    x = normal(rng, 200)
    found = surrogate_estimates(x, np.column_stack([x[:, 0], rng.standard_normal(200)]), population())
    assert found.explained[0] > 0.99 and found.explained[1] < 0.1
    assert found.at([1]).mean().value == found.mean().value[1:]


def test_failed_samples_and_constant_inputs_are_left_out():
    rng = np.random.default_rng(3)
    x = np.column_stack([normal(rng, 220), np.full(220, 7.0)])
    y = x[:, :1].copy()
    y[3] = np.nan
    points = np.concatenate([population(), np.full((FOLDS, 512, 1), 7.0)], axis=2)
    found = surrogate_estimates(x, y, points)
    assert found.samples == 219
    assert found.sigma().value == pytest.approx([1.0], rel=0.02)
    assert surrogate_estimates(x[:LEAST_ALONE], y[:LEAST_ALONE], points) is None  # 199 of them
    assert surrogate_estimates(x[: LEAST - 1], y[: LEAST - 1], points, (x, y)) is None
    assert surrogate_estimates(x[:, 3:], y, points[:, :, 3:]) is None


def test_leave_one_out_errors_choose_the_surrogate():
    rng = np.random.default_rng(4)
    x = normal(rng, 80)
    y = np.column_stack([x[:, 0], x[:, 0] * x[:, 1], np.maximum(x[:, 0], 0.0), rng.standard_normal(80)])
    chosen = best_surrogate(x, y)
    assert chosen.kind[1:] == ["quadratic", "spline", "plain"]
    assert chosen.predict(x[:5])[:, 1] == pytest.approx(y[:5, 1])


def test_moments_of_the_hinge():
    """The closed form of this file against integration."""
    t, weight = np.polynomial.hermite_e.hermegauss(200)
    values = np.maximum(t - 0.5, 0.0)
    weight = weight / weight.sum()
    variance = 0.64 + weight @ values**2 - (weight @ values) ** 2 + 2 * 0.8 * DIRECTION[0] * (weight @ (t * values))
    assert hinge_moments() == pytest.approx((weight @ values, np.sqrt(variance)), rel=3e-3)
