"""Small sheets, and Abaqus decks of them as an exporter writes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

__all__ = ["annulus", "arc", "drilled", "extruded", "grid", "write_deck"]


def grid(length: float, width: float, size: float, z: float = 0.0, x: float = 0.0, y: float = 0.0):
    """Points (n, 3) and quadrilaterals (k, 4) of a flat rectangle from (x, y), its normal along z."""
    return extruded([(x, z), (x + length, z)], y, y + width, size)


def extruded(profile, start: float, stop: float, size: float):
    """A profile in (x, z), polyline, drawn along y from start to stop: points (n, 3) and quadrilaterals (k, 4)."""
    corners = np.asarray(profile, dtype=float)
    along = [corners[:1]]
    for a, b in zip(corners, corners[1:]):
        n = max(1, round(float(np.linalg.norm(b - a)) / size))
        along.append(a + (b - a) * np.arange(1, n + 1)[:, None] / n)
    xz = np.concatenate(along)
    y = np.linspace(start, stop, max(1, round((stop - start) / size)) + 1)
    points = np.array([[px, py, pz] for py in y for px, pz in xz])
    n = len(xz)
    quads = [
        [j * n + i, j * n + i + 1, (j + 1) * n + i + 1, (j + 1) * n + i]
        for j in range(len(y) - 1)
        for i in range(n - 1)
    ]
    return points, np.array(quads)


def annulus(centre, inner: float, outer: float, around: int = 24, rings: int = 5):
    """A flat ring about `centre`, its normal along z: points (n, 3) and quadrilaterals (k, 4)."""
    angle = 2 * np.pi * np.arange(around) / around
    radii = np.linspace(inner, outer, rings + 1)
    points = np.array([[r * np.cos(a), r * np.sin(a), 0.0] for r in radii for a in angle]) + np.asarray(centre, float)
    quads = [
        [r * around + k, (r + 1) * around + k, (r + 1) * around + (k + 1) % around, r * around + (k + 1) % around]
        for r in range(rings)
        for k in range(around)
    ]
    return points, np.array(quads)


def drilled(length: float, width: float, radius: float, z: float = 0.0, around: int = 24, rings: int = 3):
    """A flat rectangle from the origin, about twice as long as wide, with two round holes: points, quadrilaterals."""
    points, quads = [], []
    for block in (0, 1):
        half = np.array([length / 4, width / 2])
        centre = np.array([length / 4 + block * length / 2, width / 2])
        angle = 2 * np.pi * (np.arange(around) + 0.5) / around
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        square = circle / np.abs(circle).max(axis=1, keepdims=True)
        for corner in np.pi / 4 + np.pi / 2 * np.arange(4):  # the ray nearest to each corner ends in it
            square[np.argmin(np.abs(np.angle(np.exp(1j * (angle - corner)))))] = np.sign(
                [np.cos(corner), np.sin(corner)]
            )
        first = len(points)
        for ring in range(rings + 1):
            share = ring / rings
            flat = centre + (1 - share) * radius * circle + share * half * square
            points += [[x, y, z] for x, y in flat]
        for ring in range(rings):
            a = first + ring * around + np.arange(around)
            b = first + ring * around + (np.arange(around) + 1) % around
            quads += np.column_stack([a, a + around, b + around, b]).tolist()
    return np.array(points), np.array(quads)


def arc(radius: float, low: float, high: float, size: float, centre=(0.0, 0.0)):
    """A profile in (x, z) on a circle, from one angle in degrees to another."""
    n = max(2, round(np.radians(high - low) * radius / size))
    angle = np.radians(np.linspace(low, high, n + 1))
    return [(centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a)) for a in angle]


def write_deck(
    path: Path,
    sheets: Mapping[str, tuple[np.ndarray, np.ndarray]],
    node_sets: Mapping[str, list[int]] | None = None,
    first: int = 1001,
    sections: Mapping[str, float] | None = None,
    scale: float = 1.0,
) -> Path:
    """An Abaqus deck of several sheets of quadrilaterals or triangles, each an element set.

    Parameters
    ----------
    path : Path
    sheets : mapping of str to (points, elements)
    node_sets : mapping of str to list of int, optional
        Numbers as the deck has them: `first` for the first point of the first sheet, and so on.
    first : int
    sections : mapping of str to float, optional
        Thickness by element set, of steel.
    scale : float
        Of all lengths.
    """
    nodes, elements, number, element = ["*NODE"], [], first, 1
    for name, (points, cells) in sheets.items():
        nodes += [f"{number + i}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate((scale * points).tolist())]
        elements += [f"*ELEMENT, TYPE={'S4R' if cells.shape[1] == 4 else 'S3'}, ELSET={name}"]
        elements += [", ".join(map(str, [element + i, *(number + row)])) for i, row in enumerate(np.asarray(cells))]
        number, element = number + len(points), element + len(cells)
    for name, numbers in (node_sets or {}).items():
        elements += [f"*NSET, NSET={name}", ", ".join(map(str, numbers))]
    for name, thickness in (sections or {}).items():
        elements += [f"*SHELL SECTION, ELSET={name}, MATERIAL=STEEL", f"{scale * thickness!r}, 5"]
    if sections:
        elements += ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{210e3 / scale**2!r}, 0.3"]
    path.write_text("\n".join(nodes + elements) + "\n")
    return path
