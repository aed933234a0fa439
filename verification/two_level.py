"""Two-level regression (control-variate) estimate from N cheap and n expensive samples.

Each of N samples has a cheap result y (the reduced model); n of them also have the expensive result x (the full finite
elements). With

    x = α + β y + e,        e of zero mean and variance σ_e², given y,

and least squares over the n pairs (β̂, residual variance s_e² with n − 2 degrees of freedom, S_yy = Σ (y_j − ȳ_n)²),

    mean      μ̂  = x̄_n + β̂ (ȳ_N − ȳ_n)                                                                     (1)
              var μ̂ = s_e² [1/n + (ȳ_N − ȳ_n)²/S_yy] + β̂² s_y²/N
    variance  σ̂² = (β̂² − s_e²/S_yy) s_y² + s_e²,       s_e²/S_yy being the bias of β̂²                       (2)
              var σ̂² = 4 β̂² s_y⁴ s_e²/S_yy + (1 − s_y²/S_yy)² 2 s_e⁴/(n − 2) + β̂⁴ var s_y²
              var s_y² = [m₄ − s_y⁴ (N − 3)/(N − 1)]/N,     m₄ the fourth central moment

Intervals are Student's with Welch–Satterthwaite degrees of freedom; that of σ is computed for ln σ, so that it is
positive. The n samples need not be random: (1) and (2) are conditional on y, so samples may be *chosen by y*. Extreme
samples increase S_yy and the precision of β̂, but then the result relies on the linearity of the relation. If y does not
vary over the n samples, β = 1 and the residuals have n − 1 degrees of freedom.

The errors of the cheap results, ȳ_N − μ̂ and s_y − σ̂, have a smaller variance than μ̂ and σ̂, because both use the same N
samples: sampling errors contribute only as far as the slope differs from 1,

    var (ȳ_N − μ̂) = s_e² [1/n + (ȳ_N − ȳ_n)²/S_yy] + (1 − β̂)² s_y²/N                                         (3)
    var (s_y − σ̂) = [the first two terms of var σ̂²]/(4 σ̂²) + (1 − β̂² s_y/σ̂)² var s_y²/(4 s_y²)

References
----------
Cochran (1977), Sampling Techniques, 3rd ed., Wiley, chapter 7: regression estimators.
Lavenberg, Welch (1981), A perspective on the use of control variables …, Management Science 27, 322–335: the interval
of (1). Peherstorfer, Willcox, Gunzburger (2018), Survey of multifidelity methods …, SIAM Review 60, 550–591.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from mic.statistics.estimates import LEVEL, Estimate

__all__ = ["TwoLevel", "two_level"]


@dataclass(frozen=True)
class TwoLevel:
    """Corrected statistics of one quantity.

    Attributes
    ----------
    mean, sigma : Estimate
        In the unit of the samples; `used` counts the expensive samples. Intervals are NaN with fewer than three.
    mean_error, sigma_error : Estimate
        Mean and standard deviation of the cheap samples minus those above.
    slope : float
        β̂.
    residual : float
        s_e, in the unit of the samples: standard deviation of the residuals.
    worth : float
        Number of expensive samples that would give the same variance of the mean without cheap ones.
    """

    mean: Estimate
    sigma: Estimate
    mean_error: Estimate
    sigma_error: Estimate
    slope: float
    residual: float
    worth: float

    @property
    def six_sigma(self) -> Estimate:
        """Six standard deviations."""
        return _six(self.sigma)

    @property
    def six_sigma_error(self) -> Estimate:
        """Error of six standard deviations of the cheap samples."""
        return _six(self.sigma_error)


def two_level(cheap, chosen, dear, level: float = LEVEL) -> TwoLevel:
    """Combine N cheap results with n expensive ones.

    Parameters
    ----------
    cheap : (N,) array
        y, all finite.
    chosen : (n,) int array
        Indices of the samples with an expensive result; each once.
    dear : (n,) array
        x of these samples.
    level : float
        Confidence level.

    Raises
    ------
    ValueError
        Without expensive results, with fewer than two cheap ones, or with values that are not finite.
    """
    y_all, x = np.asarray(cheap, dtype=float), np.asarray(dear, dtype=float)
    y = y_all[np.asarray(chosen, dtype=int)]
    N, n = len(y_all), len(x)
    if n < 1 or N < 2 or len(y) != n:
        raise ValueError(
            f"two-level estimate: got {N} cheap and {n} expensive results for {len(y)} chosen samples; at least 2 "
            "and 1 are needed"
        )
    if not (np.isfinite(y_all).all() and np.isfinite(x).all()):
        raise ValueError("two-level estimate: results must be finite; remove failed samples")
    centred = y_all - y_all.mean()
    s_y2 = centred @ centred / (N - 1)
    var_s_y2 = max(0.0, ((centred**4).mean() - s_y2**2 * (N - 3) / (N - 1)) / N)
    S_yy = float(((y - y.mean()) ** 2).sum())
    varies = n > 2 and S_yy > 1e-20 * n * max(np.abs(y_all).max() ** 2, 1e-300)
    slope = float((y - y.mean()) @ (x - x.mean()) / S_yy) if varies else 1.0
    freedom = n - 2 if varies else n - 1
    e = x - x.mean() - slope * (y - y.mean())
    s_e2 = float(e @ e / freedom) if n > 1 else 0.0
    per_S = 1 / S_yy if varies else 0.0
    off = y_all.mean() - y.mean()

    mean = x.mean() + slope * off
    mean_parts = np.array([s_e2 * (1 / n + off**2 * per_S), slope**2 * s_y2 / N])
    variance = max(slope**2 - s_e2 * per_S, 0.0) * s_y2 + s_e2
    variance_parts = np.array(
        [
            4 * slope**2 * s_y2**2 * s_e2 * per_S + (1 - s_y2 * per_S) ** 2 * 2 * s_e2**2 / max(freedom, 1),
            slope**4 * var_s_y2,
        ]
    )
    sigma = np.sqrt(variance)
    nan = n < 3
    half = np.nan if nan else _half_width(mean_parts, (freedom, N - 1), level)
    share = np.nan if nan or variance == 0 else _half_width(variance_parts, (freedom, N - 1), level) / (2 * variance)
    s_y = np.sqrt(s_y2)
    mean_off, sigma_off = _errors(slope, mean_parts, variance_parts, s_y, sigma, var_s_y2, N)
    off_half = [np.nan if nan else _half_width(parts, (freedom, N - 1), level) for parts in (mean_off, sigma_off)]
    worth = variance / mean_parts.sum() if mean_parts.sum() > 0 else float("inf")
    with np.errstate(over="ignore"):
        return TwoLevel(
            Estimate(float(mean), float(mean - half), float(mean + half), n, N - n),
            Estimate(float(sigma), float(sigma * np.exp(-share)), float(sigma * np.exp(share)), n, N - n),
            _about(float(y_all.mean() - mean), off_half[0], n, N),
            _about(float(s_y - sigma), off_half[1], n, N),
            slope,
            float(np.sqrt(s_e2)),
            float(worth),
        )


def _errors(slope, mean_parts, variance_parts, s_y, sigma, var_s_y2, N):
    """The two parts of each variance of (3), from the expensive and from the cheap samples."""
    mean = np.array([mean_parts[0], (1 - slope) ** 2 * s_y**2 / N])
    if sigma == 0 or s_y == 0:
        return mean, np.zeros(2)
    share = (1 - slope**2 * s_y / sigma) ** 2
    return mean, np.array([variance_parts[0] / (4 * sigma**2), share * var_s_y2 / (4 * s_y**2)])


def _about(value, half, n, N):
    return Estimate(value, value - half, value + half, n, N - n)


def _six(s):
    return Estimate(6 * s.value, 6 * s.low, 6 * s.high, s.used, s.excluded)


def _half_width(parts, freedoms, level):
    """Half the width of Student's interval of a sum of independently estimated variances."""
    total = parts.sum()
    if total == 0:
        return 0.0
    freedom = total**2 / (parts**2 / np.asarray(freedoms, dtype=float)).sum()
    return float(stdtrit(freedom, 0.5 + level / 2) * np.sqrt(total))
