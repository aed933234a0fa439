"""Design space of an assembly and one design in it: settings, orders of stages, places of items."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mic.process.actions import stage_moves, tongs
from mic.process.model import ReducedModel
from mic.scene import Scene
from mic.scene.optimisation import jaws, mover, standing
from mic.studies.adjustment import Adjustment, as_deviations, extended
from mic.studies.order import named

__all__ = ["Change", "Design", "Space"]

#: Groups of names that close or open together, one after the other; None is the order that the scene states.
Sequenced = tuple[tuple[str, ...], ...] | None


@dataclass(frozen=True)
class Design:
    """One point of the design space.

    Attributes
    ----------
    settings : tuple of float
        Changes of forces (N) and positions (mm) from what the scene states.
    orders : tuple
        By stage, groups of names; None for the scene's own order.
    places : tuple of int
        By item, the number of its point: 0 is the scene's.
    """

    settings: tuple[float, ...]
    orders: tuple[Sequenced, ...]
    places: tuple[int, ...]

    @property
    def structure(self) -> tuple[Any, ...]:
        """Orders and places: designs that differ in them need different models."""
        return self.orders, self.places


@dataclass(frozen=True)
class Change:
    """Change of one key of the scene.

    Attributes
    ----------
    kind : {"force", "shim", "order", "place"}
    targets : tuple of str
        Names of clamps or locators, of a stage, of an item as ``TABLE.NAME``.
    before, after : float, list, or None
        Force, N; change of position, mm; order; point. None for the order that the file implies.
    """

    kind: str
    targets: tuple[str, ...]
    before: Any
    after: Any

    def __str__(self) -> str:
        if self.kind in ("force", "shim"):
            unit, table = ("N", "clamps") if self.kind == "force" else ("mm", "positions")
            return f"{table}.{'+'.join(self.targets)}: {self.before:g} → {self.after:g} {unit}"
        if self.kind == "place":
            points = (", ".join(f"{x:.6g}" for x in point) for point in (self.before, self.after))
            return f"{self.targets[0]}.point: [{next(points)}] → [{next(points)}]"
        groups = "; ".join(" ".join(group) for group in self.after)
        return f"stages.{self.targets[0]}.order: {groups}"


class Space:
    """The changes that a scene allows.

    Parameters
    ----------
    model : ReducedModel
        Its scene has a table ``optimise``.

    Attributes
    ----------
    settings : list of Adjustment
    costs : (a,) array
        Cost of a change by one unit of each setting.
    stages : list of str
    groups : list of tuple
        By stage, groups that close or open together, in the order of the scene.
    stated_groups : list of list of set
        By stage, the groups that the scene closes or opens together.
    items : list of str
    points : list of list
        By item, its allowed points; the first is the scene's.
    """

    def __init__(self, model: ReducedModel):
        self.scene, asked = model.scene, model.scene.optimise
        assert asked is not None
        self.asked, settings = asked, [_force(self.scene, one) for one in asked.forces]
        settings += [_shim(self.scene, one) for one in asked.shims]
        self.settings: list[Adjustment] = settings
        self.costs = np.array([*(one.cost for one in asked.forces), *(one.cost for one in asked.shims)], dtype=float)
        self.stages = [str(one.stage) for one in asked.orders]
        self.groups = [_groups(self.scene, one) for one in asked.orders]
        together = {
            stage.name: [set(names) for move in moves if (names := named(self.scene, move))]
            for stage, moves in stage_moves(self.scene)
        }
        self.stated_groups = [together[stage] for stage in self.stages]
        self.items = [one.item for one in asked.places]
        self.points = [[standing(self.scene, one.item)[0].point, *one.points] for one in asked.places]
        self.low = np.array([one.low for one in settings], dtype=float)
        self.high = np.array([one.high for one in settings], dtype=float)

    @cached_property
    def stated(self) -> Design:
        """The design that the scene states."""
        return Design((0.0,) * len(self.settings), (None,) * len(self.stages), (0,) * len(self.items))

    @property
    def discrete(self) -> bool:
        """Whether there are orders or places to choose from."""
        return bool(self.items) or any(len(own) > 1 for own in self.groups)

    def with_setting_deviations(self, model: ReducedModel) -> tuple[ReducedModel, list[str]]:
        """A model with a deviation of standard deviation 0 for each setting, and the names of these deviations."""
        return extended(model, self.settings)

    def with_orders_of(self, model: ReducedModel, design: Design) -> ReducedModel:
        """A model with the orders of a design."""
        if all(order is None for order in design.orders):
            return model
        return replace(model, scene=_with_orders(model.scene, dict(zip(self.stages, design.orders))))

    def settable(self, settings: Sequence[float] | np.ndarray) -> tuple[float, ...]:
        """Settings rounded to steps that can be set, within their bounds."""
        return tuple(_round_change(one, float(x)) for one, x in zip(self.settings, settings))

    def changes(self, design: Design) -> list[Change]:
        """Changes of the scene under a design."""
        found = []
        for own, change in zip(self.settings, design.settings):
            if change:
                kind = "force" if own.unit == "N" else "shim"
                found.append(Change(kind, own.targets, own.now, own.now + change))
        for stage, order in zip(self.stages, design.orders):
            if order is not None:
                found.append(Change("order", (stage,), None, [list(group) for group in order]))
        for item, points, at in zip(self.items, self.points, design.places):
            if at:
                found.append(Change("place", (item,), list(points[0]), list(points[at])))
        return found

    def with_places_of(self, design: Design) -> Scene:
        """The scene with its items at the places of a design."""
        moved: dict[str, dict[str, Any]] = {}
        for item, points, at in zip(self.items, self.points, design.places):
            if at:
                for one in standing(self.scene, item):
                    moved.setdefault(item.partition(".")[0], {})[one.name] = points[at]
        return self.scene.model_copy(
            update={
                table: [
                    one.model_copy(update={"point": own[one.name], "node": None, "set": None})
                    if one.name in own
                    else one
                    for one in getattr(self.scene, table)
                ]
                for table, own in moved.items()
            }
        )

    def with_design(self, design: Design) -> Scene:
        """The scene under a design: forces, strokes, orders and points in their keys, shims as fixed deviations."""
        scene = _with_orders(self.with_places_of(design), dict(zip(self.stages, design.orders)))
        more = {
            name: change
            for own, change in zip(self.settings, design.settings)
            if own.kind == "clamp"
            for name in own.targets
        }
        clamps = []
        for one in scene.clamps:
            key = "stroke" if one.force is None else "force"
            clamps.append(one.model_copy(update={key: getattr(one, key) + more.get(one.name, 0.0)}))
        shims = [(own, x) for own, x in zip(self.settings, design.settings) if own.kind == "locator" and x]
        moved = as_deviations(scene, [own for own, _ in shims], [x for _, x in shims])
        return scene.model_copy(update={"clamps": clamps, "deviations": [*scene.deviations, *moved]})


def _force(scene, choice) -> Adjustment:
    targets = tuple(one.name for name in choice.clamps for one in jaws(scene, name))
    now = next(one.force for one in scene.clamps if one.name == targets[0])
    low, high = choice.between
    return Adjustment(f"clamps.{'+'.join(targets)}.force", "clamp", targets, now, low - now, high - now)


def _shim(scene, choice) -> Adjustment:
    kind = "clamp" if hasattr(mover(scene, choice.of[0]), "stroke") else "locator"
    now = mover(scene, choice.of[0]).stroke if kind == "clamp" and len(choice.of) == 1 else 0.0
    name = f"{kind}s.{'+'.join(choice.of)}" + ".stroke" * (kind == "clamp")
    return Adjustment(name, kind, tuple(choice.of), now, *choice.between)


def _groups(scene, choice) -> tuple[tuple[str, ...], ...]:
    """Groups that close, or open, together in a stage, in the order of the scene."""
    stage, moves = next((stage, moves) for stage, moves in stage_moves(scene) if stage.name == choice.stage)
    if choice.groups is not None:
        called = lambda name: [one.name for one in jaws(scene, name)] or [name]
        return tuple(tuple(one for name in group for one in called(name)) for group in choice.groups)
    if stage.order is None and stage.kind == "clamp":
        own = [i for i, one in enumerate(scene.clamps) if one.stage == stage.name]
        locators = [(one.name,) for one in scene.locators if one.stage == stage.name]
        return (*locators, *(tuple(scene.clamps[i].name for i in group) for group in tongs(scene, own)))
    if stage.order is None and stage.kind == "weld":
        return tuple((one.name,) for one in scene.welds if one.stage == stage.name)
    return tuple(tuple(names) for move in moves if (names := named(scene, move)))


def _with_orders(scene: Scene, orders: dict[str, Sequenced]) -> Scene:
    stages = []
    for stage in scene.stages:
        order = orders.get(str(stage.name))
        update = {"order": [list(group) for group in order], "sequence": False} if order is not None else {}
        stages.append(stage.model_copy(update=update))
    return scene.model_copy(update={"stages": stages})


def _round_change(own: Adjustment, change: float) -> float:
    """The nearest change that can be set; the step is at most a hundredth of the range."""
    step = 10.0 ** np.floor(np.log10((own.high - own.low) / 100.0))
    return float(np.clip(np.round((own.now + change) / step) * step - own.now, own.low, own.high))
