"""A working set of candidates against all candidates at once."""

import pickle
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from mic.contact import ContactSolver, laws
from mic.contact import working_set as watching
from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.native import landing
from mic.contact.native.solver import NativeSolver
from mic.contact.path import Followed, Increments
from mic.contact.path_forecast import PathForecast
from mic.contact.states import OPEN
from mic.contact.working_set import PENETRATION, WorkingSetSolver
from verification.contact_problems import compliant

REACH = 15.0  # radius of neighbourhoods
M, N = 60, 12


@pytest.fixture(scope="module")
def problem():
    """Candidates of which some fifth closes along the way: compliance, places, loads at the start and the end."""
    rng = np.random.default_rng(3)
    S = compliant(M, rng, 1e4)
    point = np.column_stack([rng.random((M, 2)) * 100, np.zeros(M)])
    b = np.zeros((N, 2, 3 * M))
    b[:, 0, ::3] = rng.uniform(0.2, 1.0, (N, M))
    b[:, 1] = b[:, 0] + 0.3 * rng.standard_normal((N, 3 * M))
    b[:, 1, ::3] -= 0.8 * (rng.random((N, M)) < 0.3)
    return S, point, b


def watched(problem, law="coulomb", start=None, allowed=None, friction=0.3, **settings):
    S, point, _ = problem
    start = np.zeros(M, bool) if start is None else start
    allowed = np.ones(M, bool) if allowed is None else allowed
    given = Columns.of(S), Friction.of(friction, M), point, np.full(M, REACH), start, allowed, laws.find(law)
    return WorkingSetSolver(*given, tol=1e-10, **settings)


def followed(solver, b, path):
    n = len(b)
    return solver.follow(b, np.zeros((n, 3 * M)), b[:, 0].reshape(n, M, 3)[:, :, 1:], path)


@pytest.mark.parametrize("law", ["coulomb", "frictionless", "associated"])
def test_the_working_set_gives_the_result_of_all_candidates(problem, law):
    S, _, b = problem
    everything, path = ContactSolver(S, 0.3, law), Increments(1)
    for few, all_ in (
        (followed(watched(problem, law), b, path), followed(everything, b, path)),
        (watched(problem, law).solve(b[:, 1]), everything.solve(b[:, 1])),
    ):
        touching = (all_.force[:, ::3] > 1e-9).sum(axis=1)
        assert few.converged.all() and all_.converged.all() and (touching > 1).all() and touching.max() > 3
        np.testing.assert_allclose(few.displacement, all_.displacement, atol=1e-5)
        assert few.displacement[:, ::3].min() > -2 * PENETRATION * REACH


def test_a_followed_path_ends_as_with_all_candidates(problem):
    S, _, b = problem
    path = Followed(1e-5)
    few, all_ = followed(watched(problem), b, path), followed(ContactSolver(S, 0.3), b, path)
    motion = np.abs(b[:, 1] - b[:, 0]).max()
    assert np.abs(few.displacement - all_.displacement).max() < 1e-3 * motion
    assert np.abs(few.anchor - all_.anchor).max() < 1e-3 * motion
    np.testing.assert_allclose(few.trace.share.sum(axis=2), 1.0, atol=1e-9)


@pytest.mark.parametrize("path", [Followed(1e-6), Increments(600)], ids=["followed", "increments"])
def test_candidates_that_touch_only_on_the_way_are_included(path):
    """The second of two candidates touches first, and rubs until the first one, deeper at the end, lifts it."""
    S = np.kron([[1.0, 0.9], [0.9, 1.0]], np.diag([1.0, 0.5, 0.5])) + np.diag([0, 0.2, 0.2] * 2)
    b = np.array([[[0.5, 0, 0, 0.1, 0, 0], [-1.0, 0.6, 0, -0.5, 0.6, 0]]])
    given = Friction.of(0.3, 2), np.zeros((2, 3)), np.ones(2), np.zeros(2, bool), np.ones(2, bool)
    solver = WorkingSetSolver(Columns.of(S), *given, laws.find("coulomb"), tol=1e-10)
    few = solver.follow(b, np.zeros((1, 6)), np.zeros((1, 2, 2)), path)
    all_ = ContactSolver(S, 0.3).follow(b, np.zeros((1, 6)), np.zeros((1, 2, 2)), path)
    assert few.force[0, 3] == 0 and few.record is None
    assert all_.trace.work[0, 1] > 1e-4
    for name in ("slip", "length", "work", "share"):
        np.testing.assert_allclose(getattr(few.trace, name), getattr(all_.trace, name), atol=1e-5, err_msg=name)
    np.testing.assert_allclose(few.anchor, all_.anchor, atol=1e-5)


def test_a_sample_does_not_depend_on_its_batch(problem, monkeypatch):
    _, _, b = problem
    together = followed(watched(problem), b, Followed())
    monkeypatch.setattr("mic.contact.working_set.MAX_RECORDED", 1)
    apart = followed(watched(problem), b, Followed())
    np.testing.assert_allclose(apart.displacement, together.displacement, atol=1e-9)
    np.testing.assert_allclose(apart.trace.work, together.trace.work, atol=1e-9)
    alone = followed(watched(problem), b[[3]], Followed())
    np.testing.assert_allclose(alone.displacement[0], together.displacement[3], atol=1e-9)
    np.testing.assert_allclose(alone.trace.error[0], together.trace.error[3], rtol=1e-6)


def test_the_initial_working_set_does_not_change_the_result(problem):
    _, _, b = problem
    one = followed(watched(problem), b, Increments(1))
    solver = watched(problem, start=np.arange(M) % 3 == 0)
    np.testing.assert_allclose(followed(solver, b, Increments(1)).displacement, one.displacement, atol=1e-5)
    assert (solver.carried == (one.force[:, ::3] > 1e-9).any(axis=0)).mean() > 0.95


def test_excluded_candidates_carry_no_force(problem):
    _, _, b = problem
    free = followed(watched(problem), b, Increments(1))
    most = int(free.force[:, ::3].sum(axis=0).argmax())
    solver = watched(problem, allowed=np.arange(M) != most)
    n = len(b)
    found = solver.follow(b, free.force, b[:, 0].reshape(n, M, 3)[:, :, 1:], Increments(1))
    assert not found.force[:, 3 * most : 3 * most + 3].any()
    assert found.displacement[:, 3 * most].min() < -0.01 and found.converged.all()


def test_open_candidates_need_no_solve(problem):
    _, _, b = problem
    apart = b.copy()
    apart[:, :, ::3] += 10.0
    found = followed(watched(problem), apart, Followed())
    assert found.converged.all() and not found.force.any() and (found.trace.share[:, :, OPEN] == 1).all()
    np.testing.assert_array_equal(found.displacement, apart[:, 1])


@pytest.mark.parametrize("noise", [0, 1, 2])
def test_rounding_does_not_choose_between_equal_candidates(noise):
    """Six places, at each two candidates that read the same: one holds up both, the first of them."""
    apart = np.abs(np.subtract.outer(np.arange(6.0), np.arange(6.0)))
    twins = np.kron(np.exp(-apart / 2), np.ones((2, 2))) + 1e-6 * np.eye(12)
    S = np.kron(twins, np.diag([1.0, 0.6, 0.6]))
    b = np.zeros((1, 2, 36))
    b[0, 1] = np.tile([-0.02, 0.01, 0.004], 12)
    point = np.column_stack([np.repeat(np.arange(6.0), 2), np.zeros((12, 2))])
    given = Friction.of(0.3, 12), point, np.full(12, 0.5), np.zeros(12, bool), np.ones(12, bool)

    def end(b):
        solver = WorkingSetSolver(Columns.of(S), *given, laws.find("coulomb"), tol=1e-10)
        return solver.follow(b, np.zeros((1, 36)), np.zeros((1, 12, 2)), Followed()).force[0, ::3]

    plain = end(b)
    rounded = end(b * (1 + 1e-14 * np.random.default_rng(noise).standard_normal(b.shape)))
    assert plain[::2].min() > 0 and not plain[1::2].any()
    np.testing.assert_allclose(rounded, plain, rtol=0, atol=1e-9 * plain.max())


def test_factorisations_of_all_rounds_count(problem, monkeypatch):
    step, spent = NativeSolver.step, []

    def counted(*args):
        before = int(args[-1].factorisations.sum())
        step(*args)
        spent.append(int(args[-1].factorisations.sum()) - before)

    monkeypatch.setattr(NativeSolver, "step", counted)
    monkeypatch.setattr("mic.contact.native.solver.SWEEPS", 1)  # more would leave Newton's method little to do
    found = [followed(watched(problem), problem[2][[i]], Increments(1)) for i in range(N)]
    assert sum(one > 0 for one in spent) > N  # in more rounds than samples
    assert sum(int(each.trace.factorisations[0]) for each in found) == sum(spent)


def test_a_forecast_saves_factorisations_and_does_not_change_the_result(problem):
    b = problem[2]
    plain = followed(watched(problem), b, Increments(1))
    change, load = plain.force, b[:, 1, ::3]
    touching = (plain.force[:, ::3] > 0).any(axis=0)
    spent = {}
    for name, known in {"none": change[:0], "right": change, "wrong": -3.0 * change[::-1] + change.max()}.items():
        seen = PathForecast(touching, load[: len(known)], known)
        found = followed(watched(problem, start=touching, forecast=seen), b, Increments(1))
        assert found.converged.all() and (found.rung == "increments").all()
        np.testing.assert_allclose(found.displacement, plain.displacement, atol=1e-6)
        np.testing.assert_allclose(found.trace.work, plain.trace.work, atol=1e-6 * plain.trace.work.max())
        spent[name] = found.trace.factorisations.sum()
    assert spent["right"] < 0.7 * spent["none"] < spent["wrong"]


def test_a_screening_solver_records_its_samples(problem):
    b = problem[2]
    solver = watched(problem, screening=True)
    found = followed(solver, b, Increments(1))
    seen = solver.observed
    assert found.converged.all()
    np.testing.assert_array_equal(seen.load, b[:, 1, ::3])
    np.testing.assert_array_equal(seen.change, found.force)
    again = solver.follow(np.stack([b[:, 1], b[:, 0]], axis=1), found.force, found.anchor, Increments(1))
    np.testing.assert_array_equal(solver.observed.change[N:], again.force - found.force)


@pytest.mark.parametrize("law", ["coulomb", "micro-slip", "associated", "frictionless"])
def test_one_increment_of_a_batch_equals_that_of_single_samples(problem, law):
    """The step from loaded contacts, with a start of its own and some that may not touch, against the general way."""
    S, _, b = problem
    start, allowed = np.arange(M) % 5 == 0, np.arange(M) % 7 != 3
    friction = Friction(np.linspace(0.1, 0.4, M), compliance=np.linspace(1e-3, 2e-3, M))
    solver = watched(problem, law, start, allowed, friction)
    before = followed(solver, b, Increments(1))
    load = np.stack([b[:, 1], b[:, 1] + 0.1 * (b[::-1, 1] - b[:, 1])], axis=1)
    given = load, before.force, before.anchor, Increments(1)
    together = solver.follow(*given)
    alone = [solver.follow(*(a[[i]] for a in given[:3]), given[3]) for i in range(N)]
    one_by_one = solver.follow(*given[:3], Increments(1, recorded=True))  # whose forces at each step are asked for
    assert together.converged.all() and one_by_one.converged.all()
    assert (together.rung == ("active set" if law == "frictionless" else "increments")).all()
    for name in ("force", "displacement", "anchor"):
        found, size = getattr(together, name), np.abs(getattr(together, name)).max()
        np.testing.assert_array_equal(found, np.concatenate([getattr(each, name) for each in alone]))
        np.testing.assert_allclose(found, getattr(one_by_one, name), atol=1e-9 * size)
    assert np.abs(together.trace.slip).max() > 1e-3 or law == "frictionless"
    assert (together.force[:, np.repeat(~allowed, 3)] == 0).all()
    for name in ("slip", "length", "work", "share", "error"):
        np.testing.assert_allclose(getattr(together.trace, name), getattr(one_by_one.trace, name), atol=1e-7)


@pytest.mark.parametrize("law", ["coulomb", "associated", "micro-slip", "pressure-dependent"])
def test_a_round_started_from_the_previous_one_gives_the_same_solution(problem, law, monkeypatch):
    """The samples press mostly the same contacts; results do not depend on the batch, to the bit."""
    _, point, b = problem
    start, end = np.arange(M) % 3 == 0, 0.3 * b[:, 1]
    end[:, ::3][:, start] = -1.0  # these press, and most stick; of the others some join
    apart = np.linalg.norm(point[:, None] - point, axis=2)
    given = np.kron(np.eye(M) + np.exp(-apart / 8.0), np.eye(3)), point, None
    friction = rough(0.3)
    usual = watched(given, law, start, friction=friction).solve(end)
    monkeypatch.setattr(watching, "MAX_INITIAL", 10)
    monkeypatch.setattr(landing, "STEPS", 3)  # enough where each squares the error
    near = watched(given, law, start, friction=friction)
    found = near.solve(end)
    assert usual.converged.all() and found.converged.all() and (found.rung == "guess").sum() >= 10
    for name in ("force", "displacement", "anchor"):
        size = np.abs(getattr(usual, name)).max()
        np.testing.assert_allclose(getattr(found, name), getattr(usual, name), atol=1e-9 * size)
    for solver in (near, watched(given, law, start, friction=friction)):  # all is known, or nothing
        alone = [solver.solve(end[[i]]) for i in range(N)]
        for name in ("force", "displacement", "anchor"):
            np.testing.assert_array_equal(getattr(found, name), np.concatenate([getattr(one, name) for one in alone]))
    monkeypatch.setattr(watching, "MAX_PREPARED", 30)
    apiece = watched(given, law, start, friction=friction)  # of more candidates no solver is had for all samples
    np.testing.assert_array_equal(apiece.solve(end).force, found.force)


@pytest.mark.parametrize("law", ["coulomb", "frictionless", "associated", "micro-slip"])
def test_a_subset_of_a_prepared_solver_equals_a_solver_of_these_contacts(problem, law):
    S, _, b = problem
    own = np.arange(M) % 3 == 1
    rows = np.repeat(own, 3)
    friction = Friction(np.linspace(0.1, 0.4, M), compliance=np.linspace(1e-3, 2e-3, M))
    alone = ContactSolver(S[np.ix_(rows, rows)], friction.take(own), law).solve(b[:, 1, rows])
    taken = ContactSolver(S, friction, law).subset(own).solve(b[:, 1, rows])
    assert (alone.force[:, ::3] > 1e-9).any(axis=1).all() and alone.converged.all()
    np.testing.assert_array_equal(taken.force, alone.force)
    np.testing.assert_array_equal(taken.residual, alone.residual)


LAWS = ["coulomb", "frictionless", "associated", "micro-slip", "pressure-dependent"]


def rough(coefficient, yielding=1e-4):
    """Friction of a coefficient that halves under pressure, of contacts that yield."""
    pressure = np.zeros((M, 2, 5))
    pressure[:, 0, 1], pressure[:, 1, 0], pressure[:, 1, 1] = coefficient, 0.05, coefficient / 2
    return Friction(np.full(M, coefficient), pressure, np.full(M, yielding))


def alike(one, other):
    for name in ("force", "displacement", "anchor", "residual", "status"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("law", LAWS)
def test_changing_the_friction_of_a_solver_equals_a_new_solver(problem, law):
    S, _, b = problem
    before, path = ContactSolver(S, rough(0.5), law), Increments(1)
    first = followed(before, b, path)
    for friction in (rough(0.2), rough(0.2, yielding=3e-4)):
        found = followed(before.with_friction(friction), b, path)
        alike(found, followed(ContactSolver(S, friction, law), b, path))
        assert (law == "frictionless") == (np.abs(found.force - first.force).max() < 1e-9)
    alike(followed(before, b, path), first)  # the one it was made of stays


@pytest.mark.parametrize("law", LAWS)
def test_changing_the_friction_of_a_working_set_equals_a_new_one(problem, law):
    _, _, b = problem
    before, path = watched(problem, law, friction=rough(0.5)), Increments(1)
    followed(before, b, path)
    after, made = before.with_friction(rough(0.2)), watched(problem, law, friction=rough(0.2))
    alike(followed(after, b, path), followed(made, b, path))
    np.testing.assert_array_equal(after.carried, made.carried)
    normal = np.full((1, M), 0.2)
    np.testing.assert_array_equal(after.bound(normal), made.bound(normal))


def test_threads_that_request_columns_at_once_get_the_right_ones():
    """Finding them lets others run meanwhile, as compiled code does."""
    S = np.random.default_rng(0).standard_normal((40, 40))

    def find(numbers):
        time.sleep(1e-4)
        return S.T[numbers]

    columns, orders = Columns(find, S.shape), [np.random.default_rng(i).permutation(40) for i in range(4)]

    def asked(order):
        return [columns.take(order[i : i + 3]) for i in range(0, 40, 3)]

    with ThreadPoolExecutor(4) as pool:
        for order, columns_found in zip(orders, pool.map(asked, orders)):
            np.testing.assert_array_equal(np.concatenate(columns_found), S.T[order])
    assert columns.found == 40
    again = pickle.loads(pickle.dumps(Columns.of(S)))
    np.testing.assert_array_equal(again.take(orders[0]), S.T[orders[0]])


def test_columns_are_computed_once_and_cached_where_they_are_used():
    S, asked = np.random.default_rng(0).standard_normal((6, 6)), []

    def find(numbers):
        asked.extend(numbers)
        return S.T[numbers]

    columns = Columns(find, S.shape)
    doubled = Columns(lambda numbers: 2 * columns.uncached(numbers), S.shape)
    columns.take(np.array([2]))
    for _ in range(2):
        np.testing.assert_array_equal(doubled.take(np.array([4, 2, 0])), 2 * S.T[[4, 2, 0]])
    assert (columns.found, doubled.found, sorted(asked)) == (1, 3, [0, 2, 4])


def crowd(monkeypatch):
    """Lowers the numbers of candidates and contacts that count as many."""
    monkeypatch.setattr("mic.contact.working_set.MANY_CANDIDATES", 10)
    monkeypatch.setattr("mic.contact.working_set.MAX_INITIAL", 5)


@pytest.mark.parametrize("path", [Increments(1), Followed(1e-5)], ids=["at once", "followed"])
def test_a_path_with_many_candidates_ends_at_the_same_state(problem, monkeypatch, path):
    """Begun with candidates that touch without friction, grown by all that penetrate and their neighbours."""
    _, _, b = problem
    likely = np.arange(M) % 2 == 0
    few = followed(watched(problem, start=likely), b, path)
    crowd(monkeypatch)
    many = followed(watched(problem, start=likely), b, path)
    motion = np.abs(b[:, 1] - b[:, 0]).max()
    assert many.converged.all() and many.displacement[:, ::3].min() > -2 * PENETRATION * REACH
    apart = np.abs(many.displacement - few.displacement).max(axis=1)
    assert apart.max() < 1e-2 * motion and np.sort(apart)[-3] < 1e-4 * motion
    alone = followed(watched(problem, start=likely), b[[3]], path)
    np.testing.assert_allclose(alone.displacement[0], many.displacement[3], atol=1e-9)


def test_the_initial_guess_for_many_candidates_is_frictionless(problem, monkeypatch):
    S, _, b = problem
    crowd(monkeypatch)
    smooth = ContactSolver(S, 0.0, "frictionless").solve(b[:, 1]).force
    guess = watched(problem, screening=True)
    found = guess.solve(b[:, 1])
    np.testing.assert_allclose(found.force, smooth, atol=1e-5 * smooth.max())
    assert (guess.carried == (smooth[:, ::3] > 1e-9 * smooth.max()).any(axis=0)).all()
