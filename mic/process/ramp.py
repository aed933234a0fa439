"""The ramp of a step: how its load grows, on which friction depends.

With s from 0 to 1 over a step, bilateral rows go from their previous readings to their targets, ``v(s) = v⁰ + s (v¹ −
v⁰)``; clamp forces grow from their previous values; released rows and removed forces fade, ``p(s) = p⁰ + s (p¹ − p⁰)``.

The plans of two successive steps determine the columns of the previous state and of the drive from which the ramp is
assembled, whatever the samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mic.model.rows import Joints
from mic.process.drive import Drive
from mic.process.plan import Step
from mic.process.state import ROW_VALUES, Names, ProcessState, Values

__all__ = ["Ramp", "RampColumns", "row_names"]


@dataclass(frozen=True)
class Ramp:
    """Values and loads of n assemblies that grow together over a step.

    Attributes
    ----------
    value_start, value_end : (n, b) array
        Of the bilateral rows, mm and rad.
    load_start, load_end : (n, l) array
        Of the load rows, N and N mm.
    """

    value_start: np.ndarray
    value_end: np.ndarray
    load_start: np.ndarray
    load_end: np.ndarray

    def at(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Values and loads at s."""
        return (
            self.value_start + s * (self.value_end - self.value_start),
            self.load_start + s * (self.load_end - self.load_start),
        )


@dataclass(frozen=True)
class RampColumns:
    """Columns of states with the same rows that lead to a step.

    Attributes
    ----------
    step : Step
    rows, loads, stops, frozen : Names
        Rows of the state after: the step's bilateral rows, clamp rows that push, stops, and frozen weld rows.
    welded : (w,) int array
        For each frozen weld row, its column among the values frozen before, the readings of weld rows, and the gaps
        that welds close.
    start, end : (b,) int array
        For each bilateral row, its column among values and readings before, and among frozen weld values and targets.
    before, after : (l,) int array
        For each load row, its column among zero, pushes and reactions before, and among zero and pushes now.
    """

    step: Step
    rows: Names
    loads: Names
    stops: Names
    frozen: Names
    welded: np.ndarray
    start: np.ndarray
    end: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @classmethod
    def of(cls, step: Step, state: ProcessState, drive: Drive, joints: Joints) -> RampColumns:
        """The columns for states with the rows of this one."""
        value, reaction, push, frozen = state.value, state.reaction, state.push, state.frozen
        read = _first_columns([value.table, *(state.reading[kind] for kind in HELD)])
        weld = _first_columns([frozen.table, state.reading["weld"], drive.weld_gap])
        frozen_columns = dict(frozen.names.column)
        frozen_columns |= {row: weld[1] + row for row in step.made}
        frozen_columns |= {row: weld[2] + row for row in step.closed(joints)}
        names = frozen.names if not (step.made or step.closing) else Names(frozen_columns)
        targets = np.cumsum([0, len(names), *(drive.target[kind].shape[1] for kind in PRESCRIBED)])
        pushes = np.cumsum([1, push.table.shape[1]])

        def start(row):
            return value.names.column[row] if row in value else read[1 + HELD.index(row[0])] + row[1]

        def end(row):
            return names.column[row[1]] if row[0] == "weld" else targets[1 + PRESCRIBED.index(row[0])] + row[1]

        zeros = [0] * len(step.stops + step.dropped_limits)
        before = [pushes[0] + push.names.column[i] if i in push else 0 for i in step.loads + step.dropped_loads]
        after = [1 + i for i in step.loads] + [0] * len(step.dropped_loads)
        return cls(
            step,
            Names(step.bilateral),
            Names(step.loads),
            Names(limit.row for limit in step.stops),
            names,
            _integers(frozen_columns.values()),
            _integers(start(row) for row in step.bilateral),
            _integers(end(row) for row in step.bilateral),
            _integers([*before, *zeros, *(pushes[1] + reaction.names.column[row] for row in step.released)]),
            _integers([*after, *zeros, *(0 for _ in step.released)]),
        )

    def weld_values(self, state: ProcessState, drive: Drive) -> Values:
        """The frozen value of every weld row: a row made in this step freezes its reading, or closes its gap first."""
        frozen = state.frozen
        if self.frozen is frozen.names:
            return frozen
        found = np.concatenate([frozen.table, state.reading["weld"], -drive.weld_gap], axis=1)
        return Values(self.frozen, found[:, self.welded])

    def ramp(self, state: ProcessState, drive: Drive) -> Ramp:
        """From the current readings and forces to the values and loads that the step prescribes."""
        value, reaction, push, stop = state.value, state.reaction, state.push, state.stop
        frozen = self.weld_values(state, drive).table[:, : len(self.frozen)]
        read = np.concatenate([value.table, *(state.reading[kind] for kind in HELD)], axis=1)
        targets = np.concatenate([frozen, *(drive.target[kind] for kind in PRESCRIBED)], axis=1)
        start, end = read[:, self.start], targets[:, self.end]
        if not len(self.before):
            none = np.zeros((len(start), 0))
            return Ramp(start, end, none, none)
        nothing = np.zeros((len(start), 1))
        before = np.concatenate([nothing, push.table, reaction.table], axis=1)[:, self.before]
        after = np.concatenate([nothing, drive.push], axis=1)[:, self.after]
        first = len(self.step.loads + self.step.dropped_loads)
        for j, limit in enumerate(self.step.stops + self.step.dropped_limits, first):
            if j < first + len(self.stops):
                before[:, j], after[:, j] = limit.load * (limit.row in stop), limit.load
            else:
                before[:, j] = limit.load - limit.sign * stop[limit.row]
        return Ramp(start, end, before, after)


#: kinds of rows that a step may hold, and those of them whose position the drive prescribes
HELD, PRESCRIBED = ("locator", "clamp", "weld"), ("locator", "clamp")


def row_names(state: ProcessState) -> tuple[Names, ...]:
    """Rows of a state: values, reactions, pushes, stops, frozen weld rows."""
    return tuple(getattr(state, name).names for name in ROW_VALUES)


def _first_columns(tables: Iterable[np.ndarray]) -> np.ndarray:
    """The first column of each table when they are placed side by side."""
    return np.cumsum([0, *(table.shape[1] for table in tables)])


def _integers(values: Iterable[int]) -> np.ndarray:
    return np.array(list(values), dtype=int)
