"""What of a process is linear: between the steps that solve their contacts, everything.

With deviations a and the contact forces f_1 ... f_k of the steps solved so far, ``z = (1, a, f_1, ..., f_k)``,

    (b⁰, b¹) = z M_k,        readings = z R,

b as :mod:`mic.process.stage` has it. M and R are what the stages themselves make of the unit vectors of z, found once
for a process; what else the stages find of an assembly, they find when it is asked for. Not where forces are limited
or parts rest on springs: there steps are not linear in z.
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

__all__ = ["Linear", "Staged"]

#: Numbers that the maps of a process hold, about, 4 MB: beside larger problems the stages' own work is little.
MOST = 500_000


class Staged(Protocol):
    """What is needed of a :class:`mic.process.process.Process`."""

    @property
    def stages(self) -> Sequence[PreparedStage]: ...

    def asked(self, deviations: np.ndarray) -> Drive: ...

    def start(self, n: int) -> ProcessState: ...


class Map:
    """Linear in z.

    Parameters
    ----------
    table : (q, c) array
        What the first q entries of z make.
    edges : sequence of int
        Where (1, a), f_1, f_2 ... end in z, as far as q.
    """

    def __init__(self, table: np.ndarray, edges: Sequence[int]):
        parts = (np.ascontiguousarray(table[a:b]) for a, b in zip([0, *edges], edges))
        self._parts = [part if part.any() else None for part in parts]
        self._width = table.shape[1]

    def __call__(self, z: Sequence[np.ndarray]) -> np.ndarray:
        """(n, c) from the parts (n, ...) of z, as many as there are or more."""
        found = np.zeros((len(z[0]), self._width))
        for part, own in zip(self._parts, z):
            if part is not None:
                product(own, part, found)
        return found


@dataclass(frozen=True)
class Before:
    """A step that solves its contacts, as a function of all that was before it.

    Attributes
    ----------
    stage, step : int
        Which of the process's stages, and of the steps that it needs.
    way : Map to 2 d m
        b where the step begins and where it ends.
    overlap : Map to m, or None
        By how much its contacts overlap at the beginning, where the step lets them settle.
    anchor : Map to m (d - 1), or None
        Where slip is measured from; None where the step solved before tells.
    """

    stage: int
    step: int
    way: Map
    overlap: Map | None
    anchor: Map | None


@dataclass(frozen=True)
class Linear:
    """The maps of a process.

    Attributes
    ----------
    steps : list of Before
        In order.
    readings : Map to r
        What measurements read, the parts' shapes included; to nothing where nothing is measured.
    shape : (int, int)
        m and d.
    """

    steps: list[Before]
    readings: Map
    shape: tuple[int, int]

    @classmethod
    def of(cls, process: Staged, deviations: int) -> Linear | None:
        """Of a process with so many deviations; None where it is not linear, or too large to be kept."""
        state = process.start(0)
        (m, d), solved = state.force.shape[1:], 0
        for stage in process.stages:
            if stage.plan.judged or any(each.step.stops or each.rest.soft.any() for each in stage.needed):
                return None
            solved += sum(map(stage.solved, stage.needed))
        rows = 1 + deviations + solved * m * d
        if not solved or rows * solved * m * d > MOST:
            return None
        return Probe(process, deviations, rows, (m, d)).found()

    def follow(
        self, stages: Sequence[PreparedStage], deviations: np.ndarray
    ) -> tuple[list[PathSolution], np.ndarray, np.ndarray]:
        """Take n assemblies through all stages.

        Parameters
        ----------
        stages : sequence of PreparedStage
            Of the process, or of one whose contacts differ by their friction alone.
        deviations : (n, p) array

        Returns
        -------
        solutions : list of PathSolution
            Of the steps that solve their contacts, in order.
        readings : (n, r) array
        failed : (n,) bool array
        """
        n, (m, d) = len(deviations), self.shape
        z = [np.concatenate([np.ones((n, 1)), deviations], axis=1)]
        force, anchor, failed = np.zeros((n, m * d)), np.zeros((n, m, d - 1)), np.zeros(n, dtype=bool)
        solutions = []
        for before in self.steps:
            stage = stages[before.stage]
            way = before.way(z).reshape(n, 2, m * d)
            if before.overlap is not None:
                way[:, 0, ::d] += np.maximum(0.0, before.overlap(z))
            if before.anchor is not None:
                anchor = before.anchor(z).reshape(n, m, d - 1)
            solution = stage.solver(stage.needed[before.step]).follow(way, force, anchor, stage.path)
            force, anchor = solution.force, solution.anchor
            failed |= ~solution.converged
            solutions.append(solution)
            z.append(force)
        return solutions, self.readings(z), failed


class Probe:
    """Unit vectors of z, one a sample, taken through all stages.

    Parameters
    ----------
    process : Staged
    deviations : int
    rows : int
        Of z in all.
    shape : (int, int)
        m and d.
    """

    def __init__(self, process: Staged, deviations: int, rows: int, shape: tuple[int, int]):
        self._process, self._shape, self._rows = process, shape, rows
        self._drive = linear_part(process.asked(np.eye(1 + deviations, deviations, -1)), rows)
        self._edges = [1 + deviations]  # of the parts of z that are known so far
        self._steps: list[Before] = []

    def found(self) -> Linear:
        """What the stages make of them."""
        process, drive = self._process, self._drive
        state, readings, moved = process.start(self._rows), np.zeros((self._rows, 0)), True
        for i, stage in enumerate(process.stages):
            for j, eliminated in enumerate(stage.needed):
                self._at, self._stands = (i, j), moved  # whether anchors are where parts were put, not where they slid
                state, solution = stage.step(eliminated, state, drive, self._resolve(stage))
                moved = solution is None and (moved or eliminated.step.sets_down)
            if stage.plan.reads:
                readings = state.reading["measurement"] + drive.measured
        return Linear(self._steps, Map(readings, self._edges), self._shape)

    def _resolve(self, stage: PreparedStage):
        """Keeps what a step begins from, and answers with the unit vectors of its forces."""

        def resolve(eliminated, state, drive, ramp, place):
            (m, d), n, edges = self._shape, self._rows, list(self._edges)
            start, end = (stage.unloaded(eliminated, drive, ramp, place, s) for s in (0.0, 1.0))
            overlap = stage.overlap(eliminated, state, drive, start)[:, ::d] if eliminated.step.settles else None
            parts = np.concatenate([start, end], axis=1), overlap, state.anchor.reshape(n, -1) if self._stands else None
            way, *others = (None if one is None else Map(one, edges) for one in parts)
            self._steps.append(Before(*self._at, way, *others))
            force, none = np.zeros((n, m * d)), np.zeros(n)
            force[edges[-1] : edges[-1] + m * d] = np.eye(m * d)
            self._edges.append(edges[-1] + m * d)
            blank = np.zeros(n, dtype=int), np.full(n, "", dtype=object), np.full(n, "", dtype=object)
            solution = PathSolution(
                force,
                np.zeros_like(force),
                np.zeros((n, m, d - 1)),
                Trace.start(n, m),
                none,
                np.ones(n, dtype=bool),
                *blank,
            )
            return solution, np.zeros((n, 0)), place

        return resolve


def linear_part(drive: Drive, rows: int) -> Drive:
    """Of what no deviation (first) and each unit deviation ask, the first and the others less the first, and nothing
    of so many rows more."""

    def part(asked):
        found = np.zeros((rows, asked.shape[1]))
        found[: len(asked)] = asked
        found[1 : len(asked)] -= asked[0]
        return found

    values = {field.name: getattr(drive, field.name) for field in fields(Drive)}
    target = {kind: part(asked) for kind, asked in values.pop("target").items()}
    return Drive(target, **{name: part(asked) for name, asked in values.items()})
