"""6σ from few samples with derivatives: closed forms, coverage, more inputs than samples, refusals."""

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


def covered(function, slope, p, n, repeated=40):
    """Share of repetitions whose interval holds σ, of those where it is offered; how many these are; and the errors
    there and of the samples alone, root mean square."""
    truth = function(np.random.default_rng(0).standard_normal((100_000, p))).std()
    hits, errors, alone = [], [], []
    for seed in range(repeated):
        x, y, slopes = samples(function, slope, n, p, seed)
        found = estimates_with_derivatives(scene(p), x, y, slopes)
        alone.append(y.std(ddof=1) / truth - 1)
        if found.kind[0] != "plain":
            hits.append(found.sigma[1, 0] <= truth <= found.sigma[2, 0])
            errors.append(found.sigma[0, 0] / truth - 1)
    return np.mean(hits), len(hits) / repeated, *(np.sqrt(np.mean(np.square(one))) for one in (errors, alone))


@pytest.mark.slow
def test_intervals_with_a_residual_have_their_coverage():
    """A sine and a term of fourth order beside a plane: 95 %, less three standard errors of 60 repetitions."""
    a = np.array([1.0, 0.5, -0.8, 0.3])

    def function(t):
        return t @ a + 0.3 * np.sin(2 * t[:, 0]) + 0.02 * t[:, 1] ** 4

    def slope(t):
        turned = np.tile(a, (len(t), 1))
        turned[:, 0] += 0.6 * np.cos(2 * t[:, 0])
        turned[:, 1] += 0.08 * t[:, 1] ** 3
        return turned

    share, offered, error, alone = covered(function, slope, 4, 20, 60)
    assert share > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 60) and offered > 0.9
    assert error < 0.4 * alone


@pytest.mark.slow
def test_intervals_hold_where_a_contact_closes_in_a_third_of_the_samples():
    a = np.array([1.0, 0.5, -0.8])

    def slope(t):
        return np.where((t @ a > 0.6)[:, None], a, 0.0)

    share, offered, _, _ = covered(lambda t: np.maximum(t @ a, 0.6), slope, 3, 20)
    assert share > 0.95 - 3 * np.sqrt(0.95 * 0.05 / max(40 * offered, 1))


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
