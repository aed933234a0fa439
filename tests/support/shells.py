"""Freedoms, loads and supports of a shell part, found by where they are."""

import numpy as np
import pytest

from fem_reference.peers import calculix
from fem_reference.shell.factorisation import Factorisation
from fem_reference.shell.part import ShellPart
from support.panels import NU, PLACES, E, functionals, panel

SHEETS = {"left": (1.2, 5), "right": (0.8, 6), "middle": (1.0, 4)}  # thickness in mm, cells along each side

needs_ccx = pytest.mark.skipif(not calculix.available(), reason="ccx is not installed: apt-get install calculix-ccx")


def several_parts():
    """Three panels and their functionals, by name: what `compute_influence` takes."""
    surfaces = {name: panel(n) for name, (_, n) in SHEETS.items()}
    rows = {name: functionals(surface, PLACES, 6.0) for name, surface in surfaces.items()}
    parts = {name: (lambda name=name: ShellPart(surfaces[name], SHEETS[name][0], E, NU)) for name in SHEETS}
    return parts, rows


def at(part, where, components):
    """Freedoms of the given components (0…2 displacements, 3…5 rotations) at the points x (n, 3) for which `where`(x)
    holds."""
    return np.flatnonzero(where(part.dof_position) & np.isin(part.dof_component, components))


def vertex(part, point):
    """Number of the vertex nearest to a point."""
    return int(np.argmin(np.linalg.norm(part.surface.points - np.asarray(point, dtype=float), axis=1)))


def vertex_load(part, point, force):
    """Load vector (ndof,) of a force (3,) at a vertex."""
    load = np.zeros(part.ndof)
    load[part.vertex_displacement_dofs[vertex(part, point)]] = force
    return load


def supported_solution(part: ShellPart, fixed, load, prescribed=None):
    """Freedoms (ndof,) under a load with some freedoms held at zero or at `prescribed` (ndof,) values."""
    freedoms = np.zeros(part.ndof) if prescribed is None else prescribed.copy()
    free = np.setdiff1d(np.arange(part.ndof), np.concatenate([np.ravel(f) for f in fixed]))
    freedoms[free] = 0
    K = part.stiffness_csr()
    freedoms[free] = Factorisation(K[free][:, free]).solve((load - K @ freedoms)[free, None])[:, 0]
    return freedoms


def read(part, freedoms, point):
    """Displacement (3,) of the vertex nearest to a point."""
    return freedoms[part.vertex_displacement_dofs[vertex(part, point)]]
