"""Element tests: patch tests, zero-energy modes, locking, distortion; references are computed, not tabulated."""

import numpy as np
import pytest
from support.panels import grid, panel, some_normals
from support.shells import at, supported_solution, vertex

from fem_reference.shell.part import ELEMENTS, ShellPart
from mic.geometry.surface import Surface

pytestmark = pytest.mark.fem

E, NU, T = 210000.0, 0.3, 0.8


def rotation_matrix():
    """Some rotation, so that no axis of the mesh is an axis of space."""
    q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def flat_patch(size, stretch=1.0):
    """Distorted flat mesh of side lengths (10 stretch, 8), turned in space; the frame's columns are its x, y and
    normal."""
    frame = rotation_matrix()
    surface = grid(
        size,
        size,
        lambda X, Y: np.column_stack([10 * stretch * X, 8 * Y, 0 * X]) @ frame.T,
        jitter=0.3,
        pattern="cross",
    )
    return surface, frame


def on_rim(part, frame, stretch):
    """Freedoms on the rim of the patch."""
    x, y, _ = (part.dof_position @ frame).T
    return np.flatnonzero((x < 1e-6) | (x > 10 * stretch - 1e-6) | (y < 1e-6) | (y > 8 - 1e-6))


def exact_freedoms(part, frame, displacement, rotation):
    """Freedoms (ndof,) of fields given in the patch's own frame as functions of (x, y)."""
    x, y, _ = (part.dof_position @ frame).T
    components = np.hstack([displacement(x, y) @ frame.T, rotation(x, y) @ frame.T])
    return components[np.arange(part.ndof), part.dof_component]


def membrane_field(part, frame, stretch):
    """Linear u with constant drilling rotation ½(∂u2/∂x − ∂u1/∂y), and its energy per area t/2 ε:Cε."""
    a = 1e-3 * np.array([[1.0, 0.4], [-0.7, 0.6]])  # ∂u_α/∂x_β
    field = exact_freedoms(
        part,
        frame,
        lambda x, y: np.column_stack([a[0, 0] * x + a[0, 1] * y, a[1, 0] * x + a[1, 1] * y, 0 * x]),
        lambda x, y: np.column_stack([0 * x, 0 * x, 0 * x + (a[1, 0] - a[0, 1]) / 2]),
    )
    strain = (a + a.T) / 2
    return field, T / 2 * plane_stress_energy(strain)


def bending_field(part, frame, stretch):
    """Quadratic w with θ = (∂w/∂y, −∂w/∂x), and its energy per area t³/24 κ:Cκ; w stays small on a long patch."""
    k = 1e-3 * np.array([[0.8 / stretch**2, 0.3 / stretch], [0.3 / stretch, -0.5]])  # ∂²w
    field = exact_freedoms(
        part,
        frame,
        lambda x, y: np.column_stack([0 * x, 0 * x, (k[0, 0] * x * x + 2 * k[0, 1] * x * y + k[1, 1] * y * y) / 2]),
        lambda x, y: np.column_stack([k[0, 1] * x + k[1, 1] * y, -k[0, 0] * x - k[0, 1] * y, 0 * x]),
    )
    return field, T**3 / 24 * plane_stress_energy(k)


def plane_stress_energy(strain):
    """ε : C ε, by its components rather than by the tensor form that the element uses."""
    D = E / (1 - NU**2) * np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]])
    vector = np.array([strain[0, 0], strain[1, 1], 2 * strain[0, 1]])
    return vector @ D @ vector


@pytest.mark.parametrize("stretch", [1, 100])
@pytest.mark.parametrize("field", [membrane_field, bending_field])
@pytest.mark.parametrize("element", ELEMENTS)
def test_patch(element, field, stretch):
    """Constant strain or curvature on the rim of a distorted mesh fills the inside, and stores the exact energy."""
    surface, frame = flat_patch(5, stretch)
    part = ShellPart(surface, T, E, NU, element)
    exact, energy = field(part, frame, stretch)
    u = supported_solution(part, [on_rim(part, frame, stretch)], np.zeros(part.ndof), exact)
    rounding = 3e-9 * stretch**1.5  # 0.4e-9 to 1.1e-9 seen, by compiler and libraries
    for rotations in (False, True):  # of either kind relative to its own size
        kind = (part.dof_component >= 3) == rotations
        assert abs(u - exact)[kind].max() < rounding * abs(exact[kind]).max()
    assert u @ part.stiffness_csr() @ u / 2 == pytest.approx(energy * surface.areas.sum(), rel=rounding)


def junction():
    """Three sheets on one edge."""
    return Surface(np.random.default_rng(1).normal(size=(5, 3)), [[0, 1, 2], [1, 0, 3], [1, 0, 4]])


def single_triangle():
    return Surface([[0, 0, 0], [5, 1, 2], [1, 6, -1]], [[0, 1, 2]])


@pytest.mark.parametrize("surface", [panel, junction, single_triangle])
@pytest.mark.parametrize("element", ELEMENTS)
def test_exactly_six_zero_energy_modes(element, surface):
    """Whatever the normals at the corners of the triangles."""
    drawn = surface()
    surface = Surface(drawn.points, drawn.triangles, some_normals(drawn))
    part = ShellPart(surface, T, E, NU, element)
    K = part.stiffness_csr().toarray()
    assert abs(K - K.T).max() < 1e-13 * abs(K).max()
    assert abs(K @ part.rigid_modes).max() < 1e-11 * abs(K).max() * abs(part.rigid_modes).max()
    # rotations weighed with a length of the mesh, so that the spectrum has one unit
    scale = np.where(part.dof_component < 3, 1.0, 1 / np.sqrt(surface.areas.mean()))
    spectrum = np.linalg.eigvalsh(scale[:, None] * K * scale)
    assert abs(spectrum[:6]).max() < 1e-13 * spectrum[-1]
    assert spectrum[6] > 1e-8 * spectrum[-1]


def felippa_opt_stiffness(x, y, t):
    """OPT stiffness (9, 9), order (u_x, u_y, θ) per node, by the matrices printed in Felippa (2003)."""
    X = lambda i, j: x[i - 1] - x[j - 1]
    Y = lambda i, j: y[i - 1] - y[j - 1]
    A = (X(2, 1) * Y(3, 1) - X(3, 1) * Y(2, 1)) / 2
    D = E / (1 - NU**2) * np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]])
    α, β0, β = 1.5, 0.5 * (1 - 4 * NU**2), [None, 1, 2, 1, 0, 1, -1, -1, -1, -2]
    L = np.zeros((9, 3))
    for j, i, k in ((1, 3, 2), (2, 1, 3), (3, 2, 1)):
        L[3 * j - 3] = [Y(k, i), 0, X(i, k)]
        L[3 * j - 2] = [0, X(i, k), Y(k, i)]
        rotation = [Y(k, i) * (Y(j, i) - Y(k, j)), X(i, k) * (X(i, j) - X(j, k))]
        L[3 * j - 1] = α / 6 * np.array([*rotation, 2 * (X(i, j) * Y(j, i) - X(k, j) * Y(j, k))])
    L *= t / 2
    basic = L @ D @ L.T / (t * A)
    l2 = {(i, j): X(i, j) ** 2 + Y(i, j) ** 2 for i, j in ((2, 1), (3, 2), (1, 3))}
    Te = np.array(
        [
            [Y(2, 3) * Y(1, 3) * l2[2, 1], Y(3, 1) * Y(2, 1) * l2[3, 2], Y(1, 2) * Y(3, 2) * l2[1, 3]],
            [X(2, 3) * X(1, 3) * l2[2, 1], X(3, 1) * X(2, 1) * l2[3, 2], X(1, 2) * X(3, 2) * l2[1, 3]],
            [
                (Y(2, 3) * X(3, 1) + X(3, 2) * Y(1, 3)) * l2[2, 1],
                (Y(3, 1) * X(1, 2) + X(1, 3) * Y(2, 1)) * l2[3, 2],
                (Y(1, 2) * X(2, 3) + X(2, 1) * Y(3, 2)) * l2[1, 3],
            ],
        ]
    ) / (4 * A**2)
    per_edge = 2 * A / 3 / np.array([[l2[2, 1]], [l2[3, 2]], [l2[1, 3]]])
    Q1 = per_edge * [[β[1], β[2], β[3]], [β[4], β[5], β[6]], [β[7], β[8], β[9]]]
    Q2 = per_edge * [[β[9], β[7], β[8]], [β[3], β[1], β[2]], [β[6], β[4], β[5]]]
    Q3 = per_edge * [[β[5], β[6], β[4]], [β[8], β[9], β[7]], [β[2], β[3], β[1]]]
    natural = Te.T @ D @ Te
    higher = sum(Q.T @ natural @ Q for Q in ((Q1 + Q2) / 2, (Q2 + Q3) / 2, (Q3 + Q1) / 2))
    Tθ = np.zeros((3, 9))
    Tθ[:, [0, 3, 6]] = np.array([X(3, 2), X(1, 3), X(2, 1)]) / (4 * A)
    Tθ[:, [1, 4, 7]] = np.array([Y(3, 2), Y(1, 3), Y(2, 1)]) / (4 * A)
    Tθ[:, [2, 5, 8]] += np.eye(3)
    return basic + 0.75 * β0 * t * A * Tθ.T @ higher @ Tθ


def test_membrane_equals_the_published_matrices():
    x, y = np.array([0.3, 5.0, 1.2]), np.array([-0.4, 0.9, 6.1])
    part = ShellPart(Surface(np.column_stack([x, y, 0 * x]), [[0, 1, 2]]), T, E, NU)
    order = [
        np.flatnonzero((part.dof_component == c) & (abs(part.dof_position[:, 0] - x[node]) < 1e-9))[0]
        for node in range(3)
        for c in (0, 1, 5)
    ]
    K = part.stiffness_csr()[order][:, order].toarray()
    expected = felippa_opt_stiffness(x, y, T)
    assert abs(K - expected).max() < 1e-12 * abs(expected).max()


@pytest.mark.parametrize("sides, poisson", [((1, 1), 0.0), ((100, 1), 0.3), ((1, 100), 0.49)])
def test_in_plane_bending_energy_at_any_aspect_ratio(sides, poisson):
    """A rectangle a × b of two triangles bent in its plane stores E I κ² a/2, what OPT is optimal for (Felippa 2003).

    Nodal values of u1 = −κ x y, u2 = κ x²/2, ω = κ x.
    """
    a, b = sides
    part = ShellPart(grid(1, 1, lambda X, Y: np.column_stack([a * (X - 0.5), b * (Y - 0.5), 0 * X])), T, E, poisson)
    (x, y, _), component, κ = part.dof_position.T, part.dof_component, 1e-3
    u = np.select([component == 0, component == 1, component == 5], [-κ * x * y, κ * x**2 / 2, κ * x], 0.0)
    energy = u @ part.stiffness_csr() @ u / 2
    assert energy == pytest.approx(E * T * b**3 / 12 * κ**2 * a / 2, rel=1e-6)


@pytest.mark.parametrize(("t", "jitter"), [(10.0, 0.0), (0.001, 0.0), (0.1, 0.1)])
@pytest.mark.parametrize("element", ELEMENTS)
def test_pinched_ring_from_thick_to_thin(element, t, jitter):
    """t/R = 1e-1 … 1e-5 with triangle sides along the generators, 1e-1 … 1e-3 without. ν = 0.

    Flat triangles askew to the generators cannot bend without stretching once their rise h²/(8R) = 0.03 mm exceeds the
    thickness, whatever the element: at t/R = 1e-4 on the jittered mesh both are some 20 % too stiff, at 1e-5 90 %.

    Thin-ring theory, bending and stretching of a quarter under P/2 at the crown (Timoshenko, Strength of Materials):
    δ/2 = P R³/(8 E I) (π − 8/π) + π P R/(8 E b t), δ the change of the pinched diameter; transverse shear adds π P R/(8
    · 5/6 G b t).
    """
    R, b = 100.0, 40.0
    shape = lambda X, Y: np.column_stack([R * np.sin(np.pi / 2 * X), b * Y, R * np.cos(np.pi / 2 * X)])
    part = ShellPart(grid(32, 4, shape, jitter=jitter, pattern="cross"), t, E, 0.0, element)
    on_crown = np.flatnonzero(abs(part.surface.points[:, 0]) < 1e-9)
    P = 1.0
    share = np.full(len(on_crown), 1 / (len(on_crown) - 1))
    share[np.isin(part.surface.points[on_crown, 1], (0.0, b))] /= 2
    load = np.zeros(part.ndof)
    load[part.vertex_displacement_dofs[on_crown, 2]] = -P / 2 * share
    crown = at(part, lambda x: abs(x[:, 0]) < 1e-9, [0, 4, 5])
    side = at(part, lambda x: abs(x[:, 2]) < 1e-9, [2, 3, 4])
    still = part.vertex_displacement_dofs[vertex(part, [R, 0, 0]), 1]
    u = supported_solution(part, [crown, side, [still]], load)
    bending = P * R**3 / (8 * b * E * t**3 / 12) * (np.pi - 8 / np.pi)
    stretching = np.pi * P * R / (8 * b * E * t)
    shear = np.pi * P * R / (8 * b * 5 / 6 * E / 2 * t) if element in ("p2-cr", "dkmt-opt-curved") else 0.0
    mean = -(share @ u[part.vertex_displacement_dofs[on_crown, 2]])
    assert mean == pytest.approx(bending + stretching + shear, rel=0.01)
