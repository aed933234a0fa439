"""Errors that a user can correct, with one base class, so that a caller can catch them all."""

from __future__ import annotations

import os
import traceback
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

    import numpy as np

__all__ = [
    "ArgumentError",
    "FormatError",
    "FreeMotion",
    "ImpossibleSample",
    "MicError",
    "MissingLibrary",
    "MissingProvider",
    "Problems",
    "RunError",
    "SceneError",
    "Stopped",
    "StorageError",
    "WorkerLost",
]

#: In the paths of this program and of IPython.
_INNER = (os.path.dirname(__file__) + os.sep, f"{os.sep}IPython{os.sep}")


class MicError(Exception):
    """Base of every error whose message tells the user what to correct."""

    def _render_traceback_(self) -> list[str]:
        """Traceback for IPython and notebooks: the user's lines, without those of this program, and the message."""
        frames = traceback.extract_tb(self.__traceback__)
        own = [frame for frame in frames if not any(folder in frame.filename for folder in _INNER)]
        return [*traceback.format_list(own), f"{type(self).__name__}: {self}"]


class SceneError(MicError, ValueError):
    """A scene that cannot be run; the message names the file, the key and the remedy."""


class ArgumentError(MicError, ValueError):
    """An argument that a function cannot use; the message names the argument and the remedy."""


class ImpossibleSample(MicError, ArithmeticError):
    """A sample whose deviations make assembly impossible; it counts as failed, and the message gives the reason."""


class Problems:
    """Collects the errors of a scene, to report all of them at once.

    >>> problems = Problems()
    >>> for number in (1, 2):
    ...     with problems:
    ...         raise SceneError(f"problem {number}")
    >>> problems.raise_all()
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

    def raise_all(self) -> None:
        """Raise one :class:`SceneError` with all collected messages, if there are any."""
        if self.lines:
            raise SceneError("\n".join(self.lines))


class FormatError(MicError, ValueError):
    """A file of another kind or version, or one that is truncated or altered."""


class RunError(MicError):
    """A results folder that cannot be used as requested; the message gives the reason and the remedy."""


class StorageError(MicError):
    """A file or folder that cannot be read or written; the message names it and the reason (disk full, permission)."""


class MissingProvider(MicError, ImportError):
    """A finite-element computation is needed and no provider is installed."""


class MissingLibrary(MicError, ImportError):
    """An optional library is needed and not installed; the message gives the command that installs it."""


class WorkerLost(MicError, RuntimeError):
    """The process that did a task has ended without a result."""


class Stopped(BaseException):
    """SIGINT or SIGTERM was received. A BaseException, so that ``except Exception`` does not swallow it.

    Attributes
    ----------
    status : int
        Exit status of the program after this signal: 130 or 143.
    """

    def __init__(self, signal: int):
        super().__init__(f"stopped by signal {signal}")
        self.status = 128 + signal


class FreeMotion(MicError, ValueError):
    """The bilateral rows leave rigid-body motions free.

    Attributes
    ----------
    motions : (r, k) array
        The k free motions in columns, as combinations of the r motions that were to be constrained.
    """

    def __init__(self, motions: np.ndarray):
        super().__init__(f"{motions.shape[1]} rigid-body motions are free")
        self.motions = motions
