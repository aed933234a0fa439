"""The full frictional contact solve: all parts' finite elements, every stage of the process, no reduction.

What the reduced model (`mic.process.process`) is judged by. Both take the same rows of the same `Assembly` and the same conventions
from stage to stage; here each row becomes a sparse row over the freedoms of all parts, ``row · blkdiag(L_p)``, and each
increment of each stage is a Newton solve of `fem_reference.full.equilibrium`. Influence coefficients appear nowhere.

From stage to stage (s runs from 0 to 1 over the increments of a stage):

- bilateral rows hold ``B u = v(s)``, from what the row read before the stage to its target: for locators and stroke clamps minus the
  reading of the part's shape deviation plus stroke and offset, for welds what they found, or minus the gap that they close;
- rows let go, and forces taken away, fade: ``p(s) = (1 − s) Bᵣᵀ r``;
- a contact's gap is ``g = g⁰ + n·(shape deviation) + δ_n``, and slip is measured from where the increment before left it.

Where Newton's method fails, the increment is cut: fractions of it are solved first. They are a path towards the solution, not
a part of the process: slip is measured from the start of the whole increment, so cutting does not change the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI
from scipy.linalg import lapack
from scipy.sparse import block_diag, csr_matrix, vstack

from fem_reference.full.equilibrium import ContactLaw, Equilibrium, Iteration, NoConvergence, Parts, State
from fem_reference.shell.part import ShellPart
from mic.compliance.elimination import statically_determinate
from mic.geometry.surface import Surface
from mic.model.reduced import datum_locators
from mic.process.process import plan_stages

__all__ = ["ContactFailure", "FullEvaluation", "FullModel", "FullResolution", "Solve"]

LAWS = ("frictionless", "coulomb")

_SMALLEST_CUT = 1 / 64  # of an increment
_AUGMENTATIONS = 30
_AUGMENTED = 1e-10  # change of the contact forces in the last augmentation, of the largest
_ROUNDING = 1e-8  # of the largest force: a change below this that no longer shrinks is rounding
_SLOW = 0.1  # an augmentation that leaves more than this share of the change before raises ε tenfold
_STIFFEST = 1e9  # ε/k at most
_REDUNDANT = 1e-12  # squared distance of a normalised row from the span of the others


class ContactFailure(RuntimeError):
    """The full solve failed; the message names stage, increment, contact and what to change."""


@dataclass(frozen=True)
class Solve:
    """One Newton solve.

    Attributes
    ----------
    stage : str
    increment : int
        From 1.
    fraction : float
        Of the increment's load; 1 is its end.
    augmentation : int
        0 for the penalty method, then the number of times that f̂ was replaced by f.
    penalty : float
        ε/k.
    iterations : tuple of Iteration
    """

    stage: str
    increment: int
    fraction: float
    augmentation: int
    penalty: float
    iterations: tuple[Iteration, ...]


@dataclass(frozen=True)
class FullResolution:
    """Contact solution of one stage; conventions of :class:`mic.process.process.Resolution`.

    Attributes
    ----------
    stage : str
    force : (m, d) array
        N; normal compression positive.
    displacement : (m, d) array
        mm; the normal component is the gap, the tangential ones the slip since the stage before.
    state : (m,) array
        0 open, 1 stick, 2 slip (index into ``mic.process.process.STATES``).
    reaction : (b,) array
        Forces of the bilateral rows on the parts, N or N mm, in the plan's order; 0 for redundant rows.
    """

    stage: str
    force: np.ndarray
    displacement: np.ndarray
    state: np.ndarray
    reaction: np.ndarray


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
    """

    law: str
    deviations: np.ndarray
    resolutions: dict[str, FullResolution]
    measurements: np.ndarray
    history: tuple[Solve, ...]
    freedoms: dict[str, np.ndarray]
    _mesh: _Discretisation

    def field(self, stage: str) -> dict[str, np.ndarray]:
        """Displacements and rotations (n_points, 6) at the vertices of each part at the end of a stage, mm and rad.

        They are measured from the stress-free shape; the shape deviation is not part of them.
        """
        return self._mesh.vertex_fields(self.freedoms[stage])

    def strain_energy(self, stage: str) -> float:
        """Strain energy of all parts at the end of a stage, N mm."""
        parts, u = self._mesh.parts, self.freedoms[stage]
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
        ε/k, with k = E t of the softer sheet of the pair: the order of a sheet's stiffest response to a force spread over
        an area, so that a relative penetration of about 1/penalty is left.
    augmented : bool
        Remove that error by augmentation (Uzawa).
    """

    def __init__(
        self,
        assembly,
        deviated: bool = False,
        comm: MPI.Comm = MPI.COMM_WORLD,
        penalty: float = 1e3,
        augmented: bool = True,
    ):
        if not (np.isfinite(penalty) and penalty > 0):
            raise ValueError(f"penalty must be positive, not {penalty}")
        self.assembly, self.deviated, self.comm = assembly, deviated, comm
        self.penalty, self.augmented = float(penalty), augmented
        self.plans = plan_stages(assembly.scene, assembly.weld_size)

    @cached_property
    def _nominal(self) -> _Discretisation:
        return _Discretisation(self.assembly, self.assembly.parts, self.comm)

    @cached_property
    def _shape(self) -> np.ndarray:
        """(N, p) freedoms of the shape that each unit deviation gives its part (zero for locator and clamp deviations).

        Every part is held on six of the locators that it is set down on while the corrective force acts.
        """
        scene, mesh = self.assembly.scene, self._nominal
        shape = np.zeros((mesh.parts.offsets[-1], len(scene.deviations)))
        forces = [j for j, deviation in enumerate(scene.deviations) if deviation.kind == "force"]
        if forces:
            support = np.concatenate(
                [
                    datum_locators(self.assembly, part.name, mesh.rigid[:, 6 * p : 6 * p + 6])
                    for p, part in enumerate(self.assembly.parts)
                ]
            )
            held = Equilibrium(mesh.parts, mesh.rows["locator"][support], csr_matrix((0, len(shape))), 1)
            for i, j in enumerate(forces):
                load = mesh.rows["force"][i].toarray().ravel()
                shape[:, j] = held.linear(load, np.zeros(len(support)), np.zeros((0, 1))).u
        return shape

    def shape_fields(self, deviations) -> dict[str, np.ndarray]:
        """Displacements and rotations (n_points, 6) that the deviations of shape give the vertices of each part, mm and rad."""
        return self._nominal.vertex_fields(self._shape @ np.asarray(deviations, dtype=float))

    # ------------------------------------------------------------------------------------------ one assembly

    def evaluate(self, deviations, law: str = "coulomb") -> FullEvaluation:
        """Take one assembly through all stages.

        Parameters
        ----------
        deviations : (p,) array
            Values of the scene's deviations, in its order.
        law : {"coulomb", "frictionless"}

        Raises
        ------
        ContactFailure
        ValueError
            For another law, or deviations that do not fit the scene.
        """
        deviations = np.asarray(deviations, dtype=float)
        if law not in LAWS:
            raise ValueError(f"law {law!r}: the full solve knows {' and '.join(LAWS)}")
        if deviations.shape != (len(self.assembly.scene.deviations),) or not np.isfinite(deviations).all():
            raise ValueError(
                f"deviations: expected {len(self.assembly.scene.deviations)} finite numbers, got {deviations}"
            )
        shape = self._shape @ deviations
        mesh = self._nominal
        reading = {kind: mesh.rows[kind] @ shape for kind in mesh.rows}
        d = self.assembly.contacts.dimension
        contact_gap, weld_gap = reading["contact"][::d], reading["weld"][self._weld_normals]
        if self.deviated:
            parts = _deviated_parts(self.assembly, mesh.vertex_fields(shape))
            contact_gap = _opening(self.assembly, "contact", parts)[::d]
            weld_gap = _opening(self.assembly, "weld", parts)[self._weld_normals]
            mesh = _Discretisation(self.assembly, parts, self.comm)
        run = _Run(
            self,
            mesh,
            law,
            deviations,
            reading,
            self.assembly.contacts.gap + contact_gap,
            self.assembly.weld_gap + weld_gap,
        )
        for plan in self.plans:
            run.stage(plan)
        measured = np.zeros(0)
        if self.plans[-1].kind == "measure":
            measured = mesh.rows["measurement"] @ run.state.u + reading["measurement"]
        return FullEvaluation(law, deviations, run.resolutions, measured, tuple(run.history), run.freedoms, mesh)

    @property
    def _weld_normals(self):
        return np.concatenate([[0], np.cumsum(self.assembly.weld_size)]).astype(int)[:-1]


class _Run:
    """One assembly on its way through the stages."""

    def __init__(self, model, mesh, law, deviations, reading, gap, weld_gap):
        self.model, self.mesh, self.assembly = model, mesh, model.assembly
        scene, contacts = self.assembly.scene, self.assembly.contacts
        self.m, self.d = len(contacts), contacts.dimension
        self.friction = contacts.friction if law == "coulomb" else np.zeros(self.m)
        self.gap, self.weld_gap = gap, weld_gap
        moved = {kind: np.zeros(mesh.rows[kind].shape[0]) for kind in ("locator", "clamp")}
        names = {"locator": [item.name for item in scene.locators], "clamp": [item.name for item in scene.clamps]}
        for value, deviation in zip(deviations, scene.deviations):
            if deviation.kind != "force":
                moved[deviation.kind][names[deviation.kind].index(deviation.target)] += value
        stroke = {"locator": 0.0, "clamp": np.array([clamp.stroke or 0.0 for clamp in scene.clamps])}
        self.target = {kind: stroke[kind] - reading[kind] + moved[kind] for kind in moved}
        self.pushed = np.array([clamp.force or 0.0 for clamp in scene.clamps]) + moved["clamp"]
        self.target["weld"] = np.full(mesh.rows["weld"].shape[0], np.nan)  # until it is made
        self.state = State(np.zeros(mesh.parts.offsets[-1]), np.zeros(0), np.zeros((self.m, self.d)))
        self.held: dict[tuple[str, int], float] = {}  # bilateral row -> reaction
        self.loads: dict[int, float] = {}  # clamp -> force
        self.left = np.zeros((self.m, self.d))  # δ where each contact was left
        self.resolutions, self.freedoms, self.history = {}, {}, []

    def stage(self, plan):
        """Solve one stage, and keep what the next one needs."""
        if plan.kind == "weld":
            self._make_welds(plan)
        if plan.resolves or plan.kind == "locate":
            self._load(plan)
        # else nothing has changed: new welds hold what they found and carry nothing yet
        self.held = {row: self.held.get(row, 0.0) for row in plan.bilateral}
        self.loads = {i: self.pushed[i] for i in plan.loads}
        self.freedoms[plan.name] = self.state.u

    def _make_welds(self, plan):
        found = self.mesh.rows["weld"] @ self.state.u
        for kind, row in plan.bilateral:
            if kind == "weld" and np.isnan(self.target["weld"][row]):
                self.target["weld"][row] = found[row]
        for weld in plan.closing:
            self.target["weld"][self.model._weld_normals[weld]] = -self.weld_gap[weld]

    def _load(self, plan):
        """Bring the prescribed values and loads from what they are to the stage's, increment by increment."""
        mesh, u = self.mesh, self.state.u
        try:
            system = mesh.system(plan)
            v1 = np.array([self.target[kind][i] for kind, i in plan.bilateral])
            v0 = system.rows @ u
            v0, v1 = system.consistent(v0), system.consistent(v1)
        except ValueError as error:
            raise ContactFailure(f"stage {plan.name!r}: {error}") from error
        clamp, p0, p1 = mesh.rows["clamp"], np.zeros(len(u)), np.zeros(len(u))
        for i in plan.loads + plan.dropped_loads:
            p0 += clamp[i].T @ [self.loads.get(i, 0.0)]
        for i in plan.loads:
            p1 += clamp[i].T @ [self.pushed[i]]
        for kind, i in plan.released:
            p0 += mesh.rows[kind][i].T @ [self.held[kind, i]]
        reaction = np.array([self.held.get(row, 0.0) for row in plan.bilateral])[system.kept]
        self.state = replace(self.state, reaction=reaction)
        steps = plan.increments if plan.resolves and self.m else 1
        before = self.left
        for step in range(1, steps + 1):
            start, end = ((p0 + s * (p1 - p0), v0 + s * (v1 - v0)) for s in ((step - 1) / steps, step / steps))
            if plan.resolves and self.m:
                law = self._increment(plan, system, step, start, end)
            else:
                self.state = system.equilibrium.linear(*end, self.state.force)
            self.left = mesh.contact(self.state.u)
        r = np.zeros(len(plan.bilateral))
        r[system.kept] = self.state.reaction
        self.held = dict(zip(plan.bilateral, r))
        if plan.resolves and self.m:
            displacement = replace(law, anchor=before).displacement(self.left)
            self.resolutions[plan.name] = FullResolution(
                plan.name, self.state.force, displacement, law.state(self.left), r
            )

    def _increment(self, plan, system, number, start, end) -> ContactLaw:
        """Solve one increment; returns the law that its end satisfies, slip measured from the increment's start."""
        k, β = self.mesh.contact_stiffness, self.model.penalty
        estimate = self.state.force.copy()
        if not self.model.augmented:
            estimate[:, 0] = 0.0
        law = ContactLaw(self.friction, self.gap, self.left, estimate, β * k, k)

        def solve(fraction, law, augmentation):
            p, v = (a + fraction * (b - a) for a, b in zip(start, end))
            self.state, iterations = system.equilibrium.newton(self.state, p, v, law)
            self.history.append(
                Solve(plan.name, number, fraction, augmentation, float(law.penalty[0] / k[0]), tuple(iterations))
            )

        done, step = 0.0, 1.0
        while done < 1:
            try:
                solve(min(1.0, done + step), law, 0)
                done = min(1.0, done + step)
            except NoConvergence as problem:
                step /= 2
                if step < _SMALLEST_CUT:
                    raise self._failure(
                        plan, number, done, problem, "raise the stage's increments or lower the penalty"
                    ) from problem
        change = np.inf
        for augmentation in range(1, _AUGMENTATIONS + 1) if self.model.augmented else ():
            before = change
            change = float(np.abs(self.state.force - law.estimate).max())
            largest = max(np.abs(self.state.force).max(), np.abs(self.state.reaction).max())
            if change <= _AUGMENTED * largest or before <= _ROUNDING * largest and change > 0.5 * before:
                break
            stiffer = change > _SLOW * before and law.penalty[0] < _STIFFEST * k[0]
            law = replace(law, estimate=self.state.force, penalty=(10 if stiffer else 1) * law.penalty)
            try:
                solve(1.0, law, augmentation)
            except NoConvergence as problem:
                raise self._failure(
                    plan, number, 1.0, problem, "lower the penalty, or do without augmentation"
                ) from problem
        else:
            if self.model.augmented:
                raise self._failure(
                    plan,
                    number,
                    1.0,
                    f"after {_AUGMENTATIONS} augmentations the forces still change by {change:.1e} N",
                    "raise the penalty; look for contacts that the welds make redundant",
                )
        return law

    def _failure(self, plan, number, fraction, problem, remedy):
        contact = getattr(problem, "contact", None)
        where = (
            ""
            if contact is None
            else f", worst at contact {self.assembly.labels['contact'][contact * self.d].rsplit(' ', 1)[0]!r}"
        )
        return ContactFailure(
            f"stage {plan.name!r}, increment {number} of {plan.increments}, at {fraction:.3g} of its load{where}: "
            f"{problem}; {remedy}"
        )


# ---------------------------------------------------------------------------------------------- discretisation


@dataclass(frozen=True)
class _System:
    """A stage's equilibrium: its bilateral rows (b, N), the independent ones among them, and the rest as combinations of these."""

    rows: csr_matrix
    kept: np.ndarray
    combination: np.ndarray
    names: list[str]
    equilibrium: Equilibrium

    def consistent(self, value):
        """Values of the independent rows, once those of the others follow from them."""
        others = np.setdiff1d(np.arange(len(value)), self.kept)
        misfit = np.abs(value[others] - self.combination @ value[self.kept])
        bad = np.flatnonzero(misfit > 1e-8 * np.abs(value).max(initial=0.0))
        if len(bad):
            raise ValueError(
                f"{self.names[others[bad[0]]]} is redundant and contradicts the other rows by {misfit[bad[0]]:.2g}; remove it"
            )
        return value[self.kept]


class _Discretisation:
    """Finite elements of all parts, and the assembly's rows over their freedoms.

    Attributes
    ----------
    rows : dict of str to (r, N) csr_matrix
    rigid : (F, 6P) array
        Readings of the parts' rigid motions by the functionals.
    contact_stiffness : (m,) array
        k = E t of each contact's softer sheet, N/mm.
    """

    def __init__(self, assembly, parts, comm):
        self.assembly = assembly
        shells = [
            ShellPart(part.surface, part.thickness, part.young, part.poisson, part.element, comm) for part in parts
        ]
        self.parts = Parts(shells, comm)
        L = [shell.functional_matrix(part.functionals) for shell, part in zip(shells, parts)]
        whole = block_diag(L, format="csr")
        self.rows = {kind: (rows @ whole).tocsr() for kind, rows in assembly.rows.items()}
        self.rigid = block_diag([reading @ shell.rigid_modes for reading, shell in zip(L, shells)]).toarray()
        d = assembly.contacts.dimension
        k = np.array([part.young * part.thickness for part in parts])
        body = np.searchsorted(assembly.offsets, assembly.rows["contact"].indices, side="right") - 1
        indptr = assembly.rows["contact"].indptr
        self.contact_stiffness = np.array(
            [k[body[indptr[i] : indptr[i + 1]]].min() for i in range(0, len(indptr) - 1, d)]
        )
        self._systems: dict[str, _System] = {}

    def contact(self, u):
        """(m, d) relative displacements δ."""
        return (self.rows["contact"] @ u).reshape(-1, self.assembly.contacts.dimension)

    def vertex_fields(self, u):
        """(n_points, 6) of each part, by name."""
        return {
            part.name: (shell.vertex_values @ u[lo:hi]).reshape(-1, 6)
            for part, shell, lo, hi in zip(
                self.assembly.parts, self.parts.shells, self.parts.offsets, self.parts.offsets[1:]
            )
        }

    def system(self, plan) -> _System:
        """The stage's system, set up once.

        Raises
        ------
        ValueError
            If its rows leave a part free to move.
        """
        if plan.name not in self._systems:
            functional_rows = vstack([self.assembly.rows[kind][i] for kind, i in plan.bilateral], format="csr")
            statically_determinate(functional_rows, self.rigid)  # raises where a part is free
            B = vstack([self.rows[kind][i] for kind, i in plan.bilateral], format="csr")
            kept, combination = _independent(B)
            names = [self.assembly.labels[kind][i] for kind, i in plan.bilateral]
            equilibrium = Equilibrium(self.parts, B[kept], self.rows["contact"], self.assembly.contacts.dimension)
            self._systems[plan.name] = _System(B, kept, combination, names, equilibrium)
        return self._systems[plan.name]


def _independent(B):
    """Rows that span all (ascending), and the others as combinations of them."""
    scale = 1 / np.sqrt(B.multiply(B).sum(axis=1).A.ravel())
    gram = (B @ B.T).toarray() * np.outer(scale, scale)
    _, pivot, rank, _ = lapack.dpstrf(gram, tol=_REDUNDANT, lower=1)
    kept = np.sort(pivot[:rank] - 1)
    others = np.setdiff1d(np.arange(B.shape[0]), kept)
    combination = np.linalg.solve(gram[np.ix_(kept, kept)], gram[np.ix_(kept, others)]).T
    return kept, combination * scale[kept] / scale[others, None]


# ---------------------------------------------------------------------------------------------- deviated geometry


def _deviated_parts(assembly, fields):
    """Parts on the meshes that carry the shape deviation, the frames of contacts and welds turned with the surface.

    Patches keep their material points. What the fixture prescribes (locators, clamps, measurements) keeps its direction in space.
    """
    surfaces = [
        Surface(part.surface.points + fields[part.name][:, :3], part.surface.triangles) for part in assembly.parts
    ]
    direction = [part.functionals.direction.copy() for part in assembly.parts]
    for kind in ("contact", "weld"):
        rows = assembly.rows[kind]
        for group in _joints(assembly, kind):
            p, first = _owner(assembly, rows.indices[rows.indptr[group.start]])
            part = assembly.parts[p]
            patch = part.functionals.patches[part.functionals.patch[first]]
            turn = _rotation(
                *(patch.weight @ surface.normals[patch.triangle] for surface in (part.surface, surfaces[p]))
            )
            for column in np.unique(rows.indices[rows.indptr[group.start] : rows.indptr[group.stop]]):
                q, i = _owner(assembly, column)
                direction[q][i] = turn @ assembly.parts[q].functionals.direction[i]
    return [
        replace(part, surface=surface, functionals=replace(part.functionals, direction=d))
        for part, surface, d in zip(assembly.parts, surfaces, direction)
    ]


def _opening(assembly, kind, parts):
    """(r,) change of the distance between the two mid-surfaces along each row of contacts or welds, nominal to deviated."""
    distance = []
    for version in (assembly.parts, parts):
        position = np.concatenate(
            [
                [
                    d @ (patch.weight @ part.surface.at(patch.triangle, patch.barycentric)) if not rotation else 0.0
                    for patch, d, rotation in zip(
                        [part.functionals.patches[i] for i in part.functionals.patch],
                        part.functionals.direction,
                        part.functionals.rotation,
                    )
                ]
                for part in version
            ]
        )
        distance.append(assembly.rows[kind] @ position)
    return distance[1] - distance[0]


def _joints(assembly, kind):
    """Row slices of each contact or weld."""
    sizes = assembly.weld_size if kind == "weld" else [assembly.contacts.dimension] * len(assembly.contacts)
    edges = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    return [slice(lo, hi) for lo, hi in zip(edges, edges[1:])]


def _owner(assembly, column):
    """Part and own number of a stacked functional."""
    p = int(np.searchsorted(assembly.offsets, column, side="right") - 1)
    return p, int(column - assembly.offsets[p])


def _rotation(a, b):
    """The smallest rotation that turns the direction of a into that of b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + a @ b)
