"""Meshes and supports that the shell tests share."""

import numpy as np

from fem_reference.shell.factorisation import Factorisation
from fem_reference.shell.part import ShellPart
from mic.geometry.surface import Surface


def grid(nx, ny, shape, jitter=0.0, pattern="right"):
    """Triangulated unit square (X, Y), nx × ny cells, carried into space by `shape`(X, Y) → (n, 3).

    Interior vertices move by up to `jitter` cells first (always in the same way). `pattern` "right" divides all cells
    along the same diagonal, "cross" in alternation.
    """
    X, Y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, nx + 1), np.linspace(0, 1, ny + 1), indexing="ij"))
    random = np.random.default_rng(20)
    inside_x, inside_y = (X > 1e-9) & (X < 1 - 1e-9), (Y > 1e-9) & (Y < 1 - 1e-9)
    X = X + inside_x * jitter / nx * random.uniform(-1, 1, X.shape)
    Y = Y + inside_y * jitter / ny * random.uniform(-1, 1, Y.shape)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    a = i * (ny + 1) + j
    b, c, d = a + ny + 1, a + ny + 2, a + 1
    other = ((i + j) % 2 == 1) if pattern == "cross" else np.zeros(len(i), dtype=bool)
    first = np.where(other[:, None], np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    second = np.where(other[:, None], np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    return Surface(shape(X, Y), np.concatenate([first, second]))


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


def observed_rates(sizes, errors):
    """Slopes of log error over log size between successive meshes."""
    return np.diff(np.log(np.abs(errors))) / np.diff(np.log(sizes))
