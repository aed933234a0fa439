"""Reads the cells of Excel workbooks (``.xlsx``, ``.xlsm``): zipped XML, of which values alone are used."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree
from zipfile import BadZipFile, ZipFile

from mic.errors import SceneError

__all__ = ["StoredNumber", "is_workbook", "read_workbook"]

LARGEST = 200_000_000  # bytes of one file of the workbook, unpacked
MOST_ROWS, MOST_COLUMNS = 1_048_576, 16_384  # of a sheet, by the format
REFERENCE = re.compile(r"([A-Z]{1,3})([1-9]\d{0,6})")


class StoredNumber(str):
    """A number as Excel stores it: with a decimal point, whatever the language of the sheet."""


def is_workbook(content: bytes) -> bool:
    """Whether the content of a file begins as a workbook does."""
    return content.startswith(b"PK\x03\x04")


def read_workbook(path: Path) -> dict[str, list[tuple[int, list[str]]]]:
    """Rows of each sheet by its name: number in the sheet, and cells as text; numbers are :class:`StoredNumber`.

    Raises
    ------
    SceneError
        If the file is no workbook.
    """
    try:
        with ZipFile(path) as archive:
            return _sheets(archive)
    except (BadZipFile, KeyError, ElementTree.ParseError, NotImplementedError, IndexError) as problem:
        raise SceneError(
            f"it is no Excel workbook, or a damaged one ({' '.join(str(problem).split())}); save it again as .xlsx"
        ) from None


def _sheets(archive: ZipFile) -> dict[str, list[tuple[int, list[str]]]]:
    names = set(archive.namelist())
    relations = {node.get("Id"): str(node.get("Target")) for node in _xml(archive, "xl/_rels/workbook.xml.rels").iter()}
    shared: list[str] = []
    if "xl/sharedStrings.xml" in names:
        shared = [_text(item) for item in _children(_xml(archive, "xl/sharedStrings.xml"), "si")]
    sheets = {}
    for node in _xml(archive, "xl/workbook.xml").iter():
        if _tag(node) != "sheet":
            continue
        target = next((relations.get(value) for key, value in node.items() if key.endswith("}id")), None)
        if target is None:
            continue
        place = target.lstrip("/") if target.startswith("/") else str(PurePosixPath("xl") / target)
        if place in names and "worksheets" in place:  # a chart sheet has no cells
            sheets[str(node.get("name"))] = list(_rows(_xml(archive, place), shared))
    return sheets


def _rows(sheet: ElementTree.Element, shared: list[str]) -> Iterator[tuple[int, list[str]]]:
    number = 0
    for row in (node for node in sheet.iter() if _tag(node) == "row"):
        number = int(row.get("r") or number + 1)
        cells: dict[int, str] = {}
        for cell in _children(row, "c"):
            place = REFERENCE.fullmatch(cell.get("r") or "")
            column = _column(place[1]) if place else len(cells)
            if not (0 < number <= MOST_ROWS and column < MOST_COLUMNS):
                raise SceneError(
                    f"its sheet has a cell {cell.get('r')}, which no sheet can have; save it again as .xlsx"
                )
            text = _value(cell, shared)
            if text:
                cells[column] = text
        yield number, [cells.get(i, "") for i in range(max(cells, default=-1) + 1)]


def _column(letters: str) -> int:
    number = 0
    for letter in letters:
        number = 26 * number + ord(letter) - ord("A") + 1
    return number - 1


def _value(cell: ElementTree.Element, shared: list[str]) -> str:
    kind, value = cell.get("t", "n"), next(_children(cell, "v"), None)
    if kind == "inlineStr":
        return "".join(_text(item) for item in _children(cell, "is"))
    text = "" if value is None else (value.text or "")
    if kind == "s":
        return shared[int(text)] if text else ""
    if kind == "b":
        return {"1": "true", "0": "false"}.get(text, text)
    return StoredNumber(text.strip()) if kind == "n" else text


def _xml(archive: ZipFile, name: str) -> ElementTree.Element:
    with archive.open(name) as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise SceneError(f"its {name} has more than {LARGEST / 1e6:.0f} MB; save the table alone as .xlsx")
    if b"<!DOCTYPE" in content:
        raise SceneError(f"its {name} declares a document type, which Excel never writes; save it again as .xlsx")
    return ElementTree.fromstring(content)


def _text(item: ElementTree.Element) -> str:
    """The text of a string, without the readings that Japanese text carries beside it."""
    if _tag(item) == "rPh":
        return ""
    return (item.text or "" if _tag(item) == "t" else "") + "".join(map(_text, item))


def _children(node: ElementTree.Element, tag: str) -> Iterator[ElementTree.Element]:
    return (child for child in node if _tag(child) == tag)


def _tag(node: ElementTree.Element) -> str:
    return node.tag.rpartition("}")[2]
