"""Sentences, figure and tables of an error budget.

Errors of a key characteristic are relative to its tolerance, those of a zone slip to the 6σ of the slip.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic.results.outcome import Outcome
from verification.budget import FIGURES, ORDER, SAMPLING, STIFFNESS, Item, total
from verification.plots import STYLE, plt

__all__ = ["budget_figure", "budget_rows", "budget_sentences", "by_quantity", "items_of", "printed", "quantity_rows"]

WORDS = {"mean": "mean", "six_sigma": "6σ"}
MICRO = 1e3  # µm in a mm
#: What a user can do to reduce the error of a source, keys of the scene in quotes.
REMEDIES = {
    "law": "add `coulomb` to `report.laws`",
    "path": "use a smaller `path.tolerance` or more `increments`",
    ORDER: "state the order of closing with `order` in the stages",
    "pairs": "remove `pairs` and `points` from the zones, and set a smaller `spacing_factor`",
    "mesh and element": "refine the meshes",
    STIFFNESS: 'set `stiffness = "auto"`, or `"first-order"`',
    SAMPLING: "draw more samples",
}


def printed(outcome: Outcome, law: str) -> pd.DataFrame:
    """Printed statistics by quantity.

    Returns
    -------
    DataFrame
        ``mean, mean_half, six_sigma, six_sigma_half`` (mm, with half widths of the 95 % confidence intervals),
        ``lower, upper`` (mm, NaN for slips), ``samples``.
    """
    rows = {}
    zones, measurements = outcome.zone_statistics, outcome.measurement_statistics
    for _, row in zones[zones["law"] == law].iterrows() if outcome.has_slip else ():
        name, suffix = f"slip:{row['stage']}:{row['zone']}", "_rms_tangential"
        rows[name] = _figures(row, suffix) | {"lower": np.nan, "upper": np.nan, "samples": row["samples"]}
    for _, row in measurements[measurements["law"] == law].iterrows():
        limits = {key: row[key] for key in ("lower", "upper", "samples")}
        rows[f"measurement:{row['measurement']}"] = _figures(row, "") | limits
    return pd.DataFrame.from_dict(rows, orient="index")


def _figures(row, suffix) -> dict[str, float]:
    found = {}
    for figure in FIGURES:
        found[figure] = row[f"{figure}{suffix}"]
        found[f"{figure}_half"] = (row[f"{figure}{suffix}_high"] - row[f"{figure}{suffix}_low"]) / 2
    return found


def items_of(records: list[dict]) -> list[Item]:
    """The items recorded in ``summary.json``."""
    found = []
    for record in records:
        table = pd.DataFrame(record["errors"]).set_index("quantity").astype(float) if record["errors"] else None
        found.append(Item(record["source"], record["how"], record["seconds"], table, record["counts"]))
    return found


def by_quantity(figures: pd.DataFrame, items: list[Item]) -> pd.DataFrame:
    """Printed values and their errors by quantity, largest error first, key characteristics before slips.

    Returns
    -------
    DataFrame
        Columns of :func:`printed`, errors of the sum (`error mean`, `error mean ±`, … mm), ``scale`` (tolerance or 6σ
        of the slip, mm), printed ``cpk``, ``cpk error`` and ``cpk error ±``, ``worst`` (largest possible error over
        the scale) and ``dominating`` (source).
    """
    errors = total(items).reindex(figures.index).fillna(0.0)
    table = figures.join(errors.rename(columns=lambda name: f"error {name}".replace("_half", " ±")))
    tolerance = figures["upper"] - figures["lower"]
    table["scale"] = tolerance.where(tolerance.notna(), figures["six_sigma"].where(figures["six_sigma"] > 0))
    sums = pd.DataFrame({f: table[f"error {f}"].abs() + table[f"error {f} ±"] for f in FIGURES})
    table["worst"] = sums.max(axis=1) / table["scale"]
    table["figure"] = sums.idxmax(axis=1)
    table["dominating"] = [_dominating(items, name, table.at[name, "figure"]) for name in table.index]
    table["cpk"] = [_cpk(row, row["mean"], row["six_sigma"]) for _, row in table.iterrows()]
    better = [
        _cpk(row, row["mean"] - row["error mean"], row["six_sigma"] - row["error six_sigma"])
        for _, row in table.iterrows()
    ]
    table["cpk error"] = table["cpk"] - better
    table["cpk error ±"] = np.hypot(
        table["error mean ±"] / (table["six_sigma"] / 2), table["cpk"] * table["error six_sigma ±"] / table["six_sigma"]
    )
    order = sorted(table.index, key=lambda name: (not name.startswith("measurement:"), -table.at[name, "worst"]))
    return table.loc[order]


def _cpk(row, mean: float, six_sigma: float) -> float:
    """Cpk of a characteristic with two limits; NaN for slips."""
    if not six_sigma > 0:
        return np.nan
    return min(row["upper"] - mean, mean - row["lower"]) / (six_sigma / 2)


def _dominating(items: list[Item], quantity: str, figure: str) -> str:
    """Source in the sum with the largest possible error of a statistic of a quantity."""
    sizes = {
        item.source: abs(item.table.at[quantity, figure]) + np.nan_to_num(item.table.at[quantity, f"{figure}_half"])
        for item in items
        if item.counts and item.table is not None and quantity in item.table.index
    }
    known = {source: size for source, size in sizes.items() if np.isfinite(size)}
    return max(known, key=known.__getitem__) if known else ""


def _worst(table: pd.DataFrame) -> str:
    """Key characteristic (or slip, if there is none) with the largest possible error."""
    return str(table.index[0])


def budget_sentences(scene: str, table: pd.DataFrame, items: list[Item]) -> dict[str, str]:
    """Sentences for the first page: errors of the results of a scene, the largest source, and missing estimates."""
    found, kinds = {}, table.index.str.split(":").str[0]
    characteristics, slips = table[kinds == "measurement"], table[kinds == "slip"]
    if len(characteristics):
        mean, six_sigma = (_farthest(characteristics, figure, "of its tolerance") for figure in FIGURES)
        found["figures"] = f"{scene}: largest error of a mean {mean}; of a 6σ {six_sigma}."
        cpk = characteristics[characteristics["cpk error"].notna()]
        if len(cpk):
            row = cpk.loc[(cpk["cpk error"].abs() + cpk["cpk error ±"]).idxmax()]
            found["cpk"] = (
                f"{scene}: largest error of a Cpk {_signed(row['cpk error'])} ± {_plain(row['cpk error ±'])} "
                f"({_name(row.name)}, printed as {row['cpk']:.2f})."
            )
    moving = slips[slips["six_sigma"] > 0]
    if len(moving):
        mean, six_sigma = (_farthest(moving, figure, "of its own 6σ") for figure in FIGURES)
        found["slips"] = f"{scene}: largest error of the mean of a zone slip {mean}; of its 6σ {six_sigma}."
    first = table.loc[_worst(table)]
    found["dominating"] = (
        f"{scene}: largest source of error: {first['dominating'] or 'not known'}, in the "
        f"{WORDS[first['figure']]} of {_name(first.name)}. {_remedy(items, first)}"
    )
    unknown = [item.source for item in items if item.table is None]
    if unknown:
        found["unknown"] = f"{scene}: not estimated and not in the sum: {', '.join(unknown)}."
    return found


def _remedy(items: list[Item], first: pd.Series) -> str:
    """Remedy for the largest source of error, and for the next largest if that is sampling."""
    source = first["dominating"]
    if source not in REMEDIES:
        return "No key of the scene reduces it." if source else "No remedy is known."
    remedy = f"Remedy: {REMEDIES[source]}"
    if source != SAMPLING:
        return f"{remedy}; more samples do not reduce it."
    other = _dominating([item for item in items if item.source != SAMPLING], str(first.name), first["figure"])
    if other not in REMEDIES:
        return f"{remedy}."
    return f"{remedy}. The next largest source is {other}: {REMEDIES[other]}."


def _farthest(table: pd.DataFrame, figure: str, whole: str) -> str:
    error, half = table[f"error {figure}"], table[f"error {figure} ±"]
    name = ((error.abs() + half) / table["scale"]).idxmax()
    share = 100 / table.at[name, "scale"]
    return (
        f"{_signed(MICRO * error[name])} ± {_plain(MICRO * half[name])} µm ({_name(name)}, "
        f"{_signed(share * error[name])} ± {_plain(share * half[name])} % {whole})"
    )


def _plain(value: float) -> str:
    """Two significant digits without exponent; 0 for less than a thousandth."""
    return f"{float(f'{value:.2g}'):g}" if abs(value) >= 1e-3 else "0"


def _signed(value: float) -> str:
    text = _plain(value).replace("-", "−")
    return text if value < 0 or text == "0" else f"+{text}"


def _name(quantity: str) -> str:
    """Readable name of a quantity."""
    kind, *rest = quantity.split(":")
    return rest[0] if kind == "measurement" else f"zone {rest[1]} in stage {rest[0]}"


def budget_figure(cases: list[tuple[str, pd.DataFrame, list[Item]]]):
    """Bars with uncertainties for each source and the sum; one row of panels for each scene.

    Parameters
    ----------
    cases : list of (str, DataFrame, list of Item)
        Name of the scene, :func:`by_quantity`, and the sources.
    """
    height = sum(0.9 + 0.27 * (len(items) + 1) for _, _, items in cases)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            len(cases), 2, figsize=(10.4, height), squeeze=False, layout="constrained", sharey="row"
        )
    for (scene, table, items), row in zip(cases, axes):
        name = _worst(table)
        for axis, kind in zip(row, FIGURES):
            _bars(axis, items, table.loc[name], kind)
            whole = "the tolerance" if name.startswith("measurement:") else "its 6σ"
            axis.set_title(f"{scene}: {WORDS[kind]} of {_name(name)}", fontsize=10)
            axis.set_xlabel(f"error, µm; {whole} is {MICRO * table.at[name, 'scale']:.4g} µm")
        row[0].invert_yaxis()
    return figure


def _bars(axis, items: list[Item], first: pd.Series, kind: str) -> None:
    labels = []
    for y, item in enumerate(items):
        labels.append(item.source)
        known = item.table is not None and first.name in item.table.index
        value = item.table.at[first.name, kind] if known else np.nan
        if not np.isfinite(value):
            axis.text(0, y, " not estimated", va="center", fontsize=8, color="0.4")
            continue
        half = np.nan_to_num(item.table.at[first.name, f"{kind}_half"])
        colour = "tab:orange" if item.source == first["dominating"] else "tab:blue"
        _bar(axis, y, value, half, colour if item.counts else "0.75")
    _bar(axis, len(items), first[f"error {kind}"], first[f"error {kind} ±"], "0.25")
    axis.axvline(0, color="k", lw=0.8)
    axis.set_yticks(range(len(items) + 1), [*labels, "sum"])


def _bar(axis, y, value, half, colour) -> None:
    """Bar of the estimate with its uncertainty."""
    axis.barh(y, MICRO * value, height=0.6, color=colour)
    axis.errorbar(MICRO * value, y, xerr=MICRO * half, color=colour, lw=1.6, capsize=3, zorder=3)


def budget_rows(items: list[Item], table: pd.DataFrame) -> pd.DataFrame:
    """Table by source: errors of the quantity with the largest error, largest relative errors, cost and method."""
    name, rows = _worst(table), []
    for item in items:
        row = {"source": item.source if item.counts else f"{item.source} (not in the sum)"}
        for figure in FIGURES:
            known = item.table is not None and name in item.table.index
            row[f"{WORDS[figure]} of {_name(name)}, µm"] = (
                _around(item.table.at[name, figure], item.table.at[name, f"{figure}_half"]) if known else "–"
            )
        shares = [_largest(item, table, kind) for kind in ("measurement", "slip")]
        row |= dict(zip(("largest, % of tolerance", "largest, % of slip 6σ"), shares))
        rows.append(row | {"CPU s": round(item.seconds, 1), "method": item.how})
    return pd.DataFrame(rows)


def quantity_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Table by quantity for the report, in µm and %."""
    rows = []
    for name, row in table.iterrows():
        measured = str(name).startswith("measurement:")
        cells = {"quantity": _name(str(name)), "tolerance, mm": row["scale"] if measured else np.nan}
        for figure in FIGURES:
            error, half = row[f"error {figure}"], row[f"error {figure} ±"]
            cells[f"{WORDS[figure]}, mm"] = row[figure]
            cells[f"error of {WORDS[figure]}, µm"] = _around(error, half)
        cells["largest, % of tolerance or 6σ"] = 100 * row["worst"]
        cells |= {"Cpk": row["cpk"], "error of Cpk": row["cpk error"], "±": row["cpk error ±"]}
        rows.append(cells | {"largest source": row["dominating"]})
    return pd.DataFrame(rows)


def _around(value: float, half: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{_signed(MICRO * value)} ± {_plain(MICRO * half)}" if np.isfinite(half) else _signed(MICRO * value)


def _largest(item: Item, table: pd.DataFrame, kind: str) -> float:
    """Largest possible error of one source in any quantity of a kind, % of the scale."""
    if item.table is None:
        return np.nan
    rows = item.table[item.table.index.str.startswith(f"{kind}:")]
    if not len(rows) or rows.isna().all().all():
        return np.nan
    sizes = [(rows[f].abs() + rows[f"{f}_half"].fillna(0.0)) / table["scale"].reindex(rows.index) for f in FIGURES]
    return float(100 * np.nanmax([size.max() for size in sizes]))
