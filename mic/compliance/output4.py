"""Reads Nastran OUTPUT4 files (``.op4``): matrices by columns, as text or binary.

A matrix begins with its numbers of columns and rows, form and type (1, 2: real with one or two words per value, 3, 4:
complex), and name. Each column follows with its number, its first row and its length; a column past the last ends the
matrix. A first row of 0 means that the column is stored as strings, each with its length in words and its first row:
as two integers if the number of rows is negative or at least 65536, else as one, ``65536 (length + 1) + row``. In a
text file the first line of a matrix states how many numbers of which width a line holds; in a binary file each record
stands between its lengths in bytes, in the byte order of the machine that wrote it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from mic.errors import FormatError

__all__ = ["matrices"]

BIG = 65536  # number of rows from which strings have two integers
LAYOUT = re.compile(r"(\d+)[ED](\d+)\.")  # of a line of text, such as 1P,3E23.16
HEADER = 24  # bytes of a binary matrix's first record


def matrices(data: bytes) -> dict[str, csr_matrix]:
    """The matrices of a file, by name.

    Raises
    ------
    FormatError
        If the file is cut short or is no OUTPUT4 file, or a matrix is complex.
    """
    order = next((mark for mark in "<>" if data[:4] == struct.pack(f"{mark}i", HEADER)), None)
    by_name = {}
    try:
        source = _Text(data) if order is None else _Binary(data, order)
        while source.more():
            columns, rows, kind, name = source.header()
            if kind not in (1, 2):
                raise FormatError(f"{name} is complex; a stiffness is real")
            row, column, value = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
            for number, first, values in _strings(source, columns, rows, kind):
                row.append(first - 1 + np.arange(len(values)))
                column.append(np.full(len(values), number - 1))
                value.append(values)
            entries = np.concatenate(value), (np.concatenate(row), np.concatenate(column))
            by_name[name] = coo_matrix(entries, shape=(abs(rows), columns)).tocsr()
    except FormatError:
        raise
    except (ValueError, IndexError, struct.error):
        raise FormatError("it is cut short, or no OUTPUT4 file; write it again with Nastran") from None
    return by_name


def _strings(source, columns: int, rows: int, kind: int) -> Iterator[tuple[int, int, np.ndarray]]:
    """Column, first row and values (n,) of the strings of a matrix, numbered from 1."""
    two = rows < 0 or rows >= BIG
    while True:
        column, row, size = source.column()
        if column > columns:
            source.end()
            return
        if row > 0:
            yield column, row, source.values(size if source.counts_values else size // kind, kind)
            continue
        while size > 0:
            length, row = source.integers(2) if two else divmod(source.integers(1)[0], BIG)
            size -= length + two
            if length <= kind:
                raise ValueError("an empty string")
            yield column, row, source.values((length - 1) // kind, kind)


class _Text:
    """A text file, read line by line."""

    counts_values = True  # a full column states its length in values, not in words

    def __init__(self, data: bytes):
        self._lines = data.decode("ascii", errors="replace").splitlines()
        self._at = 0

    def more(self) -> bool:
        return any(line.strip() for line in self._lines[self._at :])

    def _line(self) -> str:
        self._at += 1
        return self._lines[self._at - 1]

    def header(self) -> tuple[int, int, int, str]:
        line = self._line()
        layout = LAYOUT.search(line[40:].upper())
        self._each, self._width = (int(layout[1]), int(layout[2])) if layout else (5, 16)
        columns, rows, _, kind = (int(line[at : at + 8]) for at in (0, 8, 16, 24))
        return columns, rows, kind, line[32:40].strip()

    def integers(self, number: int) -> list[int]:
        line = self._line()
        return [int(line[8 * i : 8 * i + 8]) for i in range(number)] if number > 1 else [int(line)]

    def column(self) -> list[int]:
        return self.integers(3)

    def end(self) -> None:
        self._line()

    def values(self, number: int, kind: int) -> np.ndarray:
        numbers: list[float] = []
        while len(numbers) < number:
            line = self._line().upper().replace("D", "E")
            most = min(self._each, number - len(numbers))
            numbers += [float(line[self._width * i : self._width * (i + 1)]) for i in range(most)]
        return np.array(numbers)


class _Binary:
    """A binary file, read record by record."""

    counts_values = False

    def __init__(self, data: bytes, order: str):
        self._data, self._order, self._at = data, order, 0

    def more(self) -> bool:
        return self._at < len(self._data)

    def _record(self) -> bytes:
        (size,) = struct.unpack_from(f"{self._order}i", self._data, self._at)
        start, self._at = self._at + 4, self._at + size + 8
        if size < 0 or struct.unpack_from(f"{self._order}i", self._data, self._at - 4) != (size,):
            raise ValueError("the lengths before and after a record differ")
        return self._data[start : start + size]

    def header(self) -> tuple[int, int, int, str]:
        columns, rows, _, kind, name = struct.unpack(f"{self._order}4i8s", self._record())
        return columns, rows, kind, name.decode("ascii", errors="replace").strip(" \0")

    def column(self) -> tuple[int, ...]:
        self._own, self._word = self._record(), 3
        return struct.unpack_from(f"{self._order}3i", self._own)

    def integers(self, number: int) -> tuple[int, ...]:
        self._word += number
        return struct.unpack_from(f"{self._order}{number}i", self._own, 4 * (self._word - number))

    def end(self) -> None:
        """Nothing: the record of the column past the last is already read."""

    def values(self, number: int, kind: int) -> np.ndarray:
        start = 4 * self._word
        self._word += number * kind
        if 4 * self._word > len(self._own):
            raise ValueError("a string is longer than its column")
        return np.frombuffer(self._own, f"{self._order}f{4 * kind}", number, start)
