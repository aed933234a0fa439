"""Pictures that are begun while a run still writes its tables and computes its fields: they show the samples alone.

This module loads nothing that draws; the copy of the process does, in which they are drawn.
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING

from mic.execution.worker_process import WorkerProcess
from mic.results.outcome import Outcome

if TYPE_CHECKING:
    from mic.report.context import Context
    from mic.report.picture import Picture

__all__ = ["AHEAD", "Ahead"]

#: Of :data:`mic.report.picture_registry.PICTURES` those that take nothing that a run writes after the study of its path. The
#: copy begins with the first, and the last are drawn by the run itself where it is sooner at its end.
AHEAD = (
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


class Ahead:
    """The pictures :data:`AHEAD` of an outcome, drawn by a copy of this process from now on.

    Parameters
    ----------
    outcome : Outcome
        With the study of its path.
    """

    names = AHEAD

    def __init__(self, outcome: Outcome) -> None:
        self._outcome = outcome
        self._copy = WorkerProcess([partial(self._draw, name) for name in AHEAD])

    @cached_property
    def _context(self) -> Context:
        from mic.report.context import read_context

        return read_context(self._outcome)

    def _draw(self, name: str) -> Picture | None:
        from mic.report.picture_registry import draw

        return draw(name, self._outcome, self._context)

    def pictures(self) -> dict[str, Picture | None]:
        """They by name, None where the outcome cannot fill one."""
        return dict(zip(AHEAD, self._copy.results()))

    def end(self) -> None:
        """Let the copy go, whatever it is at."""
        self._copy.stop()
