"""First-order and total Sobol indices from samples.

Written here because scipy.stats.sobol_indices and SALib have no control variate, excluded samples or BC_a intervals.

Jansen's estimators [1]_, [2]_ use two independent sets of samples ``a`` and ``b``, and sets ``m_i`` equal to ``a`` with
input i taken from ``b``:

    V S_i = V − ½ E (y_b − y_mi)²          V T_i = ½ E (y_a − y_mi)²

S_i is the share of input i alone, T_i includes its interactions. An input may be a group of numbers, independent of
all others.

The linear part has no sampling noise: for ``l = Σ_i γ_i(x_i)`` the same expectations are
``Σ_{j≠i} v_j`` and ``v_i`` with ``v_i = Var γ_i``, so that only the rest is estimated (control variate).

References
----------
.. [1] M. J. W. Jansen: Analysis of variance designs for model output, Comput. Phys. Commun. 117 (1999) 35-43.
.. [2] A. Saltelli et al.: Variance based sensitivity analysis of model output. Design and estimator for the total
       sensitivity index, Comput. Phys. Commun. 181 (2010) 259-270.
.. [3] B. Efron: Better bootstrap confidence intervals, J. Am. Stat. Assoc. 82 (1987) 171-185.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from mic.statistics.estimates import LEVEL, Estimate

__all__ = ["Indices", "Linear", "sobol"]

RESAMPLES = 1000  # bootstrap resamples
WEIGHTS = 2_000_000  # weights of resamples held in memory
ROUNDING = 1e-12  # relative to the largest output; smaller variation counts as none


@dataclass(frozen=True)
class Linear:
    """Linear part of k outputs by g inputs (control variate).

    Attributes
    ----------
    a, b : (g, n, k) array
        γ_i at the two sets of samples.
    variance, error : (g, k) array
        v_i, and its standard error.
    """

    a: np.ndarray
    b: np.ndarray
    variance: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class Indices:
    """Indices of g inputs on k outputs with bootstrap intervals; NaN if an output does not vary.

    Attributes
    ----------
    first, total : Estimate of (g, k) arrays
        S and T. They are not clipped to 0 … 1; values outside show the noise.
    interaction : Estimate of (k,) arrays
        Largest T_i − S_i.
    sigma : Estimate of (k,) arrays
        √V, in the unit of the outputs.
    """

    first: Estimate
    total: Estimate
    interaction: Estimate
    sigma: Estimate


def sobol(a, b, mixed, linear: Linear) -> Indices:
    """Sobol indices and their intervals.

    Parameters
    ----------
    a, b : (n, k) array
        Outputs of two independent sets of samples.
    mixed : (g, n, k) array
        Outputs of the first set with one input of the second, input by input.
    linear : Linear

    Notes
    -----
    Samples with an output that is not finite are excluded everywhere and counted.
    """
    a, b, mixed = (np.asarray(x, dtype=float) for x in (a, b, mixed))
    known = np.isfinite(a).all(1) & np.isfinite(b).all(1) & np.isfinite(mixed).all(2).all(0)
    n, (g, _, k) = int(known.sum()), mixed.shape
    if n < 2:
        by_input, by_output = (_estimate(x, x, x, n, len(a) - n) for x in (np.full((g, k), np.nan), np.full(k, np.nan)))
        return Indices(by_input, by_input, by_output, by_output)
    a, b, mixed, γ_a, γ_b = a[known], b[known], mixed[:, known], linear.a[:, known], linear.b[:, known]
    l_a, l_b = γ_a.sum(axis=0), γ_b.sum(axis=0)
    l_mixed = l_a - γ_a + γ_b
    # Terms averaged over the samples, (n, g, k): squares minus those of the linear part.
    first_term = np.moveaxis((b - mixed) ** 2 - (l_b - l_mixed) ** 2, 0, 1) / 2
    total_term = np.moveaxis((a - mixed) ** 2 - (l_a - l_mixed) ** 2, 0, 1) / 2
    y, l = (np.stack(pair, axis=1) for pair in ((a, b), (l_a, l_b)))
    y, l = y - y.mean(axis=0), l - l.mean(axis=0)
    square = y**2 - l**2

    def estimates(weights: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(r, g, k) first and total, (r, k) variance, of r weightings (r, n) of the samples, and v (r, g, k)."""
        mean = lambda x: np.tensordot(weights, x, axes=1)
        spread = (mean(square) - mean(y) ** 2 + mean(l) ** 2).mean(axis=1)
        whole = v.sum(axis=1)
        V = n / (n - 1) * spread + whole
        V = np.where(V > 0, V, np.nan)
        first = 1 - (mean(first_term) + whole[:, None] - v) / V[:, None]
        return first, (mean(total_term) + v) / V[:, None], V

    first, total, V = (x[0] for x in estimates(np.full((1, n), 1 / n), linear.variance[None]))
    stream = np.random.Generator(np.random.Philox(key=n))
    draws, batch = [], max(1, WEIGHTS // n)
    for start in range(0, RESAMPLES, batch):
        r = min(batch, RESAMPLES - start)
        weights = stream.multinomial(n, np.full(n, 1 / n), size=r) / n
        v = np.maximum(linear.variance + linear.error * stream.standard_normal((r, g, 1)), 0.0)
        draws.append(estimates(weights, v))
    firsts, totals, Vs = (np.concatenate(drawn) for drawn in zip(*draws))
    # Influence functions of the estimates, (n, g, k) and (n, k).
    q = square.mean(axis=1)
    on_V = (q - q.mean(axis=0)) / V
    on_first = -(first_term - first_term.mean(axis=0)) / V + (1 - first) * on_V[:, None]
    on_total = (total_term - total_term.mean(axis=0)) / V - total * on_V[:, None]
    constant = ~(np.sqrt(V) > ROUNDING * np.abs(np.concatenate([a, b])).max(axis=0))

    def estimate(value: np.ndarray, drawn: np.ndarray, influence: np.ndarray) -> Estimate:
        low, high = _interval(value, drawn, influence)
        value, low, high = (np.where(constant, np.nan, x) for x in (value, low, high))
        return _estimate(value, low, high, n, len(known) - n)

    gap, gaps, on_gap = total - first, totals - firsts, on_total - on_first
    largest = np.expand_dims(np.nan_to_num(gap).argmax(axis=0), 0)
    pick = lambda x: np.take_along_axis(x, largest.reshape((1,) * (x.ndim - 2) + largest.shape), axis=-2)[..., 0, :]
    return Indices(
        estimate(first, firsts, on_first),
        estimate(total, totals, on_total),
        estimate(pick(gap), pick(gaps), pick(on_gap)),
        estimate(np.sqrt(V), np.sqrt(Vs), on_V / 2),
    )


def _interval(value: np.ndarray, drawn: np.ndarray, influence: np.ndarray) -> list[np.ndarray]:
    """Ends of the BC_a bootstrap interval of values (...), corrected for bias and skewness [3]_.

    Parameters
    ----------
    value : (...) array
    drawn : (r, ...) array
        Bootstrap replicates.
    influence : (n, ...) array
        Influence function of the value at each sample.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        below = np.clip((drawn < value).mean(axis=0) + (drawn == value).mean(axis=0) / 2, 1e-3, 1 - 1e-3)
        bias = ndtri(below)
        skew = np.nan_to_num((influence**3).sum(axis=0) / (6 * (influence**2).sum(axis=0) ** 1.5))
    ordered, ends = np.sort(drawn, axis=0), []
    for tail in ((1 - LEVEL) / 2, (1 + LEVEL) / 2):
        z = bias + ndtri(tail)
        place = ndtr(bias + z / (1 - skew * z)) * (len(drawn) - 1)
        lower = np.floor(place).astype(int)
        upper = np.minimum(lower + 1, len(drawn) - 1)
        below, above = (np.take_along_axis(ordered, index[None], axis=0)[0] for index in (lower, upper))
        ends.append(below + (place - lower) * (above - below))
    return ends


def _estimate(value, low, high, used: int, excluded: int) -> Estimate:
    return Estimate(value, low, high, np.array(used), np.array(excluded))
