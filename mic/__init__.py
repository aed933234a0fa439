"""Variation simulation of sheet-metal assemblies with frictional contact, by the method of influence coefficients.

>>> import mic
>>> scene = mic.load_scene("meshes/wheelhouse/scene.toml")     # doctest: +SKIP
>>> model = mic.reduce(scene)                                   # doctest: +SKIP
>>> model.evaluate({"F1": 20.0}).measurements                   # doctest: +SKIP
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platformdirs import user_cache_path

from mic.compliance.cache import influence_coefficients
from mic.errors import FormatError, MicError, MissingProvider, RunError, SceneError, StorageError
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.scene import Scene, load_scene

if TYPE_CHECKING:
    from mic.runs import read_run, run

__all__ = [
    "FormatError",
    "MicError",
    "MissingProvider",
    "ReducedModel",
    "RunError",
    "Scene",
    "SceneError",
    "StorageError",
    "cache_folder",
    "load_scene",
    "read_run",
    "reduce",
    "run",
]

__version__ = "0.2.0"


def cache_folder() -> Path:
    """Where meshes and influence coefficients are kept: ``$MIC_CACHE``, or the user's cache folder.

    Raises
    ------
    StorageError
        If the user has no home.
    """
    if os.environ.get("MIC_CACHE"):
        return Path(os.environ["MIC_CACHE"])
    found = user_cache_path("mic")
    if not found.is_absolute():  # "~" as it stands
        raise StorageError("there is no home folder to keep meshes in; let MIC_CACHE name a folder that can be written")
    return found


def reduce(scene: Scene, cache: Path | None = None) -> ReducedModel:
    """Build the reduced model of a scene: meshes, contact pairs, influence coefficients.

    Parameters
    ----------
    scene : Scene
    cache : Path, optional
        Folder of generated meshes and influence coefficients; default :func:`cache_folder`.

    Raises
    ------
    SceneError
        Naming the key and the remedy.
    MissingProvider
        If influence coefficients must be computed and nothing that can is installed.
    """
    cache = cache or cache_folder()
    assembly = assemble(scene, cache)
    return ReducedModel.build(assembly, influence_coefficients(assembly, cache)[0])


def __getattr__(name: str) -> Any:
    """``mic.run`` and ``mic.read_run``: tables and statistics are slow to import, and evaluating a model needs none."""
    if name in ("read_run", "run"):
        from mic import runs

        return getattr(runs, name)
    raise AttributeError(f"module 'mic' has no attribute {name!r}")
