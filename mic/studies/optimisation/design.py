"""What may be changed of an assembly, and one choice of it: settings, orders of stages, places of items."""

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
    """One choice.

    Attributes
    ----------
    settings : tuple of float
        Changes of forces (N) and positions (mm) from what the scene states.
    orders : tuple
        By stage, groups of names; None where it is the scene's.
    places : tuple of int
        By item, which of its points: 0 is the scene's.
    """

    settings: tuple[float, ...]
    orders: tuple[Sequenced, ...]
    places: tuple[int, ...]

    @property
    def structure(self) -> tuple[Any, ...]:
        """What takes another process to be prepared."""
        return self.orders, self.places


@dataclass(frozen=True)
class Change:
    """One key that a design changes.

    Attributes
    ----------
    kind : {"force", "shim", "order", "place"}
    targets : tuple of str
        Names of clamps or locators, of a stage, of an item as ``TABLE.NAME``.
    before, after : float, list, or None
        Force, N; change of position, mm; order; point. None: what follows from the file.
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
    """What a scene lets be changed.

    Parameters
    ----------
    model : ReducedModel
        Its scene has a table ``optimise``.

    Attributes
    ----------
    settings : list of Adjustment
    costs : (a,) array
        Of a change by one unit of each.
    stages : list of str
    groups : list of tuple
        By stage, what closes or opens together, in the order of the scene.
    stated_groups : list of list of set
        By stage, what closes or opens together as the scene is.
    items : list of str
    points : list of list
        By item, where it may stand; the first is the scene's.
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
        """What the scene states."""
        return Design((0.0,) * len(self.settings), (None,) * len(self.stages), (0,) * len(self.items))

    @property
    def discrete(self) -> bool:
        """Whether there are orders or places to choose from."""
        return bool(self.items) or any(len(own) > 1 for own in self.groups)

    def opened(self, model: ReducedModel) -> tuple[ReducedModel, list[str]]:
        """A model with a deviation of no spread for each setting, and their names."""
        return extended(model, self.settings)

    def ordered(self, model: ReducedModel, design: Design) -> ReducedModel:
        """A model with the orders of a design."""
        if all(order is None for order in design.orders):
            return model
        return replace(model, scene=_with_orders(model.scene, dict(zip(self.stages, design.orders))))

    def settable(self, settings: Sequence[float] | np.ndarray) -> tuple[float, ...]:
        """Settings as a workshop can make them, within their bounds."""
        return tuple(_rounded(one, float(x)) for one, x in zip(self.settings, settings))

    def changes(self, design: Design) -> list[Change]:
        """What a design changes of the scene."""
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

    def stood(self, design: Design) -> Scene:
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

    def changed(self, design: Design) -> Scene:
        """The scene with a design: forces, strokes, orders, points in their keys, shims as deviations of no spread."""
        scene = _with_orders(self.stood(design), dict(zip(self.stages, design.orders)))
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
    """What closes, or opens, together in a stage, in the order of the scene."""
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


def _rounded(own: Adjustment, change: float) -> float:
    """The nearest change that can be set; a hundredth of its bounds is told apart."""
    step = 10.0 ** np.floor(np.log10((own.high - own.low) / 100.0))
    return float(np.clip(np.round((own.now + change) / step) * step - own.now, own.low, own.high))
