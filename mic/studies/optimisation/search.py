"""A search among orders and places.

Few choices are all looked at: those that do worst on a part of the samples are dropped, half of them each time that
the samples are doubled (successive halving [1]_). Of many, moves lead from the best that is known to one that beats it:
something closes sooner or later, two change places, or an item stands elsewhere; moves come in random order, and the
first that is better is taken. Where none is, the best is disturbed by a few moves and left from there anew [2]_. An
order of n things has (n − 1)² insertions, so that thirty take hundreds of evaluations where exhaustion would take 10³².

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
from mic.studies.optimisation.evaluations import Spent

__all__ = ["FEW", "Judge", "all_designs", "local_search", "random_design", "successive_halving"]

FEW = 5040  # designs: more are not looked at one by one
KICKS = 3  # random moves from the best, where no move helps
FRUITLESS = 3  # such disturbances in a row that bring nothing, and the search ends


class Judge(Protocol):
    """What tells designs apart: :class:`mic.studies.optimisation.evaluations.Trials`, as far as its budget goes."""

    def beats(self, design: Design, other: Design) -> bool:
        """Whether a design is better than another."""
        ...

    def merit(self, design: Design, count: int | None = None) -> float:
        """Merit of a design by the first samples; the smaller the better."""
        ...


def all_designs(space: Space, most: int = FEW) -> list[Design] | None:
    """Every combination of orders and places, the stated ones first; None where there are more than `most`."""
    count = math.prod(math.factorial(len(own)) for own in space.groups) * math.prod(map(len, space.points))
    if count > most:
        return None
    stated = space.stated
    orders = product(*([None, *permutations(own)] for own in space.groups))
    places = list(product(*(range(len(own)) for own in space.points)))
    found = [Design(stated.settings, tuple(order), at) for order in orders for at in places]
    return [one for one in found if not _stated_again(space, one)]


def _stated_again(space: Space, design: Design) -> bool:
    """Whether a design spells out an order that the scene states."""
    return any(
        order is not None and [*map(set, order)] == stated for order, stated in zip(design.orders, space.stated_groups)
    )


def successive_halving(
    designs: list[Design], judge: Judge, samples: int, block: int, better: Callable[[Design], None]
) -> Design:
    """The best of some designs.

    Parameters
    ----------
    designs : list of Design
        The first is the best that is known.
    judge : Judge
    samples, block : int
        Of a full judgement, and of the first.
    better : callable
        Called with the best, once it is known.
    """
    left, count = designs, block
    while len(left) > 1:
        merits = [judge.merit(one, count) for one in left]
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
    judge: Judge,
    stream: np.random.Generator,
    better: Callable[[Design], None],
) -> Design:
    """The best that moves lead to, until the judge's budget is spent or disturbances bring nothing more.

    Parameters
    ----------
    start : Design
    space : Space
    judge : Judge
    stream : numpy.random.Generator
    better : callable
        Called with each design that is the best so far.
    """
    best, at, fruitless = start, start, 0
    try:
        while fruitless <= FRUITLESS:
            move = next((one for one in _moves(at, space, stream) if judge.beats(one, at)), None)
            if move is not None:
                at = move
                if judge.beats(at, best):
                    best, fruitless = at, 0
                    better(best)
                continue
            at, fruitless = best, fruitless + 1
            for _ in range(KICKS):
                at = next(_moves(at, space, stream), at)
    except Spent:
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
