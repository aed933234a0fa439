"""The native solver against general-purpose optimisers, which share no code with it; and the comparison of laws."""

import numpy as np
import pytest

from mic.contact import Status, solve
from mic.contact.law_comparison import compare_laws, summarise
from verification.contact_problems import slip_dominated


@pytest.fixture(scope="module")
def problem():
    return slip_dominated(12, 3, np.random.default_rng(21), condition=1e3)


PEERS = {"ecos": "associated", "clarabel": "associated", "scs": "associated", "osqp": "frictionless"}


@pytest.mark.parametrize("backend, law", PEERS.items())
@pytest.mark.parametrize("mu", [0.0, 0.27, 2.0])
def test_native_equals_an_optimiser(problem, law, backend, mu):
    pytest.importorskip("cvxpy")
    pytest.importorskip(backend)
    native = solve(problem.S, problem.b, mu, law)
    peer = solve(problem.S, problem.b, mu, law, backend=backend, tol=1e-5)
    assert native.converged.all() and peer.converged.all(), peer.residual
    size = np.abs(native.force).max()
    np.testing.assert_allclose(peer.force, native.force, atol=1e-4 * size)
    # The energy is second-order accurate: a sharper comparison than the forces.
    energy = [
        0.5 * np.sum(f @ problem.S * f, axis=1) + np.sum(problem.b * f, axis=1) for f in (native.force, peer.force)
    ]
    np.testing.assert_allclose(energy[1], energy[0], rtol=1e-7)


def test_backends_report_their_true_residual(problem):
    pytest.importorskip("ecos")
    solution = solve(problem.S, problem.b, 0.27, "associated", backend="ecos", tol=1e-15)
    assert set(solution.rung) == {"ecos"}  # a backend is its own rung
    assert (solution.residual > 1e-15).all() and not solution.converged.any()
    assert all(status is Status.NOT_CONVERGED for status in solution.status)


def test_a_backend_solves_normal_rows_alone(problem):
    pytest.importorskip("osqp")
    normal = solve(problem.S[::3, ::3], problem.b[:, ::3], 0.0, "frictionless", backend="osqp", tol=1e-6, dimension=1)
    native = solve(problem.S, problem.b, 0.0, "frictionless")
    np.testing.assert_allclose(normal.force, native.force[:, ::3], atol=1e-5 * np.abs(native.force).max())


def test_the_comparison_of_laws_agrees_with_one_sliding_contact_by_hand():
    """S = I, b = (-1, 1, 0): the associated gap is ``μ (1 - μ)/(1 + μ²)``."""
    mu = 0.27
    study = compare_laws(np.eye(3), [-1.0, 1.0, 0.0], [mu]).set_index("law")
    assert study.loc["associated", "gap_at_load"] == pytest.approx(mu * (1.0 - mu) / (1.0 + mu**2), rel=1e-9)
    assert study.loc["coulomb", "gap_at_load"] <= 1e-12
    assert study.loc["coulomb", "slip"] == pytest.approx(1.0 - mu, rel=1e-9)
    assert study.loc["frictionless", "slip"] == pytest.approx(1.0, rel=1e-9)
    assert study.loc["frictionless", "force_change"] == pytest.approx(mu / np.hypot(1.0, mu), rel=1e-9)
    assert (study["contacts_slip"] == 1).all() and study["converged"].all()


def test_laws_agree_without_friction_and_differ_with_it():
    rng = np.random.default_rng(22)
    problem = slip_dominated(10, 5, rng, condition=1e3)
    study = summarise(compare_laws(problem.S, problem.b, [0.0, 0.3]))
    assert len(study) == 6 and not study["left_out"].any()
    assert study.loc[(0.0, "associated"), "force_change"] <= 1e-8
    assert study.loc[(0.3, "associated"), "force_change"] > 1e-2
    assert study.loc[(0.3, "associated"), "gap_at_load"] > 1e3 * study.loc[(0.3, "coulomb"), "gap_at_load"]
