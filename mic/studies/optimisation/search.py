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
from typing import Protocol

import numpy as np

from mic.studies.optimisation.design import Design, Sequenced, Space
from mic.studies.optimisation.evaluations import BudgetExceeded

__all__ = ["FEW", "DesignComparison", "all_designs", "local_search", "random_design", "successive_halving"]

FEW = 5040  # largest number of designs that are enumerated
KICKS = 3  # random moves of a perturbation
MAX_FRUITLESS = 3  # consecutive perturbations without improvement at which the search ends


class DesignComparison(Protocol):
    """Compares designs, as :class:`mic.studies.optimisation.evaluations.DesignEvaluator` does within its budget."""

    def is_better(self, design: Design, other: Design) -> bool:
        """Whether a design is better than another."""
        ...

    def merit(self, design: Design, count: int | None = None) -> float:
        """Merit of a design on the first samples; smaller is better."""
        ...


def all_designs(space: Space, limit: int = FEW) -> list[Design] | None:
    """Every combination of orders and places, the stated ones first; None if there are more than `limit`."""
    count = math.prod(math.factorial(len(own)) for own in space.groups) * math.prod(map(len, space.points))
    if count > limit:
        return None
    stated = space.stated
    orders = product(*([None, *permutations(own)] for own in space.groups))
    places = list(product(*(range(len(own)) for own in space.points)))
    found = [Design(stated.settings, tuple(order), at) for order in orders for at in places]
    return [one for one in found if not _repeats_stated_order(space, one)]


def _repeats_stated_order(space: Space, design: Design) -> bool:
    """Whether a design repeats an order that the scene states."""
    return any(
        order is not None and [*map(set, order)] == stated for order, stated in zip(design.orders, space.stated_groups)
    )


def successive_halving(
    designs: list[Design], evaluator: DesignComparison, samples: int, block: int, better: Callable[[Design], None]
) -> Design:
    """The best of some designs, by successive halving.

    Parameters
    ----------
    designs : list of Design
        The first is the best so far.
    evaluator : DesignComparison
    samples, block : int
        Numbers of samples of the last comparison, and of the first.
    better : callable
        Called with the best design if it is not the first.
    """
    left, count = designs, block
    while len(left) > 1:
        merits = [evaluator.merit(one, count) for one in left]
        if count >= samples:
            best = left[int(np.argmin(merits))]
            break
        ranked = [left[i] for i in np.argsort(merits, kind="stable")[: max(2, -(-len(left) // 2))]]
        left, count = [left[0], *(one for one in ranked if one != left[0])], min(2 * count, samples)
    else:
        best = left[0]
    if best != designs[0]:
        better(best)
    return best


def local_search(
    start: Design,
    space: Space,
    evaluator: DesignComparison,
    stream: np.random.Generator,
    better: Callable[[Design], None],
) -> Design:
    """The best design of an iterated local search, until the budget is spent or perturbations no longer help.

    Parameters
    ----------
    start : Design
    space : Space
    evaluator : DesignComparison
    stream : numpy.random.Generator
    better : callable
        Called with each design that is the best so far.
    """
    best, at, fruitless = start, start, 0
    try:
        while fruitless <= MAX_FRUITLESS:
            move = next((one for one in _moves(at, space, stream) if evaluator.is_better(one, at)), None)
            if move is not None:
                at = move
                if evaluator.is_better(at, best):
                    best, fruitless = at, 0
                    better(best)
                continue
            at, fruitless = best, fruitless + 1
            for _ in range(KICKS):
                at = next(_moves(at, space, stream), at)
    except BudgetExceeded:
        pass
    return best


def random_design(space: Space, stream: np.random.Generator) -> Design:
    """A design at random: settings uniform within their bounds, orders and places with equal chances."""
    settings = space.settable(stream.uniform(space.low, space.high))
    orders = tuple(tuple(own[i] for i in stream.permutation(len(own))) for own in space.groups)
    return Design(settings, orders, tuple(int(stream.integers(len(own))) for own in space.points))


def _moves(at: Design, space: Space, stream: np.random.Generator) -> Iterator[Design]:
    """All designs that one move makes of one, in random order."""
    moves: list[tuple[str, int, int, int]] = []
    for s, own in enumerate(space.groups):
        moves += [("insert", s, i, j) for i in range(len(own)) for j in range(len(own)) if i != j and i != j + 1]
        moves += [("swap", s, i, j) for i in range(len(own)) for j in range(i + 2, len(own))]
    moves += [("place", s, k, 0) for s, own in enumerate(space.points) for k in range(len(own)) if k != at.places[s]]
    for number in stream.permutation(len(moves)):
        kind, s, i, j = moves[number]
        if kind == "place":
            yield Design(at.settings, at.orders, (*at.places[:s], i, *at.places[s + 1 :]))
            continue
        order = list(at.orders[s] or space.groups[s])
        if kind == "insert":
            order.insert(j, order.pop(i))
        else:
            order[i], order[j] = order[j], order[i]
        orders: tuple[Sequenced, ...] = (*at.orders[:s], tuple(order), *at.orders[s + 1 :])
        yield Design(at.settings, orders, at.places)
