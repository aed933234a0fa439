"""Statistics of zones, contacts, key characteristics, profiles and force limits as tables."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.states import STATES
from mic.results.improved import QUANTILES, Improved
from mic.results.output_samples import MOTIONS
from mic.results.path_effect import UNKNOWN
from mic.results.run_samples import RunSamples
from mic.results.schema import (
    CONTACT_STATISTICS,
    LIMIT_STATISTICS,
    MEASUREMENT_STATISTICS,
    PROFILE_STATISTICS,
    SLIPS,
    ZONE_STATISTICS,
    Table,
)
from mic.statistics import capability, estimates
from mic.statistics.estimates import Estimate, Moments

__all__ = [
    "contact_statistics",
    "limit_statistics",
    "measurement_statistics",
    "profile_statistics",
    "whole_yield",
    "zone_statistics",
]

GROUPS = 100  # groups of samples for the jackknife
MEASURED = ("mean", "sigma", "six_sigma", "min", "max", "cp", "cpk", "share_outside")
IMPROVED = ("mean", "six_sigma", "cpk", "share_outside", *QUANTILES)
FIGURES = ("mean", "six_sigma")  # that path effects are given for
PRESSED = {"normal_force": "all", "normal_force_clear": "clear"}  # pairs whose forces are summed


def whole_yield(outcome: RunSamples, law: str) -> Estimate:
    """Share of the assemblies whose key characteristics are all within their limits.

    The interval assumes independent samples; it is NaN for designs that make samples in groups.
    """
    accumulator, samples = outcome.accumulators[law], len(outcome.sample_numbers(law))
    beyond = int(accumulator.counts["any outside",]) if samples else 0
    share = estimates.share(samples - beyond, samples)
    unknown = math.nan * share.value
    return share if outcome.together == 1 else replace(share, low=unknown, high=unknown)


def zone_statistics(outcome: RunSamples) -> pd.DataFrame:
    """Motion and normal force of each zone, :data:`mic.results.schema.ZONE_STATISTICS`."""
    rows = []
    pairs = np.bincount(outcome.model.contacts.zone, minlength=len(outcome.zones))
    for law in outcome.laws:
        samples, improved = len(outcome.sample_numbers(law)), outcome.improved(law)
        unknown = Moments.of(np.full((samples, len(outcome.zones)), np.nan))  # no tangential motion was modelled
        for stage in outcome.stages:
            moments = {
                column: outcome.accumulators[law].moments.get(("slips", stage, column), unknown)
                for column in SLIPS.names[3:]
            }
            for z, (zone, count) in enumerate(zip(outcome.model.scene.zones, pairs)):
                of_zone = {column: by_zone.at(z) for column, by_zone in moments.items()}
                row = {
                    "law": law,
                    "stage": stage,
                    "zone": zone.name,
                    "contacts": int(count),
                    "friction": _coefficient(zone, LAWS[law], stage),
                    "samples": samples,
                    "one_step_samples": improved.estimates.cheap_samples if improved else 0,
                    "confidence": float(estimates.confidence(samples)),
                    "rarest_event": float(estimates.rarest_event(samples)),
                }
                for motion in MOTIONS:
                    row |= _mean_and_spread(f"_{motion}", of_zone[motion])
                    row |= _path_effects(f"_{motion}", outcome, law, motion, zone.name, stage)
                    row |= _improved_zone(improved, stage, zone.name, motion)
                for column in ("slip_length", "friction_work"):
                    row |= _interval(f"mean_{column}", estimates.mean(of_zone[column]))
                for name, which in PRESSED.items():
                    force = outcome.accumulators[law].moments["pressed", stage, which].at(z)
                    row |= _mean_and_spread(f"_{name}", force)
                rows.append(row | {state: estimates.mean(of_zone[state]).value for state in STATES})
    return _frame(ZONE_STATISTICS, [pd.DataFrame(rows)], outcome.together == 1)


def _coefficient(zone, law, stage: str) -> float:
    """μ of a zone under a law in a stage; NaN where it depends on pressure."""
    if not law.frictional:
        return 0.0
    return math.nan if law.coefficient_varies and zone.pressure_pieces() is not None else zone.coefficient(stage)


def contact_statistics(outcome: RunSamples) -> pd.DataFrame:
    """Forces and states of each contact pair, :data:`mic.results.schema.CONTACT_STATISTICS`."""
    frames = []
    m = len(outcome.model.contacts)
    zone = np.array(outcome.zones, dtype=object)[outcome.model.contacts.zone] if m else np.zeros(0, dtype=object)
    for law in outcome.laws:
        accumulator, samples = outcome.accumulators[law], len(outcome.sample_numbers(law))
        for stage in outcome.stages:
            moments = {key[2]: of for key, of in accumulator.moments.items() if key[:2] == ("contacts", stage)}
            columns = {"law": law, "stage": stage, "zone": zone, "contact": np.arange(m), "samples": samples}
            columns |= _mean_and_spread("_f_n", moments["f_n"]) | {"mean_gap": estimates.mean(moments["u_n"]).value}
            if outcome.has_slip:
                columns |= _mean_and_spread("_slip_force", moments["f_t"])
                columns |= _interval("mean_tangential", estimates.mean(moments["u_t"]))
                stick, slip = (estimates.mean(moments[column]).value for column in ("path_stick", "path_slip"))
                columns |= {"path_open": 1.0 - stick - slip, "path_stick": stick, "path_slip": slip}
            for name, count in zip(STATES, accumulator.counts["states", stage]):
                columns |= _interval(name, estimates.share(count, samples))
            frames.append(pd.DataFrame(columns, index=np.arange(m)))
    return _frame(CONTACT_STATISTICS, frames, outcome.together == 1)


def measurement_statistics(outcome: RunSamples) -> pd.DataFrame:
    """Key characteristics against their limits, :data:`mic.results.schema.MEASUREMENT_STATISTICS`."""
    rows = []
    for law in outcome.laws:
        accumulator = outcome.accumulators[law]
        improved = _improved(outcome, law)
        for k, item in enumerate(outcome.model.scene.measurements):
            x = accumulator.moments["measurements",].at(k)
            moments: tuple[Estimate, ...] = (
                estimates.mean(x),
                estimates.sigma(x),
                estimates.six_sigma(x),
                estimates.minimum(x),
                estimates.maximum(x),
                capability.capability(x, math.nan if item.one_sided else item.lower, item.upper),
                capability.centred_capability(x, *item.bounds),
                estimates.share(accumulator.counts["outside",][k], x.n),
            )
            if outcome.together > 1:
                moments = _by_groups(outcome, law, item, moments)
            row = {
                "law": law,
                "measurement": item.name,
                "lower": item.lower,
                "upper": item.upper,
                "samples": moments[0].used,
                "confidence": float(estimates.confidence(x.n)),
                "rarest_event": float(estimates.rarest_event(x.n)),
            }
            for name, estimate in zip(MEASURED, moments):
                row |= _interval(name, estimate)
            rows.append(row | _path_effects("", outcome, law, "measurement", item.name) | improved[item.name])
    return _frame(MEASUREMENT_STATISTICS, [pd.DataFrame(rows)])


def _improved(outcome: RunSamples, law: str) -> dict[str, dict[str, Any]]:
    """Columns of the improved estimates by key characteristic; NaN where the samples alone are better."""
    improved = outcome.improved(law)
    alone = {"one_step_samples": 0, "improved": "plain", "explained": math.nan} | _unknown(*IMPROVED)
    columns: dict[str, dict[str, Any]] = {item.name: dict(alone) for item in outcome.model.scene.measurements}
    if improved is None:
        return columns
    for name, figures in improved.characteristics.items():
        of, k = improved.estimates, improved.keys.index(("measurement", name))
        columns[name] |= {
            "one_step_samples": of.cheap_samples,
            "improved": of.kind[k],
            "explained": float(of.explained[k]),
            "confidence": estimates.LEVEL,
            "rarest_event": float(estimates.rarest_event(max(of.samples, of.cheap_samples), estimates.SEEN)),
        }
        for figure, estimate in figures.items():
            columns[name] |= _interval(f"improved_{figure}", estimate)
    return columns


def _improved_zone(improved: Improved | None, stage: str, zone: str, motion: str) -> dict[str, Any]:
    """Columns of the improved estimates of one motion of a zone; NaN where the samples alone are better."""
    k = improved.index(("slip", stage, zone, motion)) if improved else None
    names = (f"mean_{motion}", f"six_sigma_{motion}")
    if improved is None or k is None:
        return {f"improved_{motion}": "plain"} | _unknown(*names)
    columns: dict[str, Any] = {f"improved_{motion}": improved.estimates.kind[k]}
    for name, estimate in zip(names, (improved.estimates.mean(), improved.estimates.six_sigma())):
        columns |= _interval(f"improved_{name}", estimate.at(k))
    return columns


def _unknown(*names: str) -> dict[str, float]:
    return {f"improved_{name}{end}": math.nan for name in names for end in ("", "_low", "_high")}


def profile_statistics(outcome: RunSamples) -> pd.DataFrame:
    """Deviation maps, :data:`mic.results.schema.PROFILE_STATISTICS`."""
    frames = []
    for law in outcome.laws:
        for item in outcome.model.scene.measurements:
            if item.points is None:
                continue
            x = outcome.accumulators[law].moments["profiles", item.name]
            columns = {"law": law, "measurement": item.name, "point": np.arange(len(item.points)), "samples": x.n}
            columns |= dict(zip("xyz", np.array(item.points).T)) | _mean_and_spread("", x)
            frames.append(pd.DataFrame(columns))
    return _frame(PROFILE_STATISTICS, frames, outcome.together == 1)


def _by_groups(outcome: RunSamples, law: str, item, moments: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
    """The estimates in the order of :data:`MEASURED`, with jackknife intervals over groups of samples."""
    x, group = outcome.measured(law, item.name), outcome.sample_numbers(law) // outcome.together % GROUPS
    mean, sigma, six_sigma, least, most = moments[:5]

    def cpk(values):
        return capability.centred_capability(values, *item.bounds).value

    def share(values):
        return float(capability.outside(values, item.lower, item.upper) / max(np.isfinite(values).sum(), 1))

    mean = estimates.grouped_jackknife(x, group, lambda values: estimates.mean(values).value, added=0)
    sigma = estimates.grouped_jackknife(x, group, lambda values: estimates.sigma(values).value, positive=True)
    six_sigma = replace(six_sigma, low=6 * sigma.low, high=6 * sigma.high)
    cp = replace(moments[5], low=moments[5].value * sigma.value / sigma.high,
                 high=moments[5].value * sigma.value / sigma.low)  # fmt: skip
    outside = estimates.grouped_jackknife(x, group, share)
    outside = replace(outside, low=np.maximum(outside.low, 0.0), high=np.minimum(outside.high, 1.0))
    return mean, sigma, six_sigma, least, most, cp, estimates.grouped_jackknife(x, group, cpk), outside


def limit_statistics(outcome: RunSamples) -> pd.DataFrame:
    """Clamps and guns of limited force, :data:`mic.results.schema.LIMIT_STATISTICS`."""
    scene, rows = outcome.model.scene, []
    limit = {clamp.name: clamp.limit for clamp in scene.clamps if clamp.limit is not None}
    limit |= {weld.name: weld.gun for weld in scene.welds if weld.gun is not None}
    for law in outcome.laws:
        accumulator, samples = outcome.accumulators[law], len(outcome.sample_numbers(law))
        for key, short in accumulator.counts.items():
            if key[0] != "short":
                continue
            _, stage, name = key
            pushed, left, needed = (
                accumulator.moments["limits", stage, name, of] for of in ("pushed", "left", "needed")
            )
            row = {"law": law, "stage": stage, "name": name, "limit": float(limit[name]), "samples": samples}
            row |= {"short": int(short)} | _interval("share_short", estimates.share(short, samples))
            row |= _interval("mean_pushed", estimates.mean(pushed))
            most = float(needed.high) if needed.n > 0 else math.nan
            rows.append(row | {"max_left": float(left.high), "max_needed": most})
    return _frame(LIMIT_STATISTICS, [pd.DataFrame(rows)], outcome.together == 1)


def _frame(table: Table, frames: list[pd.DataFrame], independent: bool = True) -> pd.DataFrame:
    """The frames as one table, without rows if they have none; NaN as intervals if the samples are not independent."""
    if not sum(map(len, frames)):
        return table.empty()
    frame = pd.concat(frames, ignore_index=True)
    frame = frame[[name for name in table.names if name in frame]]
    if not independent:
        bounds = [name for name in frame.columns if name.endswith(("_low", "_high"))]
        frame = frame.assign(**dict.fromkeys(bounds, math.nan))
    return frame


def _mean_and_spread(name: str, moments: Moments) -> dict[str, Any]:
    """Mean and 6σ with their intervals."""
    mean, six_sigma = estimates.mean(moments), estimates.six_sigma(moments)
    return _interval(f"mean{name}", mean) | _interval(f"six_sigma{name}", six_sigma)


def _interval(name: str, estimate: Estimate) -> dict[str, Any]:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def _path_effects(suffix: str, outcome: RunSamples, law: str, *quantity: str) -> dict[str, float]:
    """Effect of a tighter load path on mean and 6σ of a quantity (:meth:`PathStudy.effects`); NaN if unknown."""
    study = outcome.path_study
    columns: dict[str, float] = {}
    for name, effect in zip(FIGURES, study.effects(law, *quantity) if study else (UNKNOWN, UNKNOWN)):
        columns |= {f"{name}{suffix}_path": effect.change, f"{name}{suffix}_path_share": effect.share}
    return columns
