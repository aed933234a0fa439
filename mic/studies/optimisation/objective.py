r"""Objective and constraints of an optimisation, and their derivatives, from samples.

For samples y (n, k) with mean m, standard deviation σ, limits L and U and weights w, the objective to be minimised is
one of

    −min_k min(U − m, m − L)/3σ,     max_k 6 w σ,     Σ_k 6 w σ,     the share outside,     costs + reject · that share.

The violation of a constraint is relative to a Cpk of 1, to half the tolerance, or to the required force. Designs are
compared by their *merit*, the objective plus :data:`PENALTY` times the sum of the relative violations.

The gradient takes the share outside smoothed over a quarter of each σ, with Φ the normal distribution function,

    1 − (1/n) Σ_s Π_k [Φ((U − y)/h) − Φ((L − y)/h)],        h = σ/4.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from mic.scene.optimisation import clamps_with_force
from mic.studies.optimisation.design import Space
from mic.studies.samples import half_tolerances, limits

__all__ = ["PENALTY", "ConstraintCheck", "Figures", "Objective"]

PENALTY = 1e3
WORDS = {"cpk": "Cpk", "six-sigma": "6σ"}
#: Statistics that a constraint on a quantity bounds.
FIGURES = {"cpk": ("above", "below"), "six-sigma": ("six_sigma",), "mean": ("mean",)}
TOLERATED = 1e-6  # relative violation of a constraint that counts as none
SMOOTH = 0.25  # smoothing length relative to σ
LEAST = 1e-9  # mm: lower bound of σ

Settings = Sequence[float] | np.ndarray
#: Name, sign (1 for a lower bound, −1 for an upper), bound and scale; values with their derivatives.
Bound = tuple[str, float, float, float, list[tuple[float, np.ndarray]]]


@dataclass(frozen=True)
class ConstraintCheck:
    """Value and violation of one constraint on a measurement or on a sum of forces.

    Attributes
    ----------
    name : str
        Description of the constraint.
    value, bound : float
        Actual value and its bound, mm, N or 1.
    short : float
        Violation in the unit of both; 0 if the constraint is satisfied.
    share : float
        Violation relative to a Cpk of 1, to half the tolerance, or to the force.
    """

    name: str
    value: float
    bound: float
    short: float
    share: float


@dataclass(frozen=True)
class Figures:
    """Statistics of k measurements over samples, and their derivatives by a settings.

    Attributes
    ----------
    mean, six_sigma, above, below : (k,) array
        `above` and `below` are the two sides of Cpk: (U − m)/3σ, (m − L)/3σ.
    outside : float
        Share of samples outside their limits, smoothed if there are derivatives.
    slopes : dict of str to (k, a) or (a,) array
        Derivatives by name of the attribute.
    """

    mean: np.ndarray
    six_sigma: np.ndarray
    above: np.ndarray
    below: np.ndarray
    outside: float
    slopes: dict[str, np.ndarray]

    def at(self, name: str, k: int) -> tuple[float, np.ndarray]:
        """A statistic of measurement k, and its derivatives (a,), empty if they were not computed."""
        return float(getattr(self, name)[k]), self.slopes[name][k] if self.slopes else np.zeros(0)


class Objective:
    """Objective and constraints of a scene.

    Parameters
    ----------
    space : Space

    Attributes
    ----------
    kind : str
        As the scene names it.
    tightening : dict of str to float
        Amount by which a constraint is tightened, by its name, in its unit.
    """

    def __init__(self, space: Space):
        scene, request = space.scene, space.request
        self.space, self.request, self.kind = space, request, request.objective
        self.tightening: dict[str, float] = {}
        self.names = [item.name for item in scene.measurements]
        (self.lower, self.upper), self.half = limits(scene), half_tolerances(scene)
        self.included = np.array([not request.of or name in request.of for name in self.names])
        self.weights = np.array([request.weights.get(name, 1.0) for name in self.names])

    # ------------------------------------------------------------------------------------------------- figures

    def figures(self, y: np.ndarray, slopes: np.ndarray | None = None) -> Figures:
        """Statistics of samples (n, k); with the derivatives (n, k, a) of the samples, also their derivatives."""
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
        outside, douter = self._smoothed(y[:, self.included], slopes[:, self.included], sigma[self.included])
        derivatives = {
            "mean": dm,
            "six_sigma": 6 * ds,
            "above": side(above, -1.0),
            "below": side(below, 1.0),
            "outside": douter,
        }
        return Figures(m, 6 * sigma, above, below, outside, derivatives)

    def outside(self, y: np.ndarray) -> np.ndarray:
        """(n,) whether any measurement of the objective is outside its limits."""
        return ((y < self.lower) | (y > self.upper))[:, self.included].any(axis=1)

    def _smoothed(self, y, slopes, sigma) -> tuple[float, np.ndarray]:
        """The smoothed share outside and its derivatives (a,) at constant h."""
        h = SMOOTH * sigma
        up, low = (self.upper[self.included] - y) / h, (self.lower[self.included] - y) / h
        inside = np.maximum(ndtr(up) - ndtr(low), 1e-300)
        density = lambda t: np.exp(-(np.where(np.isfinite(t), t, 40.0) ** 2) / 2) / np.sqrt(2 * np.pi)
        log_slopes = (density(low) - density(up)) / h / inside  # derivative of log(inside) by y
        all_inside = inside.prod(axis=1)
        return float(1 - all_inside.mean()), -np.einsum("n,nk,nka->a", all_inside, log_slopes, slopes) / len(y)

    # --------------------------------------------------------------------------------------------------- merit

    def value(self, y: np.ndarray, unfit: np.ndarray, settings: Settings) -> float:
        """The objective of samples (n, k), to be minimised.

        Parameters
        ----------
        y : (n, k) array
        unfit : (n,) bool array
            Samples that failed or could not be built: they count as outside and are left out of mean and σ.
        settings : (a,) array
        """
        good = y[~unfit]
        if len(good) < 1 or (self.kind in ("cpk", "six-sigma", "largest-six-sigma") and len(good) < 2):
            return np.inf
        figures = self.figures(good)
        if self.kind == "cpk":
            return float(-np.minimum(figures.above, figures.below)[self.included].min())
        if self.kind == "largest-six-sigma":
            return float((self.weights * figures.six_sigma)[self.included].max())
        if self.kind == "six-sigma":
            return float((self.weights * figures.six_sigma)[self.included].sum())
        outside = 1 - (1 - figures.outside) * len(good) / len(y)
        if self.kind == "yield":
            return float(outside)
        return float(self.space.costs @ np.abs(settings) + self.request.reject * outside)

    def reported_value(self, y: np.ndarray, unfit: np.ndarray, settings: Settings) -> float:
        """The objective as it is reported: Cpk and yield are maximised."""
        value = self.value(y, unfit, settings)
        if self.kind == "cpk":
            return -value
        return 1 - value if self.kind == "yield" else value

    def check_constraints(
        self, y: np.ndarray, unfit: np.ndarray, settings: Settings, tightened: bool = True
    ) -> list[ConstraintCheck]:
        """Value and violation of each constraint."""
        if not self.request.constraints:
            return []
        checks = []
        for name, sign, bound, scale, pairs in self._bounds(self.figures(y[~unfit]), settings):
            value = float(min(value for value, _ in pairs))
            gap = sign * (bound - value) + tightened * self.tightening.get(name, 0.0)
            checks.append(ConstraintCheck(name, value, bound, max(0.0, gap), max(0.0, gap) / scale))
        return checks

    def merit(self, y: np.ndarray, unfit: np.ndarray, settings: Settings) -> float:
        """Objective plus penalty for constraint violations; designs are compared by it."""
        value = self.value(y, unfit, settings)
        return value + PENALTY * self.violation(y, unfit, settings) if np.isfinite(value) else value

    def violation(self, y: np.ndarray, unfit: np.ndarray, settings: Settings) -> float:
        """Sum of the relative constraint violations."""
        shares = [check.share for check in self.check_constraints(y, unfit, settings)]
        return sum((share for share in shares if share > TOLERATED), 0.0)

    def _bounds(self, figures: Figures, settings: Settings) -> Iterator[Bound]:
        """Each bound of each constraint, for each of its measurements."""
        for constraint in self.request.constraints:
            quantity, of = constraint.quantity, constraint.of
            bounds = [("at least", 1.0, constraint.at_least), ("at most", -1.0, constraint.at_most)]
            targets = [k for k, name in enumerate(self.names) if not of or name in of]
            for k in [0] if quantity == "force" else targets:
                if quantity == "force":
                    what = f"force of {' and '.join(of) if of else 'all clamps'}"
                    pairs = [self._force(constraint, settings)]
                else:
                    what = f"{WORDS.get(quantity, quantity)} of {self.names[k]}"
                    pairs = [figures.at(name, k) for name in FIGURES[quantity]]
                for comparison, sign, bound in bounds:
                    if bound is not None:
                        scale = {"cpk": 1.0, "force": max(abs(bound), 1.0)}.get(quantity, float(self.half[k]))
                        yield f"{what} {comparison} {bound:g}", sign, bound, scale, pairs

    def _force(self, constraint, settings: Settings) -> tuple[float, np.ndarray]:
        """The sum of forces that a constraint bounds, N, and its derivative (a,) by each setting."""
        clamps = clamps_with_force(self.space.scene, constraint)
        names = [clamp.name for clamp in clamps]
        slopes = np.array([float(sum(name in names for name in item.targets)) for item in self.space.settings])
        return sum(clamp.force for clamp in clamps) + float(slopes @ settings), slopes

    # ------------------------------------------------------------------------------------------------ gradient

    def inequalities(self, figures: Figures, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
        """Relative constraints c ≥ 0 (q,), scaled as in :class:`ConstraintCheck`, and their derivatives (q, a)."""
        values: list[float] = []
        slopes: list[np.ndarray] = []
        for name, sign, bound, scale, pairs in self._bounds(figures, settings):
            for value, slope in pairs:
                if np.isfinite(value):
                    values.append((sign * (value - bound) - self.tightening.get(name, 0.0)) / scale)
                    slopes.append(sign * slope / scale)
        return np.array(values), np.array(slopes).reshape(-1, len(self.space.settings))

    def objective_terms(self, figures: Figures) -> tuple[np.ndarray, np.ndarray]:
        """Values (q,) whose maximum is the objective, and their derivatives (q, a); one value if the objective is
        smooth. The costs of settings are not included."""
        included = self.included
        if self.kind == "cpk":
            pairs = [(-getattr(figures, side), -figures.slopes[side]) for side in ("above", "below")]
            values, slopes = (np.concatenate([pair[i][included] for pair in pairs]) for i in (0, 1))
            finite = np.isfinite(values)
            return values[finite], slopes[finite]
        if self.kind in ("six-sigma", "largest-six-sigma"):
            values = (self.weights * figures.six_sigma)[included]
            slopes = (self.weights[:, None] * figures.slopes["six_sigma"])[included]
            return (values, slopes) if self.kind != "six-sigma" else (values.sum()[None], slopes.sum(axis=0)[None])
        scale = self.request.reject if self.kind == "cost" else 1.0
        return np.array([scale * figures.outside]), scale * figures.slopes["outside"][None]
