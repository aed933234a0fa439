"""Pictures that a worker process draws while a run still writes its tables and fields.

This module imports no drawing library; the worker process does.
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING

from mic.execution.worker_process import WorkerProcess
from mic.results.outcome import Outcome

if TYPE_CHECKING:
    from mic.report.context import Context
    from mic.report.picture import Picture

__all__ = ["NAMES", "BackgroundPictures"]

#: Pictures that need only samples and path study. The worker process starts with the first; the run draws the last ones
#: if it finishes earlier.
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
    """Draws the pictures :data:`NAMES` of an outcome in a worker process, which starts at once.

    Parameters
    ----------
    outcome : Outcome
        With its path study.
    """

    names = NAMES

    def __init__(self, outcome: Outcome) -> None:
        self._outcome = outcome
        self._worker = WorkerProcess([partial(self._draw, name) for name in NAMES])

    @cached_property
    def _context(self) -> Context:
        from mic.report.context import read_context

        return read_context(self._outcome)

    def _draw(self, name: str) -> Picture | None:
        from mic.report.picture_registry import draw

        return draw(name, self._outcome, self._context)

    def pictures(self) -> dict[str, Picture | None]:
        """Wait for the pictures; by name, None if the outcome lacks the data for one."""
        return dict(zip(NAMES, self._worker.results()))

    def end(self) -> None:
        """Stop the worker process."""
        self._worker.stop()
