"""Contact problems of the Siconos test collection, with their contacts in several orders: residual and time.

    python benchmarks/collection.py siconos-4.4.0/numerics/src/FrictionContact/test/data --orders 2

The folder belongs to the source package of Debian's siconos (``apt-get source siconos``). The problems are stacks of
boxes, heaps of capsules, spheres and rocks, towers of planks and a rover on its wheels: rigid bodies, most with more
contacts than freedoms. Problems of other kinds (two dimensions, rolling friction, bodies not eliminated) are skipped
and named. Time is processor time on one thread, including the preparation of S.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from measurement import timed
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from mic.contact import ContactSolver
from verification.contact_problems import ContactProblem

SOLVED = 1e-8
COLUMNS = ("problem", "contacts", "rank", "residual", "rung", "s")


class Numbers:
    """Read the words of a text file in order as numbers."""

    def __init__(self, text: str):
        self._words, self._next = text.split(), 0

    def reals(self, count: int) -> np.ndarray:
        words = self._words[self._next : self._next + count]
        if len(words) < count:
            raise ValueError("the file ends too soon")
        self._next += count
        return np.array(words, dtype=float)

    @property
    def left(self) -> int:
        return len(self._words) - self._next

    def integer(self) -> int:
        return int(self.integers(1)[0])

    def integers(self, count: int) -> np.ndarray:
        return self.reals(count).astype(int)


def read(path: Path) -> ContactProblem:
    """One problem of Siconos' format: ``W`` dense or by blocks, ``q`` and the coefficients of friction.

    Raises
    ------
    ValueError
        If it is a problem of another kind.
    """
    numbers = Numbers(path.read_text(encoding="utf-8"))
    dimension, contacts, storage = numbers.integer(), numbers.integer(), numbers.integer()
    if dimension != 3 or storage not in (0, 1):
        raise ValueError(f"dimension {dimension}, storage {storage}")
    rows, columns = numbers.integers(2)
    if rows != columns or rows != 3 * contacts:
        raise ValueError(f"{contacts} contacts, {rows} rows, {columns} columns")
    S = _dense(numbers) if storage == 0 else _by_blocks(numbers, rows)
    problem = ContactProblem(S, numbers.reals(rows)[None], numbers.reals(contacts))
    if numbers.left > 1:  # older files end with the number of an option
        raise ValueError("there is more than a problem of contacts in it")
    return problem


def _dense(numbers: Numbers) -> np.ndarray:
    rows, columns = numbers.integers(2)
    return numbers.reals(rows * columns).reshape(columns, rows).T


def _by_blocks(numbers: Numbers, size: int) -> np.ndarray:
    """Blocks row by row, each with its number before its entries, column by column; sizes are stored as end offsets."""
    count, high, wide = numbers.integers(3)
    ends = [np.append(0, numbers.integers(n)) for n in (high, wide)]
    first, second = numbers.integers(2)
    starts, places = numbers.integers(first), numbers.integers(second)
    S = np.zeros((size, size))
    for row in range(high):
        for block in range(starts[row], starts[row + 1]) if row + 1 < first else ():
            own = [slice(*end[k : k + 2]) for end, k in zip(ends, (row, places[block]))]
            shape = S[tuple(own)].shape
            if numbers.integer() != block:
                raise ValueError(f"another block stands where block {block} should")
            S[tuple(own)] = numbers.reals(shape[0] * shape[1]).reshape(shape[::-1]).T
    if starts[-1] != count:
        raise ValueError(f"{starts[-1]} of {count} blocks")
    return S


def ordered(problem: ContactProblem, order: np.ndarray) -> ContactProblem:
    """The same contacts in another order."""
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    return ContactProblem(problem.S[np.ix_(rows, rows)], problem.b[:, rows], problem.mu[order])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--orders", type=int, default=1, help="random orders of the contacts, besides the original")
    parser.add_argument("--only", default="", help="files whose names hold this")
    options = parser.parse_args()
    console, solved, tried = Console(width=120), 0, 0
    table = Table(*COLUMNS, title="Siconos' collection, Coulomb's law")
    with threadpool_limits(1):
        for path in sorted(options.folder.glob("*.dat")):
            if options.only not in path.name:
                continue
            try:
                problem = read(path)
            except ValueError as other:
                console.print(f"[yellow]{path.name} passed over: {other}", soft_wrap=True)
                continue
            m, rank = len(problem.mu), np.linalg.matrix_rank(problem.S, hermitian=True)
            for seed in range(options.orders + 1):
                order = np.random.default_rng(seed).permutation(m) if seed else np.arange(m)
                one = ordered(problem, order)
                tried += 1
                try:
                    found, seconds = timed(lambda one=one: ContactSolver(one.S, one.mu, work=1e5).solve(one.b[0]))
                except ValueError as refused:
                    console.print(f"{path.name}: {refused}", soft_wrap=True)
                    break
                solved += bool(found.residual <= SOLVED)
                name, residual = "" if seed else path.name, f"{found.residual:.1e}"
                table.add_row(name, str(m), str(rank), residual, str(found.rung), f"{seconds:.2f}")
                if found.residual > SOLVED:
                    console.print(f"{path.name}, order {seed}: {found.status.value}, {found.residual:.1e}")
    console.print(table)
    console.print(f"{solved} of {tried} to {SOLVED:g}")


if __name__ == "__main__":
    main()
