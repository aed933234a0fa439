r"""Mean and 6σ from few samples with exact derivatives: regression on values and derivatives.

With functions ``φ_j`` of mean 0 and orthonormal as in :mod:`mic.statistics.regression`, each sample with its p
derivatives gives 1 + p equations for the coefficients b, so there may be more inputs than samples. For any b

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

import numpy as np
from scipy.special import stdtrit

from mic.statistics import estimates, regression
from mic.statistics.estimates import LEVEL, jackknife_error
from mic.statistics.regression import Regression, RegressionEstimates, orthonormal_functions

__all__ = ["estimates_with_derivatives"]

GROUPS = 20  # groups of the jackknife
FOLDS = 5
LEAST = 20  # samples; fewer give no reliable jackknife interval


def estimates_with_derivatives(
    scene, x: np.ndarray, y: np.ndarray, slopes: np.ndarray, level: float = LEVEL
) -> RegressionEstimates | None:
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
        None if the deviations' moments are not known (:meth:`mic.statistics.regression.Regression.of`).
    """
    moments = Regression.of(scene)
    if moments is None:
        return None
    varying = moments.varying
    known = np.isfinite(y).all(axis=1) & np.isfinite(slopes[:, :, varying]).all(axis=(1, 2))
    x, y, slopes = x[known], y[known], slopes[known]
    n, p = len(y), int(varying.sum())
    if n < LEAST or not p:
        return RegressionEstimates.plain(np.full(y.shape[1], np.inf))
    t = (x[:, varying] - moments.mean[varying]) / moments.sigma[varying]
    scaled = np.moveaxis(slopes[:, :, varying] * moments.sigma[varying], 1, 2)  # (n, p, k)
    plain = estimates.sigma(y, level)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.asarray(np.log(plain.high) - np.log(plain.low))
    best = RegressionEstimates.plain(np.where(np.isfinite(width), width, np.inf))
    for kind in regression.KINDS if p <= regression.QUADRATIC else regression.KINDS[:1]:
        values = orthonormal_functions(t, moments.kurtosis[varying], kind == "quadratic")
        needed = regression.SAMPLES_PER_COEFFICIENT * values.shape[1] + regression.FURTHER_SAMPLES
        if n * (1 + p) < needed:
            continue
        gradients = _gradients(t, moments.kurtosis[varying], kind == "quadratic")
        mean, sigma, explained = _intervals(values, gradients, y, scaled, level)
        with np.errstate(divide="ignore", invalid="ignore"):
            width = np.log(sigma[2]) - np.log(sigma[1])
        best.offer(kind, width, mean, sigma, explained)
    return best


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


def _intervals(values, gradients, y, slopes, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and σ (3, k) with jackknife intervals (for σ on the logarithm), and the explained share (k,)."""
    n, groups = len(y), min(GROUPS, len(y))
    group = np.arange(n) % groups
    arrays = values, gradients, y, slopes
    mean, sigma, explained = _cross_fit(*arrays)
    without = [_cross_fit(*(array[group != g] for array in arrays)) for g in range(groups)]
    quantile = stdtrit(FOLDS - 1, 0.5 + level / 2)  # samples of a fold share their coefficients
    half = quantile * jackknife_error(np.array([fit[0] for fit in without]))
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.exp(quantile * jackknife_error(np.log([fit[1] for fit in without])))
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
