"""Reads tables as people have them: text with any separator and either decimal mark, or Excel.

The header is the row in which most columns are recognised; titles above it, comments and blank rows are skipped. A
number that could mean two things ("1,250" is 1.25 or 1250) is decided by the other numbers of its column, else of the
table; if these do not decide, the reader asks for a line in the scene.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from mic.errors import SceneError
from mic.scene.excel_file import StoredNumber, is_workbook, read_workbook
from mic.scene.keys import LengthUnit, Table
from mic.scene.table_columns import Columns, Header, quantity_of, unit_of
from mic.system.foreign_files import reading

__all__ = ["TableFile", "TableSettings", "open_table", "parse_table"]

Rows = list[tuple[int, list[str]]]  # number of each row in the file, and its cells

SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}
WIDE, BLANK = "  ", " "  # two blanks or more, any blanks
COMMENT = re.compile(r"#(?!\d*$)|//|%|\$|!")
JUDGED = 1000  # lines by which the separator is chosen
ABOVE = 60  # rows in which the header is sought
OLD_EXCEL = b"\xd0\xcf\x11\xe0"
TITLED_UNIT = re.compile(r"\b(?:units?|einheit(?:en)?|dimensions?)\b(?:\W+(?:are|sind|in))*\W+(\w+)", re.IGNORECASE)
SPELT = re.compile(r"\b(?:inch(?:es)?|zoll|met(?:er|re)s?)\b", re.IGNORECASE)
WITH_UNIT = re.compile(r"(.*\d[.,]?)\s*([^\d\s.,]+)")
LOCAL = (";", "\t", "")  # separators of spreadsheets, which write numbers as their country does; none in a workbook
RULE = re.compile(r"[-=_:+]{3,}")  # between the header and the rows
CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")
SPACE = re.compile(r"[\s\ufeff]")
LINE = "say which by a line in the scene"
DIGITS = r"\d[\d.,'’\u00a0\u2009\u202f ]*|[.,]\d+"
NUMBER = re.compile(rf"([+-]?)({DIGITS})([eE][+-]?\d+)?")
GROUPED = re.compile(r"[1-9]\d{0,2}(?:([.,'’\u00a0\u2009\u202f ])\d{3})(?:\1\d{3})*")


class TableSettings(Table):
    """Keys of a table beside `file`, for files that can be read in more than one way."""

    columns: dict[str, str] | Annotated[list[str], Field(min_length=1)] | None = None
    """headers by key, `{ x = "Nominal X" }`; or all keys in their order, of a file without headers"""

    unit: LengthUnit | None = None
    """of lengths whose header names none; default: mm"""

    decimal: Literal[".", ","] | None = None
    """decimal mark, if the numbers do not show it"""

    sheet: str | None = None
    """of a workbook with several tables"""


@dataclass(frozen=True)
class TableFile:
    """A table.

    Attributes
    ----------
    columns : Columns
        That it may have.
    header : Header
        Which column holds which key.
    rows : list of (int, list of str)
        The number of each row in its file, and its cells, as many as there are columns.
    header_row : int
        Row of the header in the file, 0 if it has none.
    settings : TableSettings
    separator : str
    notes : tuple of str
        What was ignored besides columns.
    """

    columns: Columns
    header: Header
    rows: Rows
    header_row: int
    settings: TableSettings
    separator: str
    notes: tuple[str, ...] = ()

    @property
    def said(self) -> str:
        """The key of each column, and the ignored columns; empty if the headers are the keys and all are used."""
        return self.header.said(self.notes)

    @property
    def key_of(self) -> dict[str, int]:
        """The column of each key."""
        return self.header.key_of

    def texts(self, key: str | int) -> list[str]:
        """The cells of a column, given by its key or number."""
        column = key if isinstance(key, int) else self.key_of[key]
        return [cells[column] for _, cells in self.rows]

    def numbers(self, key: str | int) -> list[float]:
        """The numbers of a column, given by its key or number, lengths in mm; NaN where a cell holds none.

        Raises
        ------
        SceneError
            If the decimal mark or the unit is not certain.
        """
        texts = self.texts(key)
        if self.decimal_mark and self.factor(key) == 1:  # many points
            values = [_float(text.replace(self.decimal_mark, ".")) for text in texts]
            if all(value == value or not text for value, text in zip(values, texts)):
                return values
        return [self.number(key, text) for text in texts]

    @cached_property
    def decimal_mark(self) -> str | None:
        """The decimal mark of all numbers, if each shows it at most once and none the other mark; None if not."""
        texts = {self.key_of[key] for key in self.columns.texts & self.key_of.keys()}
        cells = [cell for _, row in self.rows for i, cell in enumerate(row) if i not in texts]
        other, own = (".", ",") if any("," in cell for cell in cells) else (",", ".")
        if any(other in cell or cell.count(own) > 1 or "_" in cell for cell in cells):
            return None
        given = self.settings.decimal or ("." if own == "." and self.separator not in LOCAL else None)
        return own if given == own or not given and any(_marks(cell) == (own, "", True) for cell in cells) else None

    def number(self, key: str | int, text: str) -> float:
        """The number in a cell of a column, as :meth:`numbers`."""
        column = key if isinstance(key, int) else self.key_of[key]
        quantity = None if isinstance(key, int) else quantity_of(key)
        unit = WITH_UNIT.fullmatch(text) if quantity else None
        if unit and (own := unit_of(unit[2], quantity)):
            text, factor = unit[1], own[1]
        else:
            factor = self.factor(key)
        value = _value(text, self._decimal(column, text))
        return value if factor == 1 else value * factor

    def factor(self, key: str | int) -> float:
        """The unit of a column in mm, N or N/mm; 1 for columns without a key.

        Raises
        ------
        SceneError
            If the unit is not certain.
        """
        if isinstance(key, int):
            return 1.0
        factor = self.header.factor[key]
        if key not in self.header.unitless or quantity_of(key) != "length":
            return factor
        if (given := unit_of(self.settings.unit or "", "length")) is not None:
            return given[1]
        others = [
            other for other in self.key_of if quantity_of(other) == "length" and other not in self.header.unitless
        ]
        if {self.header.factor[other] for other in others} - {1.0}:
            raise SceneError(
                f"column {self.header.headers[self.key_of[key]]!r} names no unit, and others are not in mm: {LINE}, "
                'unit = "mm" or unit = "in"'
            )
        return factor

    @cached_property
    def _evidence(self) -> list[tuple[set[str], set[str]]]:
        """Certain decimal marks, and marks that group thousands: of each column, and last of the table."""
        texts = {self.key_of[key] for key in self.columns.texts & self.key_of.keys()}
        found: list[tuple[set[str], set[str]]] = [(set(), set()) for _ in (*self.header.headers, "table")]
        for column in range(len(self.header.headers)):
            for word in (word for text in self.texts(column) for word in _words(text) if column not in texts):
                decimal, group, certain = _marks(word)
                for own in (found[column], found[-1]):
                    own[0].update({decimal} - {""} if certain else ())
                    own[1].update({group} - {""})
        return found

    def _decimal(self, column: int, text: str) -> str:
        """The decimal mark of a number."""
        own, _, certain = _marks(text)
        if self.settings.decimal is not None or certain:
            return self.settings.decimal or own or "."
        other = "," if own == "." else "."
        (of_column, _), (of_table, groups) = self._evidence[column], self._evidence[-1]
        if (of_column or of_table) == {own}:
            return own
        if own in groups - of_table:
            return other
        if own == "." and not of_table and self.separator not in LOCAL:
            return own
        numbers = " or ".join(f"{_value(text, mark):.10g}" for mark in (own, other))
        raise SceneError(
            f"column {self.header.headers[column]!r}: {text!r} is {numbers}, and no other number of the table decides: "
            f'{LINE}, decimal = "{own}" or decimal = "{other}"'
        )


def open_table(
    path: Path, columns: Columns, folder: Path | None = None, settings: TableSettings | None = None
) -> TableFile:
    """A table of the user, read within the gate of :func:`mic.system.foreign_files.reading`.

    Parameters
    ----------
    path : Path
    columns : Columns
        By which the header is recognised.
    folder : Path, optional
        Folder of the scene that names the file.
    settings : TableSettings, optional

    Raises
    ------
    SceneError
        In one sentence that begins with the path; as :func:`parse_table`.
    """
    with reading(path, "table", folder, SceneError):
        return parse_table(path, columns, settings)


def parse_table(
    path: Path,
    columns: Columns,
    settings: TableSettings | None = None,
    default: Sequence[str] = (),
    most: int | None = None,
) -> TableFile:
    """A table of the user.

    Parameters
    ----------
    path : Path
    columns : Columns
    settings : TableSettings, optional
    default : sequence of str
        Keys of the columns of a file without a header, if it has as many, all of numbers.
    most : int, optional
        Only the whole lines within so many bytes are read.

    Raises
    ------
    SceneError
        If the file is no table, or can be read in several ways; the sentence names the line of the scene that decides.
    """
    settings = settings or TableSettings()
    content = path.read_bytes() if most is None else _read_lines(path, most)
    if is_workbook(content):
        return _of_workbook(path, columns, settings, default)
    if settings.sheet is not None:
        raise SceneError("sheet goes with Excel workbooks (.xlsx), and this is none: remove it")
    text = _text(content)
    head = "".join(text.splitlines(keepends=True)[:JUDGED])
    found = [_arranged(rows, columns, settings, default, mark) for mark, rows in _splittings(head)]
    named = [one for one in found if one.score[0] > 1 and one.separator in SEPARATORS]  # "X | Y" has blanks, too
    mark = max(named or found, key=lambda one: one.score).separator
    rows = next(rows for own, rows in _splittings(text) if own == mark)
    return _arranged(rows, columns, settings, default, mark).table(columns)


def _read_lines(path: Path, most: int) -> bytes:
    """The whole lines within so many bytes of a file."""
    with path.open("rb") as file:
        return file.read(most).rpartition(b"\n")[0]


@dataclass(frozen=True)
class _Arranged:
    """Rows below their header, before the columns are matched; rows above it are titles and comments."""

    score: tuple[int, int, int]
    headers: list[str]
    number: int
    rows: Rows
    above: Rows
    separator: str
    settings: TableSettings

    def table(self, columns: Columns) -> TableFile:
        if not self.headers:
            raise SceneError(
                "row 1: the header is missing; name the columns there, or all of them in their order by a line in the "
                'scene, columns = ["name", "x", …]'
            )
        rows = self._filled()
        given = self.settings.columns if isinstance(self.settings.columns, dict) else None
        header = columns.match(self.headers, given)
        header, rows = _with_units_row(header, rows)
        _refuse_ambiguous(self.number, header, rows)
        if self.settings.unit is None:
            _refuse_titled_unit(self.above, header)
        footer = []
        while len(header.key_of) > 2 and rows and _is_footer(rows[-1][1]):
            number, cells = rows.pop()
            footer.append(f"row {number} {max(cells)!r}")
        titles = [str(number) for number, cells in self.above if not _is_comment(cells)]
        notes = [f"row{'s' * (len(titles) > 1)} {', '.join(titles)} above the header"] if titles else []
        notes += footer
        return TableFile(columns, header, rows, self.number, self.settings, self.separator, tuple(notes))

    def _filled(self) -> Rows:
        """Rows with as many cells as there are headers."""
        many, rows = len(self.headers), []
        certain = self.separator != "," or any(
            _marks(cell)[::2] == (".", True) for _, cells in self.rows for cell in cells
        )
        for number, cells in self.rows:
            uneven = len(_trimmed(cells)) != many and self.separator in (BLANK, WIDE)  # blanks leave no cell empty
            if any(cells[many:]) or (len(cells) < many and not certain) or uneven:
                between = SEPARATORS.get(self.separator, "blanks")
                remedy = "give each row the same number of cells"
                if self.separator == ",":
                    remedy += "; if commas are also the decimal mark, separate the cells by semicolons"
                raise SceneError(
                    f"not a table: row {number} has {len(cells)} cells separated by {between}, and the header {many}; "
                    + remedy
                )
            rows.append((number, [*cells[:many], *[""] * (many - len(cells))]))
        return rows


def _of_workbook(path: Path, columns: Columns, settings: TableSettings, default: Sequence[str]) -> TableFile:
    sheets = read_workbook(path)
    if settings.sheet is not None and settings.sheet not in sheets:
        raise SceneError(f"there is no sheet {settings.sheet!r}; it has {', '.join(map(repr, sheets))}")
    if settings.sheet is not None:
        sheets = {settings.sheet: sheets[settings.sheet]}
    lines = {name: [(number, list(map(_line, cells))) for number, cells in rows] for name, rows in sheets.items()}
    found = {
        name: _arranged(rows, columns, settings, default, "")
        for name, rows in lines.items()
        if any(any(cells) for _, cells in rows)
    }
    if not found:
        raise SceneError("not a table: its sheets are empty; save it again")
    most = max(one.score[0] for one in found.values())
    good = [name for name, one in found.items() if one.score[0] >= max(1, most - 1) and one.rows] or list(found)[:1]
    if len(good) > 1:
        raise SceneError(f'the sheets {", ".join(map(repr, good))} may all be meant: {LINE}, sheet = "{good[0]}"')
    table = found[good[0]].table(columns)
    if len(sheets) > 1:
        table = replace(table, notes=(*table.notes, f"of the sheet {good[0]!r}"))
    return table


def _text(content: bytes) -> str:
    if content.startswith(OLD_EXCEL):
        raise SceneError("it is a workbook of Excel before 2007; save it as .xlsx or CSV")
    marks = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
    coding = next((name for mark, name in marks.items() if content.startswith(mark)), "utf-8")
    try:
        try:
            text = content.decode(coding)
        except UnicodeDecodeError:
            if coding != "utf-8":
                raise
            text = content.decode("cp1252")  # CSV of Excel on Windows
    except UnicodeDecodeError as problem:
        raise SceneError(f"cannot be read as text ({problem}); save it as CSV in UTF-8") from None
    if strange := CONTROL.search(text):
        raise SceneError(f"cannot be read as text (it holds the character {ord(strange[0])}); save it as CSV in UTF-8")
    return text


def _splittings(text: str) -> Iterator[tuple[str, Rows]]:
    """The rows of a text for each separator that may be meant."""
    first, _, rest = text.partition("\n")
    if stated := re.fullmatch(r"\ufeff?\"?sep=(.)\"?\r?", first):  # Excel's own first line
        yield stated[1], _records("\n" + rest, stated[1])
        return
    marks = [mark for mark in SEPARATORS if mark in text] or [","]
    for mark in marks:
        yield mark, _records(text, mark)
    if "\t" not in text and re.search(r"\S {2,}\S", text):
        yield WIDE, _records(re.sub(r"(?<=\S) {2,}", "\t", text), "\t")
    if re.search(r"\S[ \t]+\S", text):
        yield BLANK, _records(text.replace("\t", " "), " ")


def _records(text: str, separator: str) -> Rows:
    rows, last = [], 0
    reader = csv.reader(StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
    try:
        for cells in reader:
            rows.append((last + 1, list(map(_line, cells))))
            last = reader.line_num
    except csv.Error as problem:
        raise SceneError(f"not a table: row {last + 1}: {problem}; save it as CSV again") from None
    return rows


def _line(cell: str) -> str:
    """A cell on one line; blanks that group thousands stay."""
    if isinstance(cell, StoredNumber):
        return cell
    return re.sub(r"[ \t\r\n\f\v]+", " ", cell).strip(" \ufeff\u00a0") if SPACE.search(cell) else cell


def _arranged(
    rows: Rows, columns: Columns, settings: TableSettings, default: Sequence[str], separator: str
) -> _Arranged:
    """Rows with the header: the row with most known columns, else the first, unless that holds numbers alone."""
    filled = [(number, cells) for number, cells in rows if any(cells) and not RULE.fullmatch("".join(cells))]
    data = [(number, cells) for number, cells in filled if not _is_comment(cells)]
    if not data:
        raise SceneError("not a table: row 1: the header is missing; give a header and a row for each item")
    comments = [(number, cells) for number, cells in filled if _is_comment(cells)]
    if isinstance(settings.columns, list):
        return _Arranged((len(settings.columns), 0, 0), settings.columns, 0, data, comments, separator, settings)
    counts = [columns.count(cells) for _, cells in data[:ABOVE]]
    best, first = max(counts), _trimmed(data[0][1])
    number, headers = data[counts.index(best)] if best else data[0]
    headers, over = _trimmed(headers), data[max(0, counts.index(best) - 1)]
    if best == 0 and all(map(_is_number, first)):
        # numpy.savetxt and CloudCompare write the header as a comment.
        named = [(n, _trimmed(_uncommented(cells))) for n, cells in comments[:ABOVE]]
        named = [(n, cells) for n, cells in named if len(cells) == len(first) and columns.count(cells)]
        if named or len(default) == len(first):
            number, headers = named[0] if named else (0, list(default))
            best = columns.count(headers)
        else:
            return _Arranged((-1, len(first), 0), [], 0, data, comments, separator, settings)
    below = [(n, cells) for n, cells in data if n > number and _trimmed(cells) != headers]
    if headers[0] == "#" and all(len(_trimmed(cells)) == len(headers) - 1 for _, cells in below):
        headers = headers[1:]  # the mark of a comment, not a column
    above = [(n, cells) for n, cells in filled if n < number]
    if best and over[0] < number and (joined := _under(over[1], headers, columns)) != headers:
        headers, above = joined, [row for row in above if row != over]
        best = columns.count(headers)
    fitting = sum(not any(cells[len(headers) :]) for _, cells in below)
    return _Arranged((best, len(headers) * (best == 0), fitting), headers, number, below, above, separator, settings)


def _under(groups: Sequence[str], headers: Sequence[str], columns: Columns) -> list[str]:
    """Headers below a row of groups, such as ``X`` below ``Nominal``; with their group where that tells more."""
    joined, group = [], ""
    for i, header in enumerate(headers):
        group = groups[i] if i < len(groups) and groups[i] else group
        both = f"{group} {header}".strip()
        needed = headers.count(header) > 1 or columns.key(header) is None and columns.key(both) is not None
        joined.append(both if header and needed else header)
    return joined


def _trimmed(cells: Sequence[str]) -> list[str]:
    """Cells without the empty ones at the end."""
    many = max((i + 1 for i, cell in enumerate(cells) if cell), default=0)
    return list(cells[:many])


def _is_comment(cells: Sequence[str]) -> bool:
    return bool(COMMENT.match(cells[0]))


def _is_number(cell: str) -> bool:
    return isinstance(cell, StoredNumber) or NUMBER.fullmatch(cell.replace("−", "-")) is not None


def _is_footer(cells: Sequence[str]) -> bool:
    """Whether a row holds one phrase, such as ``Total: 8 welds``."""
    filled = [cell for cell in cells if cell]
    return len(filled) == 1 and re.search(r"\w[ :]", filled[0]) is not None


def _uncommented(cells: Sequence[str]) -> list[str]:
    first = re.sub(r"^[#/%$!\s]+", "", cells[0])
    return [first, *cells[1:]] if first else list(cells[1:])


def _with_units_row(header: Header, rows: Rows) -> tuple[Header, Rows]:
    """The table without a row of units below its header."""
    if not rows or not any(rows[0][1]):
        return header, rows
    cells = [re.sub(r"^[\[(]\s*|\s*[\])]$", "", cell) for cell in rows[0][1]]
    units = {key: unit_of(cells[i], quantity_of(key)) for key, i in header.key_of.items() if key in header.unitless}
    if not any(units.values()) or any(cell and cell not in "-–/" and unit_of(cell) is None for cell in cells):
        return header, rows
    factor = header.factor | {key: unit[1] for key, unit in units.items() if unit}
    unitless = header.unitless - {key for key, unit in units.items() if unit}
    return replace(header, factor=factor, unitless=unitless), rows[1:]


def _refuse_ambiguous(number: int, header: Header, rows: Rows) -> None:
    """Refuse repeated columns, and several columns of one quantity unless their cells are equal."""
    for key, others in header.others.items():
        first = header.key_of[key]
        names = [header.headers[i] for i in (first, *others)]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise SceneError(f"row {number}: column {twice!r} is given twice; rename or remove one of them")
        if quantity_of(key) is not None and any(cells[i] != cells[first] for _, cells in rows for i in others):
            raise SceneError(
                f'{key} may be {" or ".join(map(repr, names))}: {LINE}, columns = {{ {key} = "{names[0]}" }}'
            )


def _refuse_titled_unit(above: Rows, header: Header) -> None:
    """Refuse lengths without a unit below a title or comment that names one other than mm."""
    lengths = [key for key in header.key_of if key in header.unitless and quantity_of(key) == "length"]
    heads = [header.headers[header.key_of[key]] for key in lengths]
    for number, cells in above if heads else ():
        text = " ".join(cells)
        units = [unit for word in re.findall(r"[^\W\d_]+", text) if (unit := unit_of(word, "length"))]
        named = TITLED_UNIT.search(text)  # "in" and "m" are words, too
        factors = {factor for _, factor in units if factor not in (25.4, 1000.0)}
        factors |= {unit[1] for word in SPELT.findall(text) if (unit := unit_of(word, "length"))}
        factors |= {unit[1] for unit in [unit_of(named[1], "length")] if unit} if named else set()
        if factors - {1.0} and 1.0 not in factors:
            raise SceneError(
                f'row {number} says {text!r}, and column {heads[0]!r} names no unit: {LINE}, unit = "in" (or "mm", '
                '"cm", "m", "ft")'
            )


def _words(text: str) -> Sequence[str]:
    """A cell, or its members if it is a list."""
    return (text,) if isinstance(text, StoredNumber) else text.split()


def _marks(text: str) -> tuple[str, str, bool]:
    """Decimal mark of a number and mark that groups its thousands, both empty if there are none; whether it is certain.

    Uncertain is a single mark before three digits, which may do either: it is returned as the decimal mark.
    """
    found = NUMBER.fullmatch(text.replace("−", "-"))
    if isinstance(text, StoredNumber) or found is None:
        return "", "", True
    digits, dots, commas = found[2], found[2].count("."), found[2].count(",")
    if dots and commas:
        decimal = max(".,", key=digits.rfind)
        whole, _, fraction = digits.partition(decimal)
        well_formed = GROUPED.fullmatch(whole) and fraction.isdigit()
        return (decimal, "," if decimal == "." else ".", True) if well_formed else ("", "", True)
    if not dots and not commas:
        return "", "", True
    own = "." if dots else ","
    if dots + commas > 1 and not GROUPED.fullmatch(digits):  # a date
        return "", "", True
    if dots + commas > 1:
        return "," if own == "." else ".", own, True
    return own, "", not GROUPED.fullmatch(digits) or bool(found[3])


def _value(text: str, decimal: str) -> float:
    """The number in a cell with a decimal mark; NaN if it is none."""
    found = NUMBER.fullmatch(text.replace("−", "-"))
    if isinstance(text, StoredNumber) or found is None:
        return float(text) if found or text.casefold().strip("+-") in ("inf", "infinity") else float("nan")
    whole, _, fraction = found[2].partition(decimal)
    if re.search(r"\D", whole):
        if not GROUPED.fullmatch(whole):
            return float("nan")
        whole = re.sub(r"\D", "", whole)
    return (
        float(f"{found[1]}{whole}.{fraction or '0'}{found[3] or ''}")
        if re.fullmatch(r"\d*", fraction)
        else float("nan")
    )


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
