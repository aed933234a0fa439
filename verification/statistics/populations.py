"""Populations of known statistics for plain samples: kinks, jumps, skewed, correlated and truncated sources.

Every population is ``c w + Σ g_i(z_i)`` with independent z_i, standard normal or a truncated standard normal, and w
normal or uniform, so mean and variance are integrals over one variable each, by Gauss-Legendre quadrature between the
kinks. Nothing here uses the estimates that it judges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
from scipy.special import ndtr, ndtri

from mic.scene.deviation import Correlation
from mic.statistics.draw import draw

__all__ = ["CHANGES", "NAMED", "SLOPED", "Population", "Sources", "random_answers"]

REACH, CELLS, NODES = 9.0, 60, 12  # of the quadrature
IN_TEN, IN_FIFTY = float(ndtri(0.9)), float(ndtri(0.98))
ROOT3 = 3**0.5


@dataclass(frozen=True)
class Term:
    """A function of one variable, its kinks, and the ends of the variable's range."""

    function: Callable[[np.ndarray], np.ndarray]
    kinks: tuple[float, ...] = ()
    ends: tuple[float, float] = (-REACH, REACH)

    @property
    def moments(self) -> tuple[float, float]:
        """Mean and variance."""
        edges = np.unique(np.clip([*np.linspace(-REACH, REACH, CELLS + 1), *self.kinks, *self.ends], *self.ends))
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        half, middle = np.diff(edges)[:, None] / 2, (edges[1:] + edges[:-1])[:, None] / 2
        z = (middle + half * nodes).ravel()
        weight = (half * weights).ravel() * np.exp(-(z**2) / 2)
        y, weight = self.function(z), weight / weight.sum()
        mean = float(weight @ y)
        return mean, float(weight @ (y - mean) ** 2)


@dataclass(frozen=True)
class Population:
    """A population.

    Attributes
    ----------
    name : str
    terms : tuple of Term
    share : float
        c.
    uniform : bool
        Whether w is uniform.
    rarest : float
        Probability of the rarest event that changes the quantity.
    below : callable or None
        Its distribution function, where a share outside limits is judged.
    """

    name: str
    terms: tuple[Term, ...]
    share: float = 0.0
    uniform: bool = False
    rarest: float = 1.0
    below: Callable[[float], float] | None = field(default=None, repr=False)

    @property
    def mean(self) -> float:
        """Mean."""
        return sum(term.moments[0] for term in self.terms)

    @property
    def sigma(self) -> float:
        """Standard deviation."""
        return (self.share**2 + sum(term.moments[1] for term in self.terms)) ** 0.5

    def draw(self, stream: np.random.Generator, size: tuple[int, ...]) -> np.ndarray:
        """Independent samples."""
        y = np.zeros(size)
        if self.share:
            y += self.share * (stream.uniform(-ROOT3, ROOT3, size) if self.uniform else stream.standard_normal(size))
        for term in self.terms:
            y += term.function(stream.standard_normal(size))
        return y


def _kink(place: float, effect: float) -> Term:
    return Term(lambda z: effect * np.maximum(z - place, 0.0), (place,))


def _jump(place: float, effect: float) -> Term:
    return Term(lambda z: effect * (z > place), (place,))


def _lognormal(width: float) -> Term:
    return Term(lambda z: np.exp(width * z))


_HINGE = Term(lambda z: np.where(z < 0, 0.2 * z, z), (0.0,))
_RARE = Term(lambda z: 0.1 * z + 3 * np.maximum(z - IN_TEN, 0.0), (IN_TEN,))
_NORMAL = Term(lambda z: z)

#: The populations of the claim.
NAMED = (
    Population("normal", (_NORMAL,), below=ndtr),
    Population("uniform", (), 1.0, True, below=lambda y: float(np.clip((y / ROOT3 + 1) / 2, 0, 1))),
    Population("lognormal", (_lognormal(0.5),), below=lambda y: float(ndtr(2 * np.log(y))) if y > 0 else 0.0),
    Population("hinge", (_HINGE,), rarest=0.5, below=lambda y: float(ndtr(y if y > 0 else 5 * y))),
    Population(
        "contact in 1 of 10",
        (_RARE,),
        rarest=0.1,
        below=lambda y: float(ndtr(y / 0.1 if y < 0.1 * IN_TEN else (y + 3 * IN_TEN) / 3.1)),
    ),
    Population("soft contact in 1 of 10", (_kink(IN_TEN, 2.0),), 0.3, rarest=0.1),
    Population(
        "snap in 1 of 50",
        (_NORMAL, _jump(IN_FIFTY, 6.0)),
        rarest=0.02,
        below=lambda y: float(0.98 * ndtr(y) + 0.02 * ndtr(y - 6)),
    ),
    Population("snap in 1 of 10", (_NORMAL, _jump(IN_TEN, 3.0)), rarest=0.1),
    Population("two states", (_jump(ndtri(0.7), 6.0),), 1.0, rarest=0.3),
    Population("exponential", (Term(lambda z: -np.log(ndtr(-z))),)),
)


def random_answers(count: int, seed: int) -> list[Population]:
    """Answers with random kinks, jumps and skewness, on none of which the intervals were chosen."""
    stream, found = np.random.default_rng(seed), []
    for number in range(count):
        place, far = stream.uniform(-1.5, 1.6), stream.uniform(0.2, 1.6)
        effect, jump = stream.normal(0, stream.choice([0.0, 0.5, 2.0, 4.0])), stream.normal(0, stream.choice([0, 2, 5]))
        width, share = stream.choice([0.0, 0.3, 0.6]), stream.choice([0.1, 0.3, 1.0])
        terms = (_kink(place, effect), _jump(far, jump), *((_lognormal(width),) if width else ()))
        rarest = min([1.0] + [float(ndtr(-place))] * bool(effect) + [float(ndtr(-far))] * bool(jump))
        uniform = bool(stream.random() < 0.3)
        found.append(Population(f"{number}", terms, float(share), uniform, rarest))
    return found


class Sources:
    """Outputs of correlated and truncated sources that :mod:`mic.statistics.draw` samples.

    Two normal deviations have a correlation of 0.8, so that their sum is normal with the variance 3.6; a third one is
    truncated to -0.5 … 2 standard deviations, a fourth is normal.
    """

    ENDS = (-0.5, 2.0)
    CLOSES = 1.0  # of the truncated deviation: a contact of 1 in 5

    def __init__(self, design: str = "independent"):
        one = {"mean": 0.0, "sigma": 1.0, "distribution": "normal", "parameters": {}, "truncated": None, "scores": None}
        items = [SimpleNamespace(**one | {"name": name}) for name in "abcd"]
        items[2].truncated = self.ENDS
        correlation = Correlation(deviations=["a", "b"], matrix=[[1.0, 0.8], [0.8, 1.0]])
        settings = SimpleNamespace(design=design, values=None)
        self.scene = SimpleNamespace(deviations=items, correlations=[correlation], monte_carlo=settings)
        share = float(ndtr(self.ENDS[1]) - ndtr(self.CLOSES)) / float(ndtr(self.ENDS[1]) - ndtr(self.ENDS[0]))
        snap = Term(lambda z: z + 3 * (z > IN_TEN), (IN_TEN,))
        truncated = Term(lambda z: z, ends=self.ENDS)
        contact = Term(lambda z: 2 * np.maximum(z - self.CLOSES, 0.0), (self.CLOSES,), self.ENDS)
        self.populations = (
            Population("correlated, hinge", (_HINGE,), 0.3, rarest=0.5),
            Population("correlated, snap in 1 of 10", (snap,), 0.3, rarest=0.1),
            Population("truncated", (truncated,), 0.3),
            Population("truncated, contact in 1 of 5", (contact,), 0.3, rarest=share),
        )

    def inputs(self, seed: int, count: int) -> np.ndarray:
        """(count, 4) deviations."""
        return draw(self.scene, seed, 0, count)

    def outputs(self, x: np.ndarray) -> np.ndarray:
        """(n, 4) values in the order of the populations."""
        w, c, rest = (x[:, 0] + x[:, 1]) / 3.6**0.5, x[:, 2], 0.3 * x[:, 3]
        of = [population.terms[0].function for population in self.populations]
        return np.column_stack([of[0](w) + rest, of[1](w) + rest, of[2](c) + rest, of[3](c) + rest])


#: Two assemblies on the same samples of two standard normal variables: name, both answers as functions of (u, v), and
#: the probability of the rarest event that changes either.
CHANGES = (
    ("scaled", lambda u, v: u + 0.3 * v, lambda u, v: 0.8 * u + 0.3 * v, 1.0),
    ("hinge moves", lambda u, v: _HINGE.function(u) + 0.2 * v, lambda u, v: _HINGE.function(u - 0.3) + 0.2 * v, 0.38),
    ("contact in 1 of 10", lambda u, v: v, lambda u, v: v + 2 * np.maximum(u - IN_TEN, 0.0), 0.1),
    ("snap in 1 of 50", lambda u, v: u, lambda u, v: u + 6.0 * (v > IN_FIFTY), 0.02),
    ("lognormal", lambda u, v: np.exp(0.5 * u) + 0.1 * v, lambda u, v: np.exp(0.4 * u) + 0.1 * v, 1.0),
)

#: Answers whose derivatives are known, c v + g(u) of two standard normal variables: the population and g'.
SLOPED = (
    (Population("hinge", (_HINGE,), 0.3, rarest=0.5), lambda u: np.where(u < 0, 0.2, 1.0)),
    (Population("lognormal", (_lognormal(0.5),), 0.3), lambda u: 0.5 * np.exp(0.5 * u)),
    (Population("soft contact in 1 of 10", (_kink(IN_TEN, 2.0),), 0.3, rarest=0.1), lambda u: 2.0 * (u > IN_TEN)),
)
