"""Discrete search over orders and places.

If there are few designs, all are compared by successive halving [1]_: each time the number of samples doubles, the
worse half is dropped. Otherwise iterated local search [2]_ is used: a move shifts one group of an order, swaps two
groups or relocates an item; moves are tried in random order and the first improvement is accepted. At a local optimum a
few random moves perturb the best design and the search restarts there. An order of n groups has (n − 1)² insertions, so
that thirty groups take hundreds of evaluations, where exhaustive search would take 10³². SciPy has no search over
permutations.

References
----------
.. [1] K. Jamieson, A. Talwalkar: Non-stochastic best arm identification and hyperparameter optimization, AISTATS 2016,
       Proc. Mach. Learn. Res. 51, 240-248.
.. [2] H. R. Lourenço, O. C. Martin, T. Stützle: Iterated local search, Handbook of Metaheuristics, 2003, 320-353.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import permutations, product

import numpy as np

from mic.studies.optimisation.design import Design, Sequenced, Space
from mic.studies.optimisation.evaluations import BLOCK, BudgetExceeded, DesignEvaluator

__all__ = ["FEW", "all_designs", "local_search", "successive_halving"]

FEW = 5040  # largest number of designs that are enumerated
KICKS = 3  # random moves of a perturbation
MAX_FRUITLESS = 3  # consecutive perturbations without improvement at which the search ends


def all_designs(space: Space, limit: int = FEW) -> list[Design] | None:
    """Every combination of orders and places, the stated ones first; None if there are more than `limit`."""
    count = math.prod(math.factorial(len(groups)) for groups in space.groups) * math.prod(map(len, space.points))
    if count > limit:
        return None
    orders = product(*([None, *permutations(groups)] for groups in space.groups))
    places = list(product(*(range(len(points)) for points in space.points)))
    designs = [Design(space.stated.settings, order, numbers) for order in orders for numbers in places]
    return [design for design in designs if not _repeats_stated_order(space, design)]


def _repeats_stated_order(space: Space, design: Design) -> bool:
    """Whether a design repeats an order that the scene states."""
    return any(
        order is not None and [*map(set, order)] == stated for order, stated in zip(design.orders, space.stated_groups)
    )


def successive_halving(designs: list[Design], evaluator: DesignEvaluator, better: Callable[[Design], None]) -> Design:
    """The best of some designs, by successive halving.

    Parameters
    ----------
    designs : list of Design
        The first is the best so far.
    evaluator : DesignEvaluator
    better : callable
        Called with the best design if it is not the first.
    """
    first, remaining, count = designs[0], designs, BLOCK
    while len(remaining) > 1:
        merits = [evaluator.merit(design, count) for design in remaining]
        if count >= evaluator.samples:
            remaining = [remaining[int(np.argmin(merits))]]
            break
        ranked = [remaining[i] for i in np.argsort(merits, kind="stable")[: max(2, -(-len(remaining) // 2))]]
        remaining = [first, *(design for design in ranked if design != first)]
        count = min(2 * count, evaluator.samples)
    if remaining[0] != first:
        better(remaining[0])
    return remaining[0]


def local_search(
    start: Design, evaluator: DesignEvaluator, stream: np.random.Generator, better: Callable[[Design], None]
) -> Design:
    """The best design of an iterated local search, until the budget is spent or perturbations no longer help.

    Parameters
    ----------
    start : Design
    evaluator : DesignEvaluator
    stream : numpy.random.Generator
    better : callable
        Called with each design that is the best so far.
    """
    best, current, fruitless = start, start, 0
    try:
        while fruitless <= MAX_FRUITLESS:
            neighbours = _moves(current, evaluator.space, stream)
            improvement = next((design for design in neighbours if evaluator.is_better(design, current)), None)
            if improvement is not None:
                current = improvement
                if evaluator.is_better(current, best):
                    best, fruitless = current, 0
                    better(best)
                continue
            current, fruitless = best, fruitless + 1
            for _ in range(KICKS):
                current = next(_moves(current, evaluator.space, stream), current)
    except BudgetExceeded:
        pass
    return best


def _moves(design: Design, space: Space, stream: np.random.Generator) -> Iterator[Design]:
    """All designs that are one move from a design, in random order."""
    moves: list[tuple[str, int, int, int]] = []
    for s, groups in enumerate(space.groups):
        n = len(groups)
        moves += [("insert", s, i, j) for i in range(n) for j in range(n) if i != j and i != j + 1]
        moves += [("swap", s, i, j) for i in range(n) for j in range(i + 2, n)]
    for s, points in enumerate(space.points):
        moves += [("place", s, k, 0) for k in range(len(points)) if k != design.places[s]]
    for number in stream.permutation(len(moves)):
        kind, s, i, j = moves[number]
        if kind == "place":
            yield Design(design.settings, design.orders, (*design.places[:s], i, *design.places[s + 1 :]))
            continue
        order = list(design.orders[s] or space.groups[s])
        if kind == "insert":
            order.insert(j, order.pop(i))
        else:
            order[i], order[j] = order[j], order[i]
        orders: tuple[Sequenced, ...] = (*design.orders[:s], tuple(order), *design.orders[s + 1 :])
        yield Design(design.settings, orders, design.places)
