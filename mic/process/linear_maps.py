"""Linear maps of a process: between the steps that solve contact, everything is linear.

With deviations a and the contact forces f_1 ... f_k of the steps solved so far, ``z = (1, a, f_1, ..., f_k)``,

    (b⁰, b¹) = z M_k,        readings = z R,

with b as in :mod:`mic.process.stage`. M and R are computed once for a process, by taking the unit vectors of z through
the stages. Other results of an assembly are computed by the stages when requested. Steps with limited forces, or with
parts that rest on springs, are not linear in z; such a process has no maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mic.contact.path import PathSolution, Trace
from mic.process.stage import PreparedStage
from mic.system.matrix_product import product

__all__ = ["Linear"]

MAX_NUMBERS = 500_000  # in the maps of a process, about 4 MB; larger problems gain little from them


class LinearMap:
    """A linear function of z.

    Parameters
    ----------
    table : (q, c) array
        Coefficients of the first q entries of z.
    edges : sequence of int
        Ends of (1, a), f_1, f_2 ... in z, up to q.
    """

    def __init__(self, table: np.ndarray, edges: Sequence[int]):
        parts = (np.ascontiguousarray(table[a:b]) for a, b in zip([0, *edges], edges))
        self._parts = [part if part.any() else None for part in parts]
        self._width = table.shape[1]

    def __call__(self, z: Sequence[np.ndarray]) -> np.ndarray:
        """(n, c) values from the parts (n, ...) of z; parts beyond q are ignored."""
        found = np.zeros((len(z[0]), self._width))
        for part, own in zip(self._parts, z):
            if part is not None:
                product(own, part, found)
        return found


@dataclass(frozen=True)
class SolvedStep:
    """A step that solves contact, as a function of the deviations and all earlier contact forces.

    Attributes
    ----------
    stage, step : int
        Number of the process's stage, and of its required step.
    unloaded : LinearMap to 2 d m
        b at the start and at the end of the step.
    overlap : LinearMap to m, or None
        Overlap of its contacts at the start, if the step resolves overlaps.
    anchor : LinearMap to m (d - 1), or None
        Anchors of slip; None if the previous solved step determines them.
    """

    stage: int
    step: int
    unloaded: LinearMap
    overlap: LinearMap | None
    anchor: LinearMap | None


@dataclass(frozen=True)
class Linear:
    """The linear maps of a process.

    Attributes
    ----------
    steps : list of SolvedStep
        In order.
    readings : LinearMap to r
        Readings of the measurements, the parts' shapes included; empty if nothing is measured.
    shape : (int, int)
        m and d.
    """

    steps: list[SolvedStep]
    readings: LinearMap
    shape: tuple[int, int]

    @classmethod
    def of(cls, process, deviations: int) -> Linear | None:
        """The maps of a process with this number of deviations; None if it is not linear, or if they are too large."""
        state = process.start(0)
        (m, d), solved = state.force.shape[1:], 0
        for stage in process.stages:
            if stage.plan.checked_limits or any(
                each.step.stops or each.rest.soft.any() for each in stage.required_steps
            ):
                return None
            solved += sum(map(stage.solves_contact, stage.required_steps))
        rows = 1 + deviations + solved * m * d
        if not solved or rows * solved * m * d > MAX_NUMBERS:
            return None
        return _record(process, deviations, rows, (m, d))

    def follow(
        self, stages: Sequence[PreparedStage], deviations: np.ndarray
    ) -> tuple[list[PathSolution], np.ndarray, np.ndarray]:
        """Take n assemblies through all stages.

        Parameters
        ----------
        stages : sequence of PreparedStage
            Of the process, or of one whose contacts differ only by their friction.
        deviations : (n, p) array

        Returns
        -------
        solutions : list of PathSolution
            Of the steps that solve contact, in order.
        readings : (n, r) array
        failed : (n,) bool array
        """
        n, (m, d) = len(deviations), self.shape
        z = [np.concatenate([np.ones((n, 1)), deviations], axis=1)]
        force, anchor, failed = np.zeros((n, m * d)), np.zeros((n, m, d - 1)), np.zeros(n, dtype=bool)
        solutions = []
        for solved_step in self.steps:
            stage = stages[solved_step.stage]
            unloaded = solved_step.unloaded(z).reshape(n, 2, m * d)
            if solved_step.overlap is not None:
                unloaded[:, 0, ::d] += np.maximum(0.0, solved_step.overlap(z))
            if solved_step.anchor is not None:
                anchor = solved_step.anchor(z).reshape(n, m, d - 1)
            solution = stage.solver(stage.required_steps[solved_step.step]).follow(unloaded, force, anchor, stage.path)
            force, anchor = solution.force, solution.anchor
            failed |= ~solution.converged
            solutions.append(solution)
            z.append(force)
        return solutions, self.readings(z), failed


def _record(process, deviations: int, rows: int, shape: tuple[int, int]) -> Linear:
    """The maps of a process: as many unit vectors as `rows`, one for each sample, are taken through all stages."""
    (m, d), edges = shape, [1 + deviations]
    steps: list[SolvedStep] = []

    def resolve(number, stage, anchors_follow_parts, batch):
        """Record the start of a step; its solution has the unit vectors of its forces."""
        start, end = (stage.unloaded(batch, s) for s in (0.0, 1.0))
        unloaded = LinearMap(np.concatenate([start, end], axis=1), edges)
        settles, at = batch.eliminated.step.settles, batch.anchor.reshape(rows, -1)
        overlap = LinearMap(stage.overlap(batch, start)[:, ::d], edges) if settles else None
        anchors = LinearMap(at, edges) if anchors_follow_parts else None
        steps.append(SolvedStep(*number, unloaded, overlap, anchors))
        force, anchor = np.zeros((rows, m * d)), np.zeros((rows, m, d - 1))
        force[edges[-1] : edges[-1] + m * d] = np.eye(m * d)
        edges.append(edges[-1] + m * d)
        none, text = np.zeros(rows), np.full(rows, "", dtype=object)
        converged, iterations = np.ones(rows, dtype=bool), np.zeros(rows, dtype=int)
        trace = Trace.start(rows, m)
        solution = PathSolution(force, np.zeros_like(force), anchor, trace, none, converged, iterations, text, text)
        return solution, np.zeros((rows, 0)), batch.place

    drive = process.drive(np.eye(1 + deviations, deviations, -1)).combined(partial(_linear_part, rows))
    state, readings, moved = process.start(rows), np.zeros((rows, 0)), True
    for i, stage in enumerate(process.stages):
        for j, eliminated in enumerate(stage.required_steps):
            state, solution = stage.step(eliminated, state, drive, partial(resolve, (i, j), stage, moved))
            moved = solution is None and (moved or eliminated.step.sets_down)
        if stage.plan.reads:
            readings = state.reading["measurement"] + drive.measured
    return Linear(steps, LinearMap(readings, edges), shape)


def _linear_part(rows: int, values: np.ndarray) -> np.ndarray:
    """The values without deviations (first), and their change by each unit, padded with zeros to `rows` rows."""
    found = np.zeros((rows, values.shape[1]))
    found[: len(values)] = values
    found[1 : len(values)] -= values[0]
    return found
