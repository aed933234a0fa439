"""Optimise the settings, orders and places of an assembly, and estimate the gain on fresh samples.

The discrete search over orders and places (:mod:`mic.studies.optimisation.search`) and the gradient search over
settings (:mod:`mic.studies.optimisation.gradient_search`) alternate as long as either improves the design. All designs
are compared on the same samples of the inputs. Selecting the best of many designs biases its objective on these
samples, so the best design and the stated scene are evaluated again on samples that were not used in the search; the
gain has the confidence interval of paired differences (:mod:`mic.statistics.paired_differences`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count as counted
from pathlib import Path

import numpy as np
import pandas as pd

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.schema import COMPARISON
from mic.scene import Scene
from mic.statistics.estimates import Estimate
from mic.statistics.paired_differences import jackknife, share_change
from mic.studies.comparison import Side, differences
from mic.studies.optimisation.design import Change, Design, Space
from mic.studies.optimisation.evaluations import BLOCK, BudgetExceeded, DesignEvaluator
from mic.studies.optimisation.gradient_search import descend
from mic.studies.optimisation.matching import Kind, Matched, combinations, match_parts, read_kinds
from mic.studies.optimisation.moved_items import RelocatedModels
from mic.studies.optimisation.objective import ConstraintCheck, Objective
from mic.studies.optimisation.search import all_designs, local_search, successive_halving
from mic.studies.samples import Progress, first_frictional
from mic.system.arguments import checked
from mic.system.disk_cache import cache_folder

__all__ = ["BUDGET", "FRESH", "SAMPLES", "Optimum", "evaluate_design", "optimise"]

SAMPLES = 60  #: samples of the search
FRESH = 400  #: fresh samples, on which the best design is evaluated
BUDGET = 20_000  #: evaluations of an assembly
DISCRETE_SHARE = 0.5  # share of the remaining budget for one discrete search if there are settings as well
MAX_SEARCHES = 3  # searches, each with tightened constraints if the fresh samples violate one
CONSTRAINT_TOLERANCE = 1e-2  # relative violation of a constraint that sampling error may cause
LEAST_BUDGET = 40  # evaluations: with fewer left, the discrete search is skipped

OnBetter = Callable[[list[Change], float], None]


@dataclass(frozen=True)
class Optimum:
    """Best design found, and its effect on fresh samples.

    Attributes
    ----------
    law : str
    objective : str
        Objective, as the scene names it.
    changes : list of Change
        Changes of the scene; empty if no better design was found.
    scene : Scene
        The scene with these changes.
    gain : Estimate
        Improvement of the objective on fresh samples, with its paired confidence interval; positive is better. The unit
        is 1 for Cpk and yield, mm for 6σ, and the scene's own unit for cost.
    before, after : float
        Objective on the fresh samples, without and with the changes.
    table : DataFrame
        Change of each key characteristic, as :data:`mic.results.schema.COMPARISON` declares it.
    kept : list of ConstraintCheck
        The constraints on the fresh samples.
    relief : Estimate
        Reduction of the sum of the relative constraint violations (:class:`ConstraintCheck`).
    found : float
        Objective on the samples of the search, which is biased towards better values.
    samples, fresh : int
        Numbers of samples of the search and of fresh samples.
    evaluations : int
        Evaluations of an assembly in the search.
    trail : DataFrame
        ``evaluations`` and ``objective``, on the samples of the search, of each design that was the best so far.
    matched : Matched or None
        Combinations of measured parts.
    matched_gain : Estimate or None
        Reduction of their average cost on fresh samples of the unmeasured deviations; without an interval if all
        deviations are measured.
    """

    law: str
    objective: str
    changes: list[Change]
    scene: Scene
    gain: Estimate
    before: float
    after: float
    table: pd.DataFrame
    kept: list[ConstraintCheck]
    relief: Estimate
    found: float
    samples: int
    fresh: int
    evaluations: int
    trail: pd.DataFrame
    matched: Matched | None
    matched_gain: Estimate | None

    @property
    def gained(self) -> bool:
        """Whether the interval of the gain, or of the reduction of constraint violations, lies above zero."""
        if not self.changes or float(self.relief.high) < 0:
            return False
        return float(self.relief.low) > 0 or float(self.gain.low) > 0

    @property
    def missed(self) -> list[ConstraintCheck]:
        """Violated constraints."""
        return [check for check in self.kept if check.short > 0]


@checked
def optimise(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    fresh: int = FRESH,
    budget: int = BUDGET,
    seed: int | None = None,
    threads: int = 1,
    ledger: Path | None = None,
    cache: Path | None = None,
    say: Callable[[str], None] = lambda line: None,
    progress: Progress = lambda count: None,
    better: OnBetter = lambda changes, objective: None,
) -> Optimum:
    """Find the best changes among those that the scene's table ``[optimise]`` allows.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the scene's first with friction, or its first.
    samples : int
        Samples of the inputs for the search, rounded up to a multiple of 20.
    fresh : int
        Further samples, on which the best design is evaluated.
    budget : int
        Evaluations of an assembly in the search. An evaluation with derivatives counts as 2 + 0.05 per setting.
    seed : int, optional
        Seed of the samples and of the search; default: the scene's.
    threads : int
    ledger : Path, optional
        File that stores every evaluated sample, so that an interrupted call resumes.
    cache : Path, optional
        Folder of meshes and influence coefficients, for items at other places; default :func:`mic.cache_folder`.
    say : callable, optional
        Called with one line of text before each part is solved for other places.
    progress : callable or bool, optional
        Called with the number of assemblies that were evaluated; or whether a bar is shown.
    better : callable, optional
        Called with the changes and the objective, on the samples of the search, of each design that is the best so far.

    Raises
    ------
    SceneError
        If the scene allows no changes or no deviation varies; if a candidate place lies off its part; if measured parts
        do not belong to this scene.
    """
    scene = model.scene
    _check_scene(scene)
    space, kinds = Space(model), read_kinds(scene)
    samples, fresh = _sample_counts(scene, samples, fresh)
    relocated = RelocatedModels(space, cache or cache_folder(), say) if space.items else None
    law = law or first_frictional(scene.report.laws)
    seed = scene.monte_carlo.seed if seed is None else seed
    evaluator = DesignEvaluator(model, space, law, samples, seed, budget, threads, relocated, ledger, progress)
    _check_budget(kinds, budget)
    best, first, history = _search_with_tightening(evaluator, fresh, better)
    return evaluate_design(evaluator, best, first, fresh, history, kinds)


def _check_scene(scene: Scene) -> None:
    if scene.optimise is None:
        raise SceneError(
            f"scene {scene.name!r} allows no changes; add a table [optimise] with forces, shims, orders, places or "
            "matching"
        )
    if scene.monte_carlo.values is None and not any(deviation.sigma for deviation in scene.deviations):
        raise SceneError(
            f"scene {scene.name!r}: nothing varies, so there is no variation to optimise; give deviations a sigma"
        )
    one_step = {stage.name for stage in scene.stages if stage.path == "one-step"}
    for i, choice in enumerate(scene.optimise.orders):
        if choice.stage in one_step:
            raise SceneError(
                f"optimise.orders[{i}].stage: {choice.stage!r} has no order, since it closes everything at once (path "
                "= 'one-step'); give the stage another path"
            )


def _sample_counts(scene, samples: int, fresh: int) -> tuple[int, int]:
    """Numbers of samples for the search and of fresh ones; a table of samples is split, half for the search."""
    table = scene.monte_carlo.values
    samples = -(-samples // BLOCK) * BLOCK
    if table is None:
        return samples, fresh
    samples = min(samples, len(table) // 2)
    if samples < 2:
        raise SceneError(
            f"scene {scene.name!r}: its table has {len(table)} samples, too few to find and evaluate changes; give at "
            "least four"
        )
    return samples, min(fresh, len(table) - samples)


def _check_budget(kinds: Sequence[Kind], budget: int) -> None:
    count = combinations(kinds) if kinds else 0
    if count > budget:
        raise SceneError(
            f"optimise.matching: {count} combinations of {' and '.join(kind.name for kind in kinds)} exceed the budget "
            f"of {budget} evaluations; increase --budget, or match fewer parts"
        )


# ------------------------------------------------------------------------------------------------------------ search


def _search_with_tightening(
    evaluator: DesignEvaluator, fresh: int, better: OnBetter
) -> tuple[Design, int, list[tuple[int, float]]]:
    """Search, and search again with tightened constraints while the fresh samples violate them.

    Returns
    -------
    Design
    int
        First fresh sample for the final evaluation.
    list of (int, float)
        Evaluations and objective of each design that was the best so far.
    """
    space, objective = evaluator.space, evaluator.objective
    first, best, history = evaluator.samples, space.stated, list[tuple[int, float]]()
    stream = np.random.default_rng(evaluator.seed)
    for _ in range(MAX_SEARCHES):
        best = _search(evaluator, best, stream, history, better)
        if best == space.stated or not space.request.constraints:
            break
        checks = objective.check_constraints(*evaluator.values(best, first, fresh), best.settings, tightened=False)
        violated = [check for check in checks if check.share > CONSTRAINT_TOLERANCE]
        if not violated or objective.violation(*evaluator.values(best, 0, evaluator.samples), best.settings):
            break
        for check in violated:
            objective.tightening[check.name] = objective.tightening.get(check.name, 0.0) + check.short
        if space.scene.monte_carlo.values is None:
            first += fresh
    return best, first, history


def _search(
    evaluator: DesignEvaluator, best: Design, stream, history: list[tuple[int, float]], better: OnBetter
) -> Design:
    """The best design found from a given one, by discrete and gradient searches in turn."""
    space = evaluator.space

    def record(design: Design) -> None:
        value = evaluator.objective.reported_value(*evaluator.search_values(design), design.settings)
        history.append((int(evaluator.spent), value))
        better(space.changes(design), value)

    if not (space.settings or space.discrete):
        return best
    try:
        record(best)
        for round_number in counted():
            before = best
            if space.discrete:
                best = _search_discrete(evaluator, best, stream, record, exhaustive=round_number == 0)
            best = descend(best, evaluator, record)
            if best == before or not (space.discrete and space.settings):
                break
    except BudgetExceeded:
        if not history:
            raise SceneError(
                f"optimise: {evaluator.samples} samples of the stated scene exceed the budget of "
                f"{evaluator.budget:g} evaluations; increase --budget, or reduce --samples"
            ) from None
    return best


def _search_discrete(evaluator: DesignEvaluator, best: Design, stream, record, exhaustive: bool) -> Design:
    """The best orders and places at the settings of `best`: all compared if the budget allows, else local search."""
    designs = all_designs(evaluator.space) if exhaustive else None
    budget, remaining = evaluator.budget, evaluator.budget - evaluator.spent
    allowance = remaining * (DISCRETE_SHARE if evaluator.space.settings else 1.0)
    if remaining < LEAST_BUDGET:
        return best
    if designs is not None and _halving_cost(len(designs), evaluator.samples) <= allowance:
        candidates = [best, *(replace(design, settings=best.settings) for design in designs if design != best)]
        return successive_halving(candidates, evaluator, record)
    evaluator.budget = evaluator.spent + allowance
    try:
        return local_search(best, evaluator, stream, record)
    finally:
        evaluator.budget = budget


def _halving_cost(count: int, samples: int) -> float:
    """Upper estimate of the evaluations that successive halving of `count` designs needs."""
    return count * BLOCK * (1 + np.ceil(np.log2(max(samples / BLOCK, 1))) / 2) + 2 * samples


# -------------------------------------------------------------------------------------------------------- evaluation


def evaluate_design(
    evaluator: DesignEvaluator,
    best: Design,
    first: int,
    fresh: int,
    history: Sequence[tuple[int, float]] = (),
    kinds: Sequence[Kind] = (),
) -> Optimum:
    """Evaluate a design and the stated scene on fresh samples.

    Parameters
    ----------
    evaluator : DesignEvaluator
    best : Design
    first, fresh : int
        Number of the first fresh sample, and how many there are.
    history : sequence of (int, float)
        Rows of :attr:`Optimum.trail`.
    kinds : sequence of Kind
        Measured parts to be matched under this design.
    """
    space, objective, settings = evaluator.space, evaluator.objective, best.settings
    objective.tightening = {}
    searched = bool(space.settings) or space.discrete

    def values(design: Design, start: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        if searched:
            return evaluator.values(design, start, count)
        return np.zeros((0, len(objective.names))), np.zeros(0, dtype=bool)

    a, unfit_a = values(space.stated, first, fresh)
    b, unfit_b = values(best, first, fresh)
    before, after = (
        Side(
            name, space.scene, evaluator.law, pd.DataFrame(np.where(unfit[:, None], np.nan, y), columns=objective.names)
        )
        for name, y, unfit in (("as it is", a, unfit_a), ("optimised", b, unfit_b))
    )
    pairs = np.concatenate([a, b], axis=1)[~(unfit_a | unfit_b)]
    combination, combination_gain = match_parts(evaluator, best, kinds, fresh) if kinds else (None, None)
    return Optimum(
        law=evaluator.law,
        objective=objective.kind,
        changes=space.changes(best),
        scene=space.with_design(best),
        gain=_share_gain(objective, a, b, unfit_a, unfit_b, settings) or _decrease(objective.value, pairs, settings),
        before=objective.reported_value(a, unfit_a, space.stated.settings),
        after=objective.reported_value(b, unfit_b, settings),
        table=differences(before, after)[0] if searched else COMPARISON.empty(),
        kept=objective.check_constraints(b, unfit_b, settings) if len(b) > 1 else [],
        relief=_decrease(objective.violation, pairs, settings),
        found=objective.reported_value(*values(best, 0, evaluator.samples), settings),
        samples=evaluator.samples,
        fresh=len(a),
        evaluations=int(np.ceil(evaluator.spent)),
        trail=pd.DataFrame([*history], columns=["evaluations", "objective"]),
        matched=combination,
        matched_gain=combination_gain,
    )


def _share_gain(objective: Objective, a, b, unfit_a, unfit_b, settings: Sequence[float]) -> Estimate | None:
    """Improvement of an objective that is a share, or its cost, with its confidence interval; None for others."""
    if objective.kind not in ("yield", "cost"):
        return None
    change = share_change(objective.outside(a) | unfit_a, objective.outside(b) | unfit_b)
    reject = objective.request.reject if objective.kind == "cost" else 1.0
    cost = float(objective.space.costs @ np.abs(settings)) if objective.kind == "cost" else 0.0
    return Estimate.of(a[:, 0], *(-reject * end - cost for end in (change.value, change.high, change.low)))


def _decrease(statistic: Callable[..., float], pairs: np.ndarray, settings: Sequence[float]) -> Estimate:
    """Decrease of a statistic from stated samples (n, k) to those with settings, side by side, with its interval."""
    stated, k = np.zeros(len(settings)), pairs.shape[1] // 2

    def decrease(y: np.ndarray) -> float:
        fit = np.zeros(len(y), dtype=bool)
        return statistic(y[:, :k], fit, stated) - statistic(y[:, k:], fit, settings)

    return jackknife(pairs, decrease)
