"""Linear shell elements on triangles in space, written as their theory is printed.

The shell carries displacements u and rotations θ (three components each). In the frame (e1, e2, e3) of a
triangle, e3 normal, u = (u1, u2, w); the normal fibre tilts by β = e3 × θ, so that γ = ∇w − β is the transverse shear
and ω = θ·e3 is the rotation about the normal (the drilling freedom). The strain energy per unit area is

    W = t/2 ε : C ε + t³/24 κ : C κ + (shear and drilling terms of the element, if any),               (1)

with ε the membrane strain, κ = sym ∇β the curvature and C plane stress,

    C ε = E/(1−ν²) ((1−ν) ε + ν tr(ε) I).                                                              (2)

Two elements, chosen because they share nothing but (1) and (2):

`dkt_opt`
    (u, θ) linear, six freedoms per vertex. Kirchhoff plate theory held at discrete points (DKT: Batoz, Bathe and Ho
    1980) and Felippa's optimal membrane triangle with drilling freedoms (OPT: Felippa 2003), its strain measured on
    the curved surface that normals at the triangle's corners tell of. No shear strain, no penalty. Where the normals
    are the triangle's own, what is left is DKT and OPT as published. On request it shears: DKMT in place of DKT (Katili
    1993), with the same freedoms, which tends to DKT where the sheet is thin.

`p2_cr`
    u quadratic, θ Crouzeix–Raviart (Campello, Pimenta and Wriggers 2003; Bleyer, Numerical Tours of Computational
    Mechanics with FEniCS). Reissner–Mindlin theory with a drilling penalty. Its triangles are flat.

All integrands are of degree two at most and one quadrature degree is used throughout: FFCx 0.5 generates
wrong matrices where one integral mixes degrees.

References
----------
- Batoz, Bathe, Ho (1980), A study of three-node triangular plate bending elements, Int. J. Numer. Meth. Engng 15,
  1771–1812.
- Katili (1993), A new discrete Kirchhoff–Mindlin element based on Mindlin–Reissner plate theory and assumed shear
  strain fields, part I: an extended DKT element for thick-plate bending analysis, Int. J. Numer. Meth. Engng 36,
  1859–1883.
- Felippa (2003), A study of optimal membrane triangles with drilling freedoms, Comput. Methods Appl. Mech. Engrg 192,
  2125–2168.
- Allman (1984), A compatible triangular element including vertex rotations for plane elasticity analysis, Comput.
  Struct. 19, 1–8.
- Campello, Pimenta, Wriggers (2003), A triangular finite shell element based on a fully nonlinear shell formulation,
  Comput. Mech. 31, 505–518.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import ufl
from ufl import as_matrix, as_vector, cross, dot, grad, inner, outer, sqrt, sym, tr

from fem_reference.shell import compat
from fem_reference.shell.interpolation import CROUZEIX_RAVIART, P1, P2, Interpolation
from mic.geometry.surface import Surface

__all__ = [
    "DRILLING_PENALTY",
    "ELEMENTS",
    "QUADRATURE_DEGREE",
    "SHEAR_FACTOR",
    "Kinematics",
    "Material",
    "ShellElement",
    "Triangle",
    "dkmt_strains",
    "dkt_curvature",
    "dkt_opt",
    "kinematics",
    "membrane_strain",
    "opt_beta0",
    "p2_cr",
    "plane_stress",
    "triangle",
]

QUADRATURE_DEGREE = 2

SHEAR_FACTOR = 5 / 6  # Reissner's, of the transverse shear energy
DRILLING_PENALTY = 1.0  # times E t³/h²: Bleyer's choice


class Material(NamedTuple):
    """Isotropic sheet; the members are of type ``fem.Constant``, so that a form is compiled once for all values."""

    young: ufl.Coefficient  #: E, MPa
    poisson: ufl.Coefficient  #: ν
    thickness: ufl.Coefficient  #: t, mm
    beta0: ufl.Coefficient  #: β0 of OPT's higher-order stiffness, see :func:`opt_beta0`


class Triangle(NamedTuple):
    """Geometry of one flat triangle in its own frame. Vertices, edges and barycentric coordinates are cyclic: 0, 1,
    2."""

    frame: ufl.core.expr.Expr  #: P = [e1 e2] (3, 2): columns in the plane, e1 along the edge 0→1
    normal: ufl.core.expr.Expr  #: e3
    vertex: list  #: three plane vectors; vertex 0 is the origin
    position: ufl.core.expr.Expr  #: plane vector of the point of integration
    area: ufl.core.expr.Expr  #: A
    barycentric: list  #: λ0, λ1, λ2
    gradient: list  #: ∇λ0, ∇λ1, ∇λ2, plane vectors

    #: (i, j, k): the edge from i to j lies opposite vertex k
    edges = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def unit(a):
    return a / sqrt(dot(a, a))


def triangle(mesh) -> Triangle:
    """The `Triangle` of each cell of a mesh, as UFL expressions."""
    jacobian = ufl.Jacobian(mesh)  # columns: edges 0→1 and 0→2
    side1, side2 = (as_vector([jacobian[i, c] for i in range(3)]) for c in (0, 1))
    origin = as_vector([ufl.geometry.CellVertices(mesh)[0, i] for i in range(3)])
    e1, e3 = unit(side1), unit(cross(side1, side2))
    e2 = cross(e3, e1)
    length, (b, height) = sqrt(dot(side1, side1)), (dot(side2, e1), dot(side2, e2))
    # vertices (0, 0), (length, 0), (b, height)
    gradient = [
        as_vector([-1 / length, (b - length) / (length * height)]),
        as_vector([1 / length, -b / (length * height)]),
        as_vector([0, 1 / height]),
    ]
    frame = as_matrix([[e1[i], e2[i]] for i in range(3)])
    position = dot(frame.T, ufl.SpatialCoordinate(mesh) - origin)
    return Triangle(
        frame=frame,
        normal=e3,
        vertex=[as_vector([0, 0]), as_vector([length, 0]), as_vector([b, height])],
        position=position,
        area=length * height / 2,
        barycentric=[1 + dot(gradient[0], position), dot(gradient[1], position), dot(gradient[2], position)],
        gradient=gradient,
    )


def plane_stress(strain, material: Material):
    """C ε of (2)."""
    E, ν = material.young, material.poisson
    return E / (1 - ν**2) * ((1 - ν) * strain + ν * tr(strain) * ufl.Identity(2))


def opt_beta0(poisson: float) -> float:
    """β0 = max(½(1 − 4ν²), 0.01): Felippa (2003), the optimum for in-plane bending at any aspect ratio."""
    return max(0.5 * (1 - 4 * poisson**2), 0.01)


# ---------------------------------------------------------------------------------------------- kinematics


class Kinematics(NamedTuple):
    """Quantities that both elements take from (u, θ): components in the triangle's plane, and their plane gradients."""

    grad_u: ufl.core.expr.Expr  #: ∂u_α/∂x_β, (2, 2)
    grad_w: ufl.core.expr.Expr  #: ∇w, (2,)
    beta: ufl.core.expr.Expr  #: β = e3 × θ in the plane, (2,): where there is no shear, β = ∇w
    grad_beta: ufl.core.expr.Expr  #: (2, 2)
    omega: ufl.core.expr.Expr  #: ω = θ·e3, the drilling rotation
    grad_omega: ufl.core.expr.Expr  #: (2,)

    @property
    def rotation_of_u(self):
        """½(∂u2/∂x1 − ∂u1/∂x2): what ω must equal in a continuum."""
        return (self.grad_u[1, 0] - self.grad_u[0, 1]) / 2


def kinematics(T: Triangle, u, θ) -> Kinematics:
    P, e3 = T.frame, T.normal
    plane_gradient_u = dot(grad(u), P)  # (3, 2)
    plane_gradient_θ = dot(grad(θ), P)
    tilt = as_matrix([[-P[i, 1], P[i, 0]] for i in range(3)])  # (e3 × θ)·e1 = −θ·e2, (e3 × θ)·e2 = θ·e1
    return Kinematics(
        grad_u=dot(P.T, plane_gradient_u),
        grad_w=dot(e3, plane_gradient_u),
        beta=dot(tilt.T, θ),
        grad_beta=dot(tilt.T, plane_gradient_θ),
        omega=dot(e3, θ),
        grad_omega=dot(e3, plane_gradient_θ),
    )


# ---------------------------------------------------------------------------------------------- DKT + OPT


class Corners(NamedTuple):
    """Normals, rotations and displacement gradient of a curved triangle at its corners, as vectors of space."""

    normal: list  #: n0, n1, n2
    rotation: list  #: θ0, θ1, θ2
    relative: list  #: θ′: θ less the rotation of the triangle, which follows from ∇u
    grad_u: ufl.core.expr.Expr  #: ∂u/∂x_β, (3, 2): times a chord it is the difference of u between its ends


def corners(T: Triangle, v: Kinematics, u, θ, normals) -> Corners:
    P = T.frame
    grad_θ = dot(grad(θ), P)
    rotation = [θ + dot(grad_θ, vertex - T.position) for vertex in T.vertex]  # θ is linear
    e1, e2 = (as_vector([P[i, c] for i in range(3)]) for c in (0, 1))
    of_triangle = v.grad_w[1] * e1 - v.grad_w[0] * e2 + v.rotation_of_u * T.normal
    return Corners(normals, rotation, [one - of_triangle for one in rotation], dot(grad(u), P))


def dkt_curvature(T: Triangle, v: Kinematics):
    """Curvature of the discrete Kirchhoff triangle.

    β is linear plus one quadratic bubble per edge, directed along the edge's tangent s, whose amplitude makes
    the shear along the edge vanish in the mean and at both ends (Batoz et al. 1980):

        β = Σ λi βi + Σ_edges 3/2 γ_s s 4 λi λj,      γ_s = (wj − wi)/l − ½(βi + βj)·s
        κ = sym ∇β
    """
    curvature = sym(v.grad_beta)
    for i, j, _ in T.edges:
        curvature += bubble(T, i, j, edge_shear(T, v, i, j))
    return curvature


def dkmt_strains(T: Triangle, v: Kinematics, material: Material):
    """Curvature and transverse shear strain of the discrete Kirchhoff–Mindlin triangle.

    The mean shear γ_s along an edge of length l is shared between the bubble and a shear strain as constant curvature
    has it in equilibrium (Katili 1993). With k the `SHEAR_FACTOR`,

        β = Σ λi βi + Σ_edges 3/2 γ_s/(1 + φ) s 4 λi λj,      φ = 2/(k (1 − ν)) t²/l²
        γ = Σ_edges l γ_s φ/(1 + φ) (λi ∇λj − λj ∇λi)                                                              (10)

    whose tangential component on each edge is γ_s φ/(1 + φ). On thin sheet φ vanishes and DKT is left.
    """
    λ, dλ = T.barycentric, T.gradient
    curvature, γ = sym(v.grad_beta), ufl.zero(2)
    for i, j, _ in T.edges:
        edge = T.vertex[j] - T.vertex[i]
        φ = 2 / (SHEAR_FACTOR * (1 - material.poisson)) * material.thickness**2 / dot(edge, edge)
        share = edge_shear(T, v, i, j) / (1 + φ)  # γ_s/l of the bubble; φ times as much is left
        curvature += bubble(T, i, j, share)
        γ += φ * dot(edge, edge) * share * (λ[i] * dλ[j] - λ[j] * dλ[i])
    return curvature, γ


def edge_shear(T: Triangle, v: Kinematics, i, j):
    """γ_s/l of the edge i→j, β being linear and ∇w constant."""
    edge = T.vertex[j] - T.vertex[i]  # l s
    middle = (T.vertex[i] + T.vertex[j]) / 2
    beta_middle = v.beta + dot(v.grad_beta, middle - T.position)  # ½(βi + βj)
    return dot(v.grad_w - beta_middle, edge) / dot(edge, edge)


def bubble(T: Triangle, i, j, shear):
    """Curvature of the bubble of the edge i→j of length l whose amplitude is 3/2 l times `shear`."""
    λ, dλ = T.barycentric, T.gradient
    edge = T.vertex[j] - T.vertex[i]
    return 3 / 2 * shear * sym(outer(edge, 4 * (λ[i] * dλ[j] + λ[j] * dλ[i])))


def membrane_strain(T: Triangle, v: Kinematics, at: Corners, material: Material):
    """Membrane strain of the optimal triangle with drilling freedoms on a curved surface.

    The surface is known by its unit normals n_i at the corners. An edge i→j, L its chord of length l with the unit
    vector s, is the cubic whose end tangents L + a_i lie in the tangent planes there and have the length that an arc
    asks for. With cos α = ‖n_i + n_j‖/2, Δn = n_j − n_i and P_i = I − n_i n_iᵀ,

        L + a_i = P_i (L + k Δn),   k = (L·Δn) (3 + cos α)/(4 cos α (1 + cos α)(2 + cos α)).

    They rotate with the nodes, δa_i = θ_i × (L + a_i) − ΔL, where ΔL = u_j − u_i. The mean strain along the edge is

        l² ε_e = L·ΔL + r_e,   r_e = q_i·δa_i + q_j·δa_j,   q_i = 2/15 a_i − 1/30 a_j,                              (3)

    the same seen from both of its triangles. The constant strain with these three means is

        ε_0 = sym ∇u − Σ_e r_e sym(∇λi ⊗ ∇λj).                                                                       (4)

    Drilling is the rotation of the corner's tangent plane against the chord, in that plane:

        φ_i = m_i·(θ_i × L − ΔL)/l,   m_i = (n_i × L)/|n_i × L|.                                                     (5)

    Basic part: the strain of edges that bow out by the difference of their end rotations (OPT: α_b = 3/2). With A the
    triangle's area and k opposite to the edge,

        ε_b = ε_0 + α_b A/3 Σ_e (φ_j − φ_i) ∇λk ⊗ ∇λk.                                                               (6)

    Higher-order part, of zero mean and linear in the deviatoric rotations ω̃_i,

        ε_h = −√β0 A Σ_e s_k sym(∇λi ⊗ ∇λj),   s_k = (1 − 3λj) ω̃_i − (1 − 3λi) ω̃_j + (λi − λj) ω̃_k,              (7)

    where ω̃_i is the mean over the corner's two edges of

        φ_i + m·ε_0 s − F l²/6 δ(κτ),   m = e3 × s,                                                                  (8)

    the rotation of the edge by the mean strain, and of the chord against the geodesic of normal curvature
    κ = −Δn·s/l and torsion τ = −Δn·m/l. With θ′ the rotation relative to that of the triangle,
    δκ = −(θ′_j × n_j − θ′_i × n_i)·s/l and δτ likewise with m. F makes (8) vanish for a cylinder that opens; with the
    arc over its chord c = 3/(2 + cos α),

        F = ¾ (1/cos α + c (3 + 2 c cos α)/(3 (6 − c cos α))) · (|n_i × s| |n_j × s|)^−½.                            (9)

    Every quadratic inextensional displacement of every quadratic surface has ε_b = ε_h = 0 (docs/curved_triangle.md).
    With n_i = e3 all a, κ and τ vanish, and (6) and (7) are the ANDES template of Felippa (2003) with (β1 … β9) =
    (1, 2, 1, 0, 1, −1, −1, −1, −2).
    """
    α_b = 3 / 2
    λ, dλ, A, P = T.barycentric, T.gradient, T.area, T.frame
    n, θ = at.normal, at.rotation
    edges = [(i, j, k, T.vertex[j] - T.vertex[i]) for i, j, k in T.edges]
    mean = sym(v.grad_u)
    for i, j, _, chord in edges:
        L, ΔL = dot(P, chord), dot(at.grad_u, chord)
        Δn, cosine = n[j] - n[i], half_turn(n[i], n[j])
        bow = (3 + cosine) / (4 * cosine * (1 + cosine) * (2 + cosine)) * dot(L, Δn) * Δn
        a = {c: bow - dot(L + bow, n[c]) * n[c] for c in (i, j)}
        q = {c: 2 / 15 * a[c] - 1 / 30 * a[o] for c, o in ((i, j), (j, i))}
        # q·δa with the product of three vectors turned round: one cross product of constants for each corner
        r = sum(dot(θ[c], cross(L + a[c], q[c])) for c in (i, j)) - dot(q[i] + q[j], ΔL)
        mean -= r * sym(outer(dλ[i], dλ[j]))
    basic, higher, ω_dev = mean, ufl.zero(2, 2), [0, 0, 0]
    for i, j, k, chord in edges:
        l2 = dot(chord, chord)
        L, ΔL = dot(P, chord), dot(at.grad_u, chord)
        across = as_vector([-chord[1], chord[0]])  # l m
        M, Δn = dot(P, across), n[j] - n[i]
        turn = cross(at.relative[j], n[j]) - cross(at.relative[i], n[i])
        geodesic = (dot(Δn, M) * dot(turn, L) + dot(Δn, L) * dot(turn, M)) / l2  # l² δ(κτ)
        across_normal = {c: cross(n[c], L) for c in (i, j)}
        cosine = half_turn(n[i], n[j])
        arc = 3 / (2 + cosine)
        finite = 3 / 4 * (1 / cosine + arc * (3 + 2 * arc * cosine) / (3 * (6 - arc * cosine)))
        finite *= sqrt(l2 / sqrt(dot(across_normal[i], across_normal[i]) * dot(across_normal[j], across_normal[j])))
        φ = {c: dot(unit(across_normal[c]), cross(θ[c], L) - ΔL) / sqrt(l2) for c in (i, j)}
        for c in (i, j):
            ω_dev[c] += (φ[c] + dot(across, dot(mean, chord)) / l2 - finite * geodesic / 6) / 2
        basic += α_b * A / 3 * (φ[j] - φ[i]) * outer(dλ[k], dλ[k])
    for i, j, k in T.edges:
        s_k = (1 - 3 * λ[j]) * ω_dev[i] - (1 - 3 * λ[i]) * ω_dev[j] + (λ[i] - λ[j]) * ω_dev[k]
        higher -= A * s_k * sym(outer(dλ[i], dλ[j]))
    return basic + sqrt(material.beta0) * higher


def half_turn(n_i, n_j):
    """cos α, 2α the angle between two unit normals."""
    return sqrt(1 - dot(n_j - n_i, n_j - n_i) / 4)


def dkt_opt(V, material: Material, normals, shear: bool = False):
    """Bilinear form of (1) for the six-freedom element on V = [P1]⁶.

    `normals`, of [DG0]⁹, holds n at corners 0, 1, 2 of each cell in turn, on the side of the cell's e3. With `shear`
    bending is DKMT's in place of DKT's, and ``½ k G t |γ|²`` is added with (10).
    """
    T, t = triangle(V.mesh), material.thickness
    G = material.young / (2 * (1 + material.poisson))
    n = [as_vector([normals[3 * corner + i] for i in range(3)]) for corner in range(3)]

    def strains(v):
        u, θ = as_vector([v[i] for i in range(3)]), as_vector([v[i] for i in range(3, 6)])
        v = kinematics(T, u, θ)
        κ, γ = dkmt_strains(T, v, material) if shear else (dkt_curvature(T, v), None)
        return membrane_strain(T, v, corners(T, v, u, θ, n), material), κ, γ

    ε, κ, γ = strains(ufl.TrialFunction(V))
    ε_, κ_, γ_ = strains(ufl.TestFunction(V))
    W = t * inner(plane_stress(ε, material), ε_) + t**3 / 12 * inner(plane_stress(κ, material), κ_)
    if shear:
        W += SHEAR_FACTOR * G * t * dot(γ, γ_)
    return W * ufl.dx(metadata={"quadrature_degree": QUADRATURE_DEGREE})


# ---------------------------------------------------------------------------------------------- P2 × CR


def p2_cr(V, material: Material, normals=None):
    """Bilinear form of (1) for quadratic u and Crouzeix–Raviart θ, V = [P2]³ × [CR]³; it reads no normals.

    Transverse shear energy ``½ · 5/6 G t |∇w − β|²`` and drilling energy ``½ E t³/h² (½ curl u − ω)²``, h the cell's
    diameter. Crouzeix–Raviart rotations contain the gradients of quadratics edge by edge, hence no shear locking.
    """
    T, t, E = triangle(V.mesh), material.thickness, material.young
    G = E / (2 * (1 + material.poisson))
    h = ufl.CellDiameter(V.mesh)

    def strains(function):
        v = kinematics(T, *ufl.split(function))
        return sym(v.grad_u), sym(v.grad_beta), v.grad_w - v.beta, v.rotation_of_u - v.omega

    ε, κ, γ, drill = strains(ufl.TrialFunction(V))
    ε_, κ_, γ_, drill_ = strains(ufl.TestFunction(V))
    return (
        t * inner(plane_stress(ε, material), ε_)
        + t**3 / 12 * inner(plane_stress(κ, material), κ_)
        + SHEAR_FACTOR * G * t * dot(γ, γ_)
        + DRILLING_PENALTY * E * t**3 / h**2 * drill * drill_
    ) * ufl.dx(metadata={"quadrature_degree": QUADRATURE_DEGREE})


# ---------------------------------------------------------------------------------------------- by name


@dataclass(frozen=True)
class ShellElement:
    """The properties of an element that a part uses.

    Attributes
    ----------
    form : callable
        ``form(V, material, normals)``, the bilinear form of (1).
    space : callable
        ``space(mesh)``, V: one field of six components at the same nodes, or a displacement and a rotation field.
    displacement, rotation : Interpolation
        Of u and of θ, in the order of the space's nodes.
    normals : callable, optional
        ``normals(surface)``, the (k, 3, 3) unit normals at the corners of a surface's triangles that the form reads.
    """

    form: Callable
    space: Callable
    displacement: Interpolation
    rotation: Interpolation
    normals: Callable[[Surface], np.ndarray] | None = None


def of_triangles(surface: Surface) -> np.ndarray:
    """At each corner the triangle's own normal: a sheet of flat triangles."""
    return np.repeat(surface.normals[:, None], 3, axis=1)


def of_corners(surface: Surface) -> np.ndarray:
    """The normals of the curved sheet."""
    return surface.corner_normals


ELEMENTS = {
    "dkt-opt-curved": ShellElement(dkt_opt, compat.lagrange_6, P1, P1, of_corners),
    "dkmt-opt-curved": ShellElement(partial(dkt_opt, shear=True), compat.lagrange_6, P1, P1, of_corners),
    "dkt-opt": ShellElement(dkt_opt, compat.lagrange_6, P1, P1, of_triangles),
    "p2-cr": ShellElement(p2_cr, compat.p2_crouzeix_raviart, P2, CROUZEIX_RAVIART),
}
