"""The answer first: what is within its limits, with which probability, what drives the worst, and can it be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.report.driver_sentences import named, signed, unit_of
from mic.report.style import change, number, percent
from mic.results.error_sources import Source, error_budget
from mic.results.outcome import Outcome
from mic.results.schema import CONTRIBUTORS, FRICTION_EFFECTS, LINEARITY, RARE, REMEDIES
from mic.results.statistic_tables import whole_yield

__all__ = ["SHOWN", "Answer", "answer"]

SHOWN = 10  # characteristics in the table of the first screen, the least capable ones
FEW = 10  # independent groups of samples: fewer leave intervals that say little
CAPABLE = 1.0  # Cpk whose interval lies above that: all but 3 in a thousand are inside


@dataclass(frozen=True)
class Answer:
    """What the page opens with.

    Attributes
    ----------
    law : str
        The law that it holds for.
    sentences : list of str
        The answer; the first is the shortest that there is.
    rows : list of dict
        By key characteristic, the least capable first: the columns of
        :data:`mic.results.schema.MEASUREMENT_STATISTICS`, ``verdict`` (``in``, ``close`` or ``out``) and ``drivers``.
    more : int
        Characteristics beyond those.
    budget : list of dict
        Sources of error: ``name``, ``mean`` and ``six_sigma`` for people, ``width`` (%) of the bar, ``how``.
    """

    law: str
    sentences: list[str]
    rows: list[dict[Any, Any]]
    more: int
    budget: list[dict[str, Any]]


def answer(outcome: Outcome) -> Answer | None:
    """The answer that a run gives, under its first law; None where nothing is measured or no sample is valid."""
    law = next((law for law in outcome.laws if len(outcome.sample_numbers(law))), None)
    if law is None or not outcome.model.scene.measurements:
        return None
    table = outcome.measurement_statistics
    rows = table[table["law"] == law].sort_values("cpk", kind="stable", na_position="last").to_dict("records")
    drivers = outcome.study(CONTRIBUTORS)
    for row in rows:
        row["verdict"] = _verdict(row)
        own = None
        if drivers is not None:
            own = drivers[(drivers["law"] == law) & (drivers["measurement"] == row["measurement"])]
        row["drivers"] = None if own is None or not len(own) else named(own, "total") or "nothing: it hardly varies"
    budget = error_budget(outcome, law)
    sentences = [_first(outcome, law, rows), *_further(outcome, law, rows), *_trust(outcome, law, budget)]
    return Answer(law, sentences, rows[:SHOWN], max(0, len(rows) - SHOWN), _bars(budget))


def _verdict(row: dict[Any, Any]) -> str:
    if row["share_outside"] > 0:
        return "out"
    return "in" if row["cpk_low"] >= CAPABLE or np.isinf(row["cpk"]) else "close"


def _first(outcome: Outcome, law: str, rows: list[dict[Any, Any]]) -> str:
    """One sentence: how many assemblies are good, which characteristic is worst, what drives it."""
    good, count = whole_yield(outcome, law), len(rows)
    what = f"all {count} key characteristics are" if count > 1 else f"{rows[0]['measurement']} is"
    limits = "their limits" if count > 1 else "its limits"
    share, low, high = (percent(float(x), 1) for x in (good.value, good.low, good.high))
    sure = f" ({low} to {high})" if good.low == good.low else ""
    said = f"In {share} of the assemblies{sure} {what} within {limits}"
    worst = rows[0]
    if count > 1 and np.isfinite(worst["cpk"]):
        outside = f", {percent(worst['share_outside'], 1)} outside" if worst["share_outside"] > 0 else ""
        said += f"; {worst['measurement']} is worst (Cpk {number(worst['cpk'], 2)}{outside})"
    return said + (f", driven by {worst['drivers']}." if worst["drivers"] else ".")


def _further(outcome: Outcome, law: str, rows: list[dict[Any, Any]]) -> list[str]:
    """Rare misses, drivers, friction: what is known of them, or which command tells."""
    said = []
    rare = outcome.study(RARE)
    own = [] if rare is None else rare[(rare["law"] == law) & (rare["measurement"] == "")].to_dict("records")
    for row in own:
        low, high = (number(1e6 * row[f"outside_{end}"], 2) for end in ("low", "high"))
        most = number(1e6 * row["outside"], 2)
        said.append(f"By subset simulation {most} ppm ({low} to {high}) of the assemblies miss a limit.")
        if not row["agrees"] and np.isfinite(row["first_order"]):
            said.append(
                f"The likeliest misses alone would say {number(1e6 * row['first_order'], 2)}: limits are curved."
            )
    linearity = outcome.study(LINEARITY)
    if linearity is None:
        said.append("What drives them is not measured: mic contributors tells, of this folder.")
    elif (beyond := linearity[(linearity["law"] == law) & ~linearity["linear"]])["r_squared"].notna().any():
        said.append("A linear analysis would mislead here: see what drives it.")
    elif len(beyond):
        said.append("Whether a linear analysis holds is not known: mic contributors took too few samples.")
    table = outcome.study(REMEDIES)
    serving = [] if table is None else table[(table["law"] == law) & table["reached"]].to_dict("records")
    if serving:
        last = [one for one in serving if one["remedy"] == serving[-1]["remedy"]]
        moves = ", ".join(f"{one['adjustment']} {signed(one['change'])} {unit_of(one['adjustment'])}" for one in last)
        whom = "all of them" if last[0]["remedy"] == "together" else "the worst"
        said.append(f"{moves} would bring {whom} within limits.")
    elif table is None and any(row["verdict"] == "out" for row in rows):
        said.append("What would mend it is not known: mic remedy tells.")
    if outcome.study(FRICTION_EFFECTS) is None and outcome.has_slip and outcome.model.contacts.frictional:
        said.append("Whether friction matters is not measured: mic friction tells.")
    return said


def _trust(outcome: Outcome, law: str, budget: list[Source]) -> list[str]:
    """How far the figures can be trusted."""
    known = [one for one in budget if one.measured]
    said = []
    if known:
        each = np.array([[one.mean, one.six_sigma] for one in known])
        mean, six_sigma = (change(float(x)).lstrip("+") for x in np.sqrt(np.nansum(each**2, axis=0)))
        most = max(known, key=lambda one: np.nan_to_num(one.six_sigma))
        missing = [one.name for one in budget if not one.measured]
        unknown = f"; not measured: {', '.join(missing)}" if missing else ""
        said.append(f"Means can be trusted to {mean} and 6σ to {six_sigma}, most of it from {most.name}{unknown}.")
    groups = len(outcome.sample_numbers(law)) // outcome.together
    if outcome.together > 1 and groups < FEW:
        said.append(
            f"Its design makes {outcome.together} samples together, and there are {groups} such groups: intervals are "
            f"as wide as {groups} values leave them; draw {FEW * outcome.together}, or independent samples."
        )
    lost = len(outcome.failed[law]) + outcome.missing[law]
    if lost:
        said.append(f"{lost} of {outcome.record['samples']} samples failed or are missing, and do not count.")
    if outcome.unbuilt[law]:
        said.append(
            f"{len(outcome.unbuilt[law])} assemblies are not built: a clamp or gun falls short of its position."
        )
    return said


def _bars(budget: list[Source]) -> list[dict[str, Any]]:
    """Bars on a scale of the largest."""
    largest = max((np.nanmax([one.mean, one.six_sigma]) for one in budget if one.measured), default=0.0) or 1.0
    return [
        {
            "name": one.name,
            "measured": one.measured,
            "mean": _micrometres(one.mean),
            "six_sigma": _micrometres(one.six_sigma),
            "widths": [0.0 if np.isnan(x) else round(100 * x / largest, 1) for x in (one.mean, one.six_sigma)],
            "where": one.where,
            "how": one.how,
        }
        for one in budget
    ]


def _micrometres(value: float) -> str:
    return "–" if np.isnan(value) else "< 0.01" if value < 1e-5 else number(1e3 * value, 2)
