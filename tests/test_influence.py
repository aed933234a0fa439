"""Influence coefficients: against dense algebra, against every other way to compute them, over processes."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from support.panels import NU, PLACES, E, T, functionals, panel
from support.processes import on_processes
from support.shells import several_parts
from threadpoolctl import threadpool_limits

from fem_reference.shell import factorisation, influence, mumps
from fem_reference.shell.factorisation import (
    BLOCK,
    Factorisation,
    FactorisationError,
    NoSchurComplement,
    OutOfMemory,
    upper_triangle,
)
from fem_reference.shell.influence import compute_influence, influence_matrix
from fem_reference.shell.ordering import nested_dissection
from fem_reference.shell.part import ELEMENTS, ShellPart
from mic.compliance.part import GENERATION

pytestmark = pytest.mark.fem


def spd(m=200, n=30):
    """A sparse SPD matrix K (m, m), sparse rows L (n, m), and L K⁻¹ Lᵀ."""
    random = np.random.default_rng(5)
    B = sp.random(m, m, density=0.02, random_state=7)
    L = sp.random(n, m, density=0.05, random_state=8).tolil()
    L[np.arange(n), random.permutation(m)[:n]] = 1.0
    K, L = (B @ B.T + sp.eye(m)).tocsr(), L.tocsr()
    return K, L, L @ np.linalg.solve(K.toarray(), L.T.toarray())


def close(H, exact):
    return abs(H - exact).max() < 1e-12 * abs(exact).max()


def sweeps(factors, K):
    """Whether factors serve a right-hand side of more than a block."""
    B = np.random.default_rng(1).normal(size=(K.shape[0], BLOCK + 3))
    return factors.solve(B) == pytest.approx(np.linalg.solve(K.toarray(), B), rel=1e-9, abs=1e-12)


def test_schur_complement_and_sweeps_against_dense_algebra():
    K, L, exact = spd()
    factors = Factorisation(K, L)
    assert close(factors.influence, exact) and (factors.influence == factors.influence.T).all()
    # the factors of K remain usable beneath the border, by dense and by sparse right-hand sides
    assert sweeps(factors, K) and L @ factors.solve_sparse(L) == pytest.approx(exact, rel=1e-9, abs=1e-12)
    assert factors.memory > 0


def test_entries_below_the_diagonal_are_not_read():
    K, L, exact = spd()
    for given in (sp.triu(K, format="csr"), (sp.triu(K) + 7 * sp.tril(K, -1)).tocsr()):
        assert close(influence_matrix(given, L)[0], exact)


def test_the_values_of_the_stiffness_are_stored_once(monkeypatch):
    """MUMPS reads the values of the stiffness in place; the factorisation does not change them."""
    K, L, _ = spd()
    K, given = factorisation.upper_triangle(K), []
    before, give = K.copy(), mumps.Instance.give
    monkeypatch.setattr(
        mumps.Instance, "give", lambda self, **arrays: (given.append(arrays.get("a")), give(self, **arrays))
    )
    influence_matrix(K, L)
    (values,) = [array for array in given if array is not None]
    assert np.shares_memory(K.data, values)
    assert (K != before).nnz == 0


def test_the_order_is_a_permutation_that_dissects():
    """A grid of 40 × 40 nodes: little fill, and the three degrees of freedom of a node stay together."""
    grid = sp.diags([np.ones(39), np.full(40, 4.0), np.ones(39)], [-1, 0, 1])
    K = sp.kron(sp.kron(grid, grid), np.ones((3, 3))).tocsr()
    places = nested_dissection(upper_triangle(K))
    assert np.array_equal(np.sort(places), np.arange(K.shape[0]))
    nodes = np.sort(places.reshape(-1, 3), axis=1)
    assert np.array_equal(nodes[:, 0] + 2, nodes[:, 2]) and not np.any(nodes[:, 0] % 3)
    # row by row, the factor is a band; an order that confuses places with rows fills more than that
    band = _factor_entries(K, np.arange(K.shape[0]))
    assert _factor_entries(K, places) < band < _factor_entries(K, np.argsort(places))


def _factor_entries(K, places):
    """Entries of the factors of a matrix with K's pattern, in another order."""
    order = np.argsort(places)
    shifted = (K + 100 * sp.eye(K.shape[0]))[order][:, order].tocsc()
    options = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    return splu(shifted, **options).nnz


def test_without_metis_the_coefficients_are_the_same(monkeypatch):
    K, L, exact = spd()
    monkeypatch.setattr(factorisation, "nested_dissection", lambda pattern: None)
    assert close(Factorisation(K, L).influence, exact)


@pytest.mark.parametrize("unknown", ["series", "place"])
def test_a_mumps_of_unknown_structure_is_called_through_petsc(unknown, monkeypatch):
    """Its version is unknown, or its structure has another layout than that version."""
    if unknown == "series":
        layouts = {f"0{series}": layout for series, layout in mumps.LAYOUTS.items()}
    else:
        layouts = {
            series: layout | {"version_number": layout["version_number"] + 4}
            for series, layout in mumps.LAYOUTS.items()
        }
    monkeypatch.setattr(mumps, "LAYOUTS", layouts)
    K, L, exact = spd()
    with pytest.warns(UserWarning, match=r"structure of MUMPS \d+\.\d+\.\d+ is not known.*blocks of right-hand sides"):
        H, factors = influence_matrix(K, L)
    assert close(H, exact) and sweeps(factors, K)


@pytest.fixture
def no_schur_complement(monkeypatch):
    """Computing a Schur complement raises the given error."""

    def failing(error):
        class Failing(Factorisation):
            def __init__(self, K, L=None):
                if L is not None:
                    raise error
                super().__init__(K)

        monkeypatch.setattr(influence, "Factorisation", Failing)

    return failing


@pytest.mark.parametrize("reason", [OutOfMemory, NoSchurComplement])
def test_falls_back_to_sweeps_where_there_is_no_schur_complement(reason, no_schur_complement):
    K, L, exact = spd(n=BLOCK + 5)
    no_schur_complement(reason("the text decides nothing"))
    with pytest.warns(UserWarning, match="blocks of right-hand sides"):
        H, _ = influence_matrix(K, L)
    assert close(H, exact) and (H == H.T).all()


def test_other_failures_are_not_swallowed(no_schur_complement):
    """Only the type of the error, not its text, starts the other computation of coefficients."""
    no_schur_complement(FactorisationError("memory is not what is wrong here"))
    with pytest.raises(FactorisationError, match="not what is wrong"):
        influence_matrix(*spd()[:2])


def test_mumps_errors_for_lack_of_memory_are_translated(monkeypatch):
    """A limit of 1 MB on what MUMPS may take (ICNTL(23)) is reported as lack of memory."""
    run = mumps.Instance.run
    monkeypatch.setattr(mumps.Instance, "run", lambda self, job: (self.control(23, 1), run(self, job)))
    with pytest.raises(OutOfMemory, match="memory ran out"):
        Factorisation(*spd(m=1000)[:2])


def test_the_postcondition_catches_a_wrong_answer(monkeypatch):
    class Wrong(Factorisation):
        def __init__(self, K, L=None):
            super().__init__(K, L)
            self.influence = self.influence * (1 + 1e-6)

    monkeypatch.setattr(influence, "Factorisation", Wrong)
    with pytest.raises(FactorisationError, match="fail their check"):
        influence_matrix(*spd()[:2])


def test_an_indefinite_matrix_is_refused():
    K, L, _ = spd()
    with pytest.raises(FactorisationError):
        influence_matrix((K - 50 * sp.eye(K.shape[0])).tocsr(), L)


#: Largest three eigenvalues of H on balanced forces, of the panel below, mm/N.
COMPLIANCE = {
    "dkt-opt-curved": (1.005014230023e-05, 3.750048980812e-05, 1.187984466135e-04),
    "dkmt-opt-curved": (1.009667744194e-05, 3.753813159768e-05, 1.189746776533e-04),
    "dkt-opt": (9.182787856985e-06, 3.147470142548e-05, 9.923381312995e-05),
    "p2-cr": (9.477040579903e-06, 3.411630200963e-05, 9.863116031831e-05),
}


@pytest.mark.parametrize("element", ELEMENTS)
def test_an_element_gives_the_coefficients_that_caches_hold_and_those_of_the_pseudo_inverse(element):
    """If the former fails for a good reason, raise `GENERATION`; otherwise old caches are used with the new element.

    On balanced forces H is L K⁺ Lᵀ, whatever the pins; K⁺ by the dense spectrum. Rigid readings G included.
    """
    surface = panel(5)
    part = ShellPart(surface, T, E, NU, element)
    rows = functionals(surface, PLACES, 6.0)
    H, G = part.influence(rows)
    assert (H == H.T).all() and np.linalg.eigvalsh(H).min() > -1e-10 * abs(H).max()
    balanced = np.linalg.svd(G)[0][:, 6:]
    from_pins = balanced.T @ H @ balanced
    assert GENERATION == 9 and np.linalg.eigvalsh(from_pins)[-3:] == pytest.approx(COMPLIANCE[element], rel=1e-8)
    L = part.functional_matrix(rows)
    scale = np.where(part.dof_component < 3, 1.0, 0.1)  # rotations in 10 rad: a better conditioned spectrum
    λ, V = np.linalg.eigh(scale[:, None] * part.stiffness_csr().toarray() * scale)
    V = scale[:, None] * V[:, 6:]
    from_spectrum = balanced.T @ (L @ (V / λ[6:] @ V.T) @ L.T) @ balanced
    assert abs(from_pins - from_spectrum).max() < 1e-8 * abs(from_spectrum).max()
    assert pytest.approx(L @ part.rigid_modes) == G


def test_one_factorisation_serves_coefficients_and_fields(monkeypatch):
    """Field recovery after `influence` costs solves, no second factorisation."""
    part = ShellPart(panel(5), T, E, NU)
    rows = functionals(part.surface, PLACES, 6.0)
    part.influence(rows)
    monkeypatch.setattr("fem_reference.shell.part.Factorisation", None)  # any further one would fail
    monkeypatch.setattr("fem_reference.shell.influence.Factorisation", None)
    assert part.field(rows, np.ones((len(rows), 2))).shape == (len(part.surface.points), 6, 2)


PROGRAM = """
import sys

import numpy as np
from mpi4py import MPI
from support.panels import NU, PLACES, E, T, functionals, panel
from support.shells import several_parts
from threadpoolctl import threadpool_limits

from fem_reference.shell.influence import compute_influence
from fem_reference.shell.part import ShellPart

# a part whose mesh is shared out has other numbers for its freedoms, the same normals and the same compliance
for element in ("dkt-opt-curved", "dkmt-opt-curved"):
    shared, alone = (ShellPart(panel(6), T, E, NU, element, comm=comm) for comm in (MPI.COMM_WORLD, MPI.COMM_SELF))
    rows = functionals(alone.surface, PLACES, 6.0)
    (H, G), (H_alone, G_alone) = shared.influence(rows), alone.influence(rows)
    balanced = np.linalg.svd(G_alone)[0][:, 6:]
    assert abs(G - G_alone).max() < 1e-12 * abs(G).max()
    assert abs(balanced.T @ (H - H_alone) @ balanced).max() < 1e-10 * abs(balanced.T @ H @ balanced).max(), element

coefficients = compute_influence(*several_parts())
if MPI.COMM_WORLD.rank == 0:
    values = {f"{name} {key}": value for name, pair in coefficients.items() for key, value in zip("HG", pair)}
    np.savez(sys.argv[1], **values)
"""


@pytest.mark.slow
def test_two_processes_give_the_coefficients_of_one(tmp_path):
    """To 1e-10."""
    outcome = on_processes(2, "-c", PROGRAM, tmp_path / "result.npz")
    assert outcome.returncode == 0, outcome.stderr
    serial = compute_influence(*several_parts())
    with np.load(tmp_path / "result.npz") as parallel:
        for name, (H, G) in serial.items():
            assert abs(parallel[f"{name} H"] - H).max() < 1e-10 * abs(H).max()
            assert abs(parallel[f"{name} G"] - G).max() < 1e-10 * abs(G).max()


def test_the_number_of_threads_does_not_change_a_bit():
    K, L, _ = spd(m=1000, n=300)
    right = np.random.default_rng(2).normal(size=(K.shape[0], BLOCK))

    def computed(threads):
        with threadpool_limits(limits=threads, user_api="blas"):
            factors = Factorisation(K, L)
            return factors.influence, factors.solve(right), factors.solve_sparse(L[:BLOCK])

    for one, two in zip(computed(1), computed(2)):
        np.testing.assert_array_equal(one, two)
