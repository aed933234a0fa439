"""Every problem ends with a force that obeys the law, or with a status that gives the reason."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mic.contact import ContactSolver, Status, certify, solve
from mic.contact.friction import Friction
from mic.contact.laws import LAWS

FREE = [name for name, law in LAWS.items() if not law.reads]  # laws that know no units
BOUND = [name for name, law in LAWS.items() if law.reads]


def problem(m=4, seed=3):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((3 * m, 3 * m + 4))
    b = rng.standard_normal(3 * m)
    b[::3] -= 1.0
    return root @ root.T / (3 * m), b


def broken_condition(S, b, mu, force, law):
    """Largest breach of a condition of the law, of the largest force, displacement or their product; in long double,
    which holds the squares of all doubles, and with none of the program's own measures."""
    S, b, f = (np.asarray(a, dtype=np.longdouble) for a in (S, b, force))
    u = (S @ f + b).reshape(-1, 3)
    f = f.reshape(-1, 3)
    F, U = np.abs(f).max() or np.longdouble(1), max(np.abs(u).max(), np.abs(b).max()) or np.longdouble(1)
    mu = mu if LAWS[law].frictional else 0.0
    slip, traction = np.hypot(u[:, 1], u[:, 2]), np.hypot(f[:, 1], f[:, 2])
    # Complementary to the normal force: under the associated law slipping contacts open by μ times their slip.
    gap = u[:, 0] - (mu * slip if law == "associated" else 0.0)
    breaches = [
        -f[:, 0] / F,
        -gap / ((1 + mu) * U),
        np.abs(f[:, 0] * gap) / (F * (1 + mu) * U),
        (traction - mu * f[:, 0]) / ((1 + mu) * F),  # the distance to the cone
        (mu * f[:, 0] * slip + (f[:, 1:] * u[:, 1:]).sum(-1)) / (F * (1 + mu) * U),
    ]
    return float(max(np.max(each) for each in breaches))


@pytest.mark.parametrize("law", FREE)
@pytest.mark.parametrize("compliance, length", [(1, 1e-200), (1, 1e200), (1e-200, 1), (1e200, 1e150), (1e-90, 1e-90)])
def test_very_large_and_very_small_numbers_are_solved(law, compliance, length):
    S, b = problem()
    near, far = solve(S, b, 0.3, law), solve(S * compliance, b * length, 0.3, law)
    assert far.status is Status.CONVERGED and far.residual <= 1e-10
    np.testing.assert_allclose(far.force * (compliance / length), near.force, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(far.displacement / length, near.displacement, rtol=1e-8, atol=1e-8)
    assert broken_condition(S * compliance, b * length, 0.3, far.force, law) < 1e-8
    # The certificate knows a wrong force there, too.
    wrong = certify(S * compliance, b * length, 0.3, 0.9 * far.force, law).residual
    assert wrong == pytest.approx(certify(S, b, 0.3, 0.9 * near.force, law).residual, rel=1e-6) and wrong > 1e-3


@pytest.mark.parametrize("law", FREE)
@pytest.mark.parametrize("compliance, length", [(1e-200, 1e200), (1e200, 1e-200), (1, 1e-320)])
def test_a_force_outside_the_range_of_numbers_is_refused(law, compliance, length):
    S, b = problem()
    solution = solve(S * compliance, b * length, 0.3, law)
    assert solution.status is Status.OUT_OF_RANGE and not solution.converged and not solution.force.any()
    assert "units" in solution.status.advice


@pytest.mark.parametrize("law", BOUND)
def test_a_law_with_units_refuses_values_out_of_range(law):
    S, b = problem()
    constant = np.tile([0.0, 0.3, 0.0, 0.0, 0.0], (4, 1, 1))
    friction = Friction(np.full(4, 0.3), constant, np.full(4, 0.1))
    solution = ContactSolver(S, friction, law).solve(np.stack([b, 1e-200 * b, 1e200 * b]))
    assert [status is Status.OUT_OF_RANGE for status in solution.status] == [False, True, True]
    assert solution.converged.tolist() == [True, False, False] and np.isinf(solution.residual[1:]).all()
    alone = ContactSolver(S, friction, law).solve(b)
    assert np.array_equal(alone.force, solution.force[0])


@pytest.mark.parametrize("law", FREE)
def test_extreme_samples_do_not_change_others_in_their_batch(law):
    S, b = problem()
    batch = ContactSolver(S, 0.3, law).solve(np.stack([1e-200 * b, b]))
    assert batch.converged.all()
    assert np.array_equal(batch.force[1], ContactSolver(S, 0.3, law).solve(b).force)


@pytest.mark.parametrize("law", LAWS)
def test_overlap_without_compliance_is_infeasible(law):
    S, b = np.zeros((6, 6)), np.array([0.1, 0.3, 0.0, 1.0, 0.0, 0.2])
    assert solve(S, b, 0.3, law).status is Status.CONVERGED
    b[0] = 0.0  # touching, it slides without force; under the associated law it would have to open, and cannot
    sliding = solve(S, b, 0.3, law)
    assert sliding.status is (Status.INFEASIBLE if law == "associated" else Status.CONVERGED)
    b[0] = -1e-3
    overlapping = solve(S, b, 0.3, law)
    assert overlapping.status is Status.INFEASIBLE and not overlapping.force.any()


@pytest.mark.parametrize("share, refused", [(1e-6, True), (1e-12, False)])
def test_an_indefinite_compliance_is_refused(share, refused):
    S, b = problem()
    values, vectors = np.linalg.eigh(S)
    values[0] = -share * values[-1]
    S = (vectors * values) @ vectors.T
    if refused:
        with pytest.raises(ValueError, match="positive semidefinite; it has an eigenvalue below"):
            solve(S, b, 0.3)
    else:
        assert solve(S, b, 0.3).converged


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    m=st.integers(1, 4),
    rank=st.integers(0, 12),
    mu=st.sampled_from([0.0, 1e-9, 0.3, 2.0, 1e3, 1e8]),
    law=st.sampled_from(FREE),
    compliance=st.floats(-220, 220),
    length=st.floats(-220, 220),
    stiff=st.floats(0, 3),
    still=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@pytest.mark.slow
def test_wrong_solutions_are_never_reported_as_converged(m, rank, mu, law, compliance, length, stiff, still, seed):
    """Any rank, any friction, any size; contacts without compliance; most loads are not made to be balanced."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((3 * m, rank)) * 10.0 ** (stiff * rng.uniform(-1, 1, m)).repeat(3)[:, None]
    if still:
        root[:3] = 0.0
    S = (root @ root.T) * 10.0**compliance
    b = rng.standard_normal(3 * m) * 10.0**length
    if seed % 3 == 0 and abs(length - compliance) < 300:  # one that some force balances
        b = np.abs(b) * np.tile([1.0, 0.0, 0.0], m) - S @ (rng.standard_normal(3 * m) * 10.0 ** (length - compliance))
    solution = solve(S, b, mu, law)
    assert isinstance(solution.status, Status) and solution.converged == (solution.status is Status.CONVERGED)
    if solution.converged:
        assert np.isfinite(solution.force).all() and broken_condition(S, b, mu, solution.force, law) < 1e-6


def test_a_useless_guess_does_not_prevent_a_solution(monkeypatch):
    S, b = problem()
    solver = ContactSolver(S, 0.3)
    right, find = solver.solve(b), solver.backend.solve
    useless = np.stack([right.force, right.force])

    def misled(rows, guess):
        force, *others = find(rows, None)
        return (0.0 * force if np.array_equal(guess, useless) else force), *others

    monkeypatch.setattr(solver.backend, "solve", misled)
    monkeypatch.setattr(solver.backend, "attempts", lambda b, force: iter(()))
    found = solver.solve(np.stack([b, b]), useless)
    assert found.converged.all() and np.array_equal(found.force, [right.force, right.force])
    assert (found.factorisations == 2 * right.factorisations).all()  # in vain, too
