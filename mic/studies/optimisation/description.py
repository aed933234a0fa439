"""What a scene asks of `mic optimise`, in words: one sentence each for what is wanted, may change and must be kept."""

from __future__ import annotations

import math
from typing import Any

from mic.studies.optimisation.design import Space
from mic.studies.optimisation.matching import combinations, read_kinds
from mic.studies.optimisation.optimum import BUDGET, FRESH

__all__ = ["OBJECTIVES", "asked"]

#: What each objective is.
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
MOST = 6  # names in a row
PAIR = 2  # names of a group that are all told


def asked(model: Any) -> list[str]:
    """What `mic optimise` would do: the objective, what may be changed, what is kept, and what that takes.

    Parameters
    ----------
    model : mic.process.model.ReducedModel or mic.model.assembly.Assembly
        Whose scene has a table ``optimise``.

    Raises
    ------
    SceneError
        If a file of measured parts cannot be read.
    """
    scene, space = model.scene, Space(model)
    own = space.asked
    what, items = OBJECTIVES[own.objective].removesuffix(", mm,"), _row(own.of) or "all measurements"
    way = "as large" if own.objective in _GROWS else "as small"
    found = [f"wanted: {what} of {items} becomes {way} as it can, over the variation of the inputs"]
    if own.reject:
        found[0] += f"; an assembly outside its limits costs {own.reject:g}"
    if own.weights:
        found[0] += f"; weights: {_row([f'{name} {weight:g}' for name, weight in own.weights.items()])}"
    for one in space.settings:
        low, high = (one.now + end for end in (one.low, one.high))
        kind = "force" if one.unit == "N" else "shim" if one.kind == "locator" else "stroke"
        found.append(
            f"may change: {kind} of {_row(one.targets)}, {low:g} to {high:g} {one.unit} ({one.now:g} as it is)"
        )
    for stage, groups in zip(space.stages, space.groups):
        row, count = _row([_together(each) for each in groups]), math.factorial(len(groups))
        found.append(f"may change: order of stage {stage}: {row}; {count:,} orders")
    for item, points in zip(space.items, space.points):
        places = "; ".join("(" + ", ".join(f"{x:g}" for x in point) + ")" for point in points[1 : MOST + 1])
        more = f" and {len(points) - 1 - MOST} more" if len(points) - 1 > MOST else ""
        found.append(f"may change: place of {item}, to {places}{more}")
    kinds = read_kinds(scene) if own.matching else []
    for batch in kinds:
        names = [scene.deviations[column].name for column in batch.columns]
        found.append(f"may be matched: {len(batch.rows)} parts {batch.name}, measured: {_row(names)}")
    for limit in own.constraints:
        ends = [f"at least {limit.at_least:g}{_UNITS[limit.quantity]}"] if limit.at_least is not None else []
        ends += [f"at most {limit.at_most:g}{_UNITS[limit.quantity]}"] if limit.at_most is not None else []
        every = "all clamps" if limit.quantity == "force" else "each measurement"
        found.append(f"kept: {_QUANTITIES[limit.quantity]} of {_row(limit.of) or every} is {' and '.join(ends)}")
    return [*found, _effort(space, kinds)]


def _effort(space: Space, kinds) -> str:
    """How much there is to choose from, and what a search takes of it."""
    there = []
    designs = math.prod([math.factorial(len(own)) for own in space.groups] + [len(own) for own in space.points])
    if designs > 1:
        there.append(f"{designs:,} designs of orders and places")
    if space.settings:
        there.append(f"{len(space.settings)} setting{'s' * (len(space.settings) > 1)} between bounds")
    if kinds:
        there.append(f"{combinations(kinds):,} combinations of parts")
    told = " × ".join(there)
    return (
        f"takes: {told}; at most {BUDGET:,} evaluations of an assembly to find the best, unless --budget says another "
        f"number, and up to {2 * FRESH:,} to judge it (--fresh)"
    )


def _together(names) -> str:
    """Names of a group; of a large one the ends."""
    return "+".join(names) if len(names) <= PAIR else f"{names[0]}+…+{names[-1]}"


def _row(names) -> str:
    """Names one after the other, the first of many."""
    names = [str(name) for name in names]
    return ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "")
