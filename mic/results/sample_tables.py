"""An evaluation as tables: the Parquet datasets of the results."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.states import OPEN, SLIP, STATES, STICK
from mic.process.evaluation import Evaluation, Resolution
from mic.results.schema import CONTACTS, DEVIATIONS, LIMITS, MEASUREMENTS, PROFILES, RESOLUTIONS, SAMPLES, SLIPS

__all__ = ["tables", "zone_motion"]

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
    modelled = len(zones) if model.contacts.dimension == 3 else 0
    motions = [
        zone_motion(resolution, model.contacts, model.contacts.zone == z, LAWS[evaluation.law].frictional)
        for resolution in resolutions
        for z in range(modelled)
    ]
    status = np.array([str(getattr(value, "value", value)) for r in resolutions for value in r.status], dtype=object)
    found = {
        SAMPLES: {"sample": number, "failed": evaluation.failed, "built": evaluation.built},
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
            "rescued": _joined([_rescued(model, evaluation.law, r) for r in resolutions], bool),
            "iterations": _joined([r.iterations for r in resolutions], np.int64),
            "converged": _joined([r.converged for r in resolutions], bool),
            "path_error": _joined([r.trace.error for r in resolutions], float),
            "steps": _joined([r.trace.steps for r in resolutions], np.int64),
            "factorisations": _joined([r.trace.factorisations for r in resolutions], np.int64),
            "unseen": _joined([r.unseen for r in resolutions], float),
            "unseen_at": _joined([r.unseen_at for r in resolutions], np.int32),
        },
        SLIPS: {
            "sample": np.tile(number, len(motions)),
            "stage": _named(np.repeat(np.arange(len(stages)), n * modelled), stages),
            "zone": _named(np.tile(np.repeat(np.arange(modelled), n), len(stages)), zones),
        }
        | {name: _joined([motion[name] for motion in motions], float) for name in SLIPS.names[3:]},
        MEASUREMENTS: {
            "sample": np.tile(number, len(measured)),
            "measurement": _named(np.repeat(np.arange(len(measured)), n), measured),
            "value": evaluation.measurements.T.ravel(),
        },
        CONTACTS: _contacts(model.contacts, resolutions, number, stages, zones, LAWS[evaluation.law].frictional),
    }
    found[PROFILES] = _profiles(model, evaluation.readings, number)
    found[LIMITS] = _limits(model, resolutions, number, stages)
    return {table.name: pd.DataFrame(columns) for table, columns in found.items()}


def _profiles(model, readings: np.ndarray, number: np.ndarray):
    """What measurements over many points read at each of them."""
    over = [k for k, item in enumerate(model.scene.measurements) if item.points is not None and readings.size]
    own = [np.arange(*model.characteristics.start[k : k + 2]) for k in over]
    names = [model.scene.measurements[k].name for k in over]
    columns = np.concatenate([np.zeros(0, dtype=int), *own])
    point = np.concatenate([np.zeros(0, dtype=int), *(each - each[0] for each in own)])
    return {
        "sample": np.tile(number, len(columns)),
        "measurement": _named(np.repeat(np.arange(len(over)), [len(each) * len(number) for each in own]), names),
        "point": np.repeat(point, len(number)).astype(np.int32),
        "value": readings[:, columns].T.ravel(),
    }


def _limits(model, resolutions: list[Resolution], number: np.ndarray, stages: list[str]):
    """Clamps and guns of limited force, stage by stage."""
    judged = {plan.name: plan.limit_names(model.scene, model.weld_size) for plan in model.plans}
    names = list(dict.fromkeys(name for stage in stages for name in judged[stage]))
    rows = [(i, names.index(name), j) for i, stage in enumerate(stages) for j, name in enumerate(judged[stage])]
    columns = {
        "sample": np.tile(number, len(rows)),
        "stage": _named(np.repeat([i for i, _, _ in rows], len(number)), stages if rows else []),
        "name": _named(np.repeat([k for _, k, _ in rows], len(number)), names),
    }
    for column, dtype in (("pushed", float), ("left", float), ("reached", bool), ("needed", float)):
        columns[column] = _joined([getattr(resolutions[i], column)[:, j] for i, _, j in rows], dtype)
    return columns


def _rescued(model, law: str, resolution: Resolution) -> np.ndarray:
    """(n,) samples that were to be followed along their path in a stage, were not, and have a solution all the same."""
    followed = {plan.name: plan.path == "followed" for plan in model.plans}
    asked = followed[resolution.stage] and LAWS[law].followed and model.contacts.dimension == 3
    return asked & (resolution.rung != "followed") & resolution.converged


def zone_motion(resolution: Resolution, contacts, own: np.ndarray, frictional: bool) -> dict[str, np.ndarray]:
    """The last columns of :data:`mic.results.schema.SLIPS` for one zone: (n,) each, NaN for what takes friction.

    Pairs that the zone states count alike. Candidates stand nearer to each other along edges, and count by their area;
    what they slip under load by the work that friction did on the way. The finer they are, the less of the area
    touches, down to lines and points: a mean over it has no limit, one over the work has.

    Parameters
    ----------
    resolution : Resolution
    contacts : mic.model.assembly.Contacts
    own : (m,) bool array
        The zone's pairs.
    frictional : bool
    """
    u_t, trace = resolution.displacement[:, own, 1:], resolution.trace
    weight = np.where(contacts.watched, contacts.area, 1.0)[own]
    weight = weight / weight.sum()
    share = weight @ trace.share[:, own]
    work = np.maximum(trace.work[:, own], 0.0)
    total = np.maximum(work.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    bearing = np.where(contacts.watched[own], work / total, weight)
    under_load = {
        "rms_slip": np.sqrt(((trace.slip[:, own] ** 2).sum(axis=2) * bearing).sum(axis=1)),
        "slip_length": np.sqrt((trace.length[:, own] ** 2 * bearing).sum(axis=1)),
        "friction_work": trace.work[:, own].sum(axis=1),
        **{STATES[state]: share[:, state] for state in (OPEN, STICK, SLIP)},
    }
    if not frictional:
        under_load = {name: np.full(len(u_t), np.nan) for name in under_load}
    return {"rms_tangential": np.sqrt((u_t**2).sum(axis=2) @ weight)} | under_load


def _contacts(contacts, resolutions, number, stages, zones, frictional):
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
    if d == 3:
        for name, state in (("path_stick", STICK), ("path_slip", SLIP)):
            share = _joined([r.trace.share[:, :, state].ravel() for r in resolutions], np.float32)
            columns[name] = share if frictional else np.full_like(share, np.nan)
    return columns


def _named(codes, names):
    return pd.Categorical.from_codes(np.asarray(codes, dtype=int), names)


def _joined(pieces, dtype):
    return np.concatenate([np.asarray(piece, dtype=dtype) for piece in pieces]) if pieces else np.zeros(0, dtype=dtype)
