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

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import linprog

from mic.process.model import ReducedModel
from mic.results.schema import REMEDIES, REMEDY_EFFECTS
from mic.statistics import estimates
from mic.statistics.capability import centred_capability, outside
from mic.statistics.draw import draw
from mic.statistics.estimates import LEVEL
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments, extended

__all__ = ["CAPABILITY", "SAMPLES", "Limits", "Remedies", "Remedy", "remedies", "smallest"]

SAMPLES = 60
DERIVED = 20  # first samples that are evaluated with derivatives, which cost several evaluations each
CAPABILITY = 1.0  #: required Cpk
SINGLES = 3  # remedies with a single adjustment that are evaluated in full
ROUNDS = 10  # largest number of linearisations per remedy
JUDGED = 3  # largest number of sets of fresh samples
REACHED = 1e-3  # tolerated excess over a limit, relative to half the tolerance
CHEAPER = 0.9  # ratio of costs below which another linearisation is worthwhile
CUTS = 60  # largest number of cutting planes
WHOLE = 2.0  # range of a change, relative to the largest allowed change
SHORT = 1e4  # penalty for an excess of half the tolerance
RESAMPLES = 1000  # bootstrap resamples
TOGETHER = "together"

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Limits:
    """Limits of k key characteristics, mm.

    Attributes
    ----------
    lower, upper : (k,) array
        -∞ where there is no lower one.
    half : (k,) array
        Half the tolerance.
    spread : float
        How many σ are to lie within them on either side of the mean.
    """

    lower: np.ndarray
    upper: np.ndarray
    half: np.ndarray
    spread: float

    @classmethod
    def of(cls, scene, capability: float = CAPABILITY) -> Limits:
        lower, upper = np.array([item.bounds for item in scene.measurements]).T
        half = np.array([(item.upper - item.lower) / 2 for item in scene.measurements])
        return cls(lower, upper, half, 3 * capability)

    def margin(self, y: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """(k,) how far ``mean ± spread σ`` of samples (n, k) lies within the limits, mm, negative beyond; (r, k) under
        each of weightings (r, n)."""
        n, off = len(y), y - y.mean(axis=0)
        w = np.full((1, n), 1 / n) if weights is None else weights
        m = w @ off
        sigma = np.sqrt(np.maximum(w @ off**2 - m**2, 0.0) * n / max(n - 1, 1))
        m = m + y.mean(axis=0)
        found = np.minimum(self.upper - m, m - self.lower) - self.spread * sigma
        return found[0] if weights is None else found


@dataclass(frozen=True)
class Remedy:
    """Changes that were evaluated in full.

    Attributes
    ----------
    name : str
        The adjustment's, or ``together``.
    changes : dict of Adjustment to float
        mm or N.
    reached : bool
        Whether what was to be within its limits is, of fresh samples: the worst characteristic, or all of them.
    rounds : int
        Times that the samples were taken through the process with their derivatives.
    before, after : list of (n, k) array
        Key characteristics as they are and with the changes, of the samples that it was found with, and of fresh ones,
        where there are any.
    """

    name: str
    changes: dict[Adjustment, float]
    reached: bool
    rounds: int
    before: list[np.ndarray]
    after: list[np.ndarray]


@dataclass(frozen=True)
class Remedies:
    """What would bring an assembly within its limits under one law.

    Attributes
    ----------
    law : str
    worst : str
        The key characteristic that is farthest beyond its limits; empty where all are within them.
    adjustable : int
        How many adjustments there are to choose from.
    found : list of Remedy
        Of one adjustment each, for the worst characteristic, the smallest first; then of all together, for all of them.
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
    trust: float = WHOLE,
    ask: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """The smallest changes that bring samples within limits, by their derivatives.

    Parameters
    ----------
    y : (n, k) array
        Key characteristics, mm.
    slopes : (n, k, a) array
        Their derivatives, mm per unit of each change.
    limits : Limits
    low, high : (a,) array
        Bounds of the changes, ``low ≤ 0 ≤ high``; those between 0 and 0 are not made.
    at : (a,) array, optional
        The changes that `y` and `slopes` belong to; default: none.
    trust : float
        By how much changes may differ from those, as a share of the largest that is allowed; 2 is no bound.
    ask : (k,) array, optional
        How far within the limits ``mean ± spread σ`` is to lie, mm; -∞ where it does not matter. Default: 0.

    Returns
    -------
    (a,) array, float
        Changes; and by how much they fall short of what is asked, the most over the characteristics, as a share of half
        the tolerance. That is made as small as it can be; the changes are the smallest that do.
    """
    n, k, a = slopes.shape
    at, ask = np.zeros(a) if at is None else at, np.zeros(k) if ask is None else ask
    size = np.maximum(-low, high)
    mean, gradient = y.mean(axis=0), slopes.mean(axis=0)
    joint = np.concatenate([y[..., None], slopes], axis=2)
    joint = (joint - joint.mean(axis=0)) / np.sqrt(max(n - 1, 1))
    square = np.einsum("nki,nkj->kij", joint, joint)

    def sigma(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) σ, and (k, a) its derivative."""
        q = np.concatenate([[1.0], x - at])
        found = np.sqrt(np.maximum(np.einsum("i,kij,j->k", q, square, q), 0.0))
        turned = (square @ q)[:, 1:]
        return found, np.divide(turned, found[:, None], out=np.zeros_like(turned), where=found[:, None] > 0)

    # Unknowns: changes up and down, and the shortfall.
    own = np.divide(1.0, size, out=np.zeros(a), where=size > 0)
    costs = np.concatenate([own, own, [SHORT]])
    up, down = np.minimum(high, at + trust * size), np.maximum(low, at - trust * size)
    bounds = [*zip(np.maximum(down, 0), np.maximum(up, 0)), *zip(np.maximum(-up, 0), np.maximum(-down, 0)), (0, None)]
    A: list[np.ndarray] = []
    b: list[np.ndarray] = []
    sides = [
        (sign, limit, np.flatnonzero(np.isfinite(limit) & np.isfinite(ask)))
        for sign, limit in ((1.0, limits.upper), (-1.0, limits.lower))
    ]
    x, found = at, np.zeros(2 * a + 1)
    for _ in range(CUTS):
        value, turned = sigma(x)
        worst = -np.inf
        for sign, limit, own in sides:
            beyond = sign * (mean + gradient @ (x - at) - limit) + limits.spread * value + ask
            worst = max(worst, (beyond / limits.half - found[-1])[own].max(initial=-np.inf))
            line = (sign * gradient + limits.spread * turned) / limits.half[:, None]
            A.append(np.column_stack([line, -line, -np.ones(k)])[own])
            b.append((line @ x - beyond / limits.half)[own])
        if len(A) > 2 and worst <= REACHED / 10:
            break
        done = linprog(costs, np.concatenate(A), np.concatenate(b), bounds=bounds, method="highs")
        if done.x is None:
            break
        found = done.x
        x = found[:a] - found[a : 2 * a]
    return x, float(found[-1])


@dataclass(frozen=True)
class _Place:
    """Changes x (a,), key characteristics y (n, k) of the samples there, and their derivatives (n, k, a)."""

    x: np.ndarray
    y: np.ndarray
    slopes: np.ndarray


class _Search:
    """Samples and their derivatives at any changes of the adjustments."""

    def __init__(self, model, law, some, limits, samples, seed, threads, progress):
        self.extended, self.names = extended(model, some)
        self.some, self.limits, self.law = some, limits, law
        self.scene, self.samples, self.seed, self.progress = model.scene, samples, seed, progress
        self.process = self.extended.process(law, threads=threads)
        self.low, self.high = (np.array([getattr(one, end) for one in some]) for end in ("low", "high"))
        self.drawn = self._drawn(0)[:DERIVED]

    def _drawn(self, batch: int) -> np.ndarray:
        """(n, p) deviations of a set of samples: 0 those that remedies are found with, others fresh ones."""
        if not self.scene.deviations:
            return np.zeros((1 if batch == 0 else 0, 0))
        return draw(self.scene, self.seed, batch * self.samples, self.samples)

    def values(self, batch: int, x: np.ndarray) -> np.ndarray:
        """(n, k) of a set of samples with changes; NaN where one failed."""
        drawn = self._drawn(batch)
        if not len(drawn):
            return np.zeros((0, len(self.scene.measurements)))
        found = self.process.attempt(np.column_stack([drawn, np.tile(x, (len(drawn), 1))]))
        self.progress(len(drawn))
        return np.where(found.failed[:, None], np.nan, found.measurements)

    def place(self, x: np.ndarray, own: np.ndarray) -> _Place:
        """The samples at changes (a,), with derivatives with respect to some of them, and without those that failed."""
        whole = np.column_stack([self.drawn, np.tile(x, (len(self.drawn), 1))])
        found = self.extended.sensitivities(whole, self.law, [self.names[i] for i in own])
        self.progress(len(whole))
        known = ~found.failed & np.isfinite(found.jacobian).all(axis=(1, 2))
        slopes = np.zeros((int(known.sum()), found.measurements.shape[1], len(self.some)))
        slopes[:, :, own] = found.jacobian[known]
        return _Place(x, found.measurements[known], slopes)

    def short(self, y: np.ndarray, ask: np.ndarray) -> float:
        """By how much samples fall short, the most over the characteristics, as a share of half the tolerance."""
        y = y[np.isfinite(y).all(axis=1)]
        if not len(y):
            return np.inf
        return float(((ask - self.limits.margin(y)) / self.limits.half).max())

    def sought(self, own: np.ndarray, ask: np.ndarray, start: _Place) -> tuple[_Place, int]:
        """Changes of some adjustments that bring the samples to what is asked, or as near as they come, and the rounds
        that took."""
        inside = np.isin(np.arange(len(self.some)), own)
        low, high = np.where(inside, self.low, 0.0), np.where(inside, self.high, 0.0)
        size = np.maximum(-low, high).clip(np.finfo(float).tiny)
        at, trust = start, WHOLE
        best, rounds = (max(0.0, self.short(at.y, ask)), float(np.abs(at.x / size).sum()), at), 0
        for rounds in range(1, ROUNDS + 1):
            step, _ = smallest(at.y, at.slopes, self.limits, low, high, at.x, trust, ask)
            way = float(np.abs((step - at.x) / size).max())
            cost = float(np.abs(step / size).sum())
            reached = best[0] <= REACHED
            if way < 1e-3 or (reached and cost > CHEAPER * best[1]):
                return best[2], rounds - 1
            there = self.place(step, own)
            short = max(0.0, self.short(there.y, ask))
            if short <= REACHED or short < best[0]:
                if short <= REACHED and reached and cost >= best[1]:
                    return best[2], rounds
                best = (short, cost, there)
                at, trust = there, min(WHOLE, 2 * trust)
            else:
                trust = way / 3
        return best[2], rounds

    def remedy(self, name: str, own: np.ndarray, wanted: np.ndarray, at: _Place, before: dict) -> Remedy:
        """Found, set as it can be set, and judged on fresh samples."""
        ask, rounds = np.where(wanted, 0.0, -np.inf), 0
        for batch in range(1, JUDGED + 1):
            at, more = self.sought(own, ask, at)
            rounds += more
            x = np.array([one.settable(change) for one, change in zip(self.some, at.x)])
            for b in (0, batch):
                if b not in before:
                    before[b] = self.values(b, np.zeros(len(x)))
            after = [self.values(b, x) for b in (0, batch)]
            fresh = after[1] if len(after[1]) else after[0]
            plain = np.where(wanted, 0.0, -np.inf)
            short = self.short(fresh, plain)
            if short <= REACHED or self.short(at.y, ask) > REACHED:  # done, or nothing more can be asked for
                break
            known = fresh[np.isfinite(fresh).all(axis=1)]
            ask = ask + np.maximum(0.0, -self.limits.margin(known))
        keep = [i for i, y in enumerate(after) if len(y)]
        return Remedy(
            name,
            {one: float(change) for one, change in zip(self.some, x) if change},
            short <= REACHED,
            rounds,
            [[before[0], before[batch]][i] for i in keep],
            [after[i] for i in keep],
        )


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
    """Find what would bring the key characteristics within their limits.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples, seed : int
        Of each set of samples; derivatives are taken of the first 20 of the first set.
    shim, factor, names
        What may be adjusted, as :func:`mic.studies.adjustment.adjustments` has it.
    capability : float
        Cpk that is asked for.
    threads : int
    progress : callable, optional
        Called with the number of samples that were taken through the process.

    Raises
    ------
    ValueError
        If nothing is measured or nothing can be adjusted, and as :func:`mic.studies.adjustment.adjustments`.
    SceneError
        Where parts rest by contact alone.
    """
    scene = model.scene
    some = adjustments(model, shim, factor, names)
    if not scene.measurements or not some:
        what = "be adjusted but what it is measured from" if scene.measurements else "be remedied: nothing is measured"
        raise ValueError(f"scene {scene.name!r} has nothing that can {what}")
    limits = Limits.of(scene, capability)
    search = _Search(model, law, some, limits, samples, seed, threads, progress)
    before = {0: search.values(0, np.zeros(len(some)))}
    known = before[0][np.isfinite(before[0]).all(axis=1)]
    if not len(known):
        raise ValueError(f"scene {scene.name!r}: no sample can be evaluated as it is")
    short = -limits.margin(known) / limits.half
    worst, every = int(short.argmax()), np.arange(len(some))
    found: list[Remedy] = []
    if short[worst] > REACHED:
        first = search.place(np.zeros(len(some)), every)
        alone = np.arange(len(short)) == worst
        for i in _promising(search, first, alone):
            found.append(search.remedy(some[i].name, np.array([i]), alone, first, before))
        found.sort(key=lambda one: (not one.reached, sum(abs(x) / a.size for a, x in one.changes.items())))
        together = search.remedy(TOGETHER, every, np.ones(len(short), dtype=bool), first, before)
        if not any(one.changes == together.changes for one in found):
            found.append(together)
    name = scene.measurements[worst].name if short[worst] > REACHED else ""
    return Remedies(search.process.law, name, len(some), found, *_tabled(scene, search.process.law, limits, found))


def _promising(search: _Search, first: _Place, wanted: np.ndarray) -> list[int]:
    """The adjustments that alone, by their derivatives, bring the wanted characteristics within their limits, the
    smallest first; if none does, the one that brings them nearest."""
    ask, told = np.where(wanted, 0.0, -np.inf), []
    for i in range(len(search.some)):
        own = np.arange(len(search.some)) == i
        x, short = smallest(
            first.y,
            first.slopes,
            search.limits,
            np.where(own, search.low, 0.0),
            np.where(own, search.high, 0.0),
            ask=ask,
        )
        told.append((short, abs(x[i]) / search.some[i].size, i))
    reach = sorted((cost, i) for short, cost, i in told if short <= REACHED)
    return [i for _, i in reach[:SINGLES]] or [min(told)[2]]


def _tabled(scene, law, limits: Limits, found: Sequence[Remedy]) -> tuple[pd.DataFrame, pd.DataFrame]:
    moves, effects = [], []
    for one in found:
        for own, change in one.changes.items():
            moves.append((law, one.name, own.name, change, own.now + change, one.reached, one.rounds))
        for i, (a, b) in enumerate(zip(one.before, one.after)):
            effects += _effects(scene, limits, a, b, {"law": law, "remedy": one.name, "fresh": i == 1})
    types = {"change": "float64", "value": "float64", "reached": "bool", "rounds": "int64"}
    table = pd.DataFrame(moves, columns=REMEDIES.names).astype(types)
    return table, pd.DataFrame(effects, columns=REMEDY_EFFECTS.names) if effects else REMEDY_EFFECTS.empty()


def _effects(scene, limits: Limits, a: np.ndarray, b: np.ndarray, keys: dict) -> list[dict]:
    """Rows of samples (n, k) before and after, of those that did not fail in either."""
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    a, b, n = a[known], b[known], int(known.sum())
    stream = np.random.Generator(np.random.Philox(key=n))
    weights = stream.multinomial(n, np.full(n, 1 / max(n, 1)), size=RESAMPLES) / max(n, 1)
    gain = limits.margin(b) - limits.margin(a)
    drawn = limits.margin(b, weights) - limits.margin(a, weights)
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    rows = [
        keys | {"measurement": item.name, "samples": n, "failed": int((~known).sum())} for item in scene.measurements
    ]
    lower, upper = limits.lower, limits.upper
    for word, y in (("_before", a), ("", b)):
        columns = {
            f"mean{word}": y.mean(axis=0),
            f"six_sigma{word}": 6 * y.std(axis=0, ddof=min(1, n - 1)),
            f"cpk{word}": np.asarray(centred_capability(y, lower, upper).value),
            f"margin{word}": limits.margin(y),
        }
        share = estimates.share(outside(y, lower, upper), n)
        columns |= {
            f"outside{word}{e}": getattr(share, at) for e, at in (("", "value"), ("_low", "low"), ("_high", "high"))
        }
        for k, row in enumerate(rows):
            row |= {name: float(np.atleast_1d(value)[k]) for name, value in columns.items()}
    for k, row in enumerate(rows):
        row |= {"gain": float(gain[k]), "gain_low": float(low[k]), "gain_high": float(high[k])}
    return rows
