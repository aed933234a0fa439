"""Progress of a computation on one line, for notebooks and interactive sessions."""

from __future__ import annotations

import sys
import time
from typing import Any

from mic.errors import ArgumentError

__all__ = ["ProgressBar"]

PATIENCE = 1.0  # s before the first line, unless it is requested
PERIOD = 0.2  # s between two lines
WIDTH = 24  # letters of the bar


class ProgressBar:
    """One line, written again and again, of a notebook's output or the standard error stream; the last one stays.

    Parameters
    ----------
    progress : bool or None
        Whether it is shown; None: after one second, in a notebook or an interactive session.
    total : int, optional
        Number of evaluations, if known.

    Attributes
    ----------
    shown : bool
        Whether it may be shown.

    Raises
    ------
    ArgumentError
        If `progress` is something else.
    """

    def __init__(self, progress: bool | None, total: int | None = None):
        if not isinstance(progress, bool | None):
            raise ArgumentError(f"progress is {progress!r}; give True or False")
        interactive = hasattr(sys, "ps1")  # set by Python and IPython for their prompts
        self.shown = interactive if progress is None else progress
        self._start = time.monotonic()
        self._next = self._start + (PATIENCE if progress is None else 0.0)
        self._total, self._count, self._text, self._length = total, 0, "", 0
        self._notebook = sys.modules.get("IPython.display") if "ipykernel" in sys.modules else None
        self._cell: Any = None

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *error: object) -> None:
        if self._length:
            self._write(f"{self._text}, {time.monotonic() - self._start:.1f} s", "\n")

    def advance(self, count: int) -> None:
        """Count further evaluations."""
        self._count += count
        used = time.monotonic() - self._start
        self._text, time_text = f"{self._count} evaluations", f"{used:.0f} s"
        if self._total:
            done = WIDTH * min(self._count, self._total) // self._total
            self._text = f"[{'#' * done}{'-' * (WIDTH - done)}] {self._count}/{self._total} evaluations"
            time_text = f"{used * (self._total / max(self._count, 1) - 1):.0f} s left"
        self._show(f"{self._text}, {time_text}")

    def report(self, sentence: str) -> None:
        """Show a sentence in place of the line before."""
        self._text = sentence
        self._show(sentence)

    def _show(self, text: str) -> None:
        if self.shown and time.monotonic() >= self._next:
            self._next = time.monotonic() + PERIOD
            self._write(text)

    def _write(self, text: str, end: str = "") -> None:
        if self._notebook is not None:  # an output that is replaced, also in the saved notebook
            self._cell = self._cell or self._notebook.display({}, raw=True, display_id=True)
            self._cell.update({"text/plain": text}, raw=True)
        else:
            print("\r" + text.ljust(self._length), end=end, file=sys.stderr, flush=True)
        self._length = len(text)
