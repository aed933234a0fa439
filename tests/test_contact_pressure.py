"""Friction that depends on pressure: pieces, closed forms, the certificate, and each method of solution."""

import numpy as np
import pytest
from scipy.optimize import brentq

from mic.contact import certify, ladder, solve
from mic.contact.friction import Friction
from mic.contact.laws import COULOMB, PRESSURE_DEPENDENT
from mic.contact.laws.pressure_dependent import power, rescaled, table
from verification.contact_problems import slip_dominated

POINTS = [(0.5, 0.5), (1.0, 0.4), (2.0, 0.3), (5.0, 0.25)]
FUNCTIONS = {
    "table": (table(POINTS), lambda p: np.interp(p, *np.array(POINTS).T)),
    "rising table": (table([(0.0, 0.1), (3.0, 0.6)]), lambda p: np.interp(p, [0.0, 3.0], [0.1, 0.6])),
    "power": (power(0.3, 1.0, 0.5, 0.1, 0.8), lambda p: np.clip(0.3 * p**-0.5, 0.1, 0.8)),
    "rising power": (power(0.3, 1.0, -0.5, 0.1, 0.8), lambda p: np.clip(0.3 * p**0.5, 0.1, 0.8)),
    "constant bound": (power(0.3, 1.0, 1.0, 0.0, 5.0), lambda p: np.clip(0.3 / p, 0.0, 5.0)),
}
CASES = pytest.mark.parametrize("pieces, mu", FUNCTIONS.values(), ids=FUNCTIONS)


def friction(pieces, m, area=1.0):
    """m contacts of one area under one function of pressure; the coefficient of other laws is another."""
    own = np.broadcast_to(rescaled(pieces, 1.0 / area), (m, *pieces.shape))
    return Friction(np.full(m, 0.9), own.copy())


@CASES
def test_pieces_reproduce_their_friction_function(pieces, mu):
    p = np.concatenate([np.geomspace(1e-3, 100.0, 200), [x for x, _ in POINTS]])
    area = 2.5
    parameters = PRESSURE_DEPENDENT.parameters(friction(pieces, len(p), area))
    found = PRESSURE_DEPENDENT.coefficient(parameters, p * area)
    np.testing.assert_allclose(found, mu(p), rtol=1e-12)
    np.testing.assert_allclose(PRESSURE_DEPENDENT.bound(p * area, parameters), mu(p) * p * area, rtol=1e-12)


@CASES
def test_a_sliding_contact_has_the_friction_of_its_pressure(pieces, mu):
    """S = I: the normal force is the overlap, the friction force ``μ(f_n/A) f_n``."""
    area = 0.7
    for overlap in (0.01, 0.4, 1.3, 3.0, 30.0):
        solution = solve(np.eye(3), [-overlap, 100.0, 0.0], friction(pieces, 1, area), PRESSURE_DEPENDENT)
        held = mu(overlap / area) * overlap
        np.testing.assert_allclose(solution.force, [overlap, -held, 0.0], rtol=1e-10)


@CASES
def test_coupling_of_normal_and_tangential_compliance_is_solved_exactly(pieces, mu):
    """``w_n = 0``, ``f_t = -g(f_n) e`` with ``S_nt ≠ 0``: one equation for f_n."""
    S = np.array([[1.0, 0.3, 0.0], [0.3, 1.4, 0.0], [0.0, 0.0, 1.2]])
    for overlap in (0.1, 1.0, 4.0):
        b = np.array([-overlap, 50.0, 0.0])
        f_n = brentq(lambda f, overlap=overlap: S[0, 0] * f - S[0, 1] * mu(f) * f - overlap, 1e-9, 1e2, xtol=1e-14)
        solution = solve(S, b, friction(pieces, 1), PRESSURE_DEPENDENT)
        np.testing.assert_allclose(solution.force, [f_n, -mu(f_n) * f_n, 0.0], rtol=1e-9)


@CASES
def test_solutions_obey_coulombs_law_with_the_coefficients_of_their_pressure(pieces, mu):
    rng = np.random.default_rng(5)
    problem = slip_dominated(30, 20, rng)
    law = friction(pieces, 30, 0.2)
    solution = solve(problem.S, problem.b, law, PRESSURE_DEPENDENT)
    assert solution.converged.all() and solution.residual.max() <= 1e-10
    others = []
    for b, force in zip(problem.b, solution.force):
        own = mu(np.maximum(force[::3], 1e-300) / 0.2)
        assert certify(problem.S, b, own, force, COULOMB).residual <= 1e-10
        others.append(certify(problem.S, b, 1.05 * own, force, COULOMB).residual)
    assert np.median(others) > 1e-4  # a sample in which all contacts stick obeys others, too


@CASES
def test_all_samples_converge_on_batch_rungs(pieces, mu):
    problem = slip_dominated(60, 60, np.random.default_rng(7))
    solution = solve(problem.S, problem.b, friction(pieces, 60, 0.2), PRESSURE_DEPENDENT)
    assert solution.converged.all()
    assert ladder.PROXIMAL.name not in solution.rung


@pytest.mark.parametrize(
    "build, words",
    [
        (lambda: table([(0.0, 0.5), (1.0, 0.1)]), "must not fall with pressure, and does between 0 and 1 MPa"),
        (lambda: table([(1.0, 0.5), (1.0, 0.1)]), "pressures must rise"),
        (lambda: table([(0.0, -0.1)]), "must not be negative"),
        (lambda: table([]), "at least one point"),
        (lambda: power(0.3, 1.0, 1.2, 0.1, 0.5), "must not fall with pressure, and does with n = 1.2"),
        (lambda: power(0.3, 1.0, 0.0, 0.1, 0.5), "friction does not depend on pressure"),
        (lambda: power(0.3, 1.0, 0.5, 0.6, 0.5), "mu_min <= mu_max"),
        (lambda: solve(np.eye(3), -np.ones(3), Friction(np.ones(1), np.ones((2, 1, 5)))), "pressure must have"),
        (lambda: solve(np.eye(3), -np.ones(3), Friction(np.ones(1), None, -np.ones(1))), "compliance must not be neg"),
    ],
)
def test_invalid_friction_functions_are_refused(build, words):
    with pytest.raises(ValueError, match=words):
        build()


def test_friction_may_fall_until_its_bound_is_constant():
    """``(μ p)' = μ + p dμ/dp`` vanishes at the second point for ``μ₂ = μ₁ p₂/(2 p₂ - p₁)``."""
    p1, p2, mu1 = 1.0, 3.0, 0.5
    level = mu1 * p2 / (2.0 * p2 - p1)
    table([(p1, mu1), (p2, level)])
    with pytest.raises(ValueError, match="must not fall"):
        table([(p1, mu1), (p2, level - 1e-6)])
