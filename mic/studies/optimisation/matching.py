"""Match measured parts of several kinds so that the average cost of their assemblies is smallest.

The cost of a combination of parts is the average over samples of the unmeasured deviations,

    c = (1/n) Σ_s Σ_k w_k ((y_sk − centre_k) / half a tolerance)²,

a quadratic loss; for the objectives `yield` and `cost` it is the share of samples outside plus a thousandth of that
loss, which orders combinations of equal share. The total cost is the sum over assemblies, so that two kinds form an
assignment problem, which is solved exactly [1]_. With more kinds, one kind at a time is reassigned to the combinations
of the others until nothing improves, which finds a local optimum.

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
from mic.scene.measured_report import read_measured_report
from mic.statistics.estimates import Estimate
from mic.statistics.paired_differences import mean_change
from mic.studies.optimisation.design import Design
from mic.studies.optimisation.evaluations import BLOCK, DesignEvaluator
from mic.system.files import fingerprint

__all__ = ["FARTHEST", "Kind", "Matched", "assign_parts", "combinations", "match_parts", "read_kinds"]

FARTHEST = 6.0  #: standard deviations from the mean beyond which a part is refused
ROUNDS = 50
FRESH_SAMPLES = 1000  # largest number of fresh samples of the unmeasured deviations
SHARE = 1e-3  # weight of the loss beside the share outside
UNFIT = 10.0  # loss of an assembly that cannot be built, above the largest other loss


@dataclass(frozen=True)
class Kind:
    """Measured parts of one kind.

    Attributes
    ----------
    name : str
    columns : list of int
        Numbers of the measured deviations.
    values : (n, c) array
    rows : list of int
        Row of each part in its file.
    """

    name: str
    columns: list[int]
    values: np.ndarray
    rows: list[int]


@dataclass(frozen=True)
class Matched:
    """Combinations of parts.

    Attributes
    ----------
    kinds : list of str
    rows : (a, t) int array
        File rows of the t parts of each of the a assemblies.
    left : list of list of int
        By kind, the rows of unused parts.
    before, after : float
        Average cost in the order of the files and as matched.
    rounds : int
        Number of assignment problems that were solved.
    """

    kinds: list[str]
    rows: np.ndarray
    left: list[list[int]]
    before: float
    after: float
    rounds: int


def read_kinds(scene: Scene) -> list[Kind]:
    """Read the measured parts that a scene names.

    Raises
    ------
    SceneError
        If a file is no table, names an unknown deviation or one that another kind measures, or holds a part that does
        not belong to the scene; the message names file, row and column.
    """
    assert scene.optimise is not None
    names = [entry.name for entry in scene.deviations]
    kinds: list[Kind] = []
    for i, entry in enumerate(scene.optimise.matching):
        path = scene.folder / entry.file
        try:
            kind = _read(entry.name, path, scene, names)
        except SceneError as problem:
            raise SceneError(f"optimise.matching[{i}].file ({entry.name}): {problem}") from None
        for other in kinds:
            repeated = [names[j] for j in kind.columns if j in other.columns]
            if repeated:
                raise SceneError(
                    f"optimise.matching[{i}].file ({entry.name}): {repeated[0]!r} is measured on {other.name} as well; "
                    "list each deviation for a single kind of part"
                )
        kinds.append(kind)
    return kinds


def _read(name: str, path: Path, scene: Scene, names: list[str]) -> Kind:
    report = read_measured_report(path, names, "deviation", folder=scene.folder)
    columns = [j for j, column in enumerate(names) if any(column in own for own in report.values.values())]
    values = np.array([[own.get(names[j], np.nan) for j in columns] for own in report.values.values()])
    for (i, j), value in np.ndenumerate(values):
        item = scene.deviations[columns[j]]
        at = f"{path}: row {report.rows[i]}, column {item.name}"
        if np.isnan(value):
            raise SceneError(f"{at}: is empty; add the value, or remove the part")
        if abs(value - item.mean) > FARTHEST * item.sigma:
            raise SceneError(
                f"{at}: {value:g} is more than {FARTHEST:g} standard deviations ({item.sigma:g}) off the mean, "
                f"{item.mean:g}; give the parts of this scene, or increase the sigma of the deviation"
            )
    if len(values) < 2:
        raise SceneError(f"{path}: the file has fewer than two parts; add rows")
    return Kind(name, columns, values, report.rows)


def assign_parts(kinds: Sequence[Kind], cost: Callable[[np.ndarray], np.ndarray]) -> Matched:
    """Combine parts at the smallest sum of costs.

    Parameters
    ----------
    kinds : sequence of Kind
    cost : callable
        Returns the costs (c,) of combinations (c, t), given as part numbers.
    """
    count = min(len(kind.values) for kind in kinds)
    matching = np.tile(np.arange(count)[:, None], (1, len(kinds)))
    before = float(cost(matching).mean())
    best, rounds = before, 0
    while rounds < ROUNDS * len(kinds):
        start = best
        for t in (*range(1, len(kinds)), 0) if len(kinds) > 2 else (1,):
            matching, best = _reassign(kinds, matching, t, cost)
            rounds += 1
        if len(kinds) == 2 or best >= start - 1e-12 * max(abs(start), 1.0):
            break
    rows = np.column_stack([np.array(kind.rows)[matching[:, t]] for t, kind in enumerate(kinds)])
    unused = [[row for row in kind.rows if row not in rows[:, t]] for t, kind in enumerate(kinds)]
    return Matched([kind.name for kind in kinds], rows, unused, before, best, rounds)


def _reassign(kinds, matching: np.ndarray, t: int, cost) -> tuple[np.ndarray, float]:
    """Reassign the parts of kind `t` to the combinations of the others; two kinds are assigned as a whole."""
    if len(kinds) == 2:
        matching = np.tile(np.arange(len(kinds[0].values))[:, None], (1, 2))
    count = len(kinds[t].values)
    candidates = np.repeat(matching, count, axis=0)
    candidates[:, t] = np.tile(np.arange(count), len(matching))
    table = cost(candidates).reshape(len(matching), count)
    rows, columns = linear_sum_assignment(table)
    changed = matching[rows].copy()
    changed[:, t] = columns
    return changed, float(table[rows, columns].mean())


def combinations(kinds: Sequence[Kind]) -> int:
    """Least number of combinations that are evaluated."""
    sizes = [len(kind.values) for kind in kinds]
    return sizes[0] * sizes[1] if len(sizes) == 2 else min(sizes) * sum(sizes)


def match_parts(
    evaluator: DesignEvaluator, design: Design, kinds: Sequence[Kind], fresh: int
) -> tuple[Matched, Estimate]:
    """Match measured parts under a design; also estimate the reduction of their average cost on fresh samples.

    The estimate has no interval if all deviations are measured.

    Parameters
    ----------
    evaluator : DesignEvaluator
    design : Design
    kinds : sequence of Kind
    fresh : int
    """
    losses = _LossTable(evaluator, design, kinds)
    remaining = (evaluator.budget - evaluator.spent) // combinations(kinds)
    samples = int(min(evaluator.samples, max(1, remaining)))
    result = assign_parts(kinds, lambda parts: losses.evaluate(parts, 0, samples).mean(axis=1))
    matching = np.column_stack([np.searchsorted(kind.rows, rows) for kind, rows in zip(kinds, result.rows.T)])
    if not losses.varying:
        return result, Estimate.of(np.zeros(1), result.before - result.after, np.nan, np.nan)
    in_file_order = np.tile(np.arange(len(matching))[:, None], (1, len(kinds)))
    count = min(fresh, FRESH_SAMPLES)
    after, before = (
        losses.evaluate(parts, evaluator.samples, count).mean(axis=0) for parts in (matching, in_file_order)
    )
    return result, mean_change(after, before)


class _LossTable:
    """Losses of combinations of parts under a design, each evaluated once."""

    def __init__(self, evaluator: DesignEvaluator, design: Design, kinds: Sequence[Kind]):
        self.evaluator, self.design, self.kinds = evaluator, design, kinds
        scene, objective = evaluator.space.scene, evaluator.objective
        measured = [j for kind in kinds for j in kind.columns]
        self.varying = any(deviation.sigma > 0 for j, deviation in enumerate(scene.deviations) if j not in measured)
        self.mean = np.array([[deviation.mean for deviation in scene.deviations]])
        centre = (objective.lower + objective.upper) / 2
        self.centre = np.where(np.isfinite(centre), centre, 0.0)
        self.weight = objective.weights * objective.included
        self._known: dict[tuple[tuple[int, ...], int], np.ndarray] = {}

    def evaluate(self, matching: np.ndarray, first: int, count: int) -> np.ndarray:
        """(c, count) losses over samples from number `first`; a single column if nothing else varies."""
        deviations = self.evaluator.draw_deviations(first, count) if self.varying else self.mean
        combinations = [*map(tuple, matching.tolist())]
        missing = [
            combination for combination in dict.fromkeys(combinations) if (combination, first) not in self._known
        ]
        step = max(1, BLOCK // len(deviations))
        for start in range(0, len(missing), step):
            batch = missing[start : start + step]
            x = np.tile(deviations, (len(batch), 1, 1))
            for t, kind in enumerate(self.kinds):
                x[:, :, kind.columns] = kind.values[[combination[t] for combination in batch], None]
            self._known.update(zip(((combination, first) for combination in batch), self._losses(x)))
        return np.array([self._known[combination, first] for combination in combinations])

    def _losses(self, x: np.ndarray) -> np.ndarray:
        """(c, n) losses of combinations with deviations (c, n, p)."""
        objective, deviations = self.evaluator.objective, x.reshape(-1, x.shape[2])
        evaluate = lambda: self.evaluator.evaluate(self.design, deviations)
        y, unfit = self.evaluator.load_or_evaluate(self.design, f"parts {fingerprint(x.tobytes())}", evaluate)
        squares = (self.weight * ((y - self.centre) / objective.half) ** 2).sum(axis=1)
        loss = np.where(unfit, squares.max(initial=0.0) + UNFIT, squares)
        if objective.kind in ("yield", "cost"):
            loss = (objective.outside(y) | unfit) + SHARE * loss
        return loss.reshape(x.shape[:2])
