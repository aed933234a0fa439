"""The report of a run folder: one HTML file that opens offline."""

from __future__ import annotations

import base64
from pathlib import Path

import jinja2
import pandas as pd

from verification.run import read_results, write_summary

__all__ = ["number", "table_cells", "write_report"]


def write_report(folder: Path) -> Path:
    """Write ``summary.json`` and ``report.html`` from the studies that a run folder holds.

    Raises
    ------
    FileNotFoundError
        If the folder holds no finished study.
    """
    folder = Path(folder)
    results = read_results(folder)
    if not results:
        raise FileNotFoundError(
            f"{folder}: holds no finished study; name the folder that `python -m verification run --out` wrote"
        )
    entries = write_summary(folder)
    for result in results:
        result["passed"] = all(finding["passed"] for finding in result["findings"])
        for finding in result["findings"]:
            if "figure" in finding:
                finding["image"] = base64.b64encode((result["folder"] / finding["figure"]).read_bytes()).decode()
            if "table" in finding:
                finding["rows"] = table_cells(
                    pd.read_csv(result["folder"] / finding["table"], keep_default_na=False, na_values=["nan", ""])
                )
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = number
    page = environment.get_template("report.html").render(
        results=results,
        entries=len(entries),
        failed=sum(not entry["passed"] for entry in entries),
        seconds=sum(result["seconds"] for result in results),
    )
    path = folder / "report.html"
    temporary = folder / ".report.html"
    temporary.write_text(page)
    temporary.replace(path)
    return path


def number(value) -> str:
    """Three significant figures, or a dash for what does not exist."""
    if value is None or value != value:
        return "–"
    if isinstance(value, (bool, str)):
        return str(value)
    return f"{value:.3g}" if abs(value) < 1e3 or abs(value) >= 1e5 else f"{value:.0f}"


def table_cells(frame: pd.DataFrame) -> dict:
    """Columns and rows of a table as text."""
    return {
        "columns": list(frame.columns),
        "rows": [[_cell(value) for value in row] for row in frame.itertuples(index=False)],
    }


def _cell(value) -> dict:
    if isinstance(value, float):
        return {"text": "–" if value != value else f"{value:.4g}", "number": True}
    return {"text": str(value), "number": isinstance(value, int)}
