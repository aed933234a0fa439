"""Named settings: defaults of accuracy."""

from __future__ import annotations

from typing import Any

from mic.contact.path import Followed

__all__ = ["SETTINGS", "fill_in"]

#: Element size, tolerance of the friction path, spacing of contact candidates and samples where the scene gives none.
#: `verification/trade` measures their cost and error. The path may use half of the error of a setting: 5, 2 and 1 % of
#: a 6σ, for the slip with the largest error. The tolerance of the contact solver is not included: it costs nothing.
SETTINGS: dict[str, dict[str, Any]] = {
    "draft": {"size": "coarse", "tolerance": 10 * Followed.tolerance, "spacing_factor": 0.7, "samples": 100},
    "standard": {"size": "fine", "tolerance": 4 * Followed.tolerance, "spacing_factor": 0.85, "samples": 500},
    "reference": {"size": "fine", "tolerance": Followed.tolerance, "spacing_factor": 0.7, "samples": 2000},
}
FOLLOWING = ("clamp", "weld", "release")  # kinds of stages that a path can be given for


def fill_in(table: dict[str, Any]) -> dict[str, Any]:
    """A scene's table with the defaults of its setting; malformed tables are left to the schema."""
    name = table.get("setting")
    setting = SETTINGS.get(name) if isinstance(name, str) else None
    if setting is None:
        return table

    def filled(item, key, rivals=(), applies=True):
        given = not isinstance(item, dict) or any(name in item for name in (key, *rivals))  # None counts as given
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
