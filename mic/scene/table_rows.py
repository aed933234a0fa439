"""Rows of a table as items of the scene: points, directions, parts and limits from the columns that people have."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel

from mic.errors import SceneError
from mic.scene.keys import LengthUnit
from mic.scene.part_names import PartNames
from mic.scene.table_columns import Columns, data, squash, unit_of
from mic.scene.table_file import LINE, TableFile, TableSettings, open_table

__all__ = ["AXES", "WrongRows", "read_rows"]

AXES = ("x", "y", "z")
UNITS = get_args(LengthUnit)
FLAGS = {"true": True, "yes": True, "ja": True, "false": False, "no": False, "nein": False}
AXIS = re.compile(r"([+-]?)([xyz])", re.IGNORECASE)
SYMMETRIC = re.compile(r"(?:±|\+\s*/\s*-)\s*([\d.,]+)")
TWO_LIMITS = re.compile(r"([+-]?\s*[\d.,]+)\s*(?:/|;|\.\.\.|…|to|\s)\s*([+-]?\s*[\d.,]+)")
#: Columns that together make a key.
COMPOSED = {
    "parts": ("part1", "part2", "part3"),
    "direction": ("i", "j", "k"),
    "radius": ("diameter",),
    "lower": ("plus_minus", "width", "tolerance", "minus", "nominal"),
    "point": ("coordinates",),
}


class WrongRows:
    """Errors of the rows of a table; equal ones are reported once, with the numbers of their rows."""

    def __init__(self, path: Path):
        self.path = path
        self._rows: dict[tuple[str, str], dict[int, None]] = {}

    def add(self, row: int, column: str, text: str) -> None:
        """Add an error in a row, and a column unless that is empty."""
        self._rows.setdefault((column, text), {})[row] = None

    def raise_all(self) -> None:
        """Raise one :class:`SceneError` with a line for each distinct error, if there are any."""
        lines = []
        for (column, text), numbers in self._rows.items():
            first, *rest = numbers
            others = f"{', '.join(map(str, rest[:5]))}{', …' * (len(rest) > 5)}"
            more = f" (and in {len(rest)} more: {others})" if rest else ""
            lines.append(f"{self.path}: row {first}{column and f', column {column}'}: {text}{more}")
        if lines:
            raise SceneError("\n".join(lines))


def read_rows(
    path: Path,
    kind: type[BaseModel],
    folder: Path | None = None,
    settings: TableSettings | None = None,
    parts: PartNames | None = None,
) -> tuple[list[tuple[int, dict[str, Any]]], str]:
    """Rows of a table as tables of the scene, with their numbers in the file; how the columns were read, if unusual.

    Parameters
    ----------
    path : Path
    kind : type
        Schema of one row: its keys are the possible columns.
    folder : Path, optional
        As for :func:`mic.scene.table_file.open_table`.
    settings : TableSettings, optional
    parts : PartNames, optional

    Raises
    ------
    SceneError
        If the file is not a table, has no rows, or may be read in several ways.
    """
    fields = kind.model_fields
    keys = [*AXES, "unit", *(name for name in fields if name != "point")]
    keys += [name for key, names in COMPOSED.items() if key in fields for name in names]
    columns = Columns.of_file(keys)
    if "parts" in fields and "part" not in fields:
        columns = replace(
            columns, aliases={**columns.aliases, "parts": (*columns.aliases["parts"], *data()["columns"]["part"])}
        )
    table = open_table(path, columns, folder, settings)
    try:
        table.columns.refuse_misspelt(table.header)
        return _rows(_in_unit(table), kind, parts or PartNames({})), table.said
    except SceneError as problem:
        raise SceneError(f"{path}: {problem}") from None


def _in_unit(table: TableFile) -> TableFile:
    """The table with the unit that a column of units states; raises SceneError if it states several."""
    if "unit" not in table.key_of or table.settings.unit is not None:
        return table
    found = {unit[1]: text for text in table.texts("unit") if (unit := unit_of(text, "length"))}
    name = next((name for name in UNITS if unit_of(name, "length") == ("length", *found)), None)
    if len(found) > 1 or (found and name is None):
        raise SceneError(f"the rows are in {' and '.join(found.values())}: convert them to one unit, mm or in")
    return replace(table, settings=table.settings.model_copy(update={"unit": name})) if found else table


def _rows(table: TableFile, kind: type[BaseModel], parts: PartNames) -> list[tuple[int, dict[str, Any]]]:
    if not table.key_of:
        heads = ", ".join(map(repr, filter(None, table.header.headers)))
        known = ", ".join((*AXES, *(name for name in kind.model_fields if name != "point")))
        raise SceneError(
            f"row {table.header_row}: there is no known column among {heads}; columns are {known}; rename them, or "
            'name all columns in their order by a line in the scene, columns = ["name", "x", …]'
        )
    given = [axis for axis in AXES if axis in table.key_of]
    if given and len(given) < 3:
        missing = next(axis for axis in AXES if axis not in given)
        raise SceneError(
            f"row {table.header_row}: x, y and z belong together, and there is only {' and '.join(given)}; rename the "
            f'others, or name them by a line in the scene, columns = {{ {missing} = "…" }}'
        )
    if not table.rows:
        raise SceneError("there is no row below the header; add rows, or remove the table")
    if given and all(all(texts) for texts in zip(*map(table.texts, AXES))):  # other places are further information
        for key in ("coordinates", "node", "set"):
            table.key_of.pop(key, None)
    names = [table.key_of[key] for key in ("name",) if key in table.key_of] + table.header.others.get("name", [])
    if unique := [column for column in names if len({*table.texts(column), ""}) > len(table.rows)]:
        table.key_of["name"] = unique[0]
    limits = _limits(table) if "lower" in kind.model_fields else [{} for _ in table.rows]
    rows = []
    for i, (number, cells) in enumerate(table.rows):
        texts = {key: cells[column] for key, column in table.key_of.items() if cells[column]}
        rows.append((number, _row(table, kind, texts, parts) | limits[i]))
    return rows


def _row(table: TableFile, kind: type[BaseModel], texts: dict[str, str], parts: PartNames) -> dict[str, Any]:
    """The keys of a row; a cell that is no number where one is needed remains text, which the schema rejects."""

    def number(key: str, text: str) -> float | str:
        value = table.number(key, text)
        return text if np.isnan(value) else value

    row: dict[str, Any] = {}
    for key, text in texts.items():
        if key == "parts":
            row[key] = parts.split(text)
        elif key == "part":
            row[key] = parts.find(text) or text
        elif key == "name":
            row[key] = re.sub(r"[^A-Za-z0-9_.+-]+", "_", text) if re.search("[A-Za-z0-9]", text) else text
        elif key == "hole":
            row[key] = [number(key, word) for word in _members(text)]
        elif key == "direction":
            row[key] = _direction(table, text)
        elif key == "node":
            node = table.number(key, text)
            row[key] = int(node) if np.isfinite(node) and node == np.floor(node) else text
        elif key in kind.model_fields and _is_text(kind.model_fields[key].annotation):
            row[key] = text
        elif key in kind.model_fields and key not in ("lower", "upper"):
            row[key] = FLAGS.get(text.casefold(), number(key, text))
    joined = [parts.find(texts[key]) or texts[key] for key in COMPOSED["parts"] if key in texts]
    if joined and "parts" not in row:
        row["parts"] = joined
    if all(key in texts for key in COMPOSED["direction"]) and "direction" not in row:
        row["direction"] = [number(key, texts[key]) for key in COMPOSED["direction"]]
    if "diameter" in texts and "radius" not in row:
        value = number("diameter", texts["diameter"])
        row["radius"] = value if isinstance(value, str) else value / 2
    if any(axis in texts for axis in AXES):
        row["point"] = [number(axis, texts[axis]) if axis in texts else "" for axis in AXES]
    elif "coordinates" in texts:
        row["point"] = [number("coordinates", word) for word in _members(texts["coordinates"])]
    return row


def _members(text: str) -> list[str]:
    """The members of a list in one cell, separated by blanks, semicolons, or commas with blanks; or by two commas."""
    words = re.findall(r"[^\s;()\[\]]+", re.sub(r",\s", " ", text))
    return words[0].split(",") if len(words) == 1 and words[0].count(",") == 2 else words


def _direction(table: TableFile, text: str) -> list[float] | str:
    """Three numbers, an axis, or the text."""
    if axis := AXIS.fullmatch(text):
        return [(-1.0 if axis[1] == "-" else 1.0) if axis[2].lower() == name else 0.0 for name in AXES]
    numbers = [table.number("direction", word) for word in _members(text)]
    return text.lower() if np.isnan(numbers).any() else numbers


def _limits(table: TableFile) -> list[dict[str, Any]]:
    """Lower and upper limit of each row, mm from nominal.

    Raises
    ------
    SceneError
        If the column of a limit may be a magnitude or an absolute limit, or that of a tolerance half or all of it.
    """
    limits: list[dict[str, Any]] = [{} for _ in table.rows]
    for key, factors in (("plus_minus", (-1.0, 1.0)), ("width", (-0.5, 0.5)), ("minus", (-1.0,))):
        if key in table.key_of:
            for own, value in zip(limits, table.numbers(key)):
                own |= {
                    name: factor * value for name, factor in zip(("lower", "upper"), factors) if not np.isnan(value)
                }
    if "tolerance" in table.key_of:
        for own, text in zip(limits, table.texts("tolerance")):
            own |= _stated_limits(table, text)
    for key in ("lower", "upper"):
        if key in table.key_of:
            for own, value, text in zip(limits, table.numbers(key), table.texts(key)):
                own |= {key: text if np.isnan(value) else value} if text else {}
    both = [own for own in limits if isinstance(own.get("lower"), float) and isinstance(own.get("upper"), float)]
    if "lower" in table.key_of and both:
        _from_nominal(table, limits, both)
        _with_sign(table, both)
    return limits


def _stated_limits(table: TableFile, text: str) -> dict[str, float]:
    """Limits that a cell states with their signs, such as ``±0.5`` or ``+0.5/-0.3``."""
    if not text:
        return {}
    if symmetric := SYMMETRIC.fullmatch(text):
        value = table.number("tolerance", symmetric[1])
        return {"lower": -value, "upper": value}
    if two := TWO_LIMITS.fullmatch(text):
        values = [table.number("tolerance", re.sub(r"\s", "", one)) for one in two.groups()]
        if "-" in text or "+" in text:
            return {"lower": min(values), "upper": max(values)}
    head = table.header.headers[table.key_of["tolerance"]]
    raise SceneError(
        f'{head!r} is {text!r}, which may be ± or the whole width: {LINE}, columns = {{ plus_minus = "{head}" }} or '
        f'columns = {{ width = "{head}" }}'
    )


def _said_otherwise(table: TableFile, key: str) -> bool:
    """Whether the user named the column of a key."""
    return isinstance(table.settings.columns, dict) and key in table.settings.columns


def _from_nominal(table: TableFile, limits: list[dict[str, Any]], both: list[dict[str, Any]]) -> None:
    """Subtract the nominal values from limits that are absolute."""
    heads = {key: table.header.headers[table.key_of[key]] for key in ("lower", "upper") if key in table.key_of}
    if _said_otherwise(table, "lower") or any(
        squash(head) not in map(squash, data()["absolute"][key]) for key, head in heads.items()
    ):
        return
    around_zero = all(own["lower"] <= 0 <= own["upper"] for own in both)
    said = f'{LINE}, columns = {{ lower = "{heads["lower"]}" }}, if they are deviations from nominal'
    if "nominal" not in table.key_of:
        if not around_zero:
            raise SceneError(f"the limits in {heads['lower']!r} do not enclose 0: add a column Nominal, or {said}")
        return
    nominal = table.numbers("nominal")
    pairs = [(own, value) for own, value in zip(limits, nominal) if own in both and not np.isnan(value)]
    around_nominal = all(own["lower"] <= value <= own["upper"] for own, value in pairs)
    if around_nominal and not around_zero:
        for own, value in pairs:
            own.update(lower=own["lower"] - value, upper=own["upper"] - value)
    elif around_nominal == around_zero and any(value for _, value in pairs):
        raise SceneError(
            f"the limits in {heads['lower']!r} may be deviations or absolute: {said}; else remove the column "
            f"{table.header.headers[table.key_of['nominal']]!r} and give deviations"
        )


def _with_sign(table: TableFile, both: list[dict[str, Any]]) -> None:
    """Give a sign to lower limits that are magnitudes."""
    head = table.header.headers[table.key_of["lower"]]
    known = map(squash, data()["magnitudes"]["lower"])
    if _said_otherwise(table, "lower") or squash(head) not in known or any(own["lower"] < 0 for own in both):
        return
    if any(own["lower"] >= own["upper"] for own in both if own["lower"] > 0):  # with a sign there would be no room
        for own in both:
            own["lower"] = -own["lower"]
    elif any(own["lower"] > 0 for own in both):
        raise SceneError(
            f"{head!r} is positive, which may be the limit or its magnitude: {LINE}, "
            f'columns = {{ minus = "{head}" }} for the magnitude, or columns = {{ lower = "{head}" }}'
        )


def _is_text(annotation: Any) -> bool:
    return annotation is str or any(map(_is_text, get_args(annotation)))
