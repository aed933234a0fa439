"""Measured parts of several kinds, put together so that the assemblies become as good as they can.

What a combination costs the model says: what no kind measures varies, and the average over samples of it counts,

    c = (1/n) Σ_s Σ_k w_k ((y_sk − centre_k) / half a tolerance)²,

the loss that grows with mean and variance alike; for the objectives `yield` and `cost` the share of samples outside,
and a thousandth of that loss, which tells equals apart. Costs of different assemblies add up, so that two kinds are an
assignment problem, which is solved exactly [1]_. More kinds are taken one at a time, each assigned anew to what the
others have been put together to, until nothing improves: with more than two that finds no more than a local optimum.

References
----------
.. [1] D. F. Crouse: On implementing 2D rectangular assignment algorithms, IEEE Trans. Aerosp. Electron. Syst. 52 (2016)
       1679-1696; scipy.optimize.linear_sum_assignment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from mic.errors import SceneError
from mic.scene import Scene
from mic.scene.tables import read_cells, read_number
from mic.statistics.estimates import Estimate
from mic.statistics.paired_differences import mean_change
from mic.studies.optimisation.design import Design
from mic.studies.optimisation.evaluations import BLOCK, Trials
from mic.system.files import fingerprint

__all__ = ["FARTHEST", "Kind", "Matched", "assigned", "combinations", "matched", "read_kinds"]

FARTHEST = 6.0  #: standard deviations: a part farther off than that is not one of this scene's
ROUNDS = 50
JUDGED = 1000  # fresh samples of what was not measured, at most
SHARE = 1e-3  # of the loss, beside the share outside
UNFIT = 10.0  # loss of an assembly that cannot be built, beyond the largest


@dataclass(frozen=True)
class Kind:
    """Measured parts of one kind.

    Attributes
    ----------
    name : str
    columns : list of int
        The deviations that were measured, by their numbers.
    values : (n, c) array
    rows : list of int
        Where each stands in its file.
    """

    name: str
    columns: list[int]
    values: np.ndarray
    rows: list[int]


@dataclass(frozen=True)
class Matched:
    """Parts put together.

    Attributes
    ----------
    kinds : list of str
    rows : (a, t) int array
        Of a assemblies, the row in the file of each of their t parts.
    left : list of list of int
        By kind, the rows of parts that no assembly takes.
    before, after : float
        Their average cost in the order of the files and as they are matched.
    rounds : int
        Assignments that were solved.
    """

    kinds: list[str]
    rows: np.ndarray
    left: list[list[int]]
    before: float
    after: float
    rounds: int


def read_kinds(scene: Scene) -> list[Kind]:
    """The measured parts that a scene names.

    Raises
    ------
    SceneError
        Naming file, row and column: for files that are no tables, deviations that the scene does not have or that two
        kinds measure, and parts that are not of this scene.
    """
    assert scene.optimise is not None
    names = [one.name for one in scene.deviations]
    kinds: list[Kind] = []
    for i, one in enumerate(scene.optimise.matching):
        path = scene.folder / one.file
        try:
            kind = _read(one.name, path, scene, names)
        except SceneError as problem:
            raise SceneError(f"optimise.matching[{i}].file ({one.name}): {problem}") from None
        for other in kinds:
            twice = [names[j] for j in kind.columns if j in other.columns]
            if twice:
                raise SceneError(
                    f"optimise.matching[{i}].file ({one.name}): {twice[0]!r} is measured on {other.name} as well; each "
                    "deviation belongs to one kind of part"
                )
        kinds.append(kind)
    return kinds


def _read(name: str, path: Path, scene: Scene, names: list[str]) -> Kind:
    cells, separator = read_cells(path)
    strange = [str(column) for column in cells.columns if column not in names]
    if strange:
        raise SceneError(
            f"{path}: row 1: there is no deviation {strange[0]!r} in this scene; known: {', '.join(names)}"
        )
    columns = [names.index(str(column)) for column in cells.columns]
    values, rows = [], []
    for number, record in enumerate(cells.to_numpy().tolist(), 2):
        if not any(str(cell).strip() for cell in record):
            continue
        own = [read_number(str(cell).strip(), separator) for cell in record]
        for j, value, cell in zip(columns, own, record):
            item = scene.deviations[j]
            if not np.isfinite(value):
                raise SceneError(f"{path}: row {number}, column {item.name}: {cell!r} is no finite number; correct it")
            if abs(value - item.mean) > FARTHEST * item.sigma:
                raise SceneError(
                    f"{path}: row {number}, column {item.name}: {value:g} is more than {FARTHEST:g} standard "
                    f"deviations ({item.sigma:g}) off the mean, {item.mean:g}; these are no parts of this scene, or it "
                    "must be told how much they vary"
                )
        values.append(own)
        rows.append(number)
    if len(rows) < 2:
        raise SceneError(f"{path}: there are not two parts in it; fill it in")
    return Kind(name, columns, np.array(values), rows)


def assigned(kinds: Sequence[Kind], cost: Callable[[np.ndarray], np.ndarray]) -> Matched:
    """Put parts together at the least sum of costs.

    Parameters
    ----------
    kinds : sequence of Kind
    cost : callable
        Costs (c,) of combinations (c, t), each the numbers of its parts.
    """
    count = min(len(one.values) for one in kinds)
    together = np.tile(np.arange(count)[:, None], (1, len(kinds)))
    before = float(cost(together).mean())
    best, rounds = before, 0
    while rounds < ROUNDS * len(kinds):
        start = best
        for t in range(1, len(kinds)) if len(kinds) > 2 else (1,):
            together, best = _assigned_anew(kinds, together, t, cost)
            rounds += 1
        if len(kinds) > 2:
            together, best = _assigned_anew(kinds, together, 0, cost)
            rounds += 1
        if len(kinds) == 2 or best >= start - 1e-12 * max(abs(start), 1.0):
            break
    numbers = [np.array(one.rows) for one in kinds]
    rows = np.column_stack([own[together[:, t]] for t, own in enumerate(numbers)])
    left = [[int(row) for row in own if row not in rows[:, t]] for t, own in enumerate(numbers)]
    return Matched([one.name for one in kinds], rows, left, before, best, rounds)


def _assigned_anew(kinds, together: np.ndarray, t: int, cost) -> tuple[np.ndarray, float]:
    """The parts of one kind assigned anew to what the others are put together to; of two kinds that have unlike many
    parts, all of the first take part."""
    if len(kinds) == 2:
        first, second = len(kinds[0].values), len(kinds[1].values)
        pairs = np.stack(np.meshgrid(np.arange(first), np.arange(second), indexing="ij"), axis=-1).reshape(-1, 2)
        table = cost(pairs).reshape(first, second)
        rows, columns = linear_sum_assignment(table)
        return np.column_stack([rows, columns]), float(table[rows, columns].mean())
    own = len(kinds[t].values)
    every = np.repeat(together, own, axis=0)
    every[:, t] = np.tile(np.arange(own), len(together))
    table = cost(every).reshape(len(together), own)
    rows, columns = linear_sum_assignment(table)
    found = together[rows].copy()
    found[:, t] = columns
    return found, float(table[rows, columns].mean())


def combinations(kinds: Sequence[Kind]) -> int:
    """How many are evaluated, at the least."""
    sizes = [len(kind.values) for kind in kinds]
    return sizes[0] * sizes[1] if len(sizes) == 2 else min(sizes) * sum(sizes)


def matched(trials: Trials, design: Design, kinds: Sequence[Kind], fresh: int) -> tuple[Matched, Estimate]:
    """Measured parts matched under a design, and by how much their average cost falls on fresh samples of what was not
    measured; without an interval where all was.

    Parameters
    ----------
    trials : Trials
    design : Design
    kinds : sequence of Kind
    fresh : int
    """
    losses = _Losses(trials, design, kinds)
    left = (trials.budget - trials.spent) // combinations(kinds)
    found = assigned(kinds, lambda own: losses.of(own, 0, int(min(trials.samples, max(1, left)))).mean(axis=1))
    places = [{row: i for i, row in enumerate(kind.rows)} for kind in kinds]
    together = np.array([[own[row] for own, row in zip(places, rows)] for rows in found.rows.tolist()])
    if not losses.open:
        return found, Estimate.of(np.zeros(1), found.before - found.after, np.nan, np.nan)
    apart = np.tile(np.arange(len(together))[:, None], (1, len(kinds)))
    matched, before = (losses.of(own, trials.samples, min(fresh, JUDGED)).mean(axis=0) for own in (together, apart))
    return found, mean_change(matched, before)


class _Losses:
    """Losses of combinations under a design."""

    def __init__(self, trials: Trials, design: Design, kinds: Sequence[Kind]):
        self.trials, self.design, self.kinds = trials, design, kinds
        scene, objective = trials.space.scene, trials.objective
        measured = [j for kind in kinds for j in kind.columns]
        self.open = any(one.sigma > 0 for j, one in enumerate(scene.deviations) if j not in measured)
        self.mean = np.array([[one.mean for one in scene.deviations]])
        centre = (objective.lower + objective.upper) / 2
        self.centre = np.where(np.isfinite(centre), centre, 0.0)
        self.weight = objective.weights * objective.own
        self._known: dict[tuple[tuple[int, ...], int], np.ndarray] = {}

    def of(self, some: np.ndarray, first: int, count: int) -> np.ndarray:
        """(c, count) of samples from one on; where nothing else varies, of one."""
        drawn = self.trials.drawn(first, count) if self.open else self.mean
        every = [*map(tuple, some.tolist())]
        wanted = [own for own in dict.fromkeys(every) if (own, first) not in self._known]
        step = max(1, BLOCK // len(drawn))
        for start in range(0, len(wanted), step):
            part = wanted[start : start + step]
            x = np.tile(drawn, (len(part), 1))
            for i, own in enumerate(part):
                for kind, number in zip(self.kinds, own):
                    x[i * len(drawn) : (i + 1) * len(drawn), kind.columns] = kind.values[number]
            loss = self._evaluated(x).reshape(len(part), -1)
            self._known.update({(own, first): values for own, values in zip(part, loss)})
        return np.array([self._known[own, first] for own in every])

    def _evaluated(self, x: np.ndarray) -> np.ndarray:
        objective = self.trials.objective

        def evaluated() -> dict[str, np.ndarray]:
            y, unfit = self.trials.at(self.design, x)
            return {"y": y, "unfit": unfit.astype(float)}

        kept = self.trials.once(self.design, f"parts {fingerprint(x.tobytes())}", evaluated)
        y, unfit = kept["y"].reshape(len(x), -1), kept["unfit"].astype(bool)
        off = (self.weight * ((y - self.centre) / objective.half) ** 2).sum(axis=1)
        loss = np.where(unfit, off.max(initial=0.0) + UNFIT, off)
        if objective.kind in ("yield", "cost"):
            loss = (objective.outside(y) | unfit) + SHARE * loss
        return loss
