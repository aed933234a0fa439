"""Whether the figures can be trusted: what each source of error leaves in means and 6σ of the key characteristics.

Some sources are measured by every run: how few samples there are, the path, the solver's residuals. Others take a
command of their own, whose table is looked for in the run's folder: the meshes, the density of the pairs, the order of
the process.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.results.schema import ACCURACY, DENSITY, ORDERS
from mic.statistics import estimates
from mic.statistics.estimates import Estimate

if TYPE_CHECKING:
    from mic.results.outcome import Outcome

__all__ = ["Source", "error_budget", "whole_yield"]


@dataclass(frozen=True)
class Source:
    """One source of error.

    Attributes
    ----------
    name : str
    mean, six_sigma : float
        What it leaves in a mean and in a 6σ, mm: of the key characteristic in which it leaves most; NaN where it is not
        measured.
    where : str
        The characteristic of that 6σ; empty where it is not measured.
    how : str
        What was measured, or which command does it.
    """

    name: str
    mean: float
    six_sigma: float
    where: str
    how: str

    @property
    def measured(self) -> bool:
        """Whether anything is known of it."""
        return bool(np.isfinite(self.mean) or np.isfinite(self.six_sigma))


def whole_yield(outcome: Outcome, law: str) -> Estimate:
    """Share of the assemblies whose key characteristics are all within their limits.

    Its interval is that of independent samples; of a design that makes several together none is told.
    """
    digest, samples = outcome.digests[law], len(outcome.sample_numbers(law))
    beyond = int(digest.counts["any outside",]) if samples else 0
    found = estimates.share(samples - beyond, samples)
    return found if outcome.together == 1 else replace(found, low=np.nan * found.value, high=np.nan * found.value)


def error_budget(outcome: Outcome, law: str) -> list[Source]:
    """The sources of error of a law's key characteristics, the measured ones first, the largest of them first.

    Parameters
    ----------
    outcome : Outcome
    law : str
    """
    table = outcome.measurement_statistics
    own = table[table["law"] == law].set_index("measurement")
    found = list(_sources(outcome, law, own)) if len(own) else []
    return sorted(found, key=lambda one: -np.nan_to_num(max(one.mean, one.six_sigma), nan=-1.0))


def _sources(outcome: Outcome, law: str, own: pd.DataFrame) -> Iterator[Source]:
    half = lambda figure: (own[f"{figure}_high"] - own[f"{figure}_low"]) / 2
    count = int(own["samples"].iloc[0])
    yield _source("samples", half("mean"), half("six_sigma"), f"half the 95 % interval of {count} samples")
    if LAWS[law].frictional and outcome.stages:
        how = "what a tighter path changes of the first samples"
        if own["mean_path"].notna().any():
            yield _source("path", own["mean_path"], own["six_sigma_path"], how)
        else:
            yield _unknown("path", "mic report")
    residual = outcome.worst_residual(law)
    largest = residual * own[["min", "max"]].abs().max(axis=1)
    yield _source("contact residuals", largest, largest, f"the largest residual, {residual:.1g}, times the deviation")
    accuracy = outcome.study(ACCURACY)
    mesh = None if accuracy is None else accuracy.groupby("quantity")[["set_down", "located"]].max().max(axis=1)
    if mesh is not None and set(mesh.index) & set(own.index):
        share = mesh.reindex(own.index)
        how = "the estimated share of each characteristic's influence"
        yield _source("meshes", share * own["mean"].abs(), share * own["six_sigma"], how)
    else:
        yield _unknown("meshes", "mic run with accuracy = true under [report]")
    if not outcome.stages:
        return
    density = _of(outcome.study(DENSITY), law)
    if density is not None:
        changes = density.set_index("measurement").reindex(own.index)
        how = f"what {int(density['denser'].iloc[0])} pairs in place of {int(density['pairs'].iloc[0])} change"
        yield _source("contact pairs", changes["mean_change"], changes["six_sigma_change"], how)
    else:
        yield _unknown("contact pairs", "mic check --converge")
    orders = _of(outcome.study(ORDERS), law)
    if orders is not None:
        changes = orders.set_index("quantity")[["mean_change", "six_sigma_change"]].abs()
        most = changes.groupby("quantity").max().reindex(own.index)
        how = "the most that another order would change, if the fixture followed it"
        yield _source("order of the process", most["mean_change"], most["six_sigma_change"], how)
    else:
        yield _unknown("order of the process", "mic order")


def _of(table: pd.DataFrame | None, law: str) -> pd.DataFrame | None:
    rows = None if table is None else table[table["law"] == law]
    return rows if rows is not None and len(rows) else None


def _source(name: str, mean: Any, six_sigma: Any, how: str) -> Source:
    """Of errors by key characteristic, mm."""
    mean, six_sigma = mean.abs(), six_sigma.abs()
    where = str(six_sigma.idxmax()) if six_sigma.notna().any() else ""
    return Source(name, float(mean.max()), float(six_sigma.max()), where, how)


def _unknown(name: str, command: str) -> Source:
    return Source(name, float("nan"), float("nan"), "", f"not measured: {command} does")
