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
from mic.results.schema import DENSITY, MESH_CHANGES, ORDERS

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
    table = outcome.measurement_headlines
    rows = table[table["law"] == law].set_index("measurement")
    sources = _sources(outcome, law, rows) if len(rows) else ()
    return sorted(sources, key=lambda source: -np.nan_to_num(max(source.mean, source.six_sigma), nan=-1.0))


def _sources(outcome: Outcome, law: str, rows: pd.DataFrame) -> Iterator[Source]:
    """The sources of error of a law, from its rows of the measurement statistics."""
    half = lambda name: (rows[f"{name}_high"] - rows[f"{name}_low"]) / 2
    count = int(rows["samples"].iloc[0])
    helped = " with surrogates" if rows["alone_six_sigma"].notna().any() else ""
    yield _source("samples", half("mean"), half("six_sigma"), f"half the 95 % interval of {count} samples{helped}")
    if LAWS[law].frictional and outcome.stages:
        how = "change of the first samples on a tighter load path"
        if rows["mean_path"].notna().any():
            yield _source("path", rows["mean_path"], rows["six_sigma_path"], how)
        else:
            yield _unknown("path", "mic report")
    residual = outcome.worst_residual(law)
    largest = residual * rows[["min", "max"]].abs().max(axis=1)
    yield _source("contact residuals", largest, largest, f"largest residual, {residual:.1g}, times the largest value")
    mesh = _rows(outcome.study(MESH_CHANGES), law)
    if mesh is not None:
        changes = mesh.set_index("measurement").reindex(rows.index)
        how = f"expected change on ever finer meshes, from {int(mesh['samples'].iloc[0])} samples on finer ones"
        yield _source("meshes", changes["mean_change"], changes["six_sigma_change"], how)
    else:
        yield _unknown("meshes", "mic run with accuracy = true under [report]")
    if not outcome.stages:
        return
    density = _rows(outcome.study(DENSITY), law)
    if density is not None:
        changes = density.set_index("measurement").reindex(rows.index)
        how = f"change with {int(density['denser'].iloc[0])} pairs instead of {int(density['pairs'].iloc[0])}"
        yield _source("contact pairs", changes["mean_change"], changes["six_sigma_change"], how)
    else:
        yield _unknown("contact pairs", "mic check --converge")
    orders = _rows(outcome.study(ORDERS), law)
    if orders is not None:
        changes = orders.set_index("quantity")[["mean_change", "six_sigma_change"]].abs()
        most = changes.groupby("quantity").max().reindex(rows.index)
        how = "largest change with another order"
        yield _source("order of the process", most["mean_change"], most["six_sigma_change"], how)
    else:
        yield _unknown("order of the process", "mic order")


def _rows(table: pd.DataFrame | None, law: str) -> pd.DataFrame | None:
    """The rows of a law; None if there are none."""
    rows = None if table is None else table[table["law"] == law]
    return rows if rows is not None and len(rows) else None


def _source(name: str, mean: Any, six_sigma: Any, how: str) -> Source:
    """A source with the largest of its errors by key characteristic, mm."""
    mean, six_sigma = mean.abs(), six_sigma.abs()
    where = str(six_sigma.idxmax()) if six_sigma.notna().any() else ""
    return Source(name, float(mean.max()), float(six_sigma.max()), where, how)


def _unknown(name: str, command: str) -> Source:
    """A source that only another command estimates."""
    return Source(name, float("nan"), float("nan"), "", f"not estimated: run {command}")
