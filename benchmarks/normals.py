"""What estimated normals leave: the wheelhouse on flat triangles, with its geometry's normals, and with estimates.

    python benchmarks/normals.py                     # coarse and medium against fine, about a minute
    python benchmarks/normals.py --against 3.5       # a finer limit, mm; some minutes
    python benchmarks/normals.py --astray 0.2 0.5 1 2    # beside it, what normals cost that err by so many degrees

Error of the compliance along the normals, per cent: Frobenius norm over that of the limit, held by six locators and by
all. 24 places along the flange and 4 in each other region are read on discs of 6 mm. The limit has the geometry's
normals. With the table come the angles between estimates and the geometry's normals. Normals that err do so at random,
vertex by vertex, by a root mean square; the change is that from the geometry's normals on the same mesh.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.sparse import csr_matrix, identity

from fem_reference.shell.part import ShellPart
from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.functional import Functionals
from mic.examples import folder
from mic.geometry.script import load_script
from mic.geometry.surface import Surface

RADIUS = 6.0  # mm, of the discs
SUPPORT = ("A1", "A2", "A3", "B1", "B2", "C1")
REGIONS = {"inner": ("tread", "face"), "outer": ("panel", "brim", "wall")}


def places(geometry, part):
    """Points, normals there and directions that are read, the locators last; and the locators' names."""
    flange = [("flange", angle, 0.5, None) for angle in np.linspace(-85, 92, 24)]
    panels = [(region, angle, 0.5, None) for region in REGIONS[part] for angle in (-75, -30, 15, 60)]
    table = flange + panels + list(geometry.LOCATORS[part].values())
    points, normals = zip(*(geometry.surface_point(part, *row[:3]) for row in table))
    directions = [n if row[3] is None else row[3] - (np.array(row[3]) @ n) * n for row, n in zip(table, normals)]
    directions = [d / np.linalg.norm(d) for d in directions]
    return np.array(points), np.array(normals), np.array(directions), list(geometry.LOCATORS[part])


def compliance(geometry, part, surface, element):
    """Of the places, held by six locators and by all."""
    points, normals, directions, names = places(geometry, part)
    count = len(points)
    patches = tuple(surface.patch(point, RADIUS, normal) for point, normal in zip(points, normals))
    rows = Functionals(patches, np.arange(count), directions, np.zeros(count, bool), np.zeros(count), ("",) * count)
    blocks = Blocks.single(*ShellPart(surface, geometry.THICKNESS, 210e3, 0.3, element).influence(rows), [0, count])
    every, free = identity(count, format="csr"), count - len(names)
    none = csr_matrix((0, count))
    return [
        eliminate(blocks, every[held], none, every[:free], every[:free]).L_out
        for held in ([free + names.index(name) for name in SUPPORT], range(free, count))
    ]


def astray(points, triangles, normals, degrees):
    """(k, 3, 3) the normals, turned at random, alike for all triangles at a vertex."""
    step = np.radians(degrees) / np.sqrt(2) * np.random.default_rng(0).normal(size=points.shape)[triangles]
    turned = normals + step - (step * normals).sum(axis=2, keepdims=True) * normals
    return turned / np.linalg.norm(turned, axis=2, keepdims=True)


def off(found, limit):
    """Relative errors on six locators and on all, per cent."""
    return [100 * np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, limit)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=["coarse", "medium"], help="named sizes of the wheelhouse")
    parser.add_argument("--against", type=float, help="size of the limit, mm; default: fine")
    parser.add_argument("--astray", nargs="*", type=float, default=[], help="root mean squares, degrees")
    given = parser.parse_args()
    geometry = load_script(folder("wheelhouse") / "geometry.py")
    heads = ["part, size", "flat", "geometry's normals", "estimated", "angle, mean and largest"]
    heads += [f"{degrees:g}° astray" for degrees in given.astray]
    print(f"| {' | '.join(heads)} |\n" + "| --- " * len(heads) + "|")
    for part in geometry.PARTS:
        fine = Surface(*geometry.build(part, given.against or geometry.SIZES["fine"]))
        limit = compliance(geometry, part, fine, "dkt-opt-curved")
        for size in given.sizes:
            points, triangles, normals = geometry.build(part, geometry.SIZES[size])
            bare, told = Surface(points, triangles), Surface(points, triangles, normals)
            exact = compliance(geometry, part, told, "dkt-opt-curved")
            flat, estimated = (compliance(geometry, part, bare, element) for element in ("dkt-opt", "dkt-opt-curved"))
            cells = ["{:.1f} / {:.1f} %".format(*off(found, limit)) for found in (flat, exact, estimated)]
            apart = np.linalg.norm(bare.corner_normals - told.corner_normals, axis=2) / 2
            angle = np.degrees(2 * np.arcsin(np.clip(apart, 0, 1)))
            cells.append(f"{angle.mean():.1f}°, {angle.max():.1f}°")
            for degrees in given.astray:
                surface = Surface(points, triangles, astray(points, triangles, normals, degrees))
                changed = off(compliance(geometry, part, surface, "dkt-opt-curved"), exact)
                cells.append("{:.2f} / {:.2f} %".format(*changed))
            print(f"| {part}, {size} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
