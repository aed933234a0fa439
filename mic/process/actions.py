"""What a stage does: a list of actions on what holds the assembly.

An action changes a :class:`Fixture`, the set of rows that hold and push; nothing is solved here. A stage of the scene
is sugar for a list of actions (:data:`SUGAR`); the production solve and the full finite-element reference both follow
it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

__all__ = ["SUGAR", "Action", "Close", "Fixture", "Hold", "Joints", "Open", "Push", "Read", "SetDown", "Withdraw"]

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
        Clamp rows that push with a force.
    welds : tuple of int
        Welds made.
    """

    locators: tuple[int, ...] = ()
    strokes: tuple[int, ...] = ()
    forces: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()


class Action(Protocol):
    """One step of a stage."""

    def apply(self, fixture: Fixture) -> Fixture:
        """The fixture afterwards."""
        ...


@dataclass(frozen=True)
class SetDown:
    """Set the parts down on locators, one by one: whatever overlaps then is resolved once something closes."""

    locators: tuple[int, ...]

    def apply(self, fixture):
        return replace(fixture, locators=fixture.locators + self.locators)


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
    """Open all clamps."""

    def apply(self, fixture):
        return replace(fixture, strokes=(), forces=())


@dataclass(frozen=True)
class Open:
    """Open every locator but those that are kept."""

    keep: tuple[int, ...]

    def apply(self, fixture):
        return replace(fixture, locators=tuple(i for i in fixture.locators if i in self.keep))


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
        Rows of each weld; the first is normal to the sheets.
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


def _of_stage(items, stage) -> tuple[int, ...]:
    return tuple(i for i, item in enumerate(items) if item.stage == stage.name)


def _named(items, names) -> tuple[int, ...]:
    """Numbers of the items of these names, each of which `mic.scene.checks` has seen to exist."""
    number = {item.name: i for i, item in enumerate(items)}
    return tuple(sorted(number[name] for name in names))


def _locate(scene, stage) -> list[Action]:
    return [SetDown(_of_stage(scene.locators, stage))]


def _clamp(scene, stage) -> list[Action]:
    named = _of_stage(scene.clamps, stage)
    pushing = tuple(i for i in named if scene.clamps[i].force is not None)
    holding = tuple(i for i in named if scene.clamps[i].force is None)
    return [Hold(_of_stage(scene.locators, stage), holding), Push(pushing)]


def _weld(scene, stage) -> list[Action]:
    named = _of_stage(scene.welds, stage)
    return [Close(named, tuple(i for i in named if scene.welds[i].close))]


def _release(scene, stage) -> list[Action]:
    everything = [locator.name for locator in scene.locators]
    return [Withdraw(), Open(_named(scene.locators, everything if stage.keep is None else stage.keep))]


def _measure(scene, stage) -> list[Action]:
    return [Read()]


#: Kind of a scene's stage → ``actions(scene, stage)``.
SUGAR: dict[str, Callable[..., Sequence[Action]]] = {
    "locate": _locate,
    "clamp": _clamp,
    "weld": _weld,
    "release": _release,
    "measure": _measure,
}
