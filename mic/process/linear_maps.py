"""Linear maps of a process: between the steps that solve contact, everything is linear.

With deviations a and the contact forces f_1 ... f_k of the steps solved so far, ``z = (1, a, f_1, ..., f_k)``,

    (b⁰, b¹) = z M_k,        readings = z R,

with b as in :mod:`mic.process.stage`. M and R are computed once for a process, by taking the unit vectors of z through
the stages. Other results of an assembly are computed by the stages when requested. Steps with limited forces, or with
parts that rest on springs, are not linear in z; such a process has no maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from mic.contact.path import PathSolution, Trace
from mic.process.drive import Drive
from mic.process.stage import PreparedStage
from mic.process.state import ProcessState
from mic.system.matrix_product import product

__all__ = ["Linear", "StagedProcess"]

MAX_NUMBERS = 500_000  # in the maps of a process, about 4 MB; larger problems gain little from them


class StagedProcess(Protocol):
    """The interface of :class:`mic.process.process.Process` used here."""

    @property
    def stages(self) -> Sequence[PreparedStage]: ...

    def drive(self, deviations: np.ndarray) -> Drive: ...

    def start(self, n: int) -> ProcessState: ...


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
    def of(cls, process: StagedProcess, deviations: int) -> Linear | None:
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
        return _UnitVectors(process, deviations, rows, (m, d)).maps()

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


class _UnitVectors:
    """Unit vectors of z, one for each sample, taken through all stages.

    Parameters
    ----------
    process : StagedProcess
    deviations : int
    rows : int
        Length of z.
    shape : (int, int)
        m and d.
    """

    def __init__(self, process: StagedProcess, deviations: int, rows: int, shape: tuple[int, int]):
        self._process, self._shape, self._rows = process, shape, rows
        self._drive = linear_part(process.drive(np.eye(1 + deviations, deviations, -1)), rows)
        self._edges = [1 + deviations]  # ends of the parts of z known so far
        self._steps: list[SolvedStep] = []

    def maps(self) -> Linear:
        """Take the unit vectors through the stages."""
        process, drive = self._process, self._drive
        state, readings, moved = process.start(self._rows), np.zeros((self._rows, 0)), True
        for i, stage in enumerate(process.stages):
            for j, eliminated in enumerate(stage.required_steps):
                self._at, self._anchors_follow_parts = (i, j), moved
                state, solution = stage.step(eliminated, state, drive, self._resolve(stage))
                moved = solution is None and (moved or eliminated.step.sets_down)
            if stage.plan.reads:
                readings = state.reading["measurement"] + drive.measured
        return Linear(self._steps, LinearMap(readings, self._edges), self._shape)

    def _resolve(self, stage: PreparedStage):
        """Record the start of a step; its solution has the unit vectors of its forces."""

        def resolve(eliminated, state, drive, ramp, place):
            (m, d), n, edges = self._shape, self._rows, list(self._edges)
            start, end = (stage.unloaded(eliminated, drive, ramp, place, s) for s in (0.0, 1.0))
            overlap = stage.overlap(eliminated, state, drive, start)[:, ::d] if eliminated.step.settles else None
            parts = (
                np.concatenate([start, end], axis=1),
                overlap,
                state.anchor.reshape(n, -1) if self._anchors_follow_parts else None,
            )
            unloaded, *others = (None if one is None else LinearMap(one, edges) for one in parts)
            self._steps.append(SolvedStep(*self._at, unloaded, *others))
            force, none = np.zeros((n, m * d)), np.zeros(n)
            force[edges[-1] : edges[-1] + m * d] = np.eye(m * d)
            self._edges.append(edges[-1] + m * d)
            text = np.zeros(n, dtype=int), np.full(n, "", dtype=object), np.full(n, "", dtype=object)
            solution = PathSolution(
                force,
                np.zeros_like(force),
                np.zeros((n, m, d - 1)),
                Trace.start(n, m),
                none,
                np.ones(n, dtype=bool),
                *text,
            )
            return solution, np.zeros((n, 0)), place

        return resolve


def linear_part(drive: Drive, rows: int) -> Drive:
    """The drive without deviations (first), and its change by each unit deviation, padded with zeros to `rows` rows."""

    def part(values_of):
        found = np.zeros((rows, values_of.shape[1]))
        found[: len(values_of)] = values_of
        found[1 : len(values_of)] -= values_of[0]
        return found

    values = {field.name: getattr(drive, field.name) for field in fields(Drive)}
    target = {kind: part(values_of) for kind, values_of in values.pop("target").items()}
    return Drive(target, **{name: part(values_of) for name, values_of in values.items()})
