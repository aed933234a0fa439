"""Degenerate, extreme and infeasible contact problems, judged by the certificate."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from mic.contact import ContactSolver, Status, certify, ladder, solve
from mic.contact.laws import ASSOCIATED, COULOMB, LAWS
from mic.contact.native.linear_step import LARGE, linear_step
from mic.contact.native.proximal_points import proximal_points
from mic.contact.native.solver import NativeSolver
from mic.contact.states import OPEN, STICK
from verification.contact_problems import (
    arch,
    box_stack,
    brick_wall,
    capsule_pile,
    clamped_sheet,
    compliant,
    hanging_chain,
    manufactured,
    rock_heap,
    slip_dominated,
    sphere_pile,
)

FRICTION = [0.0, 1e-12, 0.27, 1.0, 5.0, 1e3]


def assert_solved(solution, S, b, mu, law="coulomb", tol=1e-10):
    assert np.all(solution.converged), (solution.residual, solution.status)
    recomputed = certify(S, b, mu, solution.force, law)
    assert np.max(recomputed.residual, initial=0.0) <= tol
    np.testing.assert_allclose(solution.displacement, solution.force @ S + b, atol=1e-9 * np.abs(b).max(initial=1.0))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    m=st.integers(1, 8),
    rank=st.floats(0.34, 1.0),
    mu=st.lists(st.sampled_from(FRICTION), min_size=8, max_size=8),
    law=st.sampled_from(list(LAWS)),
    seed=st.integers(0, 10_000),
    log_size=st.floats(-9, 9),
)
def test_random_feasible_problems_are_solved(m, rank, mu, law, seed, log_size):
    """Any rank, any friction, any size: feasible because ``b - S f₀`` opens every contact for some ``f₀``."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((3 * m, max(1, int(rank * 3 * m))))
    S, mu = root @ root.T, np.array(mu[:m])
    opening = np.zeros((m, 3))
    opening[:, 0] = rng.uniform(0.0, 1.0, m)
    b = 10.0**log_size * (opening.ravel() - rng.uniform(0.0, 2.0, m).repeat(3) * rng.standard_normal(3 * m) @ S)
    solution = solve(S, b, mu, law)
    # Convex laws, without shift, have a solution wherever forces open all contacts, and it is found. Of the others this
    # is sure for little friction only: beyond, an honest failure passes and a false success does not.
    residual = certify(S, b, mu, solution.force, law).residual
    assert solution.converged == (residual <= 1e-10) or abs(residual - 1e-10) < 1e-12
    if max(mu) <= 1.0 or LAWS[law].shift == 0.0:
        assert solution.converged, (solution.status, residual)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu", FRICTION)
def test_problems_with_any_friction_are_solved(mu, law):
    rng = np.random.default_rng(3)
    S = compliant(12, rng)
    b = rng.standard_normal((6, 36))
    solution = solve(S, b, mu, law)
    assert_solved(solution, S, b, mu, law)
    if mu == 0.0:
        np.testing.assert_allclose(solution.force, solve(S, b, 0.0, "frictionless").force, atol=1e-8)


@pytest.mark.parametrize("law", ["coulomb", "associated"])
@pytest.mark.parametrize("stick, slide", [(1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (0.7, 0.2)])
def test_manufactured_solutions_are_found(law, stick, slide):
    rng = np.random.default_rng(5)
    problem = manufactured(compliant(20, rng, condition=1e4), np.full(20, 0.27), 10, rng, stick, slide, law)
    solution = solve(problem.S, problem.b, problem.mu, law)
    assert_solved(solution, problem.S, problem.b, problem.mu, law)
    size = np.abs(problem.b).max()
    np.testing.assert_allclose(solution.displacement, problem.displacement, atol=1e-8 * size)
    np.testing.assert_allclose(solution.force, problem.force, atol=1e-5 * max(np.abs(problem.force).max(), 1e-12))


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e3])
def test_problems_with_gaps_of_any_size_are_solved(gap):
    rng = np.random.default_rng(6)
    S = compliant(10, rng, condition=1e3)
    b = rng.standard_normal((5, 30))
    b[:, ::6] = gap * np.abs(b[:, ::6])
    assert_solved(solve(S, b, 0.3), S, b, 0.3)
    opened = solve(S, np.abs(b) * gap, 0.3)
    assert opened.converged.all() and not opened.force.any() and not opened.residual.any()


@pytest.mark.parametrize("law", LAWS)
def test_duplicated_contacts_do_not_change_displacements(law):
    rng = np.random.default_rng(7)
    single = manufactured(compliant(8, rng, condition=1e3), np.full(8, 0.3), 5, rng, 0.5, 0.3)
    pick = np.arange(24).reshape(8, 3)[[0, 0, 1, 2, 2, 2, 3, 4, 5, 6, 7, 7]].ravel()
    S, b = single.S[np.ix_(pick, pick)], single.b[:, pick]
    solution = solve(S, b, 0.3, law)
    assert_solved(solution, S, b, 0.3, law)
    expected = solve(single.S, single.b, 0.3, law).displacement[:, pick]
    np.testing.assert_allclose(solution.displacement, expected, atol=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_contacts_without_tangential_compliance_are_solved(law):
    S = np.diag([1.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    S[0, 3] = S[3, 0] = 0.5
    b = np.array([-1.0, 0.0, 0.0, -1.0, 0.3, 0.0])
    solution = solve(S, b, 0.3, law)
    assert solution.status is Status.CONVERGED and certify(S, b, 0.3, solution.force, law).residual <= 1e-10


@pytest.mark.parametrize("law", LAWS)
def test_infeasible_loads_are_never_solved(law):
    """A wedge between two rigid jaws: any force that opens one contact closes the other."""
    S = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
    b = np.array([[-1.0, 0.1, 0.0, -1.0, 0.0, 0.0], [-1.0, 0.1, 0.0, 2.0, 0.0, 0.0]])  # too thick; fits
    solution = solve(S, b, 0.3, law)
    assert solution.status[0] is Status.INFEASIBLE and not solution.converged[0] and solution.residual[0] > 1e-3
    assert solution.status[1] is Status.CONVERGED


RIGID = {
    "stack": lambda: box_stack(10),
    "tower": lambda: box_stack(15, (0.3, 0.3, 1.0)),
    "wall": lambda: brick_wall(4, 3),
    "arch": lambda: arch(15),
    "spheres": lambda: sphere_pile(3, 3, np.random.default_rng(1)),
    "logs": lambda: capsule_pile(5, 4),
    "chain": lambda: hanging_chain(15),
}


@pytest.mark.parametrize("mu", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("scene", RIGID)
def test_rigid_bodies_in_contact_are_solved(scene, mu):
    """Many more contacts than degrees of freedom, at rest and disturbed."""
    for speed in (0.0, 0.05):
        problem = RIGID[scene]().problem(mu, np.random.default_rng(2), speed)
        assert np.linalg.matrix_rank(problem.S, 1e-9 * np.abs(problem.S).max()) < 0.7 * len(problem.S)
        assert_solved(solve(problem.S, problem.b, problem.mu), problem.S, problem.b, problem.mu)


@pytest.mark.parametrize("order", [0, 11])
@pytest.mark.parametrize("jammed", ["rocks", "sheet"])
def test_jammed_problems_are_solved_in_any_order_of_their_contacts(jammed, order):
    """Rocks on faces of any direction, and a sheet that bends in few modes between rigid blocks."""
    if jammed == "rocks":
        problem = rock_heap(16, np.random.default_rng(8)).problem(0.6, np.random.default_rng(9), 0.2)
    else:
        problem = clamped_sheet(60, 11, np.random.default_rng(10))
    m = len(problem.mu)
    assert np.linalg.matrix_rank(problem.S, hermitian=True) < 1.5 * m
    rows = (3 * np.random.default_rng(order).permutation(m)[:, None] + np.arange(3)).ravel()
    S, b = problem.S[np.ix_(rows, rows)], problem.b[:, rows]
    assert_solved(solve(S, b, problem.mu), S, b, problem.mu)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("condition", [1e3, 1e8, 1e12])
def test_problems_with_ill_conditioned_compliance_are_solved(condition, law):
    rng = np.random.default_rng(8)
    S = compliant(10, rng, condition)
    problem = manufactured(S, np.full(10, 0.27), 6, rng, 0.4, 0.4, "associated" if law == "associated" else "coulomb")
    assert_solved(solve(S, problem.b, 0.27, law), S, problem.b, 0.27, law)


@pytest.mark.parametrize("condition", [1e4, 1e7])
@pytest.mark.parametrize("m", [2, 3])
def test_slip_that_opens_contacts_is_found_without_overlap(m, condition):
    """Under the associated law a contact with a gap carries force where it slips by more than the gap allows. Without
    overlaps nor forces an error had no size, and no force at all passed for the solution of an easier problem."""
    mu, apart = np.full(m, 1.5), 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        S = compliant(m, rng, condition, 10.0)
        problem = manufactured(S, mu, 4, rng, 0.1, 0.3, ASSOCIATED)
        apart += ((problem.b[:, ::3] > 0.0).all(axis=1) & problem.force.any(axis=1)).sum()
        assert_solved(solve(S, problem.b, mu, "associated"), S, problem.b, mu, "associated")
    assert apart >= 5  # of 160: these are what it is about


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("ratio", [1e-4, 1e4])
def test_tangential_units_do_not_matter(ratio, law):
    """Tangential lengths in another unit: ``S_tt`` changes by ``ratio`` against ``S_nn``, ``μ`` by ``ratio^{-1/2}``."""
    rng = np.random.default_rng(10)
    problem = slip_dominated(15, 6, rng)
    unit = np.tile([1.0, np.sqrt(ratio), np.sqrt(ratio)], 15)
    S = problem.S * unit[:, None] * unit
    solution = solve(S, problem.b * unit, 0.27 / np.sqrt(ratio), law)
    assert_solved(solution, S, problem.b * unit, 0.27 / np.sqrt(ratio), law)
    reference = solve(problem.S, problem.b, 0.27, law).force
    np.testing.assert_allclose(solution.force * unit, reference, atol=1e-8 * np.abs(reference).max())


def test_normal_rows_alone_give_the_frictionless_answer():
    rng = np.random.default_rng(12)
    S, b = compliant(15, rng), rng.standard_normal((6, 45))
    full = solve(S, b, 0.3, "frictionless")
    normal = solve(S[::3, ::3], b[:, ::3], 0.3, "frictionless", dimension=1)
    np.testing.assert_allclose(normal.force, full.force[:, ::3], atol=1e-12)
    np.testing.assert_allclose(normal.displacement, full.displacement[:, ::3], atol=1e-12)
    np.testing.assert_allclose(normal.residual, full.residual, atol=1e-12)


def test_a_good_guess_saves_iterations():
    problem = slip_dominated(30, 10, np.random.default_rng(13))
    solver = ContactSolver(problem.S, problem.mu)
    cold = solver.solve(problem.b)
    warm = solver.solve(problem.b, guess=cold.force)
    assert warm.converged.all() and warm.iterations.sum() < cold.iterations.sum()


@pytest.mark.parametrize("condition, near", [(10.0, True), (1e6, False)])
def test_a_large_newton_step_is_solved_iteratively_or_by_factorisation(condition, near):
    """Contacts that all stick: the forces that take their displacements back."""
    m = LARGE // 3 + 5
    W, rng = compliant(m, np.random.default_rng(4), condition), np.random.default_rng(5)
    z, x = rng.normal(size=3 * m), np.empty(3 * m)
    A, B, stick = np.zeros((m, 3, 3)), np.tile(np.eye(3), (m, 1, 1)), np.full(m, STICK)
    assert linear_step(W, A, B, z, stick, OPEN, z, 0.0, True, x) == near
    np.testing.assert_allclose(W @ x, -z, atol=1e-7 * np.abs(z).max())


@pytest.mark.slow
def test_many_sticking_contacts_do_not_depend_on_their_batch():
    m = LARGE // 3 + 5
    rng = np.random.default_rng(6)
    problem = manufactured(compliant(m, rng, 1e3), np.full(m, 0.3), 6, rng, stick=0.8, slide=0.1)
    solver = ContactSolver(problem.S, problem.mu)
    found = solver.solve(problem.b)
    assert_solved(found, problem.S, problem.b, problem.mu)
    assert set(found.rung) == {"splitting"}
    np.testing.assert_allclose(found.force, problem.force, atol=1e-7 * np.abs(problem.force).max())
    for some in (slice(0, 1), slice(2, 6), slice(1, 6)):  # by themselves, or in another place among four
        np.testing.assert_array_equal(solver.solve(problem.b[some]).force, found.force[some])


def test_a_sample_ends_within_its_work():
    S = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
    hopeless, nothing = np.tile([-1.0, 0.1, 0.0], 2), np.zeros(6)
    counts = []
    for work in (5.0, 50.0, 500.0):
        native = NativeSolver(S, np.full(2, 0.27), COULOMB, 1e-10, 1, 3, work)
        found = [max(1.0, (both - steps) / 2 + steps) for _, both, steps, _ in native.attempts(hopeless, nothing)]
        assert work <= sum(found) and sum(found[:-1]) <= work
        counts.append(len(found))
    assert 1 <= counts[0] < counts[1] < counts[2]


def test_a_sample_that_needs_more_work_than_stated_is_not_converged():
    heap = rock_heap(12, np.random.default_rng(2)).problem(0.6, np.random.default_rng(2), 0.2)
    enough, less = (ContactSolver(heap.S, 0.6, work=work).solve(heap.b[0]) for work in (ladder.WORK, 0))
    assert enough.status is Status.CONVERGED and less.status is Status.NOT_CONVERGED
    assert less.factorisations < enough.factorisations < ladder.WORK and "solver_work" in less.status.advice


@pytest.mark.parametrize("law", [law for law in LAWS if LAWS[law].frictional])
def test_a_motion_that_slip_must_open_is_proven_to_be_infeasible(law):
    """No force moves the contact along d, which lies on the cone; under the associated law slip opens contacts."""
    d = np.array([1.0, -0.3, 0.0])
    solution = solve(np.eye(3) - np.outer(d, d) / (d @ d), [-0.1, 1.0, 0.0], 0.3, law)
    assert (solution.status is Status.INFEASIBLE) == (law == "associated")


def test_uncoupled_groups_of_contacts_are_solved_separately():
    """Two elastic interfaces that mostly stick and a contact that nothing else moves, in one S, by chance."""
    parts = [
        manufactured(compliant(12, np.random.default_rng(k)), np.full(12, 0.4), 3, np.random.default_rng(k), 0.8, 0.1)
        for k in (2, 3)
    ]
    S = block_diag(*(part.S for part in parts), np.eye(3))
    b = np.hstack([*(part.b for part in parts), np.tile([-1.0, 0.2, 0.0], (3, 1))])
    rows = (3 * np.random.default_rng(3).permutation(25)[:, None] + np.arange(3)).ravel()
    together = solve(S[np.ix_(rows, rows)], b[:, rows], 0.4)
    assert_solved(together, S[np.ix_(rows, rows)], b[:, rows], 0.4)
    assert set(together.rung) == {"splitting"}
    u = np.empty_like(b)
    u[:, rows] = together.displacement
    expected = np.hstack([*(part.displacement for part in parts), np.zeros((3, 3))])
    np.testing.assert_allclose(u, expected, atol=1e-8 * np.abs(b).max())
    solver = ContactSolver(S, 0.4)
    solver.solve(b)
    np.testing.assert_allclose(solver.with_friction(0.2).solve(b).force, solve(S, b, 0.2).force, atol=1e-8)


def test_each_group_of_contacts_starts_from_the_solutions_of_the_others():
    heaps = [rock_heap(12, np.random.default_rng(k)).problem(0.6, np.random.default_rng(k), 0.2) for k in (2, 7, 10)]
    S, b = block_diag(*(heap.S for heap in heaps)), np.hstack([heap.b for heap in heaps])
    rungs = {*np.concatenate([solve(heap.S, heap.b, 0.6).rung for heap in heaps])}
    together = solve(S, b, 0.6)
    assert rungs == {"proximal points"} and set(together.rung) == rungs
    assert_solved(together, S, b, 0.6)


def test_unsolved_proximal_steps_are_rejected():
    problem = box_stack(5).problem(0.4, np.random.default_rng(1), 0.1)
    native = NativeSolver(problem.S, problem.mu, COULOMB, 1e-10, 1, 3)
    start = 0.1 * np.abs(np.random.default_rng(2).standard_normal(60))
    rung = ladder.PROXIMAL
    never = replace(rung, settings=rung.settings | {"first": (), "tol": 1e-300})
    for changed, stays in ((never, True), (replace(rung, settings=rung.settings | {"first": ()}), False)):
        known = native.problem, changed, problem.b[0] * native.scaling, start
        forces = [y for y, *_ in itertools.islice(proximal_points(*known), 8)]
        assert all(np.array_equal(y, start) for y in forces) == stays
