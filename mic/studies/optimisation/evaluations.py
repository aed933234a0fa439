"""Evaluate designs on common samples; each sample of a design is evaluated once and stored."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.run_identity import identity
from mic.statistics.draw import draw
from mic.studies.optimisation.design import Design, Space
from mic.studies.optimisation.moved_items import RelocatedModels
from mic.studies.optimisation.objective import Objective
from mic.system.files import append_text

__all__ = ["EvaluationLog", "BudgetExceeded", "DesignEvaluator"]

BLOCK = 20  # samples that are evaluated and stored together
MODELS = 6  # models held in memory
# Cost of a sample with derivatives, in evaluations: a constant and a share per setting.
DERIVATIVE_COST, SETTING_COST = 2.0, 0.05


class BudgetExceeded(Exception):
    """The budget of evaluations does not allow the next evaluation."""


class EvaluationLog:
    """Log of evaluated blocks of samples, from which an interrupted optimisation resumes.

    Parameters
    ----------
    path : Path or None
        File of JSON lines; None stores nothing.
    stamp : str
        Identifies model, seed and law; records with another stamp are ignored and stay in the file.
    """

    def __init__(self, path: Path | None, stamp: str):
        self.path, self.stamp = path, stamp
        self._records: dict[str, dict[str, Any]] = {}
        if path is not None and path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    record = json.loads(line)
                    if record["stamp"] == stamp:
                        self._records[record["key"]] = record["arrays"]
                except (ValueError, KeyError, TypeError):  # incomplete record of an interrupted run
                    continue
            if not path.read_bytes().endswith(b"\n"):
                append_text(path, "\n")

    def find(self, key: str) -> dict[str, np.ndarray] | None:
        """Arrays of a key, or None."""
        arrays = self._records.get(key)
        return None if arrays is None else {name: np.array(value, dtype=float) for name, value in arrays.items()}

    def store(self, key: str, arrays: dict[str, np.ndarray]) -> None:
        """Append arrays to the file under a key; they are on disk on return."""
        if self.path is None:
            return
        lists = {name: np.asarray(value, dtype=float).tolist() for name, value in arrays.items()}
        append_text(self.path, json.dumps({"stamp": self.stamp, "key": key, "arrays": lists}) + "\n")


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
        self._ledger = EvaluationLog(ledger, f"{identity(model, seed)} {law}")
        self._bases = {(0,) * len(space.items): space.with_setting_deviations(model)}
        self._ordered_model = lru_cache(maxsize=MODELS)(self._build_model)
        self._blocks: dict[tuple[Design, int], tuple[np.ndarray, np.ndarray]] = {}
        self._slopes: dict[Design, tuple[np.ndarray, np.ndarray]] = {}

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
            self._bases[design.places] = self.space.with_setting_deviations(relocated)
        return self.space.with_orders_of(self._bases[design.places][0], design)

    def evaluate(self, design: Design, deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics (n, k) of samples (n, p) under a design, and which failed or could not be built."""
        model, names = self.model(design)
        settings = np.tile(np.array(design.settings, dtype=float).reshape(1, len(names)), (len(deviations), 1))
        process = model.process(self.law, threads=self.threads)
        evaluation = process.attempt(np.column_stack([deviations, settings]))
        self.progress(len(deviations))
        unfit = evaluation.failed | ~evaluation.built
        return np.where(evaluation.failed[:, None], 0.0, evaluation.measurements), unfit

    def block(self, design: Design, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics and failures of a block of samples under a design: from memory, log or evaluation."""
        if (design, number) not in self._blocks:

            def evaluate() -> dict[str, np.ndarray]:
                deviations = self.draw_deviations(number * BLOCK, BLOCK)
                try:
                    y, unfit = self.evaluate(design, deviations)
                except SceneError:  # with this order a part is unconstrained
                    y = np.zeros((len(deviations), len(self.space.scene.measurements)))
                    unfit = np.ones(len(deviations), bool)
                return {"y": y, "unfit": unfit.astype(float)}

            arrays = self.load_or_evaluate(design, f"values {number}", evaluate)
            self._blocks[design, number] = arrays["y"].reshape(len(arrays["unfit"]), -1), arrays["unfit"].astype(bool)
        return self._blocks[design, number]

    def load_or_evaluate(
        self, design: Design, what: str, evaluate: Callable[[], dict[str, np.ndarray]]
    ) -> dict[str, np.ndarray]:
        """Arrays of a design from the log, or evaluated and stored there."""
        key = f"{json.dumps([str(change) for change in self.space.changes(design)])} {what}"
        arrays = self._ledger.find(key)
        if arrays is None:
            arrays = evaluate()
            self._ledger.store(key, arrays)
        return arrays

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
        blocks = -(-count // BLOCK)
        missing = sum((design, number) not in self._blocks for number in range(blocks)) * BLOCK
        self._spend(min(missing, self.samples))
        return self.values(design, 0, count)

    def values_with_derivatives(self, design: Design) -> tuple[np.ndarray, np.ndarray]:
        """Samples (n, k) under a design that have derivatives, and these derivatives (n, k, a).

        Raises
        ------
        BudgetExceeded
        """
        if design not in self._slopes:
            deviations = self.draw_deviations(0, self.samples)
            self._spend(len(deviations) * (DERIVATIVE_COST + SETTING_COST * len(self.space.settings)))
            pieces = [self._derivative_block(design, deviations, first) for first in range(0, len(deviations), BLOCK)]
            y, slopes = (np.concatenate(arrays) for arrays in zip(*pieces))
            known = np.isfinite(y).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
            self._slopes[design] = y[known], slopes[known]
        return self._slopes[design]

    def _derivative_block(self, design: Design, deviations: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
        block = deviations[first : first + BLOCK]

        def evaluate() -> dict[str, np.ndarray]:
            model, names = self.model(design)
            x = np.column_stack([block, np.tile(np.array(design.settings), (len(block), 1))])
            result = model.sensitivities(x, self.law, names)
            self.progress(len(block))
            valid = ~result.failed[:, None]
            return {
                "y": np.where(valid, result.measurements, np.nan),
                "slopes": np.where(valid[..., None], result.jacobian, np.nan),
            }

        arrays = self.load_or_evaluate(design, f"slopes {first}", evaluate)
        k, a = len(self.space.scene.measurements), len(self.space.settings)
        return arrays["y"].reshape(len(block), k), arrays["slopes"].reshape(len(block), k, a)

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
        return self.objective.merit(y, unfit, np.array(design.settings))

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
            a, b = (
                self.objective.merit(y[selected], unfit[selected], np.array(candidate.settings))
                for candidate, y, unfit in sides
            )
            return a - b

        without = np.array([difference(groups != g) for g in np.unique(groups)])
        if not np.isfinite(without).all():
            return False
        error = np.sqrt((len(without) - 1) * np.mean((without - without.mean()) ** 2))
        return bool(difference(groups >= 0) > error)

    def _spend(self, count: float) -> None:
        if self.spent + count > self.budget:
            raise BudgetExceeded
        self.spent += count
