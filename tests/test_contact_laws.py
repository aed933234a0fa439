"""One and two contacts solved by hand, the cone's projection, and the certificate's refusal of wrong answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mic.contact import ContactSolver, Status, certify, solve
from mic.contact.laws import COULOMB, LAWS

FINITE = st.floats(-1e3, 1e3).map(lambda x: round(x, 6))


@given(st.tuples(FINITE, FINITE, FINITE), st.sampled_from([0.0, 1e-12, 0.27, 1.0, 5.0, 1e3]))
def test_the_projection_satisfies_moreau(x, mu):
    """``x = P_K(x) + (x - P_K(x))`` with the second in the polar cone and orthogonal to the first."""
    x = np.array([x])
    p = COULOMB.projection(x, np.array([mu]))
    polar = p - x
    size = max(np.linalg.norm(x), 1e-300)
    assert np.hypot(*p[0, 1:]) <= mu * p[0, 0] + 1e-12 * size
    assert polar[0, 0] >= mu * np.hypot(*polar[0, 1:]) - 1e-12 * size * max(1.0, mu)
    assert abs(np.sum(p * polar)) <= 1e-12 * size**2


@pytest.mark.parametrize(
    "b, force",
    [
        ([-1.0, 0.1, -0.1], [1.0, -0.1, 0.1]),  # sticks
        ([1.0, 5.0, 0.0], [0.0, 0.0, 0.0]),  # open
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),  # touches
        ([-2.0, 3.0, 4.0], [2.0, -0.6 * 0.6, -0.6 * 0.8]),  # slides against (3, 4)
    ],
)
def test_one_contact_in_each_state(b, force):
    solution = solve(np.eye(3), b, 0.3)
    np.testing.assert_allclose(solution.force, force, atol=1e-13)
    assert solution.status is Status.CONVERGED and solution.residual <= 1e-13


def test_coupling_of_normal_and_tangential_displacement():
    """Sticking with S_nt ≠ 0 solves the full 3 × 3 system."""
    S = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 1.5]])
    b = np.array([-1.0, 0.1, 0.0])
    np.testing.assert_allclose(solve(S, b, 10.0).force, -np.linalg.solve(S, b), rtol=1e-12)


def test_two_contacts_share_a_load():
    """A rigid punch on two springs: each carries what its own spring makes of the common approach."""
    S = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    solution = solve(S, [-1.0, 0.0, 0.0, -1.0, 2.0, 0.0], 0.25)
    np.testing.assert_allclose(solution.force, [1.0, 0.0, 0.0, 2.0, -0.5, 0.0], atol=1e-12)


def test_frictionless_uses_the_normal_block_and_returns_all_displacements():
    S = np.array([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0]])
    solution = solve(S, [-1.0, 0.0, 0.5], 0.9, law="frictionless")
    np.testing.assert_allclose(solution.force, [1.0, 0.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(solution.displacement, [0.0, 0.3, 0.5], atol=1e-14)


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param([0.0, 0.0, 0.0], id="zero"),
        pytest.param([-1.0, 0.27, 0.0], id="wrong sign"),
        pytest.param([1.0, 0.27, 0.0], id="friction pushes the slip"),
        pytest.param([1.0, -1.0, 0.0], id="mu ignored: stuck"),
        pytest.param([1.0, 0.0, 0.0], id="mu ignored: frictionless"),
        pytest.param([1.27 / 1.0729, -0.27 * 1.27 / 1.0729, 0.0], id="the associated answer"),
        pytest.param([1e12, 0.0, 0.0], id="huge"),
        pytest.param([np.nan, 0.0, 0.0], id="not a number"),
    ],
)
def test_certificate_refuses_wrong_answers(wrong):
    assert not certify(np.eye(3), [-1.0, 1.0, 0.0], 0.27, wrong).residual < 0.1


def test_the_residual_of_no_force_is_one_where_bodies_overlap():
    rng = np.random.default_rng(0)
    for scale in (1e-12, 1.0, 1e3):
        b = np.array([-scale, 0.2 * scale, 0.0, 1e3, 0.0, 0.0])
        for law in LAWS:
            assert certify(np.eye(6), b, 0.3, np.zeros(6), law).residual == pytest.approx(1.0, rel=1e-12)
    open_scene = np.abs(rng.standard_normal((5, 6)))
    np.testing.assert_array_equal(certify(np.eye(6), open_scene, 0.3, np.zeros((5, 6))).residual, 0.0)


def test_the_certificate_measures_each_violation():
    mu, force = 0.5, np.array([2.0, 1.5, 0.0])
    certificate = certify(np.eye(3), [-3.0, 0.5, 0.0], mu, force)  # u = (-1, 2, 0)
    assert certificate.penetration == pytest.approx(1.0)
    assert certificate.cone_violation == pytest.approx(0.5)
    assert certificate.complementarity == pytest.approx(2.0)
    assert certificate.slip_error == pytest.approx(mu * 2.0 * 2.0 + 1.5 * 2.0)


@pytest.mark.parametrize(
    "name, arguments",
    [
        ("S", dict(S=np.ones((3, 4)))),
        ("S", dict(S=np.diag([1.0, np.nan, 1.0]))),
        ("S", dict(S=np.diag([1.0, -1.0, 1.0]))),
        ("S", dict(S=np.eye(3) + np.triu(np.ones((3, 3)), 1))),
        ("S", dict(S="compliance")),
        ("b", dict(b=np.zeros(4))),
        ("b", dict(b=[0.0, np.nan, 0.0])),
        ("mu", dict(mu=-0.1)),
        ("mu", dict(mu=[0.1, 0.2])),
        ("law", dict(law="Tresca")),
        ("backend", dict(backend="simplex")),
        ("tol", dict(tol=0.0)),
        ("guess", dict(guess=np.zeros((1, 3)))),
        ("threads", dict(threads=0)),
        ("dimension", dict(dimension=2)),
        ("law", dict(dimension=1, S=np.eye(1), b=[0.0])),
        ("law", dict(backend="osqp")),
    ],
)
def test_invalid_arguments_are_named(name, arguments):
    valid = dict(S=np.eye(3), b=np.zeros(3), mu=0.3)
    with pytest.raises(ValueError, match=rf"\b{name}\b"):
        solve(**{**valid, **arguments})


def test_slight_asymmetry_is_symmetrised_with_a_warning():
    S = np.eye(3)
    S[0, 1] = 1e-3
    with pytest.warns(UserWarning, match="symmetrised"):
        solution = solve(S, [-1.0, 0.0, 0.0], 0.3)
    symmetric = solve(0.5 * (S + S.T), [-1.0, 0.0, 0.0], 0.3)
    np.testing.assert_array_equal(solution.force, symmetric.force)


def test_results_have_the_shape_of_b():
    one = solve(np.eye(6), np.full(6, -1.0), 0.3)
    assert one.force.shape == one.displacement.shape == (6,)
    assert isinstance(one.residual, float) and one.converged is True and one.status is Status.CONVERGED
    many = solve(np.eye(6), np.full((4, 6), -1.0), 0.3)
    assert many.force.shape == (4, 6) and many.residual.shape == many.iterations.shape == many.status.shape == (4,)
    none = ContactSolver(np.eye(6), 0.3).solve(np.zeros((0, 6)))
    assert none.force.shape == (0, 6)


@pytest.mark.parametrize("law", LAWS)
def test_a_problem_without_contacts_converges(law):
    solution = solve(np.zeros((0, 0)), np.zeros((2, 0)), 0.3, law=law)
    assert solution.converged.all() and solution.residual.tolist() == [0.0, 0.0]


def test_every_status_advises_a_remedy():
    for status in Status:
        assert status.advice.endswith(".") and len(status.advice) > 40
