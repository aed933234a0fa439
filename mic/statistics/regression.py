r"""Mean and 6σ from few samples: what is smooth in the inputs is known without sampling noise.

The inputs' moments are known. With functions ``φ_j`` of independent inputs, of mean 0 and orthonormal (the inputs in
standard deviations; of second order also ``(t_i² - 1)/\sqrt{κ_i - 1}`` and ``t_i t_j``), a regression ``y = a + Σ b_j
φ_j + r`` leaves to chance only what it does not explain (a control variate [1]_),

.. math::

    E\,y = a, \qquad \mathrm{Var}\,y = \sum b_j^2 - s^2 \, \mathrm{tr} (Z^T Z)^{-1} + s^2,

``s²`` the variance of the residuals r with the regression's freedoms taken off, and the second term the square that
noise adds to the slopes, Z the functions over the samples. Intervals are the jackknife's over groups of samples [2]_,
of ``log σ``.

Few samples determine few slopes: a regression is offered where there are three samples for each and ten more, the
larger one where its interval is the narrower; and none that is not narrower than the plain one.

References
----------
.. [1] R. Y. Rubinstein, R. Marcus: Efficiency of multivariate control variates in Monte Carlo simulation, Oper. Res. 33
       (1985) 661-677.
.. [2] R. G. Miller: The jackknife, a review, Biometrika 61 (1974) 1-15.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from mic.statistics.estimates import LEVEL

__all__ = ["Improved", "Regression", "kurtosis"]

#: Groups of samples that the jackknife leaves out in turn.
GROUPS = 20
#: Samples for each slope of a regression, and more.
EACH, MORE = 3, 10
#: Inputs whose squares and products are taken, at most: they are 230 then.
QUADRATIC = 20
KINDS = ("linear", "quadratic")


@dataclass(frozen=True)
class Improved:
    """Estimates of k outputs.

    Attributes
    ----------
    kind : (k,) object array of {"plain", "linear", "quadratic"}
        What the estimate rests on; ``"plain"`` where no regression is offered or none is narrower, and the rest is NaN.
    explained : (k,) array
        Share of the variance that the regression explains, R² with its freedoms taken off.
    mean, sigma : (3, k) array
        Estimate, and lower and upper end of its interval.
    """

    kind: np.ndarray
    explained: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray

    @classmethod
    def none(cls, k: int) -> Improved:
        """The result without regression, for k outputs."""
        return cls(np.full(k, "plain", dtype=object), np.full(k, np.nan), *np.full((2, 3, k), np.nan))


def kurtosis(item) -> float | None:
    """κ of a deviation whose distribution is symmetric and known; None for others.

    Parameters
    ----------
    item
        One of the scene's deviations.
    """
    known = {"normal": 3.0, "uniform": 1.8}
    whole = getattr(item, "truncated", None) is None and getattr(item, "scores", None) is None
    return known.get(item.distribution) if whole else None


@dataclass
class Regression:
    """Sums over samples, accumulated block by block (numpy: a library fit would need all samples in memory).

    Attributes
    ----------
    mean, sigma : (p,) array
        Of the inputs; inputs without standard deviation take no part.
    kurtosis : (p,) array
        Of the inputs.
    """

    mean: np.ndarray
    sigma: np.ndarray
    kurtosis: np.ndarray
    _sums: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def of(cls, scene) -> Regression | None:
        """For a scene; None where the moments of its deviations are not known: where samples are given, made in groups
        or correlated, or distributions are others than normal and uniform."""
        moments = [kurtosis(item) for item in scene.deviations]
        drawn = scene.monte_carlo.design == "independent" and scene.monte_carlo.values is None
        if not moments or None in moments or scene.correlations or not drawn:
            return None
        mean, sigma = np.array([[item.mean, item.sigma] for item in scene.deviations]).T
        return cls(mean, sigma, np.array(moments, dtype=float))

    def add(self, numbers: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        """Take samples in.

        Parameters
        ----------
        numbers : (n,) int array
            Of the samples: they tell which group each belongs to.
        x, y : (n, p), (n, k) array
            Inputs and outputs; samples with an output that is not finite are left out.
        """
        known = np.isfinite(y).all(axis=1)
        numbers, rows = numbers[known], np.column_stack([self._functions(x[known]), y[known]])
        if not self._sums:
            self._sums = [np.zeros((rows.shape[1], rows.shape[1])) for _ in range(GROUPS)]
        for group in range(GROUPS):
            own = rows[numbers % GROUPS == group]
            self._sums[group] += own.T @ own

    def improved(self, level: float = LEVEL) -> Improved | None:
        """The estimates; None before samples were added."""
        if not self._sums:
            return None
        sums = np.array(self._sums)
        inputs = int((self.sigma > 0).sum())
        slopes = (inputs, inputs + inputs * (inputs + 1) // 2)
        k = sums.shape[1] - 1 - (slopes[1] if inputs <= QUADRATIC else inputs)
        plain = _estimates(sums, 0, k, level)
        best = Improved.none(k)
        least = _width(plain[1])
        for kind, count in zip(KINDS, slopes):
            if count and (kind == "linear" or inputs <= QUADRATIC) and sums[:, 0, 0].sum() >= EACH * count + MORE:
                mean, sigma, explained = _estimates(sums, count, k, level)
                better = _width(sigma) < least
                least = np.where(better, _width(sigma), least)
                best.kind[better], best.explained[better] = kind, explained[better]
                best.mean[:, better], best.sigma[:, better] = mean[:, better], sigma[:, better]
        return best

    def _functions(self, x: np.ndarray) -> np.ndarray:
        """(n, 1 + q) 1, and the orthonormal functions of the inputs."""
        own = self.sigma > 0
        t = (x[:, own] - self.mean[own]) / self.sigma[own]
        found = [np.ones((len(x), 1)), t]
        if t.shape[1] <= QUADRATIC:
            found.append((t**2 - 1) / np.sqrt(self.kurtosis[own] - 1))
            i, j = np.triu_indices(t.shape[1], 1)
            found.append(t[:, i] * t[:, j])
        return np.column_stack(found)


def _estimates(sums: np.ndarray, count: int, k: int, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and σ (3, k) with their intervals, and the explained share (k,), with so many functions.

    Of σ the jackknife is taken of its logarithm, whose distribution is nearer to a normal one.
    """
    whole = _regressed(sums.sum(axis=0), count, k)
    without = [_regressed(sums.sum(axis=0) - one, count, k) for one in sums if one[0, 0] > 0]
    g = len(without)
    t = stdtrit(g - 1, 0.5 + level / 2) if g > 1 else np.nan

    def interval(value, others):
        half = t * np.sqrt((g - 1) / g * ((others - others.mean(axis=0)) ** 2).sum(axis=0)) if g > 1 else np.nan
        return np.array([value, value - half, value + half])

    mean = interval(whole[0], np.array([one[0] for one in without]))
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.exp(interval(np.log(whole[1]), np.log([one[1] for one in without])))
    return mean, sigma, whole[2]


def _regressed(sums: np.ndarray, count: int, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, σ and explained share (k,) of a regression on the first functions, from sums of products."""
    n, q = sums[0, 0], 1 + count
    ZZ, Zy, yy = sums[:q, :q], sums[:q, -k:], sums[-k:, -k:].diagonal()
    inverse = np.linalg.pinv(ZZ, hermitian=True)
    slopes = inverse @ Zy
    rest = np.maximum(yy - (slopes * Zy).sum(axis=0), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        s2 = rest / (n - q) if n > q else np.full(k, np.nan)
        variance = (slopes[1:] ** 2).sum(axis=0) + s2 * (1 - inverse.diagonal()[1:].sum())
        total = (yy - sums[0, -k:] ** 2 / n) / (n - 1)
        return slopes[0], np.sqrt(np.maximum(variance, s2)), 1 - s2 / total


def _width(sigma: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(sigma).all(axis=0), sigma[2] - sigma[1], np.inf)
