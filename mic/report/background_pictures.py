"""Pictures that worker processes draw while a run still writes its tables and fields.

This module imports no drawing library; the worker processes do.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from mic.execution.engine import forked_workers
from mic.execution.local import Local, WorkerPool
from mic.results.outcome import Outcome

if TYPE_CHECKING:
    from mic.report.context import Context
    from mic.report.picture import Picture

__all__ = ["NAMES", "WORKERS", "BackgroundPictures"]

WORKERS = 4  # at most, since each of them imports the drawing library, which takes as long as three pictures

#: Pictures that need only samples and path study.
NAMES = (
    "measurements",
    "states",
    "one-sample-f",
    "tangential-density",
    "law-cost",
    "one-sample-u",
    "slip-force",
    "path-states",
    "friction-work",
    "path-error",
    "deviation-maps",
    "assembly",
)


class BackgroundPictures:
    """Draws the pictures :data:`NAMES` of an outcome in worker processes, which start at once, on all cores but one.

    With one core, or where workers cannot be forked, this process draws them when they are requested.

    Parameters
    ----------
    outcome : Outcome
        With its path study.
    """

    names = NAMES

    def __init__(self, outcome: Outcome) -> None:
        self._outcome = outcome
        workers = min(WORKERS, forked_workers() - 1)
        self._pool = WorkerPool(self._draw, NAMES, workers) if workers > 0 else None

    @cached_property
    def _context(self) -> Context:
        from mic.report.context import read_context

        return read_context(self._outcome)

    def _draw(self, name: str) -> Picture | None:
        from mic.report.picture_registry import draw

        return draw(name, self._outcome, self._context)

    def pictures(self) -> dict[str, Picture | None]:
        """Wait for the pictures; by name, None if the outcome lacks the data for one."""
        completed = self._pool.completed() if self._pool else Local(1).completed(self._draw, NAMES)
        return {NAMES[number]: picture for number, picture in completed}

    def end(self) -> None:
        """End the worker processes."""
        if self._pool:
            self._pool.stop()
