"""An assembly made as good as what may be changed lets it become, and what that is worth, on fresh samples.

Orders and places are searched (:mod:`mic.studies.optimisation.search`) and settings follow exact derivatives
(:mod:`mic.studies.optimisation.gradient_search`), in turn, as long as either gains. All designs are compared on the same
samples of the inputs, so that what differs is the design's doing. The best of many is flattered by the samples that it
was chosen with: what is told of it is evaluated in full on samples that had no part in the search, the scene as it
stands beside it, and the interval of the gain is that of the pairs (:mod:`mic.statistics.paired_differences`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.schema import COMPARISON
from mic.scene import Scene
from mic.statistics.estimates import Estimate
from mic.statistics.paired_differences import jackknife, share_change
from mic.studies.comparison import Side, differences
from mic.studies.optimisation.design import Change, Design, Space
from mic.studies.optimisation.evaluations import BLOCK, Spent, Trials
from mic.studies.optimisation.gradient_search import descend
from mic.studies.optimisation.matching import Kind, Matched, combinations, matched, read_kinds
from mic.studies.optimisation.moved_items import Sites
from mic.studies.optimisation.objective import Kept, Objective
from mic.studies.optimisation.search import all_designs, local_search, successive_halving
from mic.system.disk_cache import cache_folder

__all__ = ["BUDGET", "FRESH", "SAMPLES", "Optimum", "judged", "optimise"]

SAMPLES = 60  #: with which designs are found
FRESH = 400  #: with which the best is judged
BUDGET = 20_000  #: evaluations of an assembly
SHARE = 0.5  # of what is left of the budget that a search may take before settings have their turn
JUDGED = 3  # sets of fresh samples, at most, where they miss a constraint that the search has kept
ENOUGH = 1e-2  # share of a constraint: by less it is kept, as far as samples tell
FIRST = 40  # evaluations at least, or there is no search

Better = Callable[[list[Change], float], None]


@dataclass(frozen=True)
class Optimum:
    """The best that was found, and what it is worth.

    Attributes
    ----------
    law : str
    objective : str
        As the scene names it.
    changes : list of Change
        What to change of the scene; empty where nothing better was found.
    scene : Scene
        The scene with these changes.
    gain : Estimate
        What of the objective they gain on fresh samples, with the interval that pairing leaves; positive is better: of
        Cpk and yield 1, of 6σ mm, of cost its own unit.
    before, after : float
        The objective of the fresh samples as the scene is, and with the changes.
    table : DataFrame
        What they change of every key characteristic, as :data:`mic.results.schema.COMPARISON` declares it.
    kept : list of Kept
        The constraints on the fresh samples.
    relief : Estimate
        By how much less the constraints are missed than they are as the scene is, together, as shares (:class:`Kept`).
    found : float
        The objective on the samples of the search, which flatter it.
    samples, fresh : int
        How many these were.
    evaluations : int
        Of an assembly, that the search took.
    trail : DataFrame
        ``evaluations`` and ``objective``, on the samples of the search, of each design that was the best so far.
    matched : Matched or None
        Which measured parts go together.
    matched_gain : Estimate or None
        By how much that makes their average cost smaller, on fresh samples of what was not measured; without an
        interval where all was.
    """

    law: str
    objective: str
    changes: list[Change]
    scene: Scene
    gain: Estimate
    before: float
    after: float
    table: pd.DataFrame
    kept: list[Kept]
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
        """Whether the whole interval of the gain lies above zero; or the constraints are missed by less, surely."""
        if not self.changes or float(self.relief.high) < 0:
            return False
        return float(self.relief.low) > 0 or float(self.gain.low) > 0

    @property
    def missed(self) -> list[Kept]:
        """Constraints that are not kept."""
        return [one for one in self.kept if one.short > 0]


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
    progress: Callable[[int], None] = lambda count: None,
    better: Better = lambda changes, objective: None,
) -> Optimum:
    """Find the changes that its scene allows (``[optimise]``) which make an assembly best.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the scene's first with friction, or its first.
    samples : int
        Of the inputs, with which designs are compared: a multiple of 20, or rounded up to one.
    fresh : int
        Others, with which the best is judged.
    budget : int
        Evaluations of an assembly in the search; one with derivatives counts twice and a twentieth more for each
        setting.
    seed : int, optional
        Of the samples and of the search; default: the scene's.
    threads : int
    ledger : Path, optional
        File that keeps every sample that is evaluated, so that a call that was killed goes on where it was.
    cache : Path, optional
        Folder of meshes and influence coefficients, for items at other places; default :func:`mic.cache_folder`.
    say : callable, optional
        Called with one line of text before a part is solved for these.
    progress : callable, optional
        Called with the number of assemblies that were evaluated.
    better : callable, optional
        Called with the changes and the objective, on the samples of the search, of each design that is the best so far.

    Raises
    ------
    SceneError
        Where the scene states nothing that may be changed, or nothing that varies; for a candidate off its part; for
        measured parts that are not of this scene.
    """
    scene = model.scene
    asked = scene.optimise
    if asked is None:
        raise SceneError(
            f"scene {scene.name!r} does not say what may be changed; add a table [optimise], with forces, shims, "
            "orders, places or matching"
        )
    varying = any(one.sigma for one in scene.deviations) or scene.monte_carlo.values is not None
    if not varying:
        raise SceneError(
            f"scene {scene.name!r}: nothing varies, and an optimum of the nominal assembly alone is none for those "
            "that are built; give deviations a sigma"
        )
    _in_order(scene)
    space, kinds = Space(model), read_kinds(scene)
    samples, fresh = _counted(scene, samples, fresh)
    sites = None
    if space.items:
        sites = Sites(space, cache or cache_folder(), say)
    law = law or next((name for name in scene.report.laws if LAWS[name].frictional), scene.report.laws[0])
    seed = scene.monte_carlo.seed if seed is None else seed
    trials = Trials(model, space, law, samples, seed, budget, threads, sites, ledger, progress)
    _reachable(kinds, budget)
    stream, first, best, trail = np.random.default_rng(seed), samples, space.stated, list[tuple[int, float]]()
    for _ in range(JUDGED):
        best = _searched(trials, best, stream, trail, better)
        if best == space.stated:
            break
        y, unfit = trials.values(best, 0, samples)
        missed = _missed(trials, best, first, fresh)
        if not missed or trials.objective.short(y, unfit, np.array(best.settings)):
            break
        trials.objective.more = {one.name: trials.objective.more.get(one.name, 0.0) + one.short for one in missed}
        if scene.monte_carlo.values is None:
            first += fresh
    return judged(trials, best, first, fresh, trail, kinds)


def _in_order(scene: Scene) -> None:
    assert scene.optimise is not None
    for i, one in enumerate(scene.optimise.orders):
        if any(stage.name == one.stage and stage.path == "one-step" for stage in scene.stages):
            raise SceneError(
                f'optimise.orders[{i}].stage: {one.stage!r} does all at once (path = "one-step"), in no order; give '
                "the stage another path"
            )


def _counted(scene, samples: int, fresh: int) -> tuple[int, int]:
    """Samples of the search and fresh ones; of a table of samples, half of its rows and the others."""
    given = scene.monte_carlo.values
    samples = -(-samples // BLOCK) * BLOCK
    if given is None:
        return samples, fresh
    samples = min(samples, len(given) // 2)
    if samples < 2:
        raise SceneError(
            f"scene {scene.name!r}: its table has {len(given)} samples, too few to find changes and to judge them; "
            "give four at least"
        )
    return samples, min(fresh, len(given) - samples)


def _reachable(kinds: Sequence[Kind], budget: int) -> None:
    count = combinations(kinds) if kinds else 0
    if count > budget:
        raise SceneError(
            f"optimise.matching: {count} combinations of {' and '.join(kind.name for kind in kinds)} exceed the budget "
            f"of {budget} evaluations; allow more, or match fewer parts"
        )


# ------------------------------------------------------------------------------------------------------------ search


def _missed(trials: Trials, best: Design, first: int, fresh: int) -> list[Kept]:
    """The constraints that fresh samples miss, as they are stated."""
    if not trials.space.asked.constraints:
        return []
    more, trials.objective.more = trials.objective.more, {}
    kept = trials.objective.kept(*trials.values(best, first, fresh), np.array(best.settings))
    trials.objective.more = more
    return [one for one in kept if one.share > ENOUGH]


def _searched(trials: Trials, best: Design, stream, rows: list[tuple[int, float]], better: Better) -> Design:
    """The best design from one on."""
    space = trials.space

    def tell(design: Design) -> None:
        y, unfit = trials.tried(design)
        value = _told(trials.objective, trials.objective.value(y, unfit, np.array(design.settings)))
        rows.append((int(trials.spent), value))
        better(space.changes(design), value)

    if not (space.settings or space.discrete):
        return best
    try:
        tell(best)
        turn, settled = 0, False
        while not settled:
            before = best
            if space.discrete:
                best = _ordered(trials, best, stream, tell, turn)
            best = descend(best, trials, tell)
            turn, settled = turn + 1, best == before or not (space.discrete and space.settings)
    except Spent:
        if not rows:
            raise SceneError(
                f"optimise: {trials.samples} samples of the scene as it is exceed the budget of {trials.budget:g} "
                "evaluations; allow more, or ask for fewer samples"
            ) from None
    return best


def _ordered(trials: Trials, best: Design, stream, tell, turn: int) -> Design:
    """The best orders and places with settings as they are."""
    designs = all_designs(trials.space) if turn == 0 else None
    whole, left = trials.budget, trials.budget - trials.spent
    share = left * (SHARE if trials.space.settings else 1.0)
    if left < FIRST:
        return best
    if designs is not None and _halving_costs(len(designs), trials.samples) <= share:
        own = [best, *(replace(one, settings=best.settings) for one in designs if one != best)]
        return successive_halving(own, trials, trials.samples, BLOCK, tell)
    trials.budget = trials.spent + share
    try:
        return local_search(best, trials.space, trials, stream, tell)
    finally:
        trials.budget = whole


def _halving_costs(count: int, samples: int) -> float:
    return count * BLOCK * (1 + np.ceil(np.log2(max(samples / BLOCK, 1))) / 2) + 2 * samples


def _told(objective: Objective, value: float) -> float:
    """The objective as people read it: Cpk and yield are to become large."""
    if objective.kind == "cpk":
        return -value
    return 1 - value if objective.kind == "yield" else value


# ---------------------------------------------------------------------------------------------------------- judgement


def judged(
    trials: Trials,
    best: Design,
    first: int,
    fresh: int,
    trail: Sequence[tuple[int, float]] = (),
    kinds: Sequence[Kind] = (),
) -> Optimum:
    """What a design is worth on fresh samples.

    Parameters
    ----------
    trials : Trials
    best : Design
    first, fresh : int
        The first of these samples, and how many they are.
    trail : sequence of (int, float)
        As :class:`Optimum` has it.
    kinds : sequence of Kind
        Measured parts, to be matched under this design.
    """
    trials.objective.more = {}
    space, objective = trials.space, trials.objective
    stated, settings = space.stated, np.array(best.settings)
    changed = best != stated
    searched = bool(space.settings) or space.discrete
    a, unfit_a = trials.values(stated, first, fresh) if searched else _none(space)
    b, unfit_b = trials.values(best, first, fresh) if changed else (a, unfit_a)
    y, unfit = trials.values(best, 0, trials.samples) if searched else _none(space)
    none = np.zeros(len(settings))
    values = [objective.value(a, unfit_a, none), objective.value(b, unfit_b, settings)]
    gain = _gain(objective, a, b, unfit_a, unfit_b, settings)
    relief = _relief(objective, a, b, ~(unfit_a | unfit_b), settings)
    before, after = (
        Side(name, space.scene, trials.law, _frame(space.scene, own, unfit))
        for name, own, unfit in (("as it is", a, unfit_a), ("optimised", b, unfit_b))
    )
    table = differences(before, after)[0] if searched else COMPARISON.empty()
    together, together_gain = matched(trials, best, kinds, fresh) if kinds else (None, None)
    return Optimum(
        trials.law,
        objective.kind,
        space.changes(best),
        space.changed(best),
        gain,
        _told(objective, values[0]),
        _told(objective, values[1]),
        table,
        objective.kept(b, unfit_b, settings) if len(b) > 1 else [],
        relief,
        _told(objective, objective.value(y, unfit, settings)),
        trials.samples,
        len(a),
        int(np.ceil(trials.spent)),
        pd.DataFrame([*trail], columns=["evaluations", "objective"]),
        together,
        together_gain,
    )


def _none(space: Space) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((0, len(space.scene.measurements))), np.zeros(0, dtype=bool)


def _frame(scene: Scene, y: np.ndarray, unfit: np.ndarray) -> pd.DataFrame:
    """Samples by measurement; NaN where they failed, or could not be built."""
    return pd.DataFrame(np.where(unfit[:, None], np.nan, y), columns=[one.name for one in scene.measurements])


def _gain(objective: Objective, a, b, unfit_a, unfit_b, settings: np.ndarray) -> Estimate:
    """What of the objective is gained, with its interval."""
    if objective.kind in ("yield", "cost"):
        miss = [objective.outside(y) | unfit for y, unfit in ((a, unfit_a), (b, unfit_b))]
        fewer = share_change(*miss)
        reject = objective.asked.reject if objective.kind == "cost" else 1.0
        cost = float(objective.space.costs @ np.abs(settings)) if objective.kind == "cost" else 0.0
        ends = (-reject * end - cost for end in (fewer.value, fewer.high, fewer.low))
        return Estimate.of(a[:, 0], *ends)
    kept = ~(unfit_a | unfit_b)
    k, none = a.shape[1], np.zeros(len(settings))
    value = lambda y: objective.value(y, np.zeros(len(y), dtype=bool), none)
    return jackknife(np.concatenate([a[kept], b[kept]], axis=1), lambda y: value(y[:, :k]) - value(y[:, k:]))


def _relief(objective: Objective, a, b, kept: np.ndarray, settings: np.ndarray) -> Estimate:
    """By how much less the constraints are missed."""
    if not objective.asked.constraints:
        return Estimate.of(np.zeros(len(a)), 0.0, 0.0, 0.0)
    k, none = a.shape[1], np.zeros(len(settings))
    short = lambda y, settings: objective.short(y, np.zeros(len(y), dtype=bool), settings)
    less = lambda y: short(y[:, :k], none) - short(y[:, k:], settings)
    return jackknife(np.concatenate([a[kept], b[kept]], axis=1), less)
