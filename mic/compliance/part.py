"""Parts and rigid fixtures of a scene: reading or generating their surfaces."""

from __future__ import annotations

import hashlib
import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mic.compliance.functional import Functionals
from mic.geometry.surface import Surface
from mic.scene import SceneError

__all__ = ["Part", "fixture_surface", "part_surface"]


@dataclass(frozen=True)
class Part:
    """One sheet with its retained functionals.

    Attributes
    ----------
    name : str
    surface : Surface
    thickness : float
        mm.
    young : float
        MPa.
    poisson : float
    element : str
        Shell element, ``"dkt-opt"`` or ``"p2-cr"``.
    functionals : Functionals
    """

    name: str
    surface: Surface
    thickness: float
    young: float
    poisson: float
    element: str
    functionals: Functionals

    def fingerprint(self) -> str:
        """Hash of everything that the part's influence coefficients depend on."""
        digest = hashlib.sha256()
        f = self.functionals
        digest.update(repr((3, self.element, self.thickness, self.young, self.poisson)).encode())
        arrays = [self.surface.points, self.surface.triangles, f.patch, f.direction, f.rotation, f.side]
        arrays += [array for patch in f.patches for array in (patch.triangle, patch.barycentric, patch.weight)]
        for array in arrays:
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:32]


def part_surface(part, folder: Path, cache: Path) -> Surface:
    """Surface of a scene's part, from its mesh file or its geometry source.

    A generated mesh is kept in `cache` under the hash of the part's name, the size, and all Python files of the
    source's folder and of the folder above, which it may import.

    Raises
    ------
    SceneError
        Naming the key, for a missing or unusable file.
    """
    key = "mesh" if part.mesh is not None else "geometry"
    path = folder / getattr(part, key)
    if not path.is_file():
        raise SceneError(
            f"part {part.name!r}: {key}: there is no file {path}; correct the name (it is relative to the scene file)"
        )
    try:
        if part.mesh is not None:
            return _read(path)
        sources = sorted([*path.parent.glob("*.py"), *path.parent.parent.glob("*.py")])
        digest = hashlib.sha256(repr((part.name, part.size, path.name)).encode())
        for source in sources:
            digest.update(source.read_bytes())
        identity = digest.hexdigest()[:32]
        kept = cache / "meshes" / f"{identity}.npz"
        if kept.is_file():
            with np.load(kept) as data:
                return Surface(data["points"], data["triangles"])
        points, triangles = _generate(path, part.name, part.size)
        surface = Surface(points, triangles)
        kept.parent.mkdir(parents=True, exist_ok=True)
        temporary = kept.with_suffix(f".{os.getpid()}.partial.npz")
        np.savez(temporary, points=surface.points, triangles=surface.triangles)
        temporary.replace(kept)
        return surface
    except (ValueError, KeyError, ImportError, OSError) as error:
        raise SceneError(f"part {part.name!r}: {key}: {path}: {error}") from error


def fixture_surface(fixture, folder: Path) -> Surface:
    """Surface of a rigid fixture: its mesh, or a flat round pad with its normal outwards."""
    if fixture.mesh is not None:
        path = folder / fixture.mesh
        if not path.is_file():
            raise SceneError(f"fixture {fixture.name!r}: mesh: there is no file {path}; correct the name")
        try:
            return _read(path)
        except ValueError as error:
            raise SceneError(f"fixture {fixture.name!r}: mesh: {path}: {error}") from error
    n = np.array(fixture.normal)
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    rim = fixture.radius * (np.cos(angle)[:, None] * t + np.sin(angle)[:, None] * np.cross(n, t))
    triangles = np.column_stack([np.zeros(36, int), 1 + np.arange(36), 1 + (np.arange(36) + 1) % 36])
    return Surface(np.vstack([np.zeros(3), rim]) + fixture.point, triangles)


def _read(path):
    from mic.geometry.repair import read_mesh  # meshio is slow to import; generated parts do not need it

    points, triangles, _ = read_mesh(path)
    return Surface(points, triangles)


def _generate(path, name, size):
    spec = importlib.util.spec_from_file_location(f"mic_geometry_{path.parent.name}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, "build"):
        raise ValueError("a geometry source must define build(part, size) -> (points, triangles)")
    if isinstance(size, str):
        sizes = getattr(module, "SIZES", {})
        if size not in sizes:
            raise ValueError(f"there is no size called {size!r}; known: {', '.join(sizes) or 'none, give mm'}")
        size = sizes[size]
    return module.build(name, size)
