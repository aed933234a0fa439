"""Meshes decimated to screen resolution; ParaView files hold the full ones."""

from __future__ import annotations

import numpy as np

from mic.geometry.surface import Surface

__all__ = ["MOST", "thinned"]

MOST = 3000  #: vertices of a part in a picture or view: two or three pixels from one to the next


def thinned(surface: Surface, most: int = MOST) -> tuple[np.ndarray, np.ndarray]:
    """One vertex of a surface for each cell of a cubic grid, and the triangles between them.

    Vertex clustering of J. Rossignac and P. Borrel (Modeling in Computer Graphics, 1993, 455-465).

    Parameters
    ----------
    surface : Surface
    most : int
        Vertices to be left; a surface that has no more is left as it is.

    Returns
    -------
    kept : (w,) int array
        Numbers of the vertices, ascending; of each cell that which is nearest to the middle of its vertices,
        on the sheet's edge where the cell has such.
    triangles : (s, 3) int array
        Into `kept`.
    """
    points, size = surface.points, np.sqrt(surface.areas.sum() / most)
    kept = np.arange(len(points))
    if len(points) <= most:
        return kept, surface.triangles
    while True:
        cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
        _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        if len(count) <= most:
            break
        size *= 1.1
    cell = cell.ravel()
    middle = np.column_stack([np.bincount(cell, weights=x) / count for x in points.T])
    order = np.lexsort((((points - middle[cell]) ** 2).sum(axis=1), ~surface.border_vertices, cell))
    kept = np.sort(order[np.searchsorted(cell[order], np.arange(len(count)))])
    place = np.empty(len(count), dtype=np.int64)
    place[cell[kept]] = np.arange(len(kept))
    triangles = place[cell[surface.triangles]]
    apart = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(triangles[apart], axis=1), axis=0, return_index=True)
    return kept, triangles[apart][np.sort(first)]
