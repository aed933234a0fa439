"""Definition of a study, its acceptance limits and findings, and the processes that run it.

A study is a folder with a ``study.py`` that defines ``STUDY`` and a ``README.md`` that starts with the study's claim
and its reference (:meth:`Study.opening`). Limits are declared before the study is run, in ``STUDY`` alone; the
documentation's page of the study shows them after the reference (:meth:`Study.limits`).
"""

from __future__ import annotations

import importlib
import math
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from mic.execution.ranks import wait
from mic.process.model import ReducedModel
from mic.scene import Scene
from verification.comparison import reduced_and_assembly
from verification.cost import give_back
from verification.validation import Uncertainty

__all__ = ["Acceptance", "CheckedFinding", "Context", "Finding", "ItemFailed", "Study", "Team", "studies"]

FOLDER = Path(__file__).parent
PAUSE = 0.5  # s between two attempts of a rank to get memory
MUCH = 1.0  # GB: a larger process returns freed memory to the system before it starts an item


@dataclass(frozen=True)
class Acceptance:
    """Limit on a quantity that a study measures.

    Attributes
    ----------
    name : str
        Identifies the quantity within its study.
    claim : str
        The claim that holds if the limit is met, one sentence without the number.
    limit : float
    unit : str
        ``"1"`` for ratios.
    bound : {"at most", "at least"}
    quick : float or None
        Limit of the quick version if its coarser meshes need another.
    full_only : bool
        Whether the quick version leaves the quantity out, because no small case determines it.
    reason : str
        Reason for the limit: theory, accuracy of a peer program, a standard, or a user's requirement; never the
        measured value.
    """

    name: str
    claim: str
    limit: float
    unit: str = "1"
    bound: Literal["at most", "at least"] = "at most"
    quick: float | None = None
    reason: str = ""
    full_only: bool = False

    def at(self, quick: bool) -> float:
        """The limit of the full or the quick version."""
        return self.quick if quick and self.quick is not None else self.limit

    def words(self) -> str:
        """The limit as text."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        other = "" if self.quick is None else f" (quick: {self.quick:g}{unit})"
        other = " (not in the quick version)" if self.full_only else other
        return f"{self.bound} {self.limit:g}{unit}{other}"


@dataclass(frozen=True)
class Finding:
    """Measured value for one acceptance limit, with the evidence.

    Attributes
    ----------
    name : str
        Name of the acceptance limit.
    measured : float
        In the unit of the limit.
    note : str
        Text for the report; its numbers are computed, never typed.
    figure : matplotlib.figure.Figure or None
    table : pandas.DataFrame or None
        Column names carry the units.
    uncertainty : verification.validation.Uncertainty or None
        That of a comparison error; None for quantities that are none, or whose uncertainty is not estimated.
    """

    name: str
    measured: float
    note: str = ""
    figure: object | None = None
    table: object | None = None
    uncertainty: Uncertainty | None = None


@dataclass(frozen=True)
class CheckedFinding:
    """A finding compared with its acceptance limit."""

    finding: Finding
    acceptance: Acceptance
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the limit is met; False if the measured value is not finite."""
        measured = self.finding.measured
        if not math.isfinite(measured):
            return False
        return bool(measured <= self.limit if self.acceptance.bound == "at most" else measured >= self.limit)


class ItemFailed(RuntimeError):
    """An item of :meth:`Team.map` failed on one process; the message is the traceback from there."""


class Team:
    """Processes that work on a study together.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm or None
        None for a single process without MPI.
    """

    def __init__(self, comm=None):
        self.comm = comm
        self.rank, self.size = (comm.rank, comm.size) if comm is not None else (0, 1)

    def map(self, function: Callable, items) -> list:
        """``[function(item) for item in items]``, distributed over the ranks; the whole list on every rank.

        Every rank must call it with the same items, the most expensive first; an idle rank takes the next item. The
        results do not depend on the number of ranks.

        Raises
        ------
        ItemFailed
            On every rank, if an item failed on one of several ranks. A single rank raises the item's exception.
        """
        items = list(items)

        def call(item):
            give_back(MUCH)
            return function(item)

        if self.size == 1:
            return [call(item) for item in items]
        results, failed = [], ""
        for i in self.taken(np.zeros(len(items))):
            if failed:
                continue  # takes the remaining items from the other ranks without starting them
            try:
                results.append((i, call(items[i])))
            except Exception:
                failed = traceback.format_exc()
        gathered = self.comm.allgather((results, failed))
        for _, failed in gathered:
            if failed:
                raise ItemFailed(failed)
        by_item = dict(pair for results, _ in gathered for pair in results)
        return [by_item[i] for i in range(len(items))]

    def taken(self, sizes: Sequence[float], room: float = math.inf) -> Iterator[int]:
        """Indices of the items that this rank works on, assigned one by one.

        A rank gets the first free item that fits into `room` together with the active items of the other ranks of its
        node, or any free item if none of them is active; nodes share the items equally. Every rank must call this and
        iterate to the end, where it waits for the others.

        Parameters
        ----------
        sizes : sequence of float
            Size of each item.
        room : float
            Limit on the total size of the active items of a node.
        """
        if self.size == 1:
            yield from range(len(sizes))
            return
        from mpi4py import MPI  # imported here because the import starts MPI

        node = self.comm.Split_type(MPI.COMM_TYPE_SHARED)
        nodes = self.comm.allgather(node.allreduce(self.rank, MPI.MIN))  # number of each rank's node
        different = sorted(set(nodes))
        # a flag that is 1 while a rank changes the rest: the size of the active item of each rank, and for each item
        # whether it is assigned
        entries = 1 + node.size + len(sizes)
        window = MPI.Win.Allocate_shared(8 * entries if node.rank == 0 else 0, 8, comm=node)
        held, known = np.split(np.frombuffer(window.Shared_query(0)[0])[1:entries], [node.size])
        if node.rank == 0:
            np.frombuffer(window.tomemory())[:] = 0
            known[:] = np.arange(len(sizes)) % len(different) != different.index(
                nodes[self.rank]
            )  # items of other nodes
        window.Lock_all(MPI.MODE_NOCHECK)
        self.wait()
        while True:
            # MPI.Win.Lock would wait until rank 0 calls MPI, with MPICH; an atomic operation on shared memory does not
            while not _exchanged(window, 0, 1):
                time.sleep(1e-3)
            held[node.rank] = 0.0
            left = np.flatnonzero(known == 0)
            fitting = [i for i in left if not held.any() or held.sum() + sizes[i] <= room]
            if fitting:
                held[node.rank], known[fitting[0]] = sizes[fitting[0]], 1.0
            window.Sync()
            _exchanged(window, 1, 0)
            if fitting:
                yield int(fitting[0])
            elif len(left):
                time.sleep(PAUSE)
            else:
                break
        self.wait()
        window.Unlock_all()
        window.Free()
        node.Free()

    def from_first(self, value):
        """The value of the first rank, on every rank."""
        return value if self.size == 1 else self.comm.bcast(value)

    def of_each(self, value) -> list:
        """The values of all ranks, on every rank."""
        return [value] if self.size == 1 else self.comm.allgather(value)

    def wait(self) -> None:
        """Wait for all ranks without using the processor."""
        wait(self.comm)


def _exchanged(window, old: int, new: int) -> bool:
    """Whether the first entry of a window had the value `old`, in whose place it then has `new`."""
    found = np.empty(1, dtype=np.int64)
    window.Compare_and_swap(np.array([new], dtype=np.int64), np.array([old], dtype=np.int64), found, 0, 0)
    window.Flush(0)
    window.Sync()
    return bool(found[0] == old)


@dataclass(frozen=True)
class Context:
    """Settings of a run that a study receives.

    Attributes
    ----------
    quick : bool
        Whether to use coarse meshes and small samples.
    cache : Path
        Cache folder of meshes and influence coefficients, separate for each version of the code.
    team : Team
    """

    quick: bool
    cache: Path
    team: Team

    def model(self, scene: Scene) -> ReducedModel:
        """The scene's reduced model, built as in production on this process alone."""
        return reduced_and_assembly(scene, self.cache)[0]


@dataclass(frozen=True)
class Study:
    """A claim, its reference, and the measurement that compares them.

    Attributes
    ----------
    order : int
        Position in the report.
    title, claim, reference : str
    acceptance : tuple of Acceptance
    seconds : tuple of two float
        Expected time of the full and of the quick version on one core.
    run : callable
        ``run(context)`` returns one :class:`Finding` per acceptance limit, identical on every rank.
    missing : callable
        Text that names missing requirements, for which the study is skipped; empty if there are none.
    memory : float
        Peak memory of one process in the full version, GB.
    judges_accuracy : bool
        Whether its cases belong to the domain of applicability; False if they show messages, invariance or statistics.
    measured_assembly : bool
        Whether its reference is a measured assembly with measured inputs: validation rather than verification.
    name : str
        Name of the folder; set by :func:`studies`.
    """

    order: int
    title: str
    claim: str
    reference: str
    acceptance: tuple[Acceptance, ...]
    seconds: tuple[float, float]
    run: Callable[[Context], list[Finding]]
    missing: Callable[[], str] = lambda: ""
    memory: float = 1.0
    judges_accuracy: bool = True
    measured_assembly: bool = False
    name: str = ""

    def judged(self, quick: bool) -> list[Acceptance]:
        """The limits of the full or the quick version."""
        return [acceptance for acceptance in self.acceptance if not (quick and acceptance.full_only)]

    def evaluate(self, context: Context) -> list[CheckedFinding]:
        """Run the study and compare each finding with its acceptance limit.

        Raises
        ------
        ValueError
            If a quantity with an acceptance limit was not measured exactly once.
        """
        findings = self.run(context)
        limits = {acceptance.name: acceptance for acceptance in self.judged(context.quick)}
        if sorted(finding.name for finding in findings) != sorted(limits):
            raise ValueError(
                f"study {self.name!r} measured {sorted(f.name for f in findings)}, but its acceptance limits are for "
                f"{sorted(limits)}"
            )
        return [
            CheckedFinding(finding, limits[finding.name], limits[finding.name].at(context.quick))
            for finding in findings
        ]

    def unmeasured(self, quick: bool, why: str) -> list[CheckedFinding]:
        """Findings without measured values, which meet no limit."""
        return [CheckedFinding(Finding(item.name, math.nan, why), item, item.at(quick)) for item in self.judged(quick)]

    def opening(self) -> str:
        """First lines of the study's README: title, claim and reference."""
        return f"# {self.title}\n\n**Claim.** {self.claim}\n\n**Reference.** {self.reference}\n"

    def limits(self) -> str:
        """The acceptance limits as a Markdown table with their reasons."""
        rows = [f"| {a.name} | {a.claim} | {a.words()} | {a.reason} |" for a in self.acceptance]
        return "\n".join(["| name | quantity | limit | reason for the limit |", "| --- | --- | --- | --- |", *rows, ""])


def studies() -> dict[str, Study]:
    """All studies by name, in the order of the report."""
    found = {}
    for path in FOLDER.glob("*/study.py"):
        name = path.parent.name
        found[name] = replace(importlib.import_module(f"{__package__}.{name}.study").STUDY, name=name)
    return dict(sorted(found.items(), key=lambda item: (item[1].order, item[0])))
