"""Write the changes of an optimum into the keys of its scene file."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

from mic.errors import SceneError
from mic.scene.revision import revised
from mic.studies.adjustment import Adjustment, adjustment_tables
from mic.studies.optimisation.design import Change

__all__ = ["scene_text_with_changes"]


def scene_text_with_changes(text: str, scene, changes: Sequence[Change]) -> str:
    """The text of a scene file with changes: forces, strokes, orders and points in their keys, shims as deviations.

    Parameters
    ----------
    text : str
        TOML text of the scene file.
    scene : mic.scene.Scene
        The same scene, placed on its meshes.
    changes : sequence of Change

    Raises
    ------
    SceneError
        If an item is stated in a row of another file, where it must be changed.
    """
    table = tomllib.loads(text)
    shims: dict[Adjustment, float] = {}
    for change in changes:
        if change.kind == "order":
            names = [stage.get("name", stage["kind"]) for stage in table["stages"]]
            index = names.index(change.targets[0])
            order = [_names_in_file(table, group) for group in change.after]
            text = revised(text, "stages", index, {"order": order, "sequence": None})
        elif change.kind == "place":
            key, _, name = change.targets[0].partition(".")
            text = revised(
                text, key, _index(table, key, name), {"point": list(change.after), "node": None, "set": None}
            )
        elif change.kind == "force" or change.targets[0] in {clamp.name for clamp in scene.clamps}:
            strokes = {clamp.name: clamp.stroke for clamp in scene.clamps}
            for name in _names_in_file(table, change.targets):
                force = change.kind == "force"
                value = change.after if force else strokes[name] + change.after - change.before
                key = "force" if force else "stroke"
                text = revised(text, "clamps", _index(table, "clamps", name), {key: round(value, 12)})
        else:
            difference = change.after - change.before
            adjustment = Adjustment(
                "locators." + "+".join(change.targets), "locator", change.targets, 0.0, difference, difference
            )
            shims[adjustment] = difference
    if shims:
        text = text.rstrip("\n") + "\n\n" + adjustment_tables(scene, shims)
    return text


def _names_in_file(table: dict[str, Any], names: Sequence[str]) -> list[str]:
    """Names as the file has them: for the jaws of tongs, the name of the tongs."""
    tongs = {
        f"{clamp.get('name')}-{part}": clamp.get("name")
        for clamp in table.get("clamps", [])
        for part in clamp.get("parts", ())
    }
    return list(dict.fromkeys(tongs.get(name, name) for name in names))


def _index(table: dict[str, Any], key: str, name: str) -> int:
    for i, item in enumerate(table.get(key, [])):
        if item.get("name") == name and "file" not in item and "points" not in item:
            return i
    raise SceneError(f"{key}: {name!r} is stated in a table file or in a list of points; change it there by hand")
