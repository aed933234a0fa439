"""The verdict that opens the report: capability, expected share outside, contributors, estimated errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.plausibility import Results, find_warnings_of_results
from mic.report.driver_sentences import adjusted, named
from mic.report.estimator_sentences import interval_claim, sample_count
from mic.report.style import change, number, probability
from mic.results.capability_verdict import COUNTED, NORMAL, SUBSET, CapabilityVerdict, capability_verdict
from mic.results.error_sources import Source, error_budget
from mic.results.outcome import Outcome
from mic.results.schema import CONTRIBUTORS, FRICTION_EFFECTS, LINEARITY, RARE, REMEDIES
from mic.statistics.decision import CAPABLE, NOT_CAPABLE, NOT_DECIDED

__all__ = ["SHOWN", "Verdict", "verdict"]

SHOWN = 10  # characteristics in the first table, the least capable ones
FEW = 10  # independent groups of samples: fewer give very wide intervals
SMALLEST = 1e-8  # share outside: smaller ones are not told apart
MARKS = {CAPABLE: "in", NOT_DECIDED: "close", NOT_CAPABLE: "out"}


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
        :attr:`mic.results.outcome.Outcome.measurement_headlines`, with the interval of Cpk that decides; ``verdict``
        (``in``, ``close`` or ``out``; empty if a share outside is required) and ``drivers``.
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
    table = outcome.measurement_headlines
    judged = capability_verdict(outcome, law, table)
    if judged is None:
        return None
    own_rows = table[table["law"] == law].to_dict("records")
    by_characteristic = judged.target_cpk is not None
    for k, row in enumerate(own_rows):
        row |= {"cpk_low": judged.cpk.low[k], "cpk_high": judged.cpk.high[k]}
        row["verdict"] = MARKS[judged.decision.each[k]] if by_characteristic else ""
    rows = sorted(own_rows, key=lambda row: np.nan_to_num(row["cpk"], nan=np.inf, posinf=np.inf, neginf=-np.inf))
    drivers = outcome.study(CONTRIBUTORS)
    own = CONTRIBUTORS.empty() if drivers is None else drivers[drivers["law"] == law]
    for row in rows:
        shares = own[own["measurement"] == row["measurement"]]
        row["drivers"] = (named(shares, "total") or "none: it hardly varies") if len(shares) else None
    budget = error_budget(outcome, law)
    sentences = [
        _first(judged, rows, sample_count(outcome, law)),
        *_outside(judged, outcome, law, rows),
        *_implausible(outcome, rows),
    ]
    sentences += [*_further(outcome, law, rows, judged), *_trust(outcome, law, budget)]
    return Verdict(law, sentences, rows[:SHOWN], max(0, len(rows) - SHOWN), budget)


def _first(judged: CapabilityVerdict, rows: list[dict[Any, Any]], count_in_words: str) -> str:
    """Capable, not capable or not decided, with the figure that decides, its interval and the requirement."""
    count, opening = len(rows), judged.verdict.capitalize()
    if judged.verdict == NOT_DECIDED:
        opening = f"Not decided by {count_in_words}"
    if judged.target_outside is not None:
        required, stays = f"at most {probability(judged.target_outside)}", "the share stays there"
        text = f"the share outside limits is {_share(judged)}"
    else:
        worst = next(row for row in rows if row["verdict"] == MARKS[judged.verdict])  # the least capable of these
        required, stays = f"at least {number(judged.target_cpk)}", "this Cpk stays there"
        cpk, low, high = (number(worst[f"cpk{end}"]) for end in ("", "_low", "_high"))
        interval = f" ({low} to {high})" if np.isfinite(worst["cpk_low"]) else ""
        least = ", the least capable," if judged.verdict == CAPABLE and count > 1 else ""
        text = f"Cpk of {worst['measurement']}{least} is {cpk if worst['cpk'] == worst['cpk'] else 'unknown'}{interval}"
    sentence = f"{opening}: {text}, required {required}"
    failing = sum(row["verdict"] == MARKS[NOT_CAPABLE] for row in rows)
    if failing > 1:
        all_fail = f"none of the {count} key characteristics is capable"
        sentence += f"; {all_fail if failing == count else f'{failing} of {count} key characteristics are not capable'}"
    if judged.verdict != NOT_DECIDED:
        return f"{sentence}."
    if judged.needed is not None:
        return f"{sentence}. {judged.needed} samples would decide if {stays}."
    return f"{sentence}. {_undecidable(judged)}"


def _undecidable(judged: CapabilityVerdict) -> str:
    if np.isinf(judged.decision.needed):
        return "It is so close that more than ten million samples would be needed."
    if judged.estimator == SUBSET:
        return "`mic rare` with more samples would decide."
    return "So few samples, or groups of samples, give no interval: draw more."


def _share(judged: CapabilityVerdict) -> str:
    """The share outside limits with its interval."""
    value, low, high = (float(x) for x in (judged.outside.value, judged.outside.low, judged.outside.high))
    if high < SMALLEST:
        return f"below {probability(SMALLEST)}"
    if value == 0 and high > 0:
        return f"at most {probability(high)}"
    return probability(value, low, high) if low == low else probability(value)


def _outside(judged: CapabilityVerdict, outcome: Outcome, law: str, rows: list[dict[Any, Any]]) -> list[str]:
    """Expected share outside with its estimator, and the contributors of the least capable characteristic."""
    by = judged.estimator
    if by == COUNTED:
        by += f" ({outcome.accumulators[law].counts['any outside',]} of {judged.samples})"
    elif by == NORMAL and outcome.model.scene.monte_carlo.values is None:
        by += f"; `mic rare {_folder(outcome)}` assumes none"
    sentences = [f"Expected assemblies outside a limit: {_share(judged)}, {by}."]
    if rows[0]["drivers"]:
        sentences.append(f"Main contributors of {rows[0]['measurement']}: {rows[0]['drivers']}.")
    return sentences


def _implausible(outcome: Outcome, rows: list[dict[Any, Any]]) -> list[str]:
    """Warnings of results out of all proportion."""
    scene, extent = outcome.model.scene, {part.name: part.surface.diameter for part in outcome.parts}
    by_name = {row["measurement"]: (row["mean"], row["six_sigma"]) for row in rows}
    mean, six_sigma = np.array([by_name[item.name] for item in scene.measurements]).T
    return [f"Warning: {warning}." for warning in find_warnings_of_results(Results(scene, extent, mean, six_sigma))]


def _folder(outcome: Outcome) -> str:
    """The results folder as an argument of a command."""
    return f"results/{outcome.folder.name}" if outcome.folder.parent.name == "results" else str(outcome.folder)


def _further(outcome: Outcome, law: str, rows: list[dict[Any, Any]], judged: CapabilityVerdict) -> list[str]:
    """Rare misses, contributors, remedies and friction: results, or the command that computes them."""
    command, sentences = _folder(outcome), []
    rare = outcome.study(RARE)
    own = [] if rare is None else rare[(rare["law"] == law) & (rare["measurement"] == "")].to_dict("records")
    for row in own:
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
    elif table is None and judged.verdict == NOT_CAPABLE:
        required = f" --capability {judged.target_cpk:g}" if judged.target_cpk is not None else ""
        sentences.append(f"Remedy: not computed. Run `mic remedy {command}{required}`.")
    if outcome.study(FRICTION_EFFECTS) is None and outcome.has_slip and outcome.model.contacts.frictional:
        sentences.append(f"Effect of friction: not computed. Run `mic friction {command}`.")
    return sentences


def _trust(outcome: Outcome, law: str, budget: list[Source]) -> list[str]:
    """Estimators, estimated errors, and samples that do not count."""
    known, improved = [one for one in budget if one.measured], outcome.improved(law)
    of_stiffness = outcome.record.get("stiffness", {}).get("sentences", ())
    sentences = [f"{sentence[0].upper()}{sentence[1:]}." for sentence in of_stiffness]
    if improved is not None:
        better = [bool(yes) for key, yes in zip(improved.keys, improved.better) if key[0] == "measurement"]
        sentences.append(
            f"Estimated from {sample_count(outcome, law)}, with surrogates of {sum(better)} of {len(better)} key "
            "characteristics."
        )
    sentences.append(interval_claim(outcome, law))
    if known:
        each = np.array([[one.mean, one.six_sigma] for one in known])
        mean, six_sigma = (change(float(x)).lstrip("+") for x in np.sqrt(np.nansum(each**2, axis=0)))
        of_mean, of_six_sigma = (known[int(np.argmax(np.nan_to_num(column)))].name for column in each.T)
        missing = [one.name for one in budget if not one.measured]
        unknown = f" Not estimated: {', '.join(missing)}." if missing else ""
        errors = f"±{mean} on means (mostly {of_mean}), ±{six_sigma} on 6σ (mostly {of_six_sigma})"
        if of_mean == of_six_sigma:
            errors = f"±{mean} on means, ±{six_sigma} on 6σ, mostly from {of_mean}"
        sentences.append(f"Estimated error: {errors}.{unknown}".replace("±≤", "≤"))
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
