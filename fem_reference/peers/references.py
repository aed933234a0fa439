"""Converged references: compliance of sheets by CalculiX and by shells with shear, extrapolated from three meshes.

    python -m fem_reference.peers.references            compares an element with the stored references
    python -m fem_reference.peers.references --write    computes the references anew (a quarter of an hour, needs ccx)

Each case is solved on three meshes by each of

    S6, S8R     CalculiX: shells expanded into solids, triangles and quadrilaterals with curved sides
    p2-cr       `fem_reference`: quadratic displacements, Crouzeix–Raviart rotations, on flat triangles

With H on sizes h, h/2, h/4 and D₁ = H(h/2) − H(h), D₂ = H(h/4) − H(h/2), the observed order is p = log₂ ‖D₁‖/‖D₂‖ and

    H₀ = H(h/4) + D₂ / (2ᵖ − 1),        error of H₀ ≤ ‖D₂‖ / (2ᵖ − 1),

which is the whole extrapolation step. The method with the smallest step provides the reference. Norms are Frobenius
norms, relative to that of the reference. All three methods include transverse shear. A Kirchhoff element does not: on a
thick sheet under small discs it converges to a compliance that is smaller by about the shear deformation of the discs.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem_reference.peers import calculix
from fem_reference.shell.factorisation import Factorisation
from fem_reference.shell.part import ShellPart
from mic.geometry.surface import Surface

__all__ = [
    "CASES",
    "METHODS",
    "Case",
    "by_calculix",
    "by_shells",
    "errors",
    "extrapolated",
    "load",
    "on_triangles",
    "table",
]

STORED = Path(__file__).with_suffix(".json")
YOUNG, POISSON = 210e3, 0.3  # MPa


@dataclass(frozen=True)
class Case:
    """A sheet, clamped along an edge, and the discs over which unit forces act and displacements are averaged.

    Attributes
    ----------
    thickness : float
        mm.
    sizes : (float, float, float)
        Element sizes, mm, each half of the previous one.
    grid : callable
        ``grid(size)``: coordinates (n, c) and quadrilaterals (q, 4).
    shape : callable
        Maps coordinates (n, c) to positions (n, 3), mm.
    clamped : callable
        ``clamped(positions)``: mask of the clamped nodes.
    discs : list of (centre (3,), direction (3,))
        mm; the displacement along the direction is averaged over the disc around the centre, normal to the direction.
    radius : float
        Radius of the discs, mm.
    """

    thickness: float
    sizes: tuple[float, float, float]
    grid: Callable
    shape: Callable
    clamped: Callable
    discs: list
    radius: float


def _cells(n: int, m: int, closed: bool = False):
    """Quadrilaterals (n m, 4) of a grid of n × m cells, with vertices numbered along m first.

    A closed grid joins its last row of cells to the first vertices. Every other cell begins at its second corner, so
    that the diagonals of `_halves` meet at every other vertex.
    """
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    at = lambda i, j: (i % n if closed else i) * (m + 1) + j
    cells = np.column_stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)])
    return np.where(((i + j) % 2 == 1)[:, None], np.roll(cells, -1, axis=1), cells)


def _halves(quadrilaterals):
    """Two triangles of each quadrilateral, along the diagonal from its first corner."""
    return np.concatenate([quadrilaterals[:, [0, 1, 2]], quadrilaterals[:, [0, 2, 3]]])


def _disc_points(centre, direction, radius):
    """Quadrature points (q, 3) and weights (q,) of a disc: Gauss along the radius, equidistant along the angle."""
    g, w = np.polynomial.legendre.leggauss(8)
    r, angle = np.repeat(radius * (g + 1) / 2, 24), np.tile(2 * np.pi * (np.arange(24) + 0.5) / 24, 8)
    t1 = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    t1 /= np.linalg.norm(t1)
    t2 = np.cross(direction, t1)
    weight = np.repeat(w * (g + 1), 24)
    return centre + r[:, None] * (np.cos(angle)[:, None] * t1 + np.sin(angle)[:, None] * t2), weight / weight.sum()


def _spread(case: Case, points, triangles):
    """Vertex weights (n, 3, r) of the discs, linear between the vertices."""
    surface = Surface(points, triangles)
    weights = np.zeros((len(points), 3, len(case.discs)))
    for k, (centre, direction) in enumerate(case.discs):
        x, share = _disc_points(np.asarray(centre), np.asarray(direction), case.radius)
        foot = surface.project(x, np.tile(direction, (len(x), 1)))
        value = (share[:, None] * foot.barycentric)[:, :, None] * direction
        np.add.at(weights[:, :, k], triangles[foot.triangle], value)
    return weights


def by_calculix(case: Case, size: float, corners: int) -> np.ndarray:
    """H (r, r) by S6 (three corners) or S8R (four)."""
    coordinates, quadrilaterals = case.grid(size)
    triangles = _halves(quadrilaterals)
    points = case.shape(coordinates)
    weights = _spread(case, points, triangles)
    nodes, elements = calculix.quadratic(coordinates, quadrilaterals if corners == 4 else triangles, case.shape)
    u = calculix.shell_displacements(nodes, elements, case.thickness, YOUNG, POISSON, case.clamped(nodes), weights)
    return np.einsum("nir,nis->rs", weights, u)


def by_shells(case: Case, size: float, element: str, normals: Callable | None = None) -> np.ndarray:
    """H (r, r) by an element of `fem_reference` on the triangles of S6; ``normals(points)`` gives exact normals."""
    coordinates, quadrilaterals = case.grid(size)
    points = case.shape(coordinates)
    return on_triangles(case, points, _halves(quadrilaterals), element, None if normals is None else normals(points))


def on_triangles(
    case: Case, points: np.ndarray, triangles: np.ndarray, element: str, normals: np.ndarray | None = None
) -> np.ndarray:
    """H (r, r) by an element of `fem_reference`, with loads and readings linear between vertices as for CalculiX.

    Parameters
    ----------
    case : Case
    points : (n, 3) array
        Vertices on the case's surface, mm.
    triangles : (k, 3) int array
    element : str
    normals : (n, 3) array, optional
        Exact normals of the surface at the vertices; estimated from the triangles otherwise.
    """
    weights = _spread(case, points, triangles)
    surface = Surface(points, triangles, None if normals is None else normals[triangles])
    part = ShellPart(surface, case.thickness, YOUNG, POISSON, element)
    held = case.clamped(part.dof_position)
    load = np.zeros((part.ndof, len(case.discs)))
    load[part.vertex_displacement_dofs] = weights
    free = np.flatnonzero(~held)
    u = np.zeros_like(load)
    u[free] = Factorisation(part.stiffness_csr()[free][:, free]).solve(load[free])
    return np.einsum("nir,nis->rs", weights, u[part.vertex_displacement_dofs])


# ------------------------------------------------------------------------------------------------ the cases


def _crowned_panel():
    """Doubly curved panel of 240 × 160 mm, crown 25 mm, with a hole of radius 30 mm, clamped along its short side."""

    def height(x, y):
        return 25 * (1 - (x / 120) ** 2) * (1 - 0.6 * (y / 80) ** 2) + x * y / 1600

    def shape(c):
        d = c[:, :2] / np.linalg.norm(c[:, :2], axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            rim = np.minimum(120 / np.abs(d[:, 0]), 80 / np.abs(d[:, 1]))
        x, y = ((30 * (1 - c[:, 2]) + rim * c[:, 2]) * d.T[i] for i in (0, 1))
        return np.column_stack([x, y, height(x, y)])

    def grid(size):
        corner = np.arctan2(80, 120)
        knots = np.array([0, corner, np.pi / 2, np.pi - corner])
        knots = np.concatenate([knots, knots + np.pi, [2 * np.pi]])
        around, across = 8 * round(60 / size), round(70 / size)
        angle = np.interp(8 * np.arange(around) / around, np.arange(9), knots)
        a = np.repeat(angle, across + 1)
        v = np.tile(np.arange(across + 1) / across, around)
        return np.column_stack([np.cos(a), np.sin(a), v]), _cells(around, across, closed=True)[:, ::-1]

    def disc(x, y):
        zx = -50 * x / 14400 * (1 - 0.6 * (y / 80) ** 2) + y / 1600
        zy = -25 * (1 - (x / 120) ** 2) * 1.2 * y / 6400 + x / 1600
        n = np.array([-zx, -zy, 1.0])
        return np.array([x, y, height(x, y)]), n / np.linalg.norm(n)

    places = [(60, 40), (0, -60), (100, -20), (-50, 30), (42, 10)]
    return Case(1.2, (5, 2.5, 1.25), grid, shape, lambda x: x[:, 0] < -120 + 1e-6, [disc(*p) for p in places], 8.0)


def _angle_section():
    """Plate of 40 × 50 mm with a flange of 20 mm bent up by 90°, clamped along y = 0; nothing is curved."""

    def shape(c):
        return np.column_stack([np.minimum(c[:, 0], 40), c[:, 1], np.maximum(c[:, 0] - 40, 0)])

    def grid(size):
        across, along = round(60 / size), round(50 / size)
        x, y = (
            a.ravel() for a in np.meshgrid(np.linspace(0, 60, across + 1), np.linspace(0, 50, along + 1), indexing="ij")
        )
        return np.column_stack([x, y]), _cells(across, along)

    e = np.eye(3)
    discs = [((15, 30, 0), e[2]), ((30, 15, 0), e[2]), ((40, 25, 10), e[0]), ((40, 40, 10), e[0])]
    return Case(1.0, (5, 2.5, 1.25), grid, shape, lambda x: x[:, 1] < 1e-9, discs, 6.0)


def _trough():
    """Quarter cylinder of radius 60 and length 120 mm that ends in flats of 30 mm: bends without stretching."""
    R, flat = 60.0, 30.0
    arc = np.pi / 2 * R

    def shape(c):
        s, y = c[:, 0], c[:, 1]
        angle = np.clip(s - flat, 0, arc) / R
        beyond = np.maximum(s - flat - arc, 0)
        x = np.minimum(s, flat) + R * np.sin(angle)
        return np.column_stack([x, y, R * (1 - np.cos(angle)) + beyond])

    def grid(size):
        # rows of elements end where the curvature does
        s = np.concatenate(
            [
                np.linspace(0, flat, round(flat / size) + 1),
                np.linspace(flat, flat + arc, round(90 / size) + 1)[1:],
                np.linspace(flat + arc, 2 * flat + arc, round(flat / size) + 1)[1:],
            ]
        )
        y = np.linspace(0, 120, round(120 / size) + 1)
        cells = _cells(len(s) - 1, len(y) - 1)
        s, y = (b.ravel() for b in np.meshgrid(s, y, indexing="ij"))
        return np.column_stack([s, y]), cells

    def disc(s, y):
        angle = np.clip(s - flat, 0, arc) / R
        return shape(np.array([[s, y]], float))[0], np.array([-np.sin(angle), 0, np.cos(angle)])

    places = [(20, 40), (50, 90), (77, 30), (110, 100), (140, 60)]
    return Case(0.8, (5, 2.5, 1.25), grid, shape, lambda x: x[:, 0] < 1e-9, [disc(*p) for p in places], 9.0)


CASES = {"crowned panel": _crowned_panel(), "angle section": _angle_section(), "trough": _trough()}
METHODS = {
    "S6": lambda case, size: by_calculix(case, size, 3),
    "S8R": lambda case, size: by_calculix(case, size, 4),
    "p2-cr": lambda case, size: by_shells(case, size, "p2-cr"),
}


def extrapolated(coarse, middle, fine):
    """H₀ (r, r), the step ‖H₀ − H(h/4)‖ and the observed order."""
    first, second = np.linalg.norm(middle - coarse), np.linalg.norm(fine - middle)
    order = np.log2(first / second)
    if not order > 0.5:
        raise ValueError(
            f"the observed order is {order:.2f}: these meshes do not converge, so no limit can be extrapolated"
        )
    step = (fine - middle) / (2**order - 1)
    return fine + step, float(np.linalg.norm(step)), float(order)


def compute(name: str) -> dict:
    """The stored results of a case: reference, its error, and the errors of each method."""
    case, found = CASES[name], {}
    for method, solve in METHODS.items():
        started = time.perf_counter()
        series = [solve(case, size) for size in case.sizes]
        limit, step, order = extrapolated(*series)
        found[method] = {"limit": limit, "step": step, "order": order, "series": series}
        print(f"{name}: {method} in {time.perf_counter() - started:.0f} s, order {order:.2f}", flush=True)
    best = min(found, key=lambda method: found[method]["step"])
    scale = np.linalg.norm(found[best]["limit"])
    return {
        "sizes": case.sizes,
        "reference": best,
        "H": [[float(f"{value:.6g}") for value in row] for row in found[best]["limit"]],
        "error": found[best]["step"] / scale,
        "methods": {
            method: {
                "order": one["order"],
                "error": one["step"] / scale,
                "apart": float(np.linalg.norm(one["limit"] - found[best]["limit"]) / scale),
                "off": [float(np.linalg.norm(H - found[best]["limit"]) / scale) for H in one["series"]],
            }
            for method, one in found.items()
        },
    }


def load() -> dict:
    """The stored references by case, in the form of :func:`compute`."""
    return json.loads(STORED.read_text())


def errors(name: str, stored: dict, element: str) -> list[float]:
    """‖H(h) − H₀‖/‖H₀‖ of an element on each mesh of a case, and of the element's own extrapolation."""
    H0 = np.array(stored["H"])
    series = [by_shells(CASES[name], size, element) for size in stored["sizes"]]
    series.append(extrapolated(*series)[0])
    return [float(np.linalg.norm(H - H0) / np.linalg.norm(H0)) for H in series]


def table(name: str, stored: dict, element: str) -> str:
    """Markdown table of the error of each method, and of an element of `fem_reference`, on each mesh."""
    percent = lambda values: " | ".join(f"{100 * value:.2f} %" for value in values)
    sizes = " | ".join(f"{size:g} mm" for size in stored["sizes"])
    lines = [f"| {name} | {sizes} | limit | error of the limit | order |", "| --- " * 7 + "|"]
    for method, one in stored["methods"].items():
        mark = "**" if method == stored["reference"] else ""
        values = percent([*one["off"], one["apart"], one["error"]])
        lines.append(f"| {mark}{method}{mark} | {values} | {one['order']:.1f} |")
    lines.append(f"| {element} | {percent(errors(name, stored, element))} | | |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="compute the references anew; needs CalculiX's ccx")
    parser.add_argument("--case", choices=CASES, help="only this one")
    parser.add_argument("--element", default="dkt-opt-curved", help="element of fem_reference to compare")
    options = parser.parse_args()
    stored = load() if STORED.is_file() else {}
    for name in [options.case] if options.case else CASES:
        if options.write:
            stored[name] = compute(name)
            STORED.write_text(json.dumps(stored, indent=None).replace('}, "', '},\n "') + "\n")
        print(table(name, stored[name], options.element), "\n", flush=True)


if __name__ == "__main__":
    main()
