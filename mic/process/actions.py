"""Actions of a stage: how each changes the rows that hold and push the assembly.

An action changes a :class:`Fixture`, the set of rows that hold and push; nothing is solved here. A stage of the scene
stands for a list of moves (:data:`STAGE_MOVES`), each of them actions that happen together. The production solver and
the full finite-element reference both follow this list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import chain
from typing import Any

import numpy as np

from mic.scene.stages import moves_assembly, placing_stages

__all__ = ["STAGE_MOVES", "Close", "Fixture", "Join", "Move", "Open", "stage_moves", "together", "tongs"]

MAX_COSINE = -0.9  # of the angle between the directions of two clamps that push against each other


@dataclass(frozen=True)
class Fixture:
    """The rows that hold and push the assembly.

    Attributes
    ----------
    locators : tuple of int
        Locator rows that hold.
    strokes : tuple of int
        Clamp rows that hold a position.
    forces : tuple of int
        Clamp rows that push with a force, with the weights of the parts that are placed.
    limited : tuple of int
        Clamp rows that push towards a position with a limited force.
    guns : tuple of int
        Welds whose gun presses.
    welds : tuple of int
        Welds made.
    waiting : tuple of int
        Locator rows that hold parts placed by later stages, in their future position and without contact.
    """

    locators: tuple[int, ...] = ()
    strokes: tuple[int, ...] = ()
    forces: tuple[int, ...] = ()
    limited: tuple[int, ...] = ()
    guns: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()
    waiting: tuple[int, ...] = ()

    @property
    def clamps(self) -> tuple[int, ...]:
        """All clamp rows; the weights of parts are among them."""
        return self.strokes + self.forces + self.limited

    def after(self, actions: Iterable[Action]) -> Fixture:
        """The fixture after some actions."""
        return reduce(lambda fixture, action: action.apply(fixture), actions, self)


class Action(Fixture):
    """One action of a stage: the rows that it concerns, none by default."""

    def apply(self, fixture: Fixture) -> Fixture:
        """The fixture afterwards."""
        return self._with_each(fixture, lambda rows, own: rows + own)

    def _with_each(self, fixture: Fixture, change: Callable[..., tuple[int, ...]]) -> Fixture:
        """The fixture with each of its rows changed by those of the action."""
        names = [field.name for field in fields(Fixture)]
        return Fixture(*(change(getattr(fixture, name), getattr(self, name)) for name in names))


class Close(Action):
    """Close locators, clamps and guns.

    Locators and strokes move to their targets and stay there; the others push with their force. Guns press sheets until
    they touch.
    """


class Open(Action):
    """Open locators, clamps and guns; the welds made under the guns take over their forces."""

    def apply(self, fixture: Fixture) -> Fixture:
        return self._with_each(fixture, _without)


def _without(numbers: tuple[int, ...], removed: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(i for i in numbers if i not in removed)


class Placement(Action):
    """Place parts, or the assembly, on locators; they touch nothing yet. The forces are the weights of the parts."""

    def apply(self, fixture: Fixture) -> Fixture:
        return replace(super().apply(fixture), waiting=_without(fixture.waiting, self.locators))


class PlaceParts(Placement):
    """Place the first parts on locators, one by one; overlaps are resolved later."""


class MoveAssembly(Placement):
    """Open all locators and clamps, and place the assembly on other locators; parts that wait for these join it.

    The assembly moves as it is, with its contacts active; it does not touch the new station yet.
    """

    def apply(self, fixture: Fixture) -> Fixture:
        return super().apply(Fixture(welds=fixture.welds, waiting=fixture.waiting))


@dataclass(frozen=True)
class Join(Action):
    """Make welds: each freezes the current relative position of its sheets; those in `gap` close their gap first."""

    gap: tuple[int, ...] = ()


class ResolveOverlap(Action):
    """Separate parts that overlap where they were placed, along the contact normals.

    It happens before the first thing closes, or together with it.
    """


class Read(Action):
    """Read the measurements."""


Move = tuple[Action, ...]  #: actions that happen together, contact active throughout


def _in_stage(items, stage) -> tuple[int, ...]:
    return tuple(i for i, item in enumerate(items) if item.stage == stage.name)


def _locate(scene, stage, before) -> list[Move]:
    """The first stage places parts; a later one adds parts, or moves the assembly to another station."""
    own = _in_stage(scene.locators, stage)
    if before and moves_assembly(scene, stage):
        return [(_transfer(scene, stage, own),)]
    place = Placement if before else PlaceParts
    stations = [one.name for one in _stages_up_to(scene, stage) if one is scene.stages[0] or moves_assembly(scene, one)]
    return [(place(own, forces=_weights(scene, stations[-1], [stage.name])),)]


def _stages_up_to(scene, stage) -> list[Any]:
    """The stages up to and including this one."""
    return scene.stages[: 1 + next(i for i, one in enumerate(scene.stages) if one is stage)]


def _transfer(scene, stage, locators) -> MoveAssembly:
    weights = _weights(scene, stage.name, [one.name for one in _stages_up_to(scene, stage)])
    return MoveAssembly(locators, forces=weights)


def _weights(scene, station: str, stages: Sequence[str]) -> tuple[int, ...]:
    """Rows of the weights, in one station, of the parts that these stages place.

    They follow the clamps' rows, grouped by deviation of kind gravity.
    """
    there, first = placing_stages(scene), scene.stages[0].name
    gravity = [item for item in scene.deviations if item.kind == "gravity"]
    return tuple(
        len(scene.clamps) + g * len(scene.parts) + p
        for g, item in enumerate(gravity)
        for p, part in enumerate(scene.parts)
        if (item.stage or first) == station and there[part.name] in stages
    )


def _clamp(scene, stage, before) -> list[Move]:
    """Further locators together, then clamp after clamp in the order of the file; or the groups of `order`."""
    locators, clamps = _in_stage(scene.locators, stage), _in_stage(scene.clamps, stage)
    if stage.order is None:
        moves = [(Close(locators),)] if locators else []
        return moves + [_close(scene, group) for group in tongs(scene, clamps)]
    return [
        _close(scene, _numbers_of(scene.clamps, clamps, names), _numbers_of(scene.locators, locators, names))
        for names in stage.order
    ]


def _close(scene, clamps, locators=()) -> Move:
    pushing = tuple(i for i in clamps if scene.clamps[i].force is not None)
    limited = tuple(i for i in clamps if scene.clamps[i].limit is not None)
    holding = tuple(i for i in clamps if i not in pushing and i not in limited)
    return (Close(locators, holding, pushing, limited),) * bool(clamps or locators)


def tongs(scene, clamps: Sequence[int]) -> list[tuple[int, ...]]:
    """Clamps in the order of the file, neighbours that push two parts together as one pair of tongs.

    They do so if they act on different parts, in opposite directions, at points no farther apart than their pads.
    """
    groups: list[tuple[int, ...]] = []
    for i in clamps:
        if groups and len(groups[-1]) == 1 and _facing(scene.clamps[groups[-1][0]], scene.clamps[i]):
            groups[-1] += (i,)
        else:
            groups.append((i,))
    return groups


def _facing(a, b) -> bool:
    distance = np.linalg.norm(np.subtract(a.point, b.point))
    return bool(a.part != b.part and np.dot(a.direction, b.direction) < MAX_COSINE and distance <= a.radius + b.radius)


def _weld(scene, stage, before) -> list[Move]:
    """All welds together; one after the other in a `sequence`, or in the groups of `order`.

    The guns of a group press together before its welds are made, and open afterwards.
    """
    welds = _in_stage(scene.welds, stage)
    if stage.order is not None:
        groups = [_numbers_of(scene.welds, welds, names) for names in stage.order]
    else:
        groups = [(i,) for i in welds] if stage.sequence else [welds]
    moves: list[Move] = []
    for group in groups:
        guns = tuple(i for i in group if scene.welds[i].gun is not None)
        join = Join(welds=group, gap=tuple(i for i in group if scene.welds[i].close))
        moves += [(Close(guns=guns),), (join, Open(guns=guns))] if guns else [(join,)]
    return moves


def _release(scene, stage, before) -> list[Move]:
    """Open everything but `keep` (default: all locators) in reverse order of closing, or in the groups of `order`."""
    fixture = Fixture().after(chain.from_iterable(before))
    keep = {locator.name for locator in scene.locators} if stage.keep is None else set(stage.keep)
    groups = [_closed(move) for move in reversed(before)]
    if stage.order is not None:
        groups = [_named(scene, names) for names in stage.order]
    kept_locators, kept_clamps = _named(scene, keep)
    moves: list[Move] = []
    for locators, clamps in groups:
        opened = Open(
            tuple(i for i in locators if i in fixture.locators and i not in kept_locators),
            *(
                tuple(i for i in clamps if i in held and i not in kept_clamps)
                for held in (fixture.strokes, fixture.forces, fixture.limited)
            ),
        )
        moves += [(opened,)] if opened.locators or opened.clamps else []
    return moves


def _closed(move: Move) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Locators and clamps that a move closed."""
    locators = tuple(i for action in move if isinstance(action, Close | Placement) for i in action.locators)
    return locators, tuple(i for action in move if isinstance(action, Close) for i in action.clamps)


def _named(scene, names) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Locators and clamps with these names."""
    return _numbers_of(scene.locators, None, names), _numbers_of(scene.clamps, None, names)


def _numbers_of(items, allowed, names) -> tuple[int, ...]:
    """Numbers of the items with these names, among those allowed.

    :mod:`mic.scene.stages` has checked that every name exists.
    """
    return tuple(i for i, item in enumerate(items) if item.name in names and (allowed is None or i in allowed))


def stage_moves(scene) -> Iterator[tuple[Any, list[Move]]]:
    """The stages of a scene, each with its moves."""
    before: list[Move] = []
    for stage in scene.stages:
        moves = [tuple(move) for move in STAGE_MOVES[stage.kind](scene, stage, before)]
        before += moves
        yield stage, moves


def together(moves: Sequence[Move]) -> list[Move]:
    """All moves merged into one."""
    return [tuple(chain.from_iterable(moves))]


def _measure(scene, stage, before) -> list[Move]:
    """Read the measurements, on the locators that name the stage if there are any."""
    own = _in_stage(scene.locators, stage)
    return [(_transfer(scene, stage, own), Read()) if own else (Read(),)]


#: Kind of stage, as :class:`mic.scene.process.Stage` names it → ``moves(scene, stage, before)``, given the moves of all
#: stages before.
STAGE_MOVES: dict[str, Callable[..., Sequence[Move]]] = {
    moves.__name__.removeprefix("_"): moves for moves in (_locate, _clamp, _weld, _release, _measure)
}
