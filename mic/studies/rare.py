"""Probability of rare limit violations by subset simulation on the reduced model, without a fitted distribution.

A rare event ``g(z) > 0`` in standard normal numbers z is reached by levels ``b_1 < b_2 < … < 0``, each exceeded by a
tenth of the samples that exceed the one before [1]_:

    P = p₀^(m−1) P(g > 0 | g > b_{m−1}),        p₀ = 0.1.

The first-order probability (:mod:`mic.studies.first_order_reliability`) is reported for comparison.

Samples beyond a level are drawn by Markov chains that start from the samples already there. The proposals
``z' = ρ z + √(1 − ρ²) ξ`` preserve the normal distribution and are rejected below the level; ρ adapts to the acceptance
rate [2]_. SciPy and SALib have no subset simulation.

References
----------
.. [1] S.-K. Au, J. L. Beck: Estimation of small failure probabilities in high dimensions by subset simulation,
       Probab. Eng. Mech. 16 (2001) 263-277.
.. [2] I. Papaioannou, W. Betz, K. Zwirglmaier, D. Straub: MCMC algorithms for subset simulation, Probab. Eng. Mech. 41
       (2015) 89-103.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtr, ndtri

from mic.errors import ArgumentError, SceneError
from mic.process.model import ReducedModel
from mic.results.schema import DESIGN_POINTS, RARE
from mic.statistics import estimates
from mic.statistics.draw import at_probabilities, number_count
from mic.statistics.estimates import LEVEL
from mic.studies.first_order_reliability import design_points, first_order
from mic.studies.samples import Progress, half_tolerances, valid
from mic.system.arguments import checked

__all__ = ["RareFailures", "Subset", "agree", "rare", "subset_simulation"]

SAMPLES = 1000  #: samples per level
SHARE = 0.1  # p₀: share of the samples of a level that lie beyond the next
MAX_LEVELS = 12  # largest number of levels: probabilities below 1e-12 are not resolved
ACCEPTED = 0.44  # target of the acceptance rate


@dataclass(frozen=True)
class Subset:
    """Result of a subset simulation.

    Attributes
    ----------
    probability, low, high : float
        P and its confidence interval of at least 95 %; 0 and an upper bound if P lies below the last level.
    levels : int
        1 if the event is not rare: then the result is that of plain Monte Carlo with its exact interval.
    evaluations : int
    """

    probability: float
    low: float
    high: float
    levels: int
    evaluations: int


def subset_simulation(
    g: Callable[[np.ndarray], np.ndarray], dimension: int, samples: int = SAMPLES, seed: int = 0
) -> Subset:
    """Probability of ``g(z) > 0`` for standard normal z.

    Parameters
    ----------
    g : callable
        Maps numbers (n, d) to (n,); −∞ where it is unknown.
    dimension : int
        d.
    samples : int
        N of each level, a multiple of 10.
    seed : int
    """
    stream = np.random.Generator(np.random.Philox(key=np.array([seed, samples], dtype=np.uint64)))
    chains, steps = round(samples * SHARE), round(1 / SHARE)
    z = stream.standard_normal((samples, dimension))
    y = g(z)
    beyond = int((y > 0).sum())
    if beyond >= chains:
        estimate = estimates.share(beyond, samples)
        return Subset(float(estimate.value), float(estimate.low), float(estimate.high), 1, samples)
    P, ρ, evaluations = 1.0, 0.8, samples
    δ = np.sqrt((1 - SHARE) / (SHARE * samples))  # relative errors of the levels, added as if fully correlated
    for level in range(2, MAX_LEVELS + 1):
        order = np.argsort(-y, kind="stable")[:chains]
        b, P = float(y[order[-1]]), P * SHARE
        start = stream.permutation(order)
        at, value = z[start], y[start]
        zs, ys, accepted = [at], [value], []
        for _ in range(steps - 1):
            move = ρ * at + np.sqrt(1 - ρ**2) * stream.standard_normal(at.shape)
            new = g(move)
            evaluations += chains
            accepted_moves = new >= b
            at, value = np.where(accepted_moves[:, None], move, at), np.where(accepted_moves, new, value)
            accepted.append(accepted_moves.mean())
            zs.append(at)
            ys.append(value)
        # ρ² + λ² = 1: the step λ of the next level grows with the acceptance rate; it is constant within a level.
        λ = np.sqrt(1 - ρ**2) * np.exp(np.mean(accepted) - ACCEPTED)
        ρ = np.sqrt(1 - min(λ, 0.98) ** 2)
        z, y = np.concatenate(zs), np.concatenate(ys)
        inside = np.stack(ys, axis=1) > 0  # (chains, steps)
        last = inside.sum() >= chains or level == MAX_LEVELS
        beyond_next = inside if last else np.stack(ys, axis=1) >= np.sort(y)[-chains]
        p = max(float(beyond_next.mean()), 1 / samples)
        δ += np.sqrt((1 - p) / (p * samples) * (1 + _correlation(beyond_next)))
        if last:
            break
    P *= float(inside.mean())
    if P == 0:
        return Subset(0.0, 0.0, SHARE ** (level - 1), level, evaluations)
    width = np.exp(ndtri((1 + LEVEL) / 2) * np.sqrt(np.log1p(δ**2)))
    return Subset(P, P / width, min(1.0, P * width), level, evaluations)


def _correlation(inside: np.ndarray) -> float:
    """γ of [1]_: relative increase of the variance of the mean by the correlation along chains (c, s)."""
    c, s = inside.shape
    p = inside.mean()
    if not 0 < p < 1:
        return 0.0
    difference = inside - p
    lagged = [(difference[:, k:] * difference[:, : s - k]).sum() / (c * (s - k)) for k in range(1, s)]
    return max(0.0, 2 * float(sum((1 - k / s) * r for k, r in zip(range(1, s), lagged))) / (p * (1 - p)))


@dataclass(frozen=True)
class RareFailures:
    """Probabilities of limit violations under one law.

    Attributes
    ----------
    table, points : DataFrame
        As :data:`mic.results.schema.RARE` and :data:`mic.results.schema.DESIGN_POINTS` declare them.
    why_not : str
        Reason if there are no design points.
    """

    table: pd.DataFrame
    points: pd.DataFrame
    why_not: str


def agree(row) -> bool:
    """Whether the first-order probability agrees with subset simulation: within its interval, or to a fifth."""
    near = 0.8 * row["outside"] <= row["first_order"] <= 1.25 * row["outside"]
    return bool(near or row["outside_low"] <= row["first_order"] <= row["outside_high"])


@checked
def rare(
    model: ReducedModel,
    law: str | None = None,
    names: Sequence[str] = (),
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> RareFailures:
    """Probability that any limit is violated, and those of single key characteristics.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    names : sequence of str
        Key characteristics that are evaluated individually as well.
    samples, seed : int
        See :func:`subset_simulation`.
    threads : int
    progress : callable or bool, optional
        Called with the number of evaluations after each batch; or whether a bar is shown.

    Raises
    ------
    ArgumentError
        If nothing is measured or nothing varies, or the samples are stated in a table.
    """
    scene = model.scene
    if not scene.measurements or not scene.deviations or scene.monte_carlo.values is not None:
        what = "states its samples in a table" if scene.monte_carlo.values is not None else "measures or varies nothing"
        raise ArgumentError(f"scene {scene.name!r} {what}: the probability of rare violations cannot be computed")
    items = scene.measurements
    for name in names:
        if name not in (known := [item.name for item in items]):
            raise ArgumentError(f"names: {name!r} is no key characteristic of this scene; it has: {', '.join(known)}")
    process = model.process(law, threads=threads)
    middle = np.array([(item.lower + item.upper) / 2 for item in items])
    half = half_tolerances(scene)
    rows, evaluated = [], []
    groups = {name: [k for k, item in enumerate(items) if name in ("", item.name)] for name in ("", *names)}
    for name, selected in groups.items():
        failed = 0

        def g(z: np.ndarray, selected=selected) -> np.ndarray:
            nonlocal failed
            evaluation = process.attempt(at_probabilities(scene, ndtr(z)))
            progress(len(z))
            failed += int(evaluation.failed.sum())
            evaluated.append((z, valid(evaluation)))
            excess = (np.abs(evaluation.measurements - middle) / half)[:, selected].max(axis=1) - 1
            return np.where(evaluation.failed, -np.inf, excess)

        subset = subset_simulation(g, number_count(scene), samples, seed)
        rows.append(
            [process.law, name, subset.probability, subset.low, subset.high, subset.levels, subset.evaluations, failed]
        )
    z, y = (np.concatenate(each) for each in zip(*evaluated))
    table = pd.DataFrame(rows, columns=RARE.names[: len(rows[0])]).assign(first_order=np.nan)
    points, why_not = DESIGN_POINTS.empty(), ""
    try:
        points, design, limits = design_points(model, process.law, z, y, progress)
        table["first_order"] = [first_order(design, limits, group) for group in groups.values()]
    except SceneError as problem:
        why_not = str(problem)
    table["agrees"] = [agree(row) for row in table.to_dict("records")]
    return RareFailures(table, points, why_not)
