"""Load paths with known answers: piecewise linear ones to rounding, curved ones to the order of the method."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from mic.contact import ContactSolver, tangent
from mic.contact.native import slider_lag
from mic.contact.native.kept_factors import MANY, add_responses, changed_rates, factors_of
from mic.contact.path import Followed, Increments
from mic.contact.states import OPEN, SLIP, STICK

MU = 0.5


def follow(loads, path=None, S=None, mu=MU, anchor=None, law="coulomb", threads=1):
    """One sample along straight loads (k + 1, 3m); slip is measured from the origin."""
    loads = np.asarray(loads, dtype=float)
    S = np.eye(loads.shape[1]) if S is None else S
    m = len(S) // 3
    anchor = np.zeros((1, m, 2)) if anchor is None else anchor
    return ContactSolver(S, mu, law=law, threads=threads).follow(loads[None], anchor=anchor, path=path)


def one_increment(S, loads, **start):
    """Samples of loads (n, 2, m, 3), slip measured from the origin if nothing else is given."""
    n, _, m, _ = loads.shape
    start = start or {"anchor": np.zeros((n, m, 2))}
    return ContactSolver(S, 0.3).follow(loads.reshape(n, 2, -1), **start, path=Increments(1))


def tractrix(path):
    """Error of a slider of normal force 1 and compliance 1, dragged across its string: tan(φ/2) falls by e^(-v/l)."""
    start, drag, string = 1.2, 1.0, MU
    end = 2 * np.arctan(np.tan(start / 2) * np.exp(-drag / string))
    first = np.array([-1.0, string * np.cos(start), string * np.sin(start)])
    found = follow([first, first + [0, drag, 0]], path)
    exact = np.array([drag + string * (np.cos(start) - np.cos(end)), string * (np.sin(start) - np.sin(end))])
    return np.linalg.norm(found.anchor[0, 0] - exact) / np.linalg.norm(exact), found, np.linalg.norm(exact)


def test_a_slider_dragged_round_a_corner_converges_with_second_order():
    errors = [tractrix(Followed(steps=steps))[0] for steps in (8, 16, 32, 64, 128)]
    assert all(coarse > 3.5 * fine for coarse, fine in zip(errors, errors[1:]))


def test_increments_converge_with_first_order():
    errors = [tractrix(Increments(steps))[0] for steps in (16, 32, 64)]
    assert all(1.8 < coarse / fine < 2.2 for coarse, fine in zip(errors, errors[1:]))


def test_the_error_of_a_followed_slider_is_below_a_thousandth_and_its_estimate():
    error, found, size = tractrix(None)
    assert error < 1e-3
    assert error * size < found.trace.error[0] < 0.1


def test_a_contact_that_closes_while_moving_slips_from_its_touching_point():
    """It touches at s = 0.37, moving along t1 by 0.9 over the path: μ f_n ends at 0.5 · 0.63."""
    found = follow([[0.37, 0, 0], [-0.63, 0.9, 0]])
    slip = 0.9 * 0.63 - MU * 0.63
    np.testing.assert_allclose(found.anchor[0, 0], [0.9 - MU * 0.63, 0], atol=1e-12)
    np.testing.assert_allclose(found.trace.slip[0, 0], [slip, 0], atol=1e-12)
    np.testing.assert_allclose(found.trace.work[0, 0], 0.5 * MU * 0.63 * slip, atol=1e-12)  # the force grows from 0
    np.testing.assert_allclose(found.trace.share[0, 0], [0.37, 0, 0.63], atol=1e-12)


def test_a_contact_that_closes_and_sticks_stays_at_its_touching_point():
    found = follow([[0.37, 0, 0], [-0.63, 0.4, 0]])
    np.testing.assert_allclose(found.anchor[0, 0], [0.37 * 0.4, 0], atol=1e-12)
    np.testing.assert_allclose(found.trace.slip[0, 0], 0, atol=1e-12)
    assert found.trace.work[0, 0] == pytest.approx(0, abs=1e-12)


def rounded(a, random):
    return a * (1 + 1e-14 * random.normal(size=a.shape))


def test_an_increment_does_not_depend_on_rounding_of_its_inputs():
    """At its start most contacts that press stand on their cone, and one of each sample touches without force."""
    random = np.random.default_rng(0)
    m, n = 12, 20
    A = random.normal(size=(3 * m, 6))
    S, loads = np.eye(3 * m) + A @ A.T / 30, np.zeros((n, 3, m, 3))
    loads[:, 0, :, 0] = 0.1
    loads[:, 1] = random.normal([-1, 0, 0], [0.2, 1, 1], (n, m, 3))
    loads[:, 2] = loads[:, 1] + random.normal(0, [0, 0.5, 0.5], (n, m, 3))
    loads[:, 2, :, 0] += random.choice([2.0, 0.3, -0.3], (n, m))
    loads[:, 1, 0, 0] = 10.0
    loads[:, 1, 0, 0] -= one_increment(S, loads[:, :2]).displacement[:, 0]
    loads[:, 2, 0] = loads[:, 1, 0] + [-1.0, 1.0, 0.0]
    before = one_increment(S, loads[:, :2])
    found = one_increment(S, loads[:, 1:], force=before.force, anchor=before.anchor).trace
    upper, force = np.triu(rounded(S, random)), before.force.copy()
    force[:, 0] = np.where(force[:, 0] > 0, 0.0, 1e-15)
    again = one_increment(
        upper + np.triu(upper, 1).T,
        rounded(loads[:, 1:], random),
        force=rounded(force, random),
        anchor=rounded(before.anchor, random),
    ).trace
    moved = np.abs(found.slip).max(axis=(0, 2))
    assert moved.max() > 1 and moved[0] > 0.1
    for name in ("slip", "length", "work", "share"):
        np.testing.assert_allclose(getattr(again, name), getattr(found, name), rtol=0, atol=1e-9, err_msg=name)


def test_a_reversed_load_gives_the_hysteresis_of_a_single_slider():
    """Drag by 2, then back by 2: the string is taut both ways, so that the slider goes 1.5 forth and 1 back."""
    found = follow([[-1, 0, 0], [-1, 2, 0], [-1, 0, 0]])
    np.testing.assert_allclose(found.anchor[0, 0], [0.5, 0], atol=1e-10)
    assert found.trace.length[0, 0] == pytest.approx(2.5, abs=1e-9)
    assert found.trace.work[0, 0] == pytest.approx(MU * 2.5, abs=1e-9)
    np.testing.assert_allclose(found.force[0], [1, MU, 0], atol=1e-10)


def test_the_weaker_of_two_contacts_in_series_slips_first():
    """Both are pulled through one shared spring; the second sticks until the first passes on all further load.

    S couples the tangential displacements, w1 = y1 + y2/2 + d, w2 = y1/2 + y2 + d/2, with bounds 0.2 and 0.5. The first
    slips from d = 0.2 on, from where the second's force grows by 1/2 of the drag alone.
    """
    S = np.eye(6)
    S[1, 4] = S[4, 1] = 0.5
    loads = [[-0.4, 0, 0, -1, 0, 0], [-0.4, 2, 0, -1, 1, 0]]
    found = follow(loads, S=S)
    # Until d = 0.2 both stick: y = -(d, 0). Then y1 = -0.2 and w2 = 0: y2 = 0.1 - d/2, at its bound at d = 1.2.
    # Then y2 = -0.5 and both slip: w1 = d - 0.45, w2 = d/2 - 0.6.
    np.testing.assert_allclose(found.force[0, [1, 4]], [-0.2, -0.5], atol=1e-9)
    np.testing.assert_allclose(found.anchor[0, :, 0], [2 - 0.45, 1 - 0.6], atol=1e-9)


@pytest.mark.parametrize("path", [Followed(steps=1), None], ids=["one step", "default"])
def test_a_sticking_contact_holds_the_body_until_a_second_one_closes(path):
    """Both stick, of 0.01 each by itself and 1 together: the first at 0.2; until 0.6 the body moves on by 0.01/1.01."""
    S = np.diag([1, 0.01, 0.01] * 2)
    for c in (1, 2):
        S[c::3, c::3] += 1.0
    found = follow([[0.2, 0, 0, 0.6, 0, 0], [-0.8, 0.05, 0, -0.4, 0.05, 0]], path, S, mu=5.0)
    np.testing.assert_allclose(found.anchor[0, :, 0], 0.05 * np.array([0.2, 0.2 + 0.4 * 0.01 / 1.01]), atol=1e-12)
    assert found.trace.factorisations[0] < 10


def test_a_sliding_contact_that_opens_slips_as_on_the_finest_path():
    """Its normal force depends on the direction of slip, so that no linear prediction knows when it opens."""
    S = np.array([[1, 0.3, 0.1], [0.3, 1, 0.1], [0.1, 0.1, 1]])
    loads = [[-1, 0.3, 0.35], [0.3, 2, 0.3]]
    exact = follow(loads, Followed(1e-9), S=S).trace.slip[0, 0]
    found = follow(loads, S=S).trace
    error = np.linalg.norm(found.slip[0, 0] - exact)
    assert 0 < error < 1e-3 * np.linalg.norm(exact)
    assert error < found.error[0]


def test_a_motion_below_the_tolerance_takes_one_step():
    exact = tractrix(Followed(1e-9))[1].anchor
    for floor, steps in ((2.0, 1), (0.2, 2)):
        found = tractrix(Followed(0.1, least=10 * floor))[1]  # at which forces may err by more than they are
        assert found.trace.steps[0] == steps
        assert np.linalg.norm(found.anchor - exact) < found.trace.error[0] < floor


@pytest.mark.parametrize("beside", [0, 1])
def test_contacts_that_touch_without_force_are_followed(beside):
    """Two touch as the load begins, a third closes later and takes over from one of them: what slips, since when; by
    themselves, and beside one that presses all along."""
    random = np.random.default_rng(1)
    off, moved = 0.0, 0.0
    for _ in range(50):
        A = random.normal(size=(9, 9))
        S = block_diag(A @ A.T + 0.1 * np.eye(9), np.eye(3 * beside))
        start = np.zeros(9 + 3 * beside)
        start[6], start[9:10] = random.uniform(0.05, 0.5), -1.0
        end = start.copy()
        end[[0, 3]] = -random.uniform(0.2, 1, 2)
        paths = Followed(least=0.02), Followed(1e-7, 1e-3)
        found, exact = (follow([start, end], path, S, mu=0.3).trace.slip for path in paths)
        off, moved = max(off, abs(found - exact).max()), max(moved, abs(exact).max())
    assert off < 0.02 * moved


def test_overlap_at_the_start_is_resolved_before_the_load_moves():
    """Pressed together first, the contact sticks under a drag that it could not hold while the force still grew."""
    found = follow([[-1, 0, 0], [-1, 0.4, 0]])
    np.testing.assert_allclose(found.force[0], [1, -0.4, 0], atol=1e-12)
    np.testing.assert_allclose(found.anchor[0, 0], 0, atol=1e-12)


def sheets(contacts, samples, seed):
    """Contacts like those of two sheets: smooth compliance, normal and tangential coupled, gaps, overlaps, drag."""
    rng = np.random.default_rng(seed)
    at = rng.random((contacts, 2))
    near = np.exp(-((at[:, None] - at[None]) ** 2).sum(-1) / 0.05)
    S = np.kron(near, [[1.0, 0.3, 0.1], [0.3, 1.0, 0.1], [0.1, 0.1, 1.0]]) / 1.2 + np.eye(3 * contacts) / 6
    b = np.zeros((samples, 2, contacts, 3))

    def wave():
        return np.cos(4 * rng.normal(size=(samples, 1, 2)) @ at.T + 6 * rng.random((samples, 1, 1)))[:, 0]

    b[:, 0, :, 0] = 0.6 + wave()
    b[:, 1, :, 0] = b[:, 0, :, 0] - 0.9 + 0.8 * wave()
    b[:, 1, :, 1], b[:, 1, :, 2] = 0.75 + 1.5 * wave(), 1.5 * wave()
    return ContactSolver(S, 0.3), b.reshape(samples, 2, -1)


@pytest.fixture(scope="module")
def followed_sheets():
    solver, b = sheets(30, 20, seed=5)
    return solver, b, solver.follow(b), solver.follow(b, path=Increments(512))


@pytest.mark.slow
def test_the_estimate_covers_the_error_of_nearly_every_sample(followed_sheets):
    _, _, found, fine = followed_sheets
    error = np.sqrt(((found.anchor - fine.anchor) ** 2).sum(-1).mean(1))
    assert found.converged.all() and (found.rung == "followed").all()
    assert (error <= found.trace.error).mean() >= 0.95
    motion = np.sqrt((fine.anchor**2).sum(-1).mean(1))
    assert np.median(error / motion) < 1e-2


def test_slip_and_work_of_a_followed_path_are_those_of_many_increments(followed_sheets):
    _, _, found, fine = followed_sheets
    for name in ("slip", "length", "work"):
        a, b = getattr(found.trace, name).sum(1), getattr(fine.trace, name).sum(1)
        assert np.linalg.norm(a - b) < 0.03 * np.linalg.norm(b), name
    # A contact that creeps is slip to the one and stick to the other: shares say no more than where the path went.
    assert np.abs(found.trace.share.mean(1) - fine.trace.share.mean(1)).max() < 0.1
    np.testing.assert_allclose(found.trace.share.sum(-1), 1, atol=1e-9)


def test_a_sample_does_not_depend_on_its_batch_or_on_threads(followed_sheets):
    solver, b, found, _ = followed_sheets
    alone = solver.follow(b[7:8])
    np.testing.assert_array_equal(alone.anchor[0], found.anchor[7])
    threaded = ContactSolver(solver.S, 0.3, threads=2).follow(b[:20])
    np.testing.assert_array_equal(threaded.anchor, found.anchor[:20])


def test_small_steps_of_the_associated_law_converge_to_coulombs_law():
    """Its contacts open by μ times the slip of a step, and steps may be as small as one likes: it has no path of its
    own."""
    loads = [[-1, 0, 0], [-1, 2, 0]]
    gaps = [follow(loads, Increments(count), law="associated").displacement[0, 0] for count in (1, 8, 64)]
    assert gaps[0] > 0.5 and gaps[1] < gaps[0] / 4 and gaps[2] < gaps[1] / 4


@pytest.mark.parametrize("path", [Followed(), Increments(3)], ids=["followed", "increments"])
def test_a_repeated_path_counts_all_its_factorisations(path, monkeypatch):
    solver, b = sheets(30, 2, seed=5)
    plain, find, solve, spent = solver.follow(b, path=path), solver.backend.follow, solver.solve, []

    def counted(*args, **settings):
        solution = solve(*args, **settings)
        spent.append(solution.factorisations[0])
        return solution

    monkeypatch.setattr(solver.backend, "follow", lambda *args: replace(find(*args), given_up=np.array([True, False])))
    monkeypatch.setattr(solver, "solve", counted)
    rescued, before = solver.follow(b, path=path).trace.factorisations, plain.trace.factorisations
    assert sum(spent) > 0 and before.all()
    assert rescued.tolist() == [before[0] + sum(spent), before[1]]


@pytest.mark.parametrize("lag", [tangent.lag, np.vectorize(slider_lag.lag, [float])], ids=["arrays", "compiled"])
def test_the_lag_of_a_slider_is_accurate_for_any_distance(lag):
    z = np.array([1e-6, 0.3, 3.0, 30.0])
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        np.testing.assert_allclose(lag(z), 1 / z - 1 / np.expm1(z), atol=1e-9)
        np.testing.assert_allclose(lag(-z), 1 - lag(z), rtol=1e-12)
        np.testing.assert_allclose(lag(np.array([800.0, 1e6, -1e6])), [1 / 800, 1e-6, 1 - 1e-6], rtol=1e-12)
    assert lag(np.zeros(1))[0] == 0.5


@pytest.mark.parametrize("length, force", [(25.4, 1.0), (1e-3, 1e3)])
def test_a_path_in_other_units_takes_the_same_steps(length, force):
    rng = np.random.default_rng(4)
    A = rng.normal(size=(12, 12))
    S, loads = A @ A.T + 0.1 * np.eye(12), 0.3 * rng.normal(size=(2, 12))
    loads[1, ::3] -= 1.0
    own = follow(loads, Followed(), S=S, mu=0.3)
    other = follow(length * loads, Followed(), S=length / force * S, mu=0.3)
    np.testing.assert_array_equal(other.trace.steps, own.trace.steps)
    np.testing.assert_allclose(other.force, force * own.force, rtol=1e-9, atol=1e-12 * force)
    # Rounding may decide whether Newton's method ends with the inverse of its last step or of the one before.
    np.testing.assert_allclose(other.trace.force_error, force * own.trace.force_error, rtol=0.1)


@pytest.mark.parametrize("mu, seed, mirror", [(0.0, 6, 1), (0.3, 6, 1), (0.3, 9, -1)])
def test_a_path_does_not_depend_on_the_tangential_axes_of_its_contacts(mu, seed, mirror):
    """Nor does the slip under load of contacts without friction, whose force has no direction."""
    rng, path = np.random.default_rng(seed), Followed(least=2.0)
    A = rng.normal(size=(12, 12))
    S, loads = A @ A.T + 0.1 * np.eye(12), rng.normal(size=(3, 12))
    loads[:, ::3] = [[0.1], [-1.0], [-2.0]]
    axes = (np.array([[np.cos(a), -mirror * np.sin(a)], [np.sin(a), mirror * np.cos(a)]]) for a in (0.7, 2, 3, 5))
    turn = block_diag(*(block_diag(1, plane) for plane in axes))
    own, other = follow(loads, path, S=S, mu=mu).trace, follow(loads @ turn.T, path, S=turn @ S @ turn.T, mu=mu).trace
    assert own.length.max() > 0.1 and own.steps == other.steps
    np.testing.assert_allclose(other.length, own.length, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.share, own.share, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.force_error, own.force_error, rtol=1e-6, atol=1e-12)


def test_contacts_whose_load_goes_back_the_way_it_came_open_without_slip():
    """Their forces vanish at the tip of the cone, where rounding would decide whether they slide before they open."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 6))
    S, pull = A @ A.T + 0.1 * np.eye(6), np.array([-1, 0.3, 0.1, -1.5, -0.2, 0.4])
    for _ in range(3):
        loads = np.array([0 * pull, pull, -0.7 * pull]) * (1 + 1e-13 * rng.normal(size=(3, 6)))
        found = follow(loads, Followed(least=1.0), S=S, mu=50.0)
        assert found.force[0].max() == 0.0 and found.trace.length.max() == 0.0


def test_forces_are_as_exact_as_their_estimate():
    """Sticking contacts are stiff, so exact positions may leave wrong friction.

    The error of positions is relative to the load's 2 mm.
    """
    rng = np.random.default_rng(5)
    true, estimate, size = [], [], []
    for _ in range(20):
        A = rng.normal(size=(18, 18))
        S, loads = A @ A.T + 0.01 * np.eye(18), rng.normal(size=(2, 18))
        loads[1, ::3] -= 2.0
        found, exact = (follow(loads, path, S=S, mu=0.3) for path in (Followed(least=2.0), Followed(1e-5)))
        difference = (found.force - exact.force).reshape(-1, 3)
        true.append(np.sqrt((difference**2).sum(axis=1).mean()))
        size.append(np.sqrt((exact.force**2).sum() / 6))
        estimate.append(found.trace.force_error[0])
    true, estimate, size = np.array(true), np.array(estimate), np.array(size)
    assert (true <= estimate + 1e-9 * size).mean() >= 0.95
    assert np.median(true / size) < 0.01 and np.median(estimate / size) < 0.1


def test_friction_is_exact_to_a_hundredth_of_the_largest_force_where_positions_may_err_by_more():
    """A stiff slider turns a corner within 0.01 mm; its position alone may err by 0.025 mm in a step."""
    loads = [[-0.01, 0.004, 0.0], [-0.01, 0.004, 0.01]]
    found, exact = (
        follow(loads, path, S=0.01 * np.eye(3)).force[0] for path in (Followed(least=100.0), Followed(1e-6))
    )
    assert np.linalg.norm(found - exact) < 0.01 * exact.max()


def test_a_contact_that_creeps_beside_another_takes_few_steps():
    """It breaks loose again in each step; as exact as 4096 increments."""
    solver, b = sheets(2, 30, seed=6)
    found, fine = solver.follow(b[[10]]), solver.follow(b[[10]], path=Increments(4096))
    assert found.trace.steps[0] < 100
    np.testing.assert_allclose(found.anchor, fine.anchor, atol=2e-4)
    np.testing.assert_allclose(found.force, fine.force, atol=2e-4)


@pytest.mark.parametrize("seed", [4, 11, 14])
def test_many_closed_contacts_are_followed_as_few_are(seed):
    """Ten equal pairs of sheets in one problem: many contacts have another linear algebra, and the same path."""
    copies = 10
    solver, b = sheets(24, 1, seed)
    few = solver.follow(b)
    many = ContactSolver(block_diag(*[solver.S] * copies), 0.3).follow(np.tile(b, copies))
    assert copies * (few.force[:, ::3] > 0.0).sum() > MANY and many.rung[0] == "followed"
    for name in ("force", "displacement"):
        one = getattr(few, name)
        np.testing.assert_allclose(getattr(many, name), np.tile(one, copies), atol=1e-5 * np.abs(one).max())
    for name in ("steps", "factorisations", "error", "force_error"):
        np.testing.assert_allclose(getattr(many.trace, name), getattr(few.trace, name), rtol=0.1, err_msg=name)


def test_rates_after_changes_of_many_contacts_are_those_of_their_new_equations():
    """Some of eight contacts begin to stick, to slide or open; against a dense solution of the equations."""
    rng, m, e = np.random.default_rng(2), 8, np.array([0.6, 0.8])
    root = rng.normal(size=(3 * m, 3 * m))
    W, rate = root @ root.T / m, rng.normal(size=3 * m)
    nothing, unity = np.zeros((3, 3)), np.eye(3)
    across = np.array([-e[1], e[0]])
    slides = np.array([[0, 0, 0], [-0.3, *e], [0, *(0.2 * across)]]), np.array([[1, 0, 0], [0, 0, 0], [0, *across]])
    equations = {OPEN: (unity, nothing), STICK: (nothing, unity), SLIP: slides}

    def of(state):
        return [np.array([equations[k][part] for k in state], dtype=float) for part in (0, 1)]

    state = np.array([SLIP, STICK, OPEN, SLIP, SLIP, STICK, SLIP, STICK])
    kept = factors_of(W, *of(state), state, True)
    dy, dw = np.empty(3 * m), np.empty(3 * m)
    for k, new in ((None, None), (0, STICK), (1, SLIP), (3, OPEN), (0, SLIP), (7, OPEN)):
        if k is not None:
            add_responses(W, kept, k)
            state[k] = new
        A, B = of(state)
        changed_rates(W, kept, A, B, rate, dy, dw)
        exact = np.linalg.solve(block_diag(*A) + block_diag(*B) @ W, -block_diag(*B) @ rate)
        np.testing.assert_allclose(dy, exact, atol=1e-8 * np.abs(exact).max())
        np.testing.assert_allclose(dw, W @ exact + rate, atol=1e-8 * np.abs(dw).max())
