"""Error of estimated normals: the wheelhouse with flat triangles, with exact normals, and with estimated normals.

    python benchmarks/normals.py                     # coarse and medium against fine, about a minute
    python benchmarks/normals.py --against 3.5       # a finer reference, mm; some minutes
    python benchmarks/normals.py --astray 0.2 0.5 1 2    # also the effect of normals with these errors, degrees
    PYTHONPATH=.:tests python benchmarks/normals.py --bends    # bends of one row of triangles instead, a minute

Error of the compliance along the normals, per cent: Frobenius norm relative to the reference, supported by six locators
and by all. 24 points along the flange and 4 in each other region are averaged over discs of 6 mm. The reference has the
normals of the geometry. The table also shows the angles between estimated normals and those of the geometry. Random
errors of normals are drawn for each vertex with the given root mean square; their effect is the change from exact
normals on the same mesh.

Bends: a strip of 120 mm with two bends of radius r, 1 mm thick, in opposite or the same direction, on irregular cells
of 8 or 14 mm with a single row in each bend. The error is that of the compliance under self-equilibrated forces on 24
discs, relative to a mesh of a quarter of the size.
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
from mic.geometry import normals as corner_normals
from mic.geometry.script import load_script
from mic.geometry.surface import Surface

RADIUS = 6.0  # mm, of the discs
SUPPORT = ("A1", "A2", "A3", "B1", "B2", "C1")
REGIONS = {"inner": ("tread", "face"), "outer": ("panel", "brim", "wall")}


def places(geometry, part):
    """Points, normals and directions of the functionals, the locators last; and the names of the locators."""
    flange = [("flange", angle, 0.5, None) for angle in np.linspace(-85, 92, 24)]
    panels = [(region, angle, 0.5, None) for region in REGIONS[part] for angle in (-75, -30, 15, 60)]
    table = flange + panels + list(geometry.LOCATORS[part].values())
    points, normals = zip(*(geometry.surface_point(part, *row[:3]) for row in table))
    directions = [n if row[3] is None else row[3] - (np.array(row[3]) @ n) * n for row, n in zip(table, normals)]
    directions = [d / np.linalg.norm(d) for d in directions]
    return np.array(points), np.array(normals), np.array(directions), list(geometry.LOCATORS[part])


def compliance(geometry, part, surface, element):
    """Compliance at the points, supported by six locators and by all."""
    points, normals, directions, names = places(geometry, part)
    count = len(points)
    patches = tuple(surface.patch(point, RADIUS, normal) for point, normal in zip(points, normals))
    rows = Functionals.displacements(patches, directions)
    H, G = ShellPart(surface, geometry.THICKNESS, 210e3, 0.3, element).influence(rows)
    blocks = Blocks((H,), (G,))
    every, free = identity(count, format="csr"), count - len(names)
    none = csr_matrix((0, count))
    return [
        eliminate(blocks, every[held], none, every[:free], every[:free]).L_out
        for held in ([free + names.index(name) for name in SUPPORT], range(free, count))
    ]


def astray(points, triangles, normals, degrees):
    """(k, 3, 3) normals with a random rotation at each vertex, equal in all its triangles."""
    step = np.radians(degrees) / np.sqrt(2) * np.random.default_rng(0).normal(size=points.shape)[triangles]
    turned = normals + step - (step * normals).sum(axis=2, keepdims=True) * normals
    return turned / np.linalg.norm(turned, axis=2, keepdims=True)


def bends():
    """Errors of flat triangles and of estimated normals (none refused) by the angle of a bend of one row."""
    from support import pressings  # of the tests, whose folder is not always on the path

    turns, cases = (45, 60, 66, 70, 80, 90), ((6.0, 8.0, 1), (6.0, 8.0, -1), (12.0, 14.0, 1), (12.0, 14.0, -1))
    heads = [f"r = {r:g} mm, {'same way' if way > 0 else 'either way'}" for r, _, way in cases]
    print(f"| bend of one row, flat / curved | {' | '.join(heads)} |\n" + "| --- " * (len(heads) + 1) + "|")
    guard, corner_normals.GUARD = corner_normals.GUARD, 90.0
    for turn in turns:
        cells = []
        for r, size, way in cases:
            arc, flat = r * np.radians(turn), 4 * r
            pieces = [
                (flat, 0.0),
                (arc, np.radians(turn)),
                (flat, 0.0),
                (arc, way * np.radians(turn)),
                (1.5 * flat, 0.0),
            ]
            fine, normals = pressings.swept(pieces, size / 4, 8)
            limit = Surface(fine.points, fine.triangles, normals)
            pick = np.random.default_rng(1).choice(len(fine.triangles), 24, replace=False)
            where = fine.corners[pick].mean(axis=1), normals[pick, 0]
            mesh, exact = pressings.swept(pieces, size, 1, jitter=0.2, seed=3)
            found = [balanced(mesh, "dkt-opt", *where)]
            found.append(balanced(Surface(mesh.points, mesh.triangles, exact), "dkt-opt-curved", *where))
            reference = balanced(limit, "dkt-opt-curved", *where)
            cells.append("{:.1f} / {:.1f} %".format(*off(found, [reference] * 2)))
        print(f"| {turn}° | {' | '.join(cells)} |", flush=True)
    corner_normals.GUARD = guard


def balanced(surface, element, points, directions):
    """Compliance under self-equilibrated forces on discs of 5 mm, in a basis that depends on the discs alone."""
    patches = tuple(surface.patch(point, 5.0, normal) for point, normal in zip(points, directions))
    rows = Functionals.displacements(patches, directions)
    H = ShellPart(surface, 1.0, 210e3, 0.3, element).influence(rows)[0]
    basis = np.linalg.svd(np.hstack([directions, np.cross(points, directions)]))[0][:, 6:]
    return basis.T @ H @ basis


def off(found, limit):
    """Relative errors on six locators and on all, per cent."""
    return [100 * np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, limit)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=["coarse", "medium"], help="named sizes of the wheelhouse")
    parser.add_argument("--against", type=float, help="size of the limit, mm; default: fine")
    parser.add_argument("--astray", nargs="*", type=float, default=[], help="root mean squares, degrees")
    parser.add_argument("--bends", action="store_true", help="bends of one row of triangles")
    given = parser.parse_args()
    if given.bends:
        return bends()
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
