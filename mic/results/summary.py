"""The statistics of an outcome: the tables of zones, contacts and measurements, and ``summary.json``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.states import STATES
from mic.results import capability, statistics
from mic.results.law_comparison import study_friction
from mic.results.schema import CONTACT_STATISTICS, FRICTION, MEASUREMENT_STATISTICS, STATISTICS, ZONE_STATISTICS, Table
from mic.results.statistics import Estimate, Moments
from mic.store import Format, replacing, save_json

if TYPE_CHECKING:
    from mic.results.outcome import Outcome

__all__ = [
    "contact_statistics",
    "measurement_statistics",
    "summary",
    "write_summary",
    "write_tables",
    "zone_statistics",
]

SUMMARY = Format("summary of a run", 1, "call `mic report` on the run folder")
_MEASURED = ("mean", "sigma", "six_sigma", "min", "max", "cp", "cpk", "share_outside")


def zone_statistics(outcome: Outcome) -> pd.DataFrame:
    """RMS slip over each zone, :data:`mic.results.schema.ZONE_STATISTICS`."""
    rows = []
    pairs = np.bincount(outcome.model.contacts.zone, minlength=len(outcome.zones))
    for law in outcome.laws:
        samples = len(outcome.sample_numbers(law))
        unknown = Moments.of(np.full((samples, len(outcome.zones)), np.nan))  # no tangential motion was modelled
        for stage in outcome.stages:
            slips = outcome.digests[law].moments.get(("slips", stage), unknown)
            for z, (zone, count) in enumerate(zip(outcome.model.scene.zones, pairs)):
                slip = slips.at(z)
                rows.append(
                    {
                        "law": law,
                        "stage": stage,
                        "zone": zone.name,
                        "contacts": int(count),
                        "friction": _coefficient(zone, LAWS[law], stage),
                        "samples": samples,
                    }
                    | _spread("mean_rms_slip", statistics.mean(slip))
                    | _spread("six_sigma_rms_slip", statistics.six_sigma(slip))
                )
    return _frame(ZONE_STATISTICS, pd.DataFrame(rows))


def _coefficient(zone, law, stage: str) -> float:
    """μ of a zone under a law in a stage; NaN where it depends on pressure."""
    if not law.frictional:
        return 0.0
    return math.nan if law.varies and zone.pressure_pieces() is not None else zone.coefficient(stage)


def contact_statistics(outcome: Outcome) -> pd.DataFrame:
    """Forces and states of each contact pair, :data:`mic.results.schema.CONTACT_STATISTICS`."""
    frames = []
    m = len(outcome.model.contacts)
    zone = np.array(outcome.zones, dtype=object)[outcome.model.contacts.zone] if m else np.zeros(0, dtype=object)
    for law in outcome.laws:
        digest, samples = outcome.digests[law], len(outcome.sample_numbers(law))
        for stage in outcome.stages:
            f_n, u_n = (digest.moments["contacts", stage, column] for column in ("f_n", "u_n"))
            columns = {"law": law, "stage": stage, "zone": zone, "contact": np.arange(m), "samples": samples}
            columns |= _spread("mean_f_n", statistics.mean(f_n)) | _spread("six_sigma_f_n", statistics.six_sigma(f_n))
            columns["mean_gap"] = statistics.mean(u_n).value
            if outcome.has_slip:
                force, slip = (digest.moments["contacts", stage, column] for column in ("f_t", "u_t"))
                columns |= _spread("mean_slip_force", statistics.mean(force))
                columns |= _spread("six_sigma_slip_force", statistics.six_sigma(force))
                columns |= _spread("mean_slip", statistics.mean(slip))
            for name, count in zip(STATES, digest.counts["states", stage]):
                columns |= _spread(name, statistics.share(count, samples))
            frames.append(pd.DataFrame(columns, index=np.arange(m)))
    return _frame(CONTACT_STATISTICS, pd.concat(frames, ignore_index=True) if frames else pd.DataFrame())


def measurement_statistics(outcome: Outcome) -> pd.DataFrame:
    """Key characteristics against their limits, :data:`mic.results.schema.MEASUREMENT_STATISTICS`."""
    rows = []
    for law in outcome.laws:
        digest = outcome.digests[law]
        for k, item in enumerate(outcome.model.scene.measurements):
            x = digest.moments["measurements",].at(k)
            estimates = (
                statistics.mean(x),
                statistics.sigma(x),
                statistics.six_sigma(x),
                statistics.minimum(x),
                statistics.maximum(x),
                capability.capability(x, item.lower, item.upper),
                capability.centred_capability(x, item.lower, item.upper),
                statistics.share(digest.counts["outside",][k], x.n),
            )
            row = {
                "law": law,
                "measurement": item.name,
                "lower": item.lower,
                "upper": item.upper,
                "samples": estimates[0].used,
            }
            for name, estimate in zip(_MEASURED, estimates):
                row |= _spread(name, estimate)
            rows.append(row)
    return _frame(MEASUREMENT_STATISTICS, pd.DataFrame(rows))


def summary(outcome: Outcome) -> dict[str, Any]:
    """The outcome in one JSON-ready dict (``summary.json``).

    The zone figures of each law are those of the first stage that resolves contact, clamping in the default process;
    every stage stands under ``"stages"``. Intervals ``…_ci`` are at 95 %. What does not exist is None.
    """
    laws = {}
    for law in outcome.laws:
        zones: dict[str, Any] = {}
        for row in _rows(outcome.zone_statistics, law):
            entry = _with_intervals(row, ("mean_rms_slip", "six_sigma_rms_slip"))
            zone = zones.setdefault(
                row["zone"], {"contacts": row["contacts"], "friction": row["friction"], **entry, "stages": {}}
            )
            zone["stages"][row["stage"]] = entry
        laws[law] = {
            "samples": len(outcome.sample_numbers(law)),
            "worst_residual": outcome.worst_residual(law),
            "failed": len(outcome.failed[law]),
            "zones": zones,
            "measurements": {
                row["measurement"]: {"lower": row["lower"], "upper": row["upper"]} | _with_intervals(row, _MEASURED)
                for row in _rows(outcome.measurement_statistics, law)
            },
        }
    return _json_ready(
        {
            "scene": outcome.model.scene.name,
            "description": outcome.model.scene.description,
            "samples": outcome.record["samples"],
            "seed": outcome.record["seed"],
            "failed_samples": outcome.failed,
            "missing_samples": outcome.missing,
            "confidence_level": statistics.LEVEL,
            "laws": laws,
            "versions": outcome.record["versions"],
            "wall_time": outcome.record.get("wall_time", {}),
        }
    )


def write_tables(outcome: Outcome) -> None:
    """Write ``tables/*.csv`` into the run folder, the study of friction among them, which is solved here.

    A table that has no rows now goes, should the folder hold it from an earlier run.
    """
    found = {
        ZONE_STATISTICS: outcome.zone_statistics,
        CONTACT_STATISTICS: outcome.contact_statistics,
        MEASUREMENT_STATISTICS: outcome.measurement_statistics,
        FRICTION: study_friction(outcome),
    }
    for table in STATISTICS:
        path, frame = outcome.folder / table.place, found[table]
        if frame is None or not len(frame):
            path.unlink(missing_ok=True)
            continue
        table.check(frame, path, "this is a fault of the program")
        with replacing(path) as temporary:
            # The study is read again, for pictures: every digit.
            frame.to_csv(temporary, index=False, float_format=None if table is FRICTION else "%.9g")


def write_summary(outcome: Outcome) -> Path:
    """Write ``summary.json`` into the run folder; returns its path."""
    path = outcome.folder / "summary.json"
    save_json(path, SUMMARY, summary(outcome))
    return path


def _frame(table: Table, frame: pd.DataFrame) -> pd.DataFrame:
    return frame if len(frame) else table.empty()


def _rows(table: pd.DataFrame, law: str) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in table[table["law"] == law].to_dict("records")]


def _spread(name: str, estimate: Estimate) -> dict[str, Any]:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def _with_intervals(row, names) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    for name in names:
        entry |= {name: row[name], f"{name}_ci": [row[f"{name}_low"], row[f"{name}_high"]]}
    return entry


def _json_ready(value):
    """Plain Python values; numbers that JSON does not know become None."""
    if isinstance(value, dict):
        return {str(key): _json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_ready(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
