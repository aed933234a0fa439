"""Error budget: error of means and 6σ of the key characteristics by source.

Every run estimates the errors of sampling, load path and contact residuals. Separate commands estimate those of
meshes, density of contact pairs and process order; their tables are read from the run folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.results.outcome import Outcome
from mic.results.schema import ACCURACY, DENSITY, ORDERS

__all__ = ["Source", "error_budget"]


@dataclass(frozen=True)
class Source:
    """One source of error.

    Attributes
    ----------
    name : str
    mean, six_sigma : float
        Largest error of a mean and of a 6σ over the key characteristics, mm; NaN if not estimated.
    where : str
        Key characteristic with that error of 6σ; empty if not estimated.
    how : str
        Method of estimation, or the command that estimates it.
    """

    name: str
    mean: float
    six_sigma: float
    where: str
    how: str

    @property
    def measured(self) -> bool:
        """Whether its error is estimated."""
        return bool(np.isfinite(self.mean) or np.isfinite(self.six_sigma))


def error_budget(outcome: Outcome, law: str) -> list[Source]:
    """The sources of error of a law, in descending order, those not estimated last.

    Parameters
    ----------
    outcome : Outcome
    law : str
    """
    table = outcome.measurement_statistics
    own = table[table["law"] == law].set_index("measurement")
    found = list(_sources(outcome, law, own)) if len(own) else []
    return sorted(found, key=lambda source: -np.nan_to_num(max(source.mean, source.six_sigma), nan=-1.0))


def _sources(outcome: Outcome, law: str, own: pd.DataFrame) -> Iterator[Source]:
    half = lambda figure: (own[f"{figure}_high"] - own[f"{figure}_low"]) / 2
    count = int(own["samples"].iloc[0])
    yield _source("samples", half("mean"), half("six_sigma"), f"half the 95 % interval of {count} samples")
    if LAWS[law].frictional and outcome.stages:
        how = "change of the first samples on a tighter load path"
        if own["mean_path"].notna().any():
            yield _source("path", own["mean_path"], own["six_sigma_path"], how)
        else:
            yield _unknown("path", "mic report")
    residual = outcome.worst_residual(law)
    largest = residual * own[["min", "max"]].abs().max(axis=1)
    yield _source("contact residuals", largest, largest, f"largest residual, {residual:.1g}, times the deviation")
    accuracy = outcome.study(ACCURACY)
    mesh = None if accuracy is None else accuracy.groupby("quantity")[["set_down", "located"]].max().max(axis=1)
    if mesh is not None and set(mesh.index) & set(own.index):
        share = mesh.reindex(own.index)
        how = "estimated relative error of each characteristic's influence coefficients"
        yield _source("meshes", share * own["mean"].abs(), share * own["six_sigma"], how)
    else:
        yield _unknown("meshes", "mic run with accuracy = true under [report]")
    if not outcome.stages:
        return
    density = _of(outcome.study(DENSITY), law)
    if density is not None:
        changes = density.set_index("measurement").reindex(own.index)
        how = f"change with {int(density['denser'].iloc[0])} pairs instead of {int(density['pairs'].iloc[0])}"
        yield _source("contact pairs", changes["mean_change"], changes["six_sigma_change"], how)
    else:
        yield _unknown("contact pairs", "mic check --converge")
    orders = _of(outcome.study(ORDERS), law)
    if orders is not None:
        changes = orders.set_index("quantity")[["mean_change", "six_sigma_change"]].abs()
        most = changes.groupby("quantity").max().reindex(own.index)
        how = "largest change with another order, if the fixture is adapted to it"
        yield _source("order of the process", most["mean_change"], most["six_sigma_change"], how)
    else:
        yield _unknown("order of the process", "mic order")


def _of(table: pd.DataFrame | None, law: str) -> pd.DataFrame | None:
    rows = None if table is None else table[table["law"] == law]
    return rows if rows is not None and len(rows) else None


def _source(name: str, mean: Any, six_sigma: Any, how: str) -> Source:
    """The largest of the errors by key characteristic, mm."""
    mean, six_sigma = mean.abs(), six_sigma.abs()
    where = str(six_sigma.idxmax()) if six_sigma.notna().any() else ""
    return Source(name, float(mean.max()), float(six_sigma.max()), where, how)


def _unknown(name: str, command: str) -> Source:
    return Source(name, float("nan"), float("nan"), "", f"not estimated: run {command}")
