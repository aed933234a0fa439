"""Tables of a scene that stand for several items: rows of a CSV file, or a weld at each of several points.

A table with ``file`` stands for one item per row of that file. Its other keys apply to every row; columns are keys and
override them. ``x``, ``y`` and ``z`` together are ``point``; members of a list are separated by
spaces in one cell; an empty cell omits the key.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import Any, get_args

import pandas as pd
from pydantic import BaseModel, ValidationError

from mic.errors import SceneError
from mic.scene.stages import unknown
from mic.system.foreign_files import reading

__all__ = ["read_cells", "read_number", "read_rows", "expand_tables"]

AXES = ("x", "y", "z")
#: A decimal comma.
DECIMAL = re.compile(r"(?<=\d),(?=\d)")


def expand_tables(table: Any, kinds: Mapping[str, type[BaseModel]]) -> Any:
    """A scene's table with one table per item; malformed tables are left to the schema.

    Parameters
    ----------
    table : dict
        With ``folder``, to which file names are relative.
    kinds : mapping of str to type
        The tables that may stand for several items, and their schemas.

    Raises
    ------
    SceneError
        One line for each wrong cell, with file, row and column; for an empty list of points.
    """
    if not isinstance(table, dict):
        return table
    names = {
        item["name"]
        for key in ("parts", "fixtures")
        for item in (table[key] if isinstance(table.get(key), list) else [])
        if isinstance(item, dict) and isinstance(item.get("name"), str)
    }
    problems: list[str] = []
    changed: dict[str, list[Any]] = {}
    for key, kind in kinds.items():
        if not isinstance(table.get(key), list):
            continue
        changed[key] = []
        for i, item in enumerate(table[key]):
            if isinstance(item, dict) and "file" in item:
                location = f"{key}[{i}].file"
                changed[key] += _from_file(location, item, kind, Path(table.get("folder") or "."), names, problems)
            elif isinstance(item, dict) and key == "welds" and isinstance(item.get("points"), list):
                changed[key] += _from_points(f"{key}[{i}]", item, problems)
            else:
                changed[key].append(item)
    if problems:
        raise SceneError("\n".join(problems))
    return table | changed


def _from_points(key, item: dict[str, Any], problems) -> Iterator[dict[str, Any]]:
    """One weld per point, numbered from 1."""
    if "point" in item:
        problems.append(f"{key}: give either point, for one weld, or points, for one weld at each, not both")
    if not item["points"]:
        problems.append(f"{key}.points: the list is empty; give at least one point, or remove the weld")
    rest = {key: value for key, value in item.items() if key != "points"}
    for number, point in enumerate(item["points"], 1):
        yield rest | {"point": point} | ({"name": f"{rest['name']}-{number}"} if "name" in rest else {})


def _from_file(key, item, kind, folder, names, problems) -> list[dict[str, Any]]:
    """The items of a file's rows, checked one by one; errors are added to `problems`."""
    common = {name: value for name, value in item.items() if name != "file"}
    if not isinstance(item["file"], str):
        problems.append(f"{key}: give the name of a CSV file")
        return []
    path = folder / item["file"]
    try:
        rows = read_rows(path, kind, folder)
    except SceneError as error:
        problems.append(f"{key}: {error}")
        return []
    stem = common.get("name") or path.stem
    items = []
    for count, (number, row) in enumerate(rows, 1):
        merged = {"name": f"{stem}-{count}"} | {k: v for k, v in common.items() if k != "name"} | row
        if {"node", "set", "hole"} & row.keys():
            merged = {name: value for name, value in merged.items() if name != "point" or name in row}
        items.append(merged)
        for wrong in _errors(kind, merged):
            column, text = _column(wrong["loc"]), wrong["msg"].removeprefix("Value error, ")
            if text == "Field required":
                text = "is required; fill it in"
            elif column:
                text += f"; got {wrong['input']!r}, correct it"
            problems.append(f"{path}: row {number}{column and f', column {column}'}: {text}")
        for column in ("part", "parts"):
            given = row.get(column) or []
            for name in [given] if isinstance(given, str) else given:
                problems += unknown(f"{path}: row {number}, column {column}", name, names, "part")
    return items


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


def read_cells(path: Path, folder: Path | None = None) -> tuple[pd.DataFrame, str]:
    """The cells of a CSV file as text, with its first row as column names, and the separator.

    Row i of the frame is row i + 2 of the file, empty rows included. `folder` is that of the scene that names the file,
    see :func:`mic.system.foreign_files.reading`.

    Raises
    ------
    SceneError
        If the file is not a table, or repeats a column.
    """
    with reading(path, "table", folder, SceneError):
        return _cells(path)


def _cells(path: Path) -> tuple[pd.DataFrame, str]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"cannot be read as text ({error}); save it as CSV in UTF-8") from None
    header = text.partition("\n")[0]
    separator = max(",;\t", key=header.count)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # pandas would drop surplus cells
            frame = pd.read_csv(
                StringIO(text),
                sep=separator,
                header=None,  # pandas would rename repeated columns
                dtype=str,
                keep_default_na=False,
                skipinitialspace=True,
                skip_blank_lines=False,
                index_col=False,
            ).fillna("")
    except (ValueError, pd.errors.ParserError, pd.errors.ParserWarning) as error:
        raise SceneError(
            f"not a table: {' '.join(str(error).split())}; give each row the same number of cells"
        ) from None
    columns = frame.iloc[0].str.strip()
    repeated = columns[columns.duplicated()]
    if len(repeated):
        raise SceneError(f"row 1: column {repeated.iloc[0]!r} is given twice; remove one of them")
    frame = frame.iloc[1:].reset_index(drop=True)
    frame.columns = pd.Index(columns)
    return frame, separator


def read_number(cell: str, separator: str = ",") -> float:
    """The number in a cell, else NaN; unless commas separate the cells, they may be decimal commas."""
    try:
        return float(cell if separator == "," else DECIMAL.sub(".", cell)) if "_" not in cell else float("nan")
    except ValueError:
        return float("nan")


def read_rows(path: Path, kind: type[BaseModel], folder: Path | None = None) -> list[tuple[int, dict[str, Any]]]:
    """Rows of a CSV file as tables of the scene, with their numbers in the file; the header is row 1.

    Commas, semicolons or tabs separate the cells; with the latter two, numbers may have a decimal comma.

    Parameters
    ----------
    path : Path
    kind : type
        Schema of one row: its keys are the possible columns.
    folder : Path, optional
        As for :func:`read_cells`.

    Raises
    ------
    SceneError
        If the file is not a table, or has other columns.
    """
    frame, separator = read_cells(path, folder)
    known = [name for name in kind.model_fields if name != "point"]
    unknown = [name for name in frame.columns if name not in (*known, *AXES)]
    if unknown:
        raise SceneError(
            f"{path}: row 1: there is no column {unknown[0]!r}; columns are {', '.join((*AXES, *known))}, "
            "separated by commas, semicolons or tabs"
        )
    given = [axis for axis in AXES if axis in frame.columns]
    if given and len(given) < 3:
        raise SceneError(
            f"{path}: row 1: x, y and z belong together, and there is only {' and '.join(given)}; give all three"
        )
    rows = []
    for number, record in enumerate(frame.to_dict("records"), 2):
        cells = {str(column): text for column, cell in record.items() if (text := str(cell).strip())}
        if cells:
            rows.append((number, _row(cells, kind, separator)))
    if not rows:
        raise SceneError(f"{path}: there is no row below the header; add rows, or remove the table")
    return rows


def _row(cells: dict[str, str], kind: type[BaseModel], separator: str) -> dict[str, Any]:
    """The keys of a row; unless commas separate the cells, numbers may have decimal commas."""
    number = lambda text: _number(text if separator == "," else DECIMAL.sub(".", text))
    row: dict[str, Any] = {}
    for column, cell in cells.items():
        words = [number(word) for word in cell.split()]
        if column == "parts":
            row[column] = cell.split()
        elif column == "hole" or column == "direction" and not any(isinstance(word, str) for word in words):
            row[column] = words
        elif column == "direction" or column not in AXES and _is_text(kind.model_fields[column].annotation):
            row[column] = cell
        elif column not in AXES:  # a text if it cannot be converted, which the schema rejects
            row[column] = {"true": True, "false": False}.get(cell.lower(), number(cell))
    if any(axis in cells for axis in AXES):
        row["point"] = [number(cells.get(axis, "")) for axis in AXES]
    return row


def _number(cell: str) -> Any:
    """The number in a cell; the cell if it holds none."""
    for read in (int, float):
        try:
            return read(cell)
        except ValueError:
            continue
    return cell


def _is_text(annotation: Any) -> bool:
    return annotation is str or any(map(_is_text, get_args(annotation)))
