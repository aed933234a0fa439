"""Write the changes of an optimum into the keys of its scene file."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

from mic.errors import SceneError
from mic.scene.revision import revised
from mic.studies.adjustment import Adjustment, written
from mic.studies.optimisation.design import Change

__all__ = ["rewritten"]


def rewritten(text: str, scene, changes: Sequence[Change]) -> str:
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
    for one in changes:
        if one.kind == "order":
            index = next(i for i, own in enumerate(table["stages"]) if own.get("name", own["kind"]) == one.targets[0])
            order = [_names_in_file(table, group) for group in one.after]
            text = revised(text, "stages", index, {"order": order, "sequence": None})
        elif one.kind == "place":
            key, _, name = one.targets[0].partition(".")
            text = revised(text, key, _index(table, key, name), {"point": list(one.after), "node": None, "set": None})
        elif one.kind == "force" or one.targets[0] in {clamp.name for clamp in scene.clamps}:
            strokes = {clamp.name: clamp.stroke for clamp in scene.clamps}
            for name in _names_in_file(table, one.targets):
                own = (
                    {"force": one.after} if one.kind == "force" else {"stroke": strokes[name] + one.after - one.before}
                )
                rounded = {key: round(value, 12) for key, value in own.items()}
                text = revised(text, "clamps", _index(table, "clamps", name), rounded)
        else:
            change = one.after - one.before
            moved = Adjustment("locators." + "+".join(one.targets), "locator", one.targets, 0.0, change, change)
            shims[moved] = change
    if shims:
        text = text.rstrip("\n") + "\n\n" + written(scene, shims)
    return text


def _names_in_file(table: dict[str, Any], names: Sequence[str]) -> list[str]:
    """Names as the file has them: for the jaws of tongs, the name of the tongs."""
    found = []
    for name in names:
        tong = next(
            (
                one["name"]
                for one in table.get("clamps", [])
                if name in {f"{one.get('name')}-{part}" for part in one.get("parts", ())}
            ),
            name,
        )
        if tong not in found:
            found.append(tong)
    return found


def _index(table: dict[str, Any], key: str, name: str) -> int:
    for i, one in enumerate(table.get(key, [])):
        if one.get("name") == name and "file" not in one and "points" not in one:
            return i
    raise SceneError(f"{key}: {name!r} stands in a row of a file, or among several points; change it there by hand")
