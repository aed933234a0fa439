"""Synthetic results of a model's studies, with which pictures and pages can be compared."""

from dataclasses import fields

import numpy as np
import pandas as pd

from mic.results.schema import (
    COMPARISON,
    DESIGN_POINTS,
    FRICTION_EFFECTS,
    OPTIMA,
    OPTIMUM_CHANGES,
    ORDERS,
    RARE,
    REMEDIES,
    REMEDY_EFFECTS,
    SENSITIVITIES,
    SPREADS,
)
from mic.studies.optimisation import Optimum
from mic.studies.rare import RareFailures
from mic.studies.remedy import Remedies
from mic.studies.sensitivity import Effects


def filled(table, rows):
    """A table as declared: what rows leave out counts up, so that no two numbers are alike."""
    count, made = 0, []
    for row in rows:
        whole = {}
        for column in table.columns:
            count += 1
            made_up = {"str": "", "bool": True, "int64": count}.get(column.dtype, 0.001 * count)
            whole[column.name] = row.get(column.name, made_up)
        made.append(whole)
    types = {one.name: one.dtype for one in table.columns if one.dtype != "str"}
    return pd.DataFrame(made, columns=table.names).astype(types)


def around(name, value, spread):
    """An estimate with its interval, in digits that a CSV file keeps."""
    ends = {"": value, "_low": value - spread, "_high": value + spread}
    return {f"{name}{end}": round(one, 9) for end, one in ends.items()}


def sensitivities(names, inputs):
    """The i-th input moves the k-th characteristic by (-1)^i (k + 1) / (i + 1) hundredths of a mm; the last one by less
    below a change of a contact than above it."""
    rows = []
    for k, name in enumerate(names):
        for i, one in enumerate(inputs):
            effect = 0.01 * (-1) ** i * (k + 1) / (i + 1)
            sides = {"effect_below": effect, "effect_above": effect * (2 if one == inputs[-1] else 1)}
            rows.append({"law": "coulomb", "measurement": name, "input": one, "step": 0.5, **sides})
            rows[-1] |= around("effect", effect, 0.002)
    return Effects(filled(SENSITIVITIES, rows), SPREADS.empty(), 1.0, "", "", 0)


def friction(names, zones=("", "lap")):
    """Twice the friction moves the k-th mean by 12 k % of its 6σ, half of it by half as much to the other side."""
    rows = [
        {"law": "coulomb", "zone": zone, "factor": factor, "measurement": name, "six_sigma": 0.1}
        | around("mean_change", 0.012 * k * (factor - 1), 0.004)
        | around("six_sigma_change", -0.003 * (factor - 1), 0.001)
        for zone in zones
        for factor in (0.0, 0.5, 2.0)
        for k, name in enumerate(names)
    ]
    return filled(FRICTION_EFFECTS, rows)


def rare(names, deviations):
    """Forty in a million miss, to first order fifty."""
    seen = {"outside": 4e-5, "outside_low": 1e-5, "outside_high": 9e-5, "first_order": 5e-5, "evaluations": 700}
    rows = [{"law": "coulomb", "measurement": name, "levels": 5, "failed": 0} | seen for name in ("", names[0])]
    points = [
        {"law": "coulomb", "measurement": name, "limit": "upper", "beta": 3.0 + k, "found": True, "deviation": one}
        | {"sigmas": (-1) ** i * (3.0 - i), "share": 0.6 / (i + 1)}
        for k, name in enumerate(names)
        for i, one in enumerate(deviations)
    ]
    return RareFailures(filled(RARE, rows), filled(DESIGN_POINTS, points), "")


def remedy(names, adjustment):
    """The mean of the k-th characteristic goes from 0.4 + k to 0.1 + k mm, its 6σ from 0.6 to 0.3 mm."""
    table = [{"law": "coulomb", "remedy": adjustment, "adjustment": adjustment, "change": 0.2, "value": 0.2}]
    figures = {"six_sigma_before": 0.6, "six_sigma": 0.3, "outside_before": 0.125, "outside": 0.25, "samples": 8}
    rows = [
        {"law": "coulomb", "remedy": adjustment, "fresh": fresh, "measurement": name, "margin_before": 0.1 * k - 0.1}
        | {"mean_before": 0.4 + k - 9 * (not fresh), "mean": 0.1 + k}
        | figures
        for fresh in (False, True)
        for k, name in enumerate(names)
    ]
    return Remedies("coulomb", names[0], 1, [], filled(REMEDIES, table), filled(REMEDY_EFFECTS, rows))


def order(names):
    """Reversed, the k-th mean moves by -2 (k + 1) % of its tolerance, with a standard error of half a per cent."""
    rows = [
        {"law": "coulomb", "order": one, "quantity": name, "tolerance": 2.0, "samples": 9}
        | {"mean_change": -0.04 * (k + 1) * j, "mean_error": 0.01 * j}
        | {"six_sigma_change": 0.02 * j, "six_sigma_error": 0.01 * j}
        for j, one in enumerate(("as stated", "reverse"))
        for k, name in enumerate(names)
    ]
    rows.append({"order": "reverse", "quantity": "slip clamp lap", "tolerance": np.nan, "mean_change": 9.0})
    return filled(ORDERS, rows)


def optimum(names):
    """The result and its tables; the k-th mean goes up by 2 (k + 1) % of its tolerance, 6σ down by 4 %."""
    whole = {"law": "coulomb", "objective": "cpk", "before": 1.25, "after": 1.5, "gained": True, "found": 1.625}
    whole |= around("gain", 0.25, 0.125) | {"samples": 60, "fresh": 400, "evaluations": 1234}
    change = {"law": "coulomb", "kind": "force", "targets": "C1", "before": "60", "after": "75"}
    rows = [
        {"quantity": name, "tolerance": 2.0}
        | around("mean_change", 0.02 * (k + 1), 0.01)
        | around("six_sigma_change", -0.04, 0.02)
        for k, name in enumerate(names)
    ]
    nothing = {one.name: None for one in fields(Optimum)}
    table, trail = filled(COMPARISON, [{"quantity": "", "tolerance": np.nan}, *rows]), pd.DataFrame()
    trail["evaluations"], trail["objective"] = [20, 60, 400], [1.0, 1.25, 1.625]
    return Optimum(**nothing | {"objective": "cpk", "table": table, "trail": trail}), {
        OPTIMA: filled(OPTIMA, [whole]),
        OPTIMUM_CHANGES: filled(OPTIMUM_CHANGES, [change]),
        COMPARISON: table,
    }


def left_by_studies(scene):
    """All of them for a scene: tables that the commands leave in a run's folder, and what the functions return."""
    names, deviations = [one.name for one in scene.measurements], [one.name for one in scene.deviations]
    steps, misses, mended = sensitivities(names, deviations), rare(names, deviations), remedy(names, "locators.A")
    rubbing, orders, (best, kept) = friction(names), order(names), optimum(names)
    tables = {
        SENSITIVITIES: steps.table,
        FRICTION_EFFECTS: rubbing,
        RARE: misses.table,
        DESIGN_POINTS: misses.points,
        REMEDIES: mended.table,
        REMEDY_EFFECTS: mended.effects,
        ORDERS: orders,
    }
    return tables | kept, [steps, rubbing, misses, mended, orders, best]
