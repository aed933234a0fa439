"""Frictional contact of sheets on dolfinx meshes, solved in full: no scene, no reduction.

A program for FEniCSx states sheets, supports, loads and contacts, and gets functions on its own meshes:

>>> upper = Sheet(mesh, thickness=1.0, young=210e3, poisson=0.3)                        # doctest: +SKIP
>>> root = Support(upper, lambda x: np.isclose(x[0], 0), rotation=(0, 0, 0))            # doctest: +SKIP
>>> press = Traction(upper, lambda x: x[0] > 50, (0, 0, -0.1))                          # doctest: +SKIP
>>> problem = ContactProblem([root, ...], [press], [Contact(lower, upper, friction=0.3)])  # doctest: +SKIP
>>> solution = problem.solve()                                                          # doctest: +SKIP
>>> solution.displacement(upper)                                     # a dolfinx Function  # doctest: +SKIP

Supports and loads may be changed between calls of :meth:`ContactProblem.solve`, which continues from the last solution:
friction remembers. Each solve is one of :mod:`fem_reference.full.load_path` on all freedoms, reactions and contact
forces. Contacts are node to surface: the vertices of the first sheet against the faces of the second. Units mm, N, MPa,
rad. Under ``mpirun`` the sparse system is distributed over the processes of the meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from dolfinx import fem
from dolfinx.io import XDMFFile
from scipy.sparse import block_diag, csr_matrix, hstack, vstack

from fem_reference.contact_pairs import Contact, Pairs
from fem_reference.full.equilibrium import Equilibrium, Parts, State
from fem_reference.full.friction import ContactFriction
from fem_reference.full.load_path import ContactFailure, Contacts, LoadPath, Penalty, Route, Solve, route_taken
from fem_reference.full.path import FullTrace, Point, extrapolated
from fem_reference.full.path import increments as in_increments
from fem_reference.sheet import Force, Sheet, Support, Traction

__all__ = [
    "Contact",
    "ContactFailure",
    "ContactProblem",
    "ContactState",
    "Force",
    "Sheet",
    "Solution",
    "Support",
    "Traction",
    "Writer",
]

FREE = 1e-9  # relative singular value of the supported rigid motions below which a sheet is free to move


class ContactProblem:
    """Sheets in frictional contact under supports and loads.

    Parameters
    ----------
    supports : sequence of Support
        Each sheet must be held; a later support overrides an earlier one.
    loads : sequence of Traction or Force
    contacts : sequence of Contact
    penalty : float
        ε/k, with k = E t of the softer sheet; the solution does not depend on it if `augmented`.
    augmented : bool
        Satisfy Coulomb's law exactly by augmentation.
    route : {"whole", "condensed"}
        See :mod:`fem_reference.full.load_path`.

    Attributes
    ----------
    sheets : tuple of Sheet

    Raises
    ------
    ValueError
        If a sheet is free to move, a place holds for no vertex, or surfaces do not face each other.
    """

    def __init__(
        self,
        supports: Sequence[Support],
        loads: Sequence[Traction | Force] = (),
        contacts: Sequence[Contact] = (),
        penalty: float = 1e3,
        augmented: bool = True,
        route: Route = "whole",
    ):
        every = [item.sheet for item in (*supports, *loads)]
        every += [sheet for contact in contacts for sheet in (contact.first, contact.second)]
        self.sheets = tuple(dict.fromkeys(every))
        if not supports or len({sheet.comm.size for sheet in self.sheets}) > 1:
            raise ValueError("a problem needs supports, and meshes that are distributed over the same processes")
        self.supports, self.loads, self.contacts = tuple(supports), tuple(loads), tuple(contacts)
        self.penalty, self.route = Penalty(penalty, augmented), route
        self._parts = Parts([sheet.shell for sheet in self.sheets], self.sheets[0].comm)
        self._values = block_diag([sheet.shell.vertex_values for sheet in self.sheets], format="csr")
        counts = [len(sheet.shell.surface.points) for sheet in self.sheets]
        self._first = dict(zip(self.sheets, np.concatenate([[0], np.cumsum(counts)])))
        self._rows, self.held = self._held_rows()
        self.pairs = [Pairs.of(contact) for contact in self.contacts]
        self._weights = [load.weights() for load in self.loads]
        none = csr_matrix((0, self._parts.offsets[-1]))
        C = vstack([none, *map(self._pair_rows, self.contacts, self.pairs)], format="csr")
        self._equilibrium = Equilibrium(self._parts, self._values[self._rows], C, 3, held=True, route=route)
        self._check_held()
        μ = [np.full(len(pairs.vertex), contact.friction) for contact, pairs in zip(self.contacts, self.pairs)]
        k = [
            np.full(len(pairs.vertex), min(s.shell.young * s.shell.thickness for s in (contact.first, contact.second)))
            for contact, pairs in zip(self.contacts, self.pairs)
        ]
        friction, k = (np.concatenate([*values, np.zeros(0)]) for values in (μ, k))
        self._constants = Contacts(ContactFriction.constant(friction), k, np.zeros(len(k)))
        self._gap = np.concatenate([*(pairs.gap for pairs in self.pairs), np.zeros(0)])
        self._now: tuple[State, np.ndarray, np.ndarray, np.ndarray] | None = None

    def unpack(self, unknowns: np.ndarray) -> State:
        """Freedoms, reactions and contact forces from the vector of all unknowns."""
        return self._equilibrium.unpack(unknowns)

    def vertex_values(self, sheet: Sheet, u: np.ndarray) -> np.ndarray:
        """(n, 6) displacements and rotations of a sheet's vertices from the freedoms (N,) of all sheets."""
        first = 6 * self._first[sheet]
        return (self._values @ u)[first : first + 6 * len(sheet.shell.surface.points)].reshape(-1, 6)

    def contact_force(self, sheet: Sheet, force: np.ndarray) -> np.ndarray:
        """(n, 3) forces on a sheet's vertices from the forces (m, 3) of all contacts, N."""
        total, first = np.zeros((len(sheet.shell.surface.points), 3)), 0
        for contact, pairs in zip(self.contacts, self.pairs):
            own = force[first : (first := first + len(pairs.vertex))]
            on_second = np.einsum("mij,mj->mi", pairs.frame, own)
            for body, sign, patches in (
                (contact.first, -1.0, pairs.patches[0]),
                (contact.second, 1.0, pairs.patches[1]),
            ):
                if body is sheet:
                    triangle = np.concatenate([patch.triangle for patch in patches])
                    weight = np.concatenate([patch.barycentric for patch in patches])
                    vertices = sheet.shell.surface.triangles[triangle]
                    np.add.at(total, vertices, sign * weight[:, :, None] * on_second[:, None, :])
        return total

    def _held_rows(self) -> tuple[np.ndarray, list[tuple[Support, int]]]:
        """Rows of the vertex values that are prescribed, and the support and component of each."""
        by_row: dict[int, tuple[Support, int]] = {}
        for support in self.supports:
            vertices = support.sheet.marked(support.where) + self._first[support.sheet]
            for component, value in enumerate((*support.displacement, *support.rotation)):
                if value is not None:
                    by_row.update((6 * int(v) + component, (support, component)) for v in vertices)
        rows = np.array(sorted(by_row), dtype=np.int64)
        return rows, [by_row[row] for row in rows]

    def _check_held(self) -> None:
        """Refuse sheets that are free to move without contact."""
        B, rows = self._equilibrium.B, self._rows
        for i, sheet in enumerate(self.sheets):
            lo, hi = self._parts.offsets[i : i + 2]
            modes = sheet.shell.rigid_modes * np.array([1, 1, 1] + 3 * [1 / sheet.shell.surface.diameter])
            mine = (rows >= 6 * self._first[sheet]) & (
                rows < 6 * (self._first[sheet] + len(sheet.shell.surface.points))
            )
            read = B[np.flatnonzero(mine), lo:hi] @ modes
            size = np.linalg.svd(read, compute_uv=False) if len(read) else np.zeros(0)
            if len(size) < 6 or size[5] <= FREE * size[0]:
                free = 6 - int((size > FREE * max(size.max(initial=0.0), 1e-300)).sum())
                raise ValueError(
                    f"sheet {sheet.name!r}: {free} rigid-body motions are free; add supports (contact alone does not "
                    "count)"
                )

    def _pair_rows(self, contact: Contact, pairs: Pairs) -> csr_matrix:
        """(3 m, N) motion of the second sheet less that of the first."""
        number = {sheet: i for i, sheet in enumerate(self.sheets)}
        blocks = [csr_matrix((3 * len(pairs.vertex), sheet.shell.ndof)) for sheet in self.sheets]
        for body, (sheet, sign) in enumerate(((contact.first, -1.0), (contact.second, 1.0))):
            blocks[number[sheet]] = blocks[number[sheet]] + sign * pairs.rows(sheet.shell, body)
        return hstack(blocks, format="csr")

    def _prescribed(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodal forces (N,) and values of the supported rows, as supports and loads now say."""
        nodal = np.zeros(self._values.shape[0])
        for load, weight in zip(self.loads, self._weights):
            first = 6 * self._first[load.sheet]
            table = nodal[first : first + 6 * len(weight)].reshape(-1, 6)
            table[:, :3] += weight[:, None] * np.asarray(load.value, dtype=float)
        values = [(*support.displacement, *support.rotation)[component] for support, component in self.held]
        if None in values:
            raise ValueError("a support may change its values, but not which components are free")
        return self._values.T @ nodal, np.array(values, dtype=float)

    def solve(self, increments: int = 1, tolerance: float | None = None) -> Solution:
        """Go on from the last solution, at first from the unloaded sheets, to the present supports and loads.

        Sheets that overlap at first are separated on the way.

        Parameters
        ----------
        increments : int
            Steps of backward Euler's method, from each of which slip is measured anew.
        tolerance : float, optional
            Follow the path instead, with at most this error of a contact's position in a step, mm.

        Raises
        ------
        ContactFailure
            If no equilibrium is found; the message names the contact and a remedy.
        ValueError
            If a support changed which components are free.
        """
        equilibrium, m = self._equilibrium, len(self._gap)
        p, v = self._prescribed()
        if self._now is None:
            state = State(np.zeros(equilibrium.N), np.zeros(equilibrium.b), np.zeros((m, 3)))
            anchor, p0, v0, gap = np.zeros((m, 2)), np.zeros_like(p), np.zeros_like(v), np.maximum(self._gap, 0.0)
        else:
            (state, anchor, p0, v0), gap = self._now, self._gap
        path = LoadPath(
            equilibrium,
            self._constants,
            (p0, v0, gap),
            (p, v, self._gap),
            self.penalty,
            self.route,
            ("", 1),
            self._where,
        )
        start = path.start_point(state, anchor)
        if not m:
            end = replace(start, share=1.0, unknowns=equilibrium.linear(p, v, state.force).stacked)
            trace = FullTrace.start(0, 3)
        elif tolerance is None:
            end, trace = in_increments(path.solve, start, increments)
        else:
            end, trace = extrapolated(path.solve, start, tolerance)
        self._now = equilibrium.unpack(end.unknowns), end.position, p, v
        return Solution(self, end, trace, tuple(path.solves))

    def _where(self, share, contact) -> str:
        """A share of the load and a contact for an error message."""
        for item, pairs in zip(self.contacts, self.pairs):
            if contact is not None and contact < len(pairs.vertex):
                x, y, z = item.first.shell.surface.points[pairs.vertex[contact]]
                names = f"{item.first.name!r} on {item.second.name!r}"
                return (
                    f"at {share:.3g} of the change of load, worst at contact of {names} near {x:.4g}, {y:.4g}, {z:.4g}"
                )
            contact = None if contact is None else contact - len(pairs.vertex)
        return f"at {share:.3g} of the change of load"


@dataclass(frozen=True)
class ContactState:
    """The m pairs of a contact.

    Attributes
    ----------
    point : (m, 3) array
        Vertices of the first sheet, mm.
    frame : (m, 3, 3) array
        Columns n, t1, t2; n points from the first to the second sheet.
    gap : (m,) array
        mm.
    slip : (m, 2) array
        Net slip under load since the last solve, mm.
    force : (m, 3) array
        Force of the first on the second sheet along n, t1, t2, N; compression is positive.
    state : (m,) array
        A :class:`mic.contact.states.ContactState` each: open, stick or slip.
    """

    point: np.ndarray
    frame: np.ndarray
    gap: np.ndarray
    slip: np.ndarray
    force: np.ndarray
    state: np.ndarray


class Solution:
    """An equilibrium of a :class:`ContactProblem`.

    Attributes
    ----------
    contacts : tuple of ContactState
        In the order of the problem's contacts.
    dissipated : float
        Work of friction since the last solve, N mm.
    route : str
        Route of the solves, and how many went by the other one because it did not converge.
    history : tuple of Solve
        Every Newton solve with its residuals, in order.
    """

    def __init__(self, problem: ContactProblem, end: Point, trace: FullTrace, history: tuple[Solve, ...]):
        self._problem, self._state = problem, problem.unpack(end.unknowns)
        self.dissipated, self.history = float(trace.work.sum()), history
        self.route = route_taken(problem.route, history)
        found, first = [], 0
        for contact, (vertex, frame) in zip(problem.contacts, ((pairs.vertex, pairs.frame) for pairs in problem.pairs)):
            own = slice(first, first := first + len(vertex))
            point = contact.first.shell.surface.points[vertex]
            arrays = (end.gap[own], trace.slip[own], self._state.force[own], end.state[own])
            found.append(ContactState(point, frame, *arrays))
        self.contacts = tuple(found)

    def displacement(self, sheet: Sheet) -> fem.Function:
        """Displacement of the mid-surface, mm: a linear vector Function on the sheet's mesh."""
        return sheet.function(self._values(sheet)[:, :3], "displacement")

    def rotation(self, sheet: Sheet) -> fem.Function:
        """Rotation, rad: a linear vector Function on the sheet's mesh."""
        return sheet.function(self._values(sheet)[:, 3:], "rotation")

    def contact_traction(self, sheet: Sheet) -> fem.Function:
        """Contact force per area on the sheet, N/mm²: a linear vector Function on the sheet's mesh."""
        surface = sheet.shell.surface
        area = np.bincount(surface.triangles.ravel(), np.repeat(surface.areas / 3, 3), minlength=len(surface.points))
        return sheet.function(self._problem.contact_force(sheet, self._state.force) / area[:, None], "contact_traction")

    def reaction(self, support: Support) -> np.ndarray:
        """(6,) sums of the forces, N, and moments, N mm, of a support on its sheet, each at its own vertex.

        A component that a later support overrides counts there.
        """
        total = np.zeros(6)
        for value, (owner, component) in zip(self._state.reaction, self._problem.held):
            total[component] += value * (owner is support)
        return total

    def _values(self, sheet) -> np.ndarray:
        return self._problem.vertex_values(sheet, self._state.u)


class Writer:
    """XDMF files of the sheets for ParaView, one for each sheet, with one time step for each solution.

    Parameters
    ----------
    problem : ContactProblem
        Its sheets need different names.
    folder : Path or str
        Existing folder; each sheet gets ``NAME.xdmf`` and ``NAME.h5``.
    """

    def __init__(self, problem: ContactProblem, folder: Path | str):
        names = [sheet.name for sheet in problem.sheets]
        if len(set(names)) < len(names):
            raise ValueError(f"sheets are named {', '.join(names)}: give each its own name to write their files")
        self._files = {}
        for sheet in problem.sheets:
            file = XDMFFile(sheet.mesh.comm, str(Path(folder) / f"{sheet.name}.xdmf"), "w")
            file.write_mesh(sheet.mesh)
            self._files[sheet] = file

    def write(self, solution: Solution, time: float = 0.0) -> None:
        """Append displacement, rotation and contact traction of all sheets."""
        for sheet, file in self._files.items():
            for function in (solution.displacement, solution.rotation, solution.contact_traction):
                file.write_function(function(sheet), time)

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *exception) -> None:
        for file in self._files.values():
            file.close()
