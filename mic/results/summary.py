"""The statistics of an outcome: the tables of zones, contacts and measurements, and ``summary.json``."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.states import STATES
from mic.results.error_sources import whole_yield
from mic.results.friction_sweep import study_friction
from mic.results.path_error import Effect, study_path
from mic.results.schema import (
    CONTACT_STATISTICS,
    FRICTION,
    LIMIT_STATISTICS,
    MEASUREMENT_STATISTICS,
    PATH,
    PATH_ERRORS,
    PROFILE_STATISTICS,
    SLIPS,
    ZONE_STATISTICS,
    Table,
)
from mic.statistics import capability, estimates
from mic.statistics.estimates import Estimate, Moments
from mic.statistics.regression import Improved
from mic.system.files import Format, Group, replacing, save_json, together

if TYPE_CHECKING:
    from mic.results.outcome import Outcome

__all__ = [
    "contact_statistics",
    "limit_statistics",
    "measurement_statistics",
    "profile_statistics",
    "summary",
    "write_path_study",
    "write_summary",
    "write_tables",
    "zone_statistics",
]

SUMMARY = Format("summary of a run", 2, "call `mic report` on the run folder")
GROUPS = 100  # of samples that are left out in turn: more tell the spread no better
_MEASURED = ("mean", "sigma", "six_sigma", "min", "max", "cp", "cpk", "share_outside")
_IMPROVED = ("improved_mean", "improved_six_sigma")
_HANGING = ("mean", "six_sigma")  # what a path study is asked for
_MOTIONS = ("rms_tangential", "rms_slip")
_PRESSED = {"normal_force": "all", "normal_force_clear": "clear"}  # of which pairs the forces are summed


def zone_statistics(outcome: Outcome) -> pd.DataFrame:
    """Motion of each zone, and what presses it together, :data:`mic.results.schema.ZONE_STATISTICS`."""
    rows = []
    pairs = np.bincount(outcome.model.contacts.zone, minlength=len(outcome.zones))
    for law in outcome.laws:
        samples = len(outcome.sample_numbers(law))
        unknown = Moments.of(np.full((samples, len(outcome.zones)), np.nan))  # no tangential motion was modelled
        for stage in outcome.stages:
            moments = {
                column: outcome.digests[law].moments.get(("slips", stage, column), unknown)
                for column in SLIPS.names[3:]
            }
            for z, (zone, count) in enumerate(zip(outcome.model.scene.zones, pairs)):
                own = {column: found.at(z) for column, found in moments.items()}
                row = {
                    "law": law,
                    "stage": stage,
                    "zone": zone.name,
                    "contacts": int(count),
                    "friction": _coefficient(zone, LAWS[law], stage),
                    "samples": samples,
                }
                for motion in _MOTIONS:
                    row |= _hanging(
                        f"_{motion}",
                        (estimates.mean(own[motion]), estimates.six_sigma(own[motion])),
                        _effects(outcome, law, motion, zone.name, stage),
                    )
                for column in ("slip_length", "friction_work"):
                    row |= _spread(f"mean_{column}", estimates.mean(own[column]))
                for name, which in _PRESSED.items():
                    force = outcome.digests[law].moments["pressed", stage, which].at(z)
                    row |= _spread(f"mean_{name}", estimates.mean(force))
                    row |= _spread(f"six_sigma_{name}", estimates.six_sigma(force))
                rows.append(row | {state: estimates.mean(own[state]).value for state in STATES})
    return _frame(ZONE_STATISTICS, pd.DataFrame(rows), outcome.together == 1)


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
            columns |= _spread("mean_f_n", estimates.mean(f_n)) | _spread("six_sigma_f_n", estimates.six_sigma(f_n))
            columns["mean_gap"] = estimates.mean(u_n).value
            if outcome.has_slip:
                force, motion = (digest.moments["contacts", stage, column] for column in ("f_t", "u_t"))
                columns |= _spread("mean_slip_force", estimates.mean(force))
                columns |= _spread("six_sigma_slip_force", estimates.six_sigma(force))
                columns |= _spread("mean_tangential", estimates.mean(motion))
            for name, count in zip(STATES, digest.counts["states", stage]):
                columns |= _spread(name, estimates.share(count, samples))
            if outcome.has_slip:
                stick, slip = (
                    estimates.mean(digest.moments["contacts", stage, column]).value
                    for column in ("path_stick", "path_slip")
                )
                columns |= {"path_open": 1.0 - stick - slip, "path_stick": stick, "path_slip": slip}
            frames.append(pd.DataFrame(columns, index=np.arange(m)))
    return _frame(
        CONTACT_STATISTICS, pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(), outcome.together == 1
    )


def measurement_statistics(outcome: Outcome) -> pd.DataFrame:
    """Key characteristics against their limits, :data:`mic.results.schema.MEASUREMENT_STATISTICS`."""
    rows = []
    for law in outcome.laws:
        digest = outcome.digests[law]
        regression = digest.regression.improved() if digest.regression else None
        for k, item in enumerate(outcome.model.scene.measurements):
            x = digest.moments["measurements",].at(k)
            moments: tuple[Estimate, ...] = (
                estimates.mean(x),
                estimates.sigma(x),
                estimates.six_sigma(x),
                estimates.minimum(x),
                estimates.maximum(x),
                capability.capability(x, math.nan if item.one_sided else item.lower, item.upper),
                capability.centred_capability(x, *item.bounds),
                estimates.share(digest.counts["outside",][k], x.n),
            )
            if outcome.together > 1:
                moments = _by_groups(outcome, law, item, moments)
            row = {
                "law": law,
                "measurement": item.name,
                "lower": item.lower,
                "upper": item.upper,
                "samples": moments[0].used,
            }
            found = dict(zip(_MEASURED, moments))
            effects = dict(zip(_HANGING, _effects(outcome, law, "measurement", item.name)))
            for name, estimate in found.items():
                row |= _spread(name, estimate) | (_change(name, effects[name]) if name in effects else {})
            rows.append(row | _improved(regression, k))
    return _frame(MEASUREMENT_STATISTICS, pd.DataFrame(rows))


def _improved(regression: Improved | None, k: int) -> dict[str, Any]:
    """What a regression on the deviations makes of a key characteristic; empty without one."""
    if regression is None:
        regression = Improved.none(k + 1)
    found = {"improved": str(regression.kind[k]), "explained": float(regression.explained[k])}
    for name, values in (("mean", regression.mean), ("six_sigma", 6 * regression.sigma)):
        found |= dict(zip((f"improved_{name}{end}" for end in ("", "_low", "_high")), values[:, k].tolist()))
    return found


def profile_statistics(outcome: Outcome) -> pd.DataFrame:
    """Maps of deviation, :data:`mic.results.schema.PROFILE_STATISTICS`."""
    frames = []
    for law in outcome.laws:
        for item in outcome.model.scene.measurements:
            if item.points is None:
                continue
            x = outcome.digests[law].moments["profiles", item.name]
            columns = {"law": law, "measurement": item.name, "point": np.arange(len(item.points))}
            columns |= dict(zip("xyz", np.array(item.points).T))
            mean, six_sigma = estimates.mean(x), estimates.six_sigma(x)
            if outcome.together > 1:  # samples that belong together tell no interval from moments
                none = np.full(len(item.points), np.nan)
                mean, six_sigma = (replace(each, low=none, high=none) for each in (mean, six_sigma))
            columns |= {"samples": mean.used} | _spread("mean", mean) | _spread("six_sigma", six_sigma)
            frames.append(pd.DataFrame(columns))
    return _frame(PROFILE_STATISTICS, pd.concat(frames, ignore_index=True) if frames else pd.DataFrame())


def _by_groups(outcome: Outcome, law: str, item, moments: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
    """The estimates with the intervals of samples that a design makes in groups; in :data:`_MEASURED`'s order."""
    x, group = outcome.measured(law, item.name), outcome.sample_numbers(law) // outcome.together % GROUPS
    mean, sigma, six_sigma, least, most = moments[:5]

    def cpk(values):
        return capability.centred_capability(values, *item.bounds).value

    def share(values):
        return float(capability.outside(values, item.lower, item.upper) / max(np.isfinite(values).sum(), 1))

    mean = estimates.grouped(x, group, lambda values: estimates.mean(values).value)
    sigma = estimates.grouped(x, group, lambda values: estimates.sigma(values).value, size=True)
    six_sigma = replace(six_sigma, low=6 * sigma.low, high=6 * sigma.high)
    cp = replace(moments[5], low=moments[5].value * sigma.value / sigma.high,
                 high=moments[5].value * sigma.value / sigma.low)  # fmt: skip
    outside = estimates.grouped(x, group, share)
    outside = replace(outside, low=np.maximum(outside.low, 0.0), high=np.minimum(outside.high, 1.0))
    return mean, sigma, six_sigma, least, most, cp, estimates.grouped(x, group, cpk), outside


def limit_statistics(outcome: Outcome) -> pd.DataFrame:
    """Clamps and guns of limited force, :data:`mic.results.schema.LIMIT_STATISTICS`."""
    scene, rows = outcome.model.scene, []
    limit = {clamp.name: clamp.limit for clamp in scene.clamps if clamp.limit is not None}
    limit |= {weld.name: weld.gun for weld in scene.welds if weld.gun is not None}
    for law in outcome.laws:
        digest, samples = outcome.digests[law], len(outcome.sample_numbers(law))
        for key, short in digest.counts.items():
            if key[0] != "short":
                continue
            _, stage, name = key
            pushed, left, needed = (digest.moments["limits", stage, name, of] for of in ("pushed", "left", "needed"))
            row = {"law": law, "stage": stage, "name": name, "limit": float(limit[name]), "samples": samples}
            row |= {"short": int(short)} | _spread("share_short", estimates.share(short, samples))
            row |= _spread("mean_pushed", estimates.mean(pushed))
            most = float(needed.high) if needed.n > 0 else math.nan
            rows.append(row | {"max_left": float(left.high), "max_needed": most})
    return _frame(LIMIT_STATISTICS, pd.DataFrame(rows), outcome.together == 1)


def summary(outcome: Outcome) -> dict[str, Any]:
    """The outcome in one JSON-ready dict (``summary.json``).

    The zone figures of each law are those of the first stage that resolves contact, clamping in the default process;
    every stage stands under ``"stages"``. Intervals ``…_ci`` are at 95 %; what a tighter path changes of a figure is
    ``…_path`` in mm and ``…_path_share`` (:data:`mic.results.schema.PATH`). Where a design makes samples in groups,
    only key characteristics have intervals (:func:`mic.statistics.estimates.grouped`). What does not exist is None, as
    slip under load without friction.
    """
    study = outcome.path_study
    laws = {}
    for law in outcome.laws:
        zones: dict[str, Any] = {}
        for row in _rows(outcome.zone_statistics, law):
            entry = _with_intervals(row, [f"{name}_{motion}" for motion in _MOTIONS for name in _HANGING])
            entry |= _with_intervals(row, ("mean_slip_length", "mean_friction_work"))
            entry |= _with_intervals(row, [f"{name}_{force}" for force in _PRESSED for name in _HANGING])
            entry["path"] = {state: row[state] for state in STATES}
            zone = zones.setdefault(
                row["zone"], {"contacts": row["contacts"], "friction": row["friction"], **entry, "stages": {}}
            )
            zone["stages"][row["stage"]] = entry
        laws[law] = {
            "samples": len(outcome.sample_numbers(law)),
            "worst_residual": outcome.worst_residual(law),
            "failed": len(outcome.failed[law]),
            "not_built": len(outcome.unbuilt[law]),
            "rescued": len(outcome.rescued[law]),
            "unseen_penetration": _unseen(outcome, law),
            "path": _path(outcome, law) | {"repeated": study.repeated(law) if study else 0},
            "zones": zones,
            "all_within": _all_within(outcome, law),
            "measurements": {
                row["measurement"]: {"lower": row["lower"], "upper": row["upper"]}
                | _with_intervals(row, _MEASURED)
                | {"improved": row["improved"], "explained": row["explained"]}
                | _with_intervals(row, _IMPROVED)
                for row in _rows(outcome.measurement_statistics, law)
            },
            "limits": [
                {name: value for name, value in row.items() if name != "law"}
                for row in _rows(outcome.limit_statistics, law)
            ],
        }
    return _json_ready(
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
            "confidence_level": estimates.LEVEL,
            "laws": laws,
            "versions": outcome.record["versions"],
            "wall_time": outcome.record.get("wall_time", {}),
        }
    )


def _all_within(outcome: Outcome, law: str) -> dict[str, Any] | None:
    """Share of the assemblies whose key characteristics are all within their limits; None where nothing is measured."""
    if not outcome.model.scene.measurements:
        return None
    found = whole_yield(outcome, law)
    return {"share": found.value, "share_ci": [found.low, found.high], "outside_ppm": 1e6 * (1 - found.value)}


def _unseen(outcome: Outcome, law: str) -> dict[str, Any] | None:
    """The deepest penetration between the contact pairs, mm, with its place; None where there is none."""
    depth, stage, sample, at = outcome.digests[law].unseen
    if at < 0:
        return None
    between, zones = outcome.model.between, outcome.model.scene.zones
    return {
        "depth": depth,
        "stage": stage,
        "sample": sample,
        "zone": zones[between.zone[at]].name,
        "point": between.point[at].tolist(),
    }


def _path(outcome: Outcome, law: str) -> dict[str, Any]:
    """What the way took, a sample, and the estimated error at the end of each stage, mm: mean and largest."""
    moments = outcome.digests[law].moments
    found = {
        stage: {column: moments["resolutions", stage, column] for column in ("path_error", "steps", "factorisations")}
        for stage in outcome.digests[law].stages
    }
    return {
        "steps": sum(float(own["steps"].mean) for own in found.values()),
        "factorisations": sum(float(own["factorisations"].mean) for own in found.values()),
        "error": {
            stage: {"mean": float(found[stage]["path_error"].mean), "max": float(found[stage]["path_error"].high)}
            for stage in outcome.stages
            if stage in found
        },
    }


def write_path_study(outcome: Outcome) -> None:
    """Solve and write the study of the path (:mod:`mic.results.path_error`); the other tables tell its effects."""
    study = study_path(outcome)
    _write(outcome.folder, PATH, study.pairs if study else None)
    _write(outcome.folder, PATH_ERRORS, study.errors if study else None)


def write_tables(outcome: Outcome) -> None:
    """Write ``tables/*.csv`` into the run folder, the study of friction among them, which is solved here.

    What the path left is told where :func:`write_path_study` was called before.
    """
    found = {
        ZONE_STATISTICS: outcome.zone_statistics,
        CONTACT_STATISTICS: outcome.contact_statistics,
        MEASUREMENT_STATISTICS: outcome.measurement_statistics,
        PROFILE_STATISTICS: outcome.profile_statistics,
        LIMIT_STATISTICS: outcome.limit_statistics,
        FRICTION: study_friction(outcome),
    }
    with together() as group:
        for table, frame in found.items():
            _write(outcome.folder, table, frame, group)


def _write(folder: Path, table: Table, frame: pd.DataFrame | None, group: Group | None = None) -> None:
    """Write a table; one that has no rows now goes, should the folder hold it from an earlier run."""
    path = folder / table.place
    if frame is None or not len(frame):
        path.unlink(missing_ok=True)
        return
    table.check(frame, path, "this is a fault of the program")
    with replacing(path, group=group) as temporary:
        # The studies are read again: every digit.
        frame.to_csv(temporary, index=False, float_format=None if table in (FRICTION, PATH, PATH_ERRORS) else "%.9g")


def write_summary(outcome: Outcome) -> Path:
    """Write ``summary.json`` into the run folder; returns its path."""
    path = outcome.folder / "summary.json"
    save_json(path, SUMMARY, summary(outcome))
    return path


def _frame(table: Table, frame: pd.DataFrame, independent: bool = True) -> pd.DataFrame:
    """The table; of samples that are not independent, without the intervals that hold of independent ones."""
    if not independent:
        bounds = [name for name in frame.columns if name.endswith(("_low", "_high"))]
        frame = frame.assign(**dict.fromkeys(bounds, math.nan))
    return frame if len(frame) else table.empty()


def _rows(table: pd.DataFrame, law: str) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in table[table["law"] == law].to_dict("records")]


def _spread(name: str, estimate: Estimate) -> dict[str, Any]:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def _effects(outcome: Outcome, law: str, quantity: str, name: str, stage: str | None = None) -> tuple[Effect, Effect]:
    """What a tighter path changes of mean and 6σ, as far as it is known."""
    study = outcome.path_study
    unknown = Effect(float("nan"), float("nan"))
    return (unknown, unknown) if study is None else study.effects(law, quantity, name, stage)


def _change(name: str, effect: Effect) -> dict[str, float]:
    return {f"{name}_path": effect.change, f"{name}_path_share": effect.share}


def _hanging(suffix, estimates, effects) -> dict[str, Any]:
    """Mean and 6σ with their intervals and what the path left in them."""
    row: dict[str, Any] = {}
    for name, estimate, effect in zip(_HANGING, estimates, effects):
        row |= _spread(name + suffix, estimate) | _change(name + suffix, effect)
    return row


def _with_intervals(row, names) -> dict[str, Any]:
    """The figures of a table's row, their intervals as pairs, and what the path left where the table tells it."""
    entry: dict[str, Any] = {}
    for name in names:
        entry |= {name: row[name], f"{name}_ci": [row[f"{name}_low"], row[f"{name}_high"]]}
        entry |= {key: row[key] for key in (f"{name}_path", f"{name}_path_share") if key in row}
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
