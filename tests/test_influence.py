"""Influence coefficients: against dense algebra, against every other way to compute them, over processes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from test_shell_part import NU, PLACES, E, T, functionals, panel

from fem_reference.shell import factorisation as influence
from fem_reference.shell.factorisation import Factorisation, FactorisationError, compute_influence, influence_matrix
from fem_reference.shell.part import ELEMENTS, ShellPart


def spd(m=200, n=30):
    """A sparse SPD matrix (m, m) and sparse rows (n, m)."""
    random = np.random.default_rng(5)
    B = sp.random(m, m, density=0.02, random_state=7)
    L = sp.random(n, m, density=0.05, random_state=8).tolil()
    L[np.arange(n), random.permutation(m)[:n]] = 1.0
    return (B @ B.T + sp.eye(m)).tocsr(), L.tocsr()


def test_schur_complement_and_sweeps_against_dense_algebra():
    K, L = spd()
    exact = L @ np.linalg.solve(K.toarray(), L.T.toarray())
    factorisation = Factorisation(K, L)
    assert abs(factorisation.influence - exact).max() < 1e-12 * abs(exact).max()
    assert (factorisation.influence == factorisation.influence.T).all()
    # the factors of K remain usable beneath the border, by dense and by sparse right-hand sides
    B = np.random.default_rng(1).normal(size=(K.shape[0], influence.BLOCK + 3))
    assert factorisation.solve(B) == pytest.approx(np.linalg.solve(K.toarray(), B), rel=1e-9, abs=1e-12)
    assert L @ factorisation.solve_sparse(L) == pytest.approx(exact, rel=1e-9, abs=1e-12)
    assert factorisation.memory > 0


def test_falls_back_to_sweeps_when_memory_runs_out(monkeypatch):
    K, L = spd(n=influence.BLOCK + 5)
    exact = L @ np.linalg.solve(K.toarray(), L.T.toarray())

    class Tight(Factorisation):
        def __init__(self, K, L=None):
            if L is not None:
                raise FactorisationError("memory ran out")
            super().__init__(K)

    monkeypatch.setattr(influence, "Factorisation", Tight)
    with pytest.warns(UserWarning, match="blocks of right-hand sides"):
        H, _ = influence_matrix(K, L)
    assert abs(H - exact).max() < 1e-12 * abs(exact).max() and (H == H.T).all()
    monkeypatch.setattr(influence, "_PETSC", None)  # a PETSc without the call at all
    assert influence_matrix(K, L)[0] == pytest.approx(H)


def test_the_postcondition_catches_a_wrong_answer(monkeypatch):
    K, L = spd()

    class Wrong(Factorisation):
        def __init__(self, K, L=None):
            super().__init__(K, L)
            self.influence = self.influence * (1 + 1e-6)

    monkeypatch.setattr(influence, "Factorisation", Wrong)
    with pytest.raises(FactorisationError, match="fail their check"):
        influence_matrix(K, L)


def test_an_indefinite_matrix_is_refused():
    K, L = spd()
    with pytest.raises(FactorisationError):
        influence_matrix((K - 50 * sp.eye(K.shape[0])).tocsr(), L)


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_part_s_coefficients_against_the_pseudo_inverse(element):
    """On balanced forces H is L K⁺ Lᵀ, whatever the pins; K⁺ by the dense spectrum. Rigid readings G included."""
    surface = panel(5)
    part = ShellPart(surface, T, E, NU, element)
    rows = functionals(surface, PLACES, 6.0)
    H, G = part.influence(rows)
    assert (H == H.T).all()
    L = part.functional_matrix(rows)
    scale = np.where(part.dof_component < 3, 1.0, 0.1)  # rotations in 10 rad: a better conditioned spectrum
    λ, V = np.linalg.eigh(scale[:, None] * part.stiffness_csr().toarray() * scale)
    V = scale[:, None] * V[:, 6:]
    balanced = np.linalg.svd(G)[0][:, 6:]
    from_pins = balanced.T @ H @ balanced
    from_spectrum = balanced.T @ (L @ (V / λ[6:] @ V.T) @ L.T) @ balanced
    assert abs(from_pins - from_spectrum).max() < 1e-8 * abs(from_spectrum).max()
    assert np.linalg.eigvalsh(H).min() > -1e-10 * abs(H).max()
    assert pytest.approx(L @ part.rigid_modes) == G


def test_one_factorisation_serves_coefficients_and_fields(monkeypatch):
    """Field recovery after `influence` costs solves, no second factorisation."""
    part = ShellPart(panel(5), T, E, NU)
    rows = functionals(part.surface, PLACES, 6.0)
    part.influence(rows)
    monkeypatch.setattr("fem_reference.shell.part.Factorisation", None)  # any further one would fail
    monkeypatch.setattr("fem_reference.shell.factorisation.Factorisation", None)
    assert part.field(rows, np.ones((len(rows), 2))).shape == (len(part.surface.points), 6, 2)


NAMES = {"left": (1.2, 5), "right": (0.8, 6), "middle": (1.0, 4)}


def several_parts():
    """Three parts and their functionals, by name."""
    surfaces = {name: panel(n) for name, (_, n) in NAMES.items()}
    rows = {name: functionals(surface, PLACES, 6.0) for name, surface in surfaces.items()}
    parts = {name: (lambda name=name: ShellPart(surfaces[name], NAMES[name][0], E, NU)) for name in NAMES}
    return parts, rows


if __name__ == "__main__":  # one of the processes of the test below
    from mpi4py import MPI

    # a part whose mesh is shared out has other numbers for its freedoms, and the same compliance
    shared = ShellPart(panel(6), T, E, NU, comm=MPI.COMM_WORLD)
    alone = ShellPart(panel(6), T, E, NU)
    rows = functionals(alone.surface, PLACES, 6.0)
    (H, G), (H_alone, G_alone) = shared.influence(rows), alone.influence(rows)
    balanced = np.linalg.svd(G_alone)[0][:, 6:]
    assert abs(G - G_alone).max() < 1e-12 * abs(G).max()
    assert abs(balanced.T @ (H - H_alone) @ balanced).max() < 1e-10 * abs(balanced.T @ H @ balanced).max()

    coefficients = compute_influence(*several_parts())
    if MPI.COMM_WORLD.rank == 0:
        np.savez(
            sys.argv[1],
            **{f"{name} {key}": value for name, pair in coefficients.items() for key, value in zip("HG", pair)},
        )


@pytest.mark.parametrize("processes", [1, 2, 4])
def test_equal_on_any_number_of_processes(processes, tmp_path):
    """mpirun -n 1, 2, 4 give what this process computes, to 1e-10."""
    if shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")
    here = Path(__file__).resolve()
    environment = os.environ | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(here.parents[1]), str(here.parent)]),
    }
    command = [
        "mpirun",
        "--oversubscribe",
        "-n",
        str(processes),
        sys.executable,
        "-m",
        "mpi4py",
        str(here),
        str(tmp_path / "result.npz"),
    ]
    outcome = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert outcome.returncode == 0, outcome.stderr
    serial = compute_influence(*several_parts())
    with np.load(tmp_path / "result.npz") as parallel:
        for name, (H, G) in serial.items():
            assert abs(parallel[f"{name} H"] - H).max() < 1e-10 * abs(H).max()
            assert abs(parallel[f"{name} G"] - G).max() < 1e-10 * abs(G).max()
