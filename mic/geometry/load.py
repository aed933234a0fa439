"""Surfaces of a scene's parts and fixtures: read from mesh files, built by geometry scripts, or round pads.

A geometry script is a Python file that defines ``build(part, size) -> (points, triangles)``: the mid-surface of one
part as points (n, 3) in mm and triangles (k, 3). ``SIZES``, a dict, may give names to sizes in mm.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from mic.cache import ABSENT, Cache
from mic.errors import SceneError
from mic.geometry import structured
from mic.geometry.surface import Surface
from mic.store import Format

__all__ = ["fixture_surface", "load_script", "part_surface"]

GENERATED = Format("generated mesh", 2, ABSENT)

PACKAGES = {"gmsh": "'mic-contact[mesh]'"}  # what pip installs for a module that the shipped scripts import


def part_surface(part: Any, folder: Path, cache: Path) -> Surface:
    """Surface of a part, from its mesh file or its geometry script.

    A generated mesh is kept in `cache` under the hash of the part's name, the size, and all Python files of the
    script's folder and of the folder above, which it may import; see :mod:`mic.cache` for what is believed of it.

    Parameters
    ----------
    part : mic.scene.schema.Part
    folder : Path
        Of the scene file; the part's paths are relative to it.
    cache : Path

    Raises
    ------
    SceneError
        Naming part, key and file, where the file is missing, unusable, or fails.
    """
    key = "mesh" if part.mesh is not None else "geometry"
    path = folder / getattr(part, key)
    if not path.is_file():
        raise SceneError(
            f"part {part.name!r}: {key}: there is no file {path}; correct the name (it is relative to the scene file)"
        )
    if part.mesh is not None:
        return _read(f"part {part.name!r}", path)
    meshes, identity = Cache(cache, "meshes", GENERATED), _identity(part, path)
    kept = meshes.find(identity)
    if kept is not None:
        _, arrays = kept
        return Surface(arrays["points"], arrays["triangles"])
    surface = _generate(part, path)
    meshes.keep(identity, {}, {"points": surface.points, "triangles": surface.triangles})
    return surface


def fixture_surface(fixture: Any, folder: Path) -> Surface:
    """Surface of a rigid fixture: its mesh, or a flat round pad with its normal outwards.

    Parameters
    ----------
    fixture : mic.scene.schema.Fixture
    folder : Path
        Of the scene file; the fixture's mesh is relative to it.

    Raises
    ------
    SceneError
        Naming fixture, key and file, where the mesh is missing or unusable.
    """
    if fixture.mesh is not None:
        path = folder / fixture.mesh
        if not path.is_file():
            raise SceneError(f"fixture {fixture.name!r}: mesh: there is no file {path}; correct the name")
        return _read(f"fixture {fixture.name!r}", path)
    n = np.array(fixture.normal)
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    rim = fixture.radius * (np.cos(angle)[:, None] * t + np.sin(angle)[:, None] * np.cross(n, t))
    triangles = np.column_stack([np.zeros(36, int), 1 + np.arange(36), 1 + (np.arange(36) + 1) % 36])
    return Surface(np.vstack([np.zeros(3), rim]) + fixture.point, triangles)


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


def _read(owner, path):
    from mic.geometry.readers import read_mesh  # the libraries behind it are slow to import; scripts do not need them

    try:
        points, triangles, _ = read_mesh(path)
        return Surface(points, triangles)
    except ValueError as problem:
        raise SceneError(f"{owner}: mesh: {problem}") from problem


def _identity(part, path):
    """Hash of what a generated mesh depends on."""
    digest = hashlib.sha256(repr((part.name, part.size, path.name)).encode())
    sources = sorted([*path.parent.glob("*.py"), *path.parent.parent.glob("*.py")])
    for source in [Path(structured.__file__), *sources]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:32]


def _generate(part, path):
    """Run a geometry script; whatever goes wrong in it ends in one sentence."""
    try:
        script = load_script(path)
        return _surface(script.build(part.name, _size(script, part.size)))
    except ImportError as problem:
        missing = (problem.name or "").split(".")[0]
        if (path.parent / f"{missing}.py").is_file():
            reason = f"imports {missing}, a file beside it; write the script as one file"
        elif not isinstance(problem, ModuleNotFoundError) or not missing:
            reason = f"{problem}; see that it is installed as the script needs it"
        else:
            reason = f"needs the package {missing}; install it: pip install {PACKAGES.get(missing, missing)}"
        cause: BaseException = problem
    except SystemExit as problem:
        reason, cause = "the script exits instead of returning a mesh; take the exit out", problem
    except Exception as problem:  # a script is the user's own program and may raise anything
        reason, cause = _words(problem, path), problem
    raise SceneError(f"part {part.name!r}: geometry: {path}: {reason}") from cause


def _words(problem, path):
    """What an error in a script says, with its kind and line unless it was raised on purpose."""
    text = " ".join(str(problem).split())
    lines = [frame.lineno for frame in traceback.extract_tb(problem.__traceback__) if frame.filename == str(path)]
    where = f" (line {lines[-1]} of the script)" if lines else ""
    if isinstance(problem, ValueError) and text:
        return text + where
    return f"{type(problem).__name__}: {text}{where}" if text else f"{type(problem).__name__}{where}"


def _size(script, size):
    """Element size in mm."""
    if not isinstance(size, str):
        return size
    sizes = getattr(script, "SIZES", {})
    if not isinstance(sizes, dict):
        raise ValueError(f"SIZES must be a dict of mm by name, not {type(sizes).__name__}")
    if size not in sizes:
        raise ValueError(f"there is no size called {size!r}; known: {', '.join(map(str, sizes)) or 'none, give mm'}")
    return sizes[size]


def _surface(built):
    """The surface that ``build`` returned, its arrays checked: they come from anywhere."""
    if not isinstance(built, (tuple, list)) or len(built) != 2:
        raise ValueError(f"build must return two arrays, points and triangles, not {type(built).__name__}")
    try:
        points, triangles = (np.asarray(array) for array in built)
    except ValueError:
        raise ValueError("build returned points or triangles whose rows differ in length") from None
    for name, array in (("points", points), ("triangles", triangles)):
        if array.dtype.kind not in "iuf":
            raise ValueError(f"build returned {name} that are no numbers ({array.dtype})")
    if triangles.dtype.kind == "f" and not (np.isfinite(triangles) & (triangles == np.rint(triangles))).all():
        raise ValueError("build returned triangles that are no whole numbers")
    return Surface(points, triangles)
