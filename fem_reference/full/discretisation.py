"""Finite elements of all parts of an assembly, and the assembly's rows over their freedoms: ``row · blkdiag(L_p)``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import block_diag, csr_matrix, vstack

from fem_reference.full.equilibrium import Equilibrium, Parts
from fem_reference.full.load_path import Route
from fem_reference.provider import shell_part
from mic.compliance.blocks import Blocks
from mic.compliance.support import motion_size, statically_determinate
from mic.model.rest_rows import RestRows
from mic.process.plan import Limit, Step, row_compliance

__all__ = ["Discretisation", "System"]

REDUNDANT = 1e-12  # squared distance of a normalised row from the span of the others
SOFT = 1e7  # compliance of the springs of resting parts, in 1/k of the stiffest contact
CONTRADICTS = 1e-8  # largest misfit of a redundant row, relative to the largest value


@dataclass(frozen=True)
class System:
    """Equilibrium of a step: bilateral rows (b, N), the independent ones, the others as their combinations.

    The last rows are the rest rows `place`, which read the positions of resting parts. Each acts as a spring of
    compliance `springs` (k,), mm/N; 0 for parts that are not yet placed.
    """

    rows: csr_matrix
    independent: np.ndarray
    combination: np.ndarray
    names: list[str]
    equilibrium: Equilibrium
    place: np.ndarray
    springs: np.ndarray

    @property
    def soft(self) -> np.ndarray:
        """(k,) numbers of the rows that are springs of resting parts."""
        return self.rows.shape[0] - len(self.place) + np.flatnonzero(self.springs)

    def consistent(self, value: np.ndarray) -> np.ndarray:
        """Values of the independent rows, after checking those of the others.

        Raises
        ------
        ValueError
            If a redundant row contradicts the others; the message names it.
        """
        others = np.setdiff1d(np.arange(len(value)), self.independent)
        misfit = np.abs(value[others] - self.combination @ value[self.independent])
        bad = np.flatnonzero(misfit > CONTRADICTS * np.abs(value).max(initial=0.0))
        if len(bad):
            name = self.names[others[bad[0]]]
            raise ValueError(f"{name} is redundant and contradicts the other rows by {misfit[bad[0]]:.2g}; remove it")
        return value[self.independent]


class Discretisation:
    """Finite elements of all parts, and the assembly's rows over their freedoms.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    parts : sequence of mic.compliance.part.Part
        Parts of the assembly, or the same parts on other meshes.
    comm : MPI.Comm
    resting : iterable of int
        Parts that rest by contact alone in some step.
    route : {"whole", "condensed"}
        Route of the linear solves.

    Attributes
    ----------
    parts : Parts
    readings : (F, N) csr_matrix
        The functionals of all parts over their freedoms.
    rows : dict of str to (r, N) csr_matrix
        Rows of the assembly and of `rest`.
    rest : RestRows
    rigid : Blocks
        Readings of the parts' rigid motions by the functionals; without compliance.
    contact_stiffness : (m,) array
        k = E t of each contact's softer sheet, N/mm.
    """

    def __init__(self, assembly, parts, comm, resting=(), route: Route = "whole"):
        self.assembly, self.route = assembly, route
        shells = [shell_part(part, comm) for part in parts]
        self.parts = Parts(shells, comm)
        L = [shell.functional_matrix(part.functionals) for shell, part in zip(shells, parts)]
        self.readings = block_diag(L, format="csr")
        self.rows = {kind: (rows @ self.readings).tocsr() for kind, rows in assembly.rows.items()}
        readings = tuple(np.asarray(reading @ shell.rigid_modes) for reading, shell in zip(L, shells))
        self.rigid = Blocks(tuple(np.zeros((len(G), 0)) for G in readings), readings)
        self.rest = RestRows.of(assembly, self.rigid, resting)
        self.rows["rest"] = (self.rest.rows @ self.readings).tocsr()
        d = assembly.contacts.dimension
        k = np.array([part.young * part.thickness for part in parts])
        contact = assembly.rows["contact"]
        body = np.searchsorted(assembly.offsets, contact.indices, side="right") - 1
        edges = contact.indptr
        self.contact_stiffness = np.array([k[body[edges[i] : edges[i + 1]]].min() for i in range(0, len(edges) - 1, d)])
        self._systems: dict[tuple, System] = {}

    def contact(self, u: np.ndarray, stops: tuple[Limit, ...] = ()) -> np.ndarray:
        """(m + s, d) relative displacements δ of the contacts, and of stops."""
        return (self._contact_rows(stops) @ u).reshape(-1, self.assembly.contacts.dimension)

    def stiffness(self, stops: tuple[Limit, ...]) -> np.ndarray:
        """(m + s,) k of the contacts and of the stops; stops have that of the stiffest sheet."""
        k = max(part.young * part.thickness for part in self.assembly.parts)
        return np.concatenate([self.contact_stiffness, np.full(len(stops), k)])

    def _contact_rows(self, stops: tuple[Limit, ...]) -> csr_matrix:
        """Rows of the contacts, then of the stops, whose gap closes in the direction of the push; tangential rows of
        stops are zero."""
        none = csr_matrix((self.assembly.contacts.dimension - 1, self.parts.offsets[-1]))
        rows = [self.rows["contact"]]
        for stop in stops:
            kind, row = stop.row
            rows += [-stop.sign * self.rows[kind][row], none]
        return vstack(rows, format="csr")

    def vertex_fields(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """(n_points, 6) displacements and rotations at the vertices of each part, by name."""
        return {
            part.name: (shell.vertex_values @ u[lo:hi]).reshape(-1, 6)
            for part, shell, lo, hi in zip(
                self.assembly.parts, self.parts.shells, self.parts.offsets, self.parts.offsets[1:]
            )
        }

    def elimination(self) -> tuple[float, float]:
        """Operations of this process in the last factorisation of each step, and memory of these factors, MB: sums."""
        costs = [system.equilibrium.elimination for system in self._systems.values()]
        return sum(operations for operations, _ in costs), sum(memory for _, memory in costs)

    def system(self, step: Step) -> System:
        """The system of a step with its bilateral rows, resting parts and stops; cached.

        Raises
        ------
        FreeMotion
            If its rows leave a part free to move.
        """
        held, stops = step.bilateral, step.stops
        key = held, stops, step.parked
        if key not in self._systems:
            functional_rows = vstack([self.assembly.rows[kind][i] for kind, i in held], format="csr")
            if step.resting:
                place = self.rest.completing_rows(functional_rows, self.rigid)
            else:
                statically_determinate(self.rigid.rigid(functional_rows), motion_size(self.rigid.G))
                place = np.zeros(0, dtype=int)
            B = vstack([*(self.rows[kind][i] for kind, i in held), self.rows["rest"][place]], format="csr")
            springs = np.zeros(len(place))
            if len(place):  # parts rest on contacts
                springs[~np.isin(self.rest.part[place], step.parked)] = SOFT / self.contact_stiffness.max()
            soft = row_compliance(self.assembly.scene, held)
            soft = np.concatenate([np.zeros(len(held)) if soft is None else soft, springs])
            independent, combination = _independent(B, soft)
            names = [self.assembly.labels[kind][i] for kind, i in held] + ["a part that rests"] * len(place)
            contacts = self._contact_rows(stops)
            dimension = self.assembly.contacts.dimension
            given = soft[independent] if soft.any() else None
            equilibrium = Equilibrium(
                self.parts, B[independent], contacts, dimension, given, not step.resting, self.route
            )
            self._systems[key] = System(B, independent, combination, names, equilibrium, place, springs)
        return self._systems[key]


def _independent(B, soft):
    """Independent rows (ascending), and the others as their combinations; rows that yield are independent."""
    scale = 1 / np.sqrt(np.asarray(B.multiply(B).sum(axis=1)).ravel())
    gram = (B @ B.T).toarray() * np.outer(scale, scale)
    gram[soft > 0], gram[:, soft > 0] = 0.0, 0.0
    gram[soft > 0, soft > 0] = 1.0
    _, pivot, rank, _ = lapack.dpstrf(gram, tol=REDUNDANT, lower=1)
    kept = np.sort(pivot[:rank] - 1)
    others = np.setdiff1d(np.arange(B.shape[0]), kept)
    combination = np.linalg.solve(gram[np.ix_(kept, kept)], gram[np.ix_(kept, others)]).T
    return kept, combination * scale[kept] / scale[others, None]
