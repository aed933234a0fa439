"""The process: stages in order, the assembly's state handed from one to the next.

State between stages: which bilateral rows hold, with which prescribed values; the loads; where each contact was left
tangentially. Every stage is solved in total displacements from the stress-free parts, so only friction and welds carry
memory: a weld keeps the relative displacement that it found, and slip is measured from where the contact was left, so

    b_n = g⁰ + n·(deviation_b - deviation_a) + free δ_n,        b_t = free δ_t - δ_t where the contact was left.

A tangential *shape* deviation is not a motion and does not enter b_t: it would make friction pull the parts together.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.sparse import csr_matrix, vstack

from mic.compliance.elimination import EliminatedStage, eliminate
from mic.contact import ContactSolver
from mic.scene import SceneError

__all__ = ["Evaluation", "Process", "Resolution", "StagePlan", "plan_stages"]

STATES = ("open", "stick", "slip")

#: The solvers that the paper used, and the residual that they reach; it has none for Coulomb's law.
PAPER_BACKENDS = {"frictionless": "osqp", "associated": "ecos", "coulomb": "native"}
PAPER_TOLERANCE = 1e-5


@dataclass(frozen=True)
class StagePlan:
    """What one stage holds, loads and resolves.

    Attributes
    ----------
    name, kind : str
    bilateral : tuple of (str, int)
        Rows held: kind (``"locator"``, ``"clamp"`` with a stroke, ``"weld"``) and row number.
    loads : tuple of int
        Clamp rows that push with a force.
    released : tuple of (str, int)
        Rows of the stage before that this one lets go.
    dropped_loads : tuple of int
        Clamp rows whose force ends here.
    closing : tuple of int
        Welds that close their gap here.
    resolves : bool
        Whether contact is resolved.
    increments : int
    """

    name: str
    kind: str
    bilateral: tuple[tuple[str, int], ...]
    loads: tuple[int, ...]
    released: tuple[tuple[str, int], ...]
    dropped_loads: tuple[int, ...]
    closing: tuple[int, ...]
    resolves: bool
    increments: int


def plan_stages(scene, weld_size) -> list[StagePlan]:
    """Which rows each stage of a scene holds; nothing is solved.

    Parameters
    ----------
    scene : mic.scene.schema.Scene
    weld_size : sequence of int
        Rows of each weld.
    """
    weld_start = np.concatenate([[0], np.cumsum(weld_size)]).astype(int)
    locators, strokes, forces, welded = [], [], [], []
    plans, held, pushed = [], [], []
    for stage in scene.stages:
        closing = []
        if stage.kind in ("locate", "clamp"):
            locators = locators + [i for i, locator in enumerate(scene.locators) if locator.stage == stage.name]
        if stage.kind == "clamp":
            named = [i for i, clamp in enumerate(scene.clamps) if clamp.stage == stage.name]
            strokes = strokes + [i for i in named if scene.clamps[i].force is None]
            forces = forces + [i for i in named if scene.clamps[i].force is not None]
        elif stage.kind == "weld":
            named = [i for i, weld in enumerate(scene.welds) if weld.stage == stage.name]
            welded = welded + named
            closing = [i for i in named if scene.welds[i].close]
        elif stage.kind == "release":
            strokes, forces = [], []
            if stage.keep is not None:
                locators = [i for i in locators if scene.locators[i].name in stage.keep]
        now = (
            [("locator", i) for i in locators]
            + [("clamp", i) for i in strokes]
            + [("weld", r) for i in welded for r in range(weld_start[i], weld_start[i + 1])]
        )
        added = [row for row in now if row not in held and row[0] != "weld"]
        released = tuple(row for row in held if row not in now)
        changed = bool(added or released or closing or set(forces) != set(pushed))
        # Locating sets the parts down one by one; whatever overlaps is resolved when the clamps close.
        resolves = changed and stage.kind != "locate"
        plans.append(
            StagePlan(
                stage.name,
                stage.kind,
                tuple(now),
                tuple(forces),
                released,
                tuple(i for i in pushed if i not in forces),
                tuple(closing),
                resolves,
                stage.increments,
            )
        )
        held, pushed = now, list(forces)
    return plans


@dataclass(frozen=True)
class Resolution:
    """Contact solution of one stage for n samples and m pairs of dimension d (3, or 1 where only normals are modelled).

    Attributes
    ----------
    stage : str
    force : (n, m, d) array
        N; normal compression positive.
    displacement : (n, m, d) array
        mm; the normal component is the gap, the tangential ones the slip since the stage before.
    state : (n, m) int8 array
        0 open, 1 stick, 2 slip (index into ``STATES``).
    residual : (n,) array
        The scale-free natural-map residual; 0 where there is no contact to resolve.
    converged : (n,) bool array
        True where every increment met its tolerance.
    iterations : (n,) int array
    status : (n,) object array
        Outcome of the last increment.
    reaction : (n, b) array
        Forces of the bilateral rows on the parts, N or N mm.
    """

    stage: str
    force: np.ndarray
    displacement: np.ndarray
    state: np.ndarray
    residual: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    status: np.ndarray
    reaction: np.ndarray


@dataclass(frozen=True)
class Evaluation:
    """Outcome of n assemblies.

    Attributes
    ----------
    law : str
    deviations : (n, p) array
    resolutions : dict of str to Resolution
        By stage, for the stages that resolve contact.
    measurements : (n, k) array
        Key characteristics in the scene's order, mm from nominal; empty without a measure stage.
    failed : (n,) bool array
        Samples whose contact missed its tolerance in some stage.
    functional_force : (n, F) array
        All forces on the retained functionals in the last stage, those that made the parts' shapes included.
    motion : (n, 6P) array
        Rigid-body motions of the parts in the last stage, shape deviation included.
    """

    law: str
    deviations: np.ndarray
    resolutions: dict[str, Resolution]
    measurements: np.ndarray
    failed: np.ndarray
    functional_force: np.ndarray
    motion: np.ndarray

    @classmethod
    def join(cls, pieces: list[Evaluation]) -> Evaluation:
        """Evaluations of one law, put one after the other."""

        def stack(name):
            return np.concatenate([getattr(piece, name) for piece in pieces])

        resolutions = {
            stage: Resolution(
                stage,
                *(
                    np.concatenate([getattr(piece.resolutions[stage], f.name) for piece in pieces])
                    for f in fields(Resolution)[1:]
                ),
            )
            for stage in pieces[0].resolutions
        }
        return cls(pieces[0].law, stack("deviations"), resolutions, *(stack(f.name) for f in fields(cls)[3:]))


@dataclass(frozen=True)
class Elimination:
    """One stage with its bilateral rows eliminated, whatever the contact law.

    Attributes
    ----------
    plan : StagePlan
    bilateral, load : (b, F), (l, F) csr_matrix
        Rows held, and rows that push: clamp forces, then rows let go, which fade out over the increments.
    response : EliminatedStage
        Its output rows are all locators, clamps, welds and measurements, in this order.
    """

    plan: StagePlan
    bilateral: csr_matrix
    load: csr_matrix
    response: EliminatedStage


_OUTPUTS = ("locator", "clamp", "weld", "measurement")


def eliminate_stages(model) -> list[Elimination]:
    """Eliminate every stage of a reduced model; all contact laws share the outcome.

    Raises
    ------
    SceneError
        If a stage leaves a part free to move.
    """

    def rows_of(rows):
        return vstack([csr_matrix((0, len(model.H))), *(model.rows[kind][i] for kind, i in rows)], format="csr")

    output = vstack([model.rows[kind] for kind in _OUTPUTS], format="csr")
    stages = []
    for plan in plan_stages(model.scene, model.weld_size):
        bilateral = rows_of(plan.bilateral)
        load = rows_of([("clamp", i) for i in plan.loads + plan.dropped_loads] + list(plan.released))
        try:
            response = eliminate(model.H, model.G, bilateral, model.rows["contact"], load, output)
        except ValueError as error:
            raise SceneError(f"stages ({plan.name}): {_free_motions(error, model.scene)}") from error
        stages.append(Elimination(plan, bilateral, load, response))
    return stages


def _free_motions(error, scene):
    motions = getattr(error, "free", None)
    if motions is None:
        return str(error)
    share = [np.linalg.norm(motions[6 * p : 6 * p + 6]) for p in range(len(scene.parts))]
    return (
        f"{motions.shape[1]} rigid-body motions are free, mostly of part {scene.parts[int(np.argmax(share))].name!r}; keep more "
        "locators in this stage, or join the part by welds with moment"
    )


class Process:
    """All stages of a reduced model, prepared for one contact law.

    Parameters
    ----------
    model : mic.model.reduced.ReducedModel
    law : {"coulomb", "associated", "frictionless"}
    tol : float
        Tolerance of the contact certificate; the paper's solvers get `PAPER_TOLERANCE` if that is larger.
    backend : {"native", "paper"}
        Who solves the contacts: the native solver, or the paper's (OSQP for (12), ECOS for (13)).
    threads : int
        Threads of the native solver over the samples of a batch.

    Attributes
    ----------
    stages : list of Elimination
        All stages, in order.
    solvers : list of ContactSolver or None
        One per stage, None where it resolves no contact.

    Raises
    ------
    SceneError
        If a stage leaves a part free to move.
    """

    def __init__(self, model, law: str, tol: float = 1e-10, backend: str = "native", threads: int = 1):
        self.model, self.law = model, law
        solver_name = PAPER_BACKENDS[law] if backend == "paper" else "native"
        if solver_name != "native":
            tol = max(tol, PAPER_TOLERANCE)
        edges = np.concatenate([[0], np.cumsum([model.rows[kind].shape[0] for kind in _OUTPUTS])])
        self._output = {kind: slice(edges[i], edges[i + 1]) for i, kind in enumerate(_OUTPUTS)}
        self.stages = model.eliminations
        # Without friction anywhere every law is the frictionless one, and the model may hold no tangential rows.
        smooth = model.contacts.dimension == 1 and not model.contacts.friction.any()
        self.solvers = [
            ContactSolver(
                stage.response.S,
                model.contacts.friction,
                law="frictionless" if smooth else law,
                backend=solver_name,
                tol=tol,
                threads=threads,
                dimension=model.contacts.dimension,
            )
            if stage.plan.resolves and len(model.contacts)
            else None
            for stage in self.stages
        ]

    @property
    def redundant(self) -> list[str]:
        """One sentence for each row that a stage holds in vain, since its others hold it already."""
        return [
            f"stage {p.plan.name}: {kind} row {self.model.labels[kind][i]} repeats other rows of the stage; its value has no effect"
            for p in self.stages
            for kind, i in (p.plan.bilateral[j] for j in p.response.redundant)
        ]

    def evaluate(self, deviations: np.ndarray) -> Evaluation:
        """Take a batch through all stages.

        Parameters
        ----------
        deviations : (n, p) array
            As :meth:`mic.model.reduced.ReducedModel.deviations` returns it.
        """
        model, scene = self.model, self.model.scene
        n, m, d = len(deviations), len(model.contacts), model.contacts.dimension
        nominal, moved, pushed = self._targets(deviations)
        gap = model.contacts.gap + (deviations @ (model.rows["contact"][0::d] @ model.shape).T if m else 0.0)
        weld_n = np.concatenate([[0], np.cumsum(model.weld_size)]).astype(int)[:-1]
        weld_gap = model.weld_gap + deviations @ (model.rows["weld"][weld_n] @ model.shape).T
        reading = np.zeros((n, self._output["measurement"].stop))  # of all output rows, in the state before
        left = np.zeros((n, m, d))  # δ where each contact was left
        frozen = {}  # weld row -> (n,) value
        force = np.zeros((n, m * d))
        held, reaction = {}, np.zeros((n, 0))
        failed = np.zeros(n, dtype=bool)
        resolutions = {}
        load_before = {}
        for stage, solver in zip(self.stages, self.solvers):
            plan, response = stage.plan, stage.response
            if plan.kind == "weld":
                for row in range(self._output["weld"].stop - self._output["weld"].start):
                    if ("weld", row) in plan.bilateral and row not in frozen:
                        frozen[row] = reading[:, self._output["weld"].start + row].copy()
                for weld in plan.closing:
                    frozen[weld_n[weld]] = -weld_gap[:, weld]
            target = np.column_stack([self._value(kind, i, nominal, moved, frozen) for kind, i in plan.bilateral])
            start = np.column_stack(
                [held.get(row, reading[:, self._output[row[0]].start + row[1]]) for row in plan.bilateral]
            )
            load_end = np.column_stack(
                [pushed[:, i] for i in plan.loads] + [np.zeros((n, len(plan.dropped_loads) + len(plan.released)))]
            )
            load_start = (
                np.column_stack(
                    [load_before.get(i, np.zeros(n)) for i in plan.loads + plan.dropped_loads]
                    + [reaction[:, list(held).index(row)] for row in plan.released]
                )
                if load_end.shape[1]
                else load_end
            )
            resolved = solver is not None
            converged, residual, iterations = np.ones(n, dtype=bool), np.zeros(n), np.zeros(n, dtype=int)
            steps = plan.increments if resolved else 1
            before = left
            for step in range(1, steps + 1):
                s = step / steps
                v, load = start + s * (target - start), load_start + s * (load_end - load_start)
                if resolved:
                    free = (v @ response.T.T + load @ response.L.T).reshape(n, m, d)
                    b = free - left
                    b[:, :, 0] = gap + free[:, :, 0]
                    # Where Coulomb's law has several solutions, take the one that continues the state before.
                    solution = solver.solve(b.reshape(n, m * d), guess=force)
                    force = solution.force
                    converged &= solution.converged
                    residual, iterations = np.maximum(residual, solution.residual), iterations + solution.iterations
                    left = free + (force @ response.S).reshape(n, m, d)
            if plan.kind == "locate" and m:
                left = (v @ response.T.T + load @ response.L.T).reshape(n, m, d)
            reading = v @ response.T_out.T + load @ response.L_out.T + force @ response.S_out.T
            reaction = v @ response.reaction_T.T + load @ response.reaction_L.T + force @ response.reaction_S.T
            held = {row: v[:, j] for j, row in enumerate(plan.bilateral)}
            load_before = {i: pushed[:, i] for i in plan.loads}
            if resolved:
                failed |= ~converged
                displacement = solution.displacement.reshape(n, m, d)
                if steps > 1:  # the solver's slip is that of the last increment
                    displacement[:, :, 1:] = (left - before)[:, :, 1:]
                resolutions[plan.name] = Resolution(
                    plan.name,
                    force.reshape(n, m, d).copy(),
                    displacement,
                    self._state(force.reshape(n, m, d)),
                    residual,
                    converged,
                    iterations,
                    np.asarray(solution.status),
                    reaction,
                )
        measured = (
            reading[:, self._output["measurement"]] + deviations @ (model.rows["measurement"] @ model.shape).T
            if scene.stages[-1].kind == "measure"
            else np.zeros((n, 0))
        )
        last = self.stages[-1]
        forces = (
            reaction @ last.bilateral + load @ last.load + force @ model.rows["contact"]
            if m
            else reaction @ last.bilateral + load @ last.load
        )
        motion = self._motion(last, v, forces)
        shape_motion = np.linalg.lstsq(model.G, model.shape - model.H @ model.shape_forces, rcond=None)[0]
        return Evaluation(
            self.law,
            deviations,
            resolutions,
            measured,
            failed,
            np.asarray(forces) + deviations @ model.shape_forces.T,
            motion + deviations @ shape_motion.T,
        )

    def blank(self, deviations: np.ndarray, reason: str) -> Evaluation:
        """The evaluation of samples that could not be computed: failed, all values NaN, the reason as their status."""
        model = self.model
        n, m, d = len(deviations), len(model.contacts), model.contacts.dimension
        nan = np.full((n, m, d), np.nan)
        resolutions = {
            p.plan.name: Resolution(
                p.plan.name,
                nan,
                nan,
                np.zeros((n, m), np.int8),
                np.full(n, np.nan),
                np.zeros(n, bool),
                np.zeros(n, int),
                np.full(n, reason, dtype=object),
                np.full((n, p.bilateral.shape[0]), np.nan),
            )
            for p, solver in zip(self.stages, self.solvers)
            if solver is not None
        }
        measured = len(model.scene.measurements) if model.scene.stages[-1].kind == "measure" else 0
        return Evaluation(
            self.law,
            deviations,
            resolutions,
            np.full((n, measured), np.nan),
            np.ones(n, bool),
            np.full((n, model.H.shape[0]), np.nan),
            np.full((n, model.G.shape[1]), np.nan),
        )

    def _targets(self, deviations):
        """Prescribed positions of locators and stroke clamps (n, ·), and clamp forces (n, ·)."""
        model, scene = self.model, self.model.scene
        n = len(deviations)
        moved = {kind: np.zeros((n, model.rows[kind].shape[0])) for kind in ("locator", "clamp")}
        names = {"locator": [item.name for item in scene.locators], "clamp": [item.name for item in scene.clamps]}
        for j, deviation in enumerate(scene.deviations):
            if deviation.kind != "force":
                moved[deviation.kind][:, names[deviation.kind].index(deviation.target)] += deviations[:, j]
        pushed = np.array([clamp.force or 0.0 for clamp in scene.clamps]) + moved["clamp"]
        nominal = {kind: -deviations @ (model.rows[kind] @ model.shape).T for kind in ("locator", "clamp")}
        nominal["clamp"] = nominal["clamp"] + np.array([clamp.stroke or 0.0 for clamp in scene.clamps])
        return nominal, moved, pushed

    @staticmethod
    def _value(kind, i, nominal, moved, frozen):
        return frozen[i] if kind == "weld" else nominal[kind][:, i] + moved[kind][:, i]

    def _motion(self, last, v, forces):
        """Rigid motions that put the bilateral rows at their values: least squares over A G q = v - A H f.

        Redundant rows take no part: their values have no effect, and may contradict the others.
        """
        rows = np.setdiff1d(np.arange(last.bilateral.shape[0]), last.response.redundant)
        reading = last.bilateral[rows] @ self.model.G
        misfit = v[:, rows] - (forces @ self.model.H) @ last.bilateral[rows].T
        return np.linalg.lstsq(reading, misfit.T, rcond=None)[0].T

    def _state(self, force):
        """Open, stick or slip of each contact: slip where the tangential force has reached the cone."""
        f_n = force[:, :, 0]
        loaded = f_n > 1e-9 * np.maximum(f_n.max(axis=1, keepdims=True, initial=0.0), 1e-300)
        state = loaded.astype(np.int8)
        if force.shape[2] == 3 and self.law != "frictionless":
            bound = self.model.contacts.friction * f_n
            state[loaded & (np.hypot(force[:, :, 1], force[:, :, 2]) >= bound * (1 - 1e-6))] = 2
        else:
            state[loaded] = 2
        return state
