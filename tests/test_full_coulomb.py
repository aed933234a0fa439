"""Contact forces on a condensed system, and that system itself, against what is known otherwise."""

from unittest.mock import MagicMock

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import vstack
from support.strips import clamped, contact_law, strip, vertex_rows

import mic
from fem_reference.full import condensation, coulomb
from fem_reference.full.condensation import Condensation
from fem_reference.full.coulomb import contact_forces
from fem_reference.full.equilibrium import Parts
from fem_reference.full.model import FullModel
from fem_reference.shell import factorisation
from mic import examples
from mic.model.assembly import assemble
from mic.statistics.draw import draw
from verification.scenes import with_path

pytestmark = pytest.mark.fem

SEEDS = range(12)


def sheets(m, seed, softest=1e6):
    """(3m, 3m) a compliance that yields so many times as much in some ways as in others, and what contacts read."""
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.normal(size=(3 * m, 3 * m)))
    return (turned * np.geomspace(1 / softest, 1, 3 * m)) @ turned.T, rng.normal(size=(m, 3))


def solved(S, δ, friction, start=None):
    """Forces under Coulomb's law itself: no contact yields."""
    none = np.zeros_like(δ)
    law = contact_law(friction, np.zeros(len(δ)), 1e5, 3, penalty=np.inf)
    return contact_forces(S, δ, none, law, none if start is None else start)[0]


def breach(S, δ, f, friction):
    """Largest breach of Coulomb's law by forces (m, 3), N and mm alike."""
    w = δ + (S @ f.ravel()).reshape(f.shape)
    bound, size, slip = friction * f[:, 0], np.linalg.norm(f[:, 1:], axis=1), np.linalg.norm(w[:, 1:], axis=1)
    against = (f[:, 1:] * w[:, 1:]).sum(axis=1) + bound * slip  # vanishes where the whole bound opposes the slip
    parts = (-f[:, 0], -w[:, 0], np.abs(f[:, 0] * w[:, 0]), size - bound, np.abs(against))
    return max(part.max() for part in parts)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.8])
def test_forces_obey_coulombs_law(friction):
    for seed in SEEDS[:4]:
        S, δ = sheets(20, seed)
        f = solved(S, δ, friction)
        assert breach(S, δ, f, friction) < 1e-9 * np.abs(f).max()
        assert f[:, 0].max() > 0 and (f[:, 0] == 0).any()
        if friction:
            assert breach(S, δ, f, 1.1 * friction) > 1e-6  # the law of another coefficient is broken


def test_proximal_points_solve_what_newtons_method_does_not(monkeypatch):
    problems = [sheets(20, seed) for seed in SEEDS]
    assert all(solved(*problem, 0.8) is not None for problem in problems)
    monkeypatch.setattr(coulomb, "PROXIMAL", 0)
    assert any(solved(*problem, 0.8) is None for problem in problems)


def test_a_slip_that_turns_back_may_stop_on_the_way():
    """One contact that is pulled one way and the other: it slips, turns back and stops in whatever direction."""
    S = np.diag([1.0, 1e-3, 1e-3])
    for pull in np.linspace(-2.0, 2.0, 41):
        δ = np.array([[-1.0, 0.2e-3 * pull, 0.0]])
        f = solved(S, δ, 0.2, np.array([[1.0, -0.2 * np.sign(pull), 0.0]]))
        np.testing.assert_allclose(f, [[1.0, -0.2 * np.clip(pull, -1, 1), 0.0]], atol=1e-12)


@pytest.fixture(scope="module")
def held():
    """A strip held at one end, factorised so, and rows along it."""
    shell = strip(100.0, 10.0, 2.0, 10.0)
    x = shell.surface.points[:, 0]
    rows = vertex_rows(shell, np.flatnonzero(x % 20 == 0), (0, 0, 1), side=-1).tocsr()
    parts = Parts([shell], MPI.COMM_SELF)
    return (
        parts.stiffness,
        parts.held(clamped(shell, np.flatnonzero(x == 0))),
        rows,
        clamped(shell, np.flatnonzero(x == 100)),
    )


@pytest.mark.parametrize("yielding", [False, True])
def test_a_step_with_other_supports_is_condensed_exactly(held, yielding):
    """The strip let go at the end at which it was factorised, and held at the other and under its middle: dense
    algebra of the whole system says the same."""
    K, base, rows, other = held
    B, C = vstack([other, rows[6:7]]).tocsr(), rows[:6]
    c = np.full(B.shape[0], 1e-5) if yielding else None
    step = Condensation(base, B, c, C)
    rng = np.random.default_rng(0)
    p, v = K @ rng.normal(size=K.shape[0]) * 1e-3, rng.normal(size=B.shape[0])
    b = B.shape[0]
    whole = np.block([[K.toarray(), -B.T.toarray()], [B.toarray(), np.zeros((b, b)) if c is None else np.diag(c)]])
    exact = np.linalg.solve(whole, np.concatenate([p, v]))
    u, r = step.solve(p, v)
    assert np.abs(u - exact[: len(u)]).max() < 1e-7 * np.abs(exact[: len(u)]).max()
    assert np.abs(r - exact[len(u) :]).max() < 1e-7 * np.abs(exact[len(u) :]).max()
    unit = np.linalg.solve(whole, np.vstack([C.T.toarray(), np.zeros((b, C.shape[0]))]))[: len(u)]
    S = C @ unit
    assert np.abs(step.compliance() - S).max() < 1e-7 * np.abs(S).max()
    assert np.abs(base.readings(C) - S).max() > 0.1 * np.abs(S).max()  # what the first rows alone would say


def test_rows_are_solved_once_and_each_step_has_its_own_compliance(held):
    K, base, rows, other = held
    first, second = Condensation(base, other, None, rows[:6]), Condensation(base, base.D, None, rows[:6])
    asked = first.compliance().copy()
    solved = base.solved
    assert np.array_equal(first.compliance(), asked)
    assert np.abs(second.compliance() - asked).max() > 0.1 * np.abs(asked).max()
    assert np.array_equal(first.compliance(), asked)
    assert base.solved == solved > 0


def test_an_error_for_lack_of_memory_names_the_remedy(held, monkeypatch):
    """For supported parts, and for a part where MUMPS can be called only through PETSc."""
    K, base, _, _ = held
    petsc = MagicMock(IntType=np.int32)
    petsc.PC().create().getFactorMatrix().getMumpsInfog.return_value = -9
    monkeypatch.setattr(factorisation, "PETSc", petsc)
    monkeypatch.setattr(factorisation, "Instance", MagicMock(side_effect=factorisation.Unavailable))
    for factorise in (lambda: condensation.HeldParts(K, base.D), lambda: factorisation.Factorisation(K)):
        with pytest.raises(factorisation.OutOfMemory, match="coarser mesh or more memory"):
            factorise()


@pytest.mark.slow
def test_a_sample_whose_slips_turn_back_has_a_solution(cache):
    """The lap joint's 37th on its own mesh: at the default penalty one slip turned back for ever, over the small forces
    that would stop it, from either side; the whole route needs a softer penalty."""
    scene = with_path(mic.load_scene(examples.folder("lap_joint")), "increments", 1)
    full = FullModel(assemble(scene, cache), deviated=True, comm=MPI.COMM_SELF, route="condensed")
    found = full.evaluate(draw(scene, scene.monte_carlo.seed, 37, 1)[0])
    assert {"clamp", "release"} <= set(found.resolutions) and found.route == "condensed"
    assert all(np.isinf(solve.penalty) and solve.augmentation == 0 for solve in found.history)
