"""Random contact problems of any scale under every law, judged in extended precision; the judge on planted errors."""

import warnings

import numpy as np
import pytest
from support.attack_contacts import attack, draw, outcome
from support.contact_judge import OWN, WHOLE, Problem, judge, judge_increments

from mic.contact import ContactSolver, Friction, Status, certify, solve
from mic.contact.contact_residual import RESOLVED
from mic.contact.laws import LAWS
from mic.contact.laws.pressure_dependent import rescaled, table
from mic.contact.path import Followed, Increments
from mic.contact.refinement import refined

#: Numbers of large problems of all laws that take less than a second each.
LARGE = [1003, 1008, 1013, 1026, 1029, 1037]


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 200])
def test_small_random_problems_are_solved_right_or_reported(first):
    found = [outcome(draw(number)) for number in range(first, first + 200)]
    assert not [line for one in found for line in one.failures]
    assert all(sum(one.solved for one in found if one.about.startswith(law)) > 15 for law in LAWS)
    assert sum(one.solved for one in found) > 0.75 * sum(one.samples for one in found)
    assert sum(one.named > 0 for one in found) < 0.06 * len(found)  # most at the ends of paths, which are not refined
    assert 0 < sum(bool(one.refused) for one in found) < 0.15 * len(found)


@pytest.mark.slow
def test_large_random_problems_are_solved_right_or_reported():
    found = [outcome(draw(number, large=True), work=10) for number in LARGE]
    assert not [line for one in found for line in one.failures]
    assert {law for law in LAWS for one in found if one.about.startswith(law) and one.solved} == set(LAWS)


@pytest.mark.slow
def test_an_attack_solves_its_problems(tmp_path):
    """On three small problems, and a large one."""
    assert attack(np.random.default_rng(0), tmp_path, problems=3) == []


MU, SPRING, POINTS = 0.3, 0.5, [(0.5, 0.5), (1.0, 0.4), (2.0, 0.3)]
#: One contact of unit compliance: gap and motion without force under which it slips, sticks, or is open.
LOADS = {"slip": (-1.0, 1.0, 0.0), "stick": (-1.0, 0.1, 0.0), "open": (1.0, 0.2, 0.0)}
#: Wrong forces, from the right one (3,), and the state in which they are wrong.
PLANTED = {
    "penetrates": ("slip", lambda f: 0.99 * f),
    "does not touch": ("slip", lambda f: 1.01 * f),
    "carries nothing though pressed": ("slip", lambda f: 0.0 * f),
    "pulls": ("open", lambda f: np.array([-0.5, 0.0, 0.0])),
    "carries force across a gap": ("open", lambda f: np.array([0.5, 0.0, 0.0])),
    "exceeds its bound": ("slip", lambda f: f * [1.0, 1.2, 1.0]),
    "slips too easily": ("slip", lambda f: f * [1.0, 0.8, 1.0]),
    "drives its slip": ("slip", lambda f: f * [1.0, -1.0, 1.0]),
    "slips askew": ("slip", lambda f: np.array([f[0], f[1] * np.cos(1e-3), f[1] * np.sin(1e-3)])),
    "moves though stuck": ("stick", lambda f: f * [1.0, 0.9, 1.0]),
    "has friction": ("slip", lambda f: f + [0.0, -0.01, 0.0]),
}
FRICTIONAL = [law for law in LAWS if LAWS[law].frictional]
NORMAL = ["penetrates", "does not touch", "carries nothing though pressed", "pulls", "carries force across a gap"]
WRONG = [(law, what) for law in FRICTIONAL for what in PLANTED]
WRONG += [("frictionless", what) for what in [*NORMAL, "has friction"]]


def right(law, state):
    """The force of one contact of unit compliance, by hand."""
    _, t, _ = LOADS[state]
    if state == "open":
        return np.zeros(3)
    if law == "frictionless":
        return np.array([1.0, 0.0, 0.0])
    if state == "stick":
        return np.array([1.0, -t / (1.0 + SPRING if law == "micro-slip" else 1.0), 0.0])
    mu = 0.4 if law == "pressure-dependent" else MU
    normal = (1.0 + MU) / (1.0 + MU**2) if law == "associated" else 1.0
    return np.array([normal, -mu * normal, 0.0])


def two_contacts(law, state, small=1e-12):
    """A large contact and one as small as stated, which know nothing of each other; friction as solvers take it."""
    size = np.array([1.0, small])
    S, b = np.eye(6), np.concatenate([LOADS["slip"], np.array(LOADS[state]) * small])
    force = np.concatenate([right(law, "slip"), small * right(law, state)])
    mu, known = np.full(2, MU), {}
    if law == "micro-slip":
        known = dict(compliance=np.full(2, SPRING))
    if law == "pressure-dependent":  # the same pressure on less area
        known = dict(friction=[("table", POINTS, area) for area in size])
    pieces = rescaled(np.broadcast_to(table(POINTS), (2, *table(POINTS).shape)), 1.0 / size)
    return Problem(S, law, mu, **known), Friction(mu, pieces, known.get("compliance")), b, force


@pytest.mark.parametrize("state", LOADS)
@pytest.mark.parametrize("law", LAWS)
def test_right_answers_pass(law, state):
    problem, friction, b, force = two_contacts(law, state)
    verdict = judge(problem, b[None], force[None], (force + b)[None])
    assert verdict.own.max() == 0.0 and verdict.whole[0] == 0.0 and verdict.moved[0] <= 2.0
    certificate = certify(problem.S, b, friction, force, law)
    assert certificate.residual < 1e-14 and certificate.contact_residual.max() < 1e-14
    np.testing.assert_allclose(solve(problem.S, b, friction, law).force, force, rtol=1e-12, atol=1e-25)


@pytest.mark.parametrize("law, what", WRONG)
def test_a_wrong_small_contact_beside_a_large_one_is_found(law, what):
    """By the judge and by the certificate, whose residual relative to all does not see it."""
    state, change = PLANTED[what]
    problem, friction, b, force = two_contacts(law, state)
    force[3:] = 1e-12 * change(force[3:] / 1e-12)
    verdict = judge(problem, b[None], force[None], (force + b)[None])
    assert verdict.own[0, 0] == 0.0 and verdict.own[0, 1] > 1e3 * OWN and verdict.whole[0] < WHOLE
    certificate = certify(problem.S, b, friction, force, law)
    assert certificate.residual < 1e-10 and certificate.contact_residual[1] > 1e3 * RESOLVED
    large = judge(*_alone(problem, b, force))  # and relative to the largest, if there is nothing else
    assert large.whole[0] > WHOLE


def _alone(problem, b, force):
    known = {} if problem.compliance is None else dict(compliance=problem.compliance[1:])
    if problem.friction is not None:
        known = dict(friction=problem.friction[1:])
    return Problem(problem.S[3:, 3:], problem.law, problem.mu[1:], **known), b[None, 3:], force[None, 3:]


@pytest.mark.parametrize("law", LAWS)
def test_the_judge_finds_wrong_displacements(law):
    problem, _, b, force = two_contacts(law, "stick")
    assert judge(problem, b[None], force[None], (force + b)[None] + 1e-14).moved[0] > 32.0


@pytest.mark.parametrize("law", ["coulomb", "micro-slip", "pressure-dependent", "associated"])
def test_the_judge_finds_errors_of_a_path(law):
    problem, friction, b, _ = two_contacts(law, "stick")
    loads, start = np.stack([0.1 * b, b]), 0.1 * b.reshape(2, 3)[:, 1:]
    found = ContactSolver(problem.S, friction, law).follow(loads[None], path=Increments(3, recorded=True))
    ends, forces = found.record[0].ends, found.record[0].force
    end = found.displacement[0], found.anchor[0]
    verdict, off = judge_increments(problem, *loads, start, ends, forces, end)
    assert verdict.own[-1].max() < OWN and verdict.whole.max() < WHOLE and off < 1e-12
    assert not found.unresolved.any()
    assert judge_increments(problem, *loads, start, ends, forces, (end[0], end[1] + 1e-6))[1] > 1e-7
    wrong = forces * np.array([1.0, 1.01, 1.0])[:, None]
    assert judge_increments(problem, *loads, start, ends, wrong, end)[0].whole.max() > WHOLE


def test_forces_too_small_to_be_squared_become_zero():
    """Sweeps from a guess ended at 1e-172 N; the certificate squares forces."""
    assert not outcome(draw(213364)).failures


def test_contacts_are_certified_one_by_one_unless_nobody_asks():
    S, b = np.eye(6), np.array([[-1.0, 0.2, 0.0, 0.5, 0.0, 0.0]] * 3)
    for each in (True, False):
        solver = ContactSolver(S, 0.3, certify_each=each)
        found, one = solver.solve(b), solver.solve(b[0])
        path = solver.follow(np.stack([0 * b, b], axis=1), path=Increments(2))
        named = found.unresolved, one.unresolved, path.unresolved
        shapes = [None if values is None else values.shape for values in named]
        assert shapes == ([(3, 2), (2,), (3, 2)] if each else [None] * 3)
        assert found.converged.all() and path.converged.all()


@pytest.mark.parametrize("law", LAWS)
def test_refinement_resolves_small_contacts(law):
    """Graded by 1e-12 and coupled; the error of the start is of all contacts, not of the small one."""
    problem, friction, b, force = two_contacts(law, "slip")
    S = problem.S.copy()
    S[0, 3] = S[3, 0] = 1e-3
    b[3] -= 1e-3 * force[0]
    solver = ContactSolver(S, friction, law)
    start = force + 1e-13 * np.array([1.0, 0.3, 0.1, 1.0, 0.3, 0.1]) * (1.0 if LAWS[law].frictional else [1, 0, 0] * 2)
    assert certify(S, b, friction, start, law).contact_residual[1] > 1e-3
    series = 0.0 if problem.compliance is None else np.diag(np.tile([0.0, SPRING, SPRING], 2))
    found = refined(S + series, b, start, solver.law.parameters(Friction.of(friction, 2)), solver.law, 3)
    assert certify(S, b, friction, found, law).contact_residual.max() <= RESOLVED
    solution = solver.solve(b)
    assert solution.converged and not solution.unresolved.any()


@pytest.mark.parametrize("law", LAWS)
def test_a_contact_that_overlaps_and_cannot_move_is_infeasible(law):
    """However small its overlap is against the others."""
    S = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    solution = ContactSolver(S, 0.3, law).solve(
        np.array([[-1.0, 1.0, 0.0, -1e-13, 0, 0], [-1.0, 1.0, 0.0, 1e-13, 0, 0]])
    )
    assert solution.status.tolist() == [Status.INFEASIBLE, Status.CONVERGED]
    assert solution.converged.tolist() == [False, True]


def test_paths_out_of_range_are_refused_without_a_warning():
    b = np.array([1e-200, 1.0, 1e200])[:, None, None] * np.array([[0.1, 0.0, 0.0], [-1.0, 1.0, 0.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in (Followed(), Increments(2)):
            found = ContactSolver(np.eye(3), 0.3).follow(b, path=path)
            assert found.converged.tolist() == [False, True, False]
            assert [status is Status.OUT_OF_RANGE for status in found.status] == [True, False, True]


@pytest.mark.parametrize("b", [np.zeros((1, 1, 3)), np.zeros((2, 3)), np.zeros((1, 2, 6)), np.full((1, 2, 3), np.nan)])
def test_a_path_without_loads_is_refused(b):
    with pytest.raises(ValueError, match=r"^b (must have shape|contains)"):
        ContactSolver(np.eye(3), 0.3).follow(b)


def test_a_path_ends_at_its_first_unsolved_increment(monkeypatch):
    """The jaws close on a wedge in the first of 64 increments; the other sample goes on."""
    S = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
    solver, calls = ContactSolver(S, 0.3), []
    attempts = solver.backend.infeasible
    monkeypatch.setattr(solver.backend, "infeasible", lambda b: calls.append(0) or attempts(b))
    jammed, free = [-1.0, 0.1, 0.0, -1.0, 0.0, 0.0], [-1.0, 0.1, 0.0, 2.0, 0.0, 0.0]
    loads = np.array([[np.zeros(6), jammed], [np.zeros(6), free]])
    found = solver.follow(loads, path=Increments(64))
    assert found.converged.tolist() == [False, True] and found.status[0] is Status.INFEASIBLE
    assert len(calls) == 1 and found.rung[1] == "increments"
