"""Named settings: how far accuracy goes where a scene leaves it open."""

from __future__ import annotations

from typing import Any

from mic.contact.path import Followed

__all__ = ["SETTINGS", "fill_in"]

#: What a named setting gives wherever the scene leaves it open: the geometry's named element size, the tolerance of the
#: path of friction, how far apart candidates stand, samples. What each costs, and how far off it is,
#: `verification/trade` measures. A stated number of pairs is off by more than any of these. So is one
#: increment for each step of the process. What the path leaves may take half of what a setting is to keep, 5, 2 and 1 %
#: of a 6σ, of the slip that it errs most in. The tolerance of the contact solver is not among them: the tightest costs
#: no more than the loosest.
SETTINGS: dict[str, dict[str, Any]] = {
    "draft": {"size": "coarse", "tolerance": 10 * Followed.tolerance, "spacing_factor": 0.7, "samples": 100},
    "standard": {"size": "fine", "tolerance": 4 * Followed.tolerance, "spacing_factor": 0.85, "samples": 500},
    "reference": {"size": "fine", "tolerance": Followed.tolerance, "spacing_factor": 0.7, "samples": 2000},
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
        return item if given or not applies else item | {key: setting[key]}

    def each(key, fill):
        return {key: [fill(item) for item in table[key]]} if isinstance(table.get(key), list) else {}

    def generated(part):
        return isinstance(part, dict) and part.get("geometry") is not None

    return (
        table
        | each("parts", lambda part: filled(part, "size", ("accuracy",), applies=generated(part)))
        | each("zones", lambda zone: filled(zone, "spacing_factor", ("spacing", "pairs", "points")))
        | {"path": filled(table.get("path", {}), "tolerance")}
        | {"monte_carlo": filled(table.get("monte_carlo", {}), "samples", ("table", "values"))}
    )
