"""The tables of a run as an Excel file."""

import sys
import zipfile
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from support.runs import changed

from mic.errors import RunError
from mic.results.excel import write_excel
from mic.results.outcome import read_outcome
from mic.results.schema import CONTRIBUTORS, MEASUREMENT_STATISTICS
from mic.runs import run

SHEETS = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"


@pytest.fixture(scope="module")
def folder(lap_scene, cache, tmp_path_factory):
    scene = changed(lap_scene, monte_carlo={"samples": 5}, report={"laws": ["frictionless"], "fields": False})
    folder = tmp_path_factory.mktemp("excel") / "run"
    run(scene, folder, cache)
    return folder


def sheets(path):
    """Cells by sheet: rows of numbers and texts, without empty cells."""
    with zipfile.ZipFile(path) as book:
        texts = ["".join(one.itertext()) for one in ElementTree.fromstring(book.read("xl/sharedStrings.xml"))]
        names = [one.get("name") for one in ElementTree.fromstring(book.read("xl/workbook.xml")).iter(f"{SHEETS}sheet")]
        found = {}
        for number, name in enumerate(names, 1):
            root = ElementTree.fromstring(book.read(f"xl/worksheets/sheet{number}.xml"))
            rows = []
            for row in root.iter(f"{SHEETS}row"):
                values = [(cell.get("t"), cell.findtext(f"{SHEETS}v")) for cell in row]
                given = [(kind, value) for kind, value in values if value is not None]
                rows.append([texts[int(value)] if kind == "s" else float(value) for kind, value in given])
            found[name] = rows
    return found


@pytest.mark.slow
def test_every_table_is_a_sheet_with_its_units_and_numbers(folder, tmp_path):
    found = sheets(write_excel(folder, tmp_path / "tables.xlsx"))
    assert list(found) == ["columns", "zones", "contacts", "measurements"]
    names, units, first, _ = found["measurements"]
    assert names == MEASUREMENT_STATISTICS.names and first[:2] == ["frictionless", "M1"]
    assert units == [column.unit for column in MEASUREMENT_STATISTICS.columns] and units[2] == "mm"
    own = read_outcome(folder).measurement_statistics.iloc[0]
    numbers = [value for value in first[2:] if not isinstance(value, str)]
    wanted = [value for value in own.tolist()[2:] if not isinstance(value, str) and np.isfinite(value)]
    np.testing.assert_allclose(numbers, wanted, rtol=1e-8)
    assert len(found["contacts"]) == 2 + len(read_outcome(folder).contact_statistics)
    meanings = {(row[0], row[1]): row[-1] for row in found["columns"][1:]}
    assert meanings["measurements", "cpk"].startswith("Cpk = min(")


TEXTS = ("=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "{=1}", "=HYPERLINK(1)", "https://a.example", "1e5", "007", "NA")


@pytest.mark.parametrize("text", [*TEXTS, "x" * 40_000])
def test_a_text_stays_a_text(text, tmp_path):
    """Excel would take a cell that begins like these for a formula, a link or a number."""
    row = {column.name: 1.5 if column.dtype == "float64" else text for column in CONTRIBUTORS.columns}
    frame = pd.DataFrame([row, row]).astype({column.name: column.dtype for column in CONTRIBUTORS.columns})
    CONTRIBUTORS.write(tmp_path, frame)
    path = write_excel(tmp_path, tmp_path / "tables.xlsx")
    _, _, first, second = sheets(path)["contributors"]
    assert first == second == [text[:32767] if value == text else value for value in row.values()]
    with zipfile.ZipFile(path) as book:
        sheet = book.read("xl/worksheets/sheet2.xml").decode()
    assert "<f>" not in sheet and "hyperlink" not in sheet


def test_a_table_with_more_rows_than_a_sheet_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("mic.results.excel.ROWS", 3)
    row = {column.name: 1.5 if column.dtype == "float64" else "a" for column in CONTRIBUTORS.columns}
    CONTRIBUTORS.write(tmp_path, pd.DataFrame([row, row]))
    with pytest.raises(RunError, match="contributors.csv: has 2 rows, Excel takes 1; read the CSV file instead"):
        write_excel(tmp_path, tmp_path / "tables.xlsx")


def test_a_missing_library_is_refused_with_the_command_to_install_it(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    with pytest.raises(RunError, match="pip install xlsxwriter"):
        write_excel(folder, tmp_path / "tables.xlsx")


def test_a_folder_without_tables_is_refused(tmp_path):
    with pytest.raises(RunError, match="holds no tables"):
        write_excel(tmp_path, tmp_path / "tables.xlsx")
