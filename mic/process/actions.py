"""What a stage does: a list of actions on what holds the assembly.

An action changes a :class:`Fixture`, the set of rows that hold and push; nothing is solved here. A stage of the scene
is sugar for a list of moves (:data:`SUGAR`), each of them actions that happen together; the production solve and the
full finite-element reference both follow it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from mic.model.rows import NORMAL
from mic.scene.stages import moves_assembly, set_down_in

__all__ = [
    "SUGAR",
    "Action",
    "Arrive",
    "Close",
    "Fixture",
    "Hold",
    "Joints",
    "Move",
    "Open",
    "Press",
    "Push",
    "Read",
    "Retract",
    "SetDown",
    "Settle",
    "Transfer",
    "Withdraw",
    "moves_of",
    "together",
    "tongs",
]

OPPOSITE = -0.9  # cosine of the angle between two clamps below which they push against each other

Row = tuple[str, int]  #: a row by its kind and its number


@dataclass(frozen=True)
class Fixture:
    """What holds and pushes the assembly.

    Attributes
    ----------
    locators : tuple of int
        Locator rows that hold.
    strokes : tuple of int
        Clamp rows that hold a position.
    forces : tuple of int
        Clamp rows that push with a force; the weights of the parts that are there among them.
    limited : tuple of int
        Clamp rows that push towards a position, with a limited force.
    guns : tuple of int
        Welds whose gun presses.
    welds : tuple of int
        Welds made.
    waiting : tuple of int
        Locator rows that hold parts which later stages set down: where they will stand, touching nothing.
    """

    locators: tuple[int, ...] = ()
    strokes: tuple[int, ...] = ()
    forces: tuple[int, ...] = ()
    limited: tuple[int, ...] = ()
    guns: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()
    waiting: tuple[int, ...] = ()


class Action(Protocol):
    """One step of a stage."""

    def apply(self, fixture: Fixture) -> Fixture:
        """The fixture afterwards."""
        ...


@dataclass(frozen=True)
class SetDown:
    """Set the parts down on locators, one by one: they touch nothing yet, and whatever overlaps then settles later."""

    locators: tuple[int, ...]
    weights: tuple[int, ...] = ()

    def apply(self, fixture):
        return replace(fixture, locators=fixture.locators + self.locators, forces=fixture.forces + self.weights)


@dataclass(frozen=True)
class Arrive:
    """Set down parts that were waiting, beside the others, which stay as they are; they touch nothing yet."""

    locators: tuple[int, ...]
    weights: tuple[int, ...] = ()

    def apply(self, fixture):
        waiting = tuple(i for i in fixture.waiting if i not in self.locators)
        forces = fixture.forces + self.weights
        return replace(fixture, locators=fixture.locators + self.locators, forces=forces, waiting=waiting)


@dataclass(frozen=True)
class Transfer:
    """Open all that holds the assembly, and set it down on other locators; parts that wait for these join it.

    The assembly moves as it is, its contacts active; it touches nothing of the new station yet.
    """

    locators: tuple[int, ...]
    weights: tuple[int, ...] = ()

    def apply(self, fixture):
        waiting = tuple(i for i in fixture.waiting if i not in self.locators)
        return Fixture(locators=self.locators, forces=self.weights, welds=fixture.welds, waiting=waiting)


@dataclass(frozen=True)
class Hold:
    """Close locators and clamps that hold a position: their rows move to their targets and stay there."""

    locators: tuple[int, ...] = ()
    strokes: tuple[int, ...] = ()

    def apply(self, fixture):
        return replace(fixture, locators=fixture.locators + self.locators, strokes=fixture.strokes + self.strokes)


@dataclass(frozen=True)
class Push:
    """Close clamps that push with a force."""

    forces: tuple[int, ...]

    def apply(self, fixture):
        return replace(fixture, forces=fixture.forces + self.forces)


@dataclass(frozen=True)
class Press:
    """Close clamps that push towards a position with a limited force, and guns, which press sheets until they touch."""

    limited: tuple[int, ...] = ()
    guns: tuple[int, ...] = ()

    def apply(self, fixture):
        return replace(fixture, limited=fixture.limited + self.limited, guns=fixture.guns + self.guns)


@dataclass(frozen=True)
class Retract:
    """Open guns: the welds made under them take over what they carried."""

    guns: tuple[int, ...]

    def apply(self, fixture):
        return replace(fixture, guns=tuple(i for i in fixture.guns if i not in self.guns))


@dataclass(frozen=True)
class Close:
    """Make welds: each freezes the relative position that it finds, or closes its gap first where `gap` names it.

    Attributes
    ----------
    welds, gap : tuple of int
    """

    welds: tuple[int, ...]
    gap: tuple[int, ...] = ()

    def apply(self, fixture):
        return replace(fixture, welds=fixture.welds + self.welds)


@dataclass(frozen=True)
class Withdraw:
    """Open clamps."""

    strokes: tuple[int, ...] = ()
    forces: tuple[int, ...] = ()
    limited: tuple[int, ...] = ()

    @property
    def clamps(self) -> tuple[int, ...]:
        """All of them."""
        return self.strokes + self.forces + self.limited

    def apply(self, fixture):
        return replace(
            fixture,
            strokes=tuple(i for i in fixture.strokes if i not in self.strokes),
            forces=tuple(i for i in fixture.forces if i not in self.forces),
            limited=tuple(i for i in fixture.limited if i not in self.limited),
        )


@dataclass(frozen=True)
class Open:
    """Open locators."""

    locators: tuple[int, ...]

    def apply(self, fixture):
        return replace(fixture, locators=tuple(i for i in fixture.locators if i not in self.locators))


@dataclass(frozen=True)
class Settle:
    """Parts that overlap where they were set down come to rest on each other, along the contact normals.

    It comes before whatever closes first, or with it.
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
    """Which rows the welds have.

    Attributes
    ----------
    size : tuple of int
        Rows of each weld: the means along n, t1, t2; behind them rotations about these, or moments along them, first
        those over t1 and then those over t2.
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
        """The rows of a weld that tell how far its sheets stand apart: the mean along n, and how that tilts."""
        return [int(self.first[weld]) + row for row in NORMAL[self.size[weld]]]

    @property
    def normals(self) -> np.ndarray:
        """(k,) those of all welds."""
        return np.array([row for weld in range(len(self.size)) for row in self.normal(weld)], dtype=int)


Move = tuple[Action, ...]  #: actions that happen together, contact active throughout


def _of_stage(items, stage) -> tuple[int, ...]:
    return tuple(i for i, item in enumerate(items) if item.stage == stage.name)


def _locate(scene, stage, before) -> list[Move]:
    """The first sets the parts down; a later one sets further ones down, or is another station."""
    own = _of_stage(scene.locators, stage)
    if not before:
        return [(SetDown(own, _weights(scene, stage.name, [stage.name])),)]
    if moves_assembly(scene, stage):
        return [(_transfer(scene, stage, own),)]
    stations = [one.name for one in _before(scene, stage) if one is scene.stages[0] or moves_assembly(scene, one)]
    return [(Arrive(own, _weights(scene, stations[-1], [stage.name])),)]


def _before(scene, stage) -> list[Any]:
    """The stages up to one, it among them."""
    return scene.stages[: 1 + next(i for i, one in enumerate(scene.stages) if one is stage)]


def _transfer(scene, stage, locators) -> Transfer:
    return Transfer(locators, _weights(scene, stage.name, [one.name for one in _before(scene, stage)]))


def _weights(scene, station: str, stages: Sequence[str]) -> tuple[int, ...]:
    """Rows of the weights, in a station, of the parts that these stages set down.

    They lie behind the clamps' rows, those of each deviation of kind gravity together.
    """
    there, first = set_down_in(scene), scene.stages[0].name
    gravity = [item for item in scene.deviations if item.kind == "gravity"]
    return tuple(
        len(scene.clamps) + g * len(scene.parts) + p
        for g, item in enumerate(gravity)
        for p, part in enumerate(scene.parts)
        if (item.stage or first) == station and there[part.name] in stages
    )


def _clamp(scene, stage, before) -> list[Move]:
    """Further locators together, then clamp after clamp as the file has them; or the groups of `order`."""
    locators, clamps = _of_stage(scene.locators, stage), _of_stage(scene.clamps, stage)
    if stage.order is None:
        moves = [(Hold(locators),)] if locators else []
        return moves + [_close(scene, group) for group in tongs(scene, clamps)]
    return [
        _close(scene, _among(scene.clamps, clamps, names), _among(scene.locators, locators, names))
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
    """Clamps in the order of the file; neighbours there that push two parts together are one pair of tongs.

    They do where they act on different parts, in opposite directions, at points no farther apart than their pads.
    """
    groups: list[tuple[int, ...]] = []
    for i in clamps:
        if groups and len(groups[-1]) == 1 and _facing(scene.clamps[groups[-1][0]], scene.clamps[i]):
            groups[-1] += (i,)
        else:
            groups.append((i,))
    return groups


def _facing(a, b) -> bool:
    apart = np.linalg.norm(np.subtract(a.point, b.point))
    return bool(a.part != b.part and np.dot(a.direction, b.direction) < OPPOSITE and apart <= a.radius + b.radius)


def _weld(scene, stage, before) -> list[Move]:
    """All welds together; one after the other in a `sequence`, or in the groups of `order`.

    The guns of a group press together before its welds are made, and open once they are.
    """
    welds = _of_stage(scene.welds, stage)
    if stage.order is not None:
        groups = [_among(scene.welds, welds, names) for names in stage.order]
    else:
        groups = [(i,) for i in welds] if stage.sequence else [welds]
    moves: list[Move] = []
    for group in groups:
        guns = tuple(i for i in group if scene.welds[i].gun is not None)
        made = Close(group, tuple(i for i in group if scene.welds[i].close))
        moves += [(Press(guns=guns),), (made, Retract(guns))] if guns else [(made,)]
    return moves


def _release(scene, stage, before) -> list[Move]:
    """What closed last opens first; or the groups of `order`. What is kept stays, all locators if nothing is named."""
    fixture = Fixture()
    for move in before:
        for action in move:
            fixture = action.apply(fixture)
    keep = {locator.name for locator in scene.locators} if stage.keep is None else set(stage.keep)
    kept_clamps, kept_locators = _among(scene.clamps, None, keep), _among(scene.locators, None, keep)
    if stage.order is not None:
        groups = [(_among(scene.clamps, None, names), _among(scene.locators, None, names)) for names in stage.order]
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
        elif isinstance(action, SetDown | Arrive | Transfer):
            locators += action.locators
    return clamps, locators


def _among(items, allowed, names) -> tuple[int, ...]:
    """Numbers of the items of these names, of those allowed; `mic.scene.stages` has seen that every name exists."""
    return tuple(i for i, item in enumerate(items) if item.name in names and (allowed is None or i in allowed))


def moves_of(scene) -> Iterator[tuple[Any, list[Move]]]:
    """The stages of a scene, and the moves of each as its kind has them."""
    before: list[Move] = []
    for stage in scene.stages:
        moves = [tuple(move) for move in SUGAR[stage.kind](scene, stage, before)]
        before += moves
        yield stage, moves


def together(moves: Sequence[Move]) -> list[Move]:
    """All moves as one."""
    return [tuple(action for move in moves for action in move)]


def _measure(scene, stage, before) -> list[Move]:
    """Read, on locators of its own if any name it."""
    own = _of_stage(scene.locators, stage)
    return [(_transfer(scene, stage, own), Read()) if own else (Read(),)]


#: Kind of a scene's stage → ``moves(scene, stage, before)``, with the moves of the stages before.
SUGAR: dict[str, Callable[..., Sequence[Move]]] = {
    "locate": _locate,
    "clamp": _clamp,
    "weld": _weld,
    "release": _release,
    "measure": _measure,
}
