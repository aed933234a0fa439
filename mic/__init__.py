"""Variation simulation of sheet-metal assemblies with frictional contact, by the method of influence coefficients.

>>> import mic
>>> scene = mic.load_scene("meshes/wheelhouse/scene.toml")     # doctest: +SKIP
>>> model = mic.reduce(scene)                                   # doctest: +SKIP
>>> model.evaluate({"F1": 20.0}).measurements                   # doctest: +SKIP
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mic.errors import FormatError, MicError, MissingProvider, RunError, SceneError, StorageError

if TYPE_CHECKING:
    from mic.process.model import ReducedModel
    from mic.runs import read_run, run
    from mic.scene import Scene, load_scene
    from mic.studies.comparison import compare
    from mic.studies.explanation import explain
    from mic.studies.exploration import explore

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
    "compare",
    "explain",
    "explore",
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
    from platformdirs import user_cache_path  # as all libraries, only where it is used: see __getattr__

    found = user_cache_path("mic")
    if not found.is_absolute():  # "~" as it stands
        raise StorageError("there is no home folder to keep meshes in; let MIC_CACHE name a folder that can be written")
    return found


def reduce(scene: Scene, cache: Path | None = None) -> ReducedModel:
    """Build the reduced model of a scene: meshes, contact pairs, influence coefficients; each process for itself.

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
    from mic.compliance.cache import influence_coefficients
    from mic.model.assembly import assemble
    from mic.process.model import ReducedModel
    from mic.process.plan import plan_assembly

    cache = cache or cache_folder()
    assembly = assemble(scene, cache, check=plan_assembly)
    plan_assembly(assembly)  # a process that cannot be is refused before anything is factorised
    return ReducedModel.build(assembly, influence_coefficients(assembly, cache)[0])


_HOMES = {
    "ReducedModel": "mic.process.model",
    "Scene": "mic.scene",
    "compare": "mic.studies.comparison",
    "explain": "mic.studies.explanation",
    "explore": "mic.studies.exploration",
    "load_scene": "mic.scene",
    "read_run": "mic.runs",
    "run": "mic.runs",
}


def __getattr__(name: str) -> Any:
    """Public names and rooms (``mic.contact``), imported when they are first asked for.

    Numerics and tables take a second to import. A program that is stopped meanwhile must be able to say so, and one
    that evaluates a model needs no tables.
    """
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if not name.startswith("_"):
        try:
            return importlib.import_module(f"mic.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"mic.{name}":
                raise
    raise AttributeError(f"module 'mic' has no attribute {name!r}")
