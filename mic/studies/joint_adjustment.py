r"""One joint set of adjustments for an individual assembly.

The objective (:mod:`mic.studies.adjustment_goals`) is minimised on a cheap model: the assembly with all items of each
stage closing at once, c(x), corrected by evaluations f of the assembly itself at changes x₀ [1]_,

.. math::

    m(x) = c(x) + f(x_0) - c(x_0).

m is minimised by successive linear or least-squares programs with exact derivatives of c and a line search,
within a trust region that shrinks if the evaluation at the minimum is no improvement: c has the kinks of contact, so
that a step across them is seen before it is evaluated.

The common optimum, from which assemblies start, is that of the mean assembly, found from several starts. With the
objectives ``rms`` and ``cpk`` its key characteristics are the target of all assemblies; it leaves a tenth of each
range to individual assemblies.

Deviations that are known with a standard deviation s only are replaced by their mean given prior and measurement,
``μ + (x - μ) σ²/(σ² + s²)``, and the objective is averaged over points of the remaining uncertainty.

Contact makes the objective not convex. So if no changes found so far bring an assembly within its limits, single and
random changes and those of least distance from the target are further starts, each adjustment in turn is set to what is
best by the cheap model, and the largest excess of the evaluated changes decides.

Every proposal is evaluated in full, with changes that can be set, and compared with no change.

References
----------
.. [1] D. Echeverría, P. W. Hemker: Space mapping and defect correction, Comput. Methods Appl. Math. 5 (2005) 107-136.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.process.sensitivity import sensitivities
from mic.studies.adjustable import Adjustable
from mic.studies.adjustment import Adjustment, with_adjustments
from mic.studies.adjustment_goals import Goal, LeastExcess, NearTarget, WithinLimits
from mic.studies.samples import limits
from mic.system.console import micrometres

__all__ = ["JointAdjustment", "ProposedAdjustment"]

RESERVE = 0.1  # share of each range that the common optimum leaves to individual assemblies
STARTS = 5  # starts of the common optimum
FIRST_STEPS, NEXT_STEPS = 5, 2  # programs that minimise the cheap model, before and after the first evaluation
MAX_ROUNDS = 4  # evaluations of an assembly, each after a minimisation of the cheap model
COMMON_ROUNDS = 12  # the same for the mean assembly
SHARES = (1.0, 0.4, 0.1)  # of a step, in the line search
SMALL = 0.1  # decrease of the objective, relative to its value, after which the next step waits for an evaluation
MAX_REMOVALS = 3  # adjustments whose removal is tried at a time
FEW_ORDERS = 3  # orders that are tried on an assembly
UNFIT = 1e9  # added to the objective of an assembly that cannot be built
REACHES = (1.0, 0.5, 0.25, 0.1, 0.04)  # shares of a range that are tried
LIMIT_SHARE = 0.8  # of the largest forces of clamps, in the cheap model
UNKNOWN = 1e3  # mm: key characteristics of an assembly that cannot be computed, beyond all limits
WORTH = 1e-3  # mm: a smaller excess over the limits does not count as an effect
CORNERS = 32  # random changes to ends of the ranges that are tried where no changes reach the limits
SETTINGS = (-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0)  # shares of a range to which one adjustment is set in turn
SWEEPS = 6  # largest number of adjustments that are set in turn
MINIMA = 3  # starts from which they are
DIRECTIONS = 2  # directions of the uncertainty over which the objective is averaged
LEAST_ROOM = 0.1  # of half the tolerance: least distance of the target from a limit, for the objective ``cpk``


@dataclass(frozen=True)
class ProposedAdjustment:
    """A joint set of adjustments of one assembly.

    Attributes
    ----------
    changes : dict of Adjustment to float
        mm or N; empty if none is worth it.
    order : str
        Changed orders; empty for those of the scene.
    before, after : (k,) array
        Evaluated key characteristics without and with the changes, mm.
    merit_before, merit : float
        Objective without and with the changes; less is better.
    excess : float
        Largest excess of an interval over its limits with the changes, mm; negative within.
    residual : float
        Largest residual of the contact solutions with the changes (:class:`mic.process.evaluation.Resolution`).
    evaluations : int
        Evaluations of the assembly.
    objective : str
    cost : float
        Cost of sufficient changes, also if they are not worth it; with the objective ``cost`` in the unit of the scene.
    reject : float
        Cost of an assembly outside its limits, with this objective.
    """

    changes: dict[Adjustment, float]
    order: str
    before: np.ndarray
    after: np.ndarray
    merit_before: float
    merit: float
    excess: float
    residual: float
    evaluations: int
    objective: str
    cost: float
    reject: float

    def __str__(self) -> str:
        limited, costs = self.objective in ("yield", "cost"), self.objective == "cost"
        if not self.changes and not self.order:
            if costs and self.cost > self.reject:
                return f"no adjustment is worth its cost: {self.cost:g}, and a reject costs {self.reject:g}"
            if costs:
                return "no adjustment brings it within all limits"
            return "no adjustment helps" if limited else "no adjustment is worth it"
        changes = [f"{item.name} by {change:+.4g} {item.unit}" for item, change in self.changes.items()]
        changes += [self.order] if self.order else []
        distance = micrometres(abs(self.excess))
        reached = f"within all limits by {distance}" if self.excess <= 0 else f"still {distance} beyond a limit"
        if not limited:
            reached = f"{self.merit / self.merit_before:.2g} times the distance from the target, {reached}"
        return f"{', '.join(changes)}: {reached}" + f"; cost {self.cost:g}" * costs


class _CheapModel:
    """The cheap model of an assembly at points (s, p) of its deviations, corrected by `offset` (k,), mm."""

    def __init__(self, process: Process, names: Sequence[str], points: np.ndarray, offset: np.ndarray):
        self._process, self._names, self.points, self._offset = process, list(names), points, offset

    def values(self, changes: np.ndarray) -> tuple[np.ndarray, bool]:
        """(s, k) key characteristics at the points with changes (a,), and whether any failed or cannot be built."""
        y, unfit = self.of_each(changes[None])
        return y[0], bool(unfit[0])

    def at(self, points: np.ndarray) -> _CheapModel:
        """The model at other points."""
        return _CheapModel(self._process, self._names, points, self._offset)

    def of_each(self, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, s, k) and (n,): :meth:`values` of each of some changes (n, a)."""
        y, unfit = evaluate(self._process, self.points, changes)
        return y + self._offset, unfit.any(axis=1)

    def slopes(self, changes: np.ndarray) -> np.ndarray:
        """(s, k, a) derivatives at changes (a,)."""
        x = np.column_stack([self.points, np.tile(changes, (len(self.points), 1))])
        return np.nan_to_num(sensitivities(self._process, x, self._names).jacobian)

    def correct(self, changes: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Correct the model so that its first point has key characteristics (k,) at changes (a,); the correction."""
        self._offset = y - evaluate(self._process, self.points[:1], changes[None])[0][0, 0]
        return self._offset


def _cheap_model(model: ReducedModel) -> ReducedModel:
    """The model in one step for each stage, where that is possible, with less force in its clamps: near their limits it
    does not tell for certain whether an assembly can be built."""
    clamps = [
        item if item.limit is None else item.model_copy(update={"limit": LIMIT_SHARE * item.limit})
        for item in model.scene.clamps
    ]
    reduced = replace(model, scene=model.scene.model_copy(update={"clamps": clamps}))
    return reduced.one_step or reduced


def evaluate(process: Process, points: np.ndarray, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, s, k) key characteristics of assemblies (s, p) with changes (n, a), and (n, s) whether they failed or could
    not be built."""
    n, s = len(changes), len(points)
    x = np.concatenate([np.tile(points, (n, 1)), np.repeat(changes, s, axis=0)], axis=1)
    evaluation = process.attempt(x)
    y = np.where(evaluation.failed[:, None], UNKNOWN, evaluation.measurements)
    return y.reshape(n, s, -1), (evaluation.failed | ~evaluation.built).reshape(n, s)


class JointAdjustment:
    """Finds joint sets of adjustments of assemblies.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    request : Adjustable
    progress : callable, optional
        Called with the number of evaluations since the last call.

    Attributes
    ----------
    allowed : AllowedAdjustments
    common : (a,) array
        Changes of the common optimum.
    goal : NearTarget
        Objective of assemblies with ``rms`` and ``cpk``, else of the common optimum.
    """

    def __init__(
        self, model: ReducedModel, law: str, request: Adjustable, progress: Callable[[int], object] = lambda count: None
    ):
        self.allowed = request.of(model)
        scene, settings = model.scene, self.allowed.settings
        self._progress = progress
        models = [with_adjustments(ordered, settings) for ordered in self.allowed.orders]
        self._names = models[0][1]
        self._exact = [ordered.process(law) for ordered, _ in models]
        self._cheap = _cheap_model(models[0][0]).process(law)
        self._low, self._high = (np.array([getattr(item, end) for item in settings]) for end in ("low", "high"))
        self._size = np.array([item.size for item in settings])
        self._limited = any(item.limit is not None for item in scene.clamps)
        self._mean = np.array([item.mean for item in scene.deviations])
        self._sigma = np.array([item.sigma for item in scene.deviations])
        self._lower, self._upper = limits(scene)
        ends = np.array([(item.lower, item.upper) for item in scene.measurements])
        one_sided = np.isinf(self._lower)
        self._middle = np.where(one_sided, ends[:, 0], ends.mean(axis=1))
        self._half = np.where(one_sided, 1.0, 0.5) * (ends[:, 1] - ends[:, 0])
        self._find_common()

    # ------------------------------------------------------------------------------------------------ preparation

    @property
    def always(self) -> bool:
        """Whether assemblies within their limits are adjusted too."""
        return self.allowed.objective in ("rms", "cpk")

    def _find_common(self) -> None:
        """Find the common optimum, the target, the correction of the cheap model there, and the best orders."""
        still, weight = np.zeros(len(self._size)), self.allowed.weight / self._half
        self.goal = NearTarget(self._middle, weight, still, self._size)
        share = 1 - RESERVE if self.always else 1.0
        cheap = _CheapModel(self._cheap, self._names, self._mean[None], np.zeros(len(self._middle)))
        process = self._exact[0]
        bounds = self._buildable(still, share * self._low, share * self._high)
        search = _Search(self.goal, self.allowed.settings, bounds, self.allowed.most, process)
        cheap.correct(still, search.evaluate(self._mean, still))
        stream = np.random.default_rng(0)
        starts = [still, *(stream.uniform(*bounds) for _ in range(STARTS - 1))]
        self.common, target = search.run(cheap, starts, COMMON_ROUNDS)
        self._low, self._high = self._buildable(self.common, self._low, self._high)
        self._progress(search.evaluations)
        self._offset = cheap.correct(self.common, target)
        if self.allowed.objective == "cpk":
            room = self._half - np.abs(target - self._middle)
            weight = self.allowed.weight / np.maximum(room, LEAST_ROOM * self._half)
        if self.always:
            self.goal = NearTarget(target, weight, self.common, self._size)
        self._orders = [0]
        if len(self._exact) > 1:
            found = [evaluate(process, self._mean[None], self.common[None]) for process in self._exact]
            y, unfit = (np.concatenate(parts) for parts in zip(*found))
            self._progress(len(y))
            merit = self.goal.merit(y, np.tile(self.common, (len(y), 1))) + UNFIT * unfit[:, 0]
            others = 1 + np.argsort(merit[1:], kind="stable")
            self._orders += others[: FEW_ORDERS - 1].tolist()

    def _buildable(self, about: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (a,) within which the mean assembly can be built if one adjustment moves alone."""
        ends = []
        for end in (low, high):
            reach, open_ends = np.ones(len(about)), np.full(len(about), self._limited)
            for share in (*REACHES, 0.0):
                numbers = np.flatnonzero(open_ends)
                if not numbers.size:
                    break
                reach[numbers] = share
                if share:
                    trials = np.tile(about, (numbers.size, 1))
                    trials[np.arange(numbers.size), numbers] += share * (end - about)[numbers]
                    open_ends[numbers] = evaluate(self._cheap, self._mean[None], trials)[1][:, 0]
            ends.append(np.where(reach < 1, about + reach * (end - about), end))
        return np.minimum(ends[0], 0.0), np.maximum(ends[1], 0.0)

    # -------------------------------------------------------------------------------------------------- proposals

    def propose(self, x: np.ndarray, interval: np.ndarray, noise: np.ndarray | None = None) -> ProposedAdjustment:
        """The best joint adjustment of an assembly.

        Parameters
        ----------
        x : (p,) array
            Its deviations.
        interval : (k,) array
            Half widths of the intervals of its key characteristics, mm.
        noise : (p,) array, optional
            Standard deviations of `x` as measured; infinite where it is not known. Default: 0.
        """
        points = self._points(x, np.zeros(len(x)) if noise is None else noise)
        bounded = WithinLimits(self._lower, self._upper, self._half, self.allowed.cost, interval)
        goal: Goal = self.goal if self.always else bounded
        still = np.zeros(len(self._size))
        search = _Search(goal, self.allowed.settings, (self._low, self._high), self.allowed.most, self._exact[0])
        before = search.evaluate(points[0], still)
        merit_before, order = search.merit, 0
        cheap = _CheapModel(self._cheap, self._names, points, self._offset)
        starts = [self.common]
        if isinstance(goal, WithinLimits):
            cheap.correct(still, before)
            starts = [still, self.common, *self._ends(cheap, goal)]
        changes, after = search.run(cheap, starts, MAX_ROUNDS)
        for other in self._orders[1:]:
            search.process, best = self._exact[other], search.merit
            trial = search.evaluate(points[0], changes)
            if search.merit < best:
                order, after = other, trial
        if order:
            search.process = self._exact[order]
            cheap.correct(changes, after)
            changes, after = search.run(cheap, [changes], MAX_ROUNDS // 2)
        if not self.always and bounded.excess(after[None]).max() > 0:
            search, changes, after = self._least_excess(bounded, cheap, search, (before, changes, after))
        sufficient = bounded.excess(after[None]).max() <= 0
        cost = float(np.abs(changes) @ self.allowed.cost) * self.allowed.reject if sufficient or self.always else 0.0
        if (changes.any() or order) and not self._helps(goal, bounded, points, (before, changes, after), order):
            changes, after, order = still, before, 0
        self._progress(search.evaluations)
        return ProposedAdjustment(
            {item: float(change) for item, change in zip(self.allowed.settings, changes) if change},
            self.allowed.changed_orders[order],
            before,
            after,
            merit_before,
            float(goal.merit(after[None, None], changes[None])[0]),
            float(bounded.excess(after[None]).max()),
            search.residual(),
            search.evaluations,
            self.allowed.objective,
            cost,
            self.allowed.reject,
        )

    def _least_excess(self, bounded: WithinLimits, cheap: _CheapModel, search: _Search, found):
        """A search for the least largest excess of an assembly, its best changes, and their key characteristics."""
        before, *other = found
        cheap = cheap.at(cheap.points[:1])  # the intervals contain the uncertainty
        goal = LeastExcess(*(getattr(bounded, item.name) for item in fields(bounded)))
        last = _Search(goal, self.allowed.settings, (self._low, self._high), self.allowed.most, search.process)
        near = _Search(self.goal, self.allowed.settings, (self._low, self._high), self.allowed.most, search.process)
        still, point = np.zeros(len(self._size)), cheap.points[0]
        for changes, y in ((still, before), other):
            cheap.correct(changes, y)
            for one in (last, near):
                one.evaluate(point, changes)
        nearest, y = near.run(cheap, [self.common, still], MAX_ROUNDS)
        corners = np.random.default_rng(0).choice([0.0, -1.0, 1.0], (CORNERS, len(still)))
        shares = np.concatenate([share * np.eye(len(still)) for share in SETTINGS] + [corners])
        trials = np.where(shares < 0, -shares * self._low, shares * self._high)
        last.sweep(cheap, np.concatenate([trials, [nearest, other[0], self.common]]))
        last.evaluations += search.evaluations + near.evaluations
        return last, *last.best

    def _helps(self, goal: Goal, bounded: WithinLimits, points, found, order: int) -> bool:
        """Whether an adjusted assembly is better than without any change, also averaged over its uncertainty."""
        before, changes, after = found
        still, nominal = np.zeros_like(changes), isinstance(goal, NearTarget)
        if nominal:  # the distance from the middle of the limits counts too
            middle = replace(self.goal, target=self._middle)
            if middle.merit(after[None, None], changes) > middle.merit(before[None, None], still):
                return False
        elif self.allowed.objective == "cost":
            excess = bounded.excess(after[None]).max()
            if excess > 0 or np.abs(changes) @ self.allowed.cost > 1:
                return False
        elif bounded.excess(after[None]).max() > 0:
            if bounded.excess(before[None]).max() - bounded.excess(after[None]).max() < WORTH:
                return False
        if len(points) == 1:
            return True
        values = [
            evaluate(process, points[1:], one[None])[0]
            for process, one in ((self._exact[0], still), (self._exact[order], changes))
        ]
        if nominal:
            return bool(middle.merit(values[1], changes[None]) <= middle.merit(values[0], still[None]))
        exceeded = [(replace(bounded, interval=0 * bounded.interval).excess(y[0][:, None]) > 0).sum() for y in values]
        return bool(exceeded[1] <= exceeded[0])

    def _ends(self, cheap: _CheapModel, goal: WithinLimits) -> list[np.ndarray]:
        """The two best changes of one adjustment to an end of its range, by the cheap model."""
        ends = np.concatenate([np.diag(self._low), np.diag(self._high)])
        merit = [
            float(goal.merit(y[None], end[None])[0]) + UNFIT * unfit for end in ends for y, unfit in [cheap.values(end)]
        ]
        return list(ends[np.argsort(merit, kind="stable")[:2]])

    def _points(self, x: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """(s, p) the expected deviations, then points of their uncertainty, if there is any."""
        prior = np.where(self._sigma > 0, self._sigma**2, np.inf)  # a shape as scanned has no distribution
        unknown = np.isinf(noise)
        variance = np.where(unknown, 0.0, noise**2)
        with np.errstate(invalid="ignore"):
            known = np.where(unknown, 0.0, np.where(np.isinf(prior), 1.0, prior / (prior + variance)))
        spread = np.sqrt(np.where(unknown, self._sigma**2, known * variance))
        expected = self._mean + known * (x - self._mean)
        uncertain = np.flatnonzero(spread > 0)
        if not uncertain.size:
            return expected[None]
        one = np.zeros((uncertain.size, len(x)))
        one[np.arange(uncertain.size), uncertain] = spread[uncertain]
        effect = evaluate(self._cheap, expected + np.concatenate([one, -one]), self.common[None])[0][0]
        effect = (effect[: uncertain.size] - effect[uncertain.size :]) / self._half
        directions = np.linalg.svd(effect.T, full_matrices=False)[2][:DIRECTIONS]
        moved = np.sqrt(len(directions)) * directions @ one
        return np.concatenate([expected[None], expected + moved, expected - moved])


class _Search:
    """Minimises a goal over changes that can be set, with evaluations of an assembly.

    Attributes
    ----------
    evaluations : int
    merit : float
        Merit of the best changes.
    best : tuple of (a,) and (k,) array
        The best changes, and their key characteristics.
    """

    def __init__(self, goal: Goal, settings: Sequence[Adjustment], bounds, most: int, process: Process):
        self._goal, self._most, self.process = goal, most, process
        self._step = np.array([item.step for item in settings])
        self._size = np.array([item.size for item in settings])
        self._low, self._high = (self._whole_steps(end, np.trunc) for end in bounds)
        self.evaluations, self.merit = 0, np.inf

    def evaluate(self, point: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """(k,) key characteristics of an assembly (p,) with changes (a,); the best are remembered."""
        evaluation = self.process.attempt(np.concatenate([point, changes])[None])
        y = np.where(evaluation.failed[0], UNKNOWN, evaluation.measurements[0])
        self.evaluations += 1
        merit = self._merit(y, not evaluation.built[0], changes)
        if merit < self.merit:
            self.merit, self.best, self._evaluation = merit, (changes, y), evaluation
        return y

    def _merit(self, y: np.ndarray, unfit: bool, changes: np.ndarray) -> float:
        """Objective of characteristics (k,) or (s, k) with changes (a,); worse than any other if it cannot be built."""
        return float(self._goal.merit(np.atleast_2d(y)[None], changes[None])[0]) + UNFIT * unfit

    def run(self, cheap: _CheapModel, starts: Sequence[np.ndarray], rounds: int) -> tuple[np.ndarray, np.ndarray]:
        """The best changes (a,) and their key characteristics (k,), after at most so many evaluations."""
        found = [self._descend(cheap, start, np.inf, FIRST_STEPS) for start in starts]
        changes, trust, tried = min(found, key=lambda one: one[1])[0], np.inf, {self.best[0].tobytes()}
        for _ in range(rounds):
            if changes.tobytes() in tried:
                break
            tried.add(changes.tobytes())
            before, last = self.merit, self.best[0]
            y = self.evaluate(cheap.points[0], changes)
            cheap.correct(changes, y)
            if self.merit < before:
                if before - self.merit < self._goal.enough or self.merit < self._goal.good:
                    break
            else:
                trust = float(np.abs((changes - last) / self._size).max()) / 3
                cheap.correct(*self.best)
            changes = self._descend(cheap, self.best[0], trust, NEXT_STEPS)[0]
        return self.best

    def sweep(self, cheap: _CheapModel, starts: np.ndarray) -> None:
        """Evaluate the best of some changes (n, a), then what is reached if each adjustment in turn is set best."""
        starts = np.unique(self._whole_steps(np.clip(starts, self._low, self._high), np.round), axis=0)
        order = np.argsort(self._cheap_merits(cheap, starts), kind="stable")[:MINIMA]
        for start in [*starts[order], None]:
            changes = self.best[0] if start is None else start
            y = self.evaluate(cheap.points[0], changes)
            cheap.correct(changes, y)
            merit, own = np.inf, changes
            for _ in range(SWEEPS):
                trials = self._neighbours(own)
                merits = self._cheap_merits(cheap, trials)
                together = self._combined(own, trials, merits)
                merits = np.concatenate([merits, self._cheap_merits(cheap, together)])
                trials = np.concatenate([trials, together])
                if not merits.min() < merit:
                    break
                merit, own = float(merits.min()), trials[int(merits.argmin())]
            self.evaluate(cheap.points[0], own)

    def _neighbours(self, changes: np.ndarray) -> np.ndarray:
        """(n, a) changes that differ in one adjustment: at a share of its range, or by one step."""
        count = len(changes)
        settings = np.array([np.where(share < 0, -share * self._low, share * self._high) for share in SETTINGS])
        settings = np.concatenate([settings, changes + self._step[None], changes - self._step[None]])
        trials = np.tile(changes, (len(settings), count, 1))
        trials[:, np.arange(count), np.arange(count)] = settings
        trials = self._whole_steps(np.clip(trials.reshape(-1, count), self._low, self._high), np.round)
        return np.concatenate([changes[None], trials])

    def _combined(self, changes: np.ndarray, trials: np.ndarray, merits: np.ndarray) -> np.ndarray:
        """(a, a) changes with the best neighbouring setting of one adjustment, of the two best, and so on."""
        count, result = len(changes), []
        best = merits[1:].reshape(-1, count).argmin(axis=0)
        order = np.argsort(merits[1 + best * count + np.arange(count)], kind="stable")
        for i in order:
            changes = np.where(np.arange(count) == i, trials[1 + best[i] * count + i], changes)
            result.append(changes)
        return np.array(result)

    def _cheap_merits(self, cheap: _CheapModel, trials: np.ndarray) -> np.ndarray:
        """(n,) merits of changes (n, a) by the cheap model; infinite for more changes than are allowed."""
        y, unfit = cheap.of_each(trials)
        many = np.count_nonzero(trials, axis=1) > self._most
        return np.where(many, np.inf, self._goal.merit(y, trials) + UNFIT * unfit)

    def _descend(self, cheap: _CheapModel, start: np.ndarray, trust: float, steps: int) -> tuple[np.ndarray, float]:
        """Changes that can be set and minimise the cheap model from a start, and their merit."""
        goal, d = self._goal, np.clip(start, self._low, self._high)
        low, high = np.maximum(self._low, d - trust * self._size), np.minimum(self._high, d + trust * self._size)
        y, unfit = cheap.values(d)
        merit = self._merit(y, unfit, d)
        for _ in range(steps):
            slope = cheap.slopes(d)
            step = goal.step(y, slope, d, low, high) - d
            for share in SHARES:
                trial = d + share * step
                values, unfit = cheap.values(trial)
                reached = self._merit(values, unfit, trial)
                if reached < merit - goal.enough:
                    break
            else:
                break
            gain, merit, y, d = merit - reached, reached, values, trial
            if gain < SMALL * merit:
                break
        found = []
        near = (self._settable(y, slope, d, choice) for choice in (self._worthwhile(y, slope, d, low, high), d))
        # Beyond a kink the linear model leads astray: the changes themselves are the last choice.
        for changes in (*near, self._whole_steps(d, np.round)):
            found.append((changes, self._merit(*cheap.values(changes), changes)))
            if found[0][1] <= merit + goal.worth * (1 + np.count_nonzero(d)) or np.count_nonzero(d) > self._most:
                break
        return min(found, key=lambda one: one[1])

    def _worthwhile(self, y, slope, d, low, high) -> np.ndarray:
        """The changes, without those that are not worth it or too many."""
        goal, used = self._goal, np.abs(d) > self._step / 2
        linear = lambda at: float(goal.merit((y + slope @ (at - d))[None], at[None])[0])
        step = lambda free: goal.step(y, slope, d, np.where(free, low, 0.0), np.where(free, high, 0.0))
        chosen = d if used.all() else step(used)
        merit = linear(chosen)
        while used.any():
            losses = {i: linear(np.where(np.arange(len(d)) == i, 0.0, chosen)) for i in np.flatnonzero(used)}
            trials = []
            for i in sorted(losses, key=lambda i: losses[i])[:MAX_REMOVALS]:
                trial = step(used & (np.arange(len(d)) != i))
                trials.append((linear(trial), i, trial))
            least, i, trial = min(trials, key=lambda one: one[0])
            if least - merit > goal.worth and used.sum() <= self._most:
                break
            used[i] = False
            chosen, merit = trial, least
        return chosen

    def _settable(self, y, slope, at, d) -> np.ndarray:
        """Whole steps near changes d, improved step by step by the linear model about the changes `at`."""
        linear = lambda trials: self._goal.merit(y + np.einsum("ska,na->nsk", slope, trials - at), trials)
        away = lambda count: np.sign(count) * np.ceil(np.abs(count) - 1e-6)
        d = self._whole_steps(d, np.round if isinstance(self._goal, NearTarget) else away)
        d, merit, steps = np.clip(d, self._low, self._high), np.inf, np.diag(self._step)[d != 0]
        trials = d[None]
        for _ in range(4 * len(steps) + 1):
            merits = linear(trials)
            i = int(merits.argmin())
            if not merits[i] < merit - 1e-12 * abs(merits[i]):
                break
            d, merit = trials[i], float(merits[i])
            trials = np.clip(d + np.concatenate([steps, -steps]), self._low, self._high)
        return self._whole_steps(d, np.round)

    def _whole_steps(self, changes: np.ndarray, rounding) -> np.ndarray:
        """Changes (a,) rounded to whole steps."""
        return np.round(rounding(np.round(changes / self._step, 9)) * self._step, 12) + 0.0

    def residual(self) -> float:
        """Largest residual of the contact solutions with the best changes."""
        return max((float(one.residual[0]) for one in self._evaluation.resolutions.values()), default=0.0)
