"""The full frictional contact solve: all parts' finite elements, every stage of the process, no reduction.

This is the reference for the reduced model (`mic.process`). Both use the same `Assembly`, the same rows, the same plan
of the stages (`mic.process.plan`) and the same prescribed values (`mic.process.drive`). The solution is independent:
each row is a sparse row over the freedoms of all parts, shapes are computed by finite elements, and each increment of
each stage is a Newton solve of `fem_reference.full.equilibrium`, by default on all unknowns (route "whole"): no
compliance is formed. The route "condensed" solves for the contact forces by a compliance of its own code
(`fem_reference.full.condensation`) and checks the residual of the whole system. See docs/full_contact.md.
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
from fem_reference.full.load_path import ROUTES, ContactFailure, Penalty, Route, Solve, route_taken
from fem_reference.full.stage import FullResolution, FullStage, FullState
from mic.contact import laws
from mic.errors import SceneError
from mic.model.characteristics import Characteristics
from mic.model.deviated_geometry import deviated_parts, gap_change
from mic.model.shape import controlling_forces, datum_rows, known_shapes, thickening
from mic.model.sources import sources, thickness_changes, with_deviations
from mic.process.drive import drive
from mic.process.plan import plan_assembly

__all__ = ["LAWS", "ROUTES", "ContactFailure", "FullEvaluation", "FullModel", "FullResolution", "Solve"]

#: Names of the laws that the full solve supports: slipping contacts stay closed, or there is no friction.
LAWS = tuple(law.name for law in laws.LAWS.values() if law.shift == 1.0 or not law.frictional)


@dataclass(frozen=True)
class FullEvaluation:
    """Result of one assembly.

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
        Numbering of the freedoms.
    route : str
        Route of the solves: "whole" or "condensed", and how many went by the other one because it did not converge,
        such as "whole, 2 of 31 solves condensed".
    """

    law: str
    deviations: np.ndarray
    resolutions: dict[str, FullResolution]
    measurements: np.ndarray
    history: tuple[Solve, ...]
    freedoms: dict[str, np.ndarray]
    mesh: Discretisation
    route: str

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
        From `mic.model.assembly.assemble`, with contact at pairs or at every node.
    deviated : bool
        Solve on meshes with each sample's shape deviation (stiffness, normals, gaps) instead of the nominal meshes.
    comm : MPI.Comm
        Processes that share the sparse system. Every process has the complete result.
    penalty : float
        ε/k, with k = E t of the softer sheet of the pair. The relative penetration is about 1/penalty.
    augmented : bool
        Remove the penetration by augmentation (Uzawa); required if a path is followed.
    path_tolerance : float
        Largest error of a contact's position in a step of a followed path, mm.
    route : {"whole", "condensed"}
        Newton's method on all unknowns, or on contact forces alone with a compliance of the contacts (faster; on one
        process). A load that does not converge by the chosen route is solved by the other one, which the result states.

    Raises
    ------
    SceneError
        If a part is a superelement.
    ValueError
        If an option is unknown or not positive, or a path is followed without augmentation.
    """

    def __init__(
        self,
        assembly,
        deviated: bool = False,
        comm: MPI.Comm = MPI.COMM_WORLD,
        penalty: float = 1e3,
        augmented: bool = True,
        path_tolerance: float = 1e-4,
        route: Route = "whole",
    ):
        for part in assembly.parts:
            if part.superelement is not None:
                raise SceneError(
                    f"part {part.name!r} is a superelement: whole finite elements need its mesh and material"
                )
        if route not in ROUTES:
            raise ValueError(f"route {route!r}: choose one of {', '.join(ROUTES)}")
        for name, value in (("penalty", penalty), ("path_tolerance", path_tolerance)):
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive, not {value}")
        self.assembly, self.deviated, self.comm, self.route = assembly, deviated, comm, route
        self.penalty, self.path_tolerance = Penalty(float(penalty), augmented), float(path_tolerance)
        self.plans = plan_assembly(assembly)
        followed = [plan.name for plan in self.plans if plan.resolves and plan.path == "followed"]
        if followed and not augmented and any(zone.frictional for zone in assembly.scene.zones):
            raise ValueError(
                f"stages ({', '.join(followed)}): following a path requires exact equilibria, but the penalty method "
                "has an elastic slip; give these stages increments, or set augmented=True"
            )

    @cached_property
    def nominal(self) -> Discretisation:
        """The parts on their nominal meshes."""
        return Discretisation(self.assembly, self.assembly.parts, self.comm, self._resting, self.route)

    @property
    def _resting(self) -> set[int]:
        """Parts that rest by contact alone in some step."""
        return {part for plan in self.plans for step in plan.steps for part in step.resting}

    @cached_property
    def unit_shapes(self) -> np.ndarray:
        """(N, p) freedoms of the shape per unit of each deviation; zero if a deviation changes no shape.

        Every part is supported by its datum rows (:mod:`mic.model.shape`) under the force of the source, or under
        the forces that reproduce a known shape.
        """
        assembly, mesh = self.assembly, self.nominal
        loads = [source.load(assembly.labels, assembly.rows) for source in sources(assembly.scene)]
        known = list(known_shapes(assembly))
        shape = np.zeros((mesh.parts.offsets[-1], len(loads)))
        expansions = [source.expansion() for source in sources(assembly.scene)]
        if all(load is None for load in loads) and not known and not any(expansions):
            return shape
        support = block_diag([datum_rows(assembly, p, G) for p, G in enumerate(mesh.rigid.G)], format="csr")
        held = Equilibrium(mesh.parts, (support @ mesh.readings).tocsr(), csr_matrix((0, len(shape))), 1)

        def shaped(load) -> np.ndarray:
            nodal = (load @ mesh.readings).toarray().ravel()
            return held.linear(nodal, np.zeros(support.shape[0]), np.zeros((0, 1))).u

        for j, load in enumerate(loads):
            if load is not None:
                shape[:, j] = shaped(load)
        for j, strains in enumerate(expansions):
            if strains:
                shape[:, j] = self._expanded(strains, support)
        G = block_diag(mesh.rigid.G, format="csr")
        for columns, controls in known:
            R = controls[0].rows
            unit = np.column_stack([shaped(row) for row in R])
            rigid = (R @ G).toarray()
            first = 6 * int(np.argmax(np.abs(rigid).max(axis=0)) // 6)
            name = assembly.scene.deviations[columns[0]].name
            f = controlling_forces((R @ mesh.readings) @ unit, rigid[:, first : first + 6], controls, name)
            shape[:, columns] = unit @ f
        return shape

    def _expanded(self, strains: Mapping[str, float], support: csr_matrix) -> np.ndarray:
        """(N,) freedoms of parts under isotropic strains, placed on their datum rows."""
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
        """Displacements and rotations (n_points, 6) of each part's vertices due to shape deviations, mm and rad."""
        return self.nominal.vertex_fields(self.unit_shapes @ np.asarray(deviations, dtype=float))

    def evaluate(self, deviations, law: str = "coulomb") -> FullEvaluation:
        """Solve all stages of one assembly.

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
            raise ValueError(f"law {law!r}: the full solve supports {' and '.join(LAWS)}")
        if deviations.shape != (len(assembly.scene.deviations),) or not np.isfinite(deviations).all():
            raise ValueError(f"deviations: expected {len(assembly.scene.deviations)} finite numbers, got {deviations}")
        deviated = with_deviations(assembly, deviations)
        contacts = deviated.contacts
        mesh, prescribed = self._mesh_and_drive(deviated, deviations)
        state = FullState.start(mesh.parts.offsets[-1], len(contacts), contacts.dimension)
        resolutions, freedoms, history, read = {}, {}, [], np.zeros(0)
        for plan in self.plans:
            friction = friction_of(deviated, laws.find(law), plan.name)
            stage = FullStage(plan, mesh, friction, self.penalty, self.path_tolerance, self.route)
            state, resolution, solves = stage.advance(state, prescribed)
            freedoms[plan.name] = state.solution.u
            history += solves
            if resolution is not None:
                resolutions[plan.name] = resolution
            if plan.reads:
                readings = mesh.rows["measurement"] @ state.solution.u + prescribed.measured[0]
                read = Characteristics.of(assembly.scene).values(readings[None])[0]
        route = route_taken(self.route, history)
        return FullEvaluation(law, deviations, resolutions, read, tuple(history), freedoms, mesh, route)

    def _mesh_and_drive(self, deviated, deviations):
        """The discretisation of a deviated assembly, and the values that its deviations prescribe."""
        assembly, mesh = self.assembly, self.nominal
        u, thicker = self.unit_shapes @ deviations, thickness_changes(assembly.scene, deviations)
        shape = {kind: (rows @ u)[None] for kind, rows in mesh.rows.items()}
        parts = assembly.parts
        if self.deviated:
            parts = deviated_parts(assembly, mesh.vertex_fields(u))
            shape |= {kind: gap_change(assembly, kind, parts, shape[kind][0])[None] for kind in ("contact", "weld")}
        if thicker:
            parts = [part.at(part.thickness + thicker[part.name]) if part.name in thicker else part for part in parts]
            faces = self._faces @ deviations
            rows = {**assembly.rows, "rest": mesh.rest.rows}
            shape = {kind: read + (rows[kind] @ faces)[None] for kind, read in shape.items()}
        if self.deviated or thicker:
            mesh = Discretisation(deviated, parts, self.comm, self._resting, self.route)
        return mesh, drive(deviated, deviations[None], shape)

    @cached_property
    def _faces(self) -> np.ndarray:
        """(F, p) displacement of the faces that the functionals read, per unit of each deviation, mm."""
        assembly = self.assembly
        names, offsets = [part.name for part in assembly.parts], assembly.offsets
        faces = np.zeros((offsets[-1], len(assembly.scene.deviations)))
        for j, source in enumerate(sources(assembly.scene)):
            for name, skin in source.thickening().items():
                p = names.index(name)
                faces[offsets[p] : offsets[p + 1], j] = thickening(assembly, p, skin)
        return faces
