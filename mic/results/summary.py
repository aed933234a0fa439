"""``summary.json``: statistics of a run by law, zone and key characteristic."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.states import STATES
from mic.results.capability_verdict import capability_verdict
from mic.results.headline import headline
from mic.results.output_samples import MOTIONS
from mic.results.run_samples import RunSamples
from mic.results.statistic_tables import whole_yield
from mic.statistics import estimates

__all__ = ["json_ready", "summary"]

_ZONE_KEYS = ("law", "stage", "zone", "contacts", "friction", "samples")
_BEST = ("mean", "sigma", "six_sigma", "cp", "cpk", "share_outside")
_BEST_OF_ZONE = tuple(f"{name}_{motion}" for motion in MOTIONS for name in ("mean", "six_sigma"))


def summary(
    outcome: RunSamples, zone_table: pd.DataFrame, measurement_table: pd.DataFrame, limit_table: pd.DataFrame
) -> dict[str, Any]:
    """The outcome in one JSON-ready dict (``summary.json``).

    The zone values of each law are those of the first stage that resolves contact, clamping in the default process;
    ``"stages"`` holds every stage. ``"headline"`` holds the best estimates, with surrogates or of the samples alone.
    Intervals ``…_ci`` are at 95 %; ``"confidence_level"`` is the share that holds, at least, which is less for fewer
    than 50 samples (:func:`mic.statistics.estimates.confidence`), for what ``"rarest_event"`` of the assemblies do. The
    effect of a tighter load path is ``…_path`` in mm and ``…_path_share`` (:data:`mic.results.schema.PATH`). With a
    design that makes samples in groups, only key characteristics have intervals
    (:func:`mic.statistics.estimates.grouped_jackknife`). Undefined values, such as slip under load without friction,
    are None.
    """
    study = outcome.path_study
    best_measurements, best_zones = headline(measurement_table), headline(zone_table)
    laws, fewest = {}, min((len(outcome.sample_numbers(law)) for law in outcome.laws), default=0)
    for law in outcome.laws:
        zones: dict[str, Any] = {}
        for row, best in zip(_rows(zone_table, law), _rows(best_zones, law)):
            entry = _entry(row, *_ZONE_KEYS, *STATES) | {"path": {state: row[state] for state in STATES}}
            entry["headline"] = _entry(best, *(best.keys() - set(_BEST_OF_ZONE)))
            zone = {"contacts": row["contacts"], "friction": row["friction"], **entry, "stages": {}}
            zones.setdefault(row["zone"], zone)["stages"][row["stage"]] = entry
        judged = capability_verdict(outcome, law, best_measurements)
        verdicts = judged.decision.each if judged and judged.target_cpk is not None else ()
        each = dict(zip((item.name for item in outcome.model.scene.measurements), verdicts))
        laws[law] = {
            "samples": len(outcome.sample_numbers(law)),
            "worst_residual": outcome.worst_residual(law),
            "failed": len(outcome.failed[law]),
            "not_built": len(outcome.unbuilt[law]),
            "rescued": len(outcome.rescued[law]),
            "unseen_penetration": _unseen(outcome, law),
            "path": _path(outcome, law)
            | {
                "repeated": study.repeated(law) if study else 0,
                "several_solutions": study.several(law) if study else 0,
            },
            "zones": zones,
            "verdict": judged.as_dict() if judged else None,
            "all_within": _all_within(outcome, law),
            "measurements": {
                row["measurement"]: _entry(row, "law", "measurement", "samples")
                | {"headline": _entry(best, *(best.keys() - set(_BEST)))}
                | ({"verdict": each[row["measurement"]]} if each else {})
                for row, best in zip(_rows(measurement_table, law), _rows(best_measurements, law))
            },
            "limits": [{name: row[name] for name in row if name != "law"} for row in _rows(limit_table, law)],
        }
    return json_ready(
        {
            "scene": outcome.model.scene.name,
            "description": outcome.model.scene.description,
            "samples": outcome.record["samples"],
            "seed": outcome.record["seed"],
            "design": outcome.model.scene.monte_carlo.design,
            "failed_samples": outcome.failed,
            "not_built_samples": outcome.unbuilt,
            "rescued_samples": outcome.rescued,
            "missing_samples": outcome.missing,
            "confidence_level": float(estimates.confidence(fewest)),
            "laws": laws,
            "versions": outcome.record["versions"],
            "wall_time": outcome.record.get("wall_time", {}),
        }
    )


def _all_within(outcome: RunSamples, law: str) -> dict[str, Any] | None:
    """Share of the assemblies with all key characteristics within their limits; None without key characteristics."""
    if not outcome.model.scene.measurements:
        return None
    share = whole_yield(outcome, law)
    return {"share": share.value, "share_ci": [share.low, share.high], "outside_ppm": 1e6 * (1 - share.value)}


def _unseen(outcome: RunSamples, law: str) -> dict[str, Any] | None:
    """The deepest penetration between the contact pairs, mm, and its location; None if there is none."""
    depth, stage, sample, index = outcome.accumulators[law].unseen
    if index < 0:
        return None
    between, zones = outcome.model.between, outcome.model.scene.zones
    return {
        "depth": depth,
        "stage": stage,
        "sample": sample,
        "zone": zones[between.zone[index]].name,
        "point": between.point[index].tolist(),
    }


def _path(outcome: RunSamples, law: str) -> dict[str, Any]:
    """Effort of path following per sample, and estimated path errors by stage, mm and N: mean and largest."""
    moments = outcome.accumulators[law].moments
    stages = outcome.accumulators[law].stages
    errors = {
        name: {stage: moments["resolutions", stage, f"path_{name}"] for stage in outcome.stages if stage in stages}
        for name in ("error", "force_error")
    }
    return {
        name: sum(float(moments["resolutions", stage, name].mean) for stage in stages)
        for name in ("steps", "factorisations")
    } | {
        name: {stage: {"mean": float(error.mean), "max": float(error.high)} for stage, error in by_stage.items()}
        for name, by_stage in errors.items()
    }


def _rows(table: pd.DataFrame, law: str) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in table[table["law"] == law].to_dict("records")]


def _entry(row: dict[str, Any], *without: str) -> dict[str, Any]:
    """Values of a table row, with intervals as pairs, except for some columns."""
    entry = {}
    for name, value in row.items():
        if name not in without and not name.endswith(("_low", "_high")):
            entry[name] = value
            if f"{name}_low" in row:
                entry[f"{name}_ci"] = [row[f"{name}_low"], row[f"{name}_high"]]
    return entry


def json_ready(value):
    """Plain Python values; NaN and infinity become None."""
    if isinstance(value, dict):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_ready(item) for item in value]
    if isinstance(value, (np.generic, np.ndarray)):
        return json_ready(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
