"""Reads Q-DAS files in the ASCII transfer format (AQDEF): ``.dfq``, or ``.dfd`` with its ``.dfx``.

A line ``Kxxxx/n text`` is field xxxx: K1xxx of part n, K2xxx of characteristic n, K0xxx of a value of characteristic n;
n = 0 means all. Values are fields K0001, or lines of one value per characteristic, separated by the control character
15, with attribute, time and further fields after the control character 20. Fields of a value follow it, or all precede
it.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np

from mic.errors import SceneError

__all__ = ["SUFFIXES", "Feature", "read_qdas"]

SUFFIXES = (".dfq", ".dfd", ".dfx")
FIELD = re.compile(r"K(\d{4})(?:/(\d+))?(?:[ \t]+(.*))?", re.DOTALL)
CHARACTERISTIC, WITHIN = "\x0f", "\x14"  # separators
ATTRIBUTE, INVALID = "0002", 255  # smallest attribute of a value that was not measured, or wrongly
COUNTED = "1"  # K2004 of a characteristic whose values are numbers of defects
IDENTIFIERS = ("0014", "0016")  # of a piece: its identifier, its production number


@dataclass(frozen=True)
class Feature:
    """A characteristic of the file.

    Attributes
    ----------
    names : tuple of str
        Description, number and short name, as far as they are given.
    nominal, lower, upper : float
        In `unit`; NaN if they are not given.
    unit : str
    """

    names: tuple[str, ...]
    nominal: float
    lower: float
    upper: float
    unit: str


@dataclass
class _Value:
    value: float
    piece: str = ""

    def add(self, field: str, text: str) -> None:
        if field in IDENTIFIERS:
            self.piece = self.piece or text
        elif field == ATTRIBUTE and _invalid(text):
            self.value = np.nan


def read_qdas(path: Path) -> tuple[list[Feature], list[str], np.ndarray]:
    """Features, names of the pieces, and (n, k) measured values in the units of the features; NaN for missing ones.

    Parameters
    ----------
    path : Path
        Of a ``.dfq`` file, or of a ``.dfd`` or ``.dfx`` file beside the other one.

    Raises
    ------
    SceneError
        If the file has no characteristic or no value, or a line cannot be read; the message names the line.
    """
    described: dict[int, dict[str, str]] = defaultdict(dict)
    values: dict[int, list[_Value]] = defaultdict(list)
    ahead: dict[tuple[str, int], str] = {}  # fields that precede their value, by field and characteristic
    precede: bool | None = None
    for place, line in _lines(path):
        match = FIELD.fullmatch(line)
        field, index, text = (match[1], int(match[2] or 1), (match[3] or "").strip()) if match else ("0001", 0, line)
        if field.startswith("2"):
            described[index][field] = text
        if not field.startswith("00"):
            continue
        precede = field != "0001" if precede is None else precede
        if field == "0001":
            try:
                for n, value in _values(index, text, described):
                    values[n].append(_Value(value))
                    for key in (*IDENTIFIERS, ATTRIBUTE) if precede else ():
                        values[n][-1].add(key, ahead.pop((key, n), "") or ahead.get((key, 0), ""))
            except ValueError:
                raise SceneError(f"{place}: {text[:40]!r} is no measured value; correct it") from None
        elif precede:
            ahead[field, index] = text
        else:
            for own in filter(None, [values[index]] if index else values.values()):
                own[-1].add(field, text)
    fields = {n: described[0] | described[n] for n in sorted(described) if n}
    numbers = [n for n, own in fields.items() if own.get("2004") != COUNTED]
    if not any(values[n] for n in numbers):
        lacking = "measured value" if numbers else "characteristic (K2001, K2002)"
        raise SceneError(f"it has no {lacking}; export the description and the measured values")
    return [_feature(n, fields[n]) for n in numbers], *_by_piece([values[n] for n in numbers])


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Place and text of each line that is not empty, the description first."""
    files = [path]
    if other := {".dfd": ".dfx", ".dfx": ".dfd"}.get(path.suffix.lower()):
        files += [file for file in (path.with_suffix(other), path.with_suffix(other.upper())) if file.is_file()][:1]
        if len(files) == 1:
            raise SceneError(f"{path.stem}{other} is missing; put description (.dfd) and values (.dfx) into one folder")
        files.sort(key=lambda file: file.suffix.lower())
    for file in files:
        content = file.read_bytes()
        try:
            text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
        for number, line in enumerate(re.split(r"\r\n|\n|\r", text), 1):
            if stripped := line.strip(" \t\0\x1a"):
                yield f"{file.name}, line {number}", stripped


def _values(index: int, text: str, described: Mapping[int, Mapping[str, str]]) -> Iterator[tuple[int, float]]:
    """Number of the characteristic and value for a field K0001, or for each value of a line; ValueError if wrong."""
    numbers = [index] if index else [n for n in sorted(described) if n]
    cells = text.split(CHARACTERISTIC)
    if any(cells[len(numbers) :]):
        raise ValueError
    for n, cell in zip_longest(numbers, cells[: len(numbers)], fillvalue=""):
        value, *further = (part.strip() for part in cell.split(WITHIN))
        yield int(n), np.nan if not value or any(map(_invalid, further[:1])) else _number(value)


def _invalid(attribute: str) -> bool:
    return attribute.isdecimal() and int(attribute) >= INVALID


def _number(text: str) -> float:
    if "_" in text or not np.isfinite(number := float(text.replace(",", "."))):
        raise ValueError(f"{text[:40]!r} is no number")
    return number


def _by_piece(values: list[list[_Value]]) -> tuple[list[str], np.ndarray]:
    """Names of the pieces, and (n, k) values; a piece is known by its identifier, else by its place in the file."""
    counts = {len(own) for own in values if own}
    identified = all(value.piece for own in values for value in own)
    if len(counts) > 1 and not identified:
        number = f"its characteristics have {min(counts)} to {max(counts)} values"
        raise SceneError(f"{number}, and not each has an identifier of its piece (K0014); export this field too")
    names: dict[tuple[str, int], str] = {}
    table: dict[tuple[tuple[str, int], int], float] = {}
    for k, own in enumerate(values):
        seen: Counter[str] = Counter()
        for i, value in enumerate(own):
            seen[value.piece] += 1
            key = (value.piece, seen[value.piece]) if identified else ("", i)
            again = f" ({key[1]})" if identified and key[1] > 1 else ""
            names[key] = names.get(key) or (value.piece and value.piece + again)
            table[key, k] = value.value
    found = [[table.get((key, k), np.nan) for k in range(len(values))] for key in names]
    return [name or str(i) for i, name in enumerate(names.values(), 1)], np.array(found)


def _feature(n: int, fields: Mapping[str, str]) -> Feature:
    """A characteristic by its fields; limits may be given relative to the nominal value."""
    nominal, lower, upper, below, above = (
        _number(fields[key]) if fields.get(key) else np.nan for key in ("2101", "2110", "2111", "2112", "2113")
    )
    lower, upper = (by + nominal if np.isnan(limit) else limit for limit, by in ((lower, below), (upper, above)))
    names = tuple(dict.fromkeys(fields[key] for key in ("2002", "2001", "2003") if fields.get(key)))
    return Feature(names or (str(n),), nominal, lower, upper, fields.get("2142", ""))
