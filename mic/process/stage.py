"""One stage, prepared: its bilateral rows eliminated, its contacts ready to be solved; it takes the state one step on.

In stage z, with S, T and L of :class:`mic.compliance.elimination.Response`, prescribed values v and loads p,

    δ = S f + T v + L p,        b_n = g + (T v + L p)_n,        b_t = (T v + L p)_t − δ_t where the contact was left,

and the contact law ties f to ``u = S f + b``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, vstack

from mic.compliance.elimination import Response, eliminate
from mic.contact import ContactSolver
from mic.contact.states import classify
from mic.errors import FreeMotion, SceneError
from mic.process.drive import Drive
from mic.process.evaluation import Resolution
from mic.process.path import Increments, Ramp
from mic.process.plan import StagePlan, plan_stages
from mic.process.state import ProcessState

__all__ = ["OUTPUTS", "EliminatedStage", "PreparedStage", "eliminate_stages"]

OUTPUTS = ("locator", "clamp", "weld", "measurement")  #: kinds of rows that are read at the end of a stage


@dataclass(frozen=True)
class EliminatedStage:
    """One stage with its bilateral rows eliminated, whatever the contact law.

    Attributes
    ----------
    plan : StagePlan
    bilateral, load : (b, F), (l, F) csr_matrix
        Rows held, and rows that push: clamp forces, then rows let go, which fade out.
    response : Response
        Its output rows are those of all :data:`OUTPUTS`, in this order.
    """

    plan: StagePlan
    bilateral: csr_matrix
    load: csr_matrix
    response: Response


def eliminate_stages(model) -> list[EliminatedStage]:
    """Eliminate every stage of a reduced model; all contact laws share the outcome.

    Parameters
    ----------
    model : mic.model.reduction.Reduction

    Raises
    ------
    SceneError
        If a stage leaves a part free to move.
    """

    def rows_of(rows):
        none = csr_matrix((0, model.compliance.size))
        return vstack([none, *(model.rows[kind][i] for kind, i in rows)], format="csr")

    output = vstack([model.rows[kind] for kind in OUTPUTS], format="csr")
    stages = []
    for plan in plan_stages(model.scene, model.weld_size):
        bilateral = rows_of(plan.bilateral)
        load = rows_of([("clamp", i) for i in plan.loads + plan.dropped_loads] + list(plan.released))
        try:
            response = eliminate(model.compliance, bilateral, model.rows["contact"], load, output)
        except FreeMotion as error:
            share = [np.linalg.norm(error.motions[own]) for own in model.compliance.motions]
            raise SceneError(
                f"stages ({plan.name}): {error}, mostly of part {model.scene.parts[int(np.argmax(share))].name!r}; "
                "keep more locators in this stage, or join the part by welds with moment"
            ) from error
        stages.append(EliminatedStage(plan, bilateral, load, response))
    return stages


class PreparedStage:
    """A stage ready to take assemblies on, under one contact law.

    Parameters
    ----------
    stage : EliminatedStage
    model : mic.model.reduction.Reduction
    solver : ContactSolver or None
        None where the stage resolves no contact.
    """

    def __init__(self, stage: EliminatedStage, model, solver: ContactSolver | None):
        self.plan, self.response, self.bilateral, self.solver = stage.plan, stage.response, stage.bilateral, solver
        self._contacts, self._weld_first = model.contacts, model.joints.first
        edges = np.concatenate([[0], np.cumsum([model.rows[kind].shape[0] for kind in OUTPUTS])])
        self._output = {kind: slice(a, b) for kind, a, b in zip(OUTPUTS, edges, edges[1:])}

    def advance(self, state: ProcessState, drive: Drive) -> tuple[ProcessState, Resolution | None]:
        """Take n assemblies through the stage.

        Returns
        -------
        state : ProcessState
            At its end.
        resolution : Resolution or None
            None where no contact is resolved.
        """
        plan = self.plan
        frozen = self._make_welds(state, drive)
        ramp = self._ramp(state, drive, frozen)
        if self.solver is None:
            v, p = ramp.at(1.0)
            force, left, resolution = state.force, self._set_down(v, p, state), None
        else:
            force, left, resolution = self._resolve(state, drive, ramp)
        v, p = ramp.at(1.0)
        reading, reaction = self._outcome(v, p, force)
        after = ProcessState(
            reading=reading,
            force=force,
            left=left,
            failed=state.failed if resolution is None else state.failed | ~resolution.converged,
            value={row: v[:, j] for j, row in enumerate(plan.bilateral)},
            reaction={row: reaction[:, j] for j, row in enumerate(plan.bilateral)},
            push={i: drive.push[:, i] for i in plan.loads},
            frozen=frozen,
        )
        return after, resolution if resolution is None else replace(resolution, reaction=reaction)

    def _make_welds(self, state, drive):
        """What every weld row keeps: rows made here freeze what they find, unless the weld closes its gap first."""
        frozen = dict(state.frozen) | {row: state.reading["weld"][:, row].copy() for row in self.plan.made}
        return frozen | {int(self._weld_first[weld]): -drive.weld_gap[:, weld] for weld in self.plan.closing}

    def _ramp(self, state, drive, frozen) -> Ramp:
        """From what the rows read, and the forces that act, to what the stage asks for."""
        plan, n = self.plan, len(drive)
        none = np.zeros(n)

        def columns(arrays):
            return np.column_stack([np.zeros((n, 0)), *arrays])

        start = [state.value.get(row, state.reading[row[0]][:, row[1]]) for row in plan.bilateral]
        end = [frozen[i] if kind == "weld" else drive.target[kind][:, i] for kind, i in plan.bilateral]
        fading = [none] * (len(plan.dropped_loads) + len(plan.released))
        before = [state.push.get(i, none) for i in plan.loads + plan.dropped_loads]
        return Ramp(
            columns(start),
            columns(end),
            columns(before + [state.reaction[row] for row in plan.released]),
            columns([drive.push[:, i] for i in plan.loads] + fading),
        )

    def _set_down(self, v, p, state):
        """Where the contacts stand: parts set down one by one touch nothing yet; other stages without contact leave
        them."""
        if not self.plan.sets_down or not len(self._contacts):
            return state.left
        return (v @ self.response.T.T + p @ self.response.L.T).reshape(state.left.shape)

    def _resolve(self, state, drive, ramp):
        """Follow the ramp; returns contact forces, where the contacts were left, and what is known of the solution."""
        response, solver, shape = self.response, self.solver, state.left.shape
        n = len(drive)
        force, left = state.force, state.left
        converged, residual, iterations = np.ones(n, dtype=bool), np.zeros(n), np.zeros(n, dtype=int)
        for s in Increments(self.plan.increments).steps():
            v, p = ramp.at(s)
            free = (v @ response.T.T + p @ response.L.T).reshape(shape)
            b = free - left
            b[:, :, 0] = drive.gap + free[:, :, 0]
            # Where Coulomb's law has several solutions, take the one that continues the state before.
            solution = solver.solve(b.reshape(n, -1), guess=force.reshape(n, -1))
            force = solution.force.reshape(shape)
            converged &= solution.converged
            residual = np.maximum(residual, solution.residual)
            iterations = iterations + solution.iterations
            left = free + (solution.force @ response.S).reshape(shape)
        displacement = solution.displacement.reshape(shape)
        if self.plan.increments > 1:  # the solver's slip is that of the last increment
            displacement[:, :, 1:] = (left - state.left)[:, :, 1:]
        friction = self._contacts.friction if solver.law.frictional else 0.0
        resolution = Resolution(
            stage=self.plan.name,
            force=force.copy(),
            displacement=displacement,
            state=classify(force, friction),
            residual=residual,
            converged=converged,
            iterations=iterations,
            status=np.asarray(solution.status),
            rung=np.asarray(solution.rung),
            reaction=np.zeros((n, 0)),
        )
        return force, left, resolution

    def _outcome(self, v, p, force):
        """What the output rows read, by kind, and the reactions (n, b) of the bilateral rows."""
        response, f = self.response, force.reshape(len(force), -1)
        reading = v @ response.T_out.T + p @ response.L_out.T + f @ response.S_out.T
        reaction = v @ response.reaction_T.T + p @ response.reaction_L.T + f @ response.reaction_S.T
        return {kind: reading[:, own] for kind, own in self._output.items()}, reaction
