"""Contact cases whose answer is known in closed form; no code of the reduced model takes part.

Strips have ν = 0, so that plates bend as beams do. A penalty of 1e8 sheet stiffnesses leaves no error that shows: the
forces are unknowns of their own, so the condition of the system does not suffer.
"""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import csr_matrix, hstack, vstack

from fem_reference.full.equilibrium import SLIP, STICK, ContactLaw, Equilibrium, Parts, State
from fem_reference.shell.part import ShellPart
from mic.compliance.functional import Functionals
from mic.geometry.structured import extrude
from mic.geometry.surface import Patch, Surface

E = 210e3  # MPa


def strip(length, width, thickness, size, z=0.0, start=0.0):
    return ShellPart(Surface(*extrude([(0, z), (width, z)], start, length, size)), thickness, E, 0.0)


def vertex_rows(shell, vertices, direction, side=0, rotation=False):
    """(v, ndof) readings of vertices, on the surface `side` t/2 off the mid-surface."""
    first = np.array([np.argmax((shell.surface.triangles == v).any(axis=1)) for v in vertices])
    corner = np.argmax(shell.surface.triangles[first] == np.asarray(vertices)[:, None], axis=1)
    patches = tuple(Patch(np.array([t]), np.eye(3)[[c]], np.ones(1)) for t, c in zip(first, corner))
    n = len(patches)
    return shell.functional_matrix(
        Functionals(
            patches,
            np.arange(n),
            np.tile(np.asarray(direction, float), (n, 1)),
            np.full(n, rotation),
            np.full(n, float(side)),
            ("",) * n,
        )
    )


def clamped(shell, vertices):
    return vstack(
        [vertex_rows(shell, vertices, axis, rotation=rotation) for rotation in (False, True) for axis in np.eye(3)]
    )


def interleave(*rows):
    """Rows of each contact one after the other: n, t1, t2."""
    stacked = vstack(rows, format="csr")
    m = rows[0].shape[0]
    return stacked[np.arange(len(rows) * m).reshape(len(rows), m).T.ravel()]


def contact_law(friction, gap, stiffness, dimension, penalty=1e8):
    m = len(gap)
    zero = np.zeros((m, dimension))
    return ContactLaw(
        np.full(m, friction), np.asarray(gap, float), zero, zero, np.full(m, penalty * stiffness), np.full(m, stiffness)
    )


def rest(system):
    return State(np.zeros(system.N), np.zeros(system.b), np.zeros((system.m, system.d)))


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
    state, _ = system.newton(rest(system), p, np.zeros(3), replace(law, friction=np.zeros(len(feet))))
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


def bend_leaves(L, b, h, p, pressed_from=0.0):
    """Layered cantilever: two leaves of depth h, pressed together by p from a distance to the root on.

    Returns ``deflection(P, friction, state, anchor)`` under the tip load P, upwards, half on each leaf.
    """
    shells = [strip(L, b, h, 2.5, z) for z in (0.0, h)]
    x = shells[0].surface.points[:, 0]
    root, tip, free = np.flatnonzero(x == 0), np.flatnonzero(x == L), np.flatnonzero(x > 0)
    parts = Parts(shells, MPI.COMM_SELF)
    held = clamped(shells[0], root)
    B = vstack([hstack([held, csr_matrix(held.shape)]), hstack([csr_matrix(held.shape), held])], format="csr")
    axes = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
    C = interleave(
        *(
            hstack([-vertex_rows(shells[0], free, axis, side=1), vertex_rows(shells[1], free, axis, side=-1)])
            for axis in axes
        )
    )
    system = Equilibrium(parts, B, C, 3)
    area = np.zeros(len(x))
    pressed = shells[0].surface.corners[:, :, 0].mean(axis=1) > pressed_from
    np.add.at(area, shells[0].surface.triangles[pressed], shells[0].surface.areas[pressed, None] / 3)
    press = np.concatenate(
        [vertex_rows(shell, np.arange(len(x)), (0, 0, sign)).T @ (p * area) for shell, sign in zip(shells, (1, -1))]
    )
    pull = np.concatenate([vertex_rows(shell, tip, (0, 0, 1)).mean(axis=0).A1 / 2 for shell in shells])

    def deflection(P, friction, state=None, anchor=None):
        law = contact_law(friction, np.full(len(free), -1e-9), E * h, 3)
        if anchor is not None:
            law = replace(law, anchor=anchor)
        state, _ = system.newton(state or rest(system), press + P * pull, np.zeros(system.b), law)
        δ = (C @ state.u).reshape(-1, 3)
        return float(pull @ state.u), state, δ, law.state(δ)

    return deflection


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
