"""Parametric geometry of a synthetic wheelhouse: two deep-drawn sheets that meet in a flange along the arch.

Axes (mm): x points to the rear of the car, y outboard, z up; the wheel's axis is the y axis. The arch angle is 0 at the
top, negative towards the front foot and positive towards the rear foot, so that a point at distance r from the axis
lies at (r sin(angle), y, r cos(angle)).

Each part starts as a *profile* in the (r, y) half-plane, a polyline with rounded corners whose length is measured by
``l`` from the free edge of the mating flange. It is swept along the arch and then formed: arch and flange leave circle
and plane, panels are crowned, a dome, beads and pads are pressed. The result is an analytic map (angle, l) -> point,
the part's *base surface*. Both parts share the base surface of the flange: it is where the two sheets touch. The
mid-surfaces lie half a thickness to either side, ``base -/+ t/2 n``, so they are one thickness apart along the normal.

Meshing happens in the plane: the map from the rectangle (angle, integral of dl/r) is conformal for a surface of
revolution and nearly so here, hence gmsh meshes that rectangle with a size field and every node is mapped exactly.

Normals: ``n``, and with it every triangle's orientation, points on the mating flange of **both** parts from the inner
to the outer part (about +y). Following the sheet from there, ``n`` points to the wheel on the inner part's tread and
away from the wheel on the outer part's panel.

``python geometry.py`` prints the proposed fixture, joints and measurement points as TOML.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

THICKNESS = 0.7  # mm, both sheets

# The arch that both parts follow
ARCH_START, ARCH_END = -95.0, 100.0  # degrees: front foot, rear foot
ARCH_RADIUS = 340.0  # mm, wheel axis to the flange's root corner, before forming
ARCH_SHIFT = 10.0  # mm from the axis back to the arch's centre
ARCH_OVAL = 8.0  # mm, lower at the top and wider at the feet by this
FLANGE_LEAN = 14.0  # mm, inboard displacement of the arch at the top
FLANGE_SKEW = 5.0  # mm, outboard displacement at the rear foot

# The mating flange
FLANGE_WIDTH = 24.0  # mm, from the end of the root bend to the free edge
FLANGE_TILT = 8.0  # degrees, against the radial direction, outboard
ROOT_SETBACK = 5.0  # mm, from the root corner to where the bend begins

# Profiles: (name of the straight region that ends at this corner, r in mm, y in mm, setback of the bend there in mm).
# A setback is the length by which a bend shortens each of its legs. The flange is common to both and comes first.
_ROOT = ("flange", ARCH_RADIUS, 0.0, ROOT_SETBACK)
PROFILES = {
    "inner": (_ROOT, ("tread", 324.0, -215.0, 52.0), ("face", 200.0, -230.0, 8.0), ("hem", 196.0, -254.0, 0.0)),
    "outer": (
        _ROOT,
        ("panel", 333.0, 62.0, 5.0),
        ("step", 349.0, 80.0, 5.0),
        ("brim", 346.0, 142.0, 6.0),
        ("wall", 384.0, 149.0, 0.0),
    ),
}
PARTS = tuple(PROFILES)

# Forming of the regions (heights in mm)
CROWNS = {"inner": {"tread": 7.0}, "outer": {"panel": 2.0, "brim": 2.5}}  # radial bulge, largest in the middle
INNER_NARROWING = 0.12  # share, deeper at the rear foot, shallower at the front foot


class Pressing(NamedTuple):
    """A local bulge ``height * (1 - q^2)^3`` with elliptic support.

    Attributes
    ----------
    part, region : str
        Where it is pressed.
    axis : {"r", "y"}
        Direction in which the sheet is displaced.
    angle : float
        Arch angle of the centre, degrees.
    fraction : float
        Position of the centre along the region, 0 to 1.
    half_arch, half_width : float
        Semi-axes along the arch and along the profile, mm.
    height : float
        Height, mm.
    """

    part: str
    region: str
    axis: str
    angle: float
    fraction: float
    half_arch: float
    half_width: float
    height: float


PRESSINGS = (
    Pressing("inner", "tread", "r", 6.0, 0.62, 100.0, 75.0, 26.0),  # damper dome
    Pressing("inner", "tread", "r", -45.0, 0.52, 26.0, 72.0, 6.0),  # stiffening beads across the tread
    Pressing("inner", "tread", "r", 48.0, 0.52, 26.0, 72.0, 6.0),
    Pressing("inner", "face", "y", -50.0, 0.5, 75.0, 38.0, 6.0),  # pads in the inner face
    Pressing("inner", "face", "y", 55.0, 0.5, 75.0, 38.0, 6.0),
)

# Meshing
SIZES = {"coarse": 17.5, "medium": 8.0, "fine": 5.0}  # mm
STORED = Path(__file__).with_name("meshes.npz")  # plane meshes of two sizes, written by `store`
GMSH_OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.ElementOrder": 1,
    "Mesh.RecombineAll": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.Smoothing": 5,
}
FLANGE_REFINEMENT = {"inner": 2.4, "outer": 2.7}  # size / size on the flange; they differ so that meshes do not match
BEND_REFINEMENT = 1.6  # size / size along a bend
PRESSING_REFINEMENT = 2.0  # size / size on domes, beads and pads, where the sheet is curved most
PAD = 4.0  # mm, radius of a locator's pad; elements there are no larger, and no larger than half of those elsewhere
GROWTH = 0.3  # mm of size per mm of distance


# --- the analytic surface ---------------------------------------------------------------------------------------------


class _Piece(NamedTuple):
    """A straight line (``turn == 0``) or an arc of a profile."""

    name: str  # of the straight region; empty for a bend
    begin: float  # l at its two ends, mm
    end: float
    origin: np.ndarray  # (r, y) at begin
    tangent: np.ndarray  # unit vector at begin
    turn: float  # angle by which the tangent turns to the left, radians

    def at(self, l):
        length = l - self.begin
        left = np.array([-self.tangent[1], self.tangent[0]])
        if self.turn == 0:
            along, across = length, 0 * length
        else:
            radius = (self.end - self.begin) / self.turn
            along, across = radius * np.sin(length / radius), radius * (1 - np.cos(length / radius))
        return [self.origin[i] + along * self.tangent[i] + across * left[i] for i in (0, 1)]


@cache
def _profile(part: str) -> tuple[_Piece, ...]:
    if part not in PROFILES:
        raise ValueError(f"the wheelhouse has no part {part!r}; its parts are {', '.join(PARTS)}")
    tilt = np.radians(FLANGE_TILT)
    corners = [np.array(corner[1:3]) for corner in PROFILES[part]]
    corners.insert(0, corners[0] + (FLANGE_WIDTH + ROOT_SETBACK) * np.array([np.cos(tilt), np.sin(tilt)]))
    setbacks = [0.0] + [corner[3] for corner in PROFILES[part]]
    tangents = [(b - a) / np.linalg.norm(b - a) for a, b in zip(corners, corners[1:])]

    pieces, l = [], 0.0
    for i, (name, tangent) in enumerate(zip((corner[0] for corner in PROFILES[part]), tangents)):
        origin = corners[i] + setbacks[i] * tangent
        length = np.linalg.norm(corners[i + 1] - setbacks[i + 1] * tangent - origin)
        pieces.append(_Piece(name, l, l + length, origin, tangent, 0.0))
        l += length
        if i + 1 < len(tangents):
            following = tangents[i + 1]
            turn = np.arctan2(tangent[0] * following[1] - tangent[1] * following[0], tangent @ following)
            length = setbacks[i + 1] / np.tan(abs(turn) / 2) * abs(turn)
            pieces.append(_Piece("", l, l + length, corners[i + 1] - setbacks[i + 1] * tangent, tangent, turn))
            l += length
    return tuple(pieces)


def _region(part: str, name: str) -> _Piece:
    for piece in _profile(part):
        if piece.name == name:
            return piece
    raise ValueError(
        f"part {part!r} has no region {name!r}; it has {', '.join(p.name for p in _profile(part) if p.name)}"
    )


def _bump(q2):
    """Twice continuously differentiable bump of height 1 that vanishes for q2 >= 1."""
    return np.where(q2.real < 1, (1 - q2) ** 3, 0)


def _base(part, phi, l):
    """Base surface, shape (3, ...); ``phi`` (radians) and ``l`` (mm) may be complex, for complex-step derivatives."""
    pieces = _profile(part)
    phi, l = np.broadcast_arrays(phi, l)
    r = np.zeros(phi.shape, np.result_type(phi, l, float))
    y = np.zeros_like(r)
    which = np.searchsorted([piece.end for piece in pieces[:-1]], l.real)
    for i, piece in enumerate(pieces):
        here = which == i
        if here.any():
            r[here], y[here] = piece.at(l[here])

    for name, height in CROWNS[part].items():
        piece = _region(part, name)
        r = r + height * _bump(((2 * l - piece.begin - piece.end) / (piece.end - piece.begin)) ** 2)
    for pressing in PRESSINGS:
        if pressing.part == part:
            piece = _region(part, pressing.region)
            centre = piece.begin + pressing.fraction * (piece.end - piece.begin)
            arch = ARCH_RADIUS * (phi - np.radians(pressing.angle)) / pressing.half_arch
            bulge = pressing.height * _bump(arch**2 + ((l - centre) / pressing.half_width) ** 2)
            r, y = (r + bulge, y) if pressing.axis == "r" else (r, y + bulge)
    if part == "inner":  # begins behind the root bend, without a kink
        behind = l - _region(part, "tread").begin
        depth = np.where(behind.real > 0, behind**2 / (behind**2 + 100.0**2) ** 0.5, 0)
        y = y - INNER_NARROWING * np.sin(phi) * depth
    r = r + ARCH_SHIFT * np.sin(phi) - ARCH_OVAL * np.cos(2 * phi)
    y = y - FLANGE_LEAN * np.cos(phi) ** 2 + FLANGE_SKEW * np.sin(phi)
    return np.stack([r * np.sin(phi), y, r * np.cos(phi)])


def _mid_surface(part, phi, l):
    """Mid-surface points and unit normals, each of shape (..., 3); ``phi`` in radians, ``l`` in mm."""
    phi, l = np.asarray(phi, float), np.asarray(l, float)
    step = 1e-30j  # complex step: derivatives without cancellation
    along = _base(part, phi + step, l).imag / step.imag
    across = _base(part, phi, l + step).imag / step.imag
    normal = np.cross(along, across, axis=0)
    normal /= np.linalg.norm(normal, axis=0)
    side = {"inner": -0.5, "outer": 0.5}[part]
    point = _base(part, phi, l) + side * THICKNESS * normal
    return np.moveaxis(point, 0, -1), np.moveaxis(normal, 0, -1)


def flange_point(angle, s):
    """Opposite points on the two mid-surfaces of the mating flange.

    Parameters
    ----------
    angle : float or array
        Arch angle in degrees, ``ARCH_START`` (front) to ``ARCH_END`` (rear), 0 at the top.
    s : float or array
        Distance from the end of the root bend in mm: 0 at the root, ``FLANGE_WIDTH`` at the free edge.

    Returns
    -------
    inner, outer, normal : ndarray, shape (..., 3)
        Points on the mid-surfaces (mm), with ``outer - inner == THICKNESS * normal``, and the unit normal, which
        points from the inner to the outer part.
    """
    s = np.asarray(s, float)
    if np.any(s < 0) or np.any(s > FLANGE_WIDTH):
        raise ValueError(f"s must lie between 0 and the flange width of {FLANGE_WIDTH} mm")
    phi, l = np.broadcast_arrays(np.radians(np.asarray(angle, float)), FLANGE_WIDTH - s)
    inner, normal = _mid_surface("inner", phi, l)
    outer, _ = _mid_surface("outer", phi, l)
    return inner, outer, normal


def surface_point(part, region, angle, fraction):
    """Point and normal of a part's mid-surface in one of its regions.

    Parameters
    ----------
    part : {"inner", "outer"}
    region : str
        "flange", "tread", "face", "hem" (inner) or "flange", "panel", "step", "brim", "wall" (outer).
    angle : float or array
        Arch angle in degrees.
    fraction : float or array
        Position between the region's two bends, 0 at the end nearer to the flange's free edge, 1 at the other.

    Returns
    -------
    point, normal : ndarray, shape (..., 3)
        Point (mm) and unit normal, oriented as the mesh.
    """
    piece = _region(part, region)
    l = piece.begin + np.asarray(fraction, float) * (piece.end - piece.begin)
    phi, l = np.broadcast_arrays(np.radians(np.asarray(angle, float)), l)
    return _mid_surface(part, phi, l)


# --- the mesh ---------------------------------------------------------------------------------------------------------


def build(part: str, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mesh one part's mid-surface.

    Parameters
    ----------
    part : {"inner", "outer"}
    size : float
        Element size in mm away from the mating flange; on it elements are ``FLANGE_REFINEMENT[part]`` times smaller.
        ``SIZES`` holds named values.

    Returns
    -------
    points : ndarray, shape (n, 3)
        Nodes in mm, exactly on the analytic mid-surface.
    triangles : ndarray of int, shape (k, 3)
        Oriented so that normals on the mating flange point from the inner to the outer part.
    normals : ndarray, shape (k, 3, 3)
        Those of the analytic mid-surface at the corners of each triangle.
    """
    if not 1.0 <= size <= 30.0:
        raise ValueError(f"size must lie between 1 and 30 mm, not {size}")
    l, rectangle = _rectangle(part, size)
    uv, triangles = _stored(rectangle) or _mesh_strips(*rectangle)
    v = rectangle[2]
    points, normals = _mid_surface(part, uv[:, 0] / ARCH_RADIUS, np.clip(np.interp(uv[:, 1], v, l), 0, l[-1]))
    return points, triangles, normals[triangles]


def _rectangle(part, size):
    """Samples of ``l`` across a part, and the rectangle that is meshed for a size: the arguments of `_mesh_strips`."""
    pieces = _profile(part)
    # Conformal coordinates in mm: u = R phi and v = R * integral of dl / r.
    lines = np.array([0.0] + [piece.end for piece in pieces])  # l of the lines that the mesh must follow
    l = np.unique(np.concatenate([np.linspace(a, b, 400) for a, b in zip(lines, lines[1:])]))
    x, _, z = _base(part, 0.0, l)
    scale = np.hypot(x, z) / ARCH_RADIUS
    v = np.concatenate([[0.0], np.cumsum(np.diff(l) / (0.5 * (scale[1:] + scale[:-1])))])

    target = np.minimum(size, size / FLANGE_REFINEMENT[part] + GROWTH * np.maximum(l - pieces[1].end, 0))
    for piece in pieces[2:]:
        if piece.turn and piece.end - piece.begin < 2 * size:
            distance = np.maximum(np.maximum(piece.begin - l, l - piece.end), 0)
            target = np.minimum(target, size / BEND_REFINEMENT + GROWTH * distance)

    # (u, v, half axis along u, along v, size there): finer within an ellipse, and around it
    spots = []
    for pressing in PRESSINGS:
        if pressing.part == part:
            piece = _region(part, pressing.region)
            at = np.interp(piece.begin + pressing.fraction * (piece.end - piece.begin), l, v)
            axes = pressing.half_arch, pressing.half_width
            spots.append((ARCH_RADIUS * np.radians(pressing.angle), at, *axes, size / PRESSING_REFINEMENT))
    for region, angle, fraction, _ in LOCATORS[part].values():
        piece = _region(part, region)
        at = np.interp(piece.begin + fraction * (piece.end - piece.begin), l, v)
        spots.append((ARCH_RADIUS * np.radians(angle), at, PAD, PAD, min(PAD, size / 2)))

    return l, (ARCH_RADIUS * np.radians([ARCH_START, ARCH_END]), np.interp(lines, l, v), v, target / scale, spots)


def _stored(rectangle):
    """The stored mesh of a rectangle, None if there is none; the usual sizes need no gmsh therefore."""
    wanted = _numbers(rectangle)
    if STORED.is_file():
        with np.load(STORED) as stored:
            for name in filter(lambda name: name.endswith("rectangle"), stored.files):
                numbers, mesh = stored[name], name.removesuffix("rectangle")
                if numbers.shape == wanted.shape and np.abs(numbers - wanted).max() < 1e-4:
                    return stored[f"{mesh}uv"], stored[f"{mesh}triangles"].astype(np.int64)
    return None


def _numbers(rectangle):
    """All numbers that the mesh of a rectangle depends on, one after the other."""
    *arrays, spots = rectangle
    return np.concatenate([*arrays, *spots, [GROWTH], list(GMSH_OPTIONS.values())]).astype(np.float32)


def store():
    """Write the meshes of sizes coarse and medium into `STORED`; call it after a change of the shape."""
    arrays = {}
    for part, size in product(PARTS, ("coarse", "medium")):
        _, rectangle = _rectangle(part, SIZES[size])
        uv, triangles = _mesh_strips(*rectangle)
        mesh = {"rectangle": _numbers(rectangle), "uv": uv, "triangles": triangles.astype(np.uint16)}
        arrays |= {f"{part}_{size}_{name}": array for name, array in mesh.items()}
    np.savez_compressed(STORED, **arrays)


def _mesh_strips(u_range, v_lines, v_samples, sizes, spots):
    """Triangulate a rectangle cut into strips at ``v_lines``; ``sizes`` are the target sizes at ``v_samples``, and each
    of the ``spots`` (u, v, half axes along u and v, size) is an ellipse that is finer."""
    import gmsh

    v_samples, sizes = v_samples.tolist(), sizes.tolist()  # faster than arrays, value by value

    def target(dim, tag, u, v, w, lc):
        i = min(max(bisect_right(v_samples, v), 1), len(v_samples) - 1)
        t = min(max((v - v_samples[i - 1]) / (v_samples[i] - v_samples[i - 1]), 0.0), 1.0)
        wanted = (1 - t) * sizes[i - 1] + t * sizes[i]
        for at_u, at_v, a, b, size in spots:
            outside = (((u - at_u) / a) ** 2 + ((v - at_v) / b) ** 2) ** 0.5 - 1
            wanted = min(wanted, size + GROWTH * max(outside, 0.0) * min(a, b))
        return wanted

    ours = not gmsh.isInitialized()
    if ours:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    previous = None if ours else gmsh.model.getCurrent()
    before = {name: gmsh.option.getNumber(name) for name in GMSH_OPTIONS}
    try:
        for name, value in GMSH_OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add("wheelhouse")
        geo = gmsh.model.geo
        corners = [[geo.addPoint(u, v, 0) for u in u_range] for v in v_lines]
        along = [geo.addLine(*pair) for pair in corners]
        for i in range(len(v_lines) - 1):
            left = geo.addLine(corners[i][0], corners[i + 1][0])
            right = geo.addLine(corners[i][1], corners[i + 1][1])
            geo.addPlaneSurface([geo.addCurveLoop([along[i], right, -along[i + 1], -left])])
        geo.synchronize()
        gmsh.model.mesh.setSizeCallback(target)
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, nodes = gmsh.model.mesh.getElementsByType(2)
    finally:
        gmsh.model.mesh.removeSizeCallback()
        gmsh.model.remove()
        if ours:
            gmsh.finalize()
        else:
            gmsh.model.setCurrent(previous)
            for name, value in before.items():
                gmsh.option.setNumber(name, value)

    order = np.argsort(tags)
    used, triangles = np.unique(np.searchsorted(tags, nodes, sorter=order), return_inverse=True)
    uv = coordinates.reshape(-1, 3)[order[used], :2]
    triangles = triangles.reshape(-1, 3)
    a, b = uv[triangles[:, 1]] - uv[triangles[:, 0]], uv[triangles[:, 2]] - uv[triangles[:, 0]]
    clockwise = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return uv, triangles


# --- proposed fixture, joints and measurement points ------------------------------------------------------------------

WELDS = {"W1": -86.0, "W2": -38.0, "W3": 24.0, "W4": 54.0, "W5": 92.0}  # arch angle, degrees
ZONES = {"CZ1": (-78.0, -46.0), "CZ2": (-26.0, 14.0), "CZ3": (60.0, 84.0)}  # front, top, rear: arch angles, degrees
CLAMPS = {"CZ1": (-70.0, -54.0), "CZ2": (-16.0, 4.0), "CZ3": (66.0, 78.0)}  # two in each zone
PAD_RING = 7.0  # mm: a clamp presses on a point at its centre and on six at this distance (`table1.toml`)
# The other 20 points of a zone: (share of its length, mm from the flange's root); its clamps are at 0.25 and 0.75.
BESIDE_PADS = [(u, s) for u in (0.03, 0.13, 0.37, 0.45, 0.55, 0.63, 0.87, 0.97) for s in (4.0, 20.0)]
BESIDE_PADS += [(u, FLANGE_WIDTH / 2) for u in (0.08, 0.41, 0.59, 0.92)]
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
_EDGE = (
    3.0 / FLANGE_WIDTH
)  # fraction: 3 mm inside the flange's free edge, where a 5 mm wide spot still lies on the sheet

# name: (region, arch angle, fraction of the region, direction; None = the sheet's normal, else projected on the sheet)
# A1-A3, B1, B2, C1 hold the part statically determinately (3-2-1); A4-A8 complete the 8-2-1 scheme.
LOCATORS = {
    "inner": {
        "A1": ("face", -82.0, 0.5, None),
        "A2": ("face", 86.0, 0.5, None),
        "A3": ("face", 2.0, 0.5, None),
        "A4": ("tread", -84.0, 0.3, None),
        "A5": ("tread", 90.0, 0.3, None),
        "A6": ("tread", -30.0, 0.3, None),
        "A7": ("tread", 36.0, 0.3, None),
        "A8": ("flange", 34.0, 0.5, None),
        "B1": ("face", -72.0, 0.3, Z),
        "B2": ("face", 76.0, 0.3, Z),
        "C1": ("face", -8.0, 0.3, X),
    },
    "outer": {
        "A1": ("wall", -84.0, 0.4, None),
        "A2": ("wall", 90.0, 0.4, None),
        "A3": ("wall", 2.0, 0.4, None),
        "A4": ("brim", -66.0, 0.5, None),
        "A5": ("brim", 72.0, 0.5, None),
        "A6": ("brim", -28.0, 0.5, None),
        "A7": ("brim", 32.0, 0.5, None),
        "A8": ("flange", 44.0, 0.5, None),
        "B1": ("wall", -76.0, 0.4, Z),
        "B2": ("wall", 82.0, 0.4, Z),
        "C1": ("wall", -8.0, 0.4, X),
    },
}
# At the flange's soft free edge; on the inner part at the feet, which open by springback.
CORRECTIVE_FORCES = {
    "F1": ("inner", "flange", -91.0, _EDGE),
    "F2": ("inner", "flange", -6.0, _EDGE),
    "F3": ("inner", "flange", 97.0, _EDGE),
    "F4": ("outer", "flange", -78.0, _EDGE),
    "F5": ("outer", "flange", 4.0, _EDGE),
    "F6": ("outer", "flange", 84.0, _EDGE),
}
MEASUREMENTS = {
    "M1": ("outer", "flange", -92.0, _EDGE),
    "M2": ("outer", "flange", -42.0, _EDGE),
    "M3": ("outer", "flange", 18.0, _EDGE),
    "M4": ("outer", "flange", 57.0, _EDGE),
    "M5": ("outer", "flange", 97.0, _EDGE),
    "M6": ("outer", "wall", -45.0, 0.85),
    "M7": ("outer", "wall", 50.0, 0.85),
    "M8": ("inner", "tread", 22.0, 0.3),
}


def pressed_points(zone: str) -> np.ndarray:
    """(34, 3) contact points of a zone in `table1.toml`, mm: seven under each of its clamps, 20 elsewhere."""
    first, last = ZONES[zone]
    angles, heights = [], []
    for clamp in CLAMPS[zone]:
        inner, _, _ = flange_point([clamp - 0.5, clamp + 0.5], FLANGE_WIDTH / 2)
        degree = np.linalg.norm(inner[1] - inner[0])  # mm along the flange
        around = np.radians(np.arange(30.0, 390.0, 60.0))
        angles += [clamp, *(clamp + PAD_RING * np.cos(around) / degree)]
        heights += [FLANGE_WIDTH / 2, *(FLANGE_WIDTH / 2 + PAD_RING * np.sin(around))]
    angles += [first + share * (last - first) for share, _ in BESIDE_PADS]
    heights += [height for _, height in BESIDE_PADS]
    inner, outer, _ = flange_point(angles, heights)
    return (inner + outer) / 2


def layout() -> dict[str, list[dict]]:
    """The proposed fixture, joints, corrective forces and measurement points.

    Returns
    -------
    dict
        Lists ``locators``, ``clamps``, ``welds``, ``zones``, ``deviations`` and ``measurements`` of dicts with name,
        part(s), ``point`` or ``path`` (mm; on the nominal mid-surface, for welds and zones on the surface where the
        sheets touch) and ``direction`` (unit vector).
    """
    tables = {key: [] for key in ("locators", "clamps", "welds", "zones", "deviations", "measurements")}
    for part, locators in LOCATORS.items():
        for name, (region, angle, fraction, direction) in locators.items():
            point, normal = surface_point(part, region, angle, fraction)
            if direction is None:
                direction = normal
            else:
                direction = np.array(direction) - (np.array(direction) @ normal) * normal
                direction /= np.linalg.norm(direction)
            tables["locators"].append({"name": f"{part}-{name}", "part": part, "point": point, "direction": direction})
    for zone, angles in CLAMPS.items():
        for i, angle in enumerate(angles, 1):
            inner, outer, normal = flange_point(angle, FLANGE_WIDTH / 2)
            name = f"{zone}-{i}"  # tongs: each of the two pads pushes its sheet against the other
            tables["clamps"].append({"name": f"{name}-inner", "part": "inner", "point": inner, "direction": normal})
            tables["clamps"].append({"name": f"{name}-outer", "part": "outer", "point": outer, "direction": -normal})
    for name, angle in WELDS.items():
        inner, outer, _ = flange_point(angle, FLANGE_WIDTH / 2)
        tables["welds"].append({"name": name, "parts": ["inner", "outer"], "point": (inner + outer) / 2})
    for name, (first, last) in ZONES.items():
        inner, outer, _ = flange_point(np.linspace(first, last, 9), FLANGE_WIDTH / 2)
        tables["zones"].append({"name": name, "parts": ["inner", "outer"], "path": (inner + outer) / 2})
    for key, places in (("deviations", CORRECTIVE_FORCES), ("measurements", MEASUREMENTS)):
        for name, (part, region, angle, fraction) in places.items():
            point, normal = surface_point(part, region, angle, fraction)
            tables[key].append({"name": name, "part": part, "point": point, "direction": normal})
    return tables


def main():
    """Print :func:`layout` as TOML."""

    def toml(value):
        if isinstance(value, str):
            return f'"{value}"'
        if isinstance(value, (list, np.ndarray)):
            return f"[{', '.join(toml(item) for item in value)}]"
        return f"{value:.3f}".replace("-0.000", "0.000")

    for key, rows in layout().items():
        for row in rows:
            print(f"[[{key}]]")
            for name, value in row.items():
                print(f"{name} = {toml(value)}")
            print()


if __name__ == "__main__":
    main()
