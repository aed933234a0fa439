"""Populations of known statistics: kinks, jumps and heavy tails in seven inputs, each with a cheap approximation.

Each output is ``s u + g(v) + h(w)`` with orthonormal combinations u, v, w of six standard normal inputs; in one case v
is the seventh input, which is lognormal. So its distribution is an integral over one or two normal variables, computed
by Gauss-Legendre quadrature between the kinks. The cheap model, which stands for friction in one step, moves kinks by
0.15 and jumps by 0.075 standard deviations and has 0.8 of their effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

__all__ = ["POPULATIONS", "Population", "Truth", "draw", "points"]

NORMAL = 6  # inputs; the seventh one is lognormal
WIDTH = 0.7  # σ of its logarithm
REACH, CELLS, NODES = 8.0, 100, 8  # of the quadrature
IN_TEN, IN_FIFTY = float(ndtri(0.9)), float(ndtri(0.98))  # standard deviations, exceeded once in 10 and in 50 samples


@dataclass(frozen=True)
class Truth:
    """Statistics of an output; `limit` is two standard deviations above the mean, and `outside` the share above it."""

    mean: float
    sigma: float
    limit: float
    outside: float
    low: float
    high: float

    @property
    def cpk(self) -> float:
        """Cpk with the upper limit alone."""
        return (self.limit - self.mean) / (3 * self.sigma)


@dataclass(frozen=True)
class Population:
    """An output and its distribution.

    Attributes
    ----------
    name : str
    s : float
    g, h : callable
        Take values and whether the cheap model is meant.
    kinks : tuple of tuple of float
        Places at which g and h are not smooth.
    lognormal : bool
        Whether v is the logarithm of the lognormal input over :data:`WIDTH`.
    rarest : float
        Probability of the rarest event that changes the output.
    """

    name: str
    s: float
    g: Callable
    h: Callable
    kinks: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    lognormal: bool = False
    rarest: float = 0.5

    def values(self, x: np.ndarray, axes: np.ndarray, cheap: bool = False) -> np.ndarray:
        """Outputs (n,) at inputs (n, 7), with axes (6, 3) of u, v and w."""
        u, v, w = (x[:, :NORMAL] @ axes).T
        if self.lognormal:
            v = np.log(x[:, NORMAL]) / WIDTH
        return self.s * u + self.g(v, cheap) + self.h(w, cheap)

    def truth(self) -> Truth:
        """Its statistics."""
        (v, a), (w, b) = (_quadrature(kinks) for kinks in self.kinks)
        g, h = self.g(v, False), self.h(w, False)
        means = a @ g, b @ h
        mean = float(sum(means))
        sigma = float(np.sqrt(self.s**2 + a @ (g - means[0]) ** 2 + b @ (h - means[1]) ** 2))
        if np.ptp(h) == 0:
            h, b = h[:1], np.ones(1)

        def below(limit: float) -> float:
            return float(a @ ndtr((limit - g[:, None] - h) / self.s) @ b)

        low, high = (
            brentq(lambda x, p=p: below(x) - p, mean - 15 * sigma, mean + 15 * sigma, xtol=1e-6 * sigma)
            for p in (0.00135, 0.99865)
        )
        limit = mean + 2 * sigma
        return Truth(mean, sigma, limit, 1 - below(limit), float(low), float(high))


def _quadrature(kinks: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the mean of a function of a standard normal variable that is smooth between kinks."""
    edges = np.unique(np.concatenate([np.linspace(-REACH, REACH, CELLS + 1), kinks]))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    half, middle = np.diff(edges)[:, None] / 2, (edges[1:] + edges[:-1])[:, None] / 2
    z = (middle + half * nodes).ravel()
    return z, (half * weights).ravel() * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)


def draw(stream: np.random.Generator, count: int) -> np.ndarray:
    """(count, 7) independent inputs."""
    return _inputs(stream.standard_normal((count, NORMAL + 1)))


def points(stream: np.random.Generator, sets: int, count: int) -> np.ndarray:
    """(sets, count, 7) scrambled Sobol sequences of inputs."""
    u = [qmc.Sobol(NORMAL + 1, seed=stream).random(count) for _ in range(sets)]
    return _inputs(ndtri(np.clip(u, 1e-12, 1 - 1e-12)))


def _inputs(z: np.ndarray) -> np.ndarray:
    return np.concatenate([z[..., :NORMAL], np.exp(WIDTH * z[..., NORMAL:])], axis=-1)


def _kink(place: float, effect: float) -> Callable:
    return lambda z, cheap: (0.8 if cheap else 1.0) * effect * np.maximum(z - place - 0.15 * cheap, 0.0)


def _jump(place: float, effect: float) -> Callable:
    return lambda z, cheap: (0.8 if cheap else 1.0) * effect * (z > place + 0.075 * cheap)


def _none(z, cheap):
    return np.zeros_like(z)


def _lognormal(z, cheap):
    x = np.exp(WIDTH * z)
    return x + (0.64 if cheap else 0.8) * np.maximum(x - 1.5 - 0.15 * cheap, 0.0)


def _square(z, cheap):
    return 0.3 * z + (0.16 if cheap else 0.2) * z**2


POPULATIONS = (
    Population("quadratic", 1.0, _square, _square),
    Population("kink at the mean", 1.0, _kink(0.0, 0.8), _none, ((0.0,), ())),
    Population("kink at 1 σ", 1.0, _kink(1.0, 1.0), _none, ((1.0,), ())),
    Population("two kinks", 1.0, _kink(0.5, -1.5), _kink(-0.5, -1.5), ((0.5,), (-0.5,))),
    Population("contact in 1 of 10", 0.3, _kink(IN_TEN, 2.0), _none, ((IN_TEN,), ()), rarest=0.1),
    Population("snap in 1 of 10", 1.0, _jump(IN_TEN, 1.0), _none, ((IN_TEN,), ()), rarest=0.1),
    Population("snap in 1 of 50", 1.0, _jump(IN_FIFTY, 1.0), _none, ((IN_FIFTY,), ()), rarest=0.02),
    Population("large snap in 1 of 50", 1.0, _jump(IN_FIFTY, 4.0), _none, ((IN_FIFTY,), ()), rarest=0.02),
    Population("lognormal", 0.5, _lognormal, _none, ((float(np.log(1.5)) / WIDTH,), ()), lognormal=True),
    Population("chatter", 1.0, lambda z, cheap: 0.05 * np.sin(40 * z * (1 + 0.15 * cheap)), _square),
)
