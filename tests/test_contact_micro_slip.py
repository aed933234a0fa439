"""Contacts that yield before they slip: Jenkins elements, an Iwan chain, partial slip of pressed contacts."""

import numpy as np
import pytest

from mic.contact import ContactSolver, certify, solve
from mic.contact.friction import Friction
from mic.contact.laws import COULOMB, MICRO_SLIP, PRESSURE_DEPENDENT
from mic.contact.path import Increments
from verification.contact_problems import slip_dominated


def dragged(compliance, bound, way):
    """(k, m) forces of m contacts on a rigid block, and (k, m) positions of their sliders, that goes ``way`` (k,) mm.

    Normal forces are 1: an overlap of 1 on a compliance of 1; μ is what makes the bound.
    """
    m = len(compliance)
    friction = Friction(np.asarray(bound), None, np.asarray(compliance, dtype=float))
    S = np.kron(np.eye(m), np.diag([1.0, 0.0, 0.0]))
    solver = ContactSolver(S, friction, MICRO_SLIP)
    loads = np.zeros((1, len(way), m, 3))
    loads[..., 0] = -1.0
    loads[..., 1] = np.asarray(way)[:, None]
    forces, anchors, work = [], [], np.zeros(m)
    force, anchor = np.tile([1.0, 0.0, 0.0], m)[None], np.zeros((1, m, 2))
    for k in range(len(way) - 1):
        end = solver.follow(loads[:, k : k + 2].reshape(1, 2, -1), force, anchor, Increments(1))
        assert end.converged.all()
        np.testing.assert_allclose(end.displacement.reshape(m, 3)[:, 1], way[k + 1], atol=1e-12)
        force, anchor, work = end.force, end.anchor, work + end.trace.work[0]
        forces.append(-force.reshape(m, 3)[:, 1])
        anchors.append(anchor[0, :, 0].copy())
    return np.array(forces), np.array(anchors), work


def test_a_jenkins_element_yields_slips_and_yields_back():
    """Spring 1/c in series with a slider of strength R: ``min(x/c, R)``; back, the spring unloads first."""
    c, R = 0.5, 0.3
    way = np.array([0.0, 0.1, 0.15, 0.4, 0.3, 0.1, -0.2])
    force, slider, work = dragged([c], [R], way)
    np.testing.assert_allclose(force[:, 0], [0.2, 0.3, 0.3, 0.1, -0.3, -0.3], atol=1e-10)
    np.testing.assert_allclose(slider[:, 0], [0.0, 0.0, 0.25, 0.25, 0.25, -0.05], atol=1e-10)
    assert work[0] == pytest.approx(R * (0.25 + 0.3), rel=1e-10)


def test_a_stuck_contact_has_moved_by_its_own_compliance():
    """``u_t = -c f_t``, the slider where it was, whatever else is compliant."""
    S, c = np.diag([1.0, 2.0, 2.0]), 0.7
    solution = solve(S, [-1.0, 0.2, -0.1], Friction(np.ones(1), None, np.array([c])), MICRO_SLIP)
    np.testing.assert_allclose(solution.force, [1.0, -0.2 / 2.7, 0.1 / 2.7], rtol=1e-10)
    np.testing.assert_allclose(solution.displacement, -c * solution.force * [0.0, 1.0, 1.0], atol=1e-12)


def test_an_iwan_chain_follows_its_backbone_and_masings_rule():
    """m elements of stiffness K/m in parallel, strengths spread evenly up to 2 F_s/m: ``F = K x - K² x²/(4 F_s)``
    until ``x = 2 F_s/K``; unloading and reloading repeat the backbone twice as large (Masing 1926, Iwan 1966)."""
    m, K, F_s = 400, 50.0, 8.0
    strength = 2.0 * F_s / m * (np.arange(m) + 0.5) / m

    def backbone(x):
        return np.where(x < 2.0 * F_s / K, K * x - (K * x) ** 2 / (4.0 * F_s), F_s)

    top = 0.8 * 2.0 * F_s / K
    up = np.linspace(0.0, top, 9)
    down = np.linspace(top, -top, 17)[1:]
    force, _, _ = dragged(np.full(m, m / K), strength, np.concatenate([up, down, -down]))
    total = force.sum(axis=1)
    scale = 1e-4 * F_s
    np.testing.assert_allclose(total[:8], backbone(up[1:]), atol=scale)
    peak = backbone(top)
    np.testing.assert_allclose(total[8:24], peak - 2.0 * backbone((top - down) / 2.0), atol=scale)
    np.testing.assert_allclose(total[24:], -peak + 2.0 * backbone((top - down) / 2.0), atol=scale)
    assert np.abs(total[24:] - backbone(np.abs(down))).max() > 0.1 * F_s  # a loop, not the way back


def test_a_pressed_disc_slips_in_an_annulus():
    """``p = p0 (1 - r²/a²)`` on springs k_t per area, shifted by ξ: it sticks within c, ``1 - c²/a² = k_t ξ/(μ p0)``,
    under ``Q = μ P (1 - c⁴/a⁴)``, ``P = π a² p0/2`` (the Winkler foundation of Johnson 1985, ch. 4.3)."""
    rings, a, p0, mu, k_t, share = 300, 4.0, 3.0, 0.25, 120.0, 0.6
    area = np.pi * a**2 / rings
    inside = (np.arange(rings) + 0.5) / rings  # r²/a² in the middle of rings of equal area
    bound = mu * p0 * (1.0 - inside) * area
    xi = share * mu * p0 / k_t
    force, slider, _ = dragged(np.full(rings, 1.0 / (k_t * area)), bound, [0.0, xi])
    c_squared = 1.0 - share
    assert force.sum() == pytest.approx(mu * 0.5 * np.pi * a**2 * p0 * (1.0 - c_squared**2), rel=1e-4)
    np.testing.assert_array_equal(np.abs(slider[0]) > 1e-12, inside > c_squared)


def half_plane(strips, a, modulus):
    """(m, m) tangential compliance of strips of a half-plane, -a … a, by Flamant's solution; the far field is fixed."""
    h = 2.0 * a / strips
    x = np.linspace(-a + 0.5 * h, a - 0.5 * h, strips)

    def primitive(d):
        return d * np.log(np.abs(d)) - d

    d = x[:, None] - x
    influence = primitive(d + 0.5 * h) - primitive(d - 0.5 * h)
    # Displacement under unit traction on a strip: -(2/(π E')) ∫ ln|x - s| ds; a rigid motion makes it positive.
    return x, h, (-2.0 / (np.pi * modulus) * influence) / h + 2.0 * np.log(10.0 * a) / (np.pi * modulus)


def on_strips(strips, c=1.0):
    """``∫ √(1 - x²/c²) dx`` over each strip of -1 … 1, nothing outside of c."""
    x = np.clip(np.linspace(-1.0, 1.0, strips + 1) / c, -1.0, 1.0)
    return c * np.diff(0.5 * (x * np.sqrt(1.0 - x**2) + np.arcsin(x)))


def sheared_cylinder(k_t, xi, strips=80):
    """A Hertzian line contact, sheared; stick half-width over a, force over μ P, tractions (m,) and μ p0."""
    a, p0, mu, modulus = 2.0, 5.0, 0.3, 1e3
    x, h, tangential = half_plane(strips, a, modulus)
    P = p0 * a * on_strips(strips)
    S = np.zeros((strips, 3, strips, 3))
    S[:, 0, :, 0] = np.eye(strips)
    S[:, 1, :, 1] = S[:, 2, :, 2] = tangential
    b = np.column_stack([-P, np.full(strips, xi), np.zeros(strips)]).ravel()
    friction = Friction(np.full(strips, mu), None, np.full(strips, 1.0 / (k_t * h)))
    solution = solve(S.reshape(3 * strips, -1), b, friction, MICRO_SLIP)
    assert solution.converged
    f = solution.force.reshape(-1, 3)
    slider = solution.displacement.reshape(-1, 3)[:, 1] + friction.compliance * f[:, 1]
    stick = np.abs(slider) < 1e-9 * xi
    return 0.5 * h * stick.sum() / a, -f[:, 1].sum() / (mu * P.sum()), -f[:, 1] / h, mu * p0


def test_stiff_contacts_tend_to_cattaneos_partial_slip():
    """``c/a = (1 - Q/μP)^½``, ``q = μ p0 [√(1 - x²/a²) - c/a √(1 - x²/c²)]`` (Cattaneo 1938, Mindlin 1949, plane)."""
    stick, load, q, bound = sheared_cylinder(1e9, 6e-3)
    assert 0.3 < load < 0.9
    c = np.sqrt(1.0 - load)
    assert stick == pytest.approx(c, abs=1.5 / 80)
    exact = bound * (on_strips(80) - c * on_strips(80, c)) / (2.0 / 80)
    np.testing.assert_allclose(q, exact, atol=0.02 * bound)


def test_soft_contacts_tend_to_independent_springs():
    """``k_t ξ = μ p(c)``: ``c/a = (1 - (k_t ξ/(μ p0))²)^½``; in between both bodies and contacts yield."""
    bound, share = 0.3 * 5.0, 0.7
    stick, _, q, _ = sheared_cylinder(1e-2, share * bound / 1e-2)
    assert stick == pytest.approx(np.sqrt(1.0 - share**2), abs=1.5 / 80)
    assert q.max() == pytest.approx(share * bound, rel=1e-3)
    loads = [sheared_cylinder(k_t, 6e-3)[1] for k_t in (1e1, 1e2, 1e3, 1e9)]
    assert (np.diff(loads) > 0.0).all(), loads  # the softer the contacts, the less they take up


def test_the_certificate_uses_the_slider_displacement():
    """A force that obeys Coulomb's law with u instead of the slider's displacement is refused, and the other way."""
    problem = slip_dominated(20, 10, np.random.default_rng(3), mu=2.0)  # a contact that slides has Coulomb's force
    friction = Friction(problem.mu, None, np.full(20, 0.3))
    yielding = solve(problem.S, problem.b, friction, MICRO_SLIP)
    rigid = solve(problem.S, problem.b, friction, COULOMB)
    assert (
        yielding.converged.all()
        and certify(problem.S, problem.b, friction, yielding.force, MICRO_SLIP).residual.max() <= 1e-10
    )
    assert np.median(certify(problem.S, problem.b, friction, rigid.force, MICRO_SLIP).residual) > 1e-3
    assert np.median(certify(problem.S, problem.b, friction, yielding.force, COULOMB).residual) > 1e-3
    # The slider's law, written out.
    f, u = yielding.force.reshape(10, 20, 3), yielding.displacement.reshape(10, 20, 3)
    np.testing.assert_allclose(u.reshape(10, -1), yielding.force @ problem.S + problem.b, atol=1e-12)
    w = u[..., 1:] + 0.3 * f[..., 1:]
    work = np.sum(f[..., 1:] * w, axis=-1) + problem.mu * f[..., 0] * np.linalg.norm(w, axis=-1)
    assert np.abs(work).max() <= 1e-9 and yielding.slip_error.max() <= 1e-9
    assert np.abs(np.sum(f[..., 1:] * u[..., 1:], axis=-1)).max() > 1e-3


def test_rigid_contacts_obey_coulombs_law():
    problem = slip_dominated(20, 10, np.random.default_rng(4))
    expected = solve(problem.S, problem.b, problem.mu).force
    for law in (MICRO_SLIP, PRESSURE_DEPENDENT):
        np.testing.assert_array_equal(solve(problem.S, problem.b, problem.mu, law).force, expected)
    nearly = solve(problem.S, problem.b, Friction(problem.mu, None, np.full(20, 1e-12)), MICRO_SLIP).force
    np.testing.assert_allclose(nearly, expected, atol=1e-8)
