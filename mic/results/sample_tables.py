"""An evaluation as tables: the Parquet datasets of the results."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.states import OPEN, SLIP, STATES, STICK
from mic.process.evaluation import Evaluation, Resolution
from mic.process.frames import contact_columns
from mic.results.schema import CONTACTS, DEVIATIONS, LIMITS, MEASUREMENTS, PROFILES, RESOLUTIONS, SAMPLES, SLIPS

__all__ = ["tables", "zone_motion"]


def tables(model, evaluation: Evaluation, first: int = 0) -> dict[str, pd.DataFrame]:
    """The tables of an evaluation, by name, as :data:`mic.results.schema.DATASETS` declares them.

    Rows are ordered by stage, zone, deviation or measurement, then by sample; contacts by stage, sample and pair.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    evaluation : Evaluation
    first : int
        Number of the first sample.
    """
    number = first + np.arange(len(evaluation.deviations), dtype=np.int32)
    zones = [zone.name for zone in model.scene.zones]
    stages = list(evaluation.resolutions)
    resolutions = list(evaluation.resolutions.values())
    measured = [item.name for item in model.scene.measurements][: evaluation.measurements.shape[1]]
    moving = len(zones) if model.contacts.dimension == 3 else 0  # zones whose tangential motion is modelled
    motions = [
        zone_motion(resolution, model.contacts, model.contacts.zone == z, LAWS[evaluation.law].frictional)
        for resolution in resolutions
        for z in range(moving)
    ]
    status = np.array([str(getattr(value, "value", value)) for r in resolutions for value in r.status], dtype=object)
    columns = {
        SAMPLES: {"sample": number, "failed": evaluation.failed, "built": evaluation.built},
        DEVIATIONS: _keys(number, deviation=(range(len(model.parameters)), model.parameters))
        | {"value": evaluation.deviations.T.ravel()},
        RESOLUTIONS: _keys(number, stage=(range(len(stages)), stages))
        | {
            "residual": _joined([r.residual for r in resolutions], float),
            "status": pd.Categorical(status),
            "rung": pd.Categorical(np.array([name for r in resolutions for name in r.rung], dtype=object)),
            "rescued": _joined([_rescued(model, evaluation.law, r) for r in resolutions], bool),
            "iterations": _joined([r.iterations for r in resolutions], np.int64),
            "converged": _joined([r.converged for r in resolutions], bool),
            "path_error": _joined([r.trace.error for r in resolutions], float),
            "path_force_error": _joined([r.trace.force_error for r in resolutions], float),
            "steps": _joined([r.trace.steps for r in resolutions], np.int64),
            "factorisations": _joined([r.trace.factorisations for r in resolutions], np.int64),
            "unseen": _joined([r.unseen for r in resolutions], float),
            "unseen_at": _joined([r.unseen_at for r in resolutions], np.int32),
        },
        SLIPS: _keys(
            number,
            stage=(np.repeat(range(len(stages)), moving), stages),
            zone=(np.tile(range(moving), len(stages)), zones),
        )
        | {name: _joined([motion[name] for motion in motions], float) for name in SLIPS.names[3:]},
        MEASUREMENTS: _keys(number, measurement=(range(len(measured)), measured))
        | {"value": evaluation.measurements.T.ravel()},
        CONTACTS: contact_columns(evaluation.names, resolutions, number, stages),
        PROFILES: _profiles(model, evaluation.readings, number),
        LIMITS: _limits(model, resolutions, number, stages),
    }
    return {table.name: pd.DataFrame(values) for table, values in columns.items()}


def _profiles(model, readings: np.ndarray, number: np.ndarray):
    """Columns of the dataset `profiles`."""
    profiles = [k for k, item in enumerate(model.scene.measurements) if item.points is not None and readings.size]
    indices = [np.arange(*model.characteristics.start[k : k + 2]) for k in profiles]  # of the points' readings
    names = [model.scene.measurements[k].name for k in profiles]
    columns = np.concatenate([np.zeros(0, dtype=int), *indices])
    point = np.concatenate([np.zeros(0, dtype=int), *(index - index[0] for index in indices)])
    measurement = np.repeat(range(len(profiles)), [len(index) for index in indices])
    return _keys(number, measurement=(measurement, names)) | {
        "point": np.repeat(point, len(number)).astype(np.int32),
        "value": readings[:, columns].T.ravel(),
    }


def _limits(model, resolutions: list[Resolution], number: np.ndarray, stages: list[str]):
    """Columns of the dataset `limits`."""
    limited = {plan.name: plan.limit_names(model.scene, model.weld_size) for plan in model.plans}
    names = list(dict.fromkeys(name for stage in stages for name in limited[stage]))
    rows = [(i, j, names.index(name)) for i, stage in enumerate(stages) for j, name in enumerate(limited[stage])]
    stage_of, _, name_of = zip(*rows) if rows else ((), (), ())
    columns = _keys(number, stage=(stage_of, stages if rows else []), name=(name_of, names))
    for column, dtype in (("pushed", float), ("left", float), ("reached", bool), ("needed", float)):
        columns[column] = _joined([getattr(resolutions[i], column)[:, j] for i, j, _ in rows], dtype)
    return columns


def _rescued(model, law: str, resolution: Resolution) -> np.ndarray:
    """(n,) whether path following failed in a stage and increments found the solution."""
    followed = {plan.name: plan.path == "followed" for plan in model.plans}
    requested = followed[resolution.stage] and LAWS[law].followed and model.contacts.dimension == 3
    return requested & (resolution.rung != "followed") & resolution.converged


def zone_motion(resolution: Resolution, contacts, pairs: np.ndarray, frictional: bool) -> dict[str, np.ndarray]:
    """Motion of one zone: the last columns of :data:`mic.results.schema.SLIPS`, (n,) each.

    Stated pairs have equal weights. Candidates, which are denser along edges, are weighted by area, and their slip
    under load by friction work: a finer mesh of candidates touches on a smaller area, down to lines and points, so that
    a mean over the area does not converge, while one over the work does. Columns that need friction are NaN without it.

    Parameters
    ----------
    resolution : Resolution
    contacts : mic.model.assembly.Contacts
    pairs : (m,) bool array
        Pairs of the zone.
    frictional : bool
    """
    u_t, trace = resolution.displacement[:, pairs, 1:], resolution.trace
    weight = np.where(contacts.watched, contacts.area, 1.0)[pairs]
    weight = weight / weight.sum()
    share = weight @ trace.share[:, pairs]
    work = np.maximum(trace.work[:, pairs], 0.0)
    total = work.sum(axis=1, keepdims=True)
    by_work = contacts.watched[pairs] & (total > 0)  # without friction by area
    slip_weight = np.where(by_work, work / np.where(total > 0, total, 1.0), weight)
    under_load = {
        "rms_slip": np.sqrt(((trace.slip[:, pairs] ** 2).sum(axis=2) * slip_weight).sum(axis=1)),
        "slip_length": np.sqrt((trace.length[:, pairs] ** 2 * slip_weight).sum(axis=1)),
        "friction_work": trace.work[:, pairs].sum(axis=1),
        **{STATES[state]: share[:, state] for state in (OPEN, STICK, SLIP)},
    }
    if not frictional:
        under_load = {name: np.full(len(u_t), np.nan) for name in under_load}
    return {"rms_tangential": np.sqrt((u_t**2).sum(axis=2) @ weight)} | under_load


def _keys(number, **keys) -> dict[str, Any]:
    """Columns `sample` and the given ones, each as codes and their names; all samples have every code."""
    columns = {key: _named(np.repeat(codes, len(number)), names) for key, (codes, names) in keys.items()}
    return {"sample": np.tile(number, len(next(iter(keys.values()))[0]))} | columns


def _named(codes, names):
    return pd.Categorical.from_codes(np.asarray(codes, dtype=int), names)


def _joined(pieces, dtype):
    return np.concatenate([np.asarray(piece, dtype=dtype) for piece in pieces]) if pieces else np.zeros(0, dtype=dtype)
