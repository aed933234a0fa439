"""One message when Numba compiles code, because the program is silent for a minute then."""

from __future__ import annotations

import logging
from functools import cache

from numba.core import event

__all__ = ["announce_compilation"]

MESSAGE = (
    "compiling the contact solver, once for this installation: about a minute (to do this beforehand: "
    "python -m mic.commands.compile)"
)


@cache
def announce_compilation() -> None:
    """Log a warning when Numba first compiles in this process; code loaded from Numba's cache is not reported."""
    event.register("numba:compile", _FirstCompilation())


class _FirstCompilation(event.Listener):
    """Logs the first compilation."""

    def __init__(self) -> None:
        self._logged = False

    def on_start(self, _) -> None:
        if not self._logged:
            self._logged = True
            logging.getLogger(__name__).warning(MESSAGE)

    def on_end(self, _) -> None:
        pass
