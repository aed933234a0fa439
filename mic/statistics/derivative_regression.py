r"""Mean and 6σ from few samples with exact derivatives: regression on values and derivatives.

With functions ``φ_j`` of independent inputs that have mean 0 and are orthonormal (the inputs in standard deviations;
for second order also ``(t_i² - 1)/\sqrt{κ_i - 1}`` and ``t_i t_j``), each sample with its p derivatives gives 1 + p
equations for the coefficients b, so there may be more inputs than samples. For any b

.. math::

    E\,y = E\,(y - φ b), \qquad \mathrm{Var}\,y = \sum b_j^2 + \mathrm{Var}\,r + 2\,\mathrm{Cov}(φ b, r), \qquad
    r = y - φ b,

and only the last two terms have sampling noise. They are computed fold by fold with the b of all other folds
(cross-fitting [1]_), so the estimates are unbiased for any b.

References
----------
.. [1] V. Chernozhukov et al.: Double/debiased machine learning for treatment and structural parameters, Econom. J. 21
       (2018) C1-C68, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from mic.statistics import estimates
from mic.statistics.estimates import ADDED, LEVEL, jackknife_error

__all__ = ["RegressionEstimates", "estimates_with_derivatives"]

GROUPS = 20  # groups of the jackknife
FOLDS = 5
LEAST = 20  # samples; fewer give no reliable jackknife interval
EQUATIONS_PER_COEFFICIENT, FURTHER_EQUATIONS = 3, 10  # that a regression needs
QUADRATIC = 20  # inputs of a quadratic regression, at most: 230 functions
KURTOSIS = {"normal": 3.0, "uniform": 1.8}  # of the distributions whose moments are known


@dataclass(frozen=True)
class RegressionEstimates:
    """Estimates of k outputs.

    Attributes
    ----------
    kind : (k,) object array of {"plain", "linear", "quadratic"}
        Estimator; for ``"plain"``, where no regression is narrower, the other arrays hold NaN.
    explained : (k,) array
        Share of the variance that the regression explains, R² corrected for its degrees of freedom.
    mean, sigma : (3, k) array
        Estimate, and lower and upper end of its interval.
    width : (k,) array
        Widths of the intervals of σ, in any measure.
    """

    kind: np.ndarray
    explained: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    width: np.ndarray

    @classmethod
    def plain(cls, width: np.ndarray) -> RegressionEstimates:
        """The estimates without regression, for k outputs whose intervals of σ have these widths."""
        k = len(width)
        mean, sigma = np.full((2, 3, k), np.nan)
        return cls(np.full(k, "plain", dtype=object), np.full(k, np.nan), mean, sigma, width.copy())

    def offer(self, kind: str, width: np.ndarray, mean: np.ndarray, sigma: np.ndarray, explained: np.ndarray) -> None:
        """Use other estimates for the outputs whose interval of σ they make narrower."""
        chosen = width < self.width
        self.kind[chosen], self.explained[chosen], self.width[chosen] = kind, explained[chosen], width[chosen]
        self.mean[:, chosen], self.sigma[:, chosen] = mean[:, chosen], sigma[:, chosen]


def estimates_with_derivatives(scene, x: np.ndarray, y: np.ndarray, slopes: np.ndarray) -> RegressionEstimates | None:
    """Estimates of k outputs; ``"plain"`` if no regression has a narrower interval than the samples alone.

    Parameters
    ----------
    scene : mic.scene.Scene
    x, y : (n, p), (n, k) array
        Deviations and outputs.
    slopes : (n, k, p) array
        Derivatives of the outputs, per unit of the deviations. Samples with values that are not finite are excluded.

    Returns
    -------
    RegressionEstimates or None
        None if the deviations' moments are not known: these need independent samples of uncorrelated normal and uniform
        deviations.
    """
    kurtosis = _kurtosis(scene)
    if kurtosis is None:
        return None
    mean_of, sigma_of = np.array([[item.mean, item.sigma] for item in scene.deviations]).T
    varying = sigma_of > 0
    known = np.isfinite(y).all(axis=1) & np.isfinite(slopes[:, :, varying]).all(axis=(1, 2))
    x, y, slopes = x[known], y[known], slopes[known]
    n, p = len(y), int(varying.sum())
    if n < LEAST or not p:
        return RegressionEstimates.plain(np.full(y.shape[1], np.inf))
    t = (x[:, varying] - mean_of[varying]) / sigma_of[varying]
    scaled = np.moveaxis(slopes[:, :, varying] * sigma_of[varying], 1, 2)  # (n, p, k)
    plain = estimates.sigma(y)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.asarray(np.log(plain.high) - np.log(plain.low))
    best = RegressionEstimates.plain(np.where(np.isfinite(width), width, np.inf))
    for kind in ("linear", "quadratic") if p <= QUADRATIC else ("linear",):
        values = _orthonormal_functions(t, kurtosis[varying], kind == "quadratic")
        needed = EQUATIONS_PER_COEFFICIENT * values.shape[1] + FURTHER_EQUATIONS
        if n * (1 + p) < needed:
            continue
        gradients = _gradients(t, kurtosis[varying], kind == "quadratic")
        mean, sigma, explained = _intervals(values, gradients, y, scaled)
        with np.errstate(divide="ignore", invalid="ignore"):
            width = np.log(sigma[2]) - np.log(sigma[1])
        best.offer(kind, width, mean, sigma, explained)
    return best


def _kurtosis(scene) -> np.ndarray | None:
    """(p,) κ of the deviations; None if their moments are not known."""
    independent = scene.monte_carlo.design == "independent" and scene.monte_carlo.values is None
    found = [
        KURTOSIS.get(item.distribution) if item.truncated is None and getattr(item, "scores", None) is None else None
        for item in scene.deviations
    ]
    if not found or None in found or scene.correlations or not independent:
        return None
    return np.array(found, dtype=float)


def _orthonormal_functions(t: np.ndarray, kurtosis: np.ndarray, quadratic: bool) -> np.ndarray:
    """(n, q) functions φ of the inputs t (n, p) in standard deviations."""
    if not quadratic:
        return t
    i, j = np.triu_indices(t.shape[1], 1)
    return np.column_stack([t, (t**2 - 1) / np.sqrt(kurtosis - 1), t[:, i] * t[:, j]])


def _gradients(t: np.ndarray, kurtosis: np.ndarray, quadratic: bool) -> np.ndarray:
    """Derivatives (n, p, q) of φ with respect to the inputs in standard deviations t (n, p)."""
    n, p = t.shape
    if not quadratic:
        return np.broadcast_to(np.eye(p), (n, p, p))
    i, j = np.triu_indices(p, 1)
    inputs, pair = np.arange(p), 2 * p + np.arange(len(i))
    gradients = np.zeros((n, p, 2 * p + len(i)))
    gradients[:, inputs, inputs] = 1.0
    gradients[:, inputs, p + inputs] = 2 * t / np.sqrt(kurtosis - 1)
    gradients[:, i, pair] = t[:, j]
    gradients[:, j, pair] = t[:, i]
    return gradients


def _intervals(values, gradients, y, slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and σ (3, k) with jackknife intervals (for σ on the logarithm), and the explained share (k,)."""
    n, groups = len(y), min(GROUPS, len(y))
    group = np.arange(n) % groups
    arrays = values, gradients, y, slopes
    mean, sigma, explained = _cross_fit(*arrays)
    without = [_cross_fit(*(array[group != g] for array in arrays)) for g in range(groups)]
    quantile = stdtrit(FOLDS - 1, 0.5 + LEVEL / 2)  # samples of a fold share their coefficients
    half = quantile * jackknife_error(np.array([fit[0] for fit in without]), ADDED)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.exp(quantile * jackknife_error(np.log([fit[1] for fit in without]), ADDED))
    return np.array([mean, mean - half, mean + half]), np.array([sigma, sigma / factor, sigma * factor]), explained


def _cross_fit(values, gradients, y, slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, σ and explained share (k,), each fold with the coefficients of all others."""
    n, q, k = len(y), values.shape[1], y.shape[1]
    fold = np.arange(n) % FOLDS
    residual, predicted, square = np.empty((n, k)), np.empty((n, k)), np.zeros(k)
    for f in range(FOLDS):
        test, training = fold == f, fold != f
        rows = np.concatenate([values[training] - values[training].mean(axis=0), gradients[training].reshape(-1, q)])
        right = np.concatenate([y[training] - y[training].mean(axis=0), slopes[training].reshape(-1, k)])
        b = np.linalg.lstsq(rows, right, rcond=None)[0]
        predicted[test] = values[test] @ b
        residual[test] = y[test] - predicted[test]
        square += test.sum() / n * (b**2).sum(axis=0)
    mean = residual.mean(axis=0)
    centred = residual - mean
    unexplained = (centred**2).sum(axis=0) / (n - 1)
    variance = np.maximum(square + unexplained + 2 * (predicted * centred).sum(axis=0) / (n - 1), unexplained)
    with np.errstate(divide="ignore", invalid="ignore"):
        return mean, np.sqrt(variance), 1 - unexplained / variance
