"""The numbers that a run prints, and how far a transformed scene disagrees about them.

Every number is given back in the units of the scene and compared sample by sample. The disagreement is absolute, in the
unit of the number, or relative to the largest of its kind in the same samples: key characteristics, displacements of
contacts, forces; work to the product of the last two. A number that is small because large ones of its kind cancel,
such as the force of a nearly open pair or the slip of one that sticks, is not known better than these.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd

from mic.results.sample_tables import tables
from mic.results.schema import LIMITS, MEASUREMENTS, PROFILES, RESOLUTIONS, SLIPS

__all__ = ["KEYS", "disagreement", "full_numbers", "numbers"]

KEYS = ["quantity", "stage", "name", "unit"]
MEASURED = ("key characteristic", "deviation at a point")
ZONE = {
    "rms_tangential": ("tangential displacement", "mm"),
    "rms_slip": ("slip", "mm"),
    "slip_length": ("slip path length", "mm"),
    "friction_work": ("friction work", "N mm"),
    "open": ("share open", "1"),
    "stick": ("share sticking", "1"),
    "slip": ("share slipping", "1"),
}
LIMITED = {
    "pushed": ("force of a clamp or gun", "N"),
    "left": ("remaining distance", "mm"),
    "needed": ("force needed", "N"),
}


def numbers(model: Any, evaluation: Any, order: np.ndarray | None = None) -> pd.DataFrame:
    """The numbers of an evaluation, a column per sample.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    evaluation : mic.process.evaluation.Evaluation
    order : (m,) int array, optional
        Order in which the contact pairs are listed.

    Returns
    -------
    DataFrame
        Index :data:`KEYS`; NaN for samples that failed.
    """
    found = tables(model, evaluation)
    rows: dict[tuple[str, str, str, str], np.ndarray] = {}

    def listed(table, columns: Mapping[str, tuple[str, str]], stage: str | None, *names: str) -> None:
        keys = [stage, *names] if stage else list(names)
        for at, group in found[table.name].groupby(keys, observed=True, sort=False):
            where = (at[0] if stage else "", " ".join(str(name) for name in (at[1:] if stage else at)))
            for column, (quantity, unit) in columns.items():
                if not group[column].isna().all():
                    rows[quantity, *where, unit] = group[column].to_numpy(dtype=float)

    listed(MEASUREMENTS, {"value": (MEASURED[0], "mm")}, None, "measurement")
    listed(PROFILES, {"value": (MEASURED[1], "mm")}, None, "measurement", "point")
    listed(SLIPS, ZONE, "stage", "zone")
    listed(LIMITS, LIMITED, "stage", "name")
    listed(RESOLUTIONS, {"unseen": ("penetration between pairs", "mm")}, "stage")
    if len(model.contacts):
        for stage, resolution in evaluation.resolutions.items():
            rows |= _pairs(model, stage, resolution, np.arange(len(model.contacts)) if order is None else order)
    table = pd.DataFrame.from_dict(rows, orient="index", columns=range(len(evaluation.failed)))
    table.index = pd.MultiIndex.from_tuples(rows, names=KEYS)
    return table.mask(np.broadcast_to(evaluation.failed, table.shape))


def full_numbers(model: Any, evaluation: Any) -> pd.DataFrame:
    """Numbers of one sample's full solve: key characteristics, forces and displacements of contacts.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    evaluation : fem_reference.full.model.FullEvaluation
    """
    names = [item.name for item in model.scene.measurements][: len(evaluation.measurements)]
    rows = {(MEASURED[0], "", name, "mm"): value for name, value in zip(names, evaluation.measurements)}
    for stage, resolution in evaluation.resolutions.items():
        one = SimpleNamespace(force=resolution.force[None], displacement=resolution.displacement[None])
        rows |= {key: value[0] for key, value in _pairs(model, stage, one, np.arange(len(model.contacts))).items()}
    index = pd.MultiIndex.from_tuples(rows, names=KEYS)
    return pd.DataFrame({0: list(rows.values())}, index=index, dtype=float)


def _pairs(model, stage, resolution, order) -> dict[tuple[str, str, str, str], np.ndarray]:
    """Sums of the forces of each zone, and forces and displacements of each pair."""
    force, moved, zone = resolution.force[:, order], resolution.displacement[:, order], model.contacts.zone[order]
    pairs = {"normal force": (force[..., 0], "N"), "gap": (moved[..., 0], "mm")}
    if force.shape[-1] == 3:
        pairs["friction force"] = (np.linalg.norm(force[..., 1:], axis=-1), "N")
        pairs["tangential displacement"] = (np.linalg.norm(moved[..., 1:], axis=-1), "mm")
    rows = {}
    for quantity, (each, unit) in pairs.items():
        for z, item in enumerate(model.scene.zones):
            own = np.flatnonzero(zone == z)
            if unit == "N":
                rows[quantity, stage, item.name, unit] = each[:, own].sum(axis=1)
            rows |= {(f"{quantity} of a pair", stage, f"{item.name} {k}", unit): each[:, i] for k, i in enumerate(own)}
    return rows


def disagreement(given: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Differences of other numbers from the given ones, in the same units.

    Returns
    -------
    DataFrame
        Index :data:`KEYS` of both; ``value``, the largest of the given numbers; ``difference``, the largest of any
        sample; ``relative`` to the largest of its kind.
    """
    both = given.index.intersection(other.index, sort=False)
    given, other = given.loc[both], other.loc[both]
    valid = given.notna() & other.notna()
    value = given.abs().where(valid).max(axis=1).fillna(0.0)
    difference = (other - given).abs().max(axis=1).fillna(0.0)
    unit = value.index.get_level_values("unit")
    kind = np.where(np.isin(value.index.get_level_values("quantity"), MEASURED), "measured", unit)
    sizes = value.groupby(kind).max()
    if not sizes.get("measured", 1.0) > 0:  # a released assembly that did not move, up to rounding
        sizes["measured"] = sizes.get("mm", 0.0)
    sizes["N mm"] = sizes.get("N", 0.0) * sizes.get("mm", 0.0)
    largest = pd.Series(sizes.reindex(kind).to_numpy(), value.index)
    relative = (difference / largest.where(largest > 0)).fillna(0.0).where(difference > 0, 0.0)
    relative[(largest == 0) & (difference > 0)] = np.inf
    return pd.DataFrame({"value": value, "difference": difference, "relative": relative})
