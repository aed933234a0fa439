"""Scenes of flat rectangular sheets, for cases with closed-form solutions.

A sheet is in a plane z = const, from ``x`` to ``x + length`` and from y = 0 to ``width``. Its mesh is written to a file
and read like a user's part.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from mic.geometry.readers.vtu import write_vtu
from mic.geometry.structured import extrude
from mic.scene import Scene

__all__ = ["build", "line", "write_mesh"]


def write_mesh(folder: Path, points: np.ndarray, triangles: np.ndarray) -> str:
    """Write a mesh under the hash of its content; returns the file's name.

    Parameters
    ----------
    folder : Path
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
    """
    points, triangles = np.ascontiguousarray(points, dtype=float), np.ascontiguousarray(triangles, dtype=np.int64)
    name = hashlib.sha256(points.tobytes() + triangles.tobytes()).hexdigest()[:16] + ".vtu"
    if not (folder / name).is_file():
        write_vtu(folder / name, points, triangles)
    return name


def build(folder: Path, sheets: dict, turn: np.ndarray | None = None, **tables) -> Scene:
    """A scene of flat sheets.

    Parameters
    ----------
    folder : Path
        Folder for the meshes.
    sheets : dict
        By part name: ``x, z, length, width, size`` (mm) of the mesh, and the keys of the scene's part.
    turn : (3, 3) array
        Rotation of the meshes about the origin (none by default); the other keys are not turned.
    tables
        The other keys of the scene; clamps of a stage close together.
    """
    clamping = [stage for stage in tables["stages"] if stage["kind"] == "clamp"]
    for stage in clamping:  # a distributed load is many clamps that close together
        name = stage.get("name", "clamp")
        together = [
            clamp["name"] for clamp in tables["clamps"] if clamp.get("stage", clamping[0].get("name", "clamp")) == name
        ]
        if together:
            stage["order"] = [together]
    parts = []
    for name, sheet in sheets.items():
        x, z, length, width, size = (sheet[key] for key in ("x", "z", "length", "width", "size"))
        points, triangles, _ = extrude([(0.0, z), (width, z)], x, length, size)
        mesh = write_mesh(folder, points if turn is None else points @ np.asarray(turn).T, triangles)
        parts.append({"name": name, "mesh": mesh} | {key: sheet[key] for key in ("thickness", "young", "poisson")})
    return Scene(parts=parts, folder=folder, **tables)


def line(start: float, end: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Equidistant points and the shares of a uniform line load that fall to them (trapezoidal rule)."""
    share = np.ones(count)
    share[[0, -1]] = 0.5
    return np.linspace(start, end, count), share / share.sum()
