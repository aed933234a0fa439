"""Evaluate designs on common samples; each sample of a design is evaluated once and stored."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.run_identity import identity
from mic.statistics.draw import draw
from mic.statistics.estimates import jackknife_error
from mic.studies.adjustment import with_adjustments, with_changes
from mic.studies.optimisation.design import Design, Space
from mic.studies.optimisation.moved_items import RelocatedModels
from mic.studies.optimisation.objective import Objective
from mic.studies.samples import derivatives
from mic.system.files import Format, append_text, read_line, reading, to_line
from mic.system.regular_files import open_regular

__all__ = ["EvaluationLog", "BudgetExceeded", "DesignEvaluator"]

FORMAT = Format("log of evaluations", 1, "move it away or name another")
_log = logging.getLogger(__name__)

BLOCK = 20  # samples that are evaluated and stored together
MODELS = 6  # models held in memory
# Cost of a sample with derivatives, in evaluations: a constant and a share per setting.
DERIVATIVE_COST, SETTING_COST = 2.0, 0.05


class BudgetExceeded(Exception):
    """The budget of evaluations does not allow the next evaluation."""


class EvaluationLog:
    """Arrays of evaluated blocks of samples, in memory and in a file, from which an interrupted optimisation resumes.

    Parameters
    ----------
    path : Path or None
        File of JSON lines, each with its checksum; None stores nothing.
    stamp : str
        Identifies model, seed and law; records with another stamp are ignored and stay in the file. Truncated and
        altered records stay too; they are counted in a warning and evaluated again.

    Attributes
    ----------
    used : set of str
        Keys that were requested.
    """

    def __init__(self, path: Path | None, stamp: str):
        self.path, self.stamp = path, stamp
        self.used: set[str] = set()
        self._known: dict[str, dict[str, np.ndarray]] = {}
        if path is not None and path.is_file():
            self._read(path)

    def _read(self, path: Path) -> None:
        damaged = 0
        with reading(path, FORMAT), open_regular(path) as file:
            for line in file:
                record = read_line(line)
                damaged += record is None and line.endswith(b"\n") and bool(line.strip())  # else of a killed run
                if record is not None and record["stamp"] == self.stamp:
                    arrays = {name: np.array(value, dtype=float) for name, value in record["arrays"].items()}
                    self._known[record["key"]] = arrays
        if damaged:
            _log.warning("%s: %d records are cut short or damaged; they are evaluated again", path, damaged)

    def arrays(self, key: str, evaluate: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Arrays of a key: known ones, or evaluated and appended to the file; they are on disk on return."""
        self.used.add(key)
        if key not in self._known:
            self._known[key] = evaluate()
            if self.path is not None:
                lists = {name: value.tolist() for name, value in self._known[key].items()}
                append_text(self.path, to_line({"stamp": self.stamp, "key": key, "arrays": lists}))
        return self._known[key]


class DesignEvaluator:
    """Evaluates samples under designs within a budget.

    Parameters
    ----------
    model : ReducedModel
    space : Space
    law : str
    samples, seed : int
        Number of samples of the search, and the seed; samples with higher numbers are fresh.
    budget : int
        Evaluations of an assembly; an evaluation with derivatives counts as several.
    threads : int
    relocated : RelocatedModels or None
        Models with items at other places.
    ledger : Path, optional
        File of the :class:`EvaluationLog`.
    progress : callable
        Called with the number of evaluations.

    Attributes
    ----------
    spent : float
        Evaluations of the search so far, including those read from the log.
    """

    def __init__(
        self,
        model: ReducedModel,
        space: Space,
        law: str,
        samples: int,
        seed: int,
        budget: float,
        threads: int = 1,
        relocated: RelocatedModels | None = None,
        ledger: Path | None = None,
        progress: Callable[[int], None] = lambda count: None,
    ):
        self.space, self.law, self.samples, self.seed, self.budget = space, law, samples, seed, budget
        self.objective = Objective(space)
        self.threads, self.progress, self.spent, self._relocated = threads, progress, 0.0, relocated
        # Paired intervals require independent samples.
        carlo = model.scene.monte_carlo.model_copy(update={"design": "independent"})
        self._drawing = model.scene.model_copy(update={"monte_carlo": carlo})
        self._log = EvaluationLog(ledger, f"{identity(model, seed)} {law}")
        self._bases = {(0,) * len(space.items): with_adjustments(model, space.settings)}
        self._ordered_model = lru_cache(maxsize=MODELS)(self._build_model)

    # --------------------------------------------------------------------------------------------------- samples

    def draw_deviations(self, first: int, count: int) -> np.ndarray:
        """(count, p) deviations of samples; fewer if the scene's table of samples ends."""
        return draw(self._drawing, self.seed, first, count)

    def model(self, design: Design) -> tuple[ReducedModel, list[str]]:
        """The model of a design with a deviation for each setting, and the names of these deviations."""
        ordered = self._ordered_model(replace(design, settings=self.space.stated.settings))
        return ordered, self._bases[design.places][1]

    def _build_model(self, design: Design) -> ReducedModel:
        """The model with the orders and places of a design."""
        if design.places not in self._bases:
            assert self._relocated is not None
            relocated = self._relocated.model(self.space.with_places_of(design))
            self._bases[design.places] = with_adjustments(relocated, self.space.settings)
        return self.space.with_orders_of(self._bases[design.places][0], design)

    def evaluate(self, design: Design, deviations: np.ndarray) -> dict[str, np.ndarray]:
        """Key characteristics ``y`` (n, k) of samples (n, p) under a design; ``unfit`` (n,) is 1 for those that failed
        or could not be built."""
        process = self.model(design)[0].process(self.law, threads=self.threads)
        evaluation = process.attempt(with_changes(deviations, design.settings))
        self.progress(len(deviations))
        unfit = evaluation.failed | ~evaluation.built
        y = np.where(evaluation.failed[:, None], 0.0, evaluation.measurements)
        return {"y": y, "unfit": unfit.astype(float)}

    def block(self, design: Design, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics and failures of a block of samples under a design: from memory, log or evaluation."""

        def evaluate() -> dict[str, np.ndarray]:
            deviations = self.draw_deviations(number * BLOCK, BLOCK)
            try:
                return self.evaluate(design, deviations)
            except SceneError:  # with this order a part is unconstrained
                n, k = len(deviations), len(self.space.scene.measurements)
                return {"y": np.zeros((n, k)), "unfit": np.ones(n)}

        return self.load_or_evaluate(design, f"values {number}", evaluate)

    def load_or_evaluate(
        self, design: Design, what: str, evaluate: Callable[[], dict[str, np.ndarray]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics and failures of samples of a design from the log, or evaluated and stored there."""
        arrays = self._log.arrays(self._key(design, what), evaluate)
        return arrays["y"], arrays["unfit"].astype(bool)

    def _key(self, design: Design, what: str) -> str:
        changes = [(change.kind, change.targets, change.after) for change in self.space.changes(design)]
        return f"{json.dumps(changes)} {what}"

    def values(self, design: Design, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics and failures of samples under a design; they do not count towards the budget."""
        blocks = range(first // BLOCK, -(-(first + count) // BLOCK))
        y, unfit = (np.concatenate(parts) for parts in zip(*(self.block(design, number) for number in blocks)))
        start = first - blocks[0] * BLOCK
        return y[start : start + count], unfit[start : start + count]

    # ---------------------------------------------------------------------------------------------------- search

    def search_values(self, design: Design, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The first samples of the search under a design; new evaluations count towards the budget.

        Raises
        ------
        BudgetExceeded
        """
        count = self.samples if count is None else min(count, self.samples)
        keys = {self._key(design, f"values {number}") for number in range(-(-count // BLOCK))}
        self._spend(min(len(keys - self._log.used) * BLOCK, self.samples))
        return self.values(design, 0, count)

    def values_with_derivatives(self, design: Design) -> tuple[np.ndarray, np.ndarray]:
        """Samples (n, k) under a design that have derivatives, and these derivatives (n, k, a).

        Raises
        ------
        BudgetExceeded
        """
        if self._key(design, "slopes 0") not in self._log.used:
            self._spend(self.samples * (DERIVATIVE_COST + SETTING_COST * len(self.space.settings)))

        def evaluate(first: int) -> dict[str, np.ndarray]:
            model, names = self.model(design)
            deviations = self.draw_deviations(first, min(BLOCK, self.samples - first))
            x = with_changes(deviations, design.settings)
            return dict(zip(("y", "slopes"), derivatives(model, x, self.law, self.progress, names)))

        blocks = [
            self._log.arrays(self._key(design, f"slopes {first}"), partial(evaluate, first))
            for first in range(0, self.samples, BLOCK)
        ]
        y, slopes = (np.concatenate([block[name] for block in blocks]) for name in ("y", "slopes"))
        known = np.isfinite(y).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
        return y[known], slopes[known]

    def merit(self, design: Design, count: int | None = None) -> float:
        """Merit of a design on the first samples; infinite if more of them fail than under the stated scene.

        Raises
        ------
        BudgetExceeded
        """
        y, unfit = self.search_values(design, count)
        _, stated = self.values(self.space.stated, 0, len(unfit))
        if unfit.sum() > stated.sum() and self.objective.kind not in ("yield", "cost"):
            return np.inf
        return self.objective.merit(y, unfit, design.settings)

    def is_better(self, design: Design, other: Design) -> bool:
        """Whether a design is better than another on the samples of the search.

        The design is rejected on a part of the samples if its merit is worse by more than the standard error of the
        difference of merits, estimated by the jackknife over ten groups.

        Raises
        ------
        BudgetExceeded
        """
        count = self.samples
        for part in sorted({-(-count // 4 // BLOCK) * BLOCK, -(-count // 2 // BLOCK) * BLOCK}):
            if 0 < part < count and self._clearly_worse(design, other, part):
                return False
        return self.merit(design) < self.merit(other)

    def _clearly_worse(self, design: Design, other: Design, part: int) -> bool:
        if not np.isfinite(self.merit(design, part)):
            return True
        sides = [(candidate, *self.search_values(candidate, part)) for candidate in (design, other)]
        groups = np.arange(part) % min(10, part)

        def difference(selected: np.ndarray) -> float:
            merits = [
                self.objective.merit(y[selected], unfit[selected], candidate.settings) for candidate, y, unfit in sides
            ]
            return merits[0] - merits[1]

        without = np.array([difference(groups != g) for g in np.unique(groups)])
        return bool(np.isfinite(without).all() and difference(groups >= 0) > jackknife_error(without))

    def _spend(self, count: float) -> None:
        if self.spent + count > self.budget:
            raise BudgetExceeded
        self.spent += count
