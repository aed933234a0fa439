"""An evaluation as tables: the Parquet datasets of the results."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic.contact.states import STATES
from mic.process.evaluation import Evaluation
from mic.results.schema import CONTACTS, DEVIATIONS, MEASUREMENTS, RESOLUTIONS, SAMPLES, SLIPS

__all__ = ["tables"]

AXES = ("n", "t1", "t2")


def tables(model, evaluation: Evaluation, first: int = 0) -> dict[str, pd.DataFrame]:
    """The tables of an evaluation, by name, as :data:`mic.results.schema.DATASETS` declares them.

    Rows are ordered by stage, zone, deviation or measurement, and within it by sample; those of the contacts by stage,
    sample and pair.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    evaluation : Evaluation
    first : int
        Number of the first sample.
    """
    n = len(evaluation.deviations)
    number = first + np.arange(n, dtype=np.int32)
    zones = [zone.name for zone in model.scene.zones]
    stages = list(evaluation.resolutions)
    resolutions = list(evaluation.resolutions.values())
    measured = [item.name for item in model.scene.measurements][: evaluation.measurements.shape[1]]
    slip = {
        (s, z): values
        for s, resolution in enumerate(resolutions)
        for z, values in enumerate(_zone_slip(resolution.displacement, model.contacts, len(zones)))
    }
    status = np.array([str(getattr(value, "value", value)) for r in resolutions for value in r.status], dtype=object)
    found = {
        SAMPLES: {"sample": number, "failed": evaluation.failed},
        DEVIATIONS: {
            "sample": np.tile(number, len(model.parameters)),
            "deviation": _named(np.repeat(np.arange(len(model.parameters)), n), model.parameters),
            "value": evaluation.deviations.T.ravel(),
        },
        RESOLUTIONS: {
            "sample": np.tile(number, len(stages)),
            "stage": _named(np.repeat(np.arange(len(stages)), n), stages),
            "residual": _joined([r.residual for r in resolutions], float),
            "status": pd.Categorical(status),
            "rung": pd.Categorical(np.array([name for r in resolutions for name in r.rung], dtype=object)),
            "iterations": _joined([r.iterations for r in resolutions], np.int64),
            "converged": _joined([r.converged for r in resolutions], bool),
        },
        SLIPS: {
            "sample": np.tile(number, len(slip)),
            "stage": _named(np.repeat([s for s, _ in slip], n), stages),
            "zone": _named(np.repeat([z for _, z in slip], n), zones),
            "rms_slip": _joined(list(slip.values()), float),
        },
        MEASUREMENTS: {
            "sample": np.tile(number, len(measured)),
            "measurement": _named(np.repeat(np.arange(len(measured)), n), measured),
            "value": evaluation.measurements.T.ravel(),
        },
        CONTACTS: _contacts(model.contacts, resolutions, number, stages, zones),
    }
    return {table.name: pd.DataFrame(columns) for table, columns in found.items()}


def _zone_slip(displacement: np.ndarray, contacts, zones: int) -> list[np.ndarray]:
    """Root mean square of ``‖u_t‖`` over the pairs of each zone.

    Parameters
    ----------
    displacement : (n, m, d) array
        mm.
    contacts : mic.model.assembly.Contacts
    zones : int
        Number of zones.

    Returns
    -------
    list of (n,) array
        One per zone, mm; empty where only normals are modelled.
    """
    if contacts.dimension != 3:
        return []
    square = (displacement[:, :, 1:] ** 2).sum(axis=2)
    return [np.sqrt(square[:, contacts.zone == z].mean(axis=1)) for z in range(zones)]


def _contacts(contacts, resolutions, number, stages, zones):
    n, m, d = len(number), len(contacts), contacts.dimension
    count = len(stages)
    columns = {
        "sample": np.tile(np.repeat(number, m), count),
        "stage": _named(np.repeat(np.arange(count), n * m), stages),
        "zone": _named(np.tile(contacts.zone, n * count), zones),
        "contact": np.tile(np.arange(m, dtype=np.int32), n * count),
    }
    for symbol, quantity in (("f", "force"), ("u", "displacement")):
        for j, axis in enumerate(AXES[:d]):
            columns[f"{symbol}_{axis}"] = _joined([getattr(r, quantity)[:, :, j].ravel() for r in resolutions], float)
    columns["state"] = _named(_joined([r.state.ravel() for r in resolutions], np.int8), list(STATES))
    return columns


def _named(codes, names):
    return pd.Categorical.from_codes(np.asarray(codes, dtype=int), names)


def _joined(pieces, dtype):
    return np.concatenate([np.asarray(piece, dtype=dtype) for piece in pieces]) if pieces else np.zeros(0, dtype=dtype)
