"""Reads measured values of pieces: tables of a coordinate measuring machine, and Q-DAS files.

A table has a row for each feature, with the pieces one below the other or a column for each, or a row for each piece
with a column for each feature. The features are recognised by their names, which are those of the scene in any case and
punctuation. A value is a deviation, or an actual value beside its nominal value.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mic.errors import SceneError
from mic.scene.qdas import SUFFIXES, read_qdas
from mic.scene.table_columns import BRACKETED, ENDING, Columns, unit_of
from mic.scene.table_file import TableFile, open_table
from mic.system.foreign_files import reading

__all__ = ["MeasuredReport", "read_measured_report"]

#: Columns of a report, by the keys of ``columns.toml``.
ROLES = ("name", "axis", "nominal", "value", "deviation", "gauge", "serial", "unit")
IGNORED = ("lower", "upper", "plus_minus", "width", "tolerance")
CLOSE = 0.8  # similarity of a name to one of the scene above which it is a spelling mistake
SEEN = 1e-6  # component of a direction that counts
AXES = ("x", "y", "z")
ALONG = ("t", "n", "normal", "vector")  # axes of a deviation along the direction of its feature
NUMBERS = ("value", "nominal", "deviation", "gauge")

Find = Callable[..., str | None]


@dataclass(frozen=True)
class MeasuredReport:
    """Measured deviations of some pieces.

    Attributes
    ----------
    values : dict of str to dict
        By serial number of the piece: deviations from nominal by the scene's names, mm or N. Without serial numbers,
        pieces are named by their row in a table with a row for each piece, else by their number from 1.
    rows : list of int
        Of each piece: its row in such a table, else its number from 1.
    gauge : dict of str to float
        Standard deviations of the gauge by name, mm, as far as they are given.
    said : list of str
        How the file was read, in sentences.
    """

    values: dict[str, dict[str, float]]
    rows: list[int]
    gauge: dict[str, float]
    said: list[str]


class _Reading(NamedTuple):
    """A deviation of a feature of a piece, and where it stands."""

    place: str
    piece: str
    row: int
    features: tuple[str, ...]
    axis: str
    deviation: float
    gauge: float = np.nan
    unit: str = ""


def read_measured_report(
    path: Path,
    names: Sequence[str],
    what: str,
    directions: Mapping[str, Sequence[float]] | None = None,
    folder: Path | None = None,
    units: Mapping[str, str] | None = None,
) -> MeasuredReport:
    """Measured deviations of the pieces in a file.

    Parameters
    ----------
    path : Path
        A table, or a Q-DAS file (:mod:`mic.scene.qdas`).
    names : sequence of str
        Names of the scene: key characteristics, or deviations.
    what : str
        What they are, for messages.
    directions : mapping of str to (3,) vectors, optional
        By name: deviations along x, y and z are combined along it.
    folder : Path, optional
        Of the scene that names the file, see :func:`mic.system.foreign_files.reading`.
    units : mapping of str to str, optional
        By name: ``mm`` or ``N``. Values in other units of that quantity are converted, those of another are refused.

    Raises
    ------
    SceneError
        If the file has none of the names, misspells one, or a value is wrong; the message names file, row and column.
    """
    forms = Counter(map(_simplified, names))
    known = {form: name for name in names if forms[form := _simplified(name)] == 1} | {name: name for name in names}
    find = lambda *texts: next((known[t] for text in texts for t in (text, _simplified(text)) if t in known), None)
    if path.suffix.lower() in SUFFIXES:
        with reading(path, "Q-DAS file", folder, SceneError):
            readings, said = list(_of_qdas(path)), ""
    else:
        readings, said = _of_table(path, names, find, what, folder, units or {})
    values: dict[str, dict[str, float]] = {}
    gauge: dict[str, float] = {}
    parts: dict[tuple[str, str], dict[str, float]] = {}  # components of a deviation
    rows: dict[str, int] = {}
    others: dict[str, str] = {}  # features that are not in the scene, and where they stand
    for place, piece, row, features, axis, deviation, sigma, unit in readings:
        name = find(*(f"{feature}{axis}" for feature in features))
        component = axis.casefold() if name is None and axis else ""
        name = name or (find(*features) if component in (*AXES, *ALONG) else None)
        if name is None:
            others.setdefault(features[0] + (axis and f" {axis}"), place)
            continue
        own_unit = None if units is None else units.get(str(name))
        if own_unit is not None and unit and not _same_quantity(unit, own_unit):
            raise SceneError(f"{path}: {place}: {name} is given in {unit}; convert it to {own_unit or 'a number'}")
        own = values.setdefault(piece, {})
        rows.setdefault(piece, row or len(values))
        if np.isfinite(sigma):
            gauge[name] = sigma
        if np.isnan(deviation):
            continue
        target, key = (parts.setdefault((piece, name), {}), component) if component in AXES else (own, name)
        if key in target:
            twice = f"{name!r} is given twice; delete one row, or add a column serial to tell pieces apart"
            raise SceneError(f"{path}: {place}: {twice}")
        target[key] = deviation
    read = {name for own in values.values() for name in own} | {name for _, name in parts}
    _refuse_misspelt(path, others, read, names, what)
    _combine(path, parts, values, directions or {}, what)
    rows = {piece: row for piece, row in rows.items() if values[piece]}
    values = {piece: own for piece, own in values.items() if own}
    if not values:
        raise SceneError(f"{path}: there is no measured value of a {what} of the scene; add a row below the header")
    if others and not all(place == "row 1" for place in others.values()):  # of columns the table tells itself
        said = f"{said}. " * bool(said) + f"Ignored, since the scene has no such {what}: {', '.join(others)}."
    return MeasuredReport(values, list(rows.values()), gauge, [said] * bool(said))


def _combine(path: Path, parts, values, directions: Mapping[str, Sequence[float]], what: str) -> None:
    """Add the deviations along the directions whose components along the axes are given."""
    for (piece, name), components in parts.items():
        along = dict(zip(AXES, directions.get(name, ())))
        missing = [axis for axis, d in along.items() if abs(d) > SEEN and axis not in components]
        if name in values[piece]:
            continue  # also measured along the direction itself
        if missing or not along:
            lacking = (
                f"axis {missing[0]} is missing; add a row" if along else "it has no direction; give one row for it"
            )
            raise SceneError(f"{path}: {what} {name!r} of piece {piece}: {lacking}")
        values[piece][name] = sum(d * components.get(axis, 0.0) for axis, d in along.items())


def _scale(unit: str) -> float:
    """A unit of length in mm, of force in N; 1 for others."""
    known = unit_of(unit, "length") or unit_of(unit, "force")
    return 1.0 if known is None else known[1]


def _same_quantity(unit: str, own: str) -> bool:
    """Whether a unit can be converted to the own one of a deviation."""
    known, expected = unit_of(unit), unit_of(own)
    if known is None and not own:
        return True
    return unit.casefold() == own.casefold() if known is None or expected is None else known[0] == expected[0]


def _refuse_units(path: Path, unused: Iterable[str], find: Find, units: Mapping[str, str]) -> None:
    """Refuse columns whose header is a name with a unit of another quantity, or one that is not known."""
    for header in unused:
        bracket, ending = BRACKETED.search(header), ENDING.match(header.strip())
        if bracket:
            name, unit = find(header[: bracket.start()] + header[bracket.end() :]), bracket[1]
        elif ending and unit_of(ending[2]):
            name, unit = find(ending[1]), ending[2]
        else:
            continue
        if name is not None and name in units:
            own = f"in {units[name]}" if units[name] else "as a number"
            raise SceneError(f"{path}: column {header!r}: {unit} is no unit of {name}; give it {own}, once")


def _simplified(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).casefold()


def _refuse_misspelt(path: Path, others: Iterable[str], read: set[str], names: Sequence[str], what: str) -> None:
    """Refuse a file that has no name of the scene, or one that is nearly a name that is missing otherwise."""
    for other in others:
        near = difflib.get_close_matches(other, [name for name in names if name not in read], 1, CLOSE)
        if near and re.findall(r"\d+", near[0]) == re.findall(r"\d+", other):
            raise SceneError(f"{path}: there is no {what} {other!r}; did you mean {near[0]!r}? Correct the name")
    if others and not read:
        raise SceneError(
            f"{path}: there is no {what} {next(iter(others))!r} in this scene; known: {', '.join(names) or 'none'}; "
            "correct the name, or use the file of this scene"
        )


def _of_qdas(path: Path) -> Iterator[_Reading]:
    """The deviations of a Q-DAS file, in mm if their unit is a length."""
    features, pieces, values = read_qdas(path)
    for feature, column in zip(features, values.T):
        nominal = feature.nominal
        if np.isnan(nominal):  # a form or position: deviations themselves
            nominal = 0.0
            if feature.lower > 0 or feature.upper < 0:
                raise SceneError(f"characteristic {feature.names[0]!r} has no nominal value; export field K2101")
        scale = _scale(feature.unit)
        for i, value in enumerate(column):
            yield _Reading(
                f"value {i + 1}", pieces[i], i + 1, feature.names, "", scale * (value - nominal), np.nan, feature.unit
            )


def _of_table(
    path: Path, names: Sequence[str], find: Find, what: str, folder: Path | None, units: Mapping[str, str]
) -> tuple[list[_Reading], str]:
    """The deviations of a table, and how it was read."""
    usual = Columns.of_file((*ROLES, *IGNORED))
    quantities = {name: known[0] for name, unit in units.items() if (known := unit_of(unit)) is not None}
    own = {name: [f"{name} {units[name]}"] if units.get(name) and name not in quantities else () for name in names}
    columns = Columns(own | dict(usual.aliases), usual.texts, quantities)
    table = open_table(path, columns, folder)
    roles = {key: at for key, at in table.key_of.items() if key not in names}
    by_name = {at: key for key, at in table.key_of.items() if key in names}
    hits = [sum(find(cell) is not None for cell in table.texts(at)) for at in range(len(table.header.headers))]
    feature = max(range(len(hits)), key=lambda at: (hits[at], at == roles.get("name")))
    if not table.rows:
        raise SceneError(f"{path}: there is no row below the header; add one for each measured {what}")
    _refuse_units(path, table.header.unused, find, units)
    if not hits[feature] and (by_name or "name" not in roles):
        return list(_row_a_piece(path, table, by_name, roles)), table.said
    used = {**table.key_of, "name": feature}
    if "deviation" in roles or "value" in roles:
        return list(_row_a_feature(path, table, feature, roles)), replace(table.header, key_of=used).said(table.notes)
    values = _columns_of_pieces(path, table, {feature, *roles.values()})
    used |= {table.header.headers[at]: at for at in values}
    nominal = np.nan_to_num(table.numbers("nominal")) if "nominal" in roles else np.zeros(len(table.rows))
    found = np.array(list(values.values()))
    actual = bool(
        np.nansum(np.abs(found - nominal)) < np.nansum(np.abs(found))
    )  # nearer to the nominal values than to 0
    said = replace(table.header, key_of=used).said(table.notes)
    said += f"; {'actual values' if actual else 'deviations'} of {len(values)} pieces"
    return list(_column_a_piece(path, table, feature, values, nominal if actual else 0.0 * nominal)), said


def _row_a_piece(
    path: Path, table: TableFile, by_name: Mapping[int, str], roles: Mapping[str, int]
) -> Iterator[_Reading]:
    serials = table.texts(roles["serial"]) if "serial" in roles else [""] * len(table.rows)
    for at, column in enumerate(table.header.headers):
        if at in by_name:
            for (row, cells), serial, number in zip(table.rows, serials, table.numbers(by_name[at])):
                _refuse_text(path, row, column, cells[at], number)
                yield _Reading(f"row {row}", serial or f"row {row}", row, (by_name[at],), "", number)
        elif at not in roles.values():
            yield _Reading("row 1", "", 0, (column,), "", np.nan)


def _row_a_feature(path: Path, table: TableFile, feature: int, roles: Mapping[str, int]) -> Iterator[_Reading]:
    """Actual minus nominal values, or else deviations as they are stated."""
    texts = {role: table.texts(at) for role, at in roles.items()}
    numbers = {role: table.numbers(role) for role in NUMBERS if role in roles}
    name = ""
    for i, (row, cells) in enumerate(table.rows):
        for role, column in numbers.items():
            _refuse_text(path, row, table.header.headers[roles[role]], texts[role][i], column[i])
        actual, nominal, deviation, sigma = (numbers[role][i] if role in numbers else np.nan for role in NUMBERS)
        axis = texts["axis"][i] if "axis" in roles else ""
        name = cells[feature].strip() or (name if axis else "")
        if not name:
            raise SceneError(f"{path}: row {row}, column {table.header.headers[feature]}: is empty; name the feature")
        if np.isfinite(actual - nominal):
            deviation = actual - nominal
        elif np.isnan(deviation) and "nominal" not in roles and "deviation" not in roles:
            deviation = actual  # the only column of values
        elif np.isfinite(actual) and np.isnan(deviation):
            raise SceneError(f"{path}: row {row}: the nominal value of {name!r} is missing; add it")
        unit = texts["unit"][i].strip() if "unit" in roles else ""
        scale = _scale(unit)
        piece = texts["serial"][i] if "serial" in roles else ""
        yield _Reading(f"row {row}", piece or "1", 0, (name,), axis, scale * deviation, scale * sigma, unit)


def _columns_of_pieces(path: Path, table: TableFile, used: set[int]) -> dict[int, list[float]]:
    """The numbers in each column that has some and is not used otherwise."""
    others = (at for at in range(len(table.header.headers)) if at not in used)
    values = {at: table.numbers(at) for at in others}
    values = {at: column for at, column in values.items() if np.isfinite(column).any()}
    if not values:
        raise SceneError(
            f"{path}: row 1: column 'value' is missing; add it, or nominal and actual, or one for each piece"
        )
    return values


def _column_a_piece(path: Path, table: TableFile, feature: int, values, nominal: np.ndarray) -> Iterator[_Reading]:
    for at, column in values.items():
        for (row, cells), number, expected in zip(table.rows, column, nominal):
            piece = table.header.headers[at]
            _refuse_text(path, row, piece, cells[at], number)
            yield _Reading(f"row {row}", piece, 0, (cells[feature].strip(),), "", number - expected)


def _refuse_text(path: Path, row: int, column: str, cell: str, number: float) -> None:
    if cell.strip() and not np.isfinite(number):
        raise SceneError(
            f"{path}: row {row}, column {column}: {cell.strip()!r} is not a finite number; correct it, or leave the "
            "cell empty if it was not measured"
        )
