r"""Find the smallest changes of shims, positions and clamp forces that bring an assembly within its limits.

A key characteristic is within its limits if ``mean ± 3 C σ`` is, with C the required capability. About changes x₀ of
the adjustments (:mod:`mic.studies.adjustment`) each sample is linearised with its exact derivatives,
``y_s(x) = y_s + J_s (x − x₀)``; the mean is then linear in x and σ convex,

.. math::

    \sigma(x)^2 = q^T \,\mathrm{Cov}[y, J]\, q, \qquad q = (1, x - x_0),

and minimising the sum of relative changes ``|x_i| / b_i`` (b the allowed changes) is a convex program. It is solved by
Kelley's cutting planes [1]_ with :func:`scipy.optimize.linprog`, whose solutions are sparse. The samples and
derivatives are then evaluated again at the solution, until the evaluated samples are within the limits: if contact
changes, the program is solved again about the new point, or the step is halved if it makes the result worse.

Each remedy is evaluated in full with changes that can be set, on the samples of the search and on fresh samples. If the
fresh samples exceed the limits, the requirement is tightened by the excess and checked on further samples.

References
----------
.. [1] J. E. Kelley: The cutting-plane method for solving convex programs, J. SIAM 8 (1960) 703-712.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from scipy.optimize import linprog

from mic.errors import ArgumentError, SceneError
from mic.process.model import ReducedModel
from mic.results.schema import REMEDIES, REMEDY_EFFECTS
from mic.statistics import estimates
from mic.statistics.capability import centred_capability, outside
from mic.statistics.draw import draw
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments, with_adjustments, with_changes
from mic.studies.samples import Progress, derivatives, half_tolerances, key_characteristics
from mic.studies.samples import limits as scene_limits
from mic.system.arguments import checked

__all__ = ["CAPABILITY", "SAMPLES", "Limits", "Remedies", "Remedy", "remedies", "smallest"]

SAMPLES = 60
DERIVATIVE_SAMPLES = 20  # first samples that are evaluated with derivatives, which cost several evaluations each
CAPABILITY = 1.0  #: required Cpk
MAX_SINGLES = 3  # remedies with a single adjustment that are evaluated in full
MAX_ROUNDS = 10  # linearisations per remedy
MAX_CHECKS = 3  # sets of fresh samples
TOLERATED = 1e-3  # excess over a limit, relative to half the tolerance
CHEAPER = 0.9  # ratio of costs below which another linearisation is worthwhile
MAX_CUTS = 60  # cutting planes
UNBOUNDED = 2.0  # trust region that contains all allowed changes
EXCESS_COST = 1e4  # penalty for an excess of half the tolerance
TOGETHER = "together"


@dataclass(frozen=True)
class Limits:
    """Limits of k key characteristics, mm.

    Attributes
    ----------
    lower, upper : (k,) array
        Infinite where there is none.
    half : (k,) array
        Half the tolerance.
    spread : float
        Number of σ on either side of the mean that must be within the limits.
    """

    lower: np.ndarray
    upper: np.ndarray
    half: np.ndarray
    spread: float

    def margin(self, y: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """(k,) distance of ``mean ± spread σ`` of samples (n, k) to the limits, mm, negative beyond them; (r, k) with
        weights (r, n)."""
        n, off = len(y), y - y.mean(axis=0)
        w = np.full((1, n), 1 / n) if weights is None else weights
        m = w @ off
        sigma = np.sqrt(np.maximum(w @ off**2 - m**2, 0.0) * n / max(n - 1, 1))
        m = m + y.mean(axis=0)
        margin = np.minimum(self.upper - m, m - self.lower) - self.spread * sigma
        return margin[0] if weights is None else margin


@dataclass(frozen=True)
class Remedy:
    """Changes that were evaluated in full.

    Attributes
    ----------
    name : str
        Name of the adjustment, or ``together``.
    changes : dict of Adjustment to float
        mm or N.
    reached : bool
        Whether the worst characteristic, or with ``together`` every one, is within its limits on fresh samples.
    rounds : int
        Number of evaluations of the samples with derivatives.
    before, after : list of (n, k) array
        Key characteristics without and with the changes, of the samples of the search and of fresh samples, if any.
    """

    name: str
    changes: dict[Adjustment, float]
    reached: bool
    rounds: int
    before: list[np.ndarray]
    after: list[np.ndarray]


@dataclass(frozen=True)
class Remedies:
    """Changes that bring an assembly within its limits under one law.

    Attributes
    ----------
    law : str
    worst : str
        Key characteristic that is farthest beyond its limits; empty if all are within them.
    adjustable : int
        Number of available adjustments.
    found : list of Remedy
        Remedies of the worst characteristic by one adjustment each, the smallest first; then one of all characteristics
        by all adjustments together.
    table, effects : DataFrame
        As :data:`mic.results.schema.REMEDIES` and :data:`mic.results.schema.REMEDY_EFFECTS` declare them.
    """

    law: str
    worst: str
    adjustable: int
    found: list[Remedy]
    table: pd.DataFrame
    effects: pd.DataFrame


def smallest(
    y: np.ndarray,
    slopes: np.ndarray,
    limits: Limits,
    low: np.ndarray,
    high: np.ndarray,
    at: np.ndarray | None = None,
    trust: float = UNBOUNDED,
    margin: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """The smallest changes that bring linearised samples within limits.

    Parameters
    ----------
    y : (n, k) array
        Key characteristics, mm.
    slopes : (n, k, a) array
        Their derivatives, mm per unit of each change.
    limits : Limits
    low, high : (a,) array
        Bounds of the changes, ``low ≤ 0 ≤ high``; changes between 0 and 0 are not made.
    at : (a,) array, optional
        Changes at which `y` and `slopes` were evaluated; default: none.
    trust : float
        Trust region: largest distance from `at` relative to the allowed change.
    margin : (k,) array, optional
        Required distance of ``mean ± spread σ`` to the limits, mm; -∞ for characteristics without a requirement.
        Default: 0.

    Returns
    -------
    (a,) array, float
        Changes, and their largest excess over the requirement relative to half the tolerance. The excess is minimised;
        the changes are the smallest with this excess.
    """
    n, k, a = slopes.shape
    at, margin = np.zeros(a) if at is None else at, np.zeros(k) if margin is None else margin
    size = np.maximum(-low, high)
    mean, gradient = y.mean(axis=0), slopes.mean(axis=0)
    joint = np.concatenate([y[..., None], slopes], axis=2)
    joint = (joint - joint.mean(axis=0)) / np.sqrt(max(n - 1, 1))
    covariance = np.einsum("nki,nkj->kij", joint, joint)

    def sigma(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) σ, and (k, a) its derivative."""
        q = np.concatenate([[1.0], x - at])
        σ = np.sqrt(np.maximum(np.einsum("i,kij,j->k", q, covariance, q), 0.0))
        product = (covariance @ q)[:, 1:]
        return σ, np.divide(product, σ[:, None], out=np.zeros_like(product), where=σ[:, None] > 0)

    # Unknowns: changes up and down, and the excess.
    unit_costs = np.divide(1.0, size, out=np.zeros(a), where=size > 0)
    costs = np.concatenate([unit_costs, unit_costs, [EXCESS_COST]])
    up, down = np.minimum(high, at + trust * size), np.maximum(low, at - trust * size)
    bounds = [*zip(np.maximum(down, 0), np.maximum(up, 0)), *zip(np.maximum(-up, 0), np.maximum(-down, 0)), (0, None)]
    A: list[np.ndarray] = []
    b: list[np.ndarray] = []
    sides = [
        (sign, limit, np.flatnonzero(np.isfinite(limit) & np.isfinite(margin)))
        for sign, limit in ((1.0, limits.upper), (-1.0, limits.lower))
    ]
    x, solution = at, np.zeros(2 * a + 1)
    for _ in range(MAX_CUTS):
        σ, dσ = sigma(x)
        worst = -np.inf
        for sign, limit, limited in sides:
            excess = sign * (mean + gradient @ (x - at) - limit) + limits.spread * σ + margin
            worst = max(worst, (excess / limits.half - solution[-1])[limited].max(initial=-np.inf))
            tangent = (sign * gradient + limits.spread * dσ) / limits.half[:, None]
            A.append(np.column_stack([tangent, -tangent, -np.ones(k)])[limited])
            b.append((tangent @ x - excess / limits.half)[limited])
        if len(A) > 2 and worst <= TOLERATED / 10:
            break
        program = linprog(costs, np.concatenate(A), np.concatenate(b), bounds=bounds, method="highs")
        if program.x is None:
            break
        solution = program.x
        x = solution[:a] - solution[a : 2 * a]
    return x, float(solution[-1])


@dataclass(frozen=True)
class _Linearisation:
    """Changes x (a,), key characteristics y (n, k) of the samples at them, and their derivatives (n, k, a)."""

    x: np.ndarray
    y: np.ndarray
    slopes: np.ndarray


class _Search:
    """Evaluates samples and their derivatives at any changes of the adjustments."""

    def __init__(self, model, law, available, limits, samples, seed, threads, progress):
        self.extended, self.names = with_adjustments(model, available)
        self.available, self.limits, self.law = available, limits, law
        self.scene, self.samples, self.seed, self.progress = model.scene, samples, seed, progress
        self.process = self.extended.process(law, threads=threads)
        self.low, self.high = (np.array([getattr(item, end) for item in available]) for end in ("low", "high"))
        self.deviations = self._draw(0)[:DERIVATIVE_SAMPLES]
        self.unchanged = cache(lambda batch: self.values(batch, np.zeros(len(available))))

    def _draw(self, batch: int) -> np.ndarray:
        """(n, p) deviations of a set of samples: 0 for the search, others are fresh."""
        if not self.scene.deviations:
            return np.zeros((1 if batch == 0 else 0, 0))
        return draw(self.scene, self.seed, batch * self.samples, self.samples)

    def values(self, batch: int, x: np.ndarray) -> np.ndarray:
        """(n, k) key characteristics of a set of samples with changes (a,); NaN for failed samples."""
        deviations = self._draw(batch)
        if not len(deviations):
            return np.zeros((0, len(self.scene.measurements)))
        return key_characteristics(self.process, with_changes(deviations, x), self.progress)

    def linearise(self, x: np.ndarray, moving: np.ndarray) -> _Linearisation:
        """The valid samples at changes (a,), with derivatives by the adjustments with the numbers `moving`."""
        names = [self.names[i] for i in moving]
        y, jacobian = derivatives(self.extended, with_changes(self.deviations, x), self.law, self.progress, names)
        known = np.isfinite(y).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        slopes = np.zeros((int(known.sum()), y.shape[1], len(self.available)))
        slopes[:, :, moving] = jacobian[known]
        return _Linearisation(x, y[known], slopes)

    def bounds(self, moving: Sequence[int] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (a,) of the changes if only the adjustments with the numbers `moving` change."""
        free = np.isin(np.arange(len(self.available)), moving)
        return np.where(free, self.low, 0.0), np.where(free, self.high, 0.0)

    def excess(self, y: np.ndarray, margin: np.ndarray) -> float:
        """Largest excess of samples over the required margin, relative to half the tolerance."""
        y = y[np.isfinite(y).all(axis=1)]
        if not len(y):
            return np.inf
        return float(((margin - self.limits.margin(y)) / self.limits.half).max())

    def _minimise(self, moving: np.ndarray, margin: np.ndarray, start: _Linearisation) -> tuple[_Linearisation, int]:
        """The best changes of some adjustments on the samples of the search, and the number of linearisations."""
        low, high = self.bounds(moving)
        size = np.maximum(-low, high).clip(np.finfo(float).tiny)
        at, trust = start, UNBOUNDED
        best, rounds = (max(0.0, self.excess(at.y, margin)), float(np.abs(at.x / size).sum()), at), 0
        for rounds in range(1, MAX_ROUNDS + 1):
            x, _ = smallest(at.y, at.slopes, self.limits, low, high, at.x, trust, margin)
            step = float(np.abs((x - at.x) / size).max())
            cost = float(np.abs(x / size).sum())
            reached = best[0] <= TOLERATED
            if step < 1e-3 or (reached and cost > CHEAPER * best[1]):
                return best[2], rounds - 1
            trial = self.linearise(x, moving)
            excess = max(0.0, self.excess(trial.y, margin))
            if excess <= TOLERATED or excess < best[0]:
                if excess <= TOLERATED and reached and cost >= best[1]:
                    return best[2], rounds
                best = (excess, cost, trial)
                at, trust = trial, min(UNBOUNDED, 2 * trust)
            else:
                trust = step / 3
        return best[2], rounds

    def remedy(self, name: str, moving: np.ndarray, required: np.ndarray, at: _Linearisation) -> Remedy:
        """The remedy of some characteristics, rounded to changes that can be set and checked on fresh samples.

        Parameters
        ----------
        name : str
        moving : int array
            Numbers of the adjustments.
        required : (k,) array
            Required margin, mm; -∞ for characteristics without a requirement.
        at : _Linearisation
            Start of the search.
        """
        margin, rounds = required, 0
        for batch in range(1, MAX_CHECKS + 1):
            at, more = self._minimise(moving, margin, at)
            rounds += more
            x = np.array([item.settable(change) for item, change in zip(self.available, at.x)])
            sets = [(self.unchanged(b), self.values(b, x)) for b in (0, batch)]
            sets = [pair for pair in sets if len(pair[1])]
            fresh = sets[-1][1]
            excess = self.excess(fresh, required)
            if excess <= TOLERATED or self.excess(at.y, margin) > TOLERATED:  # reached, or out of reach
                break
            known = fresh[np.isfinite(fresh).all(axis=1)]
            margin = margin + np.maximum(0.0, -self.limits.margin(known))
        changes = {item: float(change) for item, change in zip(self.available, x) if change}
        return Remedy(name, changes, excess <= TOLERATED, rounds, [a for a, _ in sets], [b for _, b in sets])


@checked
def remedies(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    shim: float = SHIM,
    factor: float = FACTOR,
    names: Sequence[str] = (),
    capability: float = CAPABILITY,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> Remedies:
    """Find changes that bring the key characteristics within their limits.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples, seed : int
        Size of each set of samples, and seed; the first 20 samples of the first set are evaluated with derivatives.
    shim, factor, names
        Allowed adjustments, see :func:`mic.studies.adjustment.adjustments`.
    capability : float
        Required Cpk.
    threads : int
    progress : callable or bool, optional
        Called with the number of evaluated samples; or whether a bar is shown.

    Raises
    ------
    ArgumentError
        If nothing is measured or nothing can be adjusted, and as :func:`mic.studies.adjustment.adjustments`.
    SceneError
        If parts are held by contact alone.
    """
    scene = model.scene
    available = adjustments(model, shim, factor, names)
    if not scene.measurements:
        raise ArgumentError(f"scene {scene.name!r} has no measurements: there is nothing to remedy")
    if not available:
        raise ArgumentError(f"scene {scene.name!r} has nothing to adjust besides the datum of its measurements")
    limits = Limits(*scene_limits(scene), half_tolerances(scene), 3 * capability)
    search = _Search(model, law, available, limits, samples, seed, threads, progress)
    known = search.unchanged(0)[np.isfinite(search.unchanged(0)).all(axis=1)]
    if not len(known):
        raise SceneError(f"scene {scene.name!r}: every sample fails without any change; see the messages of `mic run`")
    excess = -limits.margin(known) / limits.half
    worst, every = int(excess.argmax()), np.arange(len(available))
    found: list[Remedy] = []
    if excess[worst] > TOLERATED:
        start = search.linearise(np.zeros(len(available)), every)
        required = np.where(np.arange(len(excess)) == worst, 0.0, -np.inf)
        found = [
            search.remedy(available[i].name, np.array([i]), required, start)
            for i in _promising(search, start, required)
        ]
        found.sort(key=lambda remedy: (not remedy.reached, sum(abs(x) / a.size for a, x in remedy.changes.items())))
        together = search.remedy(TOGETHER, every, np.zeros(len(excess)), start)
        if not any(remedy.changes == together.changes for remedy in found):
            found.append(together)
    name, law = scene.measurements[worst].name if found else "", search.process.law
    tables = _change_table(law, found), _effect_table(scene, law, limits, found)
    return Remedies(law, name, len(available), found, *tables)


def _promising(search: _Search, start: _Linearisation, required: np.ndarray) -> list[int]:
    """Numbers of the adjustments that alone, by their derivatives, bring the required characteristics within their
    limits, the smallest first; if there is none, the one with the smallest excess."""
    results = []
    for i, item in enumerate(search.available):
        x, excess = smallest(start.y, start.slopes, search.limits, *search.bounds([i]), margin=required)
        results.append((excess, abs(x[i]) / item.size, i))
    sufficient = sorted((cost, i) for excess, cost, i in results if excess <= TOLERATED)
    return [i for _, i in sufficient[:MAX_SINGLES]] or [min(results)[2]]


def _change_table(law: str, found: Sequence[Remedy]) -> pd.DataFrame:
    """One row for each change of each remedy."""
    rows = [
        (law, remedy.name, item.name, change, item.now + change, remedy.reached, remedy.rounds)
        for remedy in found
        for item, change in remedy.changes.items()
    ]
    return pd.DataFrame(rows, columns=REMEDIES.names) if rows else REMEDIES.empty()


def _effect_table(scene, law: str, limits: Limits, found: Sequence[Remedy]) -> pd.DataFrame:
    """One row for each remedy, set of samples and key characteristic."""
    rows = [
        row
        for remedy in found
        for i, (a, b) in enumerate(zip(remedy.before, remedy.after))
        for row in _effects(scene, limits, a, b, {"law": law, "remedy": remedy.name, "fresh": i == 1})
    ]
    return pd.DataFrame(rows, columns=REMEDY_EFFECTS.names) if rows else REMEDY_EFFECTS.empty()


def _effects(scene, limits: Limits, a: np.ndarray, b: np.ndarray, keys: dict) -> list[dict]:
    """Rows by key characteristic of samples (n, k) before and after, without those that failed in either."""
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    a, b, n = a[known], b[known], int(known.sum())
    gain = limits.margin(b) - limits.margin(a)
    low, high = np.full((2, len(gain)), np.nan)
    if n > 2:
        weights = (1 - np.eye(n)) / (n - 1)  # each without one sample
        low, high = estimates.jackknife_interval(gain, limits.margin(b, weights) - limits.margin(a, weights))
    columns = {"gain": gain, "gain_low": low, "gain_high": high}
    lower, upper = limits.lower, limits.upper
    for suffix, y in (("_before", a), ("", b)):
        share = estimates.share(outside(y, lower, upper), n)
        columns |= {
            f"mean{suffix}": y.mean(axis=0),
            f"six_sigma{suffix}": 6 * y.std(axis=0, ddof=min(1, n - 1)),
            f"cpk{suffix}": np.asarray(centred_capability(y, lower, upper).value),
            f"margin{suffix}": limits.margin(y),
            f"outside{suffix}": share.value,
            f"outside{suffix}_low": share.low,
            f"outside{suffix}_high": share.high,
        }
    return [
        keys
        | {"measurement": item.name, "samples": n, "failed": int((~known).sum())}
        | {name: float(np.atleast_1d(value)[k]) for name, value in columns.items()}
        for k, item in enumerate(scene.measurements)
    ]
