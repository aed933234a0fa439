"""Functions that the readers of text decks share: lines, numbers, included files, and messages with their place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.system.foreign_files import reason_to_refuse

__all__ = [
    "LONGEST",
    "axes_of",
    "included_file",
    "located",
    "number_range",
    "real",
    "refuse_recursion",
    "take",
    "text_lines",
]

DEPTH = 20  # most files that include each other
LONGEST = 10_000_000  # numbers of a range


def text_lines(path: Path) -> list[str]:
    """Lines of a text file; bytes that are not UTF-8 are replaced."""
    return path.read_text(encoding="utf-8-sig", errors="replace").splitlines()


def real(text: str) -> float:
    """The number of a field, also with the exponent D of FORTRAN; 0 for a blank field."""
    return float(text.upper().replace("D", "E")) if text else 0.0


def take(lines: Iterator[str], problem: str) -> str:
    """The next line.

    Raises
    ------
    FormatError
        With the text `problem`, if there is none.
    """
    line = next(lines, None)
    if line is None:
        raise FormatError(problem)
    return line


def axes_of(points: Sequence[np.ndarray] | np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes of a coordinate system given by its origin, a point on its main axis and a point in a plane with that.

    Returns the main axis, the one that completes it in the plane, and the normal of the plane: x, y and z if the main
    axis is x, or z, x and y.

    Raises
    ------
    FormatError
        If the points are collinear.
    """
    main = points[1] - points[0]
    normal = np.cross(main, points[2] - points[0])
    if not np.linalg.norm(normal) > 0:
        raise FormatError(f"the three points of {name} are collinear; correct them")
    main, normal = main / np.linalg.norm(main), normal / np.linalg.norm(normal)
    return main, np.cross(normal, main), normal


def number_range(first: int, last: int, step: int = 1) -> range:
    """The numbers from the first to the last.

    Raises
    ------
    FormatError
        If there are none, or too many.
    """
    numbers = range(first, last + 1, step) if step > 0 else range(0)
    if not numbers:
        raise FormatError(f"{first}, {last}, {step} generates no numbers; correct it")
    if last - first > LONGEST:
        raise FormatError(f"{first} to {last} are more than {LONGEST} numbers; correct it")
    return numbers


@contextmanager
def located(where: str, block: str) -> Iterator[None]:
    """Add the place, and the name of the block that is read, to the message of an error."""
    try:
        yield
    except FormatError as problem:
        raise FormatError(f"{where}: {problem}") from None
    except (ValueError, IndexError):
        raise FormatError(f"{where}: a field of this {block} is no number, or is missing") from None


def refuse_recursion(path: Path, including: tuple[Path, ...]) -> None:
    """Refuse a file that is included by a file that it includes."""
    if path in including or len(including) > DEPTH:
        raise FormatError(f"{including[-1].name} includes {path.name}, which includes it in turn; remove one line")


def included_file(path: Path, name: str, where: str) -> Path:
    """Path of a file that the deck at `path` includes.

    Raises
    ------
    FormatError
        If it does not exist, or lies where nothing may be read (:func:`mic.system.foreign_files.reading`).
    """
    other = path.parent / name.replace("\\", "/")
    if reason := reason_to_refuse(other):
        raise FormatError(f"{where}: it includes {name}, which {reason}")
    if not name or not other.is_file():
        name = name or "a file without a name"
        raise FormatError(f"{where}: it includes {name}, and there is no file {other}; correct the name")
    return other
