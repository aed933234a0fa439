"""Linear shells by CalculiX: its input written, ccx run, its results read. Debian: apt-get install calculix-ccx.

CalculiX has no shell theory of its own: it expands each quadratic triangle S6 into a solid wedge and ties them at
folds, so that nothing but the geometry is shared with `fem_reference.shell.element`.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from mic.geometry.surface import Surface

__all__ = ["CalculixError", "available", "read", "run", "shell_displacements"]


class CalculixError(RuntimeError):
    """ccx is missing or did not deliver displacements; the text holds its last lines."""


def available() -> bool:
    """Whether ccx is on the path."""
    return shutil.which("ccx") is not None


def shell_displacements(
    surface: Surface, thickness: float, young: float, poisson: float, clamped: np.ndarray, forces: np.ndarray
) -> np.ndarray:
    """Displacements (n, 3, r), mm, of the vertices of a sheet clamped along edges, under r load cases.

    Parameters
    ----------
    surface : Surface
        Of n points, mm; the triangles become S6 elements with straight sides.
    thickness, young, poisson : float
        mm, MPa.
    clamped : (n,) bool array
        Vertices held in all six freedoms, and with them the midpoints of the edges between two of them.
    forces : (n, 3, r) array
        N, at the vertices.

    Raises
    ------
    CalculixError
    """
    displacements = read(run(_deck(surface, thickness, young, poisson, clamped, forces)), len(surface.points))
    if displacements.shape[2] != forces.shape[2]:
        raise CalculixError(f"ccx solved {displacements.shape[2]} of {forces.shape[2]} load cases")
    return displacements


def run(deck: str) -> str:
    """Let ccx solve an input deck; returns what its prints wrote to the .dat file.

    Raises
    ------
    CalculixError
    """
    if not available():
        raise CalculixError("ccx is not installed: apt-get install calculix-ccx")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "deck.inp"
        path.write_text(deck)
        outcome = subprocess.run(["ccx", "-i", "deck"], cwd=folder, capture_output=True, text=True)
        results = path.with_suffix(".dat")
        if outcome.returncode or not results.is_file() or "*ERROR" in outcome.stdout:
            raise CalculixError("ccx failed:\n" + "\n".join(outcome.stdout.splitlines()[-10:]) + outcome.stderr)
        return results.read_text()


def _deck(surface, thickness, young, poisson, clamped, forces) -> str:
    triangles, n = surface.triangles, len(surface.points)
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    edges, of_side = np.unique(sides, axis=0, return_inverse=True)
    midpoints = surface.points[edges].mean(axis=1)
    elements = np.hstack([triangles, n + of_side.reshape(3, -1).T]) + 1  # CalculiX counts from 1
    held = np.concatenate([np.flatnonzero(clamped), n + np.flatnonzero(clamped[edges].all(axis=1))]) + 1
    lines = ["*NODE, NSET=ALL"]
    lines += [
        f"{i}, {x:.12e}, {y:.12e}, {z:.12e}"
        for i, (x, y, z) in enumerate(np.vstack([surface.points, midpoints]), start=1)
    ]
    lines += ["*NSET, NSET=VERTICES, GENERATE", f"1, {n}, 1"]
    lines += ["*ELEMENT, TYPE=S6, ELSET=SHEET"]
    lines += [", ".join(map(str, [k, *nodes])) for k, nodes in enumerate(elements.tolist(), start=1)]
    lines += ["*MATERIAL, NAME=SHEET", "*ELASTIC", f"{young!r}, {poisson!r}"]
    lines += ["*SHELL SECTION, ELSET=SHEET, MATERIAL=SHEET", f"{thickness!r}"]
    lines += ["*BOUNDARY", *(f"{node}, 1, 6" for node in held)]
    for case in np.moveaxis(forces, 2, 0):
        lines += ["*STEP", "*STATIC", "*CLOAD, OP=NEW"]
        loaded = np.argwhere(case)
        lines += [f"{node + 1}, {axis + 1}, {case[node, axis]:.12e}" for node, axis in loaded]
        lines += ["*NODE PRINT, NSET=VERTICES", "U", "*END STEP"]
    return "\n".join(lines) + "\n"


def read(text: str, n: int, printed=None) -> np.ndarray:
    """The tables "displacements (vx,vy,vz) for set …" of a .dat file: (p, 3, steps) of the printed nodes, by default
    all n."""
    printed = np.arange(1, n + 1) if printed is None else np.asarray(printed)
    cases = []
    for line in text.splitlines():
        if line.strip().startswith("displacements"):
            cases.append(np.full((n, 3), np.nan))
        elif line.strip() and cases:
            node, *values = line.split()
            cases[-1][int(node) - 1] = [float(value) for value in values]
    if not cases or np.isnan([case[printed - 1] for case in cases]).any():
        raise CalculixError("ccx printed no displacements for some nodes")
    return np.stack([case[printed - 1] for case in cases], axis=2)
