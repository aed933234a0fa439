"""Equilibrium of all parts under bilateral rows and frictional contact: one sparse system, Newton, any number of ranks.

Unknowns are the freedoms u of all parts, the forces r of the bilateral rows B and the contact forces f of the rows C,
with

    K u = Bᵀ r + Cᵀ f + p,        B u + c r = v,                                                       (1)

c the compliance of rows that yield, 0 of the others, K the block-diagonal stiffness of the free parts, and Coulomb's
law in its penalty (augmented-Lagrangian) form. With the gap g = g⁰ + δ_n and the slip s = δ_t − a of each contact,
δ = C u, the trial force is

    y_n = f̂_n − ε g,              y_t = f̂_t − ε s,                                                     (2)

and the return mapping, not associated (the bound scales the trial force along itself and leaves f_n alone), is

    f_n = max(0, y_n),            f_t = y_t                  where ‖y_t‖ ≤ g(f_n)     (stick)           (3)
                                  f_t = g(f_n) y_t/‖y_t‖     elsewhere                (slip),

with g(f_n) = μ f_n, or g(f_n) = μ(f_n/A) f_n where the coefficient depends on pressure.

f̂ = (0, f_t of the increment before) is the plain penalty method, whose elastic slip f_t/ε is recovered on reversal;
repeating f̂ ← f (Uzawa) drives ε g → 0 and ε s → 0 in contact, so that (3) becomes Coulomb's law proper whatever ε.

A contact that yields before it slips has a true tangential stiffness k_t A. For its tangential rows ε = k_t A and
f̂_t = 0, always: the elastic slip −f_t/ε from a, where its slider stands, is then no error to be removed but the
contact's own. In contact that holds, the slider moves to δ_t + f_t/ε. Where the sheets yield through their thickness,
by c f_n, the same holds of the normal row, with ε = 1/c.

Newton's method treats (u, r, f) together. Per contact, multiplied so that each line is a force (k a stiffness of the
sheets):

    open     f = 0
    closed   k g + (k/ε)(f_n − f̂_n) = 0
    stick    k s + (k/ε)(f_t − f̂_t) = 0                                                                 (4)
    slip     f_t − g(f_n) τ = 0,   τ = y_t/‖y_t‖,    dτ = −ε (I − ττᵀ) ds/‖y_t‖

Eliminating f from (4) gives the consistent tangent K + Cᵀ(−∂f/∂δ)C of the textbooks, so the iterates are the same;
kept as unknowns, the forces leave the tangent sparse where a contact's patch covers many nodes, its condition does
not grow with ε, and f carries no rounding error of ε times a displacement. The tangent is unsymmetric where contacts
slip.

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
from fem_reference.full.coulomb import contact_forces
from fem_reference.full.friction import ContactFriction
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["ContactLaw", "Equilibrium", "Iteration", "NoConvergence", "Parts", "State"]

MAX_ITERATIONS = 60
_PATIENCE = 25  # iterations with full steps
_TOLERANCE = 1e-11  # of the largest force in the system
_WORST_ROUNDING = 1e-7
_CORRECTIONS = 6  # of a condensed solution by what it leaves in the whole system
_LINE_SEARCH = 0.8  # a full step whose work falls below this share of the start's is taken as it is
CONDENSED = 5000  # contact forces at most: what each moves at the others is 200 MB then
_ICNTL_EXTRA_MEMORY, _INFOG_STATUS = 14, 1  # MUMPS


class NoConvergence(RuntimeError):
    """Newton's method or the factorisation failed; `contact` is the worst contact, or None."""

    def __init__(self, message: str, contact: int | None = None):
        super().__init__(message)
        self.contact = contact


class Parts:
    """Where the freedoms of several parts live: their natural order, and the rows of the processes.

    Naturally, freedoms are numbered part after part, each part's as `ShellPart` numbers them.

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
        """All parts, on one process, held on the rows that are asked for first: independent ones that hold them."""
        if self._held is None:
            self._held = HeldParts(self.stiffness, rows)
        return self._held

    def layout(self, extra: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of this process and the place of every unknown, with `extra` unknowns that the last process owns.

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
class ContactLaw:
    """Law (2)–(3) of m contacts in one increment.

    Attributes
    ----------
    friction : ContactFriction
    gap : (m,) array
        g⁰, mm, with the parts' deviations.
    anchor : (m, d) array
        Where slip is measured from, mm, a slider's place where contacts yield; the normal column is not used.
    estimate : (m, d) array
        f̂, N, but for the tangential rows of contacts that yield.
    penalty : (m,) array
        ε, N/mm, but for the tangential rows of contacts that yield.
    stiffness : (m,) array
        k, N/mm.
    layer : (m,) array or 0
        c, mm/N.
    """

    friction: ContactFriction
    gap: np.ndarray
    anchor: np.ndarray
    estimate: np.ndarray
    penalty: np.ndarray
    stiffness: np.ndarray
    layer: np.ndarray | float = 0.0

    def displacement(self, δ: np.ndarray) -> np.ndarray:
        """(m, d) gap and slip from the relative displacements δ."""
        moved = δ - self.anchor
        moved[:, 0] = self.gap + δ[:, 0]
        return moved

    @cached_property
    def _ε(self):
        """(m, d) ε of every row."""
        ε = np.repeat(self.penalty[:, None], self.estimate.shape[1], axis=1)
        yields = self.friction.compliance > 0
        ε[yields, 1:] = 1 / self.friction.compliance[yields, None]
        layer = np.broadcast_to(self.layer, len(ε))
        ε[layer > 0, 0] = 1 / layer[layer > 0]
        return ε

    @cached_property
    def _held(self):
        """(m, d) f̂ of every row."""
        f = self.estimate.copy()
        f[self.friction.compliance > 0, 1:] = 0.0
        f[np.broadcast_to(self.layer, len(f)) > 0, 0] = 0.0
        return f

    def augmented(self, force: np.ndarray) -> ContactLaw:
        """f̂ ← f."""
        law = replace(self, estimate=force)
        return replace(law, estimate=law._held)

    def _trial(self, δ):
        y = self._held - self._ε * self.displacement(δ)
        return y, np.linalg.norm(y[:, 1:], axis=1)

    def force(self, δ: np.ndarray) -> np.ndarray:
        """The return mapping (3)."""
        y, size = self._trial(δ)
        f = y.copy()
        f[:, 0] = np.maximum(0, y[:, 0])
        bound, _ = self.friction.bound(f[:, 0])
        f[:, 1:] *= np.where(size > bound, bound / np.where(size > 0, size, 1), 1)[:, None]
        return f

    def state(self, δ: np.ndarray) -> np.ndarray:
        """(m,) open, stick or slip; a closed contact without friction slips."""
        y, size = self._trial(δ)
        closed = y[:, 0] > 0
        bound, _ = self.friction.bound(np.maximum(y[:, 0], 0))
        stick = (size <= bound) & (bound > 0)
        return np.where(closed, np.where(stick, STICK, SLIP), OPEN)

    def reverses(self, δ: np.ndarray, new: np.ndarray) -> bool:
        """Whether a contact that slips at δ and at `new` turns by more than 90° between them: a kink that Newton
        steps over."""
        (y, _), (z, _) = self._trial(δ), self._trial(new)
        bound, _ = self.friction.bound(np.maximum(y[:, 0], 0))
        slips = (self.state(δ) == SLIP) & (self.state(new) == SLIP) & (bound > 0)
        return bool((slips & (np.einsum("kj,kj->k", y[:, 1:], z[:, 1:]) < 0)).any())

    def linearise(self, δ: np.ndarray, f: np.ndarray, state: np.ndarray):
        """Residual (m, d) of the lines (4) and its derivatives by δ and f, both (m, d, d)."""
        m, d = f.shape
        y, size = self._trial(δ)
        moved = self.displacement(δ)
        residual, by_δ, by_f = f.copy(), np.zeros((m, d, d)), np.tile(np.eye(d), (m, 1, 1))
        k, ε = self.stiffness, self._ε
        g, slope = self.friction.bound(np.maximum(f[:, 0], 0))
        g = g + slope * np.minimum(f[:, 0], 0)  # on the way, a normal force may pull
        trial, _ = self.friction.bound(np.maximum(y[:, 0], 0))
        closed, stick, slip = state != OPEN, state == STICK, (state == SLIP) & (size > 0) & (trial > 0)

        def elastic(which, component):
            soft = k / ε[:, component]
            residual[which, component] = (k * moved[:, component] + soft * (f - self._held)[:, component])[which]
            by_δ[which, component, component] = k[which]
            by_f[which, component, component] = soft[which]

        elastic(closed, 0)
        for j in range(1, d):
            elastic(stick, j)
        τ = y[slip, 1:] / size[slip, None]
        residual[slip, 1:] = f[slip, 1:] - g[slip, None] * τ
        by_f[slip, 1:, 0] = -slope[slip, None] * τ
        turning = trial[slip] * ε[slip, -1] / size[slip]
        by_δ[slip, 1:, 1:] = turning[:, None, None] * (np.eye(d - 1) - τ[:, :, None] * τ[:, None, :])
        return residual, by_δ, by_f


@dataclass(frozen=True)
class Iteration:
    """One Newton iteration.

    Attributes
    ----------
    residual : float
        Largest residual of (1) and (4) at its end, N, as a share of the largest force in the system.
    step : float
        Step length.
    open, stick, slip : int
        Contacts in each state, at its end.
    changed : int
        Contacts whose state it changed.
    """

    residual: float
    step: float
    open: int
    stick: int
    slip: int
    changed: int

    @classmethod
    def of(cls, residual: float, step: float, state: np.ndarray, changed: int) -> Iteration:
        """With the contacts' states (m,) counted."""
        return cls(residual, step, *(int((state == s).sum()) for s in (OPEN, STICK, SLIP)), changed)


@dataclass(frozen=True)
class State:
    """Unknowns of (1).

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
        """(N + b + m d,) u, r and f, one after the other."""
        return np.concatenate([self.u, self.reaction, self.force.ravel()])


class Equilibrium:
    """System (1) with (4): the tangent's pattern is set up once, its symbolic factorisation serves all later solves.

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
        Whether the bilateral rows alone hold all parts. On one process the linear part is then condensed onto the
        contact forces (:mod:`fem_reference.full.condensation`).
    """

    def __init__(
        self,
        parts: Parts,
        B: csr_matrix,
        C: csr_matrix,
        dimension: int,
        yielding: np.ndarray | None = None,
        held: bool = False,
    ):
        self.parts, self.B, self.C, self.d = parts, B.tocsr(), C.tocsr(), dimension
        self.N, self.b, self.m = parts.offsets[-1], B.shape[0], C.shape[0] // dimension
        comm = parts.comm
        owned, self._place = parts.layout(self.b + self.m * dimension)
        self._last = comm.rank == comm.size - 1
        self._yielding, self._held = yielding, held and comm.size == 1
        self.condensable = self._held and self.m * dimension <= CONDENSED
        self._u_rows = owned[owned < self.N]
        BT, CT = self.B.T.tocsr()[self._u_rows], self.C.T.tocsr()[self._u_rows]
        self._balance = hstack([parts.stiffness, -BT, -CT], format="csr")  # of this process's freedoms

    @cached_property
    def _matrix(self) -> PETSc.Mat:
        """Of the unknowns (u, r, f), the lines of f to be set."""
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

    @cached_property
    def _ksp(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self.parts.comm)
        ksp.setOperators(self._matrix)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        self._factor = pc.getFactorMatrix()
        self._factor.setMumpsIcntl(_ICNTL_EXTRA_MEMORY, 80)
        return ksp

    def __del__(self):
        """Free the factors, hundreds of MB that petsc4py would keep to the end of the process.

        Freeing distributed ones is collective, and the processes do not forget them at the same moment: those stay.
        """
        if self.parts.comm.size == 1:
            for held in ("_factor", "_ksp", "_matrix"):
                if held in self.__dict__:
                    self.__dict__[held].destroy()

    # ------------------------------------------------------------------------------------------ sparse contact operator

    def _contact_pattern(self):
        """Columns of each contact's rows: every freedom that one of its d rows reads, then its d forces."""
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
        mine = np.empty(len(natural))
        mine[self._place] = natural
        vector.setArray(mine[lo:hi])

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
        if status < 0:
            raise NoConvergence(
                f"MUMPS reports INFOG(1) = {status}, INFOG(2) = "
                f"{self._factor.getMumpsInfog(2)} when it factorises the tangent"
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
        if self._held:
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
            After `MAX_ITERATIONS`, or where the tangent cannot be factorised.
        """
        N, b = self.N, self.b
        x = start.stacked
        δ = self._contact(x)
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
            δ = self._contact(x)
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
        """The same on the system that is condensed onto the contact forces, begun from forces (m, d).

        The law's penalty may be infinite: no contact yields then but those that do so of themselves. Returned are the
        solution, its contacts' states (m,) and the iterations, the residual of the last being that of the whole system,
        its bilateral rows among it.

        Raises
        ------
        NoConvergence
        """
        linear, history = self._condensation, []
        S, soft = linear.compliance(), 0.0 if self._yielding is None else self._yielding
        u, r, f = np.zeros(self.N), np.zeros(self.b), np.zeros_like(force)
        for _ in range(_CORRECTIONS):  # what rounding has left is less each time
            x = np.concatenate([u, r, f.ravel()])
            du, dr = linear.solve(p - self._balance @ x, v - self.B @ u - soft * r)
            force, iterations = contact_forces(S, self._contact(u + du), f, law, force)
            history += [Iteration.of(*one) for one in iterations]
            if force is None:
                raise NoConvergence("no contact forces were found on the condensed system")
            more, added = linear.solve(self.C.T @ (force - f).ravel(), np.zeros(self.b))
            u, r, f = u + du + more, r + dr + added, force
            x, δ = np.concatenate([u, r, f.ravel()]), self._contact(u)
            own = replace(law, penalty=law.stiffness).augmented(f) if np.isinf(law.penalty).any() else law
            state = own.state(δ)
            contact, _, _ = own.linearise(δ, f, state)
            residual, allowed = self._measure(x, p, contact, own)
            if largest := np.abs(x[self.N :]).max(initial=0.0):
                misfit = np.abs(self.B @ u + soft * r - v).max(initial=0.0)
                residual = max(residual, float(law.stiffness.max(initial=0.0) * misfit / largest))
            history.append(Iteration.of(residual, 1.0, state, 0))
            if residual <= allowed:
                return self.unpack(x), state, history
        raise NoConvergence(
            f"the condensed system's solution leaves {residual:.1e} of the largest force in the whole one, over "
            f"{allowed:.1e}"
        )

    @cached_property
    def _condensation(self) -> Condensation:
        return Condensation(self.parts.held(self.B), self.B, self._yielding, self.C)

    def _contact(self, x):
        return (self.C @ x[: self.N]).reshape(self.m, self.d)

    def unpack(self, x: np.ndarray) -> State:
        """The unknowns from (u, r, f) stacked."""
        return State(
            x[: self.N].copy(), x[self.N : self.N + self.b].copy(), x[self.N + self.b :].reshape(self.m, self.d).copy()
        )

    def _residual(self, x, p, v, contact):
        F = self._multiply(x) - np.concatenate([p, v, np.zeros(self.m * self.d)])
        F[self.N + self.b :] = contact.ravel()
        return F

    def _measure(self, x, p, contact, law):
        """Relative residual, and the one allowed: the tolerance, or what rounding makes of the sums where that is more.

        Rounding that leaves no digits to trust (a part that nothing holds any more has flown off) is no excuse.
        """
        N = self.N
        left = np.abs(self._balance @ x - p[self._u_rows]).max(initial=0.0)
        rounding = self._largest((self._magnitude @ np.abs(x)).max(initial=0.0))
        if self.m:
            rounding = max(
                rounding,
                float((law.stiffness * (np.abs(self.C) @ np.abs(x[:N])).reshape(self.m, self.d).max(axis=1)).max()),
            )
        scale = np.abs(x[N:]).max(initial=0.0)
        residual = max(self._largest(left), np.abs(contact).max(initial=0.0))
        nothing = 1e-13 * max(np.abs(law.stiffness * law.gap).max(initial=0.0), rounding if scale == 0 else 0.0)
        if scale <= nothing:  # no contact carries anything, nor does a row
            return (0.0 if residual <= nothing else np.inf), 0.0
        return residual / scale, min(max(_TOLERANCE, 1e-14 * rounding / scale), _WORST_ROUNDING)

    def _step_length(self, x, dx, F, law, state, iteration):
        """α with G(α) = du·(K u(α) − p − Cᵀ f(u(α))) = 0, u(α) = u + α du: the residual does no more work on the step.

        At first full steps find the contacts that open and close fastest, and only a slip that turns back is searched
        along; after `_PATIENCE` iterations every step that changes a state is. A step that moves the bilateral rows
        is taken whole.
        """
        N, b = self.N, self.b
        δ, dδ = self._contact(x), self._contact(dx)
        if not law.reverses(δ, δ + dδ) and (iteration < _PATIENCE or (law.state(δ + dδ) == state).all()):
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
