"""The verdict that opens the report: share within limits, worst characteristic, contributors, estimated errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.plausibility import Results, find_warnings_of_results
from mic.report.driver_sentences import adjusted, named
from mic.report.style import change, number, percent, probability
from mic.results.error_sources import Source, error_budget
from mic.results.outcome import Outcome
from mic.results.schema import CONTRIBUTORS, FRICTION_EFFECTS, LINEARITY, RARE, REMEDIES
from mic.results.statistic_tables import whole_yield

__all__ = ["SHOWN", "Verdict", "verdict"]

SHOWN = 10  # characteristics in the first table, the least capable ones
FEW = 10  # independent groups of samples: fewer give very wide intervals
CAPABLE = 1.0  # lower end of the interval of a Cpk: all but 3 in a thousand are inside


@dataclass(frozen=True)
class Verdict:
    """The first part of the report.

    Attributes
    ----------
    law : str
        Contact law of all figures.
    sentences : list of str
        The first is the verdict itself.
    rows : list of dict
        By key characteristic, the least capable first: the columns of
        :data:`mic.results.schema.MEASUREMENT_STATISTICS`, ``verdict`` (``in``, ``close`` or ``out``) and ``drivers``.
    more : int
        Number of further characteristics.
    budget : list of Source
        Sources of error.
    """

    law: str
    sentences: list[str]
    rows: list[dict[Any, Any]]
    more: int
    budget: list[Source]

    @property
    def largest(self) -> float:
        """The largest estimated error, mm, or 1."""
        errors = [error for one in self.budget if one.measured for error in (one.mean, one.six_sigma)]
        return float(np.nanmax(errors, initial=0.0)) or 1.0


def verdict(outcome: Outcome) -> Verdict | None:
    """The verdict of a run under its first law; None without measurements or valid samples."""
    law = next((law for law in outcome.laws if len(outcome.sample_numbers(law))), None)
    if law is None or not outcome.model.scene.measurements:
        return None
    table = outcome.measurement_statistics
    rows = table[table["law"] == law].sort_values("cpk", kind="stable", na_position="last").to_dict("records")
    drivers = outcome.study(CONTRIBUTORS)
    own = CONTRIBUTORS.empty() if drivers is None else drivers[drivers["law"] == law]
    for row in rows:
        shares = own[own["measurement"] == row["measurement"]]
        row["verdict"] = _verdict(row)
        row["drivers"] = (named(shares, "total") or "none: it hardly varies") if len(shares) else None
    budget = error_budget(outcome, law)
    sentences = [_first(outcome, law, rows), *_implausible(outcome, rows)]
    sentences += [*_further(outcome, law, rows), *_trust(outcome, law, budget)]
    return Verdict(law, sentences, rows[:SHOWN], max(0, len(rows) - SHOWN), budget)


def _verdict(row: dict[Any, Any]) -> str:
    if row["share_outside"] > 0:
        return "out"
    return "in" if row["cpk_low"] >= CAPABLE or np.isinf(row["cpk"]) else "close"


def _first(outcome: Outcome, law: str, rows: list[dict[Any, Any]]) -> str:
    """Share of assemblies within all limits, the worst characteristic and its contributors, in one sentence."""
    good, count = whole_yield(outcome, law), len(rows)
    what = f"all {count} key characteristics are" if count > 1 else f"{rows[0]['measurement']} is"
    limits = "their limits" if count > 1 else "its limits"
    share, low, high = (percent(float(x), 1) for x in (good.value, good.low, good.high))
    interval = f" ({low} to {high})" if good.low == good.low else ""
    sentence = f"In {share} of the assemblies{interval} {what} within {limits}"
    worst = rows[0]
    if count > 1 and np.isfinite(worst["cpk"]):
        outside = f", {percent(worst['share_outside'], 1)} outside" if worst["share_outside"] > 0 else ""
        sentence += f"; the worst is {worst['measurement']} (Cpk {number(worst['cpk'], 2)}{outside})"
    return sentence + (f"; main contributors: {worst['drivers']}." if worst["drivers"] else ".")


def _implausible(outcome: Outcome, rows: list[dict[Any, Any]]) -> list[str]:
    """Warnings of results out of all proportion."""
    scene, extent = outcome.model.scene, {part.name: part.surface.diameter for part in outcome.parts}
    by_name = {row["measurement"]: (row["mean"], row["six_sigma"]) for row in rows}
    mean, six_sigma = np.array([by_name[item.name] for item in scene.measurements]).T
    return [f"Warning: {warning}." for warning in find_warnings_of_results(Results(scene, extent, mean, six_sigma))]


def _further(outcome: Outcome, law: str, rows: list[dict[Any, Any]]) -> list[str]:
    """Rare misses, contributors, remedies and friction: results, or the command that computes them."""
    command = f"results/{outcome.folder.name}" if outcome.folder.parent.name == "results" else str(outcome.folder)
    sentences = []
    rare = outcome.study(RARE)
    own = [] if rare is None else rare[(rare["law"] == law) & (rare["measurement"] == "")].to_dict("records")
    for row in own:
        share = probability(row["outside"], row["outside_low"], row["outside_high"])
        sentences.append(f"Assemblies outside a limit, by subset simulation: {share}.")
        if not row["agrees"] and np.isfinite(row["first_order"]):
            first_order = probability(row["first_order"])
            sentences.append(f"The first-order estimate differs, {first_order}: the limits are curved.")
    linearity = outcome.study(LINEARITY)
    if linearity is None:
        sentences.append(f"Contributors: not computed. Run `mic contributors {command}`.")
    elif (beyond := linearity[(linearity["law"] == law) & ~linearity["linear"]])["r_squared"].notna().any():
        sentences.append("A linear analysis would mislead here: see Contributors.")
    elif len(beyond):
        sentences.append("Validity of a linear analysis: not decided. Run `mic contributors` with more samples.")
    table = outcome.study(REMEDIES)
    serving = [] if table is None else table[(table["law"] == law) & table["reached"]].to_dict("records")
    if serving:
        last = [one for one in serving if one["remedy"] == serving[-1]["remedy"]]
        moves = ", ".join(map(adjusted, last))
        which = "all characteristics" if last[0]["remedy"] == "together" else "the worst characteristic"
        sentences.append(f"Remedy: {moves} brings {which} within limits.")
    elif table is None and any(row["verdict"] == "out" for row in rows):
        sentences.append(f"Remedy: not computed. Run `mic remedy {command}`.")
    if outcome.study(FRICTION_EFFECTS) is None and outcome.has_slip and outcome.model.contacts.frictional:
        sentences.append(f"Effect of friction: not computed. Run `mic friction {command}`.")
    return sentences


def _trust(outcome: Outcome, law: str, budget: list[Source]) -> list[str]:
    """Estimated errors, and samples that do not count."""
    known = [one for one in budget if one.measured]
    sentences = []
    if known:
        each = np.array([[one.mean, one.six_sigma] for one in known])
        mean, six_sigma = (change(float(x)).lstrip("+") for x in np.sqrt(np.nansum(each**2, axis=0)))
        most = max(known, key=lambda one: np.nan_to_num(one.six_sigma))
        missing = [one.name for one in budget if not one.measured]
        unknown = f" Not estimated: {', '.join(missing)}." if missing else ""
        sentences.append(f"Estimated error: ±{mean} on means, ±{six_sigma} on 6σ, mostly from {most.name}.{unknown}")
    groups = len(outcome.sample_numbers(law)) // outcome.together
    if outcome.together > 1 and groups < FEW:
        sentences.append(
            f"The sampling design has only {groups} independent groups of {outcome.together} samples, so intervals are "
            f"wide: draw {FEW * outcome.together} samples, or independent ones."
        )
    lost = len(outcome.failed[law]) + outcome.missing[law]
    if lost:
        sentences.append(f"{lost} of {outcome.record['samples']} samples failed or are missing and are excluded.")
    if outcome.unbuilt[law]:
        sentences.append(
            f"{len(outcome.unbuilt[law])} assemblies are not built: a clamp or gun falls short of its position."
        )
    return sentences
