"""The identity of a run: a hash of all inputs that its numbers depend on.

Inputs are the scene with its defaults, the content of every file that its meshes were made from, the seed, the sampling
design or the given samples, the contact solver and its tolerance, the tolerance of path following, the version of the
program and of its file formats. The number of samples and the laws are not included, because each block states them;
nor are names, descriptions and options of the report. Computed values are not included, because their last digits may
depend on the number of threads.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from mic.process.process import TOLERANCE
from mic.system.files import fingerprint

__all__ = ["FORMAT", "differences", "identity", "inputs", "installed_version", "program_version"]

FORMAT = 4  # increased whenever the same inputs give other numbers, or blocks of another format
#: Tables of the scene without effect on the numbers; the values of a `setting` are in the other tables.
_IGNORED = {"name", "description", "setting", "monte_carlo", "report", "optimise", "scans"}
_PROGRAM_KEYS = ("program", "format")
_LABELS = {
    "program": "version of the program",
    "design": "design of the samples, or the samples themselves",
    "dimension": "contact rows per pair",
    "solver_work": "work of the contact solver for a sample",
}


def inputs(model, seed: int) -> dict[str, Any]:
    """All inputs of a run, JSON-ready, long ones as hashes.

    Parameters
    ----------
    model : mic.process.model.ReducedModel or mic.model.assembly.Assembly
    seed : int
    """
    scene = model.scene
    tables = json.loads(scene.model_dump_json(exclude=_IGNORED))
    given = scene.monte_carlo.values
    return {
        "program": program_version(),
        "format": FORMAT,
        "seed": seed,
        "design": scene.monte_carlo.design if given is None else fingerprint(given),
        "backend": scene.monte_carlo.backend,
        "solver_work": scene.monte_carlo.solver_work,
        "tolerance": TOLERANCE,
        "fields": scene.report.fields,
        "dimension": model.contacts.dimension,
        "scene": {key: fingerprint(table) for key, table in tables.items()},
        "files": dict(model.inputs),
    }


def identity(model, seed: int) -> str:
    """Hash of :func:`inputs`."""
    return fingerprint(inputs(model, seed))


def differences(stored: Mapping[str, Any], requested: Mapping[str, Any], program: bool = True) -> list[str]:
    """Differences between the inputs of two runs, as text.

    Parameters
    ----------
    stored, requested : dict
        As returned by :func:`inputs`.
    program : bool
        Whether to compare the version of the program.
    """
    differing = []
    for key in sorted(set(stored) | set(requested)):
        old, new = stored.get(key), requested.get(key)
        if old == new or (key in _PROGRAM_KEYS and not program):
            continue
        if key in ("scene", "files"):
            old, new = old or {}, new or {}
            names = [name for name in sorted(set(old) | set(new)) if old.get(name) != new.get(name)]
            differing.append(("tables of the scene: " if key == "scene" else "content of ") + ", ".join(names))
        else:
            differing.append(f"{_LABELS.get(key, key)}: {old} in the folder, {new} requested")
    return differing


def program_version() -> str:
    """Installed version of this program."""
    return installed_version("mic-contact")


NOT_INSTALLED = "not installed"  #: in place of a version


def installed_version(package: str) -> str:
    """Installed version of a package, or `NOT_INSTALLED`."""
    try:
        return version(package)
    except PackageNotFoundError:
        return NOT_INSTALLED
