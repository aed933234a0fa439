"""Example scenes with the mesh size, laws, pairs and path that a study needs."""

from __future__ import annotations

from mic.examples import folder
from mic.scene import Scene, load_scene

__all__ = ["shipped", "with_path", "with_stated_pairs"]


#: Number of pairs by zone for scenes that do not state it, sufficient to compare solvers.
FEW = {"lap": 24, "left": 20, "right": 20, "stop": 7, "foot": 24, "cover": 12, "rest": 7}


def with_stated_pairs(scene: Scene) -> Scene:
    """The scene with the stated pairs of `FEW` instead of contact candidates."""
    zones = [
        zone.model_copy(update={"pairs": FEW[zone.name], "spacing": None}) if zone.candidates else zone
        for zone in scene.zones
    ]
    return scene.model_copy(update={"zones": zones})


def shipped(name: str, size: str | float, laws=("coulomb",)) -> Scene:
    """An example scene with all parts meshed at one size, without fields.

    Parameters
    ----------
    name : str
        Its folder.
    size : str or float
        A named size of the geometry, or mm.
    laws : sequence of str
    """
    scene = with_stated_pairs(load_scene(folder(name)))
    parts = [part.model_copy(update={"size": size}) for part in scene.parts]
    return scene.model_copy(
        update={"parts": parts, "report": scene.report.model_copy(update={"laws": list(laws), "fields": False})}
    )


def with_path(scene: Scene, path: str, increments: int | None = None) -> Scene:
    """The scene with another path in all stages that resolve contact; arguments are the stage's keys."""
    change = {"path": path, "increments": increments} | (
        {"order": None, "sequence": False} if path == "one-step" else {}
    )
    stages = [
        stage.model_copy(update=change) if stage.kind in ("clamp", "weld", "release") else stage
        for stage in scene.stages
    ]
    return scene.model_copy(update={"stages": stages})
