"""The report of a run folder: one HTML file that opens offline, and prints.

Its first page says what was validated, how far off the program is, what dominates, what failed, where it must not be
used, and is signed; a page for each study follows, then the limitations in full, and all numbers.
"""

from __future__ import annotations

import base64
import itertools
import math
import re
from pathlib import Path

import jinja2
import pandas as pd
from markupsafe import Markup, escape

from verification.limitations import limitations
from verification.pdf import browser, write_pdf
from verification.plots import panels, svg
from verification.run import read_results, write_summary

__all__ = ["environment", "number", "over_limit", "table_cells", "write_report"]

BUDGET = "error_budget"  # the study that the first page tells of
LONG = 12  # rows of a table that is folded on the screen
WIDE = 9  # columns of a table that is set smaller
SIGNERS = ("Validated by", "Approved by")
FARTHEST = 1e4  # ratio of measured and limit beyond which a bar is cut


def write_report(folder: Path, pdf: bool = False) -> Path:
    """Write ``summary.json`` and ``report.html`` from the studies that a run folder holds, and ``report.pdf``.

    Returns
    -------
    Path
        Of what is to be read: the PDF where it was asked for.

    Raises
    ------
    FileNotFoundError
        If the folder holds no finished study, or nothing prints.
    """
    folder = Path(folder)
    if pdf:
        browser()
    results = read_results(folder)
    if not results:
        raise FileNotFoundError(
            f"{folder}: holds no finished study; name the folder that `python -m verification run --out` wrote"
        )
    entries = write_summary(folder)
    _fill_in(results)
    points = limitations()
    page = (
        environment()
        .get_template("report.html")
        .render(
            results=results,
            entries=entries,
            failed=[entry for entry in entries if not entry["passed"]],
            titles={result["study"]: result["title"] for result in results},
            budget=next((result for result in results if result["study"] == BUDGET), None),
            seconds=sum(result["cpu_seconds"] for result in results),
            limitations=points,
            beginnings=[_first_clause(point) for point in points],
            made=_made(results),
            signers=SIGNERS,
        )
    )
    path = folder / "report.html"
    temporary = folder / ".report.html"
    temporary.write_text(page)
    temporary.replace(path)
    return write_pdf(path) if pdf else path


def environment() -> jinja2.Environment:
    """Of the pages of this package."""
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    found.filters |= {"number": number, "keys": keys}
    return found


def keys(text: str) -> Markup:
    """A sentence with what stands between backticks, keys of a scene, set as such."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def _fill_in(results: list[dict]) -> None:
    """What the page shows beside what the folder holds: verdicts, pictures, tables, and their numbers."""
    figures, tables = itertools.count(1), itertools.count(1)
    order = sorted(results, key=lambda result: result["study"] != BUDGET)  # the first page has the first figure
    for result in order:
        result["kept"] = sum(finding["passed"] for finding in result["findings"])
        result["passed"] = result["kept"] == len(result["findings"])
        drawn = [finding for finding in result["findings"] if "figure" in finding]
        first = result["study"] == BUDGET
        if first:
            _draw(drawn, result["folder"], figures)
        result["limits"] = base64.b64encode(svg(_limits(result["findings"]))).decode()
        result["limits_number"] = next(figures)
        if not first:
            _draw(drawn, result["folder"], figures)
        for finding in result["findings"]:
            if "table" in finding:
                finding["rows"] = table_cells(
                    pd.read_csv(result["folder"] / finding["table"], keep_default_na=False, na_values=["nan", ""])
                )
                finding["table_number"] = next(tables)
                finding["long"] = len(finding["rows"]["rows"]) > LONG
                finding["wide"] = len(finding["rows"]["columns"]) > WIDE


def _draw(findings, folder, numbers) -> None:
    for finding in findings:
        finding["image"] = base64.b64encode((folder / finding["figure"]).read_bytes()).decode()
        finding["figure_number"] = next(numbers)


def _limits(findings: list[dict]):
    """Each number over its limit, or the limit over the number where it is to be at least that: beyond 1 it is not
    kept."""
    figure, (axis,) = panels(1, 7.6, 0.7 + 0.3 * len(findings))
    for y, finding in enumerate(findings):
        ratio = over_limit(finding)
        colour = "tab:green" if finding["passed"] else "tab:red"
        if math.isfinite(ratio):
            axis.barh(y, ratio, left=0, height=0.6, color=colour)
        else:
            axis.text(1.02, y, "not measured", va="center", color=colour, fontsize=9)
    ratios = [ratio for ratio in map(over_limit, findings) if math.isfinite(ratio)]
    axis.axvline(1.0, color="k", lw=1.4)
    low = min([0.5, *ratios]) / 2
    axis.set(
        xscale="log", xlim=(low, max([1.0, *ratios]) * 2), xlabel="share of the limit that is used up; 1: the limit"
    )
    axis.set_yticks(range(len(findings)), [finding["name"] for finding in findings])
    axis.invert_yaxis()
    return figure


def over_limit(finding: dict) -> float:
    """What of its limit a number uses up, within 1/`FARTHEST` and `FARTHEST`; NaN where nothing was measured."""
    measured, limit = finding["measured"], finding["limit"]
    if measured is None:
        return math.nan
    above, below = (measured, limit) if finding["bound"] == "at most" else (limit, measured)
    if above == 0 or (above > 0 and below > 0):
        return min(max(above / below if below else 1.0, 1 / FARTHEST), FARTHEST)
    return 1 / FARTHEST if finding["passed"] else FARTHEST


def _first_clause(point: str) -> str:
    """What a limitation begins with, to its first full stop, colon or semicolon that ends a clause."""
    return re.split(r"(?<=[^\d])[.:;](?:\s|$)", point, maxsplit=1)[0] + "."


def _made(results: list[dict]) -> list[tuple[str, str]]:
    """Of what and where the results were made; all values where studies differ."""
    rows = [("versions", ", ".join(f"{name} {version}" for name, version in results[0]["versions"].items()))]
    for result in results[1:]:
        if result["versions"] != results[0]["versions"]:
            rows.append(("versions", f"{result['title']}: other versions; run it again"))
    for key in ("commit", "machine", "date"):
        values = sorted({result.get(key, "not recorded") for result in results})
        if key == "date" and len(values) > 1:
            values = [f"{values[0]} to {values[-1]}"]
        rows.append((key, "; ".join(values)))
    return rows


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
