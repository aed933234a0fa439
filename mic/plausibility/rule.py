"""What a rule of judgement is, and the warning that it gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

__all__ = ["Place", "Rule", "Seen", "Warned", "number", "of"]

Place = tuple[float, float, float]
Seen = tuple[str, str, Place | None]  #: the item, what is seen of it, and where, mm, if anywhere


@dataclass(frozen=True)
class Warned:
    """One warning.

    Attributes
    ----------
    rule : str
        Name of the rule that gives it.
    item : str
        Of the scene, such as ``clamp C1``.
    text : str
        What is seen, what is usual and why, and the remedy.
    point : tuple of float or None
        Where, mm.
    """

    rule: str
    item: str
    text: str
    point: Place | None = None

    def __str__(self) -> str:
        return f"{self.item}: {self.text}"


@dataclass(frozen=True)
class Rule:
    """One rule.

    Attributes
    ----------
    name : str
        Tells it from the others.
    usual : str
        What is usual, in words, with the range.
    because : str
        The reason of the range.
    remedy : str
        What to do about an item outside.
    look : callable
        What is seen outside the range: of a scene, or of an assembly.
    """

    name: str
    usual: str
    because: str
    remedy: str
    look: Callable[[Any], Iterable[Seen]]

    def judge(self, subject: Any) -> Iterator[Warned]:
        """The warnings that a scene, or an assembly, gives."""
        for item, seen, point in self.look(subject):
            yield Warned(self.name, item, f"{seen}; usual is {self.usual} ({self.because}): {self.remedy}", point)


def number(where: str, low: float, high: float, unit: str, because: str, remedy: str, *also: float) -> Rule:
    """A rule of one number of every item of a table: it lies from `low` to `high`, or is one of `also`.

    Parameters
    ----------
    where : str
        Table and key, such as ``parts.thickness``; or section and key. A dict of numbers counts one by one.
    """
    table, key = where.split(".")

    def look(scene) -> Iterator[Seen]:
        rows = getattr(scene, table)
        for item in rows if isinstance(rows, list) else [rows]:
            given = getattr(item, key, None)
            for name, value in given.items() if isinstance(given, dict) else [("", given)]:
                if isinstance(value, (int, float)) and not low <= value <= high and value not in also:
                    said = f"{key}{name and '.' + name} = {value:g}{unit and ' ' + unit}"
                    yield of(table, item) if isinstance(rows, list) else table, said, getattr(item, "point", None)

    usual = f"{low:g} to {high:g}{unit and ' ' + unit}" + "".join(f", or {value:g}" for value in also)
    return Rule(where, usual, because, remedy, look)


def of(table: str, item: Any) -> str:
    """An item in words: ``clamp C1``."""
    return f"{table.removesuffix('s')} {item.name}"
