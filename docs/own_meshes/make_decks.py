"""Write two small decks for trying `mic init`, panel.inp and channel.inp, into the working directory.

The panel, 200 × 100 mm, has two round holes; its deck states the thickness 0.8 mm. The deck of the hat channel on it
has only the mesh. Both meshes are on the skins that touch, at z = 0, as exporters often write them.
"""

from pathlib import Path

import numpy as np

from mic.geometry.structured import extrude

AROUND, RINGS = 24, 4  # elements around a hole and in radial direction


def panel():
    """Points (n, 3), mm, and quadrilaterals (k, 4): two squares, each with a hole of 10 mm in its middle."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    square = circle / np.abs(circle).max(axis=1, keepdims=True)  # 24 rays; four end in the corners
    points, quadrilaterals = [], []
    for centre in ([50, 50], [150, 50]):
        first = len(points)
        for share in np.linspace(0, 1, RINGS + 1):
            flat = centre + (1 - share) * 5 * circle + share * 50 * square
            points += [[x, y, 0.0] for x, y in flat]
        inner = first + np.arange(AROUND)
        for ring in range(RINGS):
            a, b = inner + ring * AROUND, np.roll(inner, -1) + ring * AROUND
            quadrilaterals += np.column_stack([a, a + AROUND, b + AROUND, b]).tolist()
    return np.array(points), np.array(quadrilaterals)


def channel():
    """Points (n, 3), mm, and triangles (k, 3): a hat along x, 25 mm high, its feet at z = 0."""
    profile = [(0, 0), (16, 0), (20, 25), (40, 25), (44, 0), (60, 0)]
    points, triangles, _ = extrude(profile, 10.0, 180.0, 7.0)
    return points + [0, 20, 0], triangles


def deck(name, points, elements, section=""):
    """An Abaqus deck."""
    nodes = [f"{i}, {x:.6f}, {y:.6f}, {z:.6f}" for i, (x, y, z) in enumerate(points + 0.0, 1)]
    cells = [", ".join(map(str, [i, *row])) for i, row in enumerate((elements + 1).tolist(), 1)]
    kind = "S4R" if elements.shape[1] == 4 else "S3"
    lines = ["*NODE", *nodes, f"*ELEMENT, TYPE={kind}, ELSET={name.upper()}", *cells]
    Path(f"{name}.inp").write_text("\n".join(lines) + "\n" + section)


if __name__ == "__main__":
    steel = "*MATERIAL, NAME=DC04\n*ELASTIC\n210000., 0.3\n"
    deck("panel", *panel(), "*SHELL SECTION, ELSET=PANEL, MATERIAL=DC04\n0.8, 5\n" + steel)
    deck("channel", *channel())
