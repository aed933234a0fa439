"""Sheets with bends and their exact normals: profiles of flats and arcs swept straight or along an arch, and a box."""

import numpy as np

from mic.geometry.surface import Surface
from support.panels import cells


def profile(pieces):
    """Points and normals (y, z) at arc lengths s of a profile of pieces (length, turn), which begins flat along y; and
    the arc lengths at which its pieces end."""
    ends = np.cumsum([0.0] + [length for length, _ in pieces])

    def at(s):
        place, angle = np.zeros((len(s), 2)), np.zeros(len(s))
        begin, heading = np.zeros(2), 0.0
        for (length, turn), end in zip(pieces, ends):
            along = np.where(s >= end - 1e-9, s - end, np.nan)
            for values, here in ((along, np.isfinite(along)), (np.array([length]), None)):
                a = heading + turn * values / length
                if turn:
                    curve = np.column_stack([np.sin(a) - np.sin(heading), np.cos(heading) - np.cos(a)]) * length / turn
                else:
                    curve = np.outer(values, [np.cos(heading), np.sin(heading)])
                if here is None:
                    begin, heading = begin + curve[0], heading + turn
                else:
                    place[here], angle[here] = (begin + curve)[here], a[here]
        return place, angle

    return at, ends


def swept(pieces, size, rows, length=120.0, radius=None, jitter=0.0, seed=0):
    """A profile swept over a length, straight or along an arch of a radius.

    Bends get so many `rows` of triangles at least. Points move by up to `jitter` cells, along the lines where bends
    begin and in all directions elsewhere.

    Returns
    -------
    Surface
        Without normals.
    normals : (k, 3, 3) array
    """
    at, ends = profile(pieces)
    counts = [max(rows if turn else 1, round(piece / size)) for piece, turn in pieces]
    s = np.unique(np.concatenate([np.linspace(a, b, n + 1) for a, b, n in zip(ends, ends[1:], counts)]).round(12))
    x = np.linspace(0, length, round(length / size) + 1)
    random = np.random.default_rng(seed)
    X, S = np.meshgrid(x, s, indexing="ij")
    inner = np.isin(np.arange(len(s)), [0, len(s) - 1]) | (np.abs(s[:, None] - ends).min(axis=1) < 1e-9)
    cell = np.minimum(np.diff(s, prepend=-1e9), np.diff(s, append=1e9))
    X[1:-1] += jitter * size * random.uniform(-1, 1, X[1:-1].shape)
    S += np.where(inner, 0.0, jitter * cell) * random.uniform(-1, 1, S.shape)
    (y, z), angle = at(S.ravel())[0].T, at(S.ravel())[1]
    X, across, up = X.ravel(), -np.sin(angle), np.cos(angle)
    if radius is None:
        points, normals = np.column_stack([X, y, z]), np.column_stack([0 * X, across, up])
    else:
        turn = (X - length / 2) / radius
        points = np.column_stack([(radius + z) * np.sin(turn), y, (radius + z) * np.cos(turn) - radius])
        normals = np.column_stack([up * np.sin(turn), across, up * np.cos(turn)])
    triangles = cells(len(x) - 1, len(s) - 1)
    return Surface(points, triangles), normals[triangles]


def box(size, rows, sides=(80.0, 56.0), depth=20.0, radius=8.0):
    """An open box with radii along its edges and balls' eighths in its corners; radii get so many rows at least."""
    rows = max(rows, round(radius * np.pi / 2 / size))
    around, outwards = [], []
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(sides) / 2
    for i, heading in enumerate(np.radians([-90, 0, 90, 180])):
        a, b = corners[i], corners[(i + 1) % 4]
        count = round(np.linalg.norm(b - a) / size)
        around += [a + (b - a) * j / count for j in range(count)] + [b] * rows
        outwards += [heading] * count + [heading + np.pi / 2 * j / rows for j in range(rows)]
    around, outwards = np.array(around), np.column_stack([np.cos(outwards), np.sin(outwards)])
    walls = max(1, round(depth / size))
    tilt = np.concatenate([np.linspace(0, np.pi / 2, rows + 1), np.full(walls, np.pi / 2)])
    height = radius * (1 - np.cos(tilt)) + np.concatenate([np.zeros(rows + 1), depth * np.arange(1, walls + 1) / walls])
    rings = [
        np.column_stack([around + radius * np.sin(a) * outwards, np.full(len(around), h)]) for a, h in zip(tilt, height)
    ]
    normal = [np.column_stack([-np.sin(a) * outwards, np.full(len(around), np.cos(a))]) for a in tilt]
    m, n = len(around), len(tilt)
    ring = np.arange(m + 1) % m
    triangles = cells(m, n - 1)
    triangles = (triangles % n) * m + ring[triangles // n]
    nx, ny = (round(side / size) for side in sides)
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, nx + 1) * sides[0], np.linspace(-0.5, 0.5, ny + 1) * sides[1], indexing="ij"
    )
    floor = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    points, normals = np.concatenate([*rings, floor]), np.concatenate([*normal, np.tile([0, 0, 1.0], (len(floor), 1))])
    triangles = np.concatenate([triangles[:, ::-1], cells(nx, ny) + m * n])
    _, first, number = np.unique(points.round(6), axis=0, return_index=True, return_inverse=True)
    triangles = number.ravel()[triangles]
    points, normals = points[first], normals[first]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    return Surface(points, triangles), normals[triangles]
