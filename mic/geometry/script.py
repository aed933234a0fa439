"""Geometry scripts: Python files of the user that generate the mesh of a part.

A script defines ``build(part, size) -> (points, triangles, normals)``: the mid-surface of one part as points (n, 3) in
mm and triangles (k, 3), and optionally the normals (k, 3, 3) of the sheet at the corners of each triangle, which are
estimated if missing. ``SIZES``, a dict, may name sizes in mm. ``DEPENDS``, a list, names files that it reads by means
other than Python's ``open`` (:mod:`mic.geometry.script_dependencies`). If the scene states an accuracy, the size is a
:class:`mic.geometry.grading.GradedSize`, a float with smaller sizes around some places.

A script may raise, exit, crash, loop forever or print. It therefore runs in a separate process, which returns a mesh or
an error message in a file. Its output is discarded. It is stopped after ``$MIC_SCRIPT_LIMIT`` seconds (600).
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
import traceback
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

from mic.errors import SceneError
from mic.geometry.grading import GradedSize
from mic.geometry.script_dependencies import Dependencies, opened_files
from mic.geometry.surface import Surface
from mic.system.foreign_files import scripts_allowed
from mic.system.helper_program import run_program

__all__ = ["arrays_surface", "build", "graded_sizes", "load_script", "mesh_arrays", "named_sizes"]

LIMIT = 600.0  # s
UNWRITABLE = 73  # exit status of a script's process that cannot write its result
RANKS = ("OMPI_", "PMIX_", "PMI_")  # prefixes of variables that identify MPI processes; scripts must not inherit them
PACKAGES = {"gmsh": "'mic-contact[mesh]'"}  # pip requirement for a module that the shipped scripts import


def build(part: str, path: Path, size: float | str, share: float = 1.0) -> tuple[Surface, Dependencies]:
    """The surface that a script builds for a part at a multiple of a size, and the files that the script read.

    Parameters
    ----------
    part : str
        Name of the part.
    path : Path
    size : float or str
        Element size, mm, or one of the script's named sizes; may be a :class:`mic.geometry.grading.GradedSize`.
    share : float
        Factor on the size.

    Raises
    ------
    SceneError
        Naming part and file, if the script fails in any way.
    """
    result, arrays = _run(part, path, {"size": size, "graded": graded_sizes(size), "share": share})
    return arrays_surface(arrays), Dependencies(**result)


def named_sizes(part: str, path: Path) -> dict[str, float]:
    """Named sizes of a script, mm. Parameters and errors are those of :func:`build`."""
    return _run(part, path, {"size": None})[0]["sizes"]


def graded_sizes(size: float | str | None) -> list | None:
    """Places and sizes of a graded size as JSON; None for any other size."""
    return [size.places.tolist(), size.sizes.tolist()] if isinstance(size, GradedSize) else None


def mesh_arrays(surface: Surface) -> dict[str, np.ndarray]:
    """The arrays of a surface by name, to be stored."""
    arrays = {"points": surface.points, "triangles": surface.triangles, "normals": surface.given_normals}
    return {name: array for name, array in arrays.items() if array is not None}


def arrays_surface(arrays: Mapping[str, np.ndarray]) -> Surface:
    """The surface of arrays as :func:`mesh_arrays` returns them."""
    return Surface(arrays["points"], arrays["triangles"], arrays.get("normals"))


def load_script(path: Path) -> ModuleType:
    """A geometry script as a module; its exceptions are passed on.

    Raises
    ------
    ValueError
        If it is no Python file, or defines no ``build``.
    """
    if path.suffix != ".py":
        raise ValueError("a geometry script must be a Python file, NAME.py")
    module = ModuleType(f"mic_geometry_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]}")
    name, module.__file__ = module.__name__, str(path)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        # The source itself: an import would prefer a compiled file beside it, which may hold another program.
        exec(compile(path.read_bytes(), path, "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    if not callable(getattr(module, "build", None)):
        raise ValueError("a geometry script must define build(part, size) -> (points, triangles)")
    return module


def _run(part: str, path: Path, request: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Result of a script that runs in a separate process, and the arrays of its mesh."""
    if not scripts_allowed():
        raise SceneError(f"part {part!r}: geometry: {path} is a program, which --no-scripts refuses; give it a mesh")
    with tempfile.TemporaryDirectory(prefix="mic-script-") as name:
        folder = Path(name)
        (folder / "request.json").write_text(json.dumps({"part": part, "path": str(path), **request}))
        status = _wait(folder)
        result = folder / "result.json"
        content = json.loads(result.read_text()) if result.is_file() else {"reason": _failure(status)}
        if "reason" in content:
            raise SceneError(f"part {part!r}: geometry: {path}: {content['reason']}")
        with np.load(folder / "mesh.npz") as arrays:
            return content, dict(arrays)


def _wait(folder: Path) -> int | None:
    """Exit status of the process that runs a script; None on timeout."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(RANKS)}
    environment["PYTHONPATH"] = os.pathsep.join(place for place in sys.path if place)
    return run_program([sys.executable, "-P", "-m", "mic.geometry.script", str(folder)], _limit(), environment)


def _limit() -> float:
    """Time limit for a script, s."""
    try:
        return float(os.environ.get("MIC_SCRIPT_LIMIT") or LIMIT)
    except ValueError:
        return LIMIT


def _failure(status: int | None) -> str:
    """Reason why a script returned no result, and the remedy."""
    if status is None:
        late = f"the script does not end within {_limit():g} s"
        return f"{late}; correct its loop, use a larger size, or set MIC_SCRIPT_LIMIT to more seconds"
    if status < 0:
        return f"the script crashes (signal {-status}), probably in a library; run it on its own and correct it"
    if status == UNWRITABLE:
        full = f"its mesh cannot be written into {tempfile.gettempdir()}"
        return f"{full}: free space on that disk, or set TMPDIR to a folder on another one"
    return f"the script ends the program (exit status {status}) instead of returning a mesh; remove the exit"


def _serve(folder: Path) -> None:
    """Run the script of a request and write the result."""
    request = json.loads((folder / "request.json").read_text())
    path = Path(request["path"])
    try:
        content, arrays = (_sizes(path), {}) if request["size"] is None else _mesh(path, request)
    except BaseException as problem:  # a script is the user's own program and may raise anything
        content, arrays = {"reason": _reason(problem, path)}, {}
    try:
        np.savez(folder / "mesh.npz", **arrays)
        (folder / "result.part").write_text(json.dumps(content))
        (folder / "result.part").replace(folder / "result.json")
    except OSError:  # the reason cannot be written either
        raise SystemExit(UNWRITABLE) from None


def _sizes(path: Path) -> dict[str, Any]:
    """Named sizes of a script."""
    script = load_script(path)
    return {"sizes": {str(name): float(_size(script, str(name), 1.0)) for name in getattr(script, "SIZES", {})}}


def _mesh(path: Path, request: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Files that the script read, and the arrays of its mesh."""
    size = request["size"]
    if request["graded"] is not None:
        size = GradedSize(size, *request["graded"])
    with opened_files() as opened:
        script = load_script(path)
        surface = _surface(script.build(request["part"], _size(script, size, request["share"])))
    read = Dependencies.of(path, _declared(script), opened)
    return asdict(read), mesh_arrays(surface)


def _reason(problem: BaseException, path: Path) -> str:
    """Reason of an error in a script, and the remedy."""
    if isinstance(problem, SystemExit):
        return "the script exits instead of returning a mesh; remove the exit"
    if not isinstance(problem, ImportError):
        return _describe(problem, path)
    missing = (problem.name or "").split(".")[0]
    if (path.parent / f"{missing}.py").is_file():
        return f"imports {missing}, a file in its folder; write the script as one file"
    if not isinstance(problem, ModuleNotFoundError) or not missing:
        return f"{problem}; check the installed version"
    return f"needs the package {missing}; install it: pip install {PACKAGES.get(missing, missing)}"


def _describe(problem, path):
    """Message of an error in a script, with its type and line unless it was raised on purpose."""
    text = " ".join(str(problem).split())
    lines = [frame.lineno for frame in traceback.extract_tb(problem.__traceback__) if frame.filename == str(path)]
    where = f" (line {lines[-1]} of the script)" if lines else ""
    if isinstance(problem, ValueError) and text:
        return text + where + "; correct the script" * (";" not in text)
    return f"{type(problem).__name__}{text and ': ' + text}{where}; correct the script"


def _size(script, size, share):
    """Element size times a factor, mm."""
    if isinstance(size, GradedSize):
        return size.times(share)
    if not isinstance(size, str):
        return share * size
    sizes = getattr(script, "SIZES", {})
    if not isinstance(sizes, dict):
        raise ValueError(f"SIZES must be a dict of mm by name, not {type(sizes).__name__}")
    if size not in sizes:
        raise ValueError(f"there is no size called {size!r}; known: {', '.join(map(str, sizes)) or 'none, give mm'}")
    if not isinstance(sizes[size], (int, float)) or not 0 < sizes[size] < np.inf:
        raise ValueError(f"SIZES gives {sizes[size]!r} for {size!r}; give a size in mm")
    return share * sizes[size]


def _declared(script):
    """Files that a script declares as dependencies."""
    names = getattr(script, "DEPENDS", [])
    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
        raise ValueError("DEPENDS must be a list of file names, relative to the script")
    for name in names:
        if not (Path(script.__file__).parent / name).is_file():
            raise ValueError(f"DEPENDS names {name}, which is not in the folder of the script; correct it")
    return list(names)


def _surface(built):
    """The surface that ``build`` returned, after checking its arrays."""
    names = ("points", "triangles", "normals")
    if not isinstance(built, (tuple, list)) or len(built) not in (2, 3):
        raise ValueError(
            "build must return two arrays, points and triangles, or three, with the normals at the triangles' corners, "
            f"not {type(built).__name__}"
        )
    try:
        points, triangles, *normals = (np.asarray(array) for array in built)
    except ValueError:
        raise ValueError("build returned points or triangles whose rows differ in length") from None
    for name, array in zip(names, (points, triangles, *normals)):
        if array.dtype.kind not in "iuf":
            raise ValueError(f"build returned {name} that are not numbers ({array.dtype})")
    if triangles.dtype.kind == "f" and not (np.isfinite(triangles) & (triangles == np.rint(triangles))).all():
        raise ValueError("build returned triangles that are not integers")
    return Surface(points, triangles, *normals)


def _main() -> NoReturn:
    """Serve the request in the folder that the command line names."""
    _serve(Path(sys.argv[1]))
    os._exit(0)  # even if threads of the script still run


if __name__ == "__main__":
    _main()
