"""Tables of a scene that stand for several items: rows of a file, or a weld at each of several points.

A table with ``file`` stands for one item per row of that file (:mod:`mic.scene.table_rows`). Its other keys apply to
every row; columns override them; an empty cell omits the key.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from mic.errors import Problems, SceneError
from mic.scene.fixture import Locator
from mic.scene.part_names import PartNames, other_names
from mic.scene.table_file import TableSettings
from mic.scene.table_rows import AXES, WrongRows, read_rows

__all__ = ["expand_tables"]

#: Directions that a hole or face locks, such as ``xz``, or ``hxyfz`` of a reference point system.
SEVERAL_AXES = re.compile(r"(?:[fht]?[xyz]+)+")


def expand_tables(table: Any, kinds: Mapping[str, type[BaseModel]]) -> Any:
    """A scene's table with one table per item; malformed tables are left to the schema.

    Parts may be named by their mesh files, element sets or property numbers, in any case.

    Parameters
    ----------
    table : dict
        With ``folder``, to which file names are relative. How the columns of files were read is added as
        ``tables_read``, where that is not obvious.
    kinds : mapping of str to type
        The tables that may stand for several items, and their schemas.

    Raises
    ------
    SceneError
        One line for each wrong cell, with file, row and column, equal ones together; for an empty list of points.
    """
    if not isinstance(table, dict):
        return table
    parts = PartNames(
        {
            item["name"]: other_names(item)
            for key in ("parts", "fixtures")
            for item in (table[key] if isinstance(table.get(key), list) else [])
            if isinstance(item, dict) and isinstance(item.get("name"), str)
        }
    )
    problems = Problems()
    said: list[str] = []
    changed: dict[str, list[Any]] = {}
    for key, kind in kinds.items():
        if not isinstance(table.get(key), list):
            continue
        changed[key] = []
        for i, item in enumerate(table[key]):
            if isinstance(item, dict) and "file" in item:
                location = f"{key}[{i}].file"
                folder = Path(table.get("folder") or ".")
                with problems:
                    changed[key] += _from_file(location, item, kind, folder, parts, said)
            elif (
                isinstance(item, dict)
                and isinstance(item.get("points"), list)
                and (key == "welds" or item.get("kind") in getattr(kind, "BETWEEN", ()))
            ):
                changed[key] += _from_points(f"{key}[{i}]", item, problems.lines)
            else:
                changed[key].append(item)
    for key, items in (table | changed).items():
        if key != "parts" and isinstance(items, list):
            changed[key] = [_with_parts(item, parts) if isinstance(item, dict) else item for item in items]
    problems.raise_all()
    return table | changed | ({"tables_read": said} if said else {})


def _with_parts(item: dict[str, Any], parts: PartNames) -> dict[str, Any]:
    """An item with the names of its parts in place of others by which they are known."""
    part, several = item.get("part"), item.get("parts")
    if isinstance(part, str):
        item = item | {"part": parts.find(part) or part}
    if isinstance(several, list):
        item = item | {"parts": [parts.find(name) or name if isinstance(name, str) else name for name in several]}
    if isinstance(item.get("to"), dict):
        item = item | {"to": _with_parts(item["to"], parts)}
    if isinstance(points := item.get("points"), list):
        item = item | {"points": [_with_parts(point, parts) if isinstance(point, dict) else point for point in points]}
    return item


def _from_points(key, item: dict[str, Any], problems) -> Iterator[dict[str, Any]]:
    """One weld or measurement per point, numbered from 1."""
    what = key.partition("[")[0].removesuffix("s")
    if "point" in item:
        problems.append(f"{key}: give either point, for one {what}, or points, for one {what} at each, not both")
    if not item["points"]:
        problems.append(f"{key}.points: the list is empty; give at least one point, or remove the {what}")
    rest = {key: value for key, value in item.items() if key != "points"}
    for number, point in enumerate(item["points"], 1):
        yield rest | {"point": point} | ({"name": f"{rest['name']}-{number}"} if "name" in rest else {})


def _from_file(key, item, kind, folder: Path, parts: PartNames, said: list[str]) -> list[dict[str, Any]]:
    """The items of a file's rows, checked one by one; raises SceneError with one line for each distinct error."""
    if not isinstance(item["file"], str):
        raise SceneError(f"{key}: give the name of a table, CSV or Excel")
    path, fields = folder / item["file"], TableSettings.model_fields
    try:
        settings = TableSettings(**{name: item[name] for name in fields if name in item})
    except ValidationError as error:
        first = error.errors()[0]
        raise SceneError(
            f"{key.removesuffix('file')}{first['loc'][0]}: {first['msg']}; got {first['input']!r}"
        ) from None
    try:
        rows, read = read_rows(path, kind, folder, settings, parts)
    except SceneError as error:
        raise SceneError("\n".join(f"{key}: {line}" for line in str(error).splitlines())) from None
    said += [f"{item['file']}: {read}"] * bool(read)
    common = {name: value for name, value in item.items() if name not in ("file", "name", *fields)}
    stem = item.get("name") or re.sub(r"[^A-Za-z0-9_.+-]+", "_", path.stem)
    items, wrong = [], WrongRows(path)
    for count, (number, row) in enumerate(rows, 1):
        merged = {"name": f"{stem}-{count}"} | common | row
        if {"node", "set", "hole"} & row.keys():
            merged = {name: value for name, value in merged.items() if name != "point" or name in row}
        for one in _single_items(merged, kind):
            items.append(one)
            for column, text in _row_errors(kind, one, row, parts):
                wrong.add(number, column, text)
    wrong.raise_all()
    return items


def _single_items(item: dict[str, Any], kind: type[BaseModel]) -> list[dict[str, Any]]:
    """The items of a row: welds of neighbours in a stack of three or more parts; a locator for each of several axes."""
    parts, direction = item.get("parts"), item.get("direction")
    if isinstance(parts, list) and len(parts) > 2:
        pairs = zip("abcdefgh", pairwise(parts))
        return [item | {"name": f"{item['name']}{letter}", "parts": [*pair]} for letter, pair in pairs]
    if kind is Locator and isinstance(direction, str) and SEVERAL_AXES.fullmatch(direction):
        axes = dict.fromkeys(re.findall("[xyz]", direction))
        return [
            item | {"name": f"{item['name']}-{axis}", "direction": [float(axis == other) for other in AXES]}
            for axis in axes
        ]
    return [item]


def _row_errors(kind, item: dict[str, Any], row: dict[str, Any], parts: PartNames) -> Iterator[tuple[str, str]]:
    """Column and text of each error of a row."""
    unknown = set()
    for column in ("part", "parts"):
        given = row.get(column) or []
        for name in [given] if isinstance(given, str) else given:
            if name not in parts.names:
                unknown.add(column)
                yield column, parts.unknown(name)
    for wrong in _errors(kind, item):
        column, text = _column(wrong["loc"]), wrong["msg"].removeprefix("Value error, ")
        if text == "Field required":
            text = "is required; fill it in"
        elif column:
            text += f"; got {wrong['input']!r}, correct it"
        if column not in unknown:
            yield column, text


def _errors(kind: type[BaseModel], row: dict[str, Any]) -> list[Any]:
    try:
        kind(**row)
    except ValidationError as error:
        return list(error.errors())
    return []


def _column(location: tuple[Any, ...]) -> str:
    """The column of an error's location."""
    if not location:
        return ""
    if location[0] == "point" and len(location) > 1 and isinstance(location[1], int):
        return AXES[location[1]]
    return str(location[0])
