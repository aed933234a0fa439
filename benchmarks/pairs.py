"""Cost of elimination and of a batch of contact problems as functions of the numbers of pairs and parts.

    python benchmarks/pairs.py                       # up to 3000 pairs, a few minutes
    python benchmarks/pairs.py --cases 12,5000       # parts, pairs; 40,20000 needs more than 16 GB

All input is synthetic and seeded: a stack of P sheets, m pairs distributed over the interfaces, eight locators a sheet
and a weld an interface. Smooth kernels replace H, and every sample presses the sheets together and bends them. A
process for each case, one BLAS thread, processor time.

*set-up* is the elimination of the bilateral rows, *dense S* the same from dense matrices, and *apart* the largest
difference between the columns on demand and dense S, relative to its largest entry. *from nothing* solves a sample on
all pairs; *watched* solves it on a working set that starts with the pairs that closed in eight other samples; *forces*
is their largest difference, relative to the largest force. *increment* is the time of one sample in one increment from
open contacts, after another sample has formed most columns of S; *touch* are the pairs that close in it. The last line
has the exponents of growth with the pairs, of all cases of the table.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from measurement import alone, exponents, timed
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_matrix, vstack
from scipy.spatial.distance import cdist

from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.contact import ContactSolver, laws
from mic.contact.friction import Friction
from mic.contact.path import Increments
from mic.contact.working_set import WorkingSetSolver
from mic.system.matrix_product import one_thread

CASES = ["2,102", "2,300", "2,1002", "20,1000", "5,3000"]
AHEAD, SAMPLES = 8, 40
FEW = 10  # samples solved on all pairs if there are many pairs
DENSE = 1500  # pairs up to which dense S is formed and solved
MU, LONG, WIDE = 0.27, 900.0, 25.0  # mm, of a sheet
LOCATORS = np.array([[20, 0], [880, 0], [450, 25], [300, 12], [20, 0], [880, 25], [20, 25], [600, 0]], float)
AXES = np.array([0, 0, 0, 0, 1, 1, 2, 2])  # n, t1 or t2, which each locator holds
WELD = np.array([[450.0, 12.0]])
COLUMNS = ("parts", "pairs", "set-up, s", "dense S, s", "apart", "from nothing, ms", "watched, ms", "forces")
COLUMNS += ("increment, s", "touch", "peak, MB")


@dataclass(frozen=True)
class Stack:
    """A stack of sheets: compliance, rows, positions of the pairs, and loads of the samples."""

    compliance: Blocks
    held: csr_matrix
    pairs: csr_matrix
    point: np.ndarray
    b: np.ndarray

    @classmethod
    def of(cls, parts: int, pairs: int, seed: int = 0) -> Stack:
        """Parse "parts,pairs"."""
        rng = np.random.default_rng(seed)
        share = np.diff(np.linspace(0, pairs, parts).astype(int))
        interfaces = [rng.uniform(size=(count, 2)) * (LONG, WIDE) for count in share]
        H, G, first = [], [], [0]
        start: dict[tuple[int, int], int] = {}  # first functional of each (part, interface)
        for p in range(parts):
            places, axes = [LOCATORS], [AXES]
            count = first[-1] + len(LOCATORS)
            for i in (p - 1, p):
                if 0 <= i < parts - 1:
                    start[p, i] = count
                    points = np.vstack([interfaces[i], WELD])
                    places.append(np.repeat(points, 3, axis=0))
                    axes.append(np.tile(np.arange(3), len(points)))
                    count += 3 * len(points)
            first.append(count)
            H.append(kernel(np.vstack(places), np.concatenate(axes)))
            G.append(motions(np.vstack(places), np.concatenate(axes)))
        F = first[-1]
        locators = np.concatenate([first[p] + np.arange(len(LOCATORS)) for p in range(parts)])
        lower = [start[i, i] + np.arange(3 * share[i]) for i in range(parts - 1)]
        upper = [start[i + 1, i] + np.arange(3 * share[i]) for i in range(parts - 1)]
        other = [start[i + 1, i] + 3 * share[i] + np.arange(3) for i in range(parts - 1)]
        weld = [start[i, i] + 3 * share[i] + np.arange(3) for i in range(parts - 1)]
        held = vstack([rows(F, locators), joined(F, weld, other)], format="csr")
        point = np.vstack([np.column_stack([at, np.full(len(at), 1e4 * i)]) for i, at in enumerate(interfaces)])
        b = np.zeros((AHEAD + SAMPLES, pairs, 3))
        for sample in b:
            waves = [rng.normal() / k * np.sin(k * np.pi * point[:, 0] / LONG + rng.uniform(0, 6)) for k in range(1, 9)]
            sample[:, 0] = 0.05 * sum(waves) + 0.02 * (point[:, 1] / WIDE) * rng.normal() - 0.25
            sample[:, 1], sample[:, 2] = 0.05 * np.cos(point[:, 0] / 200), 0.02
        return cls(Blocks(tuple(H), tuple(G)), held, joined(F, lower, upper), point, b.reshape(len(b), -1))


def kernel(place: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(F, F) compliance kernel of a sheet: bending with a range of 150 mm and local compliance, uncoupled axes."""
    apart = cdist(place, place)
    bends = 2e-3 * np.exp(-((apart / 150) ** 2)) + 1e-5 * np.exp(-apart / 10)
    slides = 2e-4 * np.exp(-apart / 40)
    alike = axis[:, None] == axis
    return np.where(alike, np.where(axis == 0, bends, slides), 0.0) + 1e-5 * np.eye(len(axis))


def motions(place: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(F, 6) values of functionals along one axis each for the rigid motions of a flat sheet."""
    direction = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])[axis]
    point = np.column_stack([place, np.zeros(len(place))]) - [LONG / 2, WIDE / 2, 0]
    return np.hstack([direction, np.cross(point, direction)])


def rows(size: int, functional: np.ndarray) -> csr_matrix:
    """Rows of single functionals."""
    count = len(functional)
    return csr_matrix((np.ones(count), (np.arange(count), functional)), (count, size))


def joined(size: int, first, second) -> csr_matrix:
    """Rows of the second functional minus the first."""
    return rows(size, np.concatenate(second)) - rows(size, np.concatenate(first))


@one_thread
def measure(parts: int, pairs: int) -> tuple[list[str], dict[str, float]]:
    """The row of one case, and the costs that grow."""
    stack = Stack.of(parts, pairs)
    none = csr_matrix((0, stack.compliance.size))
    response, set_up = timed(lambda: eliminate(stack.compliance, stack.held, stack.pairs, none, none))
    S, b, law = response.S, stack.b[AHEAD:], laws.find("coulomb")

    def watched(start, **settings):
        reach, all_ = np.full(pairs, 12.0), np.ones(pairs, dtype=bool)
        given = S, Friction.of(MU, pairs), stack.point, reach, start, all_, law
        return WorkingSetSolver(*given, semidefinite=True, **settings)

    ahead = watched(np.zeros(pairs, dtype=bool), screening=True)
    ahead.solve(stack.b[:AHEAD])
    solver = watched(ahead.carried)
    solver.solve(stack.b[:2])
    found, each = timed(lambda: solver.solve(b))
    if pairs > DENSE:
        shown = ["", "", ""]
        forces = ""
    else:
        whole, forming = timed(lambda: dense(stack))
        apart = np.abs(S.take(np.arange(len(S))) - whole).max() / np.abs(whole).max()
        every = ContactSolver(whole, MU, semidefinite=True)
        every.solve(b[:1])
        count = SAMPLES if pairs <= 300 else FEW
        reference, slow = timed(lambda: every.solve(b[:count]))
        forces = f"{np.abs(reference.force - found.force[:count]).max() / np.abs(reference.force).max():.0e}"
        shown = [f"{forming:.2f}", f"{apart:.0e}", f"{1e3 * slow / count:.2f}"]
    ends = np.stack([np.tile([1.0, 0.0, 0.0], pairs) + 0 * b[:2], b[:2]], axis=1)  # open, then as in the samples
    none, anchor = np.zeros((1, 3 * pairs)), np.zeros((1, pairs, 2))
    solver.follow(ends[:1], none, anchor, Increments(1))
    found, increment = timed(lambda: solver.follow(ends[1:], none, anchor, Increments(1)))
    touch = int((found.force[:, ::3] > 0).sum())
    row = [str(parts), str(pairs), f"{set_up:.2f}", *shown, f"{1e3 * each / SAMPLES:.2f}", forces]
    costs = {"set-up": set_up, "watched": each, "increment": increment, "touch": touch}
    return [*row, f"{increment:.2f}", str(touch) if found.converged.all() else "failed"], costs


def dense(stack: Stack) -> np.ndarray:
    """(c, c) S from dense matrices, bilateral rows and rigid motions eliminated in one step."""
    H, G = stack.compliance.dense()
    B, C = stack.held.toarray(), stack.pairs.toarray()
    held, rigid = B @ H @ B.T, B @ G
    system = np.block([[held, rigid], [rigid.T, np.zeros((G.shape[1],) * 2)]])
    left = np.hstack([C @ H @ B.T, C @ G])
    S = C @ H @ C.T - left @ np.linalg.solve(system, left.T)
    return 0.5 * (S + S.T)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", default=CASES, help="parts,pairs")
    table, pairs, costs = Table(*COLUMNS), [], []
    for case in parser.parse_args().cases:
        size = [int(number) for number in case.split(",")]
        (row, cost), peak = alone(measure, *size)
        print(*row, f"{peak:.0f}", sep="\t", flush=True)
        table.add_row(*row, f"{peak:.0f}")
        pairs.append(size[1])
        costs.append(cost | {"memory": peak})
    Console(width=180).print(table)
    if len(set(pairs)) > 1:
        print("exponents:", exponents(pairs, {name: [one[name] for one in costs] for name in costs[0]}))


if __name__ == "__main__":
    main()
