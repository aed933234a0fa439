"""Published shell problems on all elements, with the observed convergence.

"Ratio" is the computed displacement over the reference. Kirchhoff theory (DKT + OPT) and Reissner–Mindlin theory (P2 ×
CR) differ where a structure is thick or carries torsion in open strips; each case says so where it matters.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.panels import grid
from support.shells import at, read, supported_solution, vertex_load

from fem_reference.shell.part import ELEMENTS, ShellPart
from verification.curved_sheets import sheets
from verification.curved_sheets.sheets import end_load, near

pytestmark = pytest.mark.fem

SHEARS = ("p2-cr", "dkmt-opt-curved")  # elements with transverse shear


def quarter_cylinder(element, n, radius, length, angle, thickness, young, poisson):
    """Part and supports of a quarter of a cylinder about y: a diaphragm at an end, symmetry at crown and middle."""

    def shape(X, Y):
        return np.column_stack([radius * np.sin(angle * X), Y * length / 2, radius * np.cos(angle * X)])

    part = ShellPart(grid(n, n, shape), thickness, young, poisson, element)
    diaphragm = at(part, lambda x: near(x[:, 1], 0), [0, 2])
    middle = at(part, lambda x: near(x[:, 1], length / 2), [1, 3, 5])
    crown = at(part, lambda x: near(x[:, 0], 0), [0, 4, 5])
    return part, [diaphragm, middle, crown]


def scordelis_lo(element, n):
    """Roof under its weight on diaphragms; vertical deflection at the middle of the free edge.

    0.3024 with shallow-shell theory (Scordelis and Lo 1964; MacNeal and Harder 1985); converged deep shells give 0.3006
    (Kiendl, Bletzinger, Linhard and Wüchner 2009, Comput. Methods Appl. Mech. Engrg 198, 3902–3914), used here.
    """
    R, L, t, angle = 25.0, 50.0, 0.25, np.radians(40)
    part, supports = quarter_cylinder(element, n, R, L, angle, t, 4.32e8, 0.0)
    u = supported_solution(part, supports, part.gravity([0, 0, -90 / t], 1.0))
    return -read(part, u, [R * np.sin(angle), L / 2, R * np.cos(angle)])[2] / 0.3006


def pinched_cylinder(element, n):
    """Two opposite forces on a cylinder with end diaphragms; deflection under the force.

    1.8249e-5: 164.24 P/(E t), thin-shell series (Lindberg, Olson and Cowper 1969, Q. Bull. Div. Mech. Engng, Nat. Res.
    Counc. Canada 4, as the OpenSees gallery quotes it). With
    transverse shear the deflection under a point force has no limit: such elements pass through the reference on their
    way, and each halving of the mesh adds P ln 2/(2π k G t), 0.2 %.
    """
    R, L = 300.0, 600.0
    part, supports = quarter_cylinder(element, n, R, L, np.pi / 2, 3.0, 3e6, 0.3)
    side = at(part, lambda x: near(x[:, 2], 0), [2, 3, 4])
    load = vertex_load(part, [0, L / 2, R], [0, 0, -0.25])
    return -read(part, supported_solution(part, [*supports, side], load), [0, L / 2, R])[2] / 1.8249e-5


def pinched_hemisphere(element, n):
    return sheets.hemisphere(element, "mesh", 0, n, jitter=0.0)


def twisted_beam(thickness, direction):
    return lambda element, n: sheets.twisted_beam(element, "mesh", 0, direction, n, thickness, jitter=0.0)


def raasch_hook(element, n):
    """Curved thick strip (t = 2, width 20, radii 14 and 46) under a transverse unit force at its tip.

    5.022: solids of 20 nodes, extrapolated by FinEtoolsFlexStructures.jl (raasch_3d_examples.jl, 5.0220), which cites
    5.02 from Abaqus' documentation. The hook works in torsion, and Kirchhoff theory lacks the torsional edge layers,
    0.63 t/b = 6.3 % of the strip's torsional stiffness: it ends so much lower.
    """
    width, first, second = 20.0, np.pi / 3 * 14, np.radians(150) * 46
    centre = 60 * np.array([np.sin(np.pi / 3), np.cos(np.pi / 3)])

    def shape(X, Y):
        s = X * (first + second)
        near_end, far = s / 14, np.pi / 3 - (s - first) / 46
        x = np.where(s <= first, 14 * np.sin(near_end), centre[0] - 46 * np.sin(far))
        y = np.where(s <= first, 14 * np.cos(near_end), centre[1] - 46 * np.cos(far))
        return np.column_stack([x, y, width * Y])

    part = ShellPart(grid(7 * n, 2 * n, shape), 2.0, 3300.0, 0.35, element)
    tip = shape(np.array([1.0]), np.array([0.5]))[0]
    load = end_load(part, lambda x: np.linalg.norm(x[:, :2] - tip[:2], axis=1) < 1e-6, 2, [0, 0, 1])
    u = supported_solution(part, [at(part, lambda x: near(x[:, 0], 0) & near(x[:, 1], 14), range(6))], load)
    return read(part, u, tip)[2] / (5.022 if element in SHEARS else (1 - 0.063) * 5.022)


def cook_membrane(element, n):
    """Cook's tapered panel in plane stress, ν = 1/3, tip deflection 23.96 (the case: Cook 1974, J. Struct. Div. ASCE
    100, 1851–1863; the number, converged by many, in no text of his that we could read)."""
    shape = lambda X, Y: np.column_stack([48 * X, 44 * X + (44 - 28 * X) * Y, 0 * X])
    part = ShellPart(grid(n, n, shape), 1.0, 1.0, 1 / 3, element)
    load = end_load(part, lambda x: near(x[:, 0], 48), 1, [0, 1, 0])
    out_of_plane = np.flatnonzero(np.isin(part.dof_component, [2, 3, 4]))
    u = supported_solution(part, [at(part, lambda x: near(x[:, 0], 0), range(6)), out_of_plane], load)
    return read(part, u, [48, 52, 0])[1] / 23.9648


def clamped_circular_plate(element, n, t=0.02, shear=False):
    """Uniform pressure p on a clamped disc of radius R: w(0) = p R⁴/(64 D), plus p R²/(4 · 5/6 G t) with transverse
    shear; exact."""
    young, poisson = 1e6, 0.3

    def shape(X, Y):  # square onto disc, concentric squares to circles
        x, y = 2 * X - 1, 2 * Y - 1
        ring, radius = np.maximum(abs(x), abs(y)), np.hypot(x, y)
        shrink = np.divide(ring, radius, out=np.zeros_like(ring), where=radius > 0)
        return np.column_stack([x * shrink, y * shrink, 0 * x])

    part = ShellPart(grid(n, n, shape), t, young, poisson, element)
    rim = at(part, lambda x: np.hypot(x[:, 0], x[:, 1]) > 1 - 0.6 / n**2, range(6))
    u = supported_solution(part, [rim], part.gravity([0, 0, 1 / t], 1.0))
    exact = 1 / (64 * young * t**3 / 12 / (1 - poisson**2))
    if shear or element in SHEARS:
        exact += 1 / (4 * 5 / 6 * young / (2 * (1 + poisson)) * t)
    return read(part, u, [0, 0, 0])[2] / exact


def folded_strip(element, n):
    """L-shaped strip, ν = 0, clamped at the foot of its post a, loaded downwards at the end of its arm b.

    Beam theory is exact: δ = P (b³/3 + a b²)/(E I), plus P a/(E A) from the post and P b/(5/6 G A) with transverse
    shear. A fold that does not hand the moment on, or twists through it, misses a b².
    """
    a, b, width, t, young = 30.0, 20.0, 10.0, 1.0, 210000.0

    def shape(X, Y):
        s = X * (a + b)
        return np.column_stack([np.maximum(s - a, 0), width * Y, np.minimum(s, a)])

    part = ShellPart(grid(5 * n, n, shape, pattern="cross"), t, young, 0.0, element)
    load = end_load(part, lambda x: near(x[:, 0], b), 1, [0, 0, -1])
    u = supported_solution(part, [at(part, lambda x: near(x[:, 2], 0), range(6))], load)
    exact = (b**3 / 3 + a * b**2) / (young * width * t**3 / 12) + a / (young * width * t)
    if element in SHEARS:
        exact += b / (5 / 6 * young / 2 * width * t)
    return -read(part, u, [b, width / 2, a])[2] / exact


def square_tube(element, n):
    """Thin square tube in torsion: θ = T L/(4 A² G t/s) (Bredt), the corners' folds carrying the shear flow round. ν =
    0.3.

    A square tube does not warp, so the formula is exact but for the walls' own torsion, (t/b)²/3 of it.
    """
    side, length, t, young, poisson = 20.0, 60.0, 0.5, 210000.0, 0.3
    corner = side / 2 * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]])

    def shape(X, Y):
        section = np.column_stack([np.interp(4 * Y, range(5), corner[:, i]) for i in (0, 1)])
        return np.column_stack([length * X, section])

    open_tube = grid(3 * n, 4 * n, shape)
    points, number = np.unique(np.round(open_tube.points, 9), axis=0, return_inverse=True)
    part = ShellPart(type(open_tube)(points, number.ravel()[open_tube.triangles]), t, young, poisson, element)
    held = at(part, lambda x: near(x[:, 0], 0), [1, 2])
    still = at(part, lambda x: near(x[:, 0], 0) & near(x[:, 1], side / 2) & near(abs(x[:, 2]), side / 2), [0])
    opposite = at(part, lambda x: near(x[:, 0], 0) & near(x[:, 1], -side / 2) & near(x[:, 2], side / 2), [0])
    turned = at(part, lambda x: near(x[:, 0], length), [1, 2])
    motion, (_, y, z) = np.zeros(part.ndof), part.dof_position[turned].T
    motion[turned] = np.where(part.dof_component[turned] == 1, -z, y)
    u = supported_solution(part, [held, still, opposite, turned], np.zeros(part.ndof), motion)
    torque = motion @ part.stiffness_csr() @ u
    G = young / 2 / (1 + poisson)
    return side**3 * G * t / length * (1 + (t / side) ** 2 / 3) / torque


#: Cells of the finest mesh and the tolerance there, by element; where the reference is known well enough, also the
#: least observed rate of the last halving.
CASES = {
    "scordelis-lo": (scordelis_lo, (8, 0.01), (8, 0.01), (16, 0.01, 1.8), (8, 0.01)),
    "pinched cylinder": (pinched_cylinder, (56, 0.01), (48, 0.02), (48, 0.01), (32, 0.01, 1.8)),
    "pinched hemisphere": (pinched_hemisphere, (16, 0.01, 2), (16, 0.01, 2), (32, 0.01, 2), (40, 0.01, 2)),
    "thick twisted beam, in plane": (twisted_beam(0.32, direction=2), *[(2, 0.01)] * 4),
    "thin twisted beam, across": (
        twisted_beam(0.0032, direction=1), (4, 0.01), (4, 0.01), (24, 0.01, 2), (16, 0.02, 2)
    ),
    "raasch hook": (raasch_hook, (4, 0.01), (12, 0.02), (4, 0.01), (6, 0.02)),
    "cook's membrane": (cook_membrane, *[(32, 0.01, 1.2)] * 3, (8, 0.01, 1.2)),
    "clamped circular plate": (clamped_circular_plate, *[(16, 0.01, 1.8)] * 3, (24, 0.01, 1.8)),
    "folded strip": (folded_strip, *[(2, 1e-3)] * 3, (3, 1e-3)),
    "square tube": (square_tube, *[(2, 0.01)] * 3, (4, 0.01)),
}  # fmt: skip


def test_every_element_stands_on_the_page():
    page = (Path(__file__).resolve().parents[1] / "docs" / "shells.md").read_text(encoding="utf-8")
    assert all(f"`{element}`" in page for element in ELEMENTS)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("name", CASES)
def test_published(name, element):
    ratio, *cases = CASES[name]
    n, tolerance, *least_rate = dict(zip(ELEMENTS, cases, strict=True))[element]
    error = ratio(element, n) - 1
    report = f"{name}, {element}: {100 * error:.3f} % on n = {n}"
    if least_rate:
        rate = np.log2(abs((ratio(element, n // 2) - 1) / error))
        report += f", observed rate {rate:.2f}"
        assert rate > least_rate[0], report
    print(report)
    assert abs(error) < tolerance, report


@pytest.mark.parametrize("thickness", [0.1, 0.3])
def test_shear_softens_a_thick_plate_as_theory_has_it(thickness):
    """By 4.6 and 41 % of the deflection: a disc 10 and 30 % as thick as its radius."""
    bent, sheared = (
        clamped_circular_plate(name, 16, thickness, True) for name in ("dkt-opt-curved", "dkmt-opt-curved")
    )
    share = 16 * thickness**2 / (5 * (1 - 0.3))  # p R²/(4 k G t) over p R⁴/(64 D)
    assert abs(sheared - 1) < 0.01 and bent < 1.01 / (1 + share)
