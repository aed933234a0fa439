"""The scenes that ship with the program, at the size and under the laws that a study needs."""

from __future__ import annotations

from mic.examples import folder
from mic.scene import Scene, load_scene

__all__ = ["shipped"]


def shipped(name: str, size: str | float, laws=("coulomb",)) -> Scene:
    """An example scene, all parts meshed at one size, without fields.

    Parameters
    ----------
    name : str
        Its folder.
    size : str or float
        A named size of the geometry, or mm.
    laws : sequence of str
    """
    scene = load_scene(folder(name))
    parts = [part.model_copy(update={"size": size}) for part in scene.parts]
    return scene.model_copy(
        update={"parts": parts, "report": scene.report.model_copy(update={"laws": list(laws), "fields": False})}
    )
