"""Several solutions of Coulomb's law are found where there are, and none where there is one."""

import numpy as np
import pytest

from mic.contact import ContactSolver
from mic.contact.second_start import coupling, has_other_solution


def solutions(w, mu, b):
    """Normal forces of all solutions of one contact in a plane with compliance [[1, w], [w, 1]]."""
    found = [0.0] if b[0] >= 0 else []
    stuck = np.linalg.solve([[1, w], [w, 1]], -b[:2])
    if stuck[0] >= 0 and abs(stuck[1]) <= mu * stuck[0]:
        found.append(stuck[0])
    for way in (1, -1):
        f = -b[0] / (1 - way * mu * w)
        if f >= 0 and way * (w * f - way * mu * f + b[1]) >= 0:
            found.append(f)
    return np.unique(np.round(found, 9))


@pytest.mark.parametrize("w, mu, expected", [(0.5, 0.27, 0), (0.9, 1.5, 35), (0.95, 3.0, 47), (0.99, 0.9, 0)])
def test_several_solutions_of_one_contact_are_all_found(w, mu, expected):
    rng = np.random.default_rng(1)
    for case in ((0.5, 0.27), (0.9, 1.5), (0.95, 3.0), (0.99, 0.9)):
        b = rng.normal(size=(400, 3))
        if case == (w, mu):
            break
    b[:, 2] = 0.0
    solver = ContactSolver(np.array([[1, w, 0], [w, 1, 0], [0, 0, 1.0]]), mu)
    true = np.array([len(solutions(w, mu, one)) > 1 for one in b])
    assert true.sum() == expected
    np.testing.assert_array_equal(has_other_solution(solver, b), true)


def test_the_coupling_of_a_contact_is_that_of_its_own_rows():
    S = np.diag([2.0, 1, 1, 4, 1, 1])
    S[0, 1] = S[1, 0] = 0.6
    S[0, 2] = S[2, 0] = 0.8
    np.testing.assert_allclose(coupling(ContactSolver(S, 0.5)), [0.25, 0.0])
