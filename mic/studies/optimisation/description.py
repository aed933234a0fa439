"""Describe the optimisation that a scene states: a sentence each for objective, allowed changes and constraints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from mic.studies.optimisation.design import Space
from mic.studies.optimisation.matching import Kind, combinations, read_kinds
from mic.studies.optimisation.optimum import BUDGET, FRESH

__all__ = ["OBJECTIVES", "describe"]

#: Description of each objective.
OBJECTIVES = {
    "cpk": "the least Cpk",
    "yield": "the share of good assemblies",
    "largest-six-sigma": "the largest 6σ, mm,",
    "six-sigma": "the sum of 6σ, mm,",
    "cost": "the cost",
}
_MAXIMISED = ("cpk", "yield")
_QUANTITIES = {"cpk": "Cpk", "six-sigma": "6σ", "mean": "the mean", "force": "the sum of the forces"}
_UNITS = {"cpk": "", "six-sigma": " mm", "mean": " mm", "force": " N"}
MAX_NAMES = 6  # names in an enumeration
MAX_GROUP_NAMES = 2  # names of a group that are all listed


def describe(model: Any) -> list[str]:
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
    space = Space(model)
    kinds = read_kinds(model.scene) if space.request.matching else []
    return [
        _objective(space.request),
        *_changes(space),
        *_matching(model.scene, kinds),
        *_constraints(space.request),
        _effort(space, kinds),
    ]


def _objective(request) -> str:
    what, items = OBJECTIVES[request.objective].removesuffix(", mm,"), _join(request.of) or "all measurements"
    direction = "maximise" if request.objective in _MAXIMISED else "minimise"
    sentence = f"objective: {direction} {what} of {items} over the variation of the inputs"
    if request.reject:
        sentence += f"; an assembly outside its limits costs {request.reject:g}"
    if request.weights:
        sentence += f"; weights: {_join([f'{name} {weight:g}' for name, weight in request.weights.items()])}"
    return sentence


def _changes(space: Space) -> Iterator[str]:
    for setting in space.settings:
        low, high = (setting.now + end for end in (setting.low, setting.high))
        kind = "force" if setting.unit == "N" else "shim" if setting.kind == "locator" else "stroke"
        targets, unit = _join(setting.targets), setting.unit
        yield f"may change: {kind} of {targets}, {low:g} to {high:g} {unit} (now {setting.now:g})"
    for stage, groups in zip(space.stages, space.groups):
        names, count = _join([_join_group(group) for group in groups]), math.factorial(len(groups))
        yield f"may change: order of stage {stage}: {names}; {count:,} orders"
    for item, points in zip(space.items, space.points):
        places = "; ".join("(" + ", ".join(f"{x:g}" for x in point) + ")" for point in points[1 : MAX_NAMES + 1])
        more = f" and {len(points) - 1 - MAX_NAMES} more" if len(points) - 1 > MAX_NAMES else ""
        yield f"may change: place of {item}, to {places}{more}"


def _matching(scene, kinds: Sequence[Kind]) -> Iterator[str]:
    for kind in kinds:
        names = [scene.deviations[column].name for column in kind.columns]
        yield f"to be matched: {len(kind.rows)} parts {kind.name} with measured {_join(names)}"


def _constraints(request) -> Iterator[str]:
    for limit in request.constraints:
        unit = _UNITS[limit.quantity]
        ends = [f"at least {limit.at_least:g}{unit}"] if limit.at_least is not None else []
        ends += [f"at most {limit.at_most:g}{unit}"] if limit.at_most is not None else []
        default = "all clamps" if limit.quantity == "force" else "each measurement"
        yield f"constraint: {_QUANTITIES[limit.quantity]} of {_join(limit.of) or default} is {' and '.join(ends)}"


def _effort(space: Space, kinds: Sequence[Kind]) -> str:
    """Number of designs, and the evaluations of a search."""
    choices = []
    designs = math.prod(math.factorial(len(groups)) for groups in space.groups) * math.prod(map(len, space.points))
    if designs > 1:
        choices.append(f"{designs:,} designs of orders and places")
    if space.settings:
        choices.append(f"{len(space.settings)} setting{'s' * (len(space.settings) > 1)} between bounds")
    if kinds:
        choices.append(f"{combinations(kinds):,} combinations of parts")
    return (
        f"effort: {' × '.join(choices)}; at most {BUDGET:,} evaluations of an assembly for the search (--budget), and "
        f"up to {2 * FRESH:,} to evaluate the best design on fresh samples (--fresh)"
    )


def _join_group(names) -> str:
    """Names of a group; the first and last of a large one."""
    return "+".join(names) if len(names) <= MAX_GROUP_NAMES else f"{names[0]}+…+{names[-1]}"


def _join(names) -> str:
    """Names separated by commas, at most :data:`MAX_NAMES`."""
    names = [str(name) for name in names]
    return ", ".join(names[:MAX_NAMES]) + (f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else "")
