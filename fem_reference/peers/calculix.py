"""Linear shells by CalculiX: write its input, run ccx, read its results. Debian: apt-get install calculix-ccx.

CalculiX has no shell theory of its own: it expands each quadratic shell into a solid (S6 into a wedge, S8R into a
brick of reduced integration) and ties them at folds. It shares only the geometry with `fem_reference.shell.element`. At
usual element sizes its shells are several per cent too stiff on curved sheets, so a single mesh is not a reference:
:mod:`fem_reference.peers.references` extrapolates from three.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.sparse import csc_matrix, triu

__all__ = ["CalculixError", "available", "quadratic", "read", "run", "shell_displacements", "stiffness"]

SHELLS = {6: "S6", 8: "S8R"}  # CalculiX's shell by its number of nodes: corners, then midsides


class CalculixError(RuntimeError):
    """ccx is missing or did not deliver displacements; the message holds its last lines."""


def available() -> bool:
    """Whether ccx is on the path."""
    return shutil.which("ccx") is not None


def quadratic(
    coordinates: np.ndarray, corners: np.ndarray, shape: Callable[[np.ndarray], np.ndarray] = lambda x: x
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (m, 3), mm, and quadratic elements (k, 6 or 8) from elements given by their corners.

    Parameters
    ----------
    coordinates : (n, c) array
        Coordinates of the corners, in the parameters that `shape` takes; they become the first n nodes.
    corners : (k, 3 or 4) int array
    shape : callable
        Maps coordinates (n, c) to positions (n, 3), mm. Midpoints are taken in coordinates, so that they lie on the
        surface too; by default coordinates are positions and sides are straight.
    """
    sides = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, of_side = np.unique(sides, axis=0, return_inverse=True)
    nodes = shape(np.vstack([coordinates, coordinates[edges].mean(axis=1)]))
    return nodes, np.hstack([corners, len(coordinates) + of_side.reshape(corners.shape)])


def shell_displacements(
    nodes: np.ndarray,
    elements: np.ndarray,
    thickness: float,
    young: float,
    poisson: float,
    clamped: np.ndarray,
    forces: np.ndarray,
) -> np.ndarray:
    """Displacements (n, 3, r), mm, of the first n nodes of a clamped sheet under r load cases.

    Parameters
    ----------
    nodes, elements
        As returned by :func:`quadratic`.
    thickness, young, poisson : float
        mm, MPa.
    clamped : (m,) bool array
        Nodes held in all six freedoms.
    forces : (n, 3, r) array
        N, at the first n nodes.

    Raises
    ------
    CalculixError
    """
    text = run(_deck(nodes, elements, thickness, young, poisson, clamped, forces))
    displacements = read(text, len(forces))
    if displacements.shape[2] != forces.shape[2]:
        raise CalculixError(f"ccx solved {displacements.shape[2]} of {forces.shape[2]} load cases")
    return displacements


def stiffness(mesh: str) -> tuple[csc_matrix, np.ndarray]:
    """The stiffness matrix of an unsupported mesh, N/mm.

    Parameters
    ----------
    mesh : str
        An input deck without steps; its material needs a density.

    Returns
    -------
    K : (d, d) csc_matrix
        Includes the internal freedoms of incompatible modes.
    freedom : (d, 2) int array
        Node (from 1) and axis (from 0) of each.

    Raises
    ------
    CalculixError
    """
    deck = mesh + "*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n1\n*END STEP\n"
    entries, names = (io.StringIO(text) for text in _solved(deck, ".sti", ".dof"))
    row, column, value = np.loadtxt(entries, ndmin=2).T  # of its upper triangle
    freedom = np.array([name.split(".") for name in names.read().split()], dtype=np.int64) - [0, 1]
    upper = csc_matrix((value, (row.astype(int) - 1, column.astype(int) - 1)), shape=(len(freedom), len(freedom)))
    return csc_matrix(upper + triu(upper, 1).T), freedom


def run(deck: str) -> str:
    """Solve an input deck by ccx and return its .dat file.

    Raises
    ------
    CalculixError
    """
    return _solved(deck, ".dat")[0]


def _solved(deck: str, *suffixes: str) -> list[str]:
    """Solve an input deck by ccx and return its output files with these suffixes."""
    if not available():
        raise CalculixError("ccx is not installed: apt-get install calculix-ccx")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "deck.inp"
        path.write_text(deck)
        outcome = subprocess.run(["ccx", "-i", "deck"], cwd=folder, capture_output=True, text=True)
        results = [path.with_suffix(suffix) for suffix in suffixes]
        if outcome.returncode or not all(one.is_file() for one in results) or "*ERROR" in outcome.stdout:
            raise CalculixError("ccx failed:\n" + "\n".join(outcome.stdout.splitlines()[-10:]) + outcome.stderr)
        return [one.read_text() for one in results]


def _deck(nodes, elements, thickness, young, poisson, clamped, forces) -> str:
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i}, {x:.12e}, {y:.12e}, {z:.12e}" for i, (x, y, z) in enumerate(nodes, start=1)]  # counted from 1
    lines += ["*NSET, NSET=READ, GENERATE", f"1, {len(forces)}, 1"]
    lines += [f"*ELEMENT, TYPE={SHELLS[elements.shape[1]]}, ELSET=SHEET"]
    lines += [", ".join(map(str, [k, *own])) for k, own in enumerate((elements + 1).tolist(), start=1)]
    lines += ["*MATERIAL, NAME=SHEET", "*ELASTIC", f"{young!r}, {poisson!r}"]
    lines += ["*SHELL SECTION, ELSET=SHEET, MATERIAL=SHEET", f"{thickness!r}"]
    lines += ["*BOUNDARY", *(f"{node}, 1, 6" for node in np.flatnonzero(clamped) + 1)]
    for case in np.moveaxis(forces, 2, 0):
        lines += ["*STEP", "*STATIC", "*CLOAD, OP=NEW"]
        loaded = np.argwhere(case)
        lines += [f"{node + 1}, {axis + 1}, {case[node, axis]:.12e}" for node, axis in loaded]
        lines += ["*NODE PRINT, NSET=READ", "U", "*END STEP"]
    return "\n".join(lines) + "\n"


def read(text: str, n: int, printed=None) -> np.ndarray:
    """(p, 3, steps) displacements of the printed nodes, by default all n, from the text of a .dat file."""
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
