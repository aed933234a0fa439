"""One increment of many contacts against all candidates at once, and the closed contacts without friction."""

import numpy as np
import pytest

from mic.contact import ContactSolver, laws
from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.large_increment import forces_without_friction
from mic.contact.path import Increments
from mic.contact.working_set import PENETRATION, WorkingSetSolver
from verification.contact_problems import compliant

REACH = 15.0  # radius of neighbourhoods
M, N = 60, 8
FRICTION = Friction.of(Friction(0.3, compliance=1e-2), M)


@pytest.fixture
def problem(monkeypatch):
    """Compliance, and two increments of samples in each of which a few contacts close and others open."""
    monkeypatch.setattr("mic.contact.working_set.MAX_INITIAL", 10)  # more initial contacts are many
    rng = np.random.default_rng(5)
    b = rng.uniform(0.1, 0.6, (N, 3, 3 * M)) * np.tile([1.0, 0.3, 0.3], M)
    b[:, 1:, ::3] -= rng.uniform(0.4, 1.2, (N, 2, 1)) * (rng.random((N, 2, M)) < 0.4)
    return compliant(M, rng, 1e4) + 1.0 * np.eye(3 * M), b


def watched(S, law, start):
    point = np.random.default_rng(0).random((M, 3)) * 100
    everywhere = np.ones(M, dtype=bool)
    given = Columns.of(S), FRICTION, point, np.full(M, REACH), start, everywhere, laws.find(law)
    return WorkingSetSolver(*given, tol=1e-10, certify_each=False)


def twice(solver, b):
    """The solutions of two increments, the second from the end of the first."""
    first = solver.follow(b[:, :2], np.zeros((len(b), 3 * M)), b[:, 0].reshape(-1, M, 3)[:, :, 1:], Increments(1))
    return first, solver.follow(b[:, 1:], first.force, first.anchor, Increments(1))


@pytest.mark.parametrize("law", ["coulomb", "micro-slip", "associated"])
def test_many_contacts_give_the_result_and_trace_of_all_candidates(problem, law):
    S, b = problem
    everything = ContactSolver(S, FRICTION, law, certify_each=False)
    for few, all_ in zip(twice(watched(S, law, np.arange(M) % 3 > 0), b), twice(everything, b)):
        assert few.converged.all() and all_.converged.all()
        assert ((all_.force[:, ::3] > 0).sum(axis=1) > 4).all() and few.residual.max() <= 1e-10
        assert few.displacement[:, ::3].min() >= -2 * PENETRATION * REACH
        for name in ("displacement", "anchor"):
            np.testing.assert_allclose(getattr(few, name), getattr(all_, name), atol=2e-5, err_msg=name)
        closed = (few.force[:, ::3] > 0) & (all_.force[:, ::3] > 0)
        for name in ("slip", "length", "work"):
            own, other = (getattr(one.trace, name)[closed] for one in (few, all_))
            np.testing.assert_allclose(own, other, atol=2e-5 * max(1.0, np.abs(other).max()), err_msg=name)


def test_many_contacts_of_a_sample_do_not_depend_on_its_batch(problem):
    S, b = problem
    start = np.arange(M) % 2 == 0
    together = twice(watched(S, "coulomb", start), b)[1]
    alone = twice(watched(S, "coulomb", start), b[[5]])[1]
    assert (alone.force[0] == together.force[5]).all() and (alone.trace.work[0] == together.trace.work[5]).all()


def test_forces_without_friction_are_complementary_to_gaps():
    rng = np.random.default_rng(1)
    for m in (1, 7, 40):
        root = rng.standard_normal((m, m))
        S = root @ root.T / m + 0.1 * np.eye(m)
        b = rng.standard_normal(m)
        force = forces_without_friction(S, b, rng.uniform(0, 1, m))
        gap = S @ force + b
        assert (
            force.min() >= 0 and gap.min() > -1e-9 and np.abs(force * gap).max() < 1e-9 and force.any() == (b < 0).any()
        )
