"""Named settings: how far accuracy goes where a scene leaves it open."""

from __future__ import annotations

from typing import Any

from mic.contact.path import Followed

__all__ = ["SETTINGS", "fill_in"]

USUAL = Followed.tolerance

#: What a named setting gives wherever the scene leaves it open: the geometry's named element size, contact pairs per
#: zone, how friction's path is followed (increments for each step of the process, or the tolerance of a path that
#: is followed), samples. What each costs, and how far off it is, `verification/trade` measures. The tolerance of
#: the contact solver is not among them: the tightest costs no more than the loosest.
SETTINGS: dict[str, dict[str, Any]] = {
    "draft": {"size": "coarse", "pairs": 17, "increments": 1, "tolerance": None, "samples": 100},
    "standard": {"size": "medium", "pairs": 34, "increments": None, "tolerance": USUAL, "samples": 500},
    "reference": {"size": "fine", "pairs": 68, "increments": None, "tolerance": USUAL / 10, "samples": 2000},
}
FOLLOWING = ("clamp", "weld", "release")  # kinds of stages that a path can be given for


def fill_in(table: dict[str, Any]) -> dict[str, Any]:
    """A scene's table with what its setting gives, where it leaves it open; malformed tables are left to the schema."""
    name = table.get("setting")
    setting = SETTINGS.get(name) if isinstance(name, str) else None
    if setting is None:
        return table

    def filled(item, key, rivals=(), applies=True):
        given = not isinstance(item, dict) or any(name in item for name in (key, *rivals))  # null is an answer, too
        return item if given or not applies or setting[key] is None else item | {key: setting[key]}

    def each(key, fill):
        return {key: [fill(item) for item in table[key]]} if isinstance(table.get(key), list) else {}

    def generated(part):
        return isinstance(part, dict) and part.get("geometry") is not None

    def follows(stage):
        return isinstance(stage, dict) and stage.get("kind") in FOLLOWING

    return (
        table
        | each("parts", lambda part: filled(part, "size", ("accuracy",), applies=generated(part)))
        | each("zones", lambda zone: filled(zone, "pairs", ("spacing", "points")))
        | each("stages", lambda stage: filled(stage, "increments", ("path",), follows(stage)))
        | {"path": filled(table.get("path", {}), "tolerance")}
        | {"monte_carlo": filled(table.get("monte_carlo", {}), "samples", ("table", "values"))}
    )
