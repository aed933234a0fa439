"""Excel workbooks for tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO

import xlsxwriter

__all__ = ["workbook"]


def workbook(sheets: Mapping[str, Sequence[Sequence[object]]]) -> bytes:
    """Content of a workbook with cells by sheet; None leaves a cell empty."""
    content = BytesIO()
    with xlsxwriter.Workbook(content, {"in_memory": True, "strings_to_numbers": False}) as book:
        for name, rows in sheets.items():
            sheet = book.add_worksheet(name)
            for i, row in enumerate(rows):
                sheet.write_row(i, 0, row)
    return content.getvalue()
