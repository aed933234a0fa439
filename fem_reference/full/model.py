"""The full frictional contact solve: all parts' finite elements, every stage of the process, no reduction.

What the reduced model (`mic.process`) is judged by. Both work on the same `Assembly`, and they share what its scene
*means*: the rows, the plan of the stages (`mic.process.plan`), and what a sample's deviations ask of them
(`mic.process.drive`). They share nothing of how it is *solved*: here each row becomes a sparse row over the freedoms
of all parts, shapes are found by finite elements, and each increment of each stage is a Newton solve of
`fem_reference.full.equilibrium`. Influence coefficients appear nowhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI
from scipy.sparse import block_diag, csr_matrix

from fem_reference.full.discretisation import Discretisation
from fem_reference.full.equilibrium import Equilibrium
from fem_reference.full.friction import friction_of
from fem_reference.full.stage import ContactFailure, FullResolution, FullStage, FullState, Penalty, Solve
from mic.contact import laws
from mic.model.characteristics import Characteristics
from mic.model.deviated_geometry import deviated_parts, gap_change
from mic.model.shape import controlling_forces, datum_rows, known_shapes, thickening
from mic.model.sources import sources, thickness_changes, with_deviations
from mic.process.drive import drive
from mic.process.plan import plan_assembly

__all__ = ["LAWS", "ContactFailure", "FullEvaluation", "FullModel", "FullResolution", "Solve"]

#: Names of the laws that the full solve obeys: those that keep a slipping contact closed, and those without friction.
LAWS = tuple(law.name for law in laws.LAWS.values() if law.shift == 1.0 or not law.frictional)


@dataclass(frozen=True)
class FullEvaluation:
    """Outcome of one assembly.

    Attributes
    ----------
    law : str
    deviations : (p,) array
    resolutions : dict of str to FullResolution
        By stage, for the stages that resolve contact.
    measurements : (k,) array
        Key characteristics, mm from nominal; empty without a measure stage.
    history : tuple of Solve
        Every Newton solve, in order.
    freedoms : dict of str to (N,) array
        u at the end of each stage, in natural order.
    mesh : Discretisation
        What the freedoms belong to.
    """

    law: str
    deviations: np.ndarray
    resolutions: dict[str, FullResolution]
    measurements: np.ndarray
    history: tuple[Solve, ...]
    freedoms: dict[str, np.ndarray]
    mesh: Discretisation

    def field(self, stage: str) -> dict[str, np.ndarray]:
        """Displacements and rotations (n_points, 6) at the vertices of each part at the end of a stage, mm and rad.

        They are measured from the stress-free shape; the shape deviation is not part of them.
        """
        return self.mesh.vertex_fields(self.freedoms[stage])

    def strain_energy(self, stage: str) -> float:
        """Strain energy of all parts at the end of a stage, N mm."""
        parts, u = self.mesh.parts, self.freedoms[stage]
        owned, _ = parts.layout(0)
        return parts.comm.allreduce(0.5 * float(u[owned] @ (parts.stiffness @ u)))


class FullModel:
    """Full finite-element contact model of an assembly.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
        With contact at pairs or at every node: what `mic.model.assembly.assemble` made.
    deviated : bool
        Solve on meshes that carry each sample's shape deviation (stiffness, normals, gaps), not on the nominal ones.
    comm : MPI.Comm
        Processes that share the sparse system. The result is whole, and the same, on each.
    penalty : float
        ε/k, with k = E t of the softer sheet of the pair: the order of a sheet's stiffest response to a force spread
        over an area, so that a relative penetration of about 1/penalty is left.
    augmented : bool
        Remove that error by augmentation (Uzawa); paths that are followed need it.
    path_tolerance : float
        Of paths that are followed: largest error of a contact's position in a step, mm.
    """

    def __init__(
        self,
        assembly,
        deviated: bool = False,
        comm: MPI.Comm = MPI.COMM_WORLD,
        penalty: float = 1e3,
        augmented: bool = True,
        path_tolerance: float = 1e-4,
    ):
        for name, value in (("penalty", penalty), ("path_tolerance", path_tolerance)):
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive, not {value}")
        self.assembly, self.deviated, self.comm = assembly, deviated, comm
        self.penalty, self.path_tolerance = Penalty(float(penalty), augmented), float(path_tolerance)
        self.plans = plan_assembly(assembly)
        followed = [plan.name for plan in self.plans if plan.resolves and plan.path == "followed"]
        if followed and not augmented and any(zone.frictional for zone in assembly.scene.zones):
            raise ValueError(
                f"stages ({', '.join(followed)}): a path is followed between exact equilibria, and the penalty method "
                "leaves an elastic slip; give these stages increments, or augment"
            )

    @cached_property
    def nominal(self) -> Discretisation:
        """The parts on their nominal meshes."""
        return Discretisation(self.assembly, self.assembly.parts, self.comm, self._resting)

    @property
    def _resting(self) -> set[int]:
        """Parts that rest by contact alone in some step."""
        return {part for plan in self.plans for step in plan.steps for part in step.resting}

    @cached_property
    def unit_shapes(self) -> np.ndarray:
        """(N, p) freedoms of the shape that each unit deviation gives its part (zero for those that give none).

        Every part is held on its datum rows (:mod:`mic.model.shape`) while the source's force acts, or those that make
        the shape that is known.
        """
        assembly, mesh = self.assembly, self.nominal
        loads = [source.load(assembly.labels, assembly.rows) for source in sources(assembly.scene)]
        known = list(known_shapes(assembly))
        shape = np.zeros((mesh.parts.offsets[-1], len(loads)))
        grown = [source.expansion() for source in sources(assembly.scene)]
        if all(load is None for load in loads) and not known and not any(grown):
            return shape
        support = block_diag([datum_rows(assembly, p, G) for p, G in enumerate(mesh.rigid.G)], format="csr")
        held = Equilibrium(mesh.parts, (support @ mesh.readings).tocsr(), csr_matrix((0, len(shape))), 1)

        def shaped(load) -> np.ndarray:
            nodal = (load @ mesh.readings).toarray().ravel()
            return held.linear(nodal, np.zeros(support.shape[0]), np.zeros((0, 1))).u

        for j, load in enumerate(loads):
            if load is not None:
                shape[:, j] = shaped(load)
        for j, strains in enumerate(grown):
            if strains:
                shape[:, j] = self._grown(strains, support)
        G = block_diag(mesh.rigid.G, format="csr")
        for columns, controls in known:
            R = controls[0].rows
            unit = np.column_stack([shaped(row) for row in R])
            rigid = (R @ G).toarray()
            own = 6 * int(np.argmax(np.abs(rigid).max(axis=0)) // 6)
            name = assembly.scene.deviations[columns[0]].name
            f = controlling_forces((R @ mesh.readings) @ unit, rigid[:, own : own + 6], controls, name)
            shape[:, columns] = unit @ f
        return shape

    def _grown(self, strains: Mapping[str, float], support: csr_matrix) -> np.ndarray:
        """(N,) freedoms of parts that have grown by strains in all directions, set down on their datum rows."""
        mesh = self.nominal
        u = np.zeros(mesh.parts.offsets[-1])
        for part, shell, lo in zip(self.assembly.parts, mesh.parts.shells, mesh.parts.offsets):
            moves = shell.dof_component < 3
            place = shell.dof_position[np.arange(shell.ndof), np.minimum(shell.dof_component, 2)]
            u[lo : lo + shell.ndof] = np.where(moves, strains.get(part.name, 0.0) * place, 0.0)
        modes = block_diag([shell.rigid_modes for shell in mesh.parts.shells], format="csr")
        read = (support @ mesh.readings).tocsr()
        return u - modes @ np.linalg.solve((read @ modes).toarray(), read @ u)

    def shape_fields(self, deviations) -> dict[str, np.ndarray]:
        """Displacements and rotations (n_points, 6) that the deviations of shape give each part's vertices, mm, rad."""
        return self.nominal.vertex_fields(self.unit_shapes @ np.asarray(deviations, dtype=float))

    def evaluate(self, deviations, law: str = "coulomb") -> FullEvaluation:
        """Take one assembly through all stages.

        Parameters
        ----------
        deviations : (p,) array
            Values of the scene's deviations, in its order.
        law : str
            One of :data:`LAWS`.

        Raises
        ------
        ContactFailure
        ValueError
            For another law, or deviations that do not fit the scene.
        """
        assembly, deviations = self.assembly, np.asarray(deviations, dtype=float)
        if law not in LAWS:
            raise ValueError(f"law {law!r}: the full solve knows {' and '.join(LAWS)}")
        if deviations.shape != (len(assembly.scene.deviations),) or not np.isfinite(deviations).all():
            raise ValueError(f"deviations: expected {len(assembly.scene.deviations)} finite numbers, got {deviations}")
        made = with_deviations(assembly, deviations)
        contacts = made.contacts
        mesh, asked = self._driven(made, deviations)
        state = FullState.start(mesh.parts.offsets[-1], len(contacts), contacts.dimension)
        resolutions, freedoms, history, read = {}, {}, [], np.zeros(0)
        for plan in self.plans:
            friction = friction_of(made, laws.find(law), plan.name)
            state, resolution, solves = FullStage(plan, mesh, friction, self.penalty, self.path_tolerance).advance(
                state, asked
            )
            freedoms[plan.name] = state.solution.u
            history += solves
            if resolution is not None:
                resolutions[plan.name] = resolution
            if plan.reads:
                readings = mesh.rows["measurement"] @ state.solution.u + asked.measured[0]
                read = Characteristics.of(assembly.scene).values(readings[None])[0]
        return FullEvaluation(law, deviations, resolutions, read, tuple(history), freedoms, mesh)

    def _driven(self, made, deviations):
        """The meshes to solve on, of an assembly as its deviations make it, and what the deviations ask of them."""
        assembly, mesh = self.assembly, self.nominal
        u, more = self.unit_shapes @ deviations, thickness_changes(assembly.scene, deviations)
        shape = {kind: (rows @ u)[None] for kind, rows in mesh.rows.items()}
        parts = assembly.parts
        if self.deviated:
            parts = deviated_parts(assembly, mesh.vertex_fields(u))
            shape |= {kind: gap_change(assembly, kind, parts, shape[kind][0])[None] for kind in ("contact", "weld")}
        if more:
            parts = [part.at(part.thickness + more[part.name]) if part.name in more else part for part in parts]
            faces = self._faces @ deviations
            rows = {**assembly.rows, "rest": mesh.rest.rows}
            shape = {kind: read + (rows[kind] @ faces)[None] for kind, read in shape.items()}
        if self.deviated or more:
            mesh = Discretisation(made, parts, self.comm, self._resting)
        return mesh, drive(made, deviations[None], shape)

    @cached_property
    def _faces(self) -> np.ndarray:
        """(F, p) how far the faces that the functionals read move per unit of each deviation, mm."""
        assembly = self.assembly
        names, offsets = [part.name for part in assembly.parts], assembly.offsets
        found = np.zeros((offsets[-1], len(assembly.scene.deviations)))
        for j, source in enumerate(sources(assembly.scene)):
            for name, skin in source.thickening().items():
                p = names.index(name)
                found[offsets[p] : offsets[p + 1], j] = thickening(assembly, p, skin)
        return found
