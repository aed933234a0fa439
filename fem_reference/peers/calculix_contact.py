"""A frictional contact case by CalculiX: bending of two leaves of solid elements, pressed together over a part of
their length.

The pressed part bends as one beam until friction is exceeded; elsewhere each leaf bends alone. No closed form is known
for the partial slip in between. Solid elements (C3D20R) with surface-to-surface penalty contact share neither element,
surface nor algorithm with `fem_reference.full.equilibrium`.

CalculiX 2.20 applies each load in one increment here. This agrees within 0.3 % with the closed form for leaves that are
pressed and slip everywhere. With smaller increments its friction grows with their number (deflections 3 % too small
with 4, 5 % with 20), for surface-to-surface and for mortar contact, although the exact solution is path-independent.
"""

from __future__ import annotations

import numpy as np

from fem_reference.peers.calculix import CalculixError, read, run

__all__ = ["leaves"]

# Nodes of a C3D20R on a grid of half elements: corners, then midsides, in CalculiX's order
_NODES = np.array(
    [
        (0, 0, 0),
        (2, 0, 0),
        (2, 2, 0),
        (0, 2, 0),
        (0, 0, 2),
        (2, 0, 2),
        (2, 2, 2),
        (0, 2, 2),
        (1, 0, 0),
        (2, 1, 0),
        (1, 2, 0),
        (0, 1, 0),
        (1, 0, 2),
        (2, 1, 2),
        (1, 2, 2),
        (0, 1, 2),
        (0, 0, 1),
        (2, 0, 1),
        (2, 2, 1),
        (0, 2, 1),
    ]
)


def leaves(
    length: float,
    width: float,
    depth: float,
    young: float,
    friction: float,
    pressure: float,
    pressed_from: float,
    loads,
    cells: tuple[int, int] = (40, 2),
) -> np.ndarray:
    """Tip deflections (s,), mm, of a cantilever of two leaves under a sequence of tip loads.

    Parameters
    ----------
    length, width, depth : float
        mm; the depth is that of one leaf.
    young : float
        MPa; ν = 0.
    friction : float
        μ between the leaves.
    pressure, pressed_from : float
        Pressure on both outer faces, MPa, and the distance from the root, mm, at which it begins.
    loads : sequence of float
        Tip load of each step, N, upwards, half on each leaf.
    cells : (int, int)
        Elements along the length, and over the depth of each leaf.

    Raises
    ------
    CalculixError
    """
    nx, nz = cells
    lines, nodes, elements, outer, inner, tips, roots = ["*NODE, NSET=ALL"], {}, [], [], [], [], []

    def node(leaf, i, j, k):
        if (leaf, i, j, k) not in nodes:
            nodes[leaf, i, j, k] = len(nodes) + 1
            lines.append(
                f"{len(nodes)}, {length * i / (2 * nx)!r}, {width * j / 2!r}, {depth * (leaf + k / (2 * nz))!r}"
            )
        return nodes[leaf, i, j, k]

    for leaf in (0, 1):
        for i in range(nx):
            for k in range(nz):
                elements.append([node(leaf, 2 * i + a, b, 2 * k + c) for a, b, c in _NODES])
                bottom, top = (f"{len(elements)}, {{}}1", f"{len(elements)}, {{}}2")
                if k == (nz - 1 if leaf else 0) and (i + 0.5) * length / nx > pressed_from:
                    outer.append((top if leaf else bottom).format("P") + f", {pressure!r}")
                if k == (0 if leaf else nz - 1):
                    inner.append((leaf, (bottom if leaf else top).format("S")))
        tips += [nodes[leaf, 2 * nx, j, nz] for j in (0, 2)]
    roots = [number for (_, i, _, _), number in nodes.items() if i == 0]
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=LEAVES")
    for number, element in enumerate(elements, start=1):
        lines += [", ".join(map(str, [number, *element[:10]])) + ",", ", ".join(map(str, element[10:]))]
    lines += ["*MATERIAL, NAME=SHEET", "*ELASTIC", f"{young!r}, 0.", "*SOLID SECTION, ELSET=LEAVES, MATERIAL=SHEET"]
    lines += ["*BOUNDARY", *(f"{number}, 1, 3" for number in roots)]
    for leaf, name in enumerate(("LOWER", "UPPER")):
        lines += [f"*SURFACE, NAME={name}, TYPE=ELEMENT", *(face for owner, face in inner if owner == leaf)]
    # Penalty stiffnesses (MPa/mm): overlaps and elastic slips stay far below the slip of the case
    lines += [
        "*SURFACE INTERACTION, NAME=FACES",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        f"{5 * young!r}",
        "*FRICTION",
        f"{friction!r}, {young!r}",
        "*CONTACT PAIR, INTERACTION=FACES, TYPE=SURFACE TO SURFACE",
        "LOWER, UPPER",
    ]
    lines += ["*NSET, NSET=TIP", ", ".join(map(str, tips))]
    for load in (0.0, *loads):
        lines += ["*STEP, INC=1000", "*STATIC", "1., 1., 1e-6, 1.", "*DLOAD, OP=NEW", *outer, "*CLOAD, OP=NEW"]
        lines += [f"{number}, 3, {load / len(tips)!r}" for number in tips]
        lines += ["*NODE PRINT, NSET=TIP, FREQUENCY=1000", "U", "*END STEP"]
    u = read(run("\n".join(lines) + "\n"), len(nodes), tips)
    if u.shape[2] != len(loads) + 1:
        raise CalculixError(f"ccx solved {u.shape[2]} of {len(loads) + 1} steps")
    return u[:, 2, 1:].mean(axis=0)
