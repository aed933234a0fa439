"""Curved panels, their meshes, and the functionals that tests read on them."""

import numpy as np

from mic.compliance.functional import Functionals
from mic.geometry.surface import Surface

E, NU, T = 210000.0, 0.3, 1.2  # MPa, 1, mm
PLACES = [[10.0, 10.0, 3.0], [45.0, 20.0, 8.0], [20.0, 40.0, 8.0]]


def cells(nx, ny, pattern="cross"):
    """Triangles of a grid of nx × ny cells, divided along one diagonal ("right") or in alternation ("cross")."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    a = i * (ny + 1) + j
    b, c, d = a + ny + 1, a + ny + 2, a + 1
    other = ((pattern == "cross") & ((i + j) % 2 == 1))[:, None]
    first = np.where(other, np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    second = np.where(other, np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    return np.concatenate([first, second])


def grid(nx, ny, shape, jitter=0.0, pattern="right"):
    """Triangulated unit square (X, Y), nx × ny cells (:func:`cells`), carried into space by `shape`(X, Y) → (n, 3).

    Interior vertices move by up to `jitter` cells first (always in the same way).
    """
    X, Y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, nx + 1), np.linspace(0, 1, ny + 1), indexing="ij"))
    random = np.random.default_rng(20)
    inside_x, inside_y = (X > 1e-9) & (X < 1 - 1e-9), (Y > 1e-9) & (Y < 1 - 1e-9)
    X = X + inside_x * jitter / nx * random.uniform(-1, 1, X.shape)
    Y = Y + inside_y * jitter / ny * random.uniform(-1, 1, Y.shape)
    return Surface(shape(X, Y), cells(nx, ny, pattern))


def plane(z=0.0, size=20.0, n=8, flip=False, tilt=0.0, x0=0.0):
    """A flat square from (x0, 0, z), n × n cells, tilted about y; flipped, its normals point down."""
    flat = grid(n, n, lambda X, Y: np.column_stack([size * X + x0, size * Y, z + np.tan(tilt) * size * X]))
    return Surface(flat.points, flat.triangles[:, ::-1]) if flip else flat


def panel(n=8):
    """A doubly curved panel of 60 × 50 mm, n × n cells of irregular shape."""
    return grid(
        n, n, lambda X, Y: np.column_stack([60 * X, 50 * Y, 8 * np.sin(2 * X + Y)]), jitter=0.2, pattern="cross"
    )


def some_normals(surface, seed=0):
    """Arbitrary normals (k, 3, 3) at the corners, some ten degrees off the triangles' own."""
    normals = surface.normals[:, None] + 0.2 * np.random.default_rng(seed).normal(size=(len(surface.triangles), 3, 3))
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def functionals(surface, places, radius):
    """Twelve rows at every place: displacements at the three levels (side −1, 0, 1) and rotations, x, y, z each."""
    patches = tuple(surface.patch(place, radius) for place in places)
    n = len(patches)
    return Functionals(
        patches=patches,
        patch=np.repeat(np.arange(n), 12),
        direction=np.tile(np.eye(3), (4 * n, 1)),
        rotation=np.tile([False] * 9 + [True] * 3, n),
        side=np.tile(np.repeat([-1, 0, 1, 0], 3), n),
        label=tuple(f"row {i}" for i in range(12 * n)),
    )
