"""What a step takes over from the state before it: where its rows begin, and which forces act or fade.

All of it are columns of a few arrays; which, the plans of the two steps decide, whatever the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.process.actions import Joints
from mic.process.drive import Drive
from mic.process.plan import Step
from mic.process.ramp import Ramp
from mic.process.row_values import Names, Values
from mic.process.state import KEPT, ProcessState

__all__ = ["RampColumns", "known"]


@dataclass(frozen=True)
class RampColumns:
    """From states of one kind to a step.

    Attributes
    ----------
    step : Step
    known : tuple of Names
        What the states before know: values, reactions, pushes, stops, what welds keep.
    rows, loads, stops, frozen : Names
        What the state after knows: the step's bilateral rows, clamp rows that push, stops, and weld rows that keep
        what they find.
    welded : (w,) int array
        Columns of what welds kept, of what weld rows read, and of the gaps that welds close: what they keep now.
    start, end : (b,) int array
        Columns of values and readings before, and of what welds keep now and the targets: the bilateral rows'.
    before, after : (l,) int array
        Columns of nothing, pushes and reactions before, and of nothing and pushes now: the load rows'.
    """

    step: Step
    known: tuple[Names, ...]
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
        """Of a state like this."""
        value, reaction, push, frozen = state.value, state.reaction, state.push, state.frozen
        read = _edges([value.table, *(state.reading[kind] for kind in READ)])
        weld = _edges([frozen.table, state.reading["weld"], drive.weld_gap])
        kept = dict(frozen.names.place)
        kept |= {row: weld[1] + row for row in step.made}
        kept |= {row: weld[2] + row for row in step.closed(joints)}
        names = frozen.names if not (step.made or step.closing) else Names(kept)
        asked = np.cumsum([0, len(names), *(drive.target[kind].shape[1] for kind in ASKED)])
        acts = np.cumsum([1, push.table.shape[1]])

        def start(row):
            return value.names.place[row] if row in value else read[1 + READ.index(row[0])] + row[1]

        def end(row):
            return names.place[row[1]] if row[0] == "weld" else asked[1 + ASKED.index(row[0])] + row[1]

        limited = [0] * len(step.stops + step.dropped_limits)
        before = [acts[0] + push.names.place[i] if i in push else 0 for i in step.loads + step.dropped_loads]
        after = [1 + i for i in step.loads] + [0] * len(step.dropped_loads)
        return cls(
            step,
            known(state),
            Names(step.bilateral),
            Names(step.loads),
            Names(limit.row for limit in step.stops),
            names,
            _integers(kept.values()),
            _integers(start(row) for row in step.bilateral),
            _integers(end(row) for row in step.bilateral),
            _integers([*before, *limited, *(acts[1] + reaction.names.place[row] for row in step.released)]),
            _integers([*after, *limited, *(0 for _ in step.released)]),
        )

    def keeps(self, state: ProcessState, drive: Drive) -> Values:
        """What every weld row keeps: rows made here freeze what they find, unless the weld closes its gap first."""
        frozen = state.frozen
        if self.frozen is frozen.names:
            return frozen
        found = np.concatenate([frozen.table, state.reading["weld"], -drive.weld_gap], axis=1)
        return Values(self.frozen, found[:, self.welded])

    def ramp(self, state: ProcessState, drive: Drive) -> Ramp:
        """From what the rows read, and the forces that act, to what the step asks for."""
        value, reaction, push, stop = state.value, state.reaction, state.push, state.stop
        frozen = self.keeps(state, drive).table[:, : len(self.frozen)]
        read = np.concatenate([value.table, *(state.reading[kind] for kind in READ)], axis=1)
        asked = np.concatenate([frozen, *(drive.target[kind] for kind in ASKED)], axis=1)
        start, end = read[:, self.start], asked[:, self.end]
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


#: kinds of rows that a step may hold, and those of them whose position the deviations ask for
READ, ASKED = ("locator", "clamp", "weld"), ("locator", "clamp")


def known(state: ProcessState) -> tuple[Names, ...]:
    """What a state knows: values, reactions, pushes, stops, what welds keep."""
    return tuple(getattr(state, name).names for name in KEPT)


def _edges(tables) -> np.ndarray:
    """Where the columns of each table begin when they stand side by side."""
    return np.cumsum([0, *(table.shape[1] for table in tables)])


def _integers(values) -> np.ndarray:
    return np.array(list(values), dtype=int)
