"""Contributors: the share of each deviation in the variance of each key characteristic, under contact.

Sobol' indices (:mod:`mic.statistics.sobol_indices`) of the reduced model, and for comparison those of a linear analysis
of the same assembly: the shares of a linear regression, and those of the differences at the mean, as a linear
chain of tolerances takes them. Deviations that belong together, such as the modes of one part's shape, are one
contributor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.process.model import ReducedModel
from mic.results.schema import CONTRIBUTORS, LINEARITY
from mic.scene import Scene
from mic.statistics.draw import draw
from mic.statistics.sobol_indices import Indices, Linear, sobol
from mic.studies.input_screening import MANY, bounds, left_out

__all__ = ["Contributors", "contributors", "groups", "joint_ranking"]

SAMPLES = 128  #: of each of the two sets
DRAWS = 20_000  #: of the deviations alone, for the moments of what is linear in them
STEP = 0.1  #: σ, of the differences at the mean

# A linear analysis can be believed within these.
R_SQUARED = 0.95
INTERACTION = 0.05
SIGMA = 0.1
SMALLEST = 1e-4  # mm, of σ: of what varies less no share is told

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Contributors:
    """What drives the key characteristics of a model under one law.

    Attributes
    ----------
    table, linearity : DataFrame
        As :data:`mic.results.schema.CONTRIBUTORS` and :data:`mic.results.schema.LINEARITY` declare them.
    """

    table: pd.DataFrame
    linearity: pd.DataFrame


def groups(scene: Scene) -> dict[str, list[int]]:
    """The scene's deviations by contributor: those of one batch, or correlated, are one, all others stand for
    themselves."""
    found: dict[str, list[int]] = {}
    for j, item in enumerate(scene.deviations):
        found.setdefault(getattr(item, "batch", None) or item.name, []).append(j)
    for table in scene.correlations:
        joined = [name for name, own in found.items() if {scene.deviations[j].name for j in own} & {*table.deviations}]
        found[" + ".join(joined)] = sorted(j for name in joined for j in found.pop(name))
    return found


def contributors(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> Contributors:
    """Find what drives the key characteristics.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples : int
        N of each set; N (g + 2) + 2 p evaluations are made of g contributors and p deviations that vary. If there
        are more than :data:`mic.studies.input_screening.MANY` contributors, those that hardly matter count as one.
    seed : int
    threads : int
    progress : callable, optional
        Called with the number of evaluations after each set.

    Raises
    ------
    ValueError
        If nothing is measured or nothing varies.
    """
    scene, own = model.scene, groups(model.scene)
    if not scene.measurements or not own:
        raise ValueError(f"scene {scene.name!r} has no {'deviations' if scene.measurements else 'measurements'}")
    if scene.monte_carlo.values is not None:
        raise ValueError(
            f"scene {scene.name!r} states its samples in a table, which says nothing of what varies alone: take the "
            "table out, and give each deviation its sigma"
        )
    independent = scene.monte_carlo.model_copy(update={"design": "independent"})
    scene = scene.model_copy(update={"monte_carlo": independent})
    process = model.process(law, threads=threads)

    def measured(deviations: np.ndarray) -> np.ndarray:
        """(n, k) key characteristics, mm; NaN where the sample failed."""
        found = process.attempt(deviations)
        progress(len(deviations))
        return np.where(found.failed[:, None], np.nan, found.measurements)

    x_a, x_b = draw(scene, seed, 0, samples), draw(scene, seed, samples, samples)
    many = draw(scene, seed, 2 * samples, DRAWS)
    a, b = measured(x_a), measured(x_b)
    every, bound = own, np.full((len(own), a.shape[1]), np.nan)
    if len(own) > MANY:
        found_bound = bounds(model, process.law, own, seed=seed, progress=progress)
        if found_bound is not None:
            varies = np.nanstd(a, axis=0) > SMALLEST
            bound = np.where(varies, found_bound, np.nan)
            own = _joined(own, left_out(found_bound, varies))
    mixed = np.stack([measured(_with(x_a, columns, x_b)) for columns in own.values()])
    slopes, r_squared = _regression(np.concatenate([x_a, x_b]), np.concatenate([a, b]))
    linear = Linear(_parts(x_a, own, slopes), _parts(x_b, own, slopes), *_moments(_parts(many, own, slopes)))
    found = sobol(a, b, mixed, linear)
    tangent, _ = _moments(_parts(many, own, _tangent(model, many.std(axis=0), measured)))
    evaluations = samples * (len(own) + 2) + 2 * int((many.std(axis=0) > 0).sum())
    done = _tabled(model, process.law, list(own), found, r_squared, linear.variance, tangent, evaluations)
    return Contributors(_with_bounds(done.table, every, own, bound, process.law, scene), done.linearity)


def _joined(own: dict[str, list[int]], out: np.ndarray) -> dict[str, list[int]]:
    """Contributors of which those that are left out are one."""
    names = list(own)
    kept = {name: own[name] for name, left in zip(names, out) if not left}
    others = sorted(j for name, left in zip(names, out) if left for j in own[name])
    return kept | ({f"{int(out.sum())} others": others} if others else {})


def _with_bounds(table, every, own, bound: np.ndarray, law: str, scene) -> pd.DataFrame:
    """The table with the bounds, and rows of the contributors that were left out."""
    told = {(item.name, name): bound[i, k] for i, name in enumerate(every) for k, item in enumerate(scene.measurements)}
    keys = list(zip(table["measurement"], table["contributor"]))
    table = table.assign(bound=[float(told.get(key, np.nan)) for key in keys])
    rest = [
        {"law": law, "measurement": item.name, "contributor": name, "bound": float(told[item.name, name])}
        for item in scene.measurements
        for name in every
        if name not in own
    ]
    return pd.concat([table, pd.DataFrame(rest)], ignore_index=True)[CONTRIBUTORS.names] if rest else table


def _with(x: np.ndarray, columns: Sequence[int], other: np.ndarray) -> np.ndarray:
    """Samples with some columns of others."""
    mixed = x.copy()
    mixed[:, columns] = other[:, columns]
    return mixed


def _regression(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (p, k) of a linear regression, and its R² (k,), corrected; 0 and NaN with fewer than 2 p samples."""
    known = np.isfinite(y).all(axis=1)
    x, y = x[known] - x[known].mean(axis=0), y[known] - y[known].mean(axis=0)
    n, p = x.shape
    if n <= 2 * p + 2:
        return np.zeros((p, y.shape[1])), np.full(y.shape[1], np.nan)
    slopes = np.linalg.lstsq(x, y, rcond=None)[0]
    whole = (y**2).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return slopes, 1 - ((y - x @ slopes) ** 2).sum(axis=0) / whole * (n - 1) / (n - 1 - p)


def _parts(x: np.ndarray, own: dict[str, list[int]], slopes: np.ndarray) -> np.ndarray:
    """(g, n, k) what is linear in each contributor."""
    return np.stack([x[:, columns] @ slopes[columns] for columns in own.values()])


def _moments(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(g, k) variances over samples, and their standard errors."""
    square = (parts - parts.mean(axis=1, keepdims=True)) ** 2
    return square.mean(axis=1), square.std(axis=1) / np.sqrt(parts.shape[1])


def _tangent(model: ReducedModel, sigma: np.ndarray, measured) -> np.ndarray:
    """(p, k) central differences at the mean, mm per unit of a deviation; NaN where an evaluation failed."""
    moving = np.flatnonzero(sigma > 0)
    step = np.zeros((len(moving), len(sigma)))
    step[np.arange(len(moving)), moving] = STEP * sigma[moving]
    mean = model.deviations({})
    y = measured(np.concatenate([mean + step, mean - step]))
    found = np.zeros((len(sigma), y.shape[1]))
    found[moving] = (y[: len(moving)] - y[len(moving) :]) / (2 * STEP * sigma[moving, None])
    return found


def _tabled(model, law, names, found: Indices, r_squared, regression, tangent, evaluations) -> Contributors:
    items = model.scene.measurements
    varies = found.sigma.value > SMALLEST
    shares = [_shares(part, varies) for part in (regression, tangent)]
    tangent_sigma = np.sqrt(tangent.sum(axis=0))
    ends = ("interaction", "interaction_low", "interaction_high")
    rows, told = [], []
    for k, item in enumerate(items):
        for i, name in enumerate(names):
            row = {"law": law, "measurement": item.name, "contributor": name}
            for index, estimate in (("first", found.first), ("total", found.total)):
                told_of = (_told(x[i, k], varies[k]) for x in (estimate.value, estimate.low, estimate.high))
                row |= dict(zip((index, f"{index}_low", f"{index}_high"), told_of))
            rows.append(row | {"regression": float(shares[0][i, k]), "tangent": float(shares[1][i, k])})
        sigma, most = ([float(x[k]) for x in (e.value, e.low, e.high)] for e in (found.sigma, found.interaction))
        holds = (
            r_squared[k] >= R_SQUARED
            and most[0] <= INTERACTION
            and abs(tangent_sigma[k] - sigma[0]) <= SIGMA * sigma[0]
        )
        told.append(
            {
                "law": law,
                "measurement": item.name,
                "samples": int(found.sigma.used),
                "failed": int(found.sigma.excluded),
                "evaluations": evaluations,
                **dict(zip(("sigma", "sigma_low", "sigma_high"), sigma)),
                "r_squared": _told(r_squared[k], varies[k]),
                **{end: _told(x, varies[k]) for end, x in zip(ends, most)},
                "tangent_sigma": float(tangent_sigma[k]),
                "linear": bool(holds or not varies[k]),
            }
        )
    table, linearity = pd.DataFrame(rows), pd.DataFrame(told)
    return Contributors(table, linearity[LINEARITY.names])


def _told(value: float, varies: bool) -> float:
    return float(value) if varies else float("nan")


def _shares(variance: np.ndarray, varies: np.ndarray) -> np.ndarray:
    """(g, k) shares of what the contributors make together."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(varies, variance / variance.sum(axis=0), np.nan)


def joint_ranking(table: pd.DataFrame, linearity: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """Which contributor hurts most overall: total indices over all key characteristics, weighed by how much of its
    tolerance each takes,

        ``T_i = Σ_k T_ik w_k / Σ_k w_k,    w_k = (σ_k / (upper_k − lower_k))²``

    (generalised indices of Lamboni, Monod and Makowski, Reliab. Eng. Syst. Saf. 96 (2011) 450-459).

    Returns
    -------
    DataFrame
        ``law``, ``contributor`` and ``total``, the largest first.
    """
    width = {item.name: item.upper - item.lower for item in scene.measurements}
    told = linearity.assign(weight=(linearity["sigma"] / linearity["measurement"].map(width)) ** 2)
    whole = table.merge(told[["law", "measurement", "weight"]]).dropna(subset=["total"])
    whole["share"] = whole["total"] * whole["weight"]
    summed = whole.groupby(["law", "contributor"], sort=False)[["share", "weight"]].sum()
    ranked = (summed["share"] / summed["weight"]).rename("total").reset_index()
    return ranked.sort_values(["law", "total"], ascending=[True, False], kind="stable", ignore_index=True)
