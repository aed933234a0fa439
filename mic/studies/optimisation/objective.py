r"""What an assembly is judged by: the objective, the constraints, and their derivatives over samples.

Of samples y (n, k) with mean m, standard deviation σ, limits L and U and weights w, the objective is, as something that
is to become small,

    −min_k min(U − m, m − L)/3σ,     max_k 6 w σ,     Σ_k 6 w σ,     the share outside,     costs + reject · that share.

A constraint that is not kept falls short by a share: of Cpk 1, of half the tolerance, or of the force that is asked
for. Designs are compared by their *merit*, the objective and :data:`PENALTY` times what they fall short by.

For a gradient the share outside is smoothed over a quarter of each σ, with Φ the normal distribution,

    1 − (1/n) Σ_s Π_k [Φ((U − y)/h) − Φ((L − y)/h)],        h = σ/4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from mic.scene.optimisation import pushing
from mic.studies.optimisation.design import Space

__all__ = ["PENALTY", "Figures", "Kept", "Objective"]

PENALTY = 1e3
WORDS = {"cpk": "Cpk", "six-sigma": "6σ"}
KEPT = 1e-6  # of what a constraint asks: by less, it is kept
SMOOTH = 0.25  # of σ
LEAST = 1e-9  # mm: σ of what does not vary


@dataclass(frozen=True)
class Kept:
    """One constraint, of one measurement or of a sum of forces.

    Attributes
    ----------
    name : str
        In words.
    value, bound : float
        What there is, and what is asked for, mm, N or 1.
    short : float
        By how much it is missed, in the unit of both; 0 where it is kept.
    share : float
        The same as a share of Cpk 1, of half the tolerance, or of the force.
    """

    name: str
    value: float
    bound: float
    short: float
    share: float


@dataclass(frozen=True)
class Figures:
    """Figures of k measurements over samples, and their derivatives by a settings.

    Attributes
    ----------
    mean, six_sigma, above, below : (k,) array
        `above` and `below` are the two sides of Cpk: (U − m)/3σ, (m − L)/3σ.
    outside : float
        Share of samples outside, smoothed where there are derivatives.
    slopes : dict of str to (k, a) or (a,) array
        Of each, by its name.
    """

    mean: np.ndarray
    six_sigma: np.ndarray
    above: np.ndarray
    below: np.ndarray
    outside: float
    slopes: dict[str, np.ndarray]


class Objective:
    """Objective and constraints of a scene.

    Parameters
    ----------
    space : Space

    Attributes
    ----------
    kind : str
        As the scene names it.
    more : dict of str to float
        By how much more than it states is asked of a constraint, by its name, in its unit.
    """

    #: Figures that a constraint on a quantity is about.
    FIGURES = {"cpk": ("above", "below"), "six-sigma": ("six_sigma",), "mean": ("mean",)}

    def __init__(self, space: Space):
        scene, asked = space.scene, space.asked
        self.space, self.asked, self.kind = space, asked, asked.objective
        self.more: dict[str, float] = {}
        self.names = [one.name for one in scene.measurements]
        self.lower, self.upper = np.array([one.bounds for one in scene.measurements]).T
        self.half = np.array([(one.upper - one.lower) / 2 for one in scene.measurements])
        self.own = np.array([not asked.of or name in asked.of for name in self.names])
        self.weights = np.array([asked.weights.get(name, 1.0) for name in self.names])

    # ------------------------------------------------------------------------------------------------- figures

    def figures(self, y: np.ndarray, slopes: np.ndarray | None = None) -> Figures:
        """Figures of samples (n, k), and with their derivatives (n, k, a) those of the figures."""
        n, k = y.shape
        m = y.mean(axis=0)
        sigma = np.maximum(y.std(axis=0, ddof=1) if n > 1 else np.zeros(k), LEAST)
        above, below = (self.upper - m) / (3 * sigma), (m - self.lower) / (3 * sigma)
        if slopes is None:
            return Figures(m, 6 * sigma, above, below, float(self.outside(y).mean()), {})
        dm = slopes.mean(axis=0)
        ds = np.einsum("nk,nka->ka", y - m, slopes - dm) / ((max(n, 2) - 1) * sigma[:, None])
        side = lambda value, sign: (
            (sign * dm - 3 * np.where(np.isfinite(value), value, 0)[:, None] * ds) / (3 * sigma[:, None])
        )
        outside, douter = self._smoothed(y[:, self.own], slopes[:, self.own], sigma[self.own])
        told = {
            "mean": dm,
            "six_sigma": 6 * ds,
            "above": side(above, -1.0),
            "below": side(below, 1.0),
            "outside": douter,
        }
        return Figures(m, 6 * sigma, above, below, outside, told)

    def outside(self, y: np.ndarray) -> np.ndarray:
        """(n,) whether any measurement of the objective is outside its limits."""
        return ((y < self.lower) | (y > self.upper))[:, self.own].any(axis=1)

    def _smoothed(self, y, slopes, sigma) -> tuple[float, np.ndarray]:
        """The smoothed share outside, and its derivatives (a,), h held where it is."""
        h = SMOOTH * sigma
        up, low = (self.upper[self.own] - y) / h, (self.lower[self.own] - y) / h
        each = np.maximum(ndtr(up) - ndtr(low), 1e-300)
        density = lambda t: np.exp(-(np.where(np.isfinite(t), t, 40.0) ** 2) / 2) / np.sqrt(2 * np.pi)
        turned = (density(low) - density(up)) / h / each  # of log each, by y
        whole = each.prod(axis=1)
        return float(1 - whole.mean()), -np.einsum("n,nk,nka->a", whole, turned, slopes) / len(y)

    # --------------------------------------------------------------------------------------------------- merit

    def value(self, y: np.ndarray, unfit: np.ndarray, settings: np.ndarray) -> float:
        """The objective of samples (n, k), as something that is to become small.

        Parameters
        ----------
        y : (n, k) array
        unfit : (n,) bool array
            Samples that failed or could not be built: they are outside, and of no figure.
        settings : (a,) array
        """
        good = y[~unfit]
        if len(good) < 1 or (self.kind in ("cpk", "six-sigma", "largest-six-sigma") and len(good) < 2):
            return np.inf
        told = self.figures(good)
        if self.kind == "cpk":
            return float(-np.minimum(told.above, told.below)[self.own].min())
        if self.kind == "largest-six-sigma":
            return float((self.weights * told.six_sigma)[self.own].max())
        if self.kind == "six-sigma":
            return float((self.weights * told.six_sigma)[self.own].sum())
        outside = 1 - (1 - told.outside) * len(good) / len(y)
        if self.kind == "yield":
            return float(outside)
        return float(self.space.costs @ np.abs(settings) + self.asked.reject * outside)

    def kept(self, y: np.ndarray, unfit: np.ndarray, settings: np.ndarray) -> list[Kept]:
        """The constraints, and by how much each is missed."""
        return [
            Kept(name, value, bound, max(0.0, gap + more), max(0.0, gap + more) / scale)
            for name, value, bound, gap, scale in self._gaps(y[~unfit], settings)
            for more in [self.more.get(name, 0.0)]
        ]

    def merit(self, y: np.ndarray, unfit: np.ndarray, settings: np.ndarray) -> float:
        """What designs are compared by: objective and what falls short."""
        value = self.value(y, unfit, settings)
        if not np.isfinite(value) or not self.asked.constraints:
            return value
        return value + PENALTY * self.short(y, unfit, settings)

    def short(self, y: np.ndarray, unfit: np.ndarray, settings: np.ndarray) -> float:
        """What the constraints are missed by, together, as shares."""
        return sum(one.share for one in self.kept(y, unfit, settings) if one.share > KEPT)

    def _gaps(self, y: np.ndarray, settings: np.ndarray) -> Iterator[tuple[str, float, float, float, float]]:
        """Name, value, bound, by how much it is beyond, and its scale, of each constraint."""
        if not self.asked.constraints:
            return
        told = self.figures(y)
        cpk = np.minimum(told.above, told.below)
        value = {"cpk": cpk, "six-sigma": told.six_sigma, "mean": told.mean}
        for one in self.asked.constraints:
            about = self._about(one) if one.quantity != "force" else [0]
            for k in about:
                found = self.force(one, settings) if one.quantity == "force" else float(value[one.quantity][k])
                for name, sign, bound, scale in self._bounds(one, k):
                    yield name, found, bound, sign * (bound - found), scale

    def _bounds(self, one, k: int) -> Iterator[tuple[str, float, float, float]]:
        """Name, 1 for a least value and -1 for a largest, bound and scale, of a constraint on a measurement."""
        what = f"{WORDS.get(one.quantity, one.quantity)} of {self.names[k]}"
        if one.quantity == "force":
            what = f"force of {' and '.join(one.of) if one.of else 'all clamps'}"
        for word, sign, bound in (("at least", 1.0, one.at_least), ("at most", -1.0, one.at_most)):
            if bound is not None:
                scale = {"cpk": 1.0, "force": max(abs(bound), 1.0)}.get(one.quantity, float(self.half[k]))
                yield f"{what} {word} {bound:g}", sign, bound, scale

    def force(self, one, settings: np.ndarray) -> float:
        """The sum of forces that a constraint is about, N."""
        return sum(clamp.force for clamp in pushing(self.space.scene, one)) + float(
            self.force_slopes(one) @ np.asarray(settings, dtype=float)
        )

    def force_slopes(self, one) -> np.ndarray:
        """(a,) by how much that sum grows with each setting."""
        names = [clamp.name for clamp in pushing(self.space.scene, one)]
        return np.array([float(sum(name in names for name in own.targets)) for own in self.space.settings])

    def _about(self, one) -> list[int]:
        return [k for k, name in enumerate(self.names) if not one.of or name in one.of]

    # -------------------------------------------------------------------------------------------- for a gradient

    def inequalities(self, told: Figures, settings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Constraints c ≥ 0, in shares as :class:`Kept` has them, (q,), and their derivatives (q, a)."""
        values: list[float] = []
        slopes: list[np.ndarray] = []

        for one in self.asked.constraints:
            for k in self._about(one) if one.quantity != "force" else [0]:
                pairs = [(self.force(one, settings), self.force_slopes(one))] if one.quantity == "force" else []
                for name in () if one.quantity == "force" else self.FIGURES[one.quantity]:
                    pairs.append((float(getattr(told, name)[k]), told.slopes[name][k]))
                for what, sign, bound, scale in self._bounds(one, k):
                    known = [(value, slope) for value, slope in pairs if np.isfinite(value)]
                    values += [(sign * (value - bound) - self.more.get(what, 0.0)) / scale for value, _ in known]
                    slopes += [sign * slope / scale for _, slope in known]
        a = len(self.space.settings)
        return np.array(values), np.array(slopes).reshape(-1, a)

    def largest(self, told: Figures) -> tuple[np.ndarray, np.ndarray]:
        """What the objective is the largest of, (q,), and their derivatives (q, a); one number of a smooth objective,
        without the costs of settings."""
        own = self.own
        if self.kind == "cpk":
            pairs = [(-getattr(told, side), -told.slopes[side]) for side in ("above", "below")]
            values, slopes = (np.concatenate([pair[i][own] for pair in pairs]) for i in (0, 1))
            known = np.isfinite(values)
            return values[known], slopes[known]
        if self.kind in ("six-sigma", "largest-six-sigma"):
            values = (self.weights * told.six_sigma)[own]
            slopes = (self.weights[:, None] * told.slopes["six_sigma"])[own]
            return (values, slopes) if self.kind != "six-sigma" else (values.sum()[None], slopes.sum(axis=0)[None])
        scale = self.asked.reject if self.kind == "cost" else 1.0
        return np.array([scale * told.outside]), scale * told.slopes["outside"][None]
