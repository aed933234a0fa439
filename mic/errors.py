"""What can go wrong that a user can mend: one base, so that a caller may catch all of it at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

    import numpy as np

__all__ = [
    "FormatError",
    "FreeMotion",
    "ImpossibleSample",
    "MicError",
    "MissingProvider",
    "Problems",
    "RunError",
    "SceneError",
    "Stopped",
    "StorageError",
]


class MicError(Exception):
    """Base of every error whose message tells the user what to mend."""


class SceneError(MicError, ValueError):
    """A scene that cannot be run; the message names the file, the key and the remedy."""


class ImpossibleSample(MicError, ArithmeticError):
    """A sample whose deviations nothing can be built with; it is counted as failed, and the message says why."""


class Problems:
    """Collects what is wrong with a scene, so that all of it is told at once.

    >>> problems = Problems()
    >>> for number in (1, 2):
    ...     with problems:
    ...         raise SceneError(f"problem {number}")
    >>> problems.tell()
    Traceback (most recent call last):
    mic.errors.SceneError: problem 1
    problem 2
    """

    def __init__(self) -> None:
        self.lines: list[str] = []

    def __bool__(self) -> bool:
        return bool(self.lines)

    def __enter__(self) -> Problems:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> bool:
        if isinstance(error, SceneError):
            self.lines += [line for line in str(error).splitlines() if line not in self.lines]
            return True
        return False

    def tell(self) -> None:
        """Raise :class:`SceneError` with all that was collected, if anything was."""
        if self.lines:
            raise SceneError("\n".join(self.lines))


class FormatError(MicError, ValueError):
    """A file that is not what it should be: another kind, another version, cut short, altered."""


class RunError(MicError):
    """A results folder that cannot be used as asked; the message says why and what to do instead."""


class StorageError(MicError):
    """A file or folder that cannot be written or read: disk full, no permission; the message names it and says why."""


class MissingProvider(MicError, ImportError):
    """Something must be computed by finite elements, and no provider of them is installed."""


class Stopped(BaseException):
    """The program was told to stop, by SIGINT or SIGTERM. No error, and not to be swallowed as one.

    Attributes
    ----------
    status : int
        Exit status of a program that this signal ends: 130 or 143.
    """

    def __init__(self, signal: int):
        super().__init__(f"stopped by signal {signal}")
        self.status = 128 + signal


class FreeMotion(MicError, ValueError):
    """Bilateral rows that leave rigid-body motions free.

    Attributes
    ----------
    motions : (r, k) array
        The k free motions in columns, in terms of the r motions that were to be held.
    """

    def __init__(self, motions: np.ndarray):
        super().__init__(f"{motions.shape[1]} rigid-body motions are free")
        self.motions = motions
