"""Actions of a stage: how each changes the rows that hold and push the assembly.

An action changes a :class:`Fixture`, the set of rows that hold and push; nothing is solved here. A stage of the scene
stands for a list of moves (:data:`STAGE_MOVES`), each of them actions that happen together. The production solver and
the full finite-element reference both follow this list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np

from mic.model.rows import NORMAL
from mic.scene.stages import moves_assembly, placing_stages

__all__ = [
    "STAGE_MOVES",
    "Action",
    "AddParts",
    "Close",
    "Fixture",
    "Hold",
    "Joints",
    "Move",
    "MoveAssembly",
    "Open",
    "PlaceParts",
    "Placement",
    "Press",
    "Push",
    "Read",
    "ResolveOverlap",
    "Retract",
    "Withdraw",
    "stage_moves",
    "together",
    "tongs",
]

MAX_COSINE = -0.9  # of the angle between the directions of two clamps that push against each other

Row = tuple[str, int]  #: a row by its kind and its number


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


class Action(Protocol):
    """One action of a stage."""

    def apply(self, fixture: Fixture) -> Fixture:
        """The fixture afterwards."""
        ...


class _Adds:
    """An action that adds its rows to those of the same name in the fixture."""

    def apply(self, fixture):
        return replace(fixture, **{f.name: getattr(fixture, f.name) + getattr(self, f.name) for f in fields(self)})


class _Removes:
    """An action that removes its rows from those of the same name in the fixture."""

    def apply(self, fixture):
        return replace(
            fixture, **{f.name: _without(getattr(fixture, f.name), getattr(self, f.name)) for f in fields(self)}
        )


def _without(numbers: tuple[int, ...], removed: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(i for i in numbers if i not in removed)


@dataclass(frozen=True)
class Placement:
    """Place parts, or the assembly, on locators; they touch nothing yet."""

    locators: tuple[int, ...]
    weights: tuple[int, ...] = ()

    def apply(self, fixture):
        return replace(
            fixture,
            locators=fixture.locators + self.locators,
            forces=fixture.forces + self.weights,
            waiting=_without(fixture.waiting, self.locators),
        )


class PlaceParts(Placement):
    """Place the first parts on locators, one by one; overlaps are resolved later."""


class AddParts(Placement):
    """Place further parts beside the others, which stay as they are."""


class MoveAssembly(Placement):
    """Open all locators and clamps, and place the assembly on other locators; parts that wait for these join it.

    The assembly moves as it is, with its contacts active; it does not touch the new station yet.
    """

    def apply(self, fixture):
        waiting = _without(fixture.waiting, self.locators)
        return Fixture(locators=self.locators, forces=self.weights, welds=fixture.welds, waiting=waiting)


@dataclass(frozen=True)
class Hold(_Adds):
    """Close locators and clamps that hold a position: their rows move to their targets and stay there."""

    locators: tuple[int, ...] = ()
    strokes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Push(_Adds):
    """Close clamps that push with a force."""

    forces: tuple[int, ...]


@dataclass(frozen=True)
class Press(_Adds):
    """Close clamps that push towards a position with a limited force, and guns, which press sheets until they touch."""

    limited: tuple[int, ...] = ()
    guns: tuple[int, ...] = ()


@dataclass(frozen=True)
class Retract(_Removes):
    """Open guns: the welds made under them take over their forces."""

    guns: tuple[int, ...]


@dataclass(frozen=True)
class Close:
    """Make welds: each freezes the current relative position of its sheets; those in `gap` close their gap first.

    Attributes
    ----------
    welds, gap : tuple of int
    """

    welds: tuple[int, ...]
    gap: tuple[int, ...] = ()

    def apply(self, fixture):
        return replace(fixture, welds=fixture.welds + self.welds)


@dataclass(frozen=True)
class Withdraw(_Removes):
    """Open clamps."""

    strokes: tuple[int, ...] = ()
    forces: tuple[int, ...] = ()
    limited: tuple[int, ...] = ()

    @property
    def clamps(self) -> tuple[int, ...]:
        """All of them."""
        return self.strokes + self.forces + self.limited


@dataclass(frozen=True)
class Open(_Removes):
    """Open locators."""

    locators: tuple[int, ...]


@dataclass(frozen=True)
class ResolveOverlap:
    """Separate parts that overlap where they were placed, along the contact normals.

    It happens before the first thing closes, or together with it.
    """

    def apply(self, fixture):
        return fixture


@dataclass(frozen=True)
class Read:
    """Read the measurements."""

    def apply(self, fixture):
        return fixture


@dataclass(frozen=True)
class Joints:
    """The rows of each weld.

    Attributes
    ----------
    size : tuple of int
        Rows of each weld: the means along n, t1, t2; then rotations about these, or moments along them, first those
        over t1 and then those over t2.
    """

    size: tuple[int, ...]

    @property
    def first(self) -> np.ndarray:
        """(w,) first row of each weld."""
        return np.concatenate([[0], np.cumsum(self.size)]).astype(int)[:-1]

    def rows(self, weld: int) -> list[Row]:
        """All rows of a weld."""
        start = int(self.first[weld])
        return [("weld", row) for row in range(start, start + self.size[weld])]

    def normal(self, weld: int) -> list[int]:
        """The rows of a weld along its normal: the mean gap of its sheets, and how the gap tilts."""
        return [int(self.first[weld]) + row for row in NORMAL[self.size[weld]]]

    @property
    def normals(self) -> np.ndarray:
        """(k,) the normal rows of all welds."""
        return np.array([row for weld in range(len(self.size)) for row in self.normal(weld)], dtype=int)


Move = tuple[Action, ...]  #: actions that happen together, contact active throughout


def _in_stage(items, stage) -> tuple[int, ...]:
    return tuple(i for i, item in enumerate(items) if item.stage == stage.name)


def _locate(scene, stage, before) -> list[Move]:
    """The first stage places parts; a later one adds parts, or moves the assembly to another station."""
    own = _in_stage(scene.locators, stage)
    if not before:
        return [(PlaceParts(own, _weights(scene, stage.name, [stage.name])),)]
    if moves_assembly(scene, stage):
        return [(_transfer(scene, stage, own),)]
    stations = [one.name for one in _stages_up_to(scene, stage) if one is scene.stages[0] or moves_assembly(scene, one)]
    return [(AddParts(own, _weights(scene, stations[-1], [stage.name])),)]


def _stages_up_to(scene, stage) -> list[Any]:
    """The stages up to and including this one."""
    return scene.stages[: 1 + next(i for i, one in enumerate(scene.stages) if one is stage)]


def _transfer(scene, stage, locators) -> MoveAssembly:
    return MoveAssembly(locators, _weights(scene, stage.name, [one.name for one in _stages_up_to(scene, stage)]))


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
        moves = [(Hold(locators),)] if locators else []
        return moves + [_close(scene, group) for group in tongs(scene, clamps)]
    return [
        _close(scene, _numbers_of(scene.clamps, clamps, names), _numbers_of(scene.locators, locators, names))
        for names in stage.order
    ]


def _close(scene, clamps, locators=()) -> Move:
    pushing = tuple(i for i in clamps if scene.clamps[i].force is not None)
    limited = tuple(i for i in clamps if scene.clamps[i].limit is not None)
    holding = tuple(i for i in clamps if i not in pushing and i not in limited)
    return (
        (Hold(locators, holding),) * bool(locators or holding)
        + (Push(pushing),) * bool(pushing)
        + (Press(limited),) * bool(limited)
    )


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
        close = Close(group, tuple(i for i in group if scene.welds[i].close))
        moves += [(Press(guns=guns),), (close, Retract(guns))] if guns else [(close,)]
    return moves


def _release(scene, stage, before) -> list[Move]:
    """Open everything but `keep` (default: all locators) in reverse order of closing, or in the groups of `order`."""
    fixture = Fixture()
    for move in before:
        for action in move:
            fixture = action.apply(fixture)
    keep = {locator.name for locator in scene.locators} if stage.keep is None else set(stage.keep)
    kept_clamps, kept_locators = _numbers_of(scene.clamps, None, keep), _numbers_of(scene.locators, None, keep)
    if stage.order is not None:
        groups = [
            (_numbers_of(scene.clamps, None, names), _numbers_of(scene.locators, None, names)) for names in stage.order
        ]
    else:
        groups = [_closed(move) for move in reversed(before)]
    moves = []
    for clamps, locators in groups:
        withdrawn = Withdraw(
            *(
                tuple(i for i in clamps if i in held and i not in kept_clamps)
                for held in (fixture.strokes, fixture.forces, fixture.limited)
            )
        )
        opened = tuple(i for i in locators if i in fixture.locators and i not in kept_locators)
        move = (withdrawn,) * bool(withdrawn.clamps) + (Open(opened),) * bool(opened)
        moves += [move] if move else []
    return moves


def _closed(move: Move) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Clamps and locators that a move closed."""
    clamps: tuple[int, ...] = ()
    locators: tuple[int, ...] = ()
    for action in move:
        if isinstance(action, Hold):
            clamps, locators = clamps + action.strokes, locators + action.locators
        elif isinstance(action, Push):
            clamps += action.forces
        elif isinstance(action, Press):
            clamps += action.limited
        elif isinstance(action, Placement):
            locators += action.locators
    return clamps, locators


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
    return [tuple(action for move in moves for action in move)]


def _measure(scene, stage, before) -> list[Move]:
    """Read the measurements, on the locators that name the stage if there are any."""
    own = _in_stage(scene.locators, stage)
    return [(_transfer(scene, stage, own), Read()) if own else (Read(),)]


#: Kind of stage, as :class:`mic.scene.process.Stage` names it → ``moves(scene, stage, before)``, given the moves of all
#: stages before.
STAGE_MOVES: dict[str, Callable[..., Sequence[Move]]] = {
    moves.__name__.removeprefix("_"): moves for moves in (_locate, _clamp, _weld, _release, _measure)
}
