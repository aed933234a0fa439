"""Tables of a scene that stand for many: rows of a CSV file, or a weld at each of several points.

A table with ``file`` stands for one item a row of that file. Its other keys hold for every row; the columns are keys,
and what a row says comes first. ``x``, ``y`` and ``z`` together are ``point``; members of a list stand in one cell with
blanks between them; an empty cell leaves the key to the table, or to its default.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import pandas as pd
from pydantic import BaseModel, ValidationError

from mic.errors import SceneError

__all__ = ["DECIMAL", "read_cells", "read_number", "read_rows", "written_out"]

AXES = ("x", "y", "z")
#: A comma that stands for the point of a number.
DECIMAL = re.compile(r"(?<=\d),(?=\d)")


def written_out(table: Any, kinds: Mapping[str, type[BaseModel]]) -> Any:
    """A scene's table with every item by itself; malformed tables are left to the schema.

    Parameters
    ----------
    table : dict
        With ``folder``, which file names are relative to.
    kinds : mapping of str to type
        The tables that may stand for many, and their schema.

    Raises
    ------
    SceneError
        A line for each cell that is wrong, with file, row and column; for a weld without any point.
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
        items = table.get(key)
        if not isinstance(items, list) or not any(isinstance(item, dict) and _stands_for(key, item) for item in items):
            continue
        changed[key] = []
        for i, item in enumerate(items):
            what = _stands_for(key, item) if isinstance(item, dict) else None
            if what == "file":
                own = f"{key}[{i}].file"
                changed[key] += _from_file(own, item, kind, Path(table.get("folder") or "."), names, problems)
            elif what == "points":
                changed[key] += _from_points(f"{key}[{i}]", item, problems)
            else:
                changed[key].append(item)
    if problems:
        raise SceneError("\n".join(problems))
    return table | changed if changed else table


def _stands_for(key: str, item: dict[str, Any]) -> str | None:
    if "file" in item:
        return "file"
    return "points" if key == "welds" and isinstance(item.get("points"), list) else None


def _from_points(key, item: dict[str, Any], problems) -> Iterator[dict[str, Any]]:
    """A weld at each point, numbered from 1."""
    if "point" in item:
        problems.append(f"{key}: give either point, of one weld, or points, of one weld at each, not both")
    if not item["points"]:
        problems.append(f"{key}.points: there is no point in it; give one at least, or remove the weld")
    rest = {key: value for key, value in item.items() if key != "points"}
    for number, point in enumerate(item["points"], 1):
        yield rest | {"point": point} | ({"name": f"{rest['name']}-{number}"} if "name" in rest else {})


def _from_file(key, item, kind, folder, names, problems) -> list[dict[str, Any]]:
    """The items of a file's rows, checked one by one; what is wrong is added to `problems`."""
    common = {name: value for name, value in item.items() if name != "file"}
    if not isinstance(item["file"], str):
        problems.append(f"{key}: give the name of a CSV file")
        return []
    path = folder / item["file"]
    try:
        rows = read_rows(path, kind)
    except SceneError as error:
        problems.append(f"{key}: {error}")
        return []
    stem = common.get("name") or path.stem
    found = []
    for count, (number, row) in enumerate(rows, 1):
        whole = {"name": f"{stem}-{count}"} | {k: v for k, v in common.items() if k != "name"} | row
        if {"node", "set", "hole"} & row.keys():
            whole = {name: value for name, value in whole.items() if name != "point" or name in row}
        found.append(whole)
        told = [(_column(error["loc"], whole), error["msg"], error["input"]) for error in _errors(kind, whole)]
        for column, message, given in told:
            text = message.removeprefix("Value error, ")
            what = f", column {column}" if column else ""
            got = f"; got {given!r}, correct it" if column and "Field required" not in text else ""
            text = "is required; fill it in" if text == "Field required" else text
            problems.append(f"{path}: row {number}{what}: {text}{got}")
        for column in ("part", "parts"):
            told_names = whole.get(column) or []
            for name in [told_names] if isinstance(told_names, str) else told_names:
                if name not in names and column in row:
                    known = ", ".join(sorted(names))
                    problems.append(f"{path}: row {number}, column {column}: there is no part {name!r}; known: {known}")
    return found


def _errors(kind: type[BaseModel], row: dict[str, Any]) -> list[Any]:
    try:
        kind(**row)
    except ValidationError as error:
        return list(error.errors())
    return []


def _column(location: tuple[Any, ...], row: dict[str, Any]) -> str:
    """The column of an error's location."""
    if not location:
        return ""
    if location[0] == "point" and len(location) > 1 and isinstance(location[1], int):
        return AXES[location[1]]
    return str(location[0])


def read_cells(path: Path, beside: str = "the scene file") -> tuple[pd.DataFrame, str]:
    """The cells of a CSV file as text, its first row their columns, and what separates them.

    Row i of the frame is row i + 2 of the file, empty ones included. Its name is relative to what it stands beside.

    Raises
    ------
    SceneError
        If the file cannot be read as a table, or names a column twice.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise SceneError(f"there is no file {path}; correct the name (it is relative to {beside})") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read as text ({error}); save it as CSV in UTF-8") from None
    header = text.partition("\n")[0]
    separator = max(",;\t", key=header.count)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # cells too many are no warning, but lost
            frame = pd.read_csv(
                path,
                sep=separator,
                header=None,  # for pandas gives columns of one name others
                dtype=str,
                keep_default_na=False,
                skipinitialspace=True,
                skip_blank_lines=False,
                encoding="utf-8-sig",
                index_col=False,
            ).fillna("")
    except (ValueError, pd.errors.ParserError, pd.errors.ParserWarning) as error:
        raise SceneError(
            f"{path}: this is no table: {' '.join(str(error).split())}; give each row as many cells"
        ) from None
    columns = frame.iloc[0].str.strip()
    twice = columns[columns.duplicated()]
    if len(twice):
        raise SceneError(f"{path}: row 1: column {twice.iloc[0]!r} stands there twice; remove one of them")
    frame = frame.iloc[1:].reset_index(drop=True)
    frame.columns = pd.Index(columns)
    return frame, separator


def read_number(cell: str, separator: str = ",") -> float:
    """A cell's number, exactly as it was written; NaN for what is none. Where commas do not separate the cells they may
    stand for the point."""
    try:
        return float(cell if separator == "," else DECIMAL.sub(".", cell)) if "_" not in cell else float("nan")
    except ValueError:
        return float("nan")


def read_rows(path: Path, kind: type[BaseModel]) -> list[tuple[int, dict[str, Any]]]:
    """Rows of a CSV file as a table of the scene has them, by their number in the file; the header is row 1.

    Commas, semicolons or tabs separate the cells; where commas do not, numbers may have a decimal comma.

    Parameters
    ----------
    path : Path
    kind : type
        Schema of one row: its keys are the columns that there may be.

    Raises
    ------
    SceneError
        If the file cannot be read as a table, or has other columns.
    """
    frame, separator = read_cells(path)
    known = [name for name in kind.model_fields if name != "point"]
    strange = [name for name in frame.columns if name not in (*known, *AXES)]
    if strange:
        raise SceneError(
            f"{path}: row 1: there is no column {strange[0]!r}; columns are {', '.join((*AXES, *known))}, "
            "which cells are separated by a comma, a semicolon or a tab"
        )
    given = [axis for axis in AXES if axis in frame.columns]
    if given and len(given) < 3:
        raise SceneError(f"{path}: row 1: of x, y and z there is only {' and '.join(given)}; give all three")
    rows = []
    for number, record in enumerate(frame.to_dict("records"), 2):
        cells = {str(column): str(cell).strip() for column, cell in record.items()}
        if separator != ",":
            cells = {column: _with_points(cell, kind, column) for column, cell in cells.items()}
        if any(cells.values()):
            rows.append((number, _row(cells, kind)))
    if not rows:
        raise SceneError(f"{path}: there is no row below the header; fill it in, or take the table out")
    return rows


def _row(cells: dict[str, str], kind: type[BaseModel]) -> dict[str, Any]:
    told = {column: cell for column, cell in cells.items() if cell}
    row = {column: _value(cell, kind, column) for column, cell in told.items() if column not in AXES}
    if any(axis in told for axis in AXES):
        row["point"] = [_number(told.get(axis, "")) for axis in AXES]
    return row


def _value(cell: str, kind: type[BaseModel], column: str) -> Any:
    """A cell as its key takes it; what it cannot be is left as text, which the schema then refuses."""
    if column == "parts":
        return cell.split()
    if column in ("direction", "hole"):
        words = [_number(word) for word in cell.split()]
        return cell if column == "direction" and any(isinstance(word, str) for word in words) else words
    if _is_text(kind.model_fields[column].annotation):
        return cell
    return {"true": True, "false": False}.get(cell.lower(), _number(cell))


def _with_points(cell: str, kind: type[BaseModel], column: str) -> str:
    """A cell with points in its numbers, where commas do not separate the cells and may stand for them."""
    text = column not in AXES and column != "direction" and _is_text(kind.model_fields[column].annotation)
    return cell if text else DECIMAL.sub(".", cell)


def _number(cell: str) -> Any:
    for read in (int, float):
        try:
            return read(cell)
        except ValueError:
            continue
    return cell


def _is_text(annotation: Any) -> bool:
    inner = get_args(annotation)
    return annotation is str or any(_is_text(one) for one in inner)
