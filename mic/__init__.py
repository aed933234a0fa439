"""Variation simulation of sheet-metal assemblies with frictional contact, by the method of influence coefficients.

>>> import mic
>>> scene = mic.load_scene("meshes/wheelhouse/scene.toml")     # doctest: +SKIP
>>> model = mic.reduce(scene)                                   # doctest: +SKIP
>>> model.evaluate({"F1": 20.0}).measurements                   # doctest: +SKIP
>>> model.evaluate(model.sample(100), friction=0.1).to_frame()  # doctest: +SKIP

Each command but ``mic serve`` is a function of the same name here, from a scene or model to tables and figures as data:
``mic.explain(model, measured, gauge)`` is ``mic explain``. ``mic report`` is :func:`mic.report.write_report`;
``mic.report.pictures`` draws the results of these functions (:mod:`mic.report.study_pictures`). Longer computations
show a bar in notebooks; ``progress=False`` hides it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mic.errors import FormatError, MicError, MissingProvider, RunError, SceneError, StorageError
from mic.system import renamed_modules
from mic.system.blas import choose_kernels

choose_kernels()  # before anything here imports numpy
renamed_modules.install()

if TYPE_CHECKING:
    from mic import examples, report
    from mic.build import check, reduce
    from mic.contact.states import ContactState
    from mic.deployment.fmi_unit import write_unit as export
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
    from mic.system.disk_cache import cache_folder
    from mic.wizard import write_scene as init

__all__ = [
    "ContactState",
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
    "examples",
    "explain",
    "explore",
    "export",
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
    "report",
    "run",
    "sensitivity",
]

__version__ = "0.2.0"


#: Module and name in it of each public name.
_PUBLIC = {
    "ContactState": ("mic.contact.states", "ContactState"),
    "ReducedModel": ("mic.process.model", "ReducedModel"),
    "Scene": ("mic.scene", "Scene"),
    "cache_folder": ("mic.system.disk_cache", "cache_folder"),
    "check": ("mic.build", "check"),
    "compare": ("mic.studies.comparison", "compare"),
    "contributors": ("mic.studies.contributors", "contributors"),
    "explain": ("mic.studies.explanation", "explain"),
    "explore": ("mic.studies.exploration", "explore"),
    "export": ("mic.deployment.fmi_unit", "write_unit"),
    "friction": ("mic.studies.friction", "friction_effects"),
    "init": ("mic.wizard", "write_scene"),
    "load_scene": ("mic.scene", "load_scene"),
    "optimise": ("mic.studies.optimisation", "optimise"),
    "order": ("mic.studies.order", "order"),
    "predict": ("mic.studies.prediction", "predict"),
    "rare": ("mic.studies.rare", "rare"),
    "read_run": ("mic.runs", "read_run"),
    "reduce": ("mic.build", "reduce"),
    "remedy": ("mic.studies.remedy", "remedies"),
    "run": ("mic.runs", "run"),
    "sensitivity": ("mic.studies.sensitivity", "effects"),
}


def __dir__() -> list[str]:
    """The public names, which a notebook completes."""
    return [*__all__, "__doc__", "__version__"]


def __getattr__(name: str) -> Any:
    """Import public names and subpackages (``mic.contact``) at their first use.

    Numerics and tables take a second to import: a program that is interrupted meanwhile must be able to report it, and
    one that evaluates a model needs no tables.
    """
    if name in _PUBLIC:
        module, attribute = _PUBLIC[name]
        return getattr(importlib.import_module(module), attribute)
    if not name.startswith("_"):
        try:
            return importlib.import_module(f"mic.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"mic.{name}":
                raise
    raise AttributeError(f"module 'mic' has no attribute {name!r}")
