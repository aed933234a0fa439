"""What a study is, and how the studies of this package are found.

A study is a folder with a ``study.py`` that defines ``STUDY`` and a ``README.md`` that opens with the study's claim,
its reference and its acceptance numbers (:meth:`Study.opening`). It measures numbers; the limits were declared before.
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

__all__ = ["Acceptance", "Context", "Finding", "ItemFailed", "Judged", "Study", "Team", "studies"]

FOLDER = Path(__file__).parent
PAUSE = 0.5  # s, after which a rank without room looks again
MUCH = 1.0  # GB: a process that holds more gives back what was freed before it begins with an item


@dataclass(frozen=True)
class Acceptance:
    """A number that a study must keep.

    Attributes
    ----------
    name : str
        Names the number within its study.
    claim : str
        What is claimed by keeping it, one sentence without the number.
    limit : float
    unit : str
        ``"1"`` for ratios.
    bound : {"at most", "at least"}
    quick : float or None
        The limit of the quick version where its coarser meshes need another.
    reason : str
        Why this number and no other: what theory gives, what a peer or a standard reaches, or what a user can bear.
        What was measured is none. Limits of the quick version show that a study runs, and validate nothing.
    """

    name: str
    claim: str
    limit: float
    unit: str = "1"
    bound: Literal["at most", "at least"] = "at most"
    quick: float | None = None
    reason: str = ""

    def at(self, quick: bool) -> float:
        """The limit of the full or the quick version."""
        return self.quick if quick and self.quick is not None else self.limit

    def words(self) -> str:
        """The acceptance number in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        other = "" if self.quick is None else f" (quick: {self.quick:g}{unit})"
        return f"{self.bound} {self.limit:g}{unit}{other}"


@dataclass(frozen=True)
class Finding:
    """What a study measured against one of its acceptance numbers, with what shows it.

    Attributes
    ----------
    name : str
        Of the acceptance number.
    measured : float
        In its unit.
    note : str
        Text for the report; its numbers are put in by the program, never typed.
    figure : matplotlib.figure.Figure or None
    table : pandas.DataFrame or None
        Column names carry the units.
    """

    name: str
    measured: float
    note: str = ""
    figure: object | None = None
    table: object | None = None


@dataclass(frozen=True)
class Judged:
    """A finding held against its acceptance number."""

    finding: Finding
    acceptance: Acceptance
    limit: float

    @property
    def passed(self) -> bool:
        """False for a number that is not finite, too."""
        measured = self.finding.measured
        if not math.isfinite(measured):
            return False
        return bool(measured <= self.limit if self.acceptance.bound == "at most" else measured >= self.limit)


class ItemFailed(RuntimeError):
    """An item that processes shared out failed on one of them; the message is the traceback from there."""


class Team:
    """The processes that work on a study together.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm or None
        None for a single process without MPI.
    """

    def __init__(self, comm=None):
        self.comm = comm
        self.rank, self.size = (comm.rank, comm.size) if comm is not None else (0, 1)

    def map(self, function: Callable, items) -> list:
        """``[function(item) for item in items]``, shared out over the ranks; the whole list on every rank.

        Every rank must call it with the same items, the dearest first: whoever is idle takes the next. Each item is
        worked on by itself, so the number of ranks leaves no trace in the results.

        Raises
        ------
        ItemFailed
            On every rank of several, where an item failed on one of them. One rank alone raises what the item raised.
        """
        items = list(items)

        def worked(item):
            give_back(MUCH)
            return function(item)

        if self.size == 1:
            return [worked(item) for item in items]
        own, failed = [], ""
        for i in self.taken(np.zeros(len(items))):
            if failed:
                continue  # so that nobody begins with what is left
            try:
                own.append((i, worked(items[i])))
            except Exception:
                failed = traceback.format_exc()
        shares = self.comm.allgather((own, failed))
        for _, failed in shares:
            if failed:
                raise ItemFailed(failed)
        found = dict(pair for share, _ in shares for pair in share)
        return [found[i] for i in range(len(items))]

    def taken(self, sizes: Sequence[float], room: float = math.inf) -> Iterator[int]:
        """Numbers of the items that this rank takes, one after the other: the first that nobody has and for which there
        is room beside those that the other ranks are at, or any where they are at none.

        Every rank must call it, and take until nothing is left: it then waits for the others.

        Parameters
        ----------
        sizes : sequence of float
            What each item takes of the room.
        room : float
        """
        if self.size == 1:
            yield from range(len(sizes))
            return
        from mpi4py import MPI  # only among several ranks: importing it starts MPI

        # By rank what it holds, and by item whether somebody has it.
        state = np.zeros(self.size + len(sizes))
        window = MPI.Win.Allocate(state.nbytes if self.rank == 0 else 0, state.itemsize, comm=self.comm)
        if self.rank == 0:
            np.frombuffer(window.tomemory(), dtype=state.dtype)[:] = 0
        self.wait()
        while True:
            window.Lock(0, MPI.LOCK_EXCLUSIVE)
            window.Get(state, 0)
            window.Flush(0)
            held, known = state[: self.size], state[self.size :]
            held[self.rank] = 0.0
            left = np.flatnonzero(known == 0)
            fitting = [i for i in left if not held.any() or held.sum() + sizes[i] <= room]
            if fitting:
                held[self.rank], known[fitting[0]] = sizes[fitting[0]], 1.0
            window.Put(state, 0)
            window.Unlock(0)
            if fitting:
                yield int(fitting[0])
            elif len(left):
                time.sleep(PAUSE)
            else:
                break
        self.wait()
        window.Free()

    def from_first(self, value):
        """The first rank's value, on every rank."""
        return value if self.size == 1 else self.comm.bcast(value)

    def of_each(self, value) -> list:
        """The values of all ranks, on every rank."""
        return [value] if self.size == 1 else self.comm.allgather(value)

    def wait(self) -> None:
        """Until every rank has come here; who waits leaves the core to the others."""
        wait(self.comm)


@dataclass(frozen=True)
class Context:
    """What a run gives to a study.

    Attributes
    ----------
    quick : bool
        Whether small meshes and few samples are asked for.
    cache : Path
        Folder for meshes and influence coefficients. It belongs to one version of the code, so that coefficients
        computed by another are never judged.
    team : Team
    """

    quick: bool
    cache: Path
    team: Team

    def model(self, scene: Scene) -> ReducedModel:
        """The scene's reduced model, made by the production path on this process alone."""
        return reduced_and_assembly(scene, self.cache)[0]


@dataclass(frozen=True)
class Study:
    """A claim, what it is held against, and how it is measured.

    Attributes
    ----------
    order : int
        Place in the report.
    title, claim, reference : str
    acceptance : tuple of Acceptance
    seconds : tuple of two float
        Expected time of the full and of the quick version on one core.
    run : callable
        ``run(context)`` returns one :class:`Finding` per acceptance number, and the same on every rank.
    missing : callable
        What it needs and does not find, in words; empty where all is there. Without it the study is left out.
    memory : float
        GB that one process holds at most in the full version.
    name : str
        The folder's; set when the study is found.
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
    name: str = ""

    def judge(self, context: Context) -> list[Judged]:
        """Run the study and hold each finding against its acceptance number.

        Raises
        ------
        ValueError
            If an acceptance number was not measured exactly once.
        """
        findings = self.run(context)
        limits = {acceptance.name: acceptance for acceptance in self.acceptance}
        if sorted(finding.name for finding in findings) != sorted(limits):
            raise ValueError(
                f"study {self.name!r} measured {sorted(f.name for f in findings)}, its acceptance numbers are "
                f"{sorted(limits)}"
            )
        return [Judged(finding, limits[finding.name], limits[finding.name].at(context.quick)) for finding in findings]

    def unmeasured(self, quick: bool, why: str) -> list[Judged]:
        """All its acceptance numbers, none of them measured, and so none kept."""
        return [Judged(Finding(one.name, math.nan, why), one, one.at(quick)) for one in self.acceptance]

    def opening(self) -> str:
        """First lines of the study's page: title, claim, reference and the table of limits."""
        rows = [f"| {a.name} | {a.claim} | {a.words()} | {a.reason} |" for a in self.acceptance]
        return (
            "\n".join(
                [
                    f"# {self.title}",
                    "",
                    f"**Claim.** {self.claim}",
                    "",
                    f"**Reference.** {self.reference}",
                    "",
                    "| name | quantity | limit | reason for the limit |",
                    "| --- | --- | --- | --- |",
                    *rows,
                ]
            )
            + "\n"
        )


def studies() -> dict[str, Study]:
    """All studies by name, in the order of the report."""
    found = {}
    for path in FOLDER.glob("*/study.py"):
        name = path.parent.name
        found[name] = replace(importlib.import_module(f"{__package__}.{name}.study").STUDY, name=name)
    return dict(sorted(found.items(), key=lambda item: (item[1].order, item[0])))
