"""Contributors: the share of each deviation in the variance of each key characteristic, under contact.

The shares are Sobol' indices (:mod:`mic.statistics.sobol_indices`) of the reduced model. They are compared with two
linear analyses of the same assembly: the shares of a linear regression, and those of the differences at the mean, which
correspond to a linear tolerance chain. Deviations that belong together, such as the modes of one part's shape, are one
contributor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.errors import ArgumentError
from mic.process.model import ReducedModel
from mic.results.schema import CONTRIBUTORS, LINEARITY
from mic.scene import Scene
from mic.statistics.draw import draw
from mic.statistics.sobol_indices import Indices, Linear, sobol
from mic.studies.input_screening import MANY, bounds, negligible
from mic.studies.samples import Progress, key_characteristics
from mic.system.arguments import checked

__all__ = ["Contributors", "contributors", "evaluation_count", "groups", "joint_ranking"]

SAMPLES = 128  #: samples of each of the two sets
DRAWS = 20_000  #: samples of the deviations alone, for the moments of their linear effects
STEP = 0.1  #: step of the differences at the mean, σ

# Bounds within which a linear analysis is valid.
R_SQUARED = 0.95  # at least
INTERACTION = 0.05  # at most
SIGMA = 0.1  # relative difference of σ, at most
SMALLEST = 1e-4  # mm: key characteristics with a smaller σ have no shares


@dataclass(frozen=True)
class Contributors:
    """Shares of the deviations in the variance of the key characteristics under one law.

    Attributes
    ----------
    table, linearity : DataFrame
        As :data:`mic.results.schema.CONTRIBUTORS` and :data:`mic.results.schema.LINEARITY` declare them.
    """

    table: pd.DataFrame
    linearity: pd.DataFrame


def groups(scene: Scene) -> dict[str, list[int]]:
    """Numbers of the deviations of each contributor: those of one batch, or correlated ones, form one contributor."""
    grouped: dict[str, list[int]] = {}
    for j, item in enumerate(scene.deviations):
        grouped.setdefault(getattr(item, "batch", None) or item.name, []).append(j)
    for table in scene.correlations:
        names = {name: {scene.deviations[j].name for j in columns} for name, columns in grouped.items()}
        joined = [name for name, own in names.items() if own & {*table.deviations}]
        grouped[" + ".join(joined)] = sorted(j for name in joined for j in grouped.pop(name))
    return grouped


def evaluation_count(scene: Scene, samples: int = SAMPLES) -> int | None:
    """Number of evaluations of :func:`contributors`; None if it depends on their results."""
    found = groups(scene)
    return (
        samples * (len(found) + 2) + 2 * sum(item.sigma > 0 for item in scene.deviations)
        if len(found) <= MANY
        else None
    )


@checked
def contributors(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> Contributors:
    """Shares of the deviations in the variance of the key characteristics.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples : int
        N of each set; g contributors and p deviations that vary take N (g + 2) + 2 p evaluations. If there are more
        than :data:`mic.studies.input_screening.MANY` contributors, the negligible ones are joined into one.
    seed : int
    threads : int
    progress : callable or bool, optional
        Called with the number of evaluations after each set; or whether a bar is shown.

    Raises
    ------
    ArgumentError
        If nothing is measured or nothing varies, or the samples are stated in a table.
    """
    scene, every = model.scene, groups(model.scene)
    if not scene.measurements or not every:
        raise ArgumentError(f"scene {scene.name!r} has no {'deviations' if scene.measurements else 'measurements'}")
    if scene.monte_carlo.values is not None:
        raise ArgumentError(
            f"scene {scene.name!r}: its samples are given in a table, which does not show how a single deviation "
            "varies; remove monte_carlo.table and give each deviation a sigma"
        )
    independent = scene.monte_carlo.model_copy(update={"design": "independent"})
    scene = scene.model_copy(update={"monte_carlo": independent})
    process = model.process(law, threads=threads)
    evaluate = lambda x: key_characteristics(process, x, progress)
    x_a, x_b = draw(scene, seed, 0, samples), draw(scene, seed, samples, samples)
    many = draw(scene, seed, 2 * samples, DRAWS)
    a, b = evaluate(x_a), evaluate(x_b)
    separate, bound = every, np.full((len(every), a.shape[1]), np.nan)
    computed = bounds(model, process.law, every, seed=seed, progress=progress) if len(every) > MANY else None
    if computed is not None:
        varies = np.nanstd(a, axis=0) > SMALLEST
        bound = np.where(varies, computed, np.nan)
        separate = _joined(every, negligible(computed, varies))
    every_column = np.arange(x_a.shape[1])
    mixed = np.stack([evaluate(np.where(np.isin(every_column, own), x_b, x_a)) for own in separate.values()])
    slopes, r_squared = _regression(np.concatenate([x_a, x_b]), np.concatenate([a, b]))
    parts = [_parts(x, separate, slopes) for x in (x_a, x_b, many)]
    linear = Linear(parts[0], parts[1], *_moments(parts[2]))
    sigma = many.std(axis=0)
    tangent, _ = _moments(_parts(many, separate, _tangent(model, sigma, evaluate)))
    indices = sobol(a, b, mixed, linear)
    varies = indices.sigma.value > SMALLEST
    law, measured = process.law, [item.name for item in scene.measurements]
    evaluations = samples * (len(separate) + 2) + 2 * int((sigma > 0).sum())
    return Contributors(
        _share_table(law, measured, every, list(separate), indices, varies, [linear.variance, tangent], bound),
        _linearity_table(law, measured, indices, varies, r_squared, tangent, evaluations),
    )


def _joined(every: dict[str, list[int]], out: np.ndarray) -> dict[str, list[int]]:
    """The contributors with those that are left out joined into one."""
    separate = {name: columns for (name, columns), left in zip(every.items(), out) if not left}
    others = sorted(j for columns, left in zip(every.values(), out) if left for j in columns)
    return separate | ({f"{int(out.sum())} others": others} if others else {})


def _regression(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (p, k) of a linear regression and its adjusted R² (k,); 0 and NaN with fewer than 2 p + 3 samples."""
    known = np.isfinite(y).all(axis=1)
    x, y = x[known] - x[known].mean(axis=0), y[known] - y[known].mean(axis=0)
    n, p = x.shape
    if n <= 2 * p + 2:
        return np.zeros((p, y.shape[1])), np.full(y.shape[1], np.nan)
    slopes = np.linalg.lstsq(x, y, rcond=None)[0]
    whole = (y**2).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return slopes, 1 - ((y - x @ slopes) ** 2).sum(axis=0) / whole * (n - 1) / (n - 1 - p)


def _parts(x: np.ndarray, separate: dict[str, list[int]], slopes: np.ndarray) -> np.ndarray:
    """(g, n, k) linear effect of each contributor in each sample."""
    return np.stack([x[:, columns] @ slopes[columns] for columns in separate.values()])


def _moments(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(g, k) variances over samples, and their standard errors."""
    square = (parts - parts.mean(axis=1, keepdims=True)) ** 2
    return square.mean(axis=1), square.std(axis=1) / np.sqrt(parts.shape[1])


def _tangent(model: ReducedModel, sigma: np.ndarray, evaluate) -> np.ndarray:
    """(p, k) central differences at the mean, mm per unit of a deviation; NaN if an evaluation failed."""
    varied = np.flatnonzero(sigma > 0)
    step = np.zeros((len(varied), len(sigma)))
    step[np.arange(len(varied)), varied] = STEP * sigma[varied]
    mean = model.deviations({})
    y = evaluate(np.concatenate([mean + step, mean - step]))
    slopes = np.zeros((len(sigma), y.shape[1]))
    slopes[varied] = (y[: len(varied)] - y[len(varied) :]) / (2 * STEP * sigma[varied, None])
    return slopes


def _share_table(law, measured, every, names: list[str], indices: Indices, varies, variances, bound) -> pd.DataFrame:
    """Shares by key characteristic and contributor, then the bounds of the contributors that are left out."""
    columns = {"law": law, "measurement": np.repeat(measured, len(names)), "contributor": names * len(measured)}
    for index, estimate in (("first", indices.first), ("total", indices.total)):
        for end, values in (("", estimate.value), ("_low", estimate.low), ("_high", estimate.high)):
            columns[f"{index}{end}"] = np.where(varies, values, np.nan).T.ravel()
    for name, variance in zip(("regression", "tangent"), variances):
        with np.errstate(invalid="ignore", divide="ignore"):
            columns[name] = np.where(varies, variance / variance.sum(axis=0), np.nan).T.ravel()
    bounds = {"measurement": np.repeat(measured, len(every)), "contributor": [*every] * len(measured)}
    bound_table = pd.DataFrame(bounds | {"bound": bound.T.ravel()})
    table = pd.DataFrame(columns).merge(bound_table, how="left")
    rest = bound_table[~bound_table["contributor"].isin(names)].assign(law=law)
    return (pd.concat([table, rest], ignore_index=True) if len(rest) else table)[CONTRIBUTORS.names]


def _linearity_table(law, measured, indices: Indices, varies, r_squared, tangent, evaluations: int) -> pd.DataFrame:
    """By key characteristic, whether a linear analysis is valid, and the figures that decide it."""
    sigma, interaction, tangent_sigma = indices.sigma, indices.interaction, np.sqrt(tangent.sum(axis=0))
    linear = (r_squared >= R_SQUARED) & (interaction.value <= INTERACTION)
    linear &= np.abs(tangent_sigma - sigma.value) <= SIGMA * sigma.value
    columns = {"law": law, "measurement": measured, "samples": int(sigma.used), "failed": int(sigma.excluded)}
    columns |= {"evaluations": evaluations, "tangent_sigma": tangent_sigma, "linear": linear | ~varies}
    columns |= {"sigma": sigma.value, "sigma_low": sigma.low, "sigma_high": sigma.high}
    ratios = {"r_squared": r_squared, "interaction": interaction.value}
    ratios |= {"interaction_low": interaction.low, "interaction_high": interaction.high}
    columns |= {name: np.where(varies, values, np.nan) for name, values in ratios.items()}
    return pd.DataFrame(columns)[LINEARITY.names]


def joint_ranking(table: pd.DataFrame, linearity: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """Total indices over all key characteristics, weighted by the squared share of the tolerance that each takes,

        ``T_i = Σ_k T_ik w_k / Σ_k w_k,    w_k = (σ_k / (upper_k − lower_k))²``

    (generalised indices of Lamboni, Monod and Makowski, Reliab. Eng. Syst. Saf. 96 (2011) 450-459).

    Returns
    -------
    DataFrame
        ``law``, ``contributor`` and ``total``, the largest first.
    """
    width = {item.name: item.upper - item.lower for item in scene.measurements}
    weight = (linearity["sigma"] / linearity["measurement"].map(width)) ** 2
    weights = linearity.assign(weight=weight)[["law", "measurement", "weight"]]
    weighted = table.merge(weights).dropna(subset=["total"])
    weighted["share"] = weighted["total"] * weighted["weight"]
    sums = weighted.groupby(["law", "contributor"], sort=False)[["share", "weight"]].sum()
    ranked = (sums["share"] / sums["weight"]).rename("total").reset_index()
    return ranked.sort_values(["law", "total"], ascending=[True, False], kind="stable", ignore_index=True)
