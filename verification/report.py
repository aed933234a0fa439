"""Report of a run folder: one self-contained HTML file, laid out for printing.

The first page has scope, errors, domain of applicability, limits not met, comparisons with their uncertainties,
limitations and signatures. One section per study, the full limitations and a table of all results follow.
"""

from __future__ import annotations

import base64
import itertools
import math
import re
from pathlib import Path

import jinja2
import pandas as pd

from mic.report.template import backticks_to_code
from mic.system.files import write_text
from verification import domain
from verification.limitations import limitations
from verification.pdf import browser, write_pdf
from verification.plots import panels, svg
from verification.run import read_results, write_summary
from verification.sampling_cost import enough

__all__ = ["environment", "number", "over_limit", "table_cells", "write_report"]

BUDGET = "error_budget"  # the study on the first page
LONG = 12  # a table with more rows is collapsed on the screen
WIDE = 9  # a table with more columns has a smaller font
SIGNERS = ("Verified by", "Approved by")
WANTED = 0.1  # accuracy of a 6σ for which the number of measured assemblies is stated
FARTHEST = 1e4  # largest ratio of measured value and limit that a bar shows


def write_report(folder: Path, pdf: bool = False) -> Path:
    """Write ``summary.json`` and ``report.html`` from the studies that a run folder holds, and ``report.pdf``.

    Returns
    -------
    Path
        The report: the PDF if requested, otherwise the HTML file.

    Raises
    ------
    FileNotFoundError
        If the folder contains no finished study, or no browser prints.
    """
    folder = Path(folder)
    if pdf:
        browser()
    results = read_results(folder)
    if not results:
        raise FileNotFoundError(
            f"{folder}: no finished study; name a folder that `python -m verification run --out` wrote"
        )
    entries = write_summary(folder)
    _fill_in(results)
    points, measured = limitations(), any(result.get("measured_assembly") for result in results)
    covering = [result for result in results if result["passed"] and result.get("domain")]
    page = (
        environment()
        .get_template("report.html")
        .render(
            title=f"Method {'validation' if measured else 'verification'} report",
            results=results,
            entries=entries,
            measured=measured,
            needed=enough(WANTED),
            wanted=WANTED,
            domain=_domain(covering),
            domain_studies=[result["study"] for result in covering],
            comparisons=_comparisons(results),
            failed=[entry for entry in entries if not entry["passed"]],
            titles={result["study"]: result["title"] for result in results},
            budget=next((result for result in results if result["study"] == BUDGET), None),
            seconds=sum(result["cpu_seconds"] for result in results),
            limitations=points,
            short_limitations=[_first_clause(point) for point in points],
            provenance=_provenance(results),
            signers=SIGNERS,
        )
    )
    path = folder / "report.html"
    write_text(path, page)
    return write_pdf(path) if pdf else path


def environment() -> jinja2.Environment:
    """Jinja environment of the templates of this package."""
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    templates.filters |= {"number": number, "keys": backticks_to_code}
    return templates


def _fill_in(results: list[dict]) -> None:
    """Add pass or fail, figures, tables and their numbers to the stored results."""
    figures, tables = itertools.count(1), itertools.count(1)
    order = sorted(results, key=lambda result: result["study"] != BUDGET)  # the first page has the first figure
    for result in order:
        result["met"] = sum(finding["passed"] for finding in result["findings"])
        result["passed"] = result["met"] == len(result["findings"])
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


def _domain(results: list[dict]) -> list[dict]:
    """Rows of the domain of applicability."""
    found = domain.merged(result["domain"] for result in results)
    rows = ((*domain.QUANTITIES[name], *ends) for name, ends in found.items())
    return [dict(zip(("title", "unit", "low", "high"), row)) for row in rows]


def _comparisons(results: list[dict]) -> list[dict]:
    """Findings with an uncertainty, and that uncertainty."""
    return [
        {"study": result["study"]} | finding | finding["uncertainty"]
        for result in results
        for finding in result["findings"]
        if finding.get("uncertainty")
    ]


def _draw(findings, folder, numbers) -> None:
    for finding in findings:
        finding["image"] = base64.b64encode((folder / finding["figure"]).read_bytes()).decode()
        finding["figure_number"] = next(numbers)


def _limits(findings: list[dict]):
    """Bar chart of measured value over limit (limit over measured value for lower limits)."""
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
    axis.set(xscale="log", xlim=(low, max([1.0, *ratios]) * 2), xlabel="measured value / limit")
    axis.set_yticks(range(len(findings)), [finding["name"] for finding in findings])
    axis.invert_yaxis()
    return figure


def over_limit(finding: dict) -> float:
    """Ratio of measured value and limit, at most 1 if met, clipped to `FARTHEST`; NaN if not measured."""
    measured, limit = finding["measured"], finding["limit"]
    if measured is None:
        return math.nan
    above, below = (measured, limit) if finding["bound"] == "at most" else (limit, measured)
    if above == 0 or (above > 0 and below > 0):
        return min(max(above / below if below else 1.0, 1 / FARTHEST), FARTHEST)
    return 1 / FARTHEST if finding["passed"] else FARTHEST


def _first_clause(point: str) -> str:
    """Text of a limitation up to the first full stop, colon or semicolon."""
    return re.split(r"(?<=[^\d])[.:;](?:\s|$)", point, maxsplit=1)[0] + "."


def _provenance(results: list[dict]) -> list[tuple[str, str]]:
    """Versions, commit, machine and date of the results; all values if studies differ."""
    rows = [("versions", ", ".join(f"{name} {version}" for name, version in results[0]["versions"].items()))]
    for result in results[1:]:
        if result["versions"] != results[0]["versions"]:
            rows.append(("versions", f"{result['title']}: different versions; run it again"))
    for key in ("commit", "machine", "date"):
        values = sorted({result.get(key, "not recorded") for result in results})
        if key == "date" and len(values) > 1:
            values = [f"{values[0]} to {values[-1]}"]
        rows.append((key, "; ".join(values)))
    return rows


def number(value) -> str:
    """Three significant figures, or a dash for None and NaN."""
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
