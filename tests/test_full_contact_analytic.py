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

from fem_reference.full import equilibrium
from fem_reference.full.equilibrium import OPEN, SLIP, STICK, Equilibrium, NoConvergence, Parts
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
    law = contact_law(0.0, [gap], E * t, 1)
    state, _ = system.newton(rest(system), P * down.toarray().ravel(), np.zeros(system.b), law)
    deflection = (down @ state.u)[0]
    assert deflection == pytest.approx(min(share, 1.0) * gap, rel=2e-3)
    assert state.force[0, 0] == pytest.approx(max(0.0, P - stiffness * gap), rel=2e-3)


def dragged():
    """A strip pressed on feet and dragged along them, loads that change, contacts that open, stick and slip: each
    load's solution and iterations by the whole system, and its solution, states and iterations by the condensed one."""
    shell = strip(100.0, 10.0, 5.0, 10.0)
    x = shell.surface.points[:, 0]
    feet = np.flatnonzero((x > 30) & (x % 20 == 0))
    tip = np.flatnonzero(x == 100.0)
    C = interleave(*(vertex_rows(shell, feet, axis, side=-1) for axis in ((0, 0, 1), (1, 0, 0), (0, 1, 0))))
    push, lift = (vertex_rows(shell, tip, axis).mean(axis=0).A1 for axis in ((1.0, 0.3, 0), (0, 0, 1.0)))
    law = contact_law(1.0, np.full(len(feet), 0.01), 5 * E, 3, penalty=1e3)
    way = [-400 * lift, 2000 * push - 40 * lift, 5000 * push - 60 * lift, -5000 * push - 20 * lift, 5 * lift]
    held = clamped(shell, np.flatnonzero(x == 0))
    system = Equilibrium(Parts([shell], MPI.COMM_SELF), held, C, 3, held=True)
    state, found = rest(system), []
    for p in way:
        condensed = system.condensed(state.force, p, np.zeros(system.b), law)
        state, history = system.newton(state, p, np.zeros(system.b), law)
        found.append((state, history, *condensed))
    return found


def test_the_condensed_system_has_the_solution_of_the_full_one():
    """Each load from where the one before has left the contacts."""
    seen = set()
    for state, iterations, condensed, states, found in dragged():
        assert np.abs(condensed.stacked - state.stacked).max() < 1e-8 * np.abs(state.stacked).max()
        assert np.abs(condensed.u - state.u).max() < 1e-8 * np.abs(state.u).max()
        counts = [(one.open, one.stick, one.slip) for one in (iterations[-1], found[-1])]
        assert counts[0] == counts[1] == tuple(int((states == s).sum()) for s in (OPEN, STICK, SLIP))
        assert found[-1].residual <= 1e-10
        seen |= {name for name in ("open", "stick", "slip") if getattr(iterations[-1], name)}
    assert seen == {"open", "stick", "slip"}


@pytest.mark.parametrize("spoilt", ["none", "none that hold", "no numbers"])
def test_a_result_that_does_not_solve_the_full_system_is_refused(monkeypatch, spoilt):
    """Forces that were not found, that leave the contacts penetrating, or are none."""
    given = {"none": None, "none that hold": 0.0, "no numbers": np.nan}[spoilt]
    forces = lambda S, δ, at, law, start: (None if given is None else np.full_like(start, given), [])
    monkeypatch.setattr(equilibrium, "contact_forces", forces)
    with pytest.raises(NoConvergence):
        dragged()


def block_on_feet():
    """A stiff plate on feet at its corners, dragged at its sole.

    x points up the slope. The fixture lies below: the block is the second body, n = +z.
    """
    shell = strip(20.0, 20.0, 5.0, 5.0)
    points = shell.surface.points
    feet = [np.linalg.norm(points - p, axis=1).argmin() for p in ((0, 0, 0), (20, 0, 0), (0, 20, 0), (20, 20, 0))]
    held = vstack([vertex_rows(shell, feet[:1], (1, 0, 0), side=-1), vertex_rows(shell, feet[:2], (0, 1, 0), side=-1)])
    C = interleave(*(vertex_rows(shell, feet, axis, side=-1) for axis in ((0, 0, 1), (1, 0, 0), (0, 1, 0))))
    return shell, Equilibrium(Parts([shell], MPI.COMM_SELF), held, C, 3), C, len(feet)


def test_block_on_an_incline():
    """A block dragged along the slope: R = W (sin α + μ cos α) up, W (sin α − μ cos α) down, W sin α ± friction across
    it.

    The block is a stiff plate; the incline is turned into the plane and gravity with it. It reverses, so the slip of
    the second motion counts from where the first one left the block.
    """
    μ, α, W = 0.3, np.radians(40.0), 50.0
    shell, system, C, feet = block_on_feet()
    p = shell.gravity(W / (shell.surface.areas.sum() * 5.0) * np.array([-np.sin(α), 0, -np.cos(α)]), 1.0)
    # Nothing but contact carries the block, so all forces follow from its balance, whatever the penalty.
    law = contact_law(μ, np.full(feet, -1e-9), E * 5.0, 3, penalty=0.01)
    smooth = replace(law, friction=ContactFriction.constant(np.zeros(feet)))
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
    # Across, friction opposes the motion along y alone.
    assert f[:, 2].sum() == pytest.approx(-μ * W * np.cos(α), rel=1e-4)


def test_block_on_feet_that_yield():
    """``R = Σ min(x/c, μ f_n)``; on the way back the feet unload first, from where their sliders came to stand."""
    μ, W, c = 0.3, 50.0, 0.01
    shell, system, C, feet = block_on_feet()
    p = shell.gravity(W / (shell.surface.areas.sum() * 5.0) * np.array([0, 0, -1.0]), 1.0)
    law = contact_law(μ, np.full(feet, -1e-9), E * 5.0, 3, penalty=0.01)
    law = replace(law, friction=replace(law.friction, compliance=np.full(feet, c)))
    state, anchor = rest(system), np.zeros((feet, 3))
    for x, pull in ((0.02, 8.0), (0.06, 15.0), (0.04, 7.0), (-0.03, -15.0)):
        law = replace(law, anchor=anchor)
        state, _ = system.newton(state, p, np.array([x, 0, 0]), law)
        δ = (C @ state.u).reshape(-1, 3)
        assert state.reaction[0] == pytest.approx(pull, abs=5e-3 * μ * W), x  # the plate gives way and rocks a little
        anchor = np.column_stack([np.zeros(feet), law.friction.slider(δ, state.force)])


def test_block_whose_friction_depends_on_its_weight():
    """Four feet carry W/4 each: ``R = 4 g(W/4)``, ``g(f) = 0.3 f (f/5)^(-0.4)``."""
    shell, system, C, feet = block_on_feet()
    law = contact_law(0.9, np.full(feet, -1e-9), E * 5.0, 3, penalty=0.01)
    g = lambda f: (0.3 * f**0.6 * 5**0.4, 0.18 * (np.maximum(f, 1e-9) / 5) ** -0.4)
    law = replace(law, friction=replace(law.friction, bounds=((np.arange(feet), g),)))
    state = rest(system)
    for W in (10.0, 40.0, 160.0):
        p = shell.gravity(W / (shell.surface.areas.sum() * 5.0) * np.array([0, 0, -1.0]), 1.0)
        state, _ = system.newton(state, p, np.array([1.0, 0, 0]), law)
        assert (law.state((C @ state.u).reshape(-1, 3)) == SLIP).all()
        # The pull at the sole tilts the block, so feet bear W/4 within a few per cent, and g is nearly straight there.
        assert state.reaction[0] == pytest.approx(4 * 0.3 * (W / 4) ** 0.6 * 5**0.4, rel=1e-3)
        np.testing.assert_allclose(-state.force[:, 1], g(state.force[:, 0])[0], rtol=1e-6)


def test_leaves_slip_and_keep_their_slip_when_unloaded():
    """Goodman and Klumpp (1956): δ = 2 L³ (P − μ p b h)/(E b h³) above the slip load P = 4/3 μ p b h. Half unloaded,
    the leaves stick at once: the deflection falls back along the slope of the solid beam, L³/(2 E b h³)."""
    L, b, h, p, μ = 100.0, 5.0, 2.0, 1.0, 0.3
    deflection, P = bend_leaves(L, b, h, p), 2 * 4 / 3 * μ * p * b * h
    top, state, anchor, states = deflection(P, μ)
    assert (states == SLIP).mean() > 0.9
    assert top == pytest.approx(2 * L**3 * (P - μ * p * b * h) / (E * b * h**3), rel=0.01)
    less, _, _, states = deflection(0.5 * P, μ, state, anchor)
    assert (states == STICK).mean() > 0.5
    assert top - less == pytest.approx(0.5 * P * L**3 / (2 * E * b * h**3), rel=0.02)
