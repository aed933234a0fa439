"""Error of dividing quadrilaterals by the choice of diagonal: the table of docs/shells.md.

    PYTHONPATH=. python benchmarks/quadrilaterals.py                  # sheets with a known surface, a minute
    PYTHONPATH=. python benchmarks/quadrilaterals.py DECK.inp 2.0     # a mesh file, thickness in mm

Error of the compliance normal to the sheet under self-equilibrated forces on 24 discs, per cent: Frobenius norm
relative to the limit. Sheets with a known surface have exact normals, and their limit is the same element on cells of a
quarter of the size with the discs at the same points. A mesh file has estimated normals; its limit is extrapolated from
the mesh divided once and twice on the surface that these normals define. Discs have a radius of 6 mm and keep away from
borders and bends.
"""

from __future__ import annotations

import argparse

import numpy as np

from fem_reference.peers.references import CASES
from fem_reference.shell.part import ShellPart
from mic.compliance.functional import Functionals
from mic.geometry.readers import read_raw
from mic.geometry.refinement import halved
from mic.geometry.repair import repair
from mic.geometry.surface import Surface

RADIUS, DISCS, YOUNG, POISSON = 6.0, 24, 210e3, 0.3  # mm, MPa
BENT = np.cos(np.radians(25))  # discs avoid places where the sheet turns by more
NONE = np.zeros((0, 3), dtype=int)


def one_way(points, cells):
    """Diagonals from each cell's corner of the lowest number."""
    first = np.argmin(cells, axis=1)
    turned = np.take_along_axis(cells, (first[:, None] + np.arange(4)) % 4, axis=1)
    return _halves(turned, np.zeros(len(cells), bool))


def shorter(points, cells):
    a, b, c, d = (points[cells[:, corner]] for corner in range(4))
    return _halves(cells, np.linalg.norm(b - d, axis=1) < np.linalg.norm(a - c, axis=1))


def as_done(points, cells):
    return repair(points, NONE, cells)[1]


def _halves(cells, other):
    cells = np.where(other[:, None], np.roll(cells, -1, axis=1), cells)
    return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


SPLITS = {"diagonals all one way": one_way, "the shorter ones": shorter, "as it is done": as_done}


def compliance(surface, thickness, places, directions):
    """Compliance at the discs under self-equilibrated forces."""
    patches = tuple(surface.patch(place, RADIUS, n) for place, n in zip(places, directions))
    rows = Functionals.displacements(patches, directions)
    return ShellPart(surface, thickness, YOUNG, POISSON, "dkt-opt-curved").influence(rows)


def off(found, limit):
    """Relative error, per cent, under forces in equilibrium on the mesh of the limit."""
    balanced = np.linalg.svd(limit[1])[0][:, 6:]
    a, b = (balanced.T @ H @ balanced for H in (found[0], limit[0]))
    return 100 * np.linalg.norm(a - b) / np.linalg.norm(b)


def row(name, errors):
    print(f"| {name} | {' | '.join(f'{error:.1f} %' for error in errors)} |", flush=True)


# ------------------------------------------------------------------------------------------------ sheets


def rectangle(height, skew=0.0):
    """``grid(size)`` of a sheet over 120 × 80 mm, its cells sheared along x by `skew`."""

    def grid(size):
        m, n = round(120 / size), round(80 / size)
        u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 120, m + 1), np.linspace(0, 80, n + 1), indexing="ij"))
        i, j = (a.ravel() for a in np.meshgrid(np.arange(m), np.arange(n), indexing="ij"))
        a = i * (n + 1) + j
        return np.column_stack([u + skew * v, v]), np.column_stack([a, a + n + 1, a + n + 2, a + 1])

    return grid, lambda at: np.column_stack([at, height(*at.T)]), 10.0, 1.0


def crown(x, y):
    return 10 * np.sin(np.pi * x / 120) * np.sin(np.pi * y / 80) + 4 * np.sin(np.pi * x / 120)


def cylinder(angle):
    """Cylinder of radius 120 mm with its generators at an angle to x, degrees."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return lambda x, y: np.sqrt(120.0**2 - (c * (y - 40) - s * (x - 60)) ** 2)


def panel():
    case = CASES["crowned panel"]
    return case.grid, case.shape, 5.0, case.thickness


SHEETS = {
    "crowned panel with a hole, 5 mm": panel(),
    "crowned sheet, 10 mm, square cells": rectangle(crown),
    "the same, cells skewed by 19°": rectangle(crown, np.tan(np.radians(19))),
    "cylinder along the cells, 10 mm": rectangle(cylinder(0)),
    "cylinder at 45° to the cells, 10 mm": rectangle(cylinder(45)),
}


def exact(shape, at, triangles):
    """The surface with its exact normals, by differences of its shape over the coordinates `at`."""
    h, points = 1e-5, shape(at)
    if at.shape[1] == 3:  # the panel, whose height is known over x and y
        x, y = points[:, :2].T
        zx = -50 * x / 14400 * (1 - 0.6 * (y / 80) ** 2) + y / 1600
        zy = -25 * (1 - (x / 120) ** 2) * 1.2 * y / 6400 + x / 1600
        normal = np.column_stack([-zx, -zy, np.ones(len(x))])
    else:
        step = np.eye(2) * h
        normal = np.cross(*(shape(at + e) - shape(at - e) for e in step))
    return Surface(points, triangles, normal[triangles])


def sheets():
    row_heads("mesh of quadrilaterals")
    for name, (grid, shape, size, thickness) in SHEETS.items():
        at, cells = grid(size)
        coarse = [exact(shape, at, split(shape(at), cells)) for split in SPLITS.values()]
        for share in (2, 4):
            at, cells = grid(size / share)
            coarse.append(exact(shape, at, as_done(shape(at), cells)))
        fine = coarse.pop()
        places, directions = chosen(fine)
        limit = compliance(fine, thickness, places, directions)
        row(name, [off(compliance(one, thickness, places, directions), limit) for one in coarse])


def chosen(surface):
    """Centres (24, 3) of triangles, their normals (24, 3): at random, a disc's radius off borders, folds and bends."""
    middle, found = surface.corners.mean(axis=1), []
    sides = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, number, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    rim = surface.points[np.unique(sides[count[number.ravel()] == 1])]
    for i in np.random.default_rng(1).permutation(len(middle)):
        near = np.linalg.norm(middle - middle[i], axis=1) < 1.5 * RADIUS
        if (
            np.linalg.norm(rim - middle[i], axis=1).min() > RADIUS
            and (surface.normals[near] @ surface.normals[i]).min() > BENT
        ):
            found.append(i)
        if len(found) == DISCS:
            break
    return middle[found], surface.normals[found]


def row_heads(first):
    heads = [first, *SPLITS, "at half the size"]
    print(f"| {' | '.join(heads)} |\n" + "| --- " * len(heads) + "|")


# ------------------------------------------------------------------------------------------------ a deck


def deck(path, thickness):
    """The mesh of a file; triangles among its quadrilaterals are the same in all divisions."""
    raw = read_raw(path)
    row_heads("deck")
    divided = [np.concatenate([raw.triangles, split(raw.points, raw.quadrilaterals)]) for split in (one_way, shorter)]
    surfaces = [Surface(*repair(raw.points, triangles)[:2]) for triangles in divided]
    surfaces.append(Surface(*repair(raw.points, raw.triangles, raw.quadrilaterals)[:2]))
    once = Surface(*halved(surfaces[-1].points, surfaces[-1].triangles, surfaces[-1].corner_normals))
    twice = Surface(*halved(once.points, once.triangles, once.corner_normals))
    places, directions = chosen(surfaces[-1])
    found = [compliance(one, thickness, places, directions) for one in (*surfaces, once, twice)]
    limit = tuple(b + (b - a) / 3 for a, b in zip(found[-2], found[-1]))
    row(path, [off(one, limit) for one in found[:-1]])
    print(f"{len(raw.quadrilaterals)} quadrilaterals, {len(raw.triangles)} triangles")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("deck", nargs="?", help="mesh file")
    parser.add_argument("thickness", nargs="?", type=float, default=1.0, help="mm")
    given = parser.parse_args()
    if given.deck:
        deck(given.deck, given.thickness)
    else:
        sheets()


if __name__ == "__main__":
    main()
