r"""Mean and 6σ from few samples whose exact derivatives are known: a regression on values and derivatives alike.

With functions ``φ_j`` of mean 0 and orthonormal as :mod:`mic.statistics.regression` has them, each sample with its p
derivatives gives 1 + p equations for the coefficients b, so that there may be more inputs than samples. For any b

.. math::

    E\,y = E\,(y - φ b), \qquad \mathrm{Var}\,y = \sum b_j^2 + \mathrm{Var}\,r + 2\,\mathrm{Cov}(φ b, r), \qquad
    r = y - φ b,

and only the last two terms are left to chance. They are taken of samples that had no part in finding b, group by group,
each with the b of all others (cross-fitting [1]_), so that the groups' estimates are unbiased whatever b is, and their
scatter is that of the mean of them.

References
----------
.. [1] V. Chernozhukov et al.: Double/debiased machine learning for treatment and structural parameters, Econom. J. 21
       (2018) C1-C68, section 3.
"""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from mic.statistics.estimates import LEVEL
from mic.statistics.estimates import sigma as plain_sigma
from mic.statistics.regression import EACH, KINDS, MORE, QUADRATIC, Improved, Regression

__all__ = ["by_slopes"]

GROUPS = 20  # that the jackknife leaves out in turn
FOLDS = 5
LEAST = 20  # samples: with fewer the jackknife does not tell how uncertain it is


def by_slopes(scene, x: np.ndarray, y: np.ndarray, slopes: np.ndarray, level: float = LEVEL) -> Improved | None:
    """Estimates of k outputs; ``"plain"`` where no regression is narrower than the samples alone.

    Parameters
    ----------
    scene : mic.scene.Scene
    x, y : (n, p), (n, k) array
        Deviations and outputs.
    slopes : (n, k, p) array
        Derivatives of the outputs, per unit of the deviations. Samples with anything that is not finite are left out.

    Returns
    -------
    Improved or None
        None where the deviations' moments are not known (:meth:`mic.statistics.regression.Regression.of`).
    """
    moments = Regression.of(scene)
    if moments is None:
        return None
    own = moments.sigma > 0
    known = np.isfinite(y).all(axis=1) & np.isfinite(slopes[:, :, own]).all(axis=(1, 2))
    x, y, slopes = x[known], y[known], slopes[known]
    n, k, p = len(y), y.shape[1], int(own.sum())
    best = Improved.none(k)
    if n < LEAST or not p:
        return best
    t = (x[:, own] - moments.mean[own]) / moments.sigma[own]
    turned = np.moveaxis(slopes[:, :, own] * moments.sigma[own], 1, 2)  # (n, p, k)
    told = plain_sigma(y, level)
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.asarray(np.log(told.high) - np.log(told.low))
    least = np.where(np.isfinite(least), least, np.inf)
    for kind in KINDS if p <= QUADRATIC else KINDS[:1]:
        values, gradients = _functions(t, moments.kurtosis[own], kind == "quadratic")
        if n * (1 + p) < EACH * values.shape[1] + MORE:
            continue
        mean, spread, explained = _intervals(values, gradients, y, turned, level)
        with np.errstate(divide="ignore", invalid="ignore"):
            width = np.log(spread[2]) - np.log(spread[1])
        better = width < least
        least = np.where(better, width, least)
        best.kind[better], best.explained[better] = kind, explained[better]
        best.mean[:, better], best.sigma[:, better] = mean[:, better], spread[:, better]
    return best


def _functions(t: np.ndarray, kurtosis: np.ndarray, quadratic: bool) -> tuple[np.ndarray, np.ndarray]:
    """φ (n, q) and its derivatives (n, p, q) with respect to the inputs in standard deviations t (n, p)."""
    n, p = t.shape
    if not quadratic:
        return t, np.broadcast_to(np.eye(p), (n, p, p))
    scale = np.sqrt(kurtosis - 1)
    i, j = np.triu_indices(p, 1)
    values = np.column_stack([t, (t**2 - 1) / scale, t[:, i] * t[:, j]])
    gradients = np.zeros((n, p, values.shape[1]))
    every, pair = np.arange(p), 2 * p + np.arange(len(i))
    gradients[:, every, every] = 1.0
    gradients[:, every, p + every] = 2 * t / scale
    gradients[:, i, pair] = t[:, j]
    gradients[:, j, pair] = t[:, i]
    return values, gradients


def _intervals(values, gradients, y, slopes, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and σ (3, k) with the jackknife's intervals, of σ of its logarithm, and the explained share (k,)."""
    n, groups = len(y), min(GROUPS, len(y))
    group = np.arange(n) % groups
    arrays = values, gradients, y, slopes
    mean, sigma, explained = _crossed(*arrays)
    without = [_crossed(*(one[group != g] for one in arrays)) for g in range(groups)]
    quantile = stdtrit(FOLDS - 1, 0.5 + level / 2)  # samples share their coefficients fold by fold

    def half(others):
        return quantile * np.sqrt((groups - 1) / groups * ((others - others.mean(axis=0)) ** 2).sum(axis=0))

    of_mean = half(np.array([one[0] for one in without]))
    with np.errstate(divide="ignore", invalid="ignore"):
        wide = np.exp(half(np.log([one[1] for one in without])))
    return np.array([mean, mean - of_mean, mean + of_mean]), np.array([sigma, sigma / wide, sigma * wide]), explained


def _crossed(values, gradients, y, slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, σ and explained share (k,), each fold with the coefficients of all others."""
    n, q, k = len(y), values.shape[1], y.shape[1]
    fold = np.arange(n) % FOLDS
    rest, foretold, square = np.empty((n, k)), np.empty((n, k)), np.zeros(k)
    for f in range(FOLDS):
        kept = fold != f
        rows = np.concatenate([values[kept] - values[kept].mean(axis=0), gradients[kept].reshape(-1, q)])
        right = np.concatenate([y[kept] - y[kept].mean(axis=0), slopes[kept].reshape(-1, k)])
        b = np.linalg.lstsq(rows, right, rcond=None)[0]
        foretold[~kept] = values[~kept] @ b
        rest[~kept] = y[~kept] - foretold[~kept]
        square += (~kept).sum() / n * (b**2).sum(axis=0)
    mean = rest.mean(axis=0)
    off = rest - mean
    left = (off**2).sum(axis=0) / (n - 1)
    variance = np.maximum(square + left + 2 * (foretold * off).sum(axis=0) / (n - 1), left)
    with np.errstate(divide="ignore", invalid="ignore"):
        return mean, np.sqrt(variance), 1 - left / variance
