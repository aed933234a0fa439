"""Design space of an assembly and one design in it: settings, orders of stages, places of items."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from mic.process.actions import stage_moves
from mic.process.model import ReducedModel
from mic.scene import Scene
from mic.scene.optimisation import jaws, locator_or_clamp, named_items
from mic.studies.adjustment import Adjustment, as_deviations
from mic.studies.order import moved_names

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
    request : mic.scene.optimisation.Optimise
        The table ``optimise``.
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
        self.scene, request = model.scene, model.scene.optimise
        assert request is not None
        self.request = request
        self.settings = [_force(self.scene, choice) for choice in request.forces]
        self.settings += [_shim(self.scene, choice) for choice in request.shims]
        costs = [choice.cost for choice in request.forces] + [choice.cost for choice in request.shims]
        self.costs = np.array(costs, dtype=float)
        self.stages = [str(choice.stage) for choice in request.orders]
        self.groups = [_groups(self.scene, choice) for choice in request.orders]
        together = {
            stage.name: [set(names) for move in moves if (names := moved_names(self.scene, move))]
            for stage, moves in stage_moves(self.scene)
        }
        self.stated_groups = [together[stage] for stage in self.stages]
        self.items = [choice.item for choice in request.places]
        self.points = [[named_items(self.scene, choice.item)[0].point, *choice.points] for choice in request.places]
        self.low = np.array([setting.low for setting in self.settings], dtype=float)
        self.high = np.array([setting.high for setting in self.settings], dtype=float)

    @cached_property
    def stated(self) -> Design:
        """The design that the scene states."""
        return Design((0.0,) * len(self.settings), (None,) * len(self.stages), (0,) * len(self.items))

    @property
    def discrete(self) -> bool:
        """Whether there are orders or places to choose from."""
        return bool(self.items) or any(len(groups) > 1 for groups in self.groups)

    def with_orders_of(self, model: ReducedModel, design: Design) -> ReducedModel:
        """A model with the orders of a design."""
        if all(order is None for order in design.orders):
            return model
        return replace(model, scene=_with_orders(model.scene, dict(zip(self.stages, design.orders))))

    def settable(self, settings: Sequence[float] | np.ndarray) -> tuple[float, ...]:
        """Settings rounded to steps that can be set, within their bounds."""
        return tuple(_round_change(setting, float(x)) for setting, x in zip(self.settings, settings))

    def changes(self, design: Design) -> list[Change]:
        """Changes of the scene under a design."""
        changes = []
        for setting, change in zip(self.settings, design.settings):
            if change:
                kind = "force" if setting.unit == "N" else "shim"
                changes.append(Change(kind, setting.targets, setting.now, setting.now + change))
        for stage, order in zip(self.stages, design.orders):
            if order is not None:
                changes.append(Change("order", (stage,), None, [list(group) for group in order]))
        for item, points, number in zip(self.items, self.points, design.places):
            if number:
                changes.append(Change("place", (item,), list(points[0]), list(points[number])))
        return changes

    def with_places_of(self, design: Design) -> Scene:
        """The scene with its items at the places of a design."""
        tables: dict[str, list[Any]] = {}
        for key, points, number in zip(self.items, self.points, design.places):
            if number:
                table = key.partition(".")[0]
                names = {item.name for item in named_items(self.scene, key)}
                update = {"point": points[number], "node": None, "set": None}
                tables[table] = [
                    item.model_copy(update=update) if item.name in names else item
                    for item in tables.get(table, getattr(self.scene, table))
                ]
        return self.scene.model_copy(update=tables)

    def with_design(self, design: Design) -> Scene:
        """The scene under a design: forces, strokes, orders and points in their keys, shims as fixed deviations."""
        scene = _with_orders(self.with_places_of(design), dict(zip(self.stages, design.orders)))
        changes = {
            name: change
            for setting, change in zip(self.settings, design.settings)
            if setting.kind == "clamp"
            for name in setting.targets
        }
        clamps = []
        for clamp in scene.clamps:
            key = "stroke" if clamp.force is None else "force"
            clamps.append(clamp.model_copy(update={key: getattr(clamp, key) + changes.get(clamp.name, 0.0)}))
        shims = {setting: x for setting, x in zip(self.settings, design.settings) if setting.kind == "locator" and x}
        shim_deviations = as_deviations(scene, [*shims], [*shims.values()])
        return scene.model_copy(update={"clamps": clamps, "deviations": [*scene.deviations, *shim_deviations]})


def _force(scene, choice) -> Adjustment:
    targets = tuple(clamp.name for name in choice.clamps for clamp in jaws(scene, name))
    now = next(clamp.force for clamp in scene.clamps if clamp.name == targets[0])
    low, high = choice.between
    return Adjustment(f"clamps.{'+'.join(targets)}.force", "clamp", targets, now, low - now, high - now, choice.step)


def _shim(scene, choice) -> Adjustment:
    kind = "clamp" if hasattr(locator_or_clamp(scene, choice.of[0]), "stroke") else "locator"
    now = locator_or_clamp(scene, choice.of[0]).stroke if kind == "clamp" and len(choice.of) == 1 else 0.0
    name = f"{kind}s.{'+'.join(choice.of)}" + ".stroke" * (kind == "clamp")
    low, high = choice.between
    return Adjustment(name, kind, tuple(choice.of), now, low, high, choice.step)


def _groups(scene, choice) -> tuple[tuple[str, ...], ...]:
    """Groups that close, or open, together in a stage, in the order of the scene."""
    stage, moves = next((stage, moves) for stage, moves in stage_moves(scene) if stage.name == choice.stage)
    if choice.groups is not None:
        expand = lambda name: [item.name for item in jaws(scene, name)] or [name]
        return tuple(tuple(item for name in group for item in expand(name)) for group in choice.groups)
    groups = [names for move in moves if (names := moved_names(scene, move))]
    if stage.order is None and stage.kind != "release":  # all but the jaws of a tong may close one by one
        clamps = {clamp.name for clamp in scene.clamps}
        split = ([names] if clamps.issuperset(names) else [[name] for name in names] for names in groups)
        groups = list(chain.from_iterable(split))
    return tuple(map(tuple, groups))


def _with_orders(scene: Scene, orders: dict[str, Sequenced]) -> Scene:
    stages = []
    for stage in scene.stages:
        order = orders.get(str(stage.name))
        update = {"order": [list(group) for group in order], "sequence": False} if order is not None else {}
        stages.append(stage.model_copy(update=update))
    return scene.model_copy(update={"stages": stages})


def _round_change(setting: Adjustment, change: float) -> float:
    """The nearest change that can be set; the step is at most a hundredth of the range, or as stated."""
    if setting.increment:
        low, high = (np.trunc(end / setting.increment + np.sign(end) * 1e-9) for end in (setting.low, setting.high))
        return float(np.clip(np.round(change / setting.increment), low, high) * setting.increment)
    step = 10.0 ** np.floor(np.log10((setting.high - setting.low) / 100.0))
    return float(np.clip(np.round((setting.now + change) / step) * step - setting.now, setting.low, setting.high))
