"""Equilibrium of all parts under bilateral rows and frictional contact: one sparse system, Newton, any number of ranks.

Unknowns are the freedoms u of all parts, the forces r of the bilateral rows B and the contact forces f of the rows C,
with

    K u = Bᵀ r + Cᵀ f + p,        B u + c r = v,                                                       (1)

with c the compliance of yielding rows (0 for rigid ones), K the block-diagonal stiffness of the free parts, and
Coulomb's law in its penalty (augmented-Lagrangian) form. With the gap g = g⁰ + δ_n and the slip s = δ_t − a of each
contact, δ = C u, the trial force is

    y_n = f̂_n − ε g,              y_t = f̂_t − ε s,                                                     (2)

and the return mapping, not associated (it scales f_t and does not change f_n), is

    f_n = max(0, y_n),            f_t = y_t                  where ‖y_t‖ ≤ g(f_n)     (stick)           (3)
                                  f_t = g(f_n) y_t/‖y_t‖     elsewhere                (slip),

with g(f_n) = μ f_n, or g(f_n) = μ(f_n/A) f_n where the coefficient depends on pressure.

f̂ = (0, f_t of the previous increment) is the plain penalty method, whose elastic slip f_t/ε is recovered on reversal;
repeating f̂ ← f (Uzawa) drives ε g → 0 and ε s → 0 in contact, so that (3) becomes Coulomb's law for any ε.

A contact with tangential compliance has a physical stiffness k_t A. Its tangential rows use ε = k_t A and f̂_t = 0:
the elastic slip −f_t/ε, measured from the slider position a, is then physical and is not removed. In contact the
slider moves to δ_t + f_t/ε. Sheets that are compressed through their thickness, by c f_n, use ε = 1/c in the normal
row in the same manner.

Newton's method solves for (u, r, f) together. The equations of each contact, scaled to forces by a stiffness k of the
sheets, are:

    open     f = 0
    closed   k g + (k/ε)(f_n − f̂_n) = 0
    stick    k s + (k/ε)(f_t − f̂_t) = 0                                                                 (4)
    slip     f_t − g(f_n) τ = 0,   τ = y_t/‖y_t‖,    dτ = −ε (I − ττᵀ) ds/‖y_t‖

Eliminating f from (4) gives the consistent tangent K + Cᵀ(−∂f/∂δ)C of the textbooks, so the iterates are the same.
With the forces as unknowns the tangent stays sparse if a contact patch covers many nodes, its condition number does
not grow with ε, and f has no rounding error of ε times a displacement. The tangent is unsymmetric if contacts slip.

References
----------
Wriggers (2006), Computational Contact Mechanics, 2nd ed., Springer: return mapping and its tangent, sections 5.2 and
6.3. Alart, Curnier (1991), A mixed formulation for frictional contact problems prone to Newton like solution methods,
Comput. Methods Appl. Mech. Engrg 92, 353–375. Simo, Laursen (1992), An augmented Lagrangian treatment of contact
problems involving friction, Comput. Struct. 42, 97–116.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import block_diag, csr_matrix, diags, hstack, vstack

from fem_reference.full.condensation import Condensation, HeldParts
from fem_reference.full.contact_law import ContactLaw
from fem_reference.full.coulomb import contact_forces
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["Equilibrium", "Iteration", "NoConvergence", "Parts", "State"]

MAX_ITERATIONS = 60
_FULL_STEPS = 25  # iterations without line search
_TOLERANCE = 1e-11  # relative to the largest force in the system
_WORST_ROUNDING = 1e-7
_REFINEMENTS = 6  # iterative refinements of a condensed solution by the residual of the whole system
_LINE_SEARCH = 0.8  # no line search if a full step reduces the work below this fraction of its initial value
CONDENSED = 5000  # largest number of contact forces to condense onto: their compliance matrix takes 200 MB
_ICNTL_EXTRA_MEMORY, _INFOG_STATUS, _RINFO_OPERATIONS, _INFO_MEMORY = 14, 1, 3, 22  # MUMPS
_EXTRA_MEMORY = (80, 400, 2000)  # per cent more than estimated, tried in turn: many supported freedoms delay pivots
_TOO_LITTLE_MEMORY = (-8, -9)  # statuses that more extra memory remedies


class NoConvergence(RuntimeError):
    """Newton's method or the factorisation failed; `contact` is the worst contact, or None."""

    def __init__(self, message: str, contact: int | None = None):
        super().__init__(message)
        self.contact = contact


class Parts:
    """Numbering of the degrees of freedom of several parts, and their distribution over processes.

    The natural order numbers part after part, each part as `ShellPart` does.

    Parameters
    ----------
    shells : sequence of ShellPart
        All on `comm`.
    comm : MPI.Comm

    Attributes
    ----------
    offsets : (P + 1,) int array
        First freedom of each part, and their number N at the end.
    """

    def __init__(self, shells, comm: MPI.Comm):
        self.shells, self.comm = tuple(shells), comm
        self.offsets = np.concatenate([[0], np.cumsum([shell.ndof for shell in shells])])
        ranges = np.array([shell.stiffness.getOwnershipRanges() for shell in shells])  # (P, ranks + 1)
        self._owned = [
            np.concatenate([offset + np.arange(lo[rank], lo[rank + 1]) for offset, lo in zip(self.offsets, ranges)])
            for rank in range(comm.size)
        ]
        blocks = []
        for shell in shells:
            indptr, indices, data = shell.stiffness.getValuesCSR()
            blocks.append(csr_matrix((data, indices, indptr), shape=(len(indptr) - 1, shell.ndof)))
        self.stiffness = block_diag(blocks, format="csr")  # this process's rows, all columns
        self._held: HeldParts | None = None

    def held(self, rows: csr_matrix) -> HeldParts:
        """Factorised stiffness of all parts on one process, supported by the rows of the first call."""
        if self._held is None:
            self._held = HeldParts(self.stiffness, rows)
        return self._held

    def layout(self, extra: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of this process and the position of every unknown; the last process owns `extra` more unknowns.

        Returns
        -------
        owned : int array
            Natural numbers of this process's rows, in order.
        place : (N + extra,) int array
            Row of the distributed system for each natural number.
        """
        N = self.offsets[-1]
        owned = list(self._owned)
        owned[-1] = np.concatenate([owned[-1], N + np.arange(extra)])
        order = np.concatenate(owned)
        place = np.empty(len(order), dtype=PETSc.IntType)
        place[order] = np.arange(len(order))
        return owned[self.comm.rank], place


@dataclass(frozen=True)
class Iteration:
    """One Newton iteration.

    Attributes
    ----------
    residual : float
        Largest residual of (1) and (4) after the iteration, relative to the largest force in the system.
    step : float
        Step length.
    open, stick, slip : int
        Number of contacts in each state after the iteration.
    changed : int
        Number of contacts whose state changed.
    """

    residual: float
    step: float
    open: int
    stick: int
    slip: int
    changed: int

    @classmethod
    def of(cls, residual: float, step: float, state: np.ndarray, changed: int) -> Iteration:
        """Iteration with the number of contacts in each of the states (m,)."""
        return cls(residual, step, *(int((state == s).sum()) for s in (OPEN, STICK, SLIP)), changed)


@dataclass(frozen=True)
class State:
    """Unknowns of equations (1) and (4).

    Attributes
    ----------
    u : (N,) array
        Freedoms in natural order.
    reaction : (b,) array
        r.
    force : (m, d) array
        f.
    """

    u: np.ndarray
    reaction: np.ndarray
    force: np.ndarray

    @property
    def stacked(self) -> np.ndarray:
        """(N + b + m d,) concatenation of u, r and f."""
        return np.concatenate([self.u, self.reaction, self.force.ravel()])


class Equilibrium:
    """System (1) with (4); sparsity pattern and symbolic factorisation of the tangent are reused by all solves.

    Parameters
    ----------
    parts : Parts
    B : (b, N) csr_matrix
        Bilateral rows, independent.
    C : (m d, N) csr_matrix
        Contact rows, contact by contact.
    dimension : int
        d.
    yielding : (b,) array, optional
        c of the bilateral rows, mm/N.
    held : bool
        Whether the bilateral rows alone exclude all rigid motions. On one process the linear part can then be condensed
        onto the contact forces (:mod:`fem_reference.full.condensation`).
    route : {"whole", "condensed"}
        Route of :meth:`linear`.
    """

    def __init__(
        self,
        parts: Parts,
        B: csr_matrix,
        C: csr_matrix,
        dimension: int,
        yielding: np.ndarray | None = None,
        held: bool = False,
        route: str = "whole",
    ):
        self.parts, self.B, self.C, self.d = parts, B.tocsr(), C.tocsr(), dimension
        self.N, self.b, self.m = parts.offsets[-1], B.shape[0], C.shape[0] // dimension
        comm = parts.comm
        owned, self._place = parts.layout(self.b + self.m * dimension)
        self._last = comm.rank == comm.size - 1
        self._yielding = yielding
        self.condensable = held and comm.size == 1 and self.m * dimension <= CONDENSED
        self._condenses = held and comm.size == 1 and route == "condensed"
        self._u_rows = owned[owned < self.N]
        BT, CT = self.B.T.tocsr()[self._u_rows], self.C.T.tocsr()[self._u_rows]
        self._balance = hstack([parts.stiffness, -BT, -CT], format="csr")  # of this process's freedoms

    @cached_property
    def _matrix(self) -> PETSc.Mat:
        """Tangent of the unknowns (u, r, f); :meth:`_update` sets the rows of f."""
        rows, contacts = [self._balance], self.m * self.d
        self._contact_pattern()
        if self._last:
            none = np.zeros((self.m, self.d, self.d))
            soft = csr_matrix((self.b, self.b)) if self._yielding is None else diags(self._yielding, format="csr")
            rows.append(hstack([self.B, soft, csr_matrix((self.b, contacts))], format="csr"))
            rows.append(self._contact_rows(none, none))
        local = vstack(rows, format="csr")
        local = csr_matrix((local.data, self._place[local.indices], local.indptr), shape=local.shape)
        local.sort_indices()
        size = local.shape
        matrix = PETSc.Mat().createAIJ(
            (size, size),
            comm=self.parts.comm,
            csr=(local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data),
        )
        matrix.assemble()
        return matrix

    @cached_property
    def _vectors(self):
        return self._matrix.createVecs()

    @cached_property
    def _magnitude(self):
        return abs(self._balance)

    @property
    def elimination(self) -> tuple[float, float]:
        """Floating-point operations of this process in the last factorisation, and memory of its factors, MB."""
        if "_ksp" not in self.__dict__:
            return 0.0, 0.0
        return self._factor.getMumpsRinfo(_RINFO_OPERATIONS), float(self._factor.getMumpsInfo(_INFO_MEMORY))

    @cached_property
    def _ksp(self) -> PETSc.KSP:
        return self._solver(_EXTRA_MEMORY[0])

    def _solver(self, extra_memory: int) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self.parts.comm)
        ksp.setOperators(self._matrix)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        self._factor = pc.getFactorMatrix()
        self._factor.setMumpsIcntl(_ICNTL_EXTRA_MEMORY, extra_memory)
        return ksp

    def __del__(self):
        """Free the factors of one process, which petsc4py would hold until exit (hundreds of MB).

        Distributed factors are not freed: that is a collective call, and garbage collection is not simultaneous.
        """
        if self.parts.comm.size == 1:
            for name in ("_factor", "_ksp", "_matrix"):
                if name in self.__dict__:
                    self.__dict__[name].destroy()

    # ------------------------------------------------------------------------------------------ sparse contact operator

    def _contact_pattern(self):
        """Columns of the rows of each contact: the freedoms that its d rows read, then its d forces."""
        C, d = self.C, self.d
        self._columns, self._owner, values = [], [], []
        for k in range(self.m):
            block = C[k * d : (k + 1) * d].tocsc()
            used = np.flatnonzero(np.diff(block.indptr))
            self._columns.append(used)
            values.append(block[:, used].toarray().T)
        lengths = np.array([len(c) for c in self._columns], dtype=int)
        self._owner = np.repeat(np.arange(self.m), lengths)
        self._values = np.concatenate(values) if values else np.zeros((0, d))  # (entries, d)
        # Row (k, i) holds the entries of contact k and then its d forces.
        start = np.concatenate([[0], np.cumsum(lengths)])
        forces = self.N + self.b + np.arange(self.m * d).reshape(self.m, d)
        gather, columns = [], []
        for k in range(self.m):
            for i in range(d):
                gather += [np.arange(start[k], start[k + 1]) * d + i, start[-1] * d + (k * d + i) * d + np.arange(d)]
                columns += [self._columns[k], forces[k]]
        self._gather = np.concatenate(gather) if gather else np.zeros(0, dtype=int)
        self._row_columns = np.concatenate(columns) if columns else np.zeros(0, dtype=int)
        self._row_start = np.concatenate([[0], np.cumsum(np.repeat(lengths + d, d))])

    def _contact_data(self, by_δ, by_f):
        entries = np.einsum("eij,ej->ei", by_δ[self._owner], self._values)  # (∂/∂δ) C
        return np.concatenate([entries.ravel(), by_f.ravel()])[self._gather]

    def _contact_rows(self, by_δ, by_f):
        return csr_matrix(
            (self._contact_data(by_δ, by_f), self._row_columns, self._row_start),
            shape=(self.m * self.d, self.N + self.b + self.m * self.d),
        )

    def _update(self, by_δ, by_f):
        matrix = self._matrix
        if self._last and self.m:
            rows = self._place[self.N + self.b :].astype(PETSc.IntType)
            matrix.setValuesIJV(
                self._row_start.astype(PETSc.IntType),
                self._place[self._row_columns],
                self._contact_data(by_δ, by_f),
                rowmap=rows,
            )
        matrix.assemble()

    # ------------------------------------------------------------------------------------------ distributed algebra

    def _scatter(self, natural, vector):
        lo, hi = vector.getOwnershipRange()
        distributed = np.empty(len(natural))
        distributed[self._place] = natural
        vector.setArray(distributed[lo:hi])

    def _gathered(self, vector):
        return np.concatenate(self.parts.comm.allgather(vector.getArray()))[self._place]

    def _multiply(self, x):
        right, left = self._vectors
        self._scatter(x, right)
        self._matrix.mult(right, left)
        return self._gathered(left)

    def _solve(self, right):
        solved, given = self._vectors
        self._scatter(right, given)
        self._ksp.solve(given, solved)
        status = self._factor.getMumpsInfog(_INFOG_STATUS)
        for extra in _EXTRA_MEMORY[1:]:
            if status not in _TOO_LITTLE_MEMORY:
                break
            self._ksp.destroy()  # a failed one does not factorise again
            self._ksp = self._solver(extra)
            self._ksp.solve(given, solved)
            status = self._factor.getMumpsInfog(_INFOG_STATUS)
        if status < 0:
            raise NoConvergence(
                f"MUMPS cannot factorise the tangent: INFOG(1) = {status}, INFOG(2) = {self._factor.getMumpsInfog(2)}"
            )
        solution = self._gathered(solved)
        if not np.isfinite(solution).all():
            raise NoConvergence("the tangent is singular")
        return solution

    def _largest(self, value: float) -> float:
        return self.parts.comm.allreduce(value, op=MPI.MAX)

    # ------------------------------------------------------------------------------------------ solves

    def linear(self, p: np.ndarray, v: np.ndarray, force: np.ndarray) -> State:
        """Equilibrium under loads p (N,) and given contact forces (m, d)."""
        if self._condenses:
            u, r = self._condensation.solve(p + self.C.T @ force.ravel(), v)
            return State(u, r, force.copy())
        zero = np.zeros((self.m, self.d, self.d))
        self._update(zero, np.tile(np.eye(self.d), (self.m, 1, 1)))
        right = np.concatenate([p, v, force.ravel()])
        x = self._solve(right)
        x += self._solve(right - self._multiply(x))
        return self.unpack(x)

    def newton(self, start: State, p: np.ndarray, v: np.ndarray, law: ContactLaw) -> tuple[State, list[Iteration]]:
        """Solve (1) and (4) from `start`.

        Raises
        ------
        NoConvergence
            After `MAX_ITERATIONS`, or if the tangent cannot be factorised.
        """
        N, b = self.N, self.b
        x = start.stacked
        δ = self.contact(x)
        state = law.state(δ)
        history: list[Iteration] = []
        for iteration in range(MAX_ITERATIONS):
            contact, by_δ, by_f = law.linearise(δ, x[N + b :].reshape(self.m, self.d), state)
            F = self._residual(x, p, v, contact)
            self._update(by_δ, by_f)
            dx = -self._solve(F)
            dx -= self._solve(F + self._multiply(dx))
            α = self._step_length(x, dx, F, law, state, iteration)
            x = x + α * dx
            δ = self.contact(x)
            before, state = state, law.state(δ)
            contact, by_δ, by_f = law.linearise(δ, x[N + b :].reshape(self.m, self.d), state)
            changed = int((state != before).sum())
            residual, allowed = self._measure(x, p, contact, law)
            history.append(Iteration.of(residual, α, state, changed))
            if residual <= allowed:
                return self.unpack(x), history
        worst = int(np.argmax(np.abs(contact).max(axis=1))) if self.m else None
        raise NoConvergence(
            f"no convergence in {MAX_ITERATIONS} iterations: residual {residual:.1e} of the largest force, "
            f"{changed} contacts still change state",
            worst,
        )

    def condensed(self, force: np.ndarray, p: np.ndarray, v: np.ndarray, law: ContactLaw):
        """Solve (1) and (4) on the system condensed onto the contact forces, starting from forces (m, d).

        An infinite penalty enforces Coulomb's law exactly. Returns the solution, the contact states (m,) and the
        iterations; the residual of the last one is that of the whole system including its bilateral rows.

        Raises
        ------
        NoConvergence
        """
        linear, history = self._condensation, []
        S, soft = linear.compliance(), 0.0 if self._yielding is None else self._yielding
        u, r, f = np.zeros(self.N), np.zeros(self.b), np.zeros_like(force)
        for _ in range(_REFINEMENTS):
            x = np.concatenate([u, r, f.ravel()])
            du, dr = linear.solve(p - self._balance @ x, v - self.B @ u - soft * r)
            force, iterations = contact_forces(S, self.contact(u + du), f, law, force)
            history += [Iteration.of(*iteration) for iteration in iterations]
            if force is None:
                raise NoConvergence("Newton's method does not converge on the condensed system")
            contact_u, contact_r = linear.solve(self.C.T @ (force - f).ravel(), np.zeros(self.b))
            u, r, f = u + du + contact_u, r + dr + contact_r, force
            x, δ = np.concatenate([u, r, f.ravel()]), self.contact(u)
            finite = replace(law, penalty=law.stiffness).augmented(f) if np.isinf(law.penalty).any() else law
            state = finite.state(δ)
            contact, _, _ = finite.linearise(δ, f, state)
            residual, allowed = self._measure(x, p, contact, finite)
            if largest := np.abs(x[self.N :]).max(initial=0.0):
                misfit = np.abs(self.B @ u + soft * r - v).max(initial=0.0)
                residual = max(residual, float(law.stiffness.max(initial=0.0) * misfit / largest))
            history.append(Iteration.of(residual, 1.0, state, 0))
            if residual <= allowed:
                return self.unpack(x), state, history
        raise NoConvergence(
            f"condensed solution: residual of the whole system {residual:.1e} of the largest force, limit {allowed:.1e}"
        )

    @cached_property
    def _condensation(self) -> Condensation:
        return Condensation(self.parts.held(self.B), self.B, self._yielding, self.C)

    def contact(self, x: np.ndarray) -> np.ndarray:
        """(m, d) relative displacements δ of the contacts from u (N,), or from all unknowns."""
        return (self.C @ x[: self.N]).reshape(self.m, self.d)

    def unpack(self, x: np.ndarray) -> State:
        """The unknowns from the concatenation of u, r and f."""
        return State(
            x[: self.N].copy(), x[self.N : self.N + self.b].copy(), x[self.N + self.b :].reshape(self.m, self.d).copy()
        )

    def _residual(self, x, p, v, contact):
        F = self._multiply(x) - np.concatenate([p, v, np.zeros(self.m * self.d)])
        F[self.N + self.b :] = contact.ravel()
        return F

    def _measure(self, x, p, contact, law):
        """Relative residual and its limit: the larger of the tolerance and the rounding error of the sums.

        The limit is at most `_WORST_ROUNDING`, so that a part without support does not count as converged.
        """
        N = self.N
        imbalance = np.abs(self._balance @ x - p[self._u_rows]).max(initial=0.0)
        rounding = self._largest((self._magnitude @ np.abs(x)).max(initial=0.0))
        if self.m:
            rounding = max(
                rounding,
                float((law.stiffness * (np.abs(self.C) @ np.abs(x[:N])).reshape(self.m, self.d).max(axis=1)).max()),
            )
        scale = np.abs(x[N:]).max(initial=0.0)
        residual = max(self._largest(imbalance), np.abs(contact).max(initial=0.0))
        negligible = 1e-13 * max(np.abs(law.stiffness * law.gap).max(initial=0.0), rounding if scale == 0 else 0.0)
        if scale <= negligible:  # all contact forces and reactions are zero
            return (0.0 if residual <= negligible else np.inf), 0.0
        return residual / scale, min(max(_TOLERANCE, 1e-14 * rounding / scale), _WORST_ROUNDING)

    def _step_length(self, x, dx, F, law, state, iteration):
        """α with G(α) = du·(K u(α) − p − Cᵀ f(u(α))) = 0, u(α) = u + α du: the residual does no work on the step.

        Steps are searched along if a slip reverses and, after `_FULL_STEPS` iterations, if a state changes. Full steps
        before that find the open and closed contacts fastest. A step that moves bilateral rows has length 1.
        """
        N, b = self.N, self.b
        δ, dδ = self.contact(x), self.contact(dx)
        if not law.reverses(δ, δ + dδ) and (iteration < _FULL_STEPS or (law.state(δ + dδ) == state).all()):
            return 1.0
        if np.abs(F[N : N + b]).max(initial=0.0) > 1e-9 * np.abs(x[:N]).max():
            return 1.0
        work = lambda force: float((dδ * force).sum())
        constant = float(dx[:N] @ F[:N]) + work(x[N + b :].reshape(self.m, self.d))
        slope = -float(dx[:N] @ F[:N]) + work(dx[N + b :].reshape(self.m, self.d))
        G = lambda α: constant + α * slope - work(law.force(δ + α * dδ))
        start, end = G(0.0), G(1.0)
        if start >= 0 or abs(end) <= _LINE_SEARCH * abs(start) or end < 0:
            return 1.0
        low, high = 0.0, 1.0
        for _ in range(60):
            α = 0.5 * (low + high)
            value = G(α)
            if abs(value) <= 0.1 * abs(start):
                break
            low, high = (α, high) if value < 0 else (low, α)
        return max(α, 1e-3)
