"""The tables of a results folder in one Excel file, one sheet each."""

from __future__ import annotations

import math
from pathlib import Path

from mic.errors import RunError
from mic.results.schema import STATISTICS, STUDIES
from mic.system.files import replacing

__all__ = ["write_excel"]

WIDEST = 24  # column width, characters
ROWS, LONGEST = 1_048_576, 32_767  # limits of Excel: rows of a sheet, characters of a cell
TEXTS_STAY = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}  # also =, +, -, @


def write_excel(folder: Path, path: Path) -> Path:
    """Write ``tables/*.csv`` of a results folder into one workbook: rows of names and units, then the values.

    A text stays a text, also one that Excel would read as a formula, a link or a number.

    Parameters
    ----------
    folder : Path
    path : Path
        The ``.xlsx`` file.

    Raises
    ------
    RunError
        If the folder holds no tables, a table has more rows than Excel takes, or xlsxwriter is not installed.
    FormatError
        If a table differs from its declaration.
    """
    try:
        import xlsxwriter  # optional
    except ImportError:
        raise RunError(f"{path}: Excel files need the library xlsxwriter; install it: pip install xlsxwriter") from None
    remedy = "run `mic report` on the run folder"
    frames = {table: table.read(Path(folder), remedy) for table in (*STATISTICS, *STUDIES)}
    existing = {table: frame for table, frame in frames.items() if frame is not None}
    if not existing:
        raise RunError(f"{folder}: holds no tables; run `mic report` on it first")
    for table, frame in existing.items():
        if len(frame) > ROWS - 2:
            raise RunError(f"{table.place}: has {len(frame)} rows, Excel takes {ROWS - 2}; read the CSV file instead")
    with replacing(Path(path)) as temporary, xlsxwriter.Workbook(str(temporary), TEXTS_STAY) as book:
        bold, grey = book.add_format({"bold": True}), book.add_format({"font_color": "#58626e", "bottom": 1})
        legend = book.add_worksheet("columns")
        legend.write_row(0, 0, ("table", "column", "unit", "meaning"), bold)
        line = 1
        for table, frame in existing.items():
            sheet = book.add_worksheet(table.name)
            sheet.freeze_panes(2, 0)
            columns = [column for column in table.columns if column.name in frame]
            for j, column in enumerate(columns):
                sheet.write_string(0, j, column.name, bold)
                sheet.write_string(1, j, column.unit, grey)
                sheet.set_column(j, j, min(WIDEST, max(8, len(column.name) + 1)))
                for i, value in enumerate(frame[column.name].tolist()):
                    if isinstance(value, str) and value:
                        sheet.write_string(2 + i, j, value[:LONGEST])
                    elif not isinstance(value, float) or math.isfinite(value):  # unknown values stay empty
                        sheet.write(2 + i, j, value)
                legend.write_row(line, 0, (table.name, column.name, column.unit, column.meaning))
                line += 1
        legend.set_column(0, 2, WIDEST)
        legend.set_column(3, 3, 100)
    return Path(path)
