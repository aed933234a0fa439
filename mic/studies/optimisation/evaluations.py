"""Assemblies under designs: the same samples for all, each taken through the process once, and kept."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.run_identity import identity
from mic.statistics.draw import draw
from mic.studies.optimisation.design import Design, Space
from mic.studies.optimisation.moved_items import Sites
from mic.studies.optimisation.objective import Objective
from mic.system.files import append_text

__all__ = ["Ledger", "Spent", "Trials"]

BLOCK = 20  # samples that are kept, and told, together
MODELS = 6  # processes that are held ready
DERIVED, EACH = 2.0, 0.05  # evaluations that a sample with its derivatives takes, and more for each setting


class Spent(Exception):
    """The budget is spent."""


class Ledger:
    """Evaluated samples, a line each block, so that a run that was killed is done again without them.

    Parameters
    ----------
    path : Path or None
        File of JSON lines; None keeps nothing.
    stamp : str
        Of what was evaluated; lines with another are passed over, and stay.
    """

    def __init__(self, path: Path | None, stamp: str):
        self.path, self.stamp = path, stamp
        self._known: dict[str, dict[str, Any]] = {}
        if path is not None and path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    record = json.loads(line)
                    if record["stamp"] == stamp:
                        self._known[record["key"]] = record["arrays"]
                except (ValueError, KeyError, TypeError):  # cut off when it was written
                    continue
            if not path.read_bytes().endswith(b"\n"):
                append_text(path, "\n")

    def find(self, key: str) -> dict[str, np.ndarray] | None:
        """Arrays under a key; None where it is not known."""
        found = self._known.get(key)
        if found is None:
            return None
        return {name: np.array(value, dtype=float) for name, value in found.items()}

    def keep(self, key: str, arrays: dict[str, np.ndarray]) -> None:
        """Write arrays under a key; they are on disk when this ends."""
        if self.path is None:
            return
        told = {name: np.asarray(value, dtype=float).tolist() for name, value in arrays.items()}
        append_text(self.path, json.dumps({"stamp": self.stamp, "key": key, "arrays": told}) + "\n")


class Trials:
    """Samples under designs, as far as a budget goes.

    Parameters
    ----------
    model : ReducedModel
    space : Space
    law : str
    samples, seed : int
        Those that designs are found with; further ones are fresh.
    budget : int
        Evaluations of an assembly; one with derivatives counts as several.
    threads : int
    sites : Sites or None
        Models with items at other places.
    ledger : Path, optional
        File that keeps what is evaluated.
    progress : callable
        Called with the number of evaluations.

    Attributes
    ----------
    spent : float
        Evaluations of the search so far, those that the ledger had among them.
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
        sites: Sites | None = None,
        ledger: Path | None = None,
        progress: Callable[[int], None] = lambda count: None,
    ):
        self.space, self.law, self.samples, self.seed, self.budget = space, law, samples, seed, budget
        self.objective = Objective(space)
        self.threads, self.progress, self.spent, self._sites = threads, progress, 0.0, sites
        # Paired intervals take samples that are independent.
        carlo = model.scene.monte_carlo.model_copy(update={"design": "independent"})
        self._drawing = model.scene.model_copy(update={"monte_carlo": carlo})
        self._ledger = Ledger(ledger, f"{identity(model, seed)} {law}")
        self._bases = {(0,) * len(space.items): space.opened(model)}
        self._models: OrderedDict[tuple[Any, ...], ReducedModel] = OrderedDict()
        self._blocks: dict[tuple[Design, int], tuple[np.ndarray, np.ndarray]] = {}
        self._slopes: dict[Design, tuple[np.ndarray, np.ndarray]] = {}

    # --------------------------------------------------------------------------------------------------- samples

    def drawn(self, first: int, count: int) -> np.ndarray:
        """(count, p) deviations of samples; of a table, as many as there are."""
        return draw(self._drawing, self.seed, first, count)

    def model(self, design: Design) -> tuple[ReducedModel, list[str]]:
        """The model of a design, with a deviation for each setting, and the names of these."""
        if design.places not in self._bases:
            assert self._sites is not None
            self._bases[design.places] = self.space.opened(self._sites.model(self.space.stood(design)))
        base, names = self._bases[design.places]
        if design.structure not in self._models:
            self._models[design.structure] = self.space.ordered(base, design)
            if len(self._models) > MODELS:
                self._models.popitem(last=False)
        self._models.move_to_end(design.structure)
        return self._models[design.structure], names

    def at(self, design: Design, deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics (n, k) of samples (n, p) under a design, and which failed or could not be built."""
        model, names = self.model(design)
        settings = np.tile(np.array(design.settings, dtype=float).reshape(1, len(names)), (len(deviations), 1))
        process = model.process(self.law, threads=self.threads)
        found = process.attempt(np.column_stack([deviations, settings]))
        self.progress(len(deviations))
        unfit = found.failed | ~found.built
        return np.where(found.failed[:, None], 0.0, found.measurements), unfit

    def block(self, design: Design, number: int) -> tuple[np.ndarray, np.ndarray]:
        """A block of samples under a design, from memory, ledger, or evaluated."""
        if (design, number) not in self._blocks:

            def evaluated() -> dict[str, np.ndarray]:
                drawn = self.drawn(number * BLOCK, BLOCK)
                try:
                    y, unfit = self.at(design, drawn)
                except SceneError:  # an order that leaves a part free, or contact that cannot hold it
                    y, unfit = np.zeros((len(drawn), len(self.space.scene.measurements))), np.ones(len(drawn), bool)
                return {"y": y, "unfit": unfit.astype(float)}

            kept = self.once(design, f"values {number}", evaluated)
            self._blocks[design, number] = kept["y"].reshape(len(kept["unfit"]), -1), kept["unfit"].astype(bool)
        return self._blocks[design, number]

    def once(self, design: Design, what: str, evaluated: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Arrays of a design from the ledger, or evaluated and kept there."""
        key = f"{json.dumps([str(one) for one in self.space.changes(design)])} {what}"
        kept = self._ledger.find(key)
        if kept is None:
            kept = evaluated()
            self._ledger.keep(key, kept)
        return kept

    def values(self, design: Design, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Samples under a design; they count to no budget."""
        blocks = range(first // BLOCK, -(-(first + count) // BLOCK))
        y, unfit = (np.concatenate(own) for own in zip(*(self.block(design, number) for number in blocks)))
        start = first - blocks[0] * BLOCK
        return y[start : start + count], unfit[start : start + count]

    # ---------------------------------------------------------------------------------------------------- search

    def tried(self, design: Design, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The first samples that designs are found with, under one; what is new counts to the budget.

        Raises
        ------
        Spent
        """
        count = self.samples if count is None else min(count, self.samples)
        whole = -(-count // BLOCK)
        new = sum((design, number) not in self._blocks for number in range(whole)) * BLOCK
        self._spend(min(new, self.samples))
        return self.values(design, 0, count)

    def derived(self, design: Design) -> tuple[np.ndarray, np.ndarray]:
        """Samples (n, k) under a design with their derivatives (n, k, a), those without them left out.

        Raises
        ------
        Spent
        """
        if design not in self._slopes:
            drawn = self.drawn(0, self.samples)
            self._spend(len(drawn) * (DERIVED + EACH * len(self.space.settings)))
            pieces = [self._derived(design, drawn, first) for first in range(0, len(drawn), BLOCK)]
            y, slopes = (np.concatenate(own) for own in zip(*pieces))
            known = np.isfinite(y).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
            self._slopes[design] = y[known], slopes[known]
        return self._slopes[design]

    def _derived(self, design: Design, drawn: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
        own = drawn[first : first + BLOCK]

        def evaluated() -> dict[str, np.ndarray]:
            model, names = self.model(design)
            whole = np.column_stack([own, np.tile(np.array(design.settings), (len(own), 1))])
            found = model.sensitivities(whole, self.law, names)
            self.progress(len(own))
            fine = ~found.failed[:, None]
            return {
                "y": np.where(fine, found.measurements, np.nan),
                "slopes": np.where(fine[..., None], found.jacobian, np.nan),
            }

        kept = self.once(design, f"slopes {first}", evaluated)
        k, a = len(self.space.scene.measurements), len(self.space.settings)
        return kept["y"].reshape(len(own), k), kept["slopes"].reshape(len(own), k, a)

    def merit(self, design: Design, count: int | None = None) -> float:
        """The merit of a design by the first samples; infinite where more of them fail than as the scene is.

        Raises
        ------
        Spent
        """
        y, unfit = self.tried(design, count)
        _, stated = self.values(self.space.stated, 0, len(unfit))
        if unfit.sum() > stated.sum() and self.objective.kind not in ("yield", "cost"):
            return np.inf
        return self.objective.merit(y, unfit, np.array(design.settings))

    def beats(self, design: Design, other: Design) -> bool:
        """Whether a design is better than another on the samples of the search.

        It is dropped after a part of them where it is worse by more than that part leaves uncertain: the standard
        error, by the jackknife over ten groups, of the difference of merits.

        Raises
        ------
        Spent
        """
        count = self.samples
        for part in sorted({-(-count // 4 // BLOCK) * BLOCK, -(-count // 2 // BLOCK) * BLOCK}):
            if 0 < part < count and self._behind(design, other, part):
                return False
        return self.merit(design) < self.merit(other)

    def _behind(self, design: Design, other: Design, part: int) -> bool:
        if not np.isfinite(self.merit(design, part)):
            return True
        sides = [(one, *self.tried(one, part)) for one in (design, other)]
        groups = np.arange(part) % min(10, part)

        def difference(kept: np.ndarray) -> float:
            a, b = (self.objective.merit(y[kept], unfit[kept], np.array(one.settings)) for one, y, unfit in sides)
            return a - b

        without = np.array([difference(groups != g) for g in np.unique(groups)])
        if not np.isfinite(without).all():
            return False
        error = np.sqrt((len(without) - 1) * np.mean((without - without.mean()) ** 2))
        return bool(difference(groups >= 0) > error)

    def _spend(self, count: float) -> None:
        if self.spent + count > self.budget:
            raise Spent
        self.spent += count
