"""Results of the studies in sentences: contributors, friction, remedies, rare misses, optima."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from mic.report.style import number, percent, probability
from mic.studies.contributors import INTERACTION, R_SQUARED, SIGMA, SMALLEST
from mic.studies.friction import HOLDS

__all__ = ["adjusted", "design_words", "friction_words", "linear_words", "named", "optimum_words", "remedy_words"]

NAMED = 3  # contributors that a sentence names
FAR = 6.0  # standard deviations: more distant misses are not mentioned
LITTLE = 0.01  # share of the variance: smaller contributors are not named


def named(rows: pd.DataFrame, share: str) -> str:
    """The largest contributors with their shares: ``F1 88 %, F3 8 %``."""
    first = rows.sort_values(share, ascending=False, kind="stable").head(NAMED).to_dict("records")
    return ", ".join(f"{row['contributor']} {percent(row[share])}" for row in first if row[share] > LITTLE)


def linear_words(table: pd.DataFrame, linearity: pd.DataFrame) -> list[str]:
    """Validity of a linear analysis: one sentence if it holds, else one for each characteristic where it fails."""
    sentences = []
    for row in linearity.to_dict("records"):
        name = row["measurement"]
        if not row["sigma"] > SMALLEST:
            sentences.append(f"{name} hardly varies (σ = {number(1e3 * row['sigma'], 2)} µm): it has no contributors.")
        elif not row["linear"]:
            own = table[(table["law"] == row["law"]) & (table["measurement"] == name)].to_dict("records")
            reasons = "; ".join(_reasons(row, own))
            undecided = f"{name}: validity of a linear analysis not decided; take more samples."
            sentences.append(f"Warning: {name}: a linear analysis misleads: {reasons}." if reasons else undecided)
    if linearity["linear"].all() and linearity["r_squared"].notna().any():
        bound = f"R² ≥ {math.floor(1e3 * linearity['r_squared'].min()) / 1e3:.3f}"
        sentences.append(
            f"All key characteristics are nearly linear ({bound}): a linear analysis gives the same ranking."
        )
    return sentences + _combined(table)


def _combined(table: pd.DataFrame) -> list[str]:
    """Contributors that were combined into one before estimating Sobol's indices, with their bounds."""
    rest = table[table["total"].isna() & table["bound"].notna()]
    if not len(rest):
        return []
    together = rest.groupby(["law", "measurement"])["bound"].sum().max()
    most = rest.sort_values("bound").iloc[-1]
    text = f"{rest['contributor'].nunique()} contributors are combined into one: by their derivatives they contribute "
    text += f"at most {percent(together, 1)} of any variance together, "
    return [f"{text}{most['contributor']} at most {percent(most['bound'], 1)}."]


def _reasons(row: dict[Any, Any], own: list[dict[Any, Any]]) -> list[str]:
    found, own = [], [each for each in own if each["total"] == each["total"]]
    if row["r_squared"] < R_SQUARED:
        found.append(f"R² is {number(row['r_squared'], 2)}")
    if row["interaction"] > INTERACTION and not row["interaction_low"] <= 0:
        most = max(own, key=lambda each: each["total"] - each["first"])
        alone, total = percent(max(most["first"], 0.0)), percent(most["total"])
        found.append(f"{most['contributor']} contributes {alone} of the variance alone and {total} with interactions")
    if abs(row["tangent_sigma"] - row["sigma"]) > SIGMA * row["sigma"]:
        tangent, sigma = number(1e3 * row["tangent_sigma"]), number(1e3 * row["sigma"])
        found.append(f"derivatives at the mean give σ = {tangent} µm instead of {sigma} µm")
    drives = max(own, key=lambda each: each["total"])["contributor"]
    for key, word in (("regression", "a regression"), ("tangent", "derivatives at the mean")):
        known = [each for each in own if each[key] == each[key]]
        if known and (other := max(known, key=lambda each: each[key])["contributor"]) != drives:
            found.append(f"the main contributor is {drives}, but {word} would name {other}")
    return found


def friction_words(effects: pd.DataFrame, needed: pd.DataFrame) -> list[str]:
    """Effect of friction, the decisive zone, and how well friction must be known."""
    sentences = []
    none = effects[(effects["zone"] == "") & (effects["factor"] == 0.0)].to_dict("records")
    for row in none:
        for figure, word in (("mean_change", "mean"), ("six_sigma_change", "6σ")):
            change, low, high = (row[f"{figure}{end}"] for end in ("", "_low", "_high"))
            if abs(change) > HOLDS * row["six_sigma"] and low * high > 0:
                size = f"{number(abs(1e3 * change), 2)} µm {'larger' if change > 0 else 'smaller'}"
                share = percent(abs(change) / row["six_sigma"])
                sentences.append(f"{row['measurement']}: without friction the {word} would be {size}, {share} of 6σ.")
    if not none:
        sentences.append("Without friction this assembly is not held.")
    elif not sentences:
        effect = "each mean and each 6σ changes by less than a tenth of 6σ"
        sentences.append(f"Friction has little effect: without it, {effect}.")
    zones = needed[needed["zone"] != ""]
    held = needed[needed["zone"] == ""].to_dict("records")
    for row in held:
        if row["change"] > HOLDS:
            own = zones[zones["measurement"] == row["measurement"]].to_dict("records")
            decides = f"; zone {max(own, key=lambda each: each['change'])['zone']} matters most" if own else ""
            times = f"{number(row['low'], 2)} to {number(row['high'], 2)} times the friction of the scene{decides}"
            sentences.append(f"{row['measurement']} changes by less than a tenth of 6σ for {times}.")
    if not any(row["change"] > HOLDS for row in held):
        sentences.append("Results change by less than a tenth of 6σ for half to twice the friction of the scene.")
    return sentences


def remedy_words(table: pd.DataFrame, effects: pd.DataFrame, scene) -> list[str]:
    """Effect of each remedy in a sentence, with the shortfall of those that do not suffice."""
    if not len(effects):
        return ["All key characteristics of the scene are within their limits: no remedy is needed."]
    sentences, width = [], {item.name: item.upper - item.lower for item in scene.measurements}
    for remedy, rows in effects.groupby("remedy", sort=False):
        moves = table[table["remedy"] == remedy].to_dict("records")
        what = ", ".join(map(adjusted, moves))
        own = rows[rows["fresh"] == rows["fresh"].max()].to_dict("records")
        lacks = "margin" if remedy == "together" else "margin_before"  # a single adjustment is for the worst
        worst = min(own, key=lambda each: each[lacks] / width[each["measurement"]])
        spoilt = [each["measurement"] for each in own if each["margin"] < 0 <= each["margin_before"]]
        beyond = f"moves {', '.join(spoilt)} out of limits" if spoilt else ""
        if not moves:
            sentences.append("No permitted adjustment improves the characteristics.")
        elif moves[0]["reached"]:
            which = "all characteristics" if remedy == "together" else "the worst characteristic"
            sentences.append(f"{what} brings {which} within limits{', but ' * bool(spoilt)}{beyond}.")
        else:
            short = f"{number(1e3 * worst['margin'], 2)} µm (Cpk {number(worst['cpk'], 2)})"
            also = f"; it also {beyond}" if spoilt else ""
            sentences.append(f"{what} is not enough: the margin of {worst['measurement']} remains {short}{also}.")
    first = effects[effects["remedy"] == effects["remedy"].iloc[0]]
    for row in first[first["fresh"] == first["fresh"].max()].to_dict("records"):
        if row["six_sigma_before"] > width[row["measurement"]]:
            spread, room = number(1e3 * row["six_sigma_before"]), number(1e3 * width[row["measurement"]])
            text = f"{row['measurement']} has 6σ = {spread} µm, more than its tolerance of {room} µm: "
            text += "a shift of the mean cannot suffice. Reduce the scatter of its contributors (`mic contributors`)."
            sentences.append(text)
    return sentences


def design_words(table: pd.DataFrame, points: pd.DataFrame) -> list[str]:
    """The most likely misses with their deviations, and whether the first-order estimate holds."""
    sentences = []
    limits = points.groupby(["law", "measurement", "limit"], sort=False)
    near = sorted((own for _, own in limits if own["beta"].iloc[0] < FAR), key=lambda own: own["beta"].iloc[0])
    for own in near[:NAMED]:
        one = own.iloc[0]
        limit = f"{one['measurement']}, {one['limit']} limit"
        if not one["found"]:
            sentences.append(f"{limit}: no design point found; contact changes the limit.")
            continue
        most = own.sort_values("share", ascending=False, kind="stable").head(NAMED).to_dict("records")
        where = ", ".join(f"{row['deviation']} {signed(row['sigmas'])} σ" for row in most if row["share"] > LITTLE)
        distance = f"{number(one['beta'])} standard deviations from the mean"
        sentences.append(f"{limit}: the most likely miss lies {distance}: {where}.")
    for row in table.to_dict("records"):
        if not row["agrees"] and row["first_order"] == row["first_order"]:
            what, first = row["measurement"] or "the assembly", probability(row["first_order"])
            text = (
                f"Warning: {what}: the first-order estimate, {first}, lies outside the interval: the limit is curved, "
            )
            text += "changes with contact, or has several likely misses. Use the value of the simulation."
            sentences.append(text)
    return sentences


def optimum_words(whole: pd.DataFrame) -> list[str]:
    """Gain of the optimum on fresh samples, which the search did not use."""
    from mic.studies.optimisation.description import OBJECTIVES  # few runs have an optimum

    sentences = []
    for row in whole.to_dict("records"):
        gain, low, high = (number(row[f"gain{end}"]) for end in ("", "_low", "_high"))
        before, after, found = (number(row[name], 4) for name in ("before", "after", "found"))
        sentences.append(
            f"On {row['fresh']} fresh samples {OBJECTIVES[row['objective']]} {before} → {after}: gain {gain} ({low} to "
            f"{high}). On the {row['samples']} samples of the search: {found}, after {row['evaluations']} evaluations."
        )
        if not row["gained"]:
            sentences.append("The gain is not significant: keep the scene as it is.")
    return sentences


def signed(value: float) -> str:
    """A change with its sign: ``+0.25``, ``−40``."""
    return f"{value:+.4g}".replace("-", "−")


def adjusted(row: Mapping[Any, Any]) -> str:
    """An adjustment of a remedy: ``locators.A +0.1 mm``, ``clamps.C1.force −40 N``."""
    unit = "N" if row["adjustment"].endswith(".force") else "mm"
    return f"{row['adjustment']} {signed(row['change'])} {unit}"
