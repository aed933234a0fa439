"""Describe the optimisation that a scene states: a sentence each for objective, allowed changes and constraints."""

from __future__ import annotations

import math
from typing import Any

from mic.studies.optimisation.design import Space
from mic.studies.optimisation.matching import combinations, read_kinds
from mic.studies.optimisation.optimum import BUDGET, FRESH

__all__ = ["OBJECTIVES", "asked"]

#: Description of each objective.
OBJECTIVES = {
    "cpk": "the least Cpk",
    "yield": "the share of good assemblies",
    "largest-six-sigma": "the largest 6σ, mm,",
    "six-sigma": "the sum of 6σ, mm,",
    "cost": "the cost",
}
_GROWS = ("cpk", "yield")
_QUANTITIES = {"cpk": "Cpk", "six-sigma": "6σ", "mean": "the mean", "force": "the sum of the forces"}
_UNITS = {"cpk": "", "six-sigma": " mm", "mean": " mm", "force": " N"}
MAX_NAMES = 6  # names in an enumeration
MAX_GROUP_NAMES = 2  # names of a group that are all listed


def asked(model: Any) -> list[str]:
    """Sentences on the objective, the allowed changes, the constraints and the effort of `mic optimise`.

    Parameters
    ----------
    model : mic.process.model.ReducedModel or mic.model.assembly.Assembly
        Its scene has a table ``optimise``.

    Raises
    ------
    SceneError
        If a file of measured parts cannot be read.
    """
    scene, space = model.scene, Space(model)
    own = space.asked
    what, items = OBJECTIVES[own.objective].removesuffix(", mm,"), _join(own.of) or "all measurements"
    way = "as large" if own.objective in _GROWS else "as small"
    found = [f"wanted: {what} of {items} becomes {way} as it can, over the variation of the inputs"]
    if own.reject:
        found[0] += f"; an assembly outside its limits costs {own.reject:g}"
    if own.weights:
        found[0] += f"; weights: {_join([f'{name} {weight:g}' for name, weight in own.weights.items()])}"
    for one in space.settings:
        low, high = (one.now + end for end in (one.low, one.high))
        kind = "force" if one.unit == "N" else "shim" if one.kind == "locator" else "stroke"
        found.append(
            f"may change: {kind} of {_join(one.targets)}, {low:g} to {high:g} {one.unit} ({one.now:g} as it is)"
        )
    for stage, groups in zip(space.stages, space.groups):
        row, count = _join([_join_group(each) for each in groups]), math.factorial(len(groups))
        found.append(f"may change: order of stage {stage}: {row}; {count:,} orders")
    for item, points in zip(space.items, space.points):
        places = "; ".join("(" + ", ".join(f"{x:g}" for x in point) + ")" for point in points[1 : MAX_NAMES + 1])
        more = f" and {len(points) - 1 - MAX_NAMES} more" if len(points) - 1 > MAX_NAMES else ""
        found.append(f"may change: place of {item}, to {places}{more}")
    kinds = read_kinds(scene) if own.matching else []
    for batch in kinds:
        names = [scene.deviations[column].name for column in batch.columns]
        found.append(f"may be matched: {len(batch.rows)} parts {batch.name}, measured: {_join(names)}")
    for limit in own.constraints:
        ends = [f"at least {limit.at_least:g}{_UNITS[limit.quantity]}"] if limit.at_least is not None else []
        ends += [f"at most {limit.at_most:g}{_UNITS[limit.quantity]}"] if limit.at_most is not None else []
        every = "all clamps" if limit.quantity == "force" else "each measurement"
        found.append(f"kept: {_QUANTITIES[limit.quantity]} of {_join(limit.of) or every} is {' and '.join(ends)}")
    return [*found, _effort(space, kinds)]


def _effort(space: Space, kinds) -> str:
    """Number of designs, and the evaluations of a search."""
    there = []
    designs = math.prod([math.factorial(len(own)) for own in space.groups] + [len(own) for own in space.points])
    if designs > 1:
        there.append(f"{designs:,} designs of orders and places")
    if space.settings:
        there.append(f"{len(space.settings)} setting{'s' * (len(space.settings) > 1)} between bounds")
    if kinds:
        there.append(f"{combinations(kinds):,} combinations of parts")
    choices = " × ".join(there)
    return (
        f"takes: {choices}; at most {BUDGET:,} evaluations of an assembly to find the best, unless --budget says "
        f"another number, and up to {2 * FRESH:,} to judge it (--fresh)"
    )


def _join_group(names) -> str:
    """Names of a group; the first and last of a large one."""
    return "+".join(names) if len(names) <= MAX_GROUP_NAMES else f"{names[0]}+…+{names[-1]}"


def _join(names) -> str:
    """Names separated by commas, at most :data:`MAX_NAMES`."""
    names = [str(name) for name in names]
    return ", ".join(names[:MAX_NAMES]) + (f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else "")
