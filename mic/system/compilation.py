"""That compiled code is being made is told, once: a minute in which nothing else is heard."""

from __future__ import annotations

import logging
from functools import cache

from numba.core import event

__all__ = ["tell"]

WORDS = (
    "compiling the contact solver, once for this installation: about a minute (beforehand, and where nobody waits: "
    "python -m mic.commands.compile)"
)


@cache
def tell() -> None:
    """From now on; code that was kept from an earlier process is read without a word."""
    event.register("numba:compile", _Once())


class _Once(event.Listener):
    """Hears of what Numba compiles, and says so the first time."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, _) -> None:
        if not self.said:
            self.said = True
            logging.getLogger(__name__).warning(WORDS)

    def on_end(self, _) -> None:
        pass
