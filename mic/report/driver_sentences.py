"""What drives the key characteristics, and whether friction matters, in sentences."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mic.report.style import number, percent
from mic.studies.contributors import INTERACTION, R_SQUARED, SIGMA, SMALLEST
from mic.studies.friction import HOLDS
from mic.studies.optimisation.description import OBJECTIVES

__all__ = ["design_words", "friction_words", "linear_words", "named", "optimum_words", "remedy_words"]

TOLD = 3  # contributors that a sentence names
FAR = 6.0  # standard normal numbers: of misses farther off nothing is told
LITTLE = 0.01  # of the variance: contributors of less are not named


def named(rows: pd.DataFrame, share: str) -> str:
    """The largest contributors with their shares: ``F1 88 %, F3 8 %``."""
    first = rows.sort_values(share, ascending=False, kind="stable").head(TOLD).to_dict("records")
    return ", ".join(f"{row['contributor']} {percent(row[share])}" for row in first if row[share] > LITTLE)


def linear_words(table: pd.DataFrame, linearity: pd.DataFrame) -> list[str]:
    """Whether a linear analysis can be believed: one sentence if it can, else one for each characteristic where not."""
    said = []
    for row in linearity.to_dict("records"):
        name = row["measurement"]
        if not row["sigma"] > SMALLEST:
            said.append(f"{name} hardly varies (σ {number(1e3 * row['sigma'], 2)} µm): nothing drives it.")
        elif not row["linear"]:
            own = table[(table["law"] == row["law"]) & (table["measurement"] == name)].to_dict("records")
            reasons = _reasons(row, own)
            said.append(
                f"Warning: {name}: a linear analysis misleads: {'; '.join(reasons)}."
                if reasons
                else f"{name}: whether a linear analysis holds is not known: take more samples."
            )
    if linearity["linear"].all() and linearity["r_squared"].notna().any():
        least = number(linearity["r_squared"].min())
        said.append(f"All key characteristics are nearly linear (R² {least} and more): a linear analysis ranks alike.")
    return said + _left_out(table)


def _left_out(table: pd.DataFrame) -> list[str]:
    """Which contributors were left out of Sobol's indices, and what they are at most."""
    rest = table[table["total"].isna() & table["bound"].notna()]
    if not len(rest):
        return []
    together = rest.groupby(["law", "measurement"])["bound"].sum().max()
    most = rest.sort_values("bound").iloc[-1]
    return [
        f"{rest['contributor'].nunique()} contributors count as one: by their derivatives they make together at most "
        f"{percent(together, 1)} of any variance, {most['contributor']} at most {percent(most['bound'], 1)}."
    ]


def _reasons(row: dict[Any, Any], own: list[dict[Any, Any]]) -> list[str]:
    found, own = [], [each for each in own if each["total"] == each["total"]]
    if row["r_squared"] < R_SQUARED:
        found.append(f"R² is {number(row['r_squared'], 2)}")
    if row["interaction"] > INTERACTION and not row["interaction_low"] <= 0:
        most = max(own, key=lambda each: each["total"] - each["first"])
        found.append(
            f"{most['contributor']} makes {percent(max(most['first'], 0.0))} of the variance alone, and "
            f"{percent(most['total'])} with others"
        )
    if abs(row["tangent_sigma"] - row["sigma"]) > SIGMA * row["sigma"]:
        found.append(
            f"by the differences at the mean σ would be {number(1e3 * row['tangent_sigma'])} µm, and it is "
            f"{number(1e3 * row['sigma'])} µm"
        )
    drives = max(own, key=lambda each: each["total"])["contributor"]
    for key, word in (("regression", "the regression"), ("tangent", "the differences at the mean")):
        known = [each for each in own if each[key] == each[key]]
        if known and (other := max(known, key=lambda each: each[key])["contributor"]) != drives:
            found.append(f"{drives} drives it, and {word} would have named {other}")
    return found


def friction_words(effects: pd.DataFrame, needed: pd.DataFrame) -> list[str]:
    """Whether friction matters, which zone's decides, and how well it must be known."""
    said = []
    none = effects[(effects["zone"] == "") & (effects["factor"] == 0.0)].to_dict("records")
    for row in none:
        for figure, word in (("mean_change", "mean"), ("six_sigma_change", "6σ")):
            change, low, high = (row[f"{figure}{end}"] for end in ("", "_low", "_high"))
            if abs(change) > HOLDS * row["six_sigma"] and low * high > 0:
                said.append(
                    f"{row['measurement']}: without friction its {word} would be {number(abs(1e3 * change), 2)} µm "
                    f"{'more' if change > 0 else 'less'}, {percent(abs(change) / row['six_sigma'])} of its 6σ."
                )
    if not none:
        said.append("Without friction this assembly does not hold.")
    elif not said:
        said.append("Friction hardly matters here: without it no mean and no 6σ would move by a tenth of 6σ.")
    zones = needed[needed["zone"] != ""]
    held = needed[needed["zone"] == ""].to_dict("records")
    for row in held:
        if row["change"] > HOLDS:
            own = zones[zones["measurement"] == row["measurement"]].to_dict("records")
            decides = f"; {max(own, key=lambda each: each['change'])['zone']} decides" if own else ""
            said.append(
                f"{row['measurement']} holds to a tenth of its 6σ while friction is {number(row['low'], 2)} to "
                f"{number(row['high'], 2)} times what the scene says{decides}."
            )
    if not any(row["change"] > HOLDS for row in held):
        said.append("The answer holds to a tenth of 6σ for half to twice the friction that the scene says.")
    return said


def remedy_words(table: pd.DataFrame, effects: pd.DataFrame, scene) -> list[str]:
    """Which remedy serves, one sentence each, and by how much those fall short that do not."""
    if not len(effects):
        return ["All key characteristics are within their limits as the scene is: there is nothing to mend."]
    said, width = [], {item.name: item.upper - item.lower for item in scene.measurements}
    for remedy, rows in effects.groupby("remedy", sort=False):
        moves = table[table["remedy"] == remedy].to_dict("records")
        what = ", ".join(f"{one['adjustment']} {signed(one['change'])} {unit_of(one['adjustment'])}" for one in moves)
        own = rows[rows["fresh"] == rows["fresh"].max()].to_dict("records")
        lacks = "margin" if remedy == "together" else "margin_before"  # alone it is for the worst
        worst = min(own, key=lambda each: each[lacks] / width[each["measurement"]])
        spoilt = [each["measurement"] for each in own if each["margin"] < 0 <= each["margin_before"]]
        beyond = f", and takes {', '.join(spoilt)} out of theirs" if spoilt else ""
        if not moves:
            said.append("Nothing that may be adjusted brings the characteristics nearer to their limits.")
        elif moves[0]["reached"]:
            whom = "all characteristics" if remedy == "together" else "the worst characteristic"
            said.append(f"{what} brings {whom} within limits{beyond}.")
        else:
            said.append(
                f"{what} is not enough: {worst['measurement']} falls short by {number(-1e3 * worst['margin'], 2)} µm "
                f"(Cpk {number(worst['cpk'], 2)}){beyond.replace('theirs', 'their limits')}."
            )
    first = effects[effects["remedy"] == effects["remedy"].iloc[0]]
    for row in first[first["fresh"] == first["fresh"].max()].to_dict("records"):
        if row["six_sigma_before"] > width[row["measurement"]]:
            said.append(
                f"{row['measurement']} spreads over {number(1e3 * row['six_sigma_before'])} µm (6σ), more than its "
                f"tolerance of {number(1e3 * width[row['measurement']])} µm: no shift of its mean can mend that, and "
                "what varies must vary less (mic contributors says what)."
            )
    return said


def design_words(table: pd.DataFrame, points: pd.DataFrame) -> list[str]:
    """The likeliest misses, by which deviations, and whether the first order can be believed."""
    said = []
    limits = points.groupby(["law", "measurement", "limit"], sort=False)
    near = sorted((own for _, own in limits if own["beta"].iloc[0] < FAR), key=lambda own: own["beta"].iloc[0])
    for own in near[:TOLD]:
        one = own.iloc[0]
        if not one["found"]:
            said.append(
                f"{one['measurement']}, {one['limit']} limit: no nearest miss was found; it turns with contact."
            )
            continue
        most = own.sort_values("share", ascending=False, kind="stable").head(TOLD).to_dict("records")
        where = ", ".join(f"{row['deviation']} {signed(row['sigmas'])} σ" for row in most if row["share"] > LITTLE)
        said.append(
            f"The likeliest miss of {one['measurement']}, {one['limit']} limit, is {number(one['beta'])} standard "
            f"deviations off: {where}."
        )
    for row in table.to_dict("records"):
        if not row["agrees"] and row["first_order"] == row["first_order"]:
            what = row["measurement"] or "the assembly"
            said.append(
                f"Warning: {what}: to first order {number(1e6 * row['first_order'], 2)} of a million miss, outside of "
                "the interval: the limit is curved, turns with contact, or has several likely misses. Take the "
                "simulation's number."
            )
    return said


def optimum_words(whole: pd.DataFrame) -> list[str]:
    """What the best that was found is worth, of samples that had no part in finding it."""
    said = []
    for row in whole.to_dict("records"):
        gain, low, high = (number(row[f"gain{end}"]) for end in ("", "_low", "_high"))
        before, after, found = (number(row[name], 4) for name in ("before", "after", "found"))
        said.append(
            f"On {row['fresh']} fresh samples {OBJECTIVES[row['objective']]} {before} → {after}: gain {gain} ({low} to "
            f"{high}); {found} on the {row['samples']} samples of the search, which took {row['evaluations']} "
            "evaluations."
        )
        if not row["gained"]:
            said.append("Nothing was gained for sure: leave the scene as it is.")
    return said


def signed(value: float) -> str:
    """A change with its sign: ``+0.25``, ``−40``."""
    return f"{value:+.4g}".replace("-", "−")


def unit_of(adjustment: str) -> str:
    """``N`` of a force, else ``mm``."""
    return "N" if adjustment.endswith(".force") else "mm"
