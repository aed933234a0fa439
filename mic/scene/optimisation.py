"""The table of an optimisation: objective, changes with their bounds, constraints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from mic.scene.keys import FiniteFloat, Name, NonNegative, Positive, Table, Vector
from mic.scene.stages import CLOSING, check_known, error_lines, raise_errors

__all__ = [
    "Constraint",
    "ForceChoice",
    "Matching",
    "Optimisation",
    "OrderChoice",
    "PlaceChoice",
    "ShimChoice",
    "check_optimisation",
    "jaws",
    "mover",
    "pushing",
    "reachable_force",
    "standing",
]

ORDERED = ("clamp", "weld", "release")  # kinds of stages with an order
MOVED = ("locators", "clamps", "welds")  # tables of items with alternative points


def _ordered(between: tuple[float, float]) -> tuple[float, float]:
    low, high = between
    if not low < high:
        raise ValueError(f"give [least, most]; {low:g} is not below {high:g}: correct them")
    return between


Between = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_ordered)]


class ForceChoice(Table):
    """A force that may change: that of one clamp, or of several with equal forces, such as the jaws of a tong."""

    clamps: Annotated[list[Name], Field(min_length=1)] = Field(description="clamps with a `force`, the same for all")
    between: Between = Field(description="least and largest force, N, around that of the scene")
    cost: NonNegative = Field(0.0, description="per N of change, for the objective `cost`")


class ShimChoice(Table):
    """Locators, or clamps with a stroke, that may move along their direction, all by the same distance."""

    of: Annotated[list[Name], Field(min_length=1)] = Field(description="locators, or clamps with a `stroke`")
    between: Between = Field(description="least and largest change, mm, around 0")
    cost: NonNegative = Field(0.0, description="per mm of change, for the objective `cost`")

    @model_validator(mode="after")
    def _around_zero(self):
        if not self.between[0] <= 0 <= self.between[1]:
            raise ValueError("between must include 0, no change: correct it")
        return self


class OrderChoice(Table):
    """A stage whose order may change: of its clamps and further locators, of its welds, or of its release."""

    stage: Name = Field(description="of kind clamp, weld or release")
    groups: Annotated[list[Annotated[list[Name], Field(min_length=1)]], Field(min_length=2)] | None = Field(
        None,
        description="names that close or open together, all of the stage's. Default: the groups of the stage's "
        "`order`, else each item or tong alone",
    )


class PlaceChoice(Table):
    """Alternative points of an item, at most 5 mm from its part."""

    item: str = Field(description="`locators.NAME`, `clamps.NAME` or `welds.NAME`")
    points: Annotated[list[Vector], Field(min_length=1)] = Field(
        description="candidates besides the point of the scene, mm"
    )


class Matching(Table):
    """Measured parts of one kind, to be matched with those of others (selective assembly)."""

    name: Name = Field(description="of the kind of part")
    file: Annotated[str, Field(min_length=1)] = Field(
        description="CSV file: a row per part, a column per measured deviation; others vary as stated"
    )


class Constraint(Table):
    """A bound for each of the measurements, or for the sum of some clamps' forces."""

    quantity: Literal["cpk", "six-sigma", "mean", "force"] = Field(
        description="Cpk; 6σ, mm; mean, mm from nominal; or the sum of forces, N"
    )
    of: list[Name] = Field([], description="measurements, or clamps; default: all")
    at_least: FiniteFloat | None = Field(None, description="lower bound")
    at_most: FiniteFloat | None = Field(None, description="upper bound")

    @model_validator(mode="after")
    def _bounds(self):
        if self.at_least is None and self.at_most is None:
            raise ValueError("give at_least or at_most, or both")
        if self.quantity == "cpk" and self.at_most is not None:
            raise ValueError("a bound of Cpk is a lower one: give at_least, and remove at_most")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            raise ValueError(f"at_least, {self.at_least:g}, is above at_most, {self.at_most:g}: correct them")
        return self


class Optimisation(Table):
    """What `mic optimise` may change, and its objective, evaluated over the variation of the inputs."""

    objective: Literal["cpk", "yield", "largest-six-sigma", "six-sigma", "cost"] = Field(
        "cpk",
        description="maximise the smallest Cpk (`cpk`) or the share of assemblies within all limits (`yield`); "
        "minimise the largest weighted 6σ, their sum, or the cost of changes and rejects",
    )
    of: list[Name] = Field([], description="measurements of the objective; default: all")
    weights: dict[Name, Positive] = Field({}, description="of the 6σ of measurements by name; default: 1")
    reject: NonNegative = Field(0.0, description="cost of an assembly outside its limits")
    forces: list[ForceChoice] = Field([], description="forces that may change")
    shims: list[ShimChoice] = Field([], description="positions that may change along their direction")
    orders: list[OrderChoice] = Field([], description="stages whose order may change")
    places: list[PlaceChoice] = Field([], description="items whose point may change")
    matching: list[Matching] = Field([], description="measured parts to be matched, at least two kinds")
    constraints: list[Constraint] = Field([], description="bounds that must be met")

    @model_validator(mode="after")
    def _something(self):
        if not any((self.forces, self.shims, self.orders, self.places, self.matching)):
            raise ValueError("nothing may be changed: add forces, shims, orders, places or matching")
        if len(self.matching) == 1:
            raise ValueError("matching needs at least two kinds of parts; add another, or remove it")
        if self.objective == "cost" and not self.reject and not self.constraints:
            raise ValueError(
                "the cost is lowest without any change; give reject, the cost of an assembly outside its limits, or "
                "constraints"
            )
        if self.objective != "cost" and (self.reject or any(one.cost for one in (*self.forces, *self.shims))):
            raise ValueError(f"costs apply to the objective cost only, and it is {self.objective}: remove them")
        if self.weights and "six-sigma" not in self.objective:
            raise ValueError(f"weights apply to 6σ, and the objective is {self.objective}: remove them")
        return self


def jaws(scene, name: str) -> list[Any]:
    """The clamps of a name: one, or the jaws of a tong."""
    parts = {f"{name}-{part.name}" for part in scene.parts}
    return [one for one in scene.clamps if one.name == name] or [one for one in scene.clamps if one.name in parts]


def mover(scene, name: str) -> Any:
    """The locator or clamp of a name; None if there is none."""
    return next((one for one in (*scene.locators, *scene.clamps) if one.name == name), None)


def standing(scene, item: str) -> list[Any]:
    """The item ``TABLE.NAME``, or the jaws of a tong; empty if there is none."""
    table, _, name = item.partition(".")
    if table == "clamps":
        return jaws(scene, name)
    return [one for one in getattr(scene, table) if one.name == name] if table in MOVED else []


def check_optimisation(scene) -> None:
    """Items of the optimisation exist, and can change as requested.

    Raises
    ------
    ValueError
        One line per error, with the key and the remedy.
    """
    asked = scene.optimise
    if asked is None:
        return
    raise_errors(
        line
        for check in (_measured, _forces, _shims, _orders, _places, _constraints)
        for line in error_lines(check, scene, asked)
    )


def _measured(scene, asked) -> None:
    names = [one.name for one in scene.measurements]
    if not names:
        raise ValueError(
            f"optimise.objective: {asked.objective} needs measurements with a tolerance, and there are none; "
            "add [[measurements]]"
        )
    raise_errors(
        line
        for key, given in (("of", asked.of), ("weights", asked.weights))
        for name in given
        for line in error_lines(check_known, f"optimise.{key}", name, names, "measurement")
    )


def _forces(scene, asked) -> None:
    names, found, seen = [one.name for one in scene.clamps], [], set()
    for i, choice in enumerate(asked.forces):
        at, stated, twice = f"optimise.forces[{i}]", set(), ""
        for name in choice.clamps:
            own = jaws(scene, name)
            if not own:
                found += error_lines(check_known, f"{at}.clamps", name, names, "clamp")
            for clamp in own:
                if clamp.force is None:
                    found.append(f"{at}.clamps: {clamp.name!r} has a stroke and no force; name it in optimise.shims")
                    continue
                stated.add(clamp.force)
                twice = twice or (clamp.name if clamp.name in seen else "")
                seen.add(clamp.name)
        if twice:
            found.append(f"{at}.clamps: {twice!r} is given twice; name it once")
        if len(stated) > 1:
            found.append(f"{at}.clamps: their forces differ in this scene; give each clamp a table of its own")
        low, high = choice.between
        found += [
            f"{at}.between: the scene states {force:g} N, which is outside {low:g} to {high:g}; correct either"
            for force in stated
            if not low <= force <= high
        ]
    raise_errors(found)


def _shims(scene, asked) -> None:
    names = [one.name for one in (*scene.locators, *scene.clamps)]
    found, seen = [], set()
    for i, choice in enumerate(asked.shims):
        at, kinds = f"optimise.shims[{i}].of", set()
        for name in choice.of:
            own = mover(scene, name)
            if own is None:
                found += error_lines(check_known, at, name, names, "locator or clamp")
                continue
            kinds.add(type(own).__name__)
            if getattr(own, "force", None) is not None:
                found.append(f"{at}: {name!r} pushes with a force and has no position; name it in optimise.forces")
            if getattr(own, "parts", None) is not None:
                found.append(f"{at}: {name!r} is a tong, whose jaws would move alike; remove it")
            if name in seen:
                found.append(f"{at}: {name!r} is given twice; name it once")
            seen.add(name)
        if len(kinds) > 1:
            found.append(f"{at}: locators and clamps cannot share a table; give each a table of its own")
    raise_errors(found)


def _orders(scene, asked) -> None:
    stages = {str(stage.name): stage for stage in scene.stages}
    found, seen = [], set()
    for i, choice in enumerate(asked.orders):
        at = f"optimise.orders[{i}]"
        stage = stages.get(choice.stage)
        if stage is None or stage.kind not in ORDERED:
            able = [name for name, one in stages.items() if one.kind in ORDERED]
            found += error_lines(check_known, f"{at}.stage", choice.stage, able, "stage that closes or opens anything")
            continue
        if choice.stage in seen:
            found.append(f"{at}.stage: {choice.stage!r} is given twice; name it once")
        seen.add(choice.stage)
        if choice.groups is not None and stage.kind != "release":
            found += error_lines(_grouped, scene, f"{at}.groups", stage, choice.groups)
    raise_errors(found)


def _grouped(scene, key: str, stage, groups) -> None:
    own = [one.name for table in CLOSING for one in getattr(scene, table) if one.stage == stage.name]
    given = [one for name in (name for group in groups for name in group) for one in _called(scene, name)]
    strange = [name for name in given if name not in own]
    twice = [name for name in given if given.count(name) > 1]
    missing = [name for name in own if name not in given]
    if strange:
        check_known(key, strange[0], own, f"item of stage {stage.name!r}")
    if twice:
        raise ValueError(f"{key}: {twice[0]!r} is given twice; name it in one group")
    if missing:
        raise ValueError(f"{key}: the stage closes {missing[0]!r} too; add it to a group")


def _called(scene, name: str) -> list[str]:
    """The names of the items of a name: itself, or the jaws of a tong."""
    return [one.name for one in jaws(scene, name)] or [name]


def _places(scene, asked) -> None:
    found, seen = [], set()
    for i, choice in enumerate(asked.places):
        at = f"optimise.places[{i}].item"
        items = standing(scene, choice.item)
        if not items:
            names = [f"{key}.{one.name}" for key in MOVED for one in getattr(scene, key)]
            found += error_lines(check_known, at, choice.item, names, "item")
        elif any(getattr(one, "hole", None) is not None for one in items):
            found.append(f"{at}: {choice.item!r} is in a hole and cannot move by itself; remove it")
        if choice.item in seen:
            found.append(f"{at}: {choice.item!r} is given twice; put all its points into one table")
        seen.add(choice.item)
    raise_errors(found)


def _constraints(scene, asked) -> None:
    found: list[str] = []
    for i, one in enumerate(asked.constraints):
        at = f"optimise.constraints[{i}]"
        if one.quantity != "force":
            names = [item.name for item in scene.measurements]
            found += [
                line for name in one.of for line in error_lines(check_known, f"{at}.of", name, names, "measurement")
            ]
            continue
        unknown = [name for name in one.of if not any(clamp.force is not None for clamp in jaws(scene, name))]
        if unknown:
            found += error_lines(check_known, f"{at}.of", unknown[0], [], "clamp with a force") or [at]
            continue
        low, high = reachable_force(scene, asked, one)
        if one.at_least is not None and high < one.at_least:
            found.append(
                f"{at}: the forces cannot reach {one.at_least:g} N together, {one.at_least - high:g} N are missing at "
                f"their largest; widen their bounds, or require {high:g} N"
            )
        if one.at_most is not None and low > one.at_most:
            found.append(
                f"{at}: the forces cannot stay below {one.at_most:g} N together, they are {low - one.at_most:g} N "
                f"above at their least; widen their bounds, or allow {low:g} N"
            )
    raise_errors(found)


def pushing(scene, one: Constraint) -> list[Any]:
    """The clamps with a force of a constraint."""
    named = [clamp for name in one.of for clamp in jaws(scene, name)] if one.of else scene.clamps
    return [clamp for clamp in named if clamp.force is not None]


def reachable_force(scene, asked, one: Constraint) -> tuple[float, float]:
    """The least and the largest sum of the forces of a constraint, N."""
    bounds = {clamp.name: choice.between for choice in asked.forces for clamp in _every_jaw(scene, choice.clamps)}
    ends = [bounds.get(clamp.name, (clamp.force, clamp.force)) for clamp in pushing(scene, one)]
    return sum(low for low, _ in ends), sum(high for _, high in ends)


def _every_jaw(scene, names: Iterable[str]) -> Iterator[Any]:
    return (clamp for name in names for clamp in jaws(scene, name))
