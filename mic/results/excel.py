"""The tables of a results folder in one Excel file, a sheet for each."""

from __future__ import annotations

import math
from pathlib import Path

from mic.errors import RunError
from mic.results.schema import ACCURACY, STATISTICS, STUDIES
from mic.system.files import replacing

__all__ = ["write_excel"]

WIDEST = 24  # characters of a column


def write_excel(folder: Path, path: Path) -> Path:
    """Write ``tables/*.csv`` of a results folder into one workbook: names, below them units, below these the numbers.

    Parameters
    ----------
    folder : Path
    path : Path
        The ``.xlsx`` file.

    Raises
    ------
    RunError
        If the folder holds no tables, or the library that writes such files is not installed.
    FormatError
        If a table is not as declared.
    """
    try:
        import xlsxwriter  # only here: it is optional
    except ImportError:
        raise RunError(
            f"{path}: writing Excel files takes the library xlsxwriter; install it: pip install xlsxwriter"
        ) from None
    frames = [(table, table.read(Path(folder), "call `mic report` on the run folder")) for table in _TABLES]
    found = [(table, frame) for table, frame in frames if frame is not None]
    if not found:
        raise RunError(f"{folder}: holds no tables; call `mic report` on it first")
    with replacing(Path(path)) as temporary, xlsxwriter.Workbook(str(temporary)) as book:
        head, soft = book.add_format({"bold": True}), book.add_format({"font_color": "#58626e", "bottom": 1})
        guide = book.add_worksheet("columns")
        guide.write_row(0, 0, ("table", "column", "unit", "meaning"), head)
        line = 1
        for table, frame in found:
            sheet = book.add_worksheet(table.name)
            sheet.freeze_panes(2, 0)
            columns = [column for column in table.columns if column.name in frame]
            for j, column in enumerate(columns):
                sheet.write_string(0, j, column.name, head)
                sheet.write_string(1, j, column.unit, soft)
                sheet.set_column(j, j, min(WIDEST, max(8, len(column.name) + 1)))
                for i, value in enumerate(frame[column.name].tolist()):
                    if not isinstance(value, float) or math.isfinite(value):  # what is not known stays empty
                        sheet.write(2 + i, j, value)
                guide.write_row(line, 0, (table.name, column.name, column.unit, column.meaning))
                line += 1
        guide.set_column(0, 2, WIDEST)
        guide.set_column(3, 3, 100)
    return Path(path)


_TABLES = (*STATISTICS, ACCURACY, *STUDIES)
