"""The identity of a run: one hash over all inputs that its numbers depend on, and over nothing that was computed.

Inputs are the scene with its defaults filled in, the content of every file that its meshes were made from, the seed,
how samples are drawn or what they are, who solves the contacts and how exactly, how exactly paths are followed, the
version of the program and the formats of its files. How many samples there are and under which laws is left out: a
block says that of itself. So are names, descriptions and what is drawn. Nothing computed enters, for its last digits
may change with the number of threads.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from mic.process.process import TOLERANCE
from mic.process.stage import LEAST_MOTION
from mic.system.files import fingerprint

__all__ = ["FORMAT", "differences", "identity", "inputs", "program_version"]

FORMAT = 3  # raised whenever the same inputs give other numbers, or blocks of another form
#: What the setting gives is filled in.
_CAPTIONS = {"name", "description", "setting", "monte_carlo", "report", "optimise"}
_OF_THE_PROGRAM = ("program", "format")
_WORDS = {
    "program": "version of the program",
    "design": "design of the samples, or the samples themselves",
    "dimension": "contact rows per pair",
    "path_floor": "error of a path that is not judged",
}


def inputs(model, seed: int) -> dict[str, Any]:
    """All inputs of a run, JSON-ready; long ones as hashes.

    Parameters
    ----------
    model : mic.process.model.ReducedModel or mic.model.assembly.Assembly
    seed : int
    """
    scene = model.scene
    tables = json.loads(scene.model_dump_json(exclude=_CAPTIONS))
    given = scene.monte_carlo.values
    return {
        "program": program_version(),
        "format": FORMAT,
        "seed": seed,
        "design": scene.monte_carlo.design if given is None else fingerprint(given),
        "backend": scene.monte_carlo.backend,
        "tolerance": TOLERANCE,
        "path_floor": LEAST_MOTION * scene.path.tolerance,
        "fields": scene.report.fields,
        "dimension": model.contacts.dimension,
        "scene": {key: fingerprint(table) for key, table in tables.items()},
        "files": dict(model.inputs),
    }


def identity(model, seed: int) -> str:
    """Hash of :func:`inputs`."""
    return fingerprint(inputs(model, seed))


def differences(there: Mapping[str, Any], asked: Mapping[str, Any], program: bool = True) -> list[str]:
    """What differs between the inputs of two runs, in words.

    Parameters
    ----------
    there, asked : dict
        As :func:`inputs` gives them.
    program : bool
        Whether the version of the program counts.
    """
    found = []
    for key in sorted(set(there) | set(asked)):
        if there.get(key) == asked.get(key) or (key in _OF_THE_PROGRAM and not program):
            continue
        if key in ("scene", "files"):
            old, new = there.get(key) or {}, asked.get(key) or {}
            names = [name for name in sorted(set(old) | set(new)) if old.get(name) != new.get(name)]
            found.append(("of the scene: " if key == "scene" else "content of ") + ", ".join(names))
        else:
            name = _WORDS.get(key, key)
            found.append(f"{name} ({there.get(key)} there, {asked.get(key)} asked for)")
    return found


def program_version() -> str:
    """Version of this program as installed."""
    try:
        return version("mic-contact")
    except PackageNotFoundError:
        return "not installed"
