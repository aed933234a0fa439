"""Contact cases whose answer is known in closed form; no code of the reduced model takes part.

Strips have ν = 0, so that plates bend as beams do. A penalty of 1e8 sheet stiffnesses leaves no error that shows: the
forces are unknowns of their own, so the condition of the system does not suffer.
"""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import csr_matrix, vstack
from support.strips import E, bend_leaves, clamped, contact_law, interleave, rest, strip, vertex_rows

from fem_reference.full.equilibrium import SLIP, STICK, Equilibrium, Parts
from fem_reference.full.friction import ContactFriction

pytestmark = pytest.mark.fem


@pytest.mark.parametrize("share", [0.5, 3.0])
def test_strip_pressed_on_a_stop(share):
    """Cantilever with a stop at distance g under its tip: the tip load P bends it freely until w = P L³/3EI = g;
    beyond, the stop carries R = P − 3EI g/L³."""
    L, b, t, gap = 100.0, 10.0, 1.0, 0.8
    shell = strip(L, b, t, 5.0)
    x = shell.surface.points[:, 0]
    tip = np.flatnonzero(x == L)
    down = csr_matrix(vertex_rows(shell, tip, (0, 0, -1)).mean(axis=0))
    system = Equilibrium(Parts([shell], MPI.COMM_SELF), clamped(shell, np.flatnonzero(x == 0)), -down, 1)
    stiffness = 3 * E * b * t**3 / 12 / L**3
    P = share * stiffness * gap
    state, _ = system.newton(
        rest(system), P * down.toarray().ravel(), np.zeros(system.b), contact_law(0.0, [gap], E * t, 1)
    )
    deflection = (down @ state.u)[0]
    assert deflection == pytest.approx(min(share, 1.0) * gap, rel=2e-3)
    assert state.force[0, 0] == pytest.approx(max(0.0, P - stiffness * gap), rel=2e-3)


@pytest.mark.parametrize("angle", [10.0, 40.0])
def test_block_on_an_incline(angle):
    """A block dragged along the slope: R = W (sin α + μ cos α) up, W (sin α − μ cos α) down, W sin α ± friction across
    it.

    The block is a stiff plate; the incline is turned into the plane and gravity with it. It reverses, so the slip of
    the second motion counts from where the first one left the block.
    """
    μ, α, W = 0.3, np.radians(angle), 50.0
    shell = strip(20.0, 20.0, 5.0, 5.0)
    points = shell.surface.points
    feet = [
        int(np.argmin(np.linalg.norm(points - p, axis=1))) for p in ((0, 0, 0), (20, 0, 0), (0, 20, 0), (20, 20, 0))
    ]
    # x points up the slope. The fixture lies below: the block is the second body, n = +z; it is dragged at its sole.
    held = vstack([vertex_rows(shell, feet[:1], (1, 0, 0), side=-1), vertex_rows(shell, feet[:2], (0, 1, 0), side=-1)])
    C = interleave(*(vertex_rows(shell, feet, axis, side=-1) for axis in ((0, 0, 1), (1, 0, 0), (0, 1, 0))))
    system = Equilibrium(Parts([shell], MPI.COMM_SELF), held, C, 3)
    p = shell.gravity(W / (shell.surface.areas.sum() * 5.0) * np.array([-np.sin(α), 0, -np.cos(α)]), 1.0)
    # Nothing but contact carries the block, so all forces follow from its balance, whatever the penalty.
    law = contact_law(μ, np.full(len(feet), -1e-9), E * 5.0, 3, penalty=0.01)
    smooth = replace(law, friction=ContactFriction.constant(np.zeros(len(feet))))
    state, _ = system.newton(rest(system), p, np.zeros(3), smooth)
    for x, y, reaction in (
        (1.0, 0.0, W * (np.sin(α) + μ * np.cos(α))),
        (-1.0, 0.0, W * (np.sin(α) - μ * np.cos(α))),
        (-1.0, 1.0, W * np.sin(α)),
    ):
        state, _ = system.newton(state, p, np.array([x, y, y]), law)
        f = state.force
        assert (law.state((C @ state.u).reshape(-1, 3))[f[:, 0] > 0] == SLIP).all()
        assert f[:, 0].sum() == pytest.approx(W * np.cos(α), rel=1e-9)
        assert state.reaction[0] == pytest.approx(reaction, rel=1e-3)  # the soft contact lets the block rock a little
        law = replace(law, anchor=(C @ state.u).reshape(-1, 3))
    assert f[:, 2].sum() == pytest.approx(
        -μ * W * np.cos(α), rel=1e-4
    )  # across: friction opposes the motion along y alone


@pytest.fixture(scope="module")
def leaves():
    L, b, h, p = 100.0, 5.0, 2.0, 1.0
    return bend_leaves(L, b, h, p), L, b, h, p


def test_leaves_that_stick_bend_as_one(leaves):
    """Goodman and Klumpp (1956): δ = P L³/(2 E b h³) below the slip load P = 4/3 μ p b h."""
    deflection, L, b, h, p = leaves
    μ = 0.3
    P = 0.7 * 4 / 3 * μ * p * b * h
    δ, _, _, state = deflection(P, μ)
    assert (state == STICK).mean() > 0.9  # at the root and the tip the pressure is not uniform
    assert δ == pytest.approx(P * L**3 / (2 * E * b * h**3), rel=0.01)


def test_leaves_that_slip(leaves):
    """δ = 2 L³ (P − μ p b h)/(E b h³) above the slip load; without friction the leaves bend on their own."""
    deflection, L, b, h, p = leaves
    for μ, factor in ((0.3, 2.0), (0.1, 4.0)):
        P = factor * 4 / 3 * μ * p * b * h
        δ, _, _, state = deflection(P, μ)
        assert (state == SLIP).mean() > 0.9
        assert δ == pytest.approx(2 * L**3 * (P - μ * p * b * h) / (E * b * h**3), rel=0.01)
    assert deflection(P, 0.0)[0] == pytest.approx(2 * L**3 * P / (E * b * h**3), rel=0.01)


def test_leaves_keep_their_slip_when_unloaded(leaves):
    """Unloading from P sticks at once: the deflection falls back along the slope of the solid beam."""
    deflection, L, b, h, p = leaves
    μ = 0.3
    P = 2 * 4 / 3 * μ * p * b * h
    top, state, anchor, _ = deflection(P, μ)
    less, *_ = deflection(0.5 * P, μ, state, anchor)
    assert top - less == pytest.approx(0.5 * P * L**3 / (2 * E * b * h**3), rel=0.02)
