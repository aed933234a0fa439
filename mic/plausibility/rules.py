"""The rules of plausibility, read from ``rules.toml``, and the warnings that they give."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.plausibility import meshes, results, scene_file
from mic.plausibility.finding import Finding, Point, label

__all__ = ["FILE", "MESHES", "PARTS", "RESULTS", "SOURCES", "Rule", "SceneWarning", "apply_rules"]


@dataclass(frozen=True)
class SceneWarning:
    """One warning.

    Attributes
    ----------
    rule : str
        Name of the rule.
    item : str
        Item of the scene, such as ``clamp C1``.
    text : str
        The finding, the usual range, its reason and the remedy.
    point : tuple of float or None
        Location, mm.
    impossible : bool
        Whether no assembly has such a value: most likely its unit is wrong.
    """

    rule: str
    item: str
    text: str
    point: Point | None = None
    impossible: bool = False

    def __str__(self) -> str:
        return f"{self.item}: {self.text}"


@dataclass(frozen=True)
class Rule:
    """One rule.

    Attributes
    ----------
    name : str
    usual : str
        The usual range, in words.
    reason : str
        Why this range is usual.
    remedy : str
        What to do about an item outside it.
    find : callable
        Findings outside the range in a scene, in parts or in an assembly.
    """

    name: str
    usual: str
    reason: str
    remedy: str
    find: Callable[[Any], Iterable[Finding]]


def _number_rule(
    key: str,
    low: float,
    high: float,
    reason: str,
    remedy: str,
    unit: str = "",
    also: Iterable[float] = (),
    least: float = -np.inf,
    most: float = np.inf,
) -> Rule:
    """A rule for one number of every item of a table: from `low` to `high`, or one of `also`.

    `key` is ``table.key`` or ``section.key``. The values of a dict are checked one by one. Values below `least` or
    above `most` are impossible.
    """
    table, name = key.split(".")
    suffix = unit and " " + unit

    def find(scene) -> Iterator[Finding]:
        rows = getattr(scene, table)
        for item in rows if isinstance(rows, list) else [rows]:
            given = getattr(item, name, None)
            for part, value in given.items() if isinstance(given, dict) else [("", given)]:
                if isinstance(value, (int, float)) and not low <= value <= high and value not in also:
                    finding = f"{name}{part and '.' + part} = {value:g}{suffix}"
                    owner = label(table, item) if isinstance(rows, list) else table
                    yield owner, finding, getattr(item, "point", None), not least <= value <= most

    usual = f"{low:g} to {high:g}{suffix}" + "".join(f", or {value:g}" for value in also)
    return Rule(key, usual, reason, remedy, find)


def _rule(module: Any, name: str, usual: str, reason: str, remedy: str) -> Rule:
    """A rule whose findings come from the function of a module with the rule's name."""
    return Rule(name, usual.format_map(vars(module)), reason, remedy, getattr(module, name.replace("-", "_")))


_TABLES = tomllib.loads(Path(__file__).with_name("rules.toml").read_text(encoding="utf-8"))

#: Rules that need the scene file alone.
FILE = (
    *(_number_rule(**row) for row in _TABLES["number"]),
    *(_rule(scene_file, **row) for row in _TABLES["scene"]),
)
#: Rules that need pairs of a part, with name and thickness, and its surface.
PARTS = tuple(_rule(meshes, **row) for row in _TABLES["parts"])
#: Rules that need the assembly with its contact pairs.
MESHES = tuple(_rule(meshes, **row) for row in _TABLES["assembly"])
#: Rules that need the displacements of free parts by the sources.
SOURCES = tuple(_rule(results, **row) for row in _TABLES["sources"])
#: Rules that need solved samples.
RESULTS = tuple(_rule(results, **row) for row in _TABLES["results"])


def apply_rules(rules: Iterable[Rule], subject: Any) -> list[SceneWarning]:
    """The warnings of rules for a scene, for parts or for an assembly."""
    return [
        SceneWarning(rule.name, item, f"{text}; usual is {rule.usual} ({rule.reason}): {rule.remedy}", *further)
        for rule in rules
        for item, text, *further in rule.find(subject)
    ]
