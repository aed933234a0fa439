"""Distributions of deviations: those of SciPy by name, shifted and scaled to the deviation's mean and sigma.

With the quantile function ``F⁻¹`` of the distribution, its mean m and its standard deviation s, a deviation of mean μ
and standard deviation σ is

    x(u) = μ + σ (F⁻¹(u) − m)/s,        u uniform in (0, 1).                                            (1)

Truncated to [a, b], ``u`` is taken between ``F(m + s (a − μ)/σ)`` and the same of b.
"""

from __future__ import annotations

import difflib
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

__all__ = ["check_distribution", "normal_scores", "quantile"]

NORMAL = "normal"  # SciPy: "norm"
LEAST = 1e-6  # probability of the interval of a truncated distribution, at least
EDGE = 1e-16  # distance of probabilities from 0 and 1, so that every quantile is finite


class _Normal:
    """The standard normal distribution with SciPy's functions, without the slow import of `scipy.stats`."""

    cdf, ppf = staticmethod(ndtr), staticmethod(ndtri)


@lru_cache(maxsize=256)
def _standard(name: str, parameters: tuple[tuple[str, float], ...]) -> tuple[Any, float, float]:
    """A distribution of SciPy with its shape parameters, its mean and its standard deviation.

    Raises
    ------
    ValueError
        If there is no such distribution, for wrong parameters, or without mean and standard deviation.
    """
    if name == NORMAL and not parameters:
        return _Normal, 0.0, 1.0
    from scipy import stats  # slow to import: see _Normal

    family = stats.norm if name == NORMAL else getattr(stats, name, None)
    if not isinstance(family, stats.rv_continuous):
        every = [NORMAL, *(key for key in vars(stats) if isinstance(getattr(stats, key), stats.rv_continuous))]
        near = difflib.get_close_matches(name, every, 1)
        raise ValueError(
            f"distribution: scipy.stats has no continuous distribution {name!r}"
            + (f"; did you mean {near[0]!r}?" if near else "; normal, uniform, triang, lognorm, … are some")
        )
    shapes, given = [word.strip() for word in (family.shapes or "").split(",") if word.strip()], dict(parameters)
    if {"loc", "scale"} & given.keys():
        raise ValueError("parameters: loc and scale follow from mean and sigma: remove them")
    if set(shapes) != set(given):
        expected = f"the parameters {', '.join(shapes)}" if shapes else "no parameters"
        raise ValueError(f"parameters: {name!r} has {expected}, given are {', '.join(given) or 'none'}; correct them")
    frozen = family(**given)
    mean, deviation = (float(value) for value in (frozen.mean(), frozen.std()))
    if not np.isfinite(frozen.ppf(0.5)):
        values = ", ".join(f"{key} = {value:g}" for key, value in given.items())
        raise ValueError(f"parameters: there is no {name!r} with {values}; correct them")
    if not (np.isfinite(mean) and np.isfinite(deviation) and deviation > 0):
        raise ValueError(f"distribution: {name!r} has no standard deviation; choose another")
    return frozen, mean, deviation


def _distribution(item) -> tuple[Any, float, float]:
    return _standard(item.distribution, tuple(item.parameters.items()))


def _probabilities(item) -> tuple[float, float]:
    """Probabilities of the limits of a deviation: 0 and 1 unless truncated."""
    if item.truncated is None:
        return 0.0, 1.0
    frozen, mean, deviation = _distribution(item)
    ends = mean + deviation * (np.array(item.truncated) - item.mean) / item.sigma
    low, high = frozen.cdf(ends)
    return float(low), float(high)


def check_distribution(item) -> None:
    """Raise ValueError, with the remedy, if a deviation's distribution does not exist."""
    _distribution(item)
    if item.truncated is None:
        return
    low, high = item.truncated
    if item.sigma == 0.0:
        raise ValueError("truncated: sigma is 0, so it has no effect; remove it")
    if low >= high:
        raise ValueError(f"truncated: the smallest value {low:g} must lie below the largest {high:g}; correct them")
    first, last = _probabilities(item)
    if last - first < LEAST:
        raise ValueError(
            f"truncated: less than {LEAST:g} of the distribution lies between {low:g} and {high:g}; correct them, or "
            "mean and sigma"
        )


def quantile(item, u: np.ndarray) -> np.ndarray:
    """(n,) values of a deviation at probabilities u, equation (1).

    Parameters
    ----------
    item
        The scene's deviation.
    u : (n,) array
    """
    frozen, mean, deviation = _distribution(item)
    low, high = _probabilities(item)
    return item.mean + item.sigma * (frozen.ppf(np.clip(low + u * (high - low), EDGE, 1 - EDGE)) - mean) / deviation


def normal_scores(item, x: np.ndarray) -> np.ndarray:
    """(n,) standard normal numbers ``Φ⁻¹(u)`` whose probabilities u give values (n,) of a deviation by equation (1).

    Values beyond a truncation, or beyond the distribution, have scores of about ±8.
    """
    frozen, mean, deviation = _distribution(item)
    low, high = _probabilities(item)
    u = (frozen.cdf(mean + deviation * (x - item.mean) / item.sigma) - low) / (high - low)
    return np.asarray(ndtri(np.clip(u, EDGE, 1 - EDGE)))
