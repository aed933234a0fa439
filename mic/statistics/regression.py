r"""Mean and 6σ by regression on the deviations, whose moments are known (control variate).

With functions ``φ_j`` of independent inputs that have mean 0 and are orthonormal (the inputs in standard deviations;
for second order also ``(t_i² - 1)/\sqrt{κ_i - 1}`` and ``t_i t_j``), a regression ``y = a + Σ b_j φ_j + r`` removes
the sampling noise of the part that it explains [1]_:

.. math::

    E\,y = a, \qquad \mathrm{Var}\,y = \sum b_j^2 - s^2 \, \mathrm{tr} (Z^T Z)^{-1} + s^2,

``s²`` is the variance of the residuals r for the regression's degrees of freedom; the second term removes the noise of
the squared coefficients; Z holds the functions at the samples. Intervals are those of the jackknife over groups of
samples [2]_, for σ on the logarithm.

A regression needs three samples per coefficient and ten more. The estimate with the narrowest interval is used: linear,
quadratic, or the plain one of the samples.

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

from mic.statistics.estimates import LEVEL, jackknife_error

__all__ = ["Regression", "RegressionEstimates", "kurtosis", "orthonormal_functions"]

GROUPS = 20  # groups of the jackknife
SAMPLES_PER_COEFFICIENT, FURTHER_SAMPLES = 3, 10  # that a regression needs
QUADRATIC = 20  # inputs of a quadratic regression, at most: 230 functions
KINDS = ("linear", "quadratic")


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


def kurtosis(item) -> float | None:
    """κ of a normal or uniform deviation; None for other distributions.

    Parameters
    ----------
    item
        One of the scene's deviations.
    """
    known = {"normal": 3.0, "uniform": 1.8}
    whole = getattr(item, "truncated", None) is None and getattr(item, "scores", None) is None
    return known.get(item.distribution) if whole else None


def orthonormal_functions(t: np.ndarray, kurtosis: np.ndarray, quadratic: bool) -> np.ndarray:
    """(n, q) functions φ of the inputs t (n, p) in standard deviations."""
    if not quadratic:
        return t
    i, j = np.triu_indices(t.shape[1], 1)
    return np.column_stack([t, (t**2 - 1) / np.sqrt(kurtosis - 1), t[:, i] * t[:, j]])


@dataclass
class Regression:
    """Sums over samples, accumulated block by block (numpy: a library fit would need all samples in memory).

    Attributes
    ----------
    mean, sigma, kurtosis : (p,) array
        Moments of the inputs; inputs without standard deviation are ignored.
    """

    mean: np.ndarray
    sigma: np.ndarray
    kurtosis: np.ndarray
    _sums: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def of(cls, scene) -> Regression | None:
        """An empty regression for a scene; None if the moments of its deviations are not known.

        Known moments need independent samples of uncorrelated normal and uniform deviations.
        """
        moments = [kurtosis(item) for item in scene.deviations]
        drawn = scene.monte_carlo.design == "independent" and scene.monte_carlo.values is None
        if not moments or None in moments or scene.correlations or not drawn:
            return None
        mean, sigma = np.array([[item.mean, item.sigma] for item in scene.deviations]).T
        return cls(mean, sigma, np.array(moments, dtype=float))

    @property
    def varying(self) -> np.ndarray:
        """(p,) bool: inputs with a standard deviation."""
        return self.sigma > 0

    def add(self, numbers: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        """Add samples.

        Parameters
        ----------
        numbers : (n,) int array
            Numbers of the samples, which assign them to groups.
        x, y : (n, p), (n, k) array
            Inputs and outputs; samples with an output that is not finite are excluded.
        """
        known = np.isfinite(y).all(axis=1)
        t = (x[known][:, self.varying] - self.mean[self.varying]) / self.sigma[self.varying]
        functions = orthonormal_functions(t, self.kurtosis[self.varying], t.shape[1] <= QUADRATIC)
        numbers, rows = numbers[known], np.column_stack([np.ones((len(t), 1)), functions, y[known]])
        if not self._sums:
            self._sums = [np.zeros((rows.shape[1], rows.shape[1])) for _ in range(GROUPS)]
        for group in range(GROUPS):
            members = rows[numbers % GROUPS == group]
            self._sums[group] += members.T @ members

    def estimates(self, level: float = LEVEL) -> RegressionEstimates | None:
        """The estimates with the narrowest intervals; None before samples were added."""
        if not self._sums:
            return None
        sums = np.array(self._sums)
        inputs = int(self.varying.sum())
        counts = (inputs, inputs + inputs * (inputs + 1) // 2)
        k = sums.shape[1] - 1 - (counts[1] if inputs <= QUADRATIC else inputs)
        best = RegressionEstimates.plain(_width(_estimates(sums, 0, k, level)[1]))
        for kind, count in zip(KINDS, counts):
            enough = sums[:, 0, 0].sum() >= SAMPLES_PER_COEFFICIENT * count + FURTHER_SAMPLES
            if count and (kind == "linear" or inputs <= QUADRATIC) and enough:
                mean, sigma, explained = _estimates(sums, count, k, level)
                best.offer(kind, _width(sigma), mean, sigma, explained)
        return best


def _estimates(sums: np.ndarray, count: int, k: int, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and σ (3, k) with their intervals, and explained share (k,), of a regression on the first `count` functions.

    The jackknife of σ uses its logarithm, whose distribution is closer to normal.
    """
    whole = _fit(sums.sum(axis=0), count, k)
    without = [_fit(sums.sum(axis=0) - group, count, k) for group in sums if group[0, 0] > 0]
    g = len(without)
    t = stdtrit(g - 1, 0.5 + level / 2) if g > 1 else np.nan

    def interval(value, others):
        half = t * jackknife_error(others) if g > 1 else np.nan
        return np.array([value, value - half, value + half])

    mean = interval(whole[0], np.array([fit[0] for fit in without]))
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.exp(interval(np.log(whole[1]), np.log([fit[1] for fit in without])))
    return mean, sigma, whole[2]


def _fit(sums: np.ndarray, count: int, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, σ and explained share (k,) of a regression on the first functions, from sums of products."""
    n, q = sums[0, 0], 1 + count
    ZZ, Zy, yy = sums[:q, :q], sums[:q, -k:], sums[-k:, -k:].diagonal()
    inverse = np.linalg.pinv(ZZ, hermitian=True)
    coefficients = inverse @ Zy
    rest = np.maximum(yy - (coefficients * Zy).sum(axis=0), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        s2 = rest / (n - q) if n > q else np.full(k, np.nan)
        variance = (coefficients[1:] ** 2).sum(axis=0) + s2 * (1 - inverse.diagonal()[1:].sum())
        total = (yy - sums[0, -k:] ** 2 / n) / (n - 1)
        return coefficients[0], np.sqrt(np.maximum(variance, s2)), 1 - s2 / total


def _width(sigma: np.ndarray) -> np.ndarray:
    """(k,) widths of the intervals of σ (3, k); infinite if undefined."""
    return np.where(np.isfinite(sigma).all(axis=0), sigma[2] - sigma[1], np.inf)
