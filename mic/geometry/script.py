"""Geometry scripts: Python files of the user's that make the mesh of a part.

A script defines ``build(part, size) -> (points, triangles, normals)``: the mid-surface of one part as points (n, 3) in
mm and triangles (k, 3), and the normals (k, 3, 3) of the sheet at the corners of each triangle, which may be left out
and are then estimated. ``SIZES``, a dict, may give names to sizes in mm; ``DEPENDS``, a list, names files that it reads
in ways that Python does not see (:mod:`mic.geometry.script_dependencies`). Where the scene states an accuracy, the size is a
:class:`mic.geometry.grading.GradedSize`, a number that tells smaller ones too.

It is somebody's program and may do anything: raise, exit, crash, never end, print what it likes. So it runs in a
process of its own, which answers in a file: with a mesh, or with the sentence that is told. What it prints is dropped.
Longer than ``$MIC_SCRIPT_LIMIT`` seconds (600) it is not waited for.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

from mic.errors import SceneError
from mic.geometry.grading import GradedSize
from mic.geometry.script_dependencies import Dependencies, opened_files
from mic.geometry.surface import Surface

__all__ = ["build", "load_script", "named_sizes"]

LIMIT = 600.0  # s
UNWRITTEN = 73  # exit status of a script's process that cannot write its answer
RANKS = ("OMPI_", "PMIX_", "PMI_")  # by these variables a process that MPI has started is known: a script is none
PACKAGES = {"gmsh": "'mic-contact[mesh]'"}  # what pip installs for a module that the shipped scripts import


def build(part: str, path: Path, size: float | str, share: float = 1.0) -> tuple[Surface, Dependencies]:
    """The surface that a script makes of a part, at a share of a size; and what the script read.

    Parameters
    ----------
    part : str
        Its name.
    path : Path
    size : float or str
        Element size, mm, or one of the script's named sizes; may be a :class:`mic.geometry.grading.GradedSize`.
    share : float

    Raises
    ------
    SceneError
        Naming part and file, where the script fails in whatever way.
    """
    graded = [size.places.tolist(), size.sizes.tolist()] if isinstance(size, GradedSize) else None
    answer, arrays = _asked(part, path, {"size": size, "graded": graded, "share": share})
    surface = Surface(arrays["points"], arrays["triangles"], arrays.get("normals"))
    return surface, Dependencies(answer["files"], answer["place"])


def named_sizes(part: str, path: Path) -> dict[str, float]:
    """The sizes that a script names, mm. Parameters and errors are those of :func:`build`."""
    return _asked(part, path, {"size": None})[0]["sizes"]


def load_script(path: Path) -> ModuleType:
    """A geometry script as a module; whatever it raises is passed on.

    Raises
    ------
    ValueError
        If it is no Python file, or defines no ``build``.
    """
    name = f"mic_geometry_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ValueError("a geometry script must be a Python file, NAME.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    if not callable(getattr(module, "build", None)):
        raise ValueError("a geometry script must define build(part, size) -> (points, triangles)")
    return module


def _asked(part: str, path: Path, request: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a script answers in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="mic-script-") as name:
        folder = Path(name)
        (folder / "request.json").write_text(json.dumps({"part": part, "path": str(path), **request}))
        status = _wait(folder)
        answer = folder / "answer.json"
        if not answer.is_file():
            raise SceneError(f"part {part!r}: geometry: {path}: {_silence(status)}")
        found = json.loads(answer.read_text())
        if "reason" in found:
            raise SceneError(f"part {part!r}: geometry: {path}: {found['reason']}")
        mesh = folder / "mesh.npz"
        if not mesh.is_file():
            return found, {}
        with np.load(mesh) as arrays:
            return found, dict(arrays)


def _wait(folder: Path) -> int | None:
    """Exit status of the process that runs a script; None where it took too long."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(RANKS)}
    environment["PYTHONPATH"] = os.pathsep.join(place for place in sys.path if place)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "mic.geometry.script", str(folder)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,  # so that what it starts ends with it
    )
    try:
        return process.wait(_limit())
    except subprocess.TimeoutExpired:
        return None
    finally:
        _end(process)


def _limit() -> float:
    """How long a script is waited for, s."""
    try:
        return float(os.environ.get("MIC_SCRIPT_LIMIT") or LIMIT)
    except ValueError:
        return LIMIT


def _end(process: subprocess.Popen) -> None:
    """End a process, and on POSIX all that it has started."""
    try:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    except ProcessLookupError:
        pass  # ended by itself, with all that it had started
    process.wait()


def _silence(status: int | None) -> str:
    """Why a script may have given no answer."""
    if status is None:
        return (
            f"the script does not end within {_limit():g} s; mend its loop, mesh coarser, or let MIC_SCRIPT_LIMIT be "
            "more seconds"
        )
    if status < 0:
        return f"the script crashes (signal {-status}), likely in a library; run it by itself, and mend it"
    if status == UNWRITTEN:
        return (
            f"its mesh cannot be written into {tempfile.gettempdir()}: make room on that disk, or let TMPDIR name a "
            "folder on another"
        )
    return f"the script ends the program (exit status {status}) instead of returning a mesh; take the exit out"


def _answer(folder: Path) -> None:
    """Run the script that a request names, and write the answer."""
    request = json.loads((folder / "request.json").read_text())
    path = Path(request["path"])
    try:
        found, arrays = (_sizes(path), {}) if request["size"] is None else _mesh(path, request)
    except BaseException as problem:  # a script is the user's own program and may raise anything
        found, arrays = {"reason": _reason(problem, path)}, {}
    try:
        if arrays:
            np.savez(folder / "mesh.npz", **arrays)
        (folder / "answer.part").write_text(json.dumps(found))
        (folder / "answer.part").replace(folder / "answer.json")
    except OSError:  # nor can it be told why
        raise SystemExit(UNWRITTEN) from None


def _sizes(path: Path) -> dict[str, Any]:
    script = load_script(path)
    return {"sizes": {str(name): float(_size(script, str(name), 1.0)) for name in getattr(script, "SIZES", {})}}


def _mesh(path: Path, request: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the script read, and the arrays of its mesh."""
    size = request["size"]
    if request["graded"] is not None:
        size = GradedSize(size, *request["graded"])
    with opened_files() as heard:
        script = load_script(path)
        surface = _surface(script.build(request["part"], _size(script, size, request["share"])))
    read = Dependencies.of(path, _declared(script), heard)
    arrays = {"points": surface.points, "triangles": surface.triangles}
    if surface.given_normals is not None:
        arrays["normals"] = surface.given_normals
    return read.header(), arrays


def _reason(problem: BaseException, path: Path) -> str:
    """What went wrong in a script, and the remedy."""
    if isinstance(problem, SystemExit):
        return "the script exits instead of returning a mesh; take the exit out"
    if not isinstance(problem, ImportError):
        return _words(problem, path)
    missing = (problem.name or "").split(".")[0]
    if (path.parent / f"{missing}.py").is_file():
        return f"imports {missing}, a file beside it; write the script as one file"
    if not isinstance(problem, ModuleNotFoundError) or not missing:
        return f"{problem}; see that it is installed as the script needs it"
    return f"needs the package {missing}; install it: pip install {PACKAGES.get(missing, missing)}"


def _words(problem, path):
    """What an error in a script says, with its kind and line unless it was raised on purpose."""
    text = " ".join(str(problem).split())
    lines = [frame.lineno for frame in traceback.extract_tb(problem.__traceback__) if frame.filename == str(path)]
    where = f" (line {lines[-1]} of the script)" if lines else ""
    if isinstance(problem, ValueError) and text:
        return text + where + "; mend the script" * (";" not in text)
    return f"{type(problem).__name__}{text and ': ' + text}{where}; mend the script"


def _size(script, size, share):
    """A share of an element size, in mm."""
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
    """The files that a script declares to read."""
    names = getattr(script, "DEPENDS", [])
    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
        raise ValueError("DEPENDS must be a list of file names, relative to the script")
    for name in names:
        if not (Path(script.__file__).parent / name).is_file():
            raise ValueError(f"DEPENDS names {name}, and there is no such file beside the script")
    return list(names)


def _surface(built):
    """The surface that ``build`` returned, its arrays checked: they come from anywhere."""
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
            raise ValueError(f"build returned {name} that are no numbers ({array.dtype})")
    if triangles.dtype.kind == "f" and not (np.isfinite(triangles) & (triangles == np.rint(triangles))).all():
        raise ValueError("build returned triangles that are no whole numbers")
    return Surface(points, triangles, *normals)


def _main() -> NoReturn:
    _answer(Path(sys.argv[1]))
    os._exit(0)  # whatever the script has left running


if __name__ == "__main__":
    _main()
