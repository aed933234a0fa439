"""Variation simulation of sheet-metal assemblies with frictional contact, by the method of influence coefficients.

>>> import mic
>>> scene = mic.load_scene("meshes/wheelhouse/scene.toml")     # doctest: +SKIP
>>> model = mic.reduce(scene)                                   # doctest: +SKIP
>>> model.evaluate({"F1": 20.0}).measurements                   # doctest: +SKIP

Each command is a function of the same name here, from a scene or model to tables and figures as data:
``mic.explain(model, measured, gauge)`` is ``mic explain``. ``mic report`` is :func:`mic.report.write_report`; pictures
of what the functions return are drawn by ``mic.report.pictures`` (:mod:`mic.report.study_pictures`).
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mic.errors import FormatError, MicError, MissingProvider, RunError, SceneError, StorageError
from mic.system import renamed_modules
from mic.system.blas import choose_kernels

choose_kernels()  # before anything here imports numpy
renamed_modules.install()

if TYPE_CHECKING:
    from mic.plausibility import Warned
    from mic.process.model import ReducedModel
    from mic.runs import read_run, run
    from mic.scene import Scene, load_scene
    from mic.studies.comparison import compare
    from mic.studies.contributors import contributors
    from mic.studies.explanation import explain
    from mic.studies.exploration import explore
    from mic.studies.friction import friction_effects as friction
    from mic.studies.optimisation import optimise
    from mic.studies.order import order
    from mic.studies.prediction import predict
    from mic.studies.rare import rare
    from mic.studies.remedy import remedies as remedy
    from mic.studies.sensitivity import effects as sensitivity
    from mic.wizard import write_scene as init

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
    "check",
    "compare",
    "contributors",
    "explain",
    "explore",
    "friction",
    "init",
    "load_scene",
    "optimise",
    "order",
    "predict",
    "rare",
    "read_run",
    "reduce",
    "remedy",
    "run",
    "sensitivity",
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
    from mic.model.assembly import assemble
    from mic.process.model import ReducedModel
    from mic.process.plan import plan_assembly
    from mic.process.stiffness import coefficients

    cache = cache or cache_folder()
    assembly = assemble(scene, cache, check=plan_assembly)
    plan_assembly(assembly)  # a process that cannot be is refused before anything is factorised
    return ReducedModel.build(assembly, coefficients(assembly, cache)[0])


def check(scene: Scene, cache: Path | None = None) -> tuple[Warned, ...]:
    """Put a scene on its meshes and judge it: what no rule forbids and no workshop would build.

    Parameters
    ----------
    scene : Scene
    cache : Path, optional
        Folder of generated meshes; default :func:`cache_folder`.

    Returns
    -------
    tuple of mic.plausibility.Warned
        In the order of the rules; none where nothing is unusual.

    Raises
    ------
    SceneError
        If the scene cannot be built, naming the key and the remedy.
    """
    from mic.model.assembly import assemble
    from mic.plausibility import judge
    from mic.process.plan import plan_assembly

    assembly = assemble(scene, cache or cache_folder(), check=plan_assembly)
    plan_assembly(assembly)
    return judge(scene, assembly)


#: Module and name of what is public here.
_HOMES = {
    "ReducedModel": ("mic.process.model", "ReducedModel"),
    "Scene": ("mic.scene", "Scene"),
    "compare": ("mic.studies.comparison", "compare"),
    "contributors": ("mic.studies.contributors", "contributors"),
    "explain": ("mic.studies.explanation", "explain"),
    "explore": ("mic.studies.exploration", "explore"),
    "friction": ("mic.studies.friction", "friction_effects"),
    "init": ("mic.wizard", "write_scene"),
    "load_scene": ("mic.scene", "load_scene"),
    "optimise": ("mic.studies.optimisation", "optimise"),
    "order": ("mic.studies.order", "order"),
    "predict": ("mic.studies.prediction", "predict"),
    "rare": ("mic.studies.rare", "rare"),
    "read_run": ("mic.runs", "read_run"),
    "remedy": ("mic.studies.remedy", "remedies"),
    "run": ("mic.runs", "run"),
    "sensitivity": ("mic.studies.sensitivity", "effects"),
}


def __getattr__(name: str) -> Any:
    """Public names and rooms (``mic.contact``), imported when they are first asked for.

    Numerics and tables take a second to import. A program that is stopped meanwhile must be able to say so, and one
    that evaluates a model needs no tables.
    """
    if name in _HOMES:
        home, own = _HOMES[name]
        return getattr(importlib.import_module(home), own)
    if not name.startswith("_"):
        try:
            return importlib.import_module(f"mic.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"mic.{name}":
                raise
    raise AttributeError(f"module 'mic' has no attribute {name!r}")
