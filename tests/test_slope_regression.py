"""6σ from few samples with derivatives: closed forms, more inputs than samples, refusals."""

from types import SimpleNamespace

import numpy as np
import pytest

from mic.statistics.derivative_regression import estimates_with_derivatives


def scene(p, distribution="normal", **keys):
    """Deviations of mean 1 and standard deviation 2."""
    item = SimpleNamespace(mean=1.0, sigma=2.0, distribution=distribution, truncated=None)
    asked = SimpleNamespace(design="independent", values=None)
    return SimpleNamespace(deviations=[item] * p, monte_carlo=asked, correlations=[], **keys)


def samples(function, slope, n, p, seed, distribution="normal"):
    draws = np.random.default_rng(seed)
    t = draws.uniform(-np.sqrt(3), np.sqrt(3), (n, p)) if distribution == "uniform" else draws.standard_normal((n, p))
    return 1 + 2 * t, function(t)[:, None], (slope(t) / 2)[:, None]


@pytest.mark.parametrize(("distribution", "kurtosis"), [("normal", 3.0), ("uniform", 1.8)])
def test_a_quadratic_is_known_but_for_nothing(distribution, kurtosis):
    """a·t + c t₀² + d t₁ t₂: mean c, variance a² + c²(κ − 1) + d²; 20 samples find it exactly."""
    a, c, d = np.array([1.0, -2.0, 0.5]), 0.7, 0.4

    def function(t):
        return t @ a + c * t[:, 0] ** 2 + d * t[:, 1] * t[:, 2]

    def slope(t):
        turned = np.tile(a, (len(t), 1))
        turned[:, 0] += 2 * c * t[:, 0]
        turned[:, 1] += d * t[:, 2]
        turned[:, 2] += d * t[:, 1]
        return turned

    found = estimates_with_derivatives(scene(3, distribution), *samples(function, slope, 20, 3, 1, distribution))
    assert found.kind.tolist() == ["quadratic"] and found.explained[0] == pytest.approx(1.0)
    np.testing.assert_allclose(found.mean[:, 0], c, rtol=1e-9)
    np.testing.assert_allclose(found.sigma[:, 0], np.sqrt(a @ a + c**2 * (kurtosis - 1) + d**2), rtol=1e-9)


def test_there_may_be_more_inputs_than_samples():
    a = np.random.default_rng(4).standard_normal(40)
    linear = samples(lambda t: t @ a, lambda t: np.tile(a, (len(t), 1)), 20, 40, 2)
    found = estimates_with_derivatives(scene(40), *linear)
    assert found.kind.tolist() == ["linear"]
    np.testing.assert_allclose(found.sigma[:, 0], np.linalg.norm(a), rtol=1e-9)


def test_it_is_not_offered_where_it_cannot_be_known():
    a = np.ones(3)
    x, y, slopes = samples(lambda t: t @ a, lambda t: np.tile(a, (len(t), 1)), 30, 3, 3)
    assert estimates_with_derivatives(scene(3, "triang"), x, y, slopes) is None
    assert estimates_with_derivatives(scene(3), x[:19], y[:19], slopes[:19]).kind.tolist() == ["plain"]
    slopes[:11] = np.nan
    assert estimates_with_derivatives(scene(3), x, y, slopes).kind.tolist() == ["plain"]
    noise = np.random.default_rng(1).standard_normal((30, 1, 3))
    assert estimates_with_derivatives(scene(3), x, y, 5 * noise).kind.tolist() == ["plain"]


@pytest.mark.parametrize(
    "unknown",
    [{"distribution": "lognorm"}, {"truncated": (-1, 1)}, {"scores": [1.0, -1.0]}, {"design": "sobol"}],
)
def test_inputs_whose_moments_are_not_known_are_refused(unknown):
    known = scene(3)
    given = samples(lambda t: t[:, 0], lambda t: np.eye(3)[np.zeros(len(t), int)], 20, 3, 1)
    assert estimates_with_derivatives(known, *given) is not None
    item = SimpleNamespace(**(vars(known.deviations[0]) | unknown))
    asked = SimpleNamespace(design=unknown.get("design", "independent"), values=None)
    changed = {"deviations": [item] * 3, "monte_carlo": asked}
    for change in (changed, {"correlations": [1]}):
        assert estimates_with_derivatives(SimpleNamespace(**vars(known) | change), *given) is None
