"""The table of an optimisation: objective, changes with their bounds, constraints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from mic.scene.keys import Count, FileName, FiniteFloat, Name, NonNegative, Positive, Table, Vector
from mic.scene.process import MOVING
from mic.scene.stages import CLOSING, unknown

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
    "locator_or_clamp",
    "clamps_with_force",
    "reachable_force",
    "named_items",
]


def _ordered(between: tuple[float, float]) -> tuple[float, float]:
    low, high = between
    if not low < high:
        raise ValueError(f"give [least, most]; {low:g} is not below {high:g}: correct them")
    return between


Between = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_ordered)]


class ForceChoice(Table):
    """A force that may change: that of one clamp, or of several with equal forces, such as the jaws of a tong."""

    clamps: Annotated[list[Name], Field(min_length=1)]
    """clamps with a `force`, the same for all"""

    between: Between
    """least and largest force, N, around that of the scene"""

    cost: NonNegative = 0.0
    """per N of change, for the objective `cost`"""

    step: Positive | None = None
    """N; changes are multiples of it. Default: a power of ten, at most a hundredth of the range"""


class ShimChoice(Table):
    """Locators, or clamps with a stroke, that may move along their direction, all by the same distance."""

    of: Annotated[list[Name], Field(min_length=1)]
    """locators, or clamps with a `stroke`"""

    between: Between
    """least and largest change, mm, around 0"""

    cost: NonNegative = 0.0
    """per mm of change, for the objective `cost`"""

    step: Positive | None = None
    """thickness of a shim, mm; changes are multiples of it. Default: as for forces"""

    @model_validator(mode="after")
    def _around_zero(self):
        if not self.between[0] <= 0 <= self.between[1]:
            raise ValueError("between must include 0, no change: correct it")
        return self


class OrderChoice(Table):
    """A stage whose order may change: of its clamps and further locators, of its welds, or of its release."""

    stage: Name
    """of kind clamp, weld or release"""

    groups: Annotated[list[Annotated[list[Name], Field(min_length=1)]], Field(min_length=2)] | None = None
    """names that close or open together, all of the stage's. Default: the groups of the stage's `order`, else each
    item or tong alone"""


class PlaceChoice(Table):
    """Alternative points of an item, at most 5 mm from its part."""

    item: str
    """`locators.NAME`, `clamps.NAME` or `welds.NAME`"""

    points: Annotated[list[Vector], Field(min_length=1)]
    """candidates besides the point of the scene, mm"""


class Matching(Table):
    """Measured parts of one kind, to be matched with those of others (selective assembly)."""

    name: Name
    """of the kind of part"""

    file: FileName
    """CSV file: a row per part, a column per measured deviation; others vary as stated"""


class Constraint(Table):
    """A bound for each of the measurements, or for the sum of some clamps' forces."""

    quantity: Literal["cpk", "six-sigma", "mean", "force"]
    """Cpk; 6σ, mm; mean, mm from nominal; or the sum of forces, N"""

    of: list[Name] = []
    """measurements, or clamps; default: all"""

    at_least: FiniteFloat | None = None
    """lower bound"""

    at_most: FiniteFloat | None = None
    """upper bound"""

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
    """Objective and variables of `mic optimise`, evaluated over the variation of the inputs."""

    objective: Literal["cpk", "yield", "largest-six-sigma", "six-sigma", "cost"] = "cpk"
    """maximise the smallest Cpk (`cpk`) or the share of assemblies within all limits (`yield`); minimise the
    largest weighted 6σ, their sum, or the cost of changes and rejects"""

    of: list[Name] = []
    """measurements of the objective; default: all"""

    weights: dict[Name, Positive] = {}
    """of the 6σ of measurements by name; default: 1"""

    reject: NonNegative = 0.0
    """cost of an assembly outside its limits"""

    forces: list[ForceChoice] = []
    """forces that may change"""

    shims: list[ShimChoice] = []
    """positions that may change along their direction"""

    orders: list[OrderChoice] = []
    """stages whose order may change"""

    places: list[PlaceChoice] = []
    """items whose point may change"""

    most: Annotated[Count, Field(ge=1)] | None = None
    """largest number of adjustments of one assembly that `mic predict --adjust scene` proposes. Default: all"""

    matching: list[Matching] = []
    """measured parts to be matched, at least two kinds"""

    constraints: list[Constraint] = []
    """bounds that must be met"""

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
        if self.objective != "cost" and (self.reject or any(change.cost for change in (*self.forces, *self.shims))):
            raise ValueError(f"costs apply to the objective cost only, and it is {self.objective}: remove them")
        if self.weights and "six-sigma" not in self.objective:
            raise ValueError(f"weights apply to 6σ, and the objective is {self.objective}: remove them")
        return self


def jaws(scene, name: str) -> list[Any]:
    """The clamps of a name: one, or the jaws of a tong."""
    parts = {f"{name}-{part.name}" for part in scene.parts}
    clamp = [clamp for clamp in scene.clamps if clamp.name == name]
    return clamp or [clamp for clamp in scene.clamps if clamp.name in parts]


def locator_or_clamp(scene, name: str) -> Any:
    """The locator or clamp of a name; None if there is none."""
    return next((item for item in (*scene.locators, *scene.clamps) if item.name == name), None)


def named_items(scene, item: str) -> list[Any]:
    """The item ``TABLE.NAME``, or the jaws of a tong; empty if there is none."""
    table, _, name = item.partition(".")
    if table == "clamps":
        return jaws(scene, name)
    return [entry for entry in getattr(scene, table) if entry.name == name] if table in CLOSING else []


def check_optimisation(scene) -> Iterator[str]:
    """Items of the optimisation exist, and can change as requested.

    Yields
    ------
    str
        One line per error, with the key and the remedy.
    """
    if scene.optimise is not None:
        for check in (_measured, _forces, _shims, _orders, _places, _constraints):
            yield from check(scene, scene.optimise)


def _measured(scene, settings) -> Iterator[str]:
    names = [item.name for item in scene.measurements]
    if not names:
        yield (
            f"optimise.objective: {settings.objective} needs measurements with a tolerance, and there are none; "
            "add [[measurements]]"
        )
        return
    for key, given in (("of", settings.of), ("weights", settings.weights)):
        for name in given:
            yield from unknown(f"optimise.{key}", name, names, "measurement")


def _forces(scene, settings) -> Iterator[str]:
    names = [clamp.name for clamp in scene.clamps]
    seen: set[str] = set()
    for i, choice in enumerate(settings.forces):
        at, clamps = f"optimise.forces[{i}]", []
        for name in choice.clamps:
            clamps += jaws(scene, name)
            if not jaws(scene, name):
                yield from unknown(f"{at}.clamps", name, names, "clamp")
        for clamp in clamps:
            if clamp.force is None:
                yield f"{at}.clamps: {clamp.name!r} has a stroke and no force; name it in optimise.shims"
        given = Counter(clamp.name for clamp in clamps)
        repeated = [name for name, count in given.items() if count > 1 or name in seen]
        if repeated:
            yield f"{at}.clamps: {repeated[0]!r} is given twice; name it once"
        seen |= given.keys()
        stated = {clamp.force for clamp in clamps if clamp.force is not None}
        if len(stated) > 1:
            yield f"{at}.clamps: their forces differ in this scene; give each clamp a table of its own"
        low, high = choice.between
        for force in stated:
            if not low <= force <= high:
                bounds = f"{low:g} to {high:g}"
                yield f"{at}.between: the scene states {force:g} N, which is outside {bounds}; correct either"


def _shims(scene, settings) -> Iterator[str]:
    names = [item.name for item in (*scene.locators, *scene.clamps)]
    seen = set()
    for i, choice in enumerate(settings.shims):
        at, kinds = f"optimise.shims[{i}].of", set()
        for name in choice.of:
            item = locator_or_clamp(scene, name)
            if item is None:
                yield from unknown(at, name, names, "locator or clamp")
                continue
            kinds.add(type(item))
            if getattr(item, "force", None) is not None:
                yield f"{at}: {name!r} pushes with a force and has no position; name it in optimise.forces"
            if getattr(item, "parts", None) is not None:
                yield f"{at}: {name!r} is a tong, whose jaws would move alike; remove it"
            if name in seen:
                yield f"{at}: {name!r} is given twice; name it once"
            seen.add(name)
        if len(kinds) > 1:
            yield f"{at}: locators and clamps cannot share a table; give each a table of its own"


def _orders(scene, settings) -> Iterator[str]:
    stages = {str(stage.name): stage for stage in scene.stages if stage.kind in MOVING}
    seen = set()
    for i, choice in enumerate(settings.orders):
        at = f"optimise.orders[{i}]"
        yield from unknown(f"{at}.stage", choice.stage, stages, "stage that closes or opens anything")
        if choice.stage in seen:
            yield f"{at}.stage: {choice.stage!r} is given twice; name it once"
        seen.add(choice.stage)
        stage = stages.get(choice.stage)
        if stage is not None and choice.groups is not None and stage.kind != "release":
            yield from _grouped(scene, f"{at}.groups", stage, choice.groups)


def _grouped(scene, at: str, stage, groups) -> list[str]:
    """Groups name the items of a stage, or tongs for their jaws, once each: the first error."""
    names = [item.name for table in CLOSING for item in getattr(scene, table) if item.stage == stage.name]
    given: list[str] = []
    for name in (name for group in groups for name in group):
        given += [clamp.name for clamp in jaws(scene, name)] or [name]
    for name in given:
        if found := unknown(at, name, names, f"item of stage {stage.name!r}"):
            return found
        if given.count(name) > 1:
            return [f"{at}: {name!r} is given twice; name it in one group"]
    missing = [name for name in names if name not in given]
    return [f"{at}: the stage closes {missing[0]!r} too; add it to a group"] if missing else []


def _places(scene, settings) -> Iterator[str]:
    seen = set()
    for i, choice in enumerate(settings.places):
        at = f"optimise.places[{i}].item"
        items = named_items(scene, choice.item)
        if not items:
            names = [f"{key}.{item.name}" for key in CLOSING for item in getattr(scene, key)]
            yield from unknown(at, choice.item, names, "item")
        elif any(getattr(item, "hole", None) is not None for item in items):
            yield f"{at}: {choice.item!r} is in a hole and cannot move by itself; remove it"
        if choice.item in seen:
            yield f"{at}: {choice.item!r} is given twice; put all its points into one table"
        seen.add(choice.item)


def _constraints(scene, settings) -> Iterator[str]:
    names = [item.name for item in scene.measurements]
    for i, constraint in enumerate(settings.constraints):
        at = f"optimise.constraints[{i}]"
        if constraint.quantity != "force":
            for name in constraint.of:
                yield from unknown(f"{at}.of", name, names, "measurement")
            continue
        lost = [name for name in constraint.of if not any(clamp.force is not None for clamp in jaws(scene, name))]
        if lost:
            yield from unknown(f"{at}.of", lost[0], [], "clamp with a force")
            continue
        low, high = reachable_force(scene, settings, constraint)
        if constraint.at_least is not None and high < constraint.at_least:
            yield (
                f"{at}: the forces cannot reach {constraint.at_least:g} N together, {constraint.at_least - high:g} N "
                f"are missing at their largest; widen their bounds, or require {high:g} N"
            )
        if constraint.at_most is not None and low > constraint.at_most:
            yield (
                f"{at}: the forces cannot stay below {constraint.at_most:g} N together, they are "
                f"{low - constraint.at_most:g} N above at their least; widen their bounds, or allow {low:g} N"
            )


def clamps_with_force(scene, constraint: Constraint) -> list[Any]:
    """The clamps with a force of a constraint."""
    named = [clamp for name in constraint.of for clamp in jaws(scene, name)] if constraint.of else scene.clamps
    return [clamp for clamp in named if clamp.force is not None]


def reachable_force(scene, settings, constraint: Constraint) -> tuple[float, float]:
    """The least and the largest sum of the forces of a constraint, N."""
    bounds = {
        clamp.name: choice.between
        for choice in settings.forces
        for name in choice.clamps
        for clamp in jaws(scene, name)
    }
    ends = [bounds.get(clamp.name, (clamp.force, clamp.force)) for clamp in clamps_with_force(scene, constraint)]
    return sum(low for low, _ in ends), sum(high for _, high in ends)
