"""Named settings: defaults of accuracy. With ``auto`` a run chooses them, see :mod:`mic.setting_choice`."""

from __future__ import annotations

from typing import Any

from mic.contact.path import Followed
from mic.scene.process import MOVING

__all__ = ["AUTO", "SETTINGS", "TARGET", "fill_in", "with_values"]

#: Element size, tolerance of the friction path, spacing of contact candidates and samples where the scene gives none.
#: `verification/trade` measures their cost and error. The path may use half of the error of a setting: 5, 2 and 1 % of
#: a 6σ, for the slip with the largest error. The tolerance of the contact solver is not included: it costs nothing.
SETTINGS: dict[str, dict[str, Any]] = {
    "draft": {"size": "medium", "tolerance": 10 * Followed.tolerance, "spacing_factor": 1.0, "samples": 100},
    "standard": {"size": "fine", "tolerance": 4 * Followed.tolerance, "spacing_factor": 0.85, "samples": 500},
    "reference": {"size": "fine", "tolerance": Followed.tolerance, "spacing_factor": 0.7, "samples": 2000},
}
AUTO = "auto"
TARGET = 0.05  # accuracy of 6σ that `auto` requires if the scene states none
_PATH = "path"  # in `Scene.left_open`; a part or zone is there as "parts.NAME" or "zones.NAME"


def fill_in(table: dict[str, Any]) -> dict[str, Any]:
    """A scene's table with the defaults of its setting; malformed tables are left to the schema.

    With `auto` they are those of `standard` until a run chooses, an accuracy, the samples of `reference`, and the
    stiffness that suits the deviations; `left_open` names what the scene does not state.
    """
    name = table.get("setting")
    setting = SETTINGS.get("standard" if name == AUTO else name) if isinstance(name, str) else None
    if setting is None:
        return table
    if name == AUTO:
        table = {"stiffness": "auto"} | table
        setting = setting | {"samples": SETTINGS["reference"]["samples"], "accuracy": TARGET}
    left_open = []

    def filled(item, key, rivals=(), applies=True, what=""):
        given = not isinstance(item, dict) or any(name in item for name in (key, *rivals))  # None counts as given
        if given or not applies:
            return item
        if what:
            left_open.append(what if what == _PATH else f"{what}.{item.get('name')}")
        return item | {key: setting[key]}

    def each(key, *filling, applies=lambda item: True):
        items = table.get(key)
        return {key: [filled(item, *filling, applies(item), key) for item in items]} if isinstance(items, list) else {}

    def generated(part):
        return isinstance(part, dict) and part.get("geometry") is not None

    given, wanted = ("table", "values"), name == AUTO and bool(table.get("measurements") and table.get("deviations"))
    sampling = filled(table.get("monte_carlo", {}), "samples", given)
    table = (
        table
        | each("parts", "size", ("accuracy",), applies=generated)
        | each("zones", "spacing_factor", ("spacing", "pairs", "points"))
        | {"path": filled(table.get("path", {}), "tolerance", what=_PATH)}
        | {"monte_carlo": filled(sampling, "accuracy", (*given, "design"), wanted)}
    )
    return table | {"left_open": left_open} if name == AUTO else table


def with_values(scene: Any, values: dict[str, Any]) -> Any:
    """The scene with values for what it leaves open: ``size``, ``spacing_factor``, ``tolerance`` or ``increments``."""

    def each(key, change):
        items = getattr(scene, key)
        return {
            key: [item.model_copy(update=change) if f"{key}.{item.name}" in scene.left_open else item for item in items]
        }

    change: dict[str, Any] = {}
    if "size" in values:
        change |= each("parts", {"size": values["size"]})
    if "spacing_factor" in values:
        change |= each("zones", {"spacing_factor": values["spacing_factor"]})
    if _PATH in scene.left_open and "tolerance" in values:
        change["path"] = scene.path.model_copy(update={"tolerance": values["tolerance"]})
    if _PATH in scene.left_open and "increments" in values:
        steps = {"increments": values["increments"]}
        follows = lambda stage: stage.kind in MOVING and stage.path is None and stage.increments is None
        change["stages"] = [stage.model_copy(update=steps) if follows(stage) else stage for stage in scene.stages]
    return scene.model_copy(update=change)
