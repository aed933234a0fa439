"""The full solve's path on one contact of compliance 1, whose backward Euler step and whose path are known in closed
form."""

import numpy as np
import pytest

from fem_reference.full.equilibrium import NoConvergence
from fem_reference.full.path import Point, extrapolated, increments
from mic.contact.states import OPEN, SLIP, STICK

pytestmark = pytest.mark.fem

MU = 0.5


def contact(start, end, longest=1.0):
    """``solve`` of one contact under the load b from `start` to `end`, and where it begins; slip from the origin.

    Steps longer than `longest` find no solution.
    """

    def at(s, anchor):
        b = np.add(start, s * np.subtract(end, start))
        normal = max(0.0, -b[0])
        pull = anchor - b[1:]
        size = np.linalg.norm(pull)
        force = pull if size <= MU * normal else MU * normal * pull / size
        state = OPEN if normal == 0 else STICK if size <= MU * normal * (1 + 1e-12) else SLIP
        f = np.array([[normal, *force]])
        return Point(s, (b[1:] + force)[None], np.array([b[0] + normal]), f, np.array([state]), f.ravel())

    def solve(point, s, anchor):
        if s - point.share > longest:
            raise NoConvergence("refused by the test")
        return at(s, anchor[0])

    return solve, at(0.0, np.zeros(2))


def round_a_corner():
    """A spring of length l pulls at an angle; its end goes on a way of 1: ``tan(φ/2) = tan(φ₀/2) exp(−1/l)``."""
    angle, spring = 1.2, MU * np.array([np.cos(1.2), np.sin(1.2)])
    last = 2 * np.arctan(np.tan(angle / 2) * np.exp(-1 / MU))
    end = np.array([1 + spring[0] - MU * np.cos(last), spring[1] - MU * np.sin(last)])
    return [-1, *spring], [-1, 1 + spring[0], spring[1]], end


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
def test_a_slider_is_followed_round_a_corner(tolerance):
    start, end, exact = round_a_corner()
    point, trace = extrapolated(*contact(start, end), tolerance)
    error = np.abs(point.position[0] - exact).max()
    assert error < 10 * tolerance and error < trace.error
    assert trace.work[0] == pytest.approx(MU * trace.length[0], rel=10 * tolerance)
    assert np.abs(trace.slip[0] - exact).max() == pytest.approx(error, rel=1e-6)


def test_increments_close_in_on_it_at_first_order():
    start, end, exact = round_a_corner()
    error = [np.abs(increments(*contact(start, end), n)[0].position[0] - exact).max() for n in (32, 64, 128)]
    assert error[0] / error[1] == pytest.approx(2, rel=0.05) and error[1] / error[2] == pytest.approx(2, rel=0.05)
    assert error[2] > 1e-3


def test_a_contact_that_closes_while_it_moves_sticks_where_it_touched():
    point, trace = extrapolated(*contact([0.37, 0, 0], [-0.63, 0.4, 0]), 1e-8)
    assert point.position[0] == pytest.approx([0.37 * 0.4, 0], abs=1e-8)
    assert trace.share[0] == pytest.approx([0.37, 0.63, 0], abs=1e-6) and trace.length[0] < 1e-8


def test_a_contact_that_opens_while_it_slides_is_counted_until_then():
    """Its friction falls with the load, so the spring that pulls it shortens: u = b − μ f_n, while f_n = 1 − 1.25 s."""
    solve, start = contact([-1, MU, 0], [0.25, MU + 1, 0])
    point, trace = extrapolated(solve, start, 1e-8)
    assert trace.slip[0] == pytest.approx([0.8 + MU, 0], abs=1e-7)
    assert trace.share[0] == pytest.approx([0.2, 0, 0.8], abs=1e-6)
    assert trace.work[0] == pytest.approx(0.5 * MU * (0.8 + MU), rel=1e-6)  # the force falls evenly
    assert point.position[0] == pytest.approx([MU + 1, 0])


def test_steps_that_find_no_solution_are_shortened():
    start, end, exact = round_a_corner()
    point, _ = extrapolated(*contact(start, end, longest=0.01), 1e-3)
    assert np.abs(point.position[0] - exact).max() < 1e-3
    with pytest.raises(NoConvergence, match="refused"):
        extrapolated(*contact(start, end, longest=0.0), 1e-3)


def beside(one, other, noise):
    """Two contacts that know nothing of each other, as one problem; positions carry some noise, mm."""

    def stacked(a, b):
        place = np.concatenate([a.position, b.position])
        rest = (np.concatenate([getattr(a, name), getattr(b, name)]) for name in ("gap", "force", "state", "unknowns"))
        return Point(a.share, place + noise.normal(scale=1e-14, size=place.shape), *rest)

    def solve(point, s, anchor):
        return stacked(one[0](point, s, anchor), other[0](point, s, anchor[1:]))

    return solve, stacked(one[1], other[1])


def test_rounding_in_a_step_that_a_closing_cuts_short_decides_nothing():
    """The step up to the closing moves nothing but straight on: what its error estimate holds is rounding."""
    start, end, _ = round_a_corner()
    ends, steps = [], set()
    for seed in range(4):
        closing, corner = contact([1e-6, 0, 0], [-1, 0, 0]), contact(start, end)
        point, trace = extrapolated(*beside(closing, corner, np.random.default_rng(seed)), 1e-3)
        ends.append(point.position)
        steps.add(trace.steps)
    assert len(steps) == 1 and np.ptp(ends, axis=0).max() < 1e-10
