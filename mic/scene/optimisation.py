"""The table of what may be changed of an assembly, and what for: objective, bounds, orders, candidates, constraints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from mic.scene.keys import FiniteFloat, Name, NonNegative, Positive, Table, Vector
from mic.scene.stages import CLOSING, known, told

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

ORDERED = ("clamp", "weld", "release")  # kinds of stages that have an order
MOVED = ("locators", "clamps", "welds")  # what may stand elsewhere


def _ordered(between: tuple[float, float]) -> tuple[float, float]:
    low, high = between
    if not low < high:
        raise ValueError(f"give [least, most]; {low:g} is not below {high:g}: exchange or mend them")
    return between


Between = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_ordered)]


class ForceChoice(Table):
    """A force that may be changed: that of one clamp, or of several that push alike, as the jaws of a tong do."""

    clamps: Annotated[list[Name], Field(min_length=1)] = Field(
        description="clamps with a `force`, which is one and the same for all of them"
    )
    between: Between = Field(description="least and most, N; what the scene states lies between them")
    cost: NonNegative = Field(0.0, description="of a change by 1 N, for the objective `cost`")


class ShimChoice(Table):
    """A locator, or a clamp with a stroke, that may be moved along its direction; several move alike."""

    of: Annotated[list[Name], Field(min_length=1)] = Field(description="locators, or clamps with a `stroke`")
    between: Between = Field(description="least and largest change, mm; 0 lies between them")
    cost: NonNegative = Field(0.0, description="of a change by 1 mm, for the objective `cost`")

    @model_validator(mode="after")
    def _around_zero(self):
        if not self.between[0] <= 0 <= self.between[1]:
            raise ValueError("between are changes, and no change, 0, must lie between them: mend it")
        return self


class OrderChoice(Table):
    """A stage whose order may be changed: that of its clamps and further locators, of its welds, or of what opens."""

    stage: Name = Field(description="of kind clamp, weld or release")
    groups: Annotated[list[Annotated[list[Name], Field(min_length=1)]], Field(min_length=2)] | None = Field(
        None,
        description="names that close, or open, together, each of the stage's in one group. Left out: the groups of "
        "the stage's `order`; where it has none, each weld, further locator, clamp or pair of tongs by itself",
    )


class PlaceChoice(Table):
    """Points at which an item may stand instead; they lie on its part, at most 5 mm off it."""

    item: str = Field(description="`locators.NAME`, `clamps.NAME` or `welds.NAME`")
    points: Annotated[list[Vector], Field(min_length=1)] = Field(
        description="candidates beside the one that the scene states, mm"
    )


class Matching(Table):
    """Measured parts of one kind, to be matched with those of others: selective assembly."""

    name: Name = Field(description="of the kind of part")
    file: Annotated[str, Field(min_length=1)] = Field(
        description="CSV file, a row for each part: columns are the deviations that were measured on it, under their "
        "names; what no kind measures varies as the scene says"
    )


class Constraint(Table):
    """What must be kept, by each of the measurements, or by the sum of some clamps' forces."""

    quantity: Literal["cpk", "six-sigma", "mean", "force"] = Field(
        description="Cpk; 6σ, mm; mean, mm from nominal; or the sum of forces, N"
    )
    of: list[Name] = Field([], description="measurements, or clamps; left out, all of them")
    at_least: FiniteFloat | None = Field(None, description="the least that is allowed")
    at_most: FiniteFloat | None = Field(None, description="the most that is allowed")

    @model_validator(mode="after")
    def _bounds(self):
        if self.at_least is None and self.at_most is None:
            raise ValueError("give at_least or at_most, or both")
        if self.quantity == "cpk" and self.at_most is not None:
            raise ValueError("Cpk is to be large: give at_least, and remove at_most")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            raise ValueError(f"at_least, {self.at_least:g}, is above at_most, {self.at_most:g}: exchange or mend them")
        return self


class Optimisation(Table):
    """What `mic optimise` may change, and what for. Everything is judged over the variation of the inputs."""

    objective: Literal["cpk", "yield", "largest-six-sigma", "six-sigma", "cost"] = Field(
        "cpk",
        description="`cpk`: the least Cpk becomes as large as it can; `yield`: the share of assemblies of which every "
        "measurement is within its limits; `largest-six-sigma`: the largest of the weighted 6σ becomes as small as it "
        "can; `six-sigma`: their sum; `cost`: that of the changes, and of what is rejected",
    )
    of: list[Name] = Field([], description="measurements that the objective is about; left out, all of them")
    weights: dict[Name, Positive] = Field({}, description="of the 6σ of measurements by name; 1 where none is given")
    reject: NonNegative = Field(0.0, description="cost of an assembly that is outside its limits")
    forces: list[ForceChoice] = Field([], description="forces that may be changed")
    shims: list[ShimChoice] = Field([], description="what may be moved along its direction")
    orders: list[OrderChoice] = Field([], description="stages whose order may be changed")
    places: list[PlaceChoice] = Field([], description="what may stand elsewhere")
    matching: list[Matching] = Field([], description="measured parts that may be matched, two kinds or more")
    constraints: list[Constraint] = Field([], description="what must be kept")

    @model_validator(mode="after")
    def _something(self):
        if not any((self.forces, self.shims, self.orders, self.places, self.matching)):
            raise ValueError("nothing may be changed: add forces, shims, orders, places or matching")
        if len(self.matching) == 1:
            raise ValueError("matching takes two kinds of parts at least; add the other's file, or remove it")
        if self.objective == "cost" and not self.reject and not self.constraints:
            raise ValueError(
                "cost is least where nothing is changed; give reject, the cost of an assembly outside its limits, or "
                "constraints"
            )
        if self.objective != "cost" and (self.reject or any(one.cost for one in (*self.forces, *self.shims))):
            raise ValueError(f"costs count for the objective cost only, this one is {self.objective}: remove them")
        if self.weights and "six-sigma" not in self.objective:
            raise ValueError(f"weights are those of 6σ, and the objective is {self.objective}: remove them")
        return self


def jaws(scene, name: str) -> list[Any]:
    """The clamps that a name stands for: one, or those that a tong of this name has become."""
    parts = {f"{name}-{part.name}" for part in scene.parts}
    return [one for one in scene.clamps if one.name == name] or [one for one in scene.clamps if one.name in parts]


def mover(scene, name: str) -> Any:
    """The locator, or clamp, of a name that may be moved along its direction; None where there is none."""
    return next((one for one in (*scene.locators, *scene.clamps) if one.name == name), None)


def standing(scene, item: str) -> list[Any]:
    """What ``TABLE.NAME`` stands for: an item, or the jaws of a tong, which move together; nothing where it is none."""
    table, _, name = item.partition(".")
    if table == "clamps":
        return jaws(scene, name)
    return [one for one in getattr(scene, table) if one.name == name] if table in MOVED else []


def check_optimisation(scene) -> None:
    """What may be changed exists, and may be changed as it is asked.

    Raises
    ------
    ValueError
        One line a problem, naming the key and the remedy.
    """
    asked = scene.optimise
    if asked is None:
        return
    found = [
        line
        for check in (_measured, _forces, _shims, _orders, _places, _constraints)
        for line in told(check, scene, asked)
    ]
    if found:
        raise ValueError("\n".join(found))


def _tell(found: Iterable[str]) -> None:
    lines = list(found)
    if lines:
        raise ValueError("\n".join(lines))


def _measured(scene, asked) -> None:
    names = [one.name for one in scene.measurements]
    if not names:
        raise ValueError(
            f"optimise.objective: {asked.objective} is that of measurements with a tolerance, and nothing is measured; "
            "add [[measurements]]"
        )
    _tell(
        line
        for key, given in (("of", asked.of), ("weights", asked.weights))
        for name in given
        for line in told(known, f"optimise.{key}", name, names, "measurement")
    )


def _forces(scene, asked) -> None:
    names, found, seen = [one.name for one in scene.clamps], [], set()
    for i, choice in enumerate(asked.forces):
        at, stated, twice = f"optimise.forces[{i}]", set(), ""
        for name in choice.clamps:
            own = jaws(scene, name)
            if not own:
                found += told(known, f"{at}.clamps", name, names, "clamp")
            for clamp in own:
                if clamp.force is None:
                    found.append(f"{at}.clamps: {clamp.name!r} has a stroke and no force; name it in optimise.shims")
                    continue
                stated.add(clamp.force)
                twice = twice or (clamp.name if clamp.name in seen else "")
                seen.add(clamp.name)
        if twice:
            found.append(f"{at}.clamps: {twice!r} stands there twice; name it once")
        if len(stated) > 1:
            found.append(f"{at}.clamps: they push with different forces in this scene; give each a table of its own")
        low, high = choice.between
        found += [
            f"{at}.between: the scene states {force:g} N, which is not between {low:g} and {high:g}; mend either"
            for force in stated
            if not low <= force <= high
        ]
    _tell(found)


def _shims(scene, asked) -> None:
    names = [one.name for one in (*scene.locators, *scene.clamps)]
    found, seen = [], set()
    for i, choice in enumerate(asked.shims):
        at, kinds = f"optimise.shims[{i}].of", set()
        for name in choice.of:
            own = mover(scene, name)
            if own is None:
                found += told(known, at, name, names, "locator or clamp")
                continue
            kinds.add(type(own).__name__)
            if getattr(own, "force", None) is not None:
                found.append(f"{at}: {name!r} pushes with a force and has no position; name it in optimise.forces")
            if getattr(own, "parts", None) is not None:
                found.append(f"{at}: {name!r} is a tong, whose jaws would move alike; leave it out")
            if name in seen:
                found.append(f"{at}: {name!r} stands there twice; name it once")
            seen.add(name)
        if len(kinds) > 1:
            found.append(f"{at}: locators and clamps move by themselves; give each a table of its own")
    _tell(found)


def _orders(scene, asked) -> None:
    stages = {str(stage.name): stage for stage in scene.stages}
    found, seen = [], set()
    for i, choice in enumerate(asked.orders):
        at = f"optimise.orders[{i}]"
        stage = stages.get(choice.stage)
        if stage is None or stage.kind not in ORDERED:
            able = [name for name, one in stages.items() if one.kind in ORDERED]
            found += told(known, f"{at}.stage", choice.stage, able, "stage that closes or opens anything")
            continue
        if choice.stage in seen:
            found.append(f"{at}.stage: {choice.stage!r} stands there twice; name it once")
        seen.add(choice.stage)
        if choice.groups is not None and stage.kind != "release":
            found += told(_grouped, scene, f"{at}.groups", stage, choice.groups)
    _tell(found)


def _grouped(scene, key: str, stage, groups) -> None:
    own = [one.name for table in CLOSING for one in getattr(scene, table) if one.stage == stage.name]
    given = [one for name in (name for group in groups for name in group) for one in _called(scene, name)]
    strange = [name for name in given if name not in own]
    twice = [name for name in given if given.count(name) > 1]
    missing = [name for name in own if name not in given]
    if strange:
        known(key, strange[0], own, f"item of stage {stage.name!r}")
    if twice:
        raise ValueError(f"{key}: {twice[0]!r} stands there twice; name it in one group")
    if missing:
        raise ValueError(f"{key}: the stage closes {missing[0]!r} too; add it to a group")


def _called(scene, name: str) -> list[str]:
    """The names that a name stands for, in a stage."""
    return [one.name for one in jaws(scene, name)] or [name]


def _places(scene, asked) -> None:
    found, seen = [], set()
    for i, choice in enumerate(asked.places):
        at = f"optimise.places[{i}].item"
        items = standing(scene, choice.item)
        if not items:
            names = [f"{key}.{one.name}" for key in MOVED for one in getattr(scene, key)]
            found += told(known, at, choice.item, names, "item")
        elif any(getattr(one, "hole", None) is not None for one in items):
            found.append(f"{at}: {choice.item!r} stands in a hole, and moves with it alone; leave it out")
        if choice.item in seen:
            found.append(f"{at}: {choice.item!r} stands there twice; put all its points into one table")
        seen.add(choice.item)
    _tell(found)


def _constraints(scene, asked) -> None:
    found: list[str] = []
    for i, one in enumerate(asked.constraints):
        at = f"optimise.constraints[{i}]"
        if one.quantity != "force":
            names = [item.name for item in scene.measurements]
            found += [line for name in one.of for line in told(known, f"{at}.of", name, names, "measurement")]
            continue
        unknown = [name for name in one.of if not any(clamp.force is not None for clamp in jaws(scene, name))]
        if unknown:
            found += told(known, f"{at}.of", unknown[0], [], "clamp with a force") or [at]
            continue
        low, high = reachable_force(scene, asked, one)
        if one.at_least is not None and high < one.at_least:
            found.append(
                f"{at}: the forces cannot reach {one.at_least:g} N together, {one.at_least - high:g} N are missing at "
                f"their largest; widen their bounds, or ask for {high:g} N"
            )
        if one.at_most is not None and low > one.at_most:
            found.append(
                f"{at}: the forces cannot stay below {one.at_most:g} N together, they are {low - one.at_most:g} N "
                f"above at their least; widen their bounds, or allow {low:g} N"
            )
    _tell(found)


def pushing(scene, one: Constraint) -> list[Any]:
    """The clamps with a force that a constraint is about."""
    named = [clamp for name in one.of for clamp in jaws(scene, name)] if one.of else scene.clamps
    return [clamp for clamp in named if clamp.force is not None]


def reachable_force(scene, asked, one: Constraint) -> tuple[float, float]:
    """The least and the largest sum of the forces of a constraint, N."""
    bounds = {clamp.name: choice.between for choice in asked.forces for clamp in _every_jaw(scene, choice.clamps)}
    ends = [bounds.get(clamp.name, (clamp.force, clamp.force)) for clamp in pushing(scene, one)]
    return sum(low for low, _ in ends), sum(high for _, high in ends)


def _every_jaw(scene, names: Iterable[str]) -> Iterator[Any]:
    return (clamp for name in names for clamp in jaws(scene, name))
