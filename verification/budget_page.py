"""An error budget on paper: its sentences, its figure and its tables.

Figures of a key characteristic are weighed by its tolerance, those of a zone's slip by the slip's own 6σ.
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
#: What a user can do about a source, keys of the scene in quotes.
REMEDIES = {
    "law": "ask for `coulomb` in `report.laws`",
    "path": "follow it closer, by a smaller `path.tolerance` or more `increments`",
    ORDER: "state the order in which things close, by `order` in the stages",
    "pairs": "leave `pairs` and `points` out of the zones, and give them a smaller `spacing_factor`",
    "mesh and element": "refine the meshes",
    STIFFNESS: 'let stiffness follow the shapes, by `stiffness = "first-order"` where it does not',
    SAMPLING: "draw more samples",
}


def printed(outcome: Outcome, law: str) -> pd.DataFrame:
    """What production prints, by quantity.

    Returns
    -------
    DataFrame
        ``mean, mean_half, six_sigma, six_sigma_half`` (mm, halves of the 95 % intervals that the samples leave),
        ``lower, upper`` (mm, NaN for slips), ``samples``.
    """
    rows = {}
    zones, own = outcome.zone_statistics, outcome.measurement_statistics
    for _, row in zones[zones["law"] == law].iterrows() if outcome.has_slip else ():
        name, suffix = f"slip:{row['stage']}:{row['zone']}", "_rms_tangential"
        rows[name] = _figures(row, suffix) | {"lower": np.nan, "upper": np.nan, "samples": row["samples"]}
    for _, row in own[own["law"] == law].iterrows():
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
    """The sources as ``summary.json`` has them."""
    found = []
    for record in records:
        table = pd.DataFrame(record["errors"]).set_index("quantity").astype(float) if record["errors"] else None
        found.append(Item(record["source"], record["how"], record["seconds"], table, record["counts"]))
    return found


def by_quantity(figures: pd.DataFrame, items: list[Item]) -> pd.DataFrame:
    """What is printed and how far it is off, by quantity, the worst first, key characteristics before slips.

    Returns
    -------
    DataFrame
        Beside the columns of :func:`printed` the sum's (`error mean`, `error mean ±`, … mm), ``scale`` (mm: tolerance,
        or the slip's 6σ), ``cpk`` as printed, ``cpk error`` and ``cpk error ±``, ``worst`` (largest possible error of
        a figure over the scale) and ``dominating``.
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
    """Of a characteristic between two limits; NaN for slips."""
    if not six_sigma > 0:
        return np.nan
    return min(row["upper"] - mean, mean - row["lower"]) / (six_sigma / 2)


def _dominating(items: list[Item], quantity: str, figure: str) -> str:
    """The source with the largest possible error of a quantity's figure among those that count."""
    sizes = {
        item.source: abs(item.table.at[quantity, figure]) + np.nan_to_num(item.table.at[quantity, f"{figure}_half"])
        for item in items
        if item.counts and item.table is not None and quantity in item.table.index
    }
    known = {source: size for source, size in sizes.items() if np.isfinite(size)}
    return max(known, key=known.__getitem__) if known else ""


def _worst(table: pd.DataFrame) -> str:
    """The key characteristic, or where there is none the slip, whose figures may be farthest off."""
    return str(table.index[0])


def budget_sentences(scene: str, table: pd.DataFrame, items: list[Item]) -> dict[str, str]:
    """How far off the figures of a scene are, which source dominates, and what is not known, for a first page."""
    found, kinds = {}, table.index.str.split(":").str[0]
    characteristics, slips = table[kinds == "measurement"], table[kinds == "slip"]
    if len(characteristics):
        mean, six_sigma = (_farthest(characteristics, figure, "of its tolerance") for figure in FIGURES)
        found["figures"] = f"{scene}: a mean may be off by {mean}; a 6σ by {six_sigma}."
        cpk = characteristics[characteristics["cpk error"].notna()]
        if len(cpk):
            row = cpk.loc[(cpk["cpk error"].abs() + cpk["cpk error ±"]).idxmax()]
            found["cpk"] = (
                f"{scene}: a Cpk may be off by {_signed(row['cpk error'])} ± {_plain(row['cpk error ±'])} "
                f"({_name(row.name)}, printed as {row['cpk']:.2f})."
            )
    moving = slips[slips["six_sigma"] > 0]
    if len(moving):
        mean, six_sigma = (_farthest(moving, figure, "of its own 6σ") for figure in FIGURES)
        found["slips"] = f"{scene}: the mean of a zone's slip may be off by {mean}; its 6σ by {six_sigma}."
    first = table.loc[_worst(table)]
    found["dominating"] = (
        f"{scene}: the source that may leave most is {first['dominating'] or 'not known'}, in the "
        f"{WORDS[first['figure']]} of {_name(first.name)}. {_what_mends(items, first)}"
    )
    unknown = [item.source for item in items if item.table is None]
    if unknown:
        found["unknown"] = f"{scene}: not estimated, and not in the sum: {', '.join(unknown)}."
    return found


def _what_mends(items: list[Item], first: pd.Series) -> str:
    """What to do about the source that leaves most, and after samples about the next."""
    source = first["dominating"]
    if source not in REMEDIES:
        return "No key of the scene mends it." if source else "Nothing is known that would mend it."
    told = f"What mends it: {REMEDIES[source]}"
    if source != SAMPLING:
        return f"{told}; more samples would not."
    other = _dominating([item for item in items if item.source != SAMPLING], str(first.name), first["figure"])
    if other not in REMEDIES:
        return f"{told}."
    return f"{told}, which leaves {other}; then {REMEDIES[other]}."


def _farthest(table: pd.DataFrame, figure: str, whole: str) -> str:
    error, half = table[f"error {figure}"], table[f"error {figure} ±"]
    name = ((error.abs() + half) / table["scale"]).idxmax()
    share = 100 / table.at[name, "scale"]
    return (
        f"{_signed(MICRO * error[name])} ± {_plain(MICRO * half[name])} µm ({_name(name)}, "
        f"{_signed(share * error[name])} ± {_plain(share * half[name])} % {whole})"
    )


def _plain(value: float) -> str:
    """Two figures, without an exponent; 0 for less than a thousandth."""
    return f"{float(f'{value:.2g}'):g}" if abs(value) >= 1e-3 else "0"


def _signed(value: float) -> str:
    text = _plain(value).replace("-", "−")
    return text if value < 0 or text == "0" else f"+{text}"


def _name(quantity: str) -> str:
    """A quantity in words."""
    kind, *rest = quantity.split(":")
    return rest[0] if kind == "measurement" else f"zone {rest[1]} in stage {rest[0]}"


def budget_figure(cases: list[tuple[str, pd.DataFrame, list[Item]]]):
    """A bar for each source, with what is unsure of it, and the sum; one row of panels for each scene.

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
    """The estimate as a bar, and about it what is unsure."""
    axis.barh(y, MICRO * value, height=0.6, color=colour)
    axis.errorbar(MICRO * value, y, xerr=MICRO * half, color=colour, lw=1.6, capsize=3, zorder=3)


def budget_rows(items: list[Item], table: pd.DataFrame) -> pd.DataFrame:
    """Source by source: errors of the worst quantity, the largest of any, cost, and how they were estimated."""
    name, rows = _worst(table), []
    for item in items:
        row = {"source": item.source if item.counts else f"{item.source} (not in the sum)"}
        for figure in FIGURES:
            known = item.table is not None and name in item.table.index
            row[f"{WORDS[figure]} of {_name(name)}, µm"] = (
                _around(item.table.at[name, figure], item.table.at[name, f"{figure}_half"]) if known else "–"
            )
        shares = [_largest(item, table, kind) for kind in ("measurement", "slip")]
        row |= dict(zip(("most of a tolerance, %", "most of a slip's 6σ, %"), shares))
        rows.append(row | {"CPU s": round(item.seconds, 1), "how": item.how})
    return pd.DataFrame(rows)


def quantity_rows(table: pd.DataFrame) -> pd.DataFrame:
    """:func:`by_quantity` as it is read: µm and shares."""
    rows = []
    for name, row in table.iterrows():
        measured = str(name).startswith("measurement:")
        cells = {"quantity": _name(str(name)), "tolerance, mm": row["scale"] if measured else np.nan}
        for figure in FIGURES:
            error, half = row[f"error {figure}"], row[f"error {figure} ±"]
            cells[f"{WORDS[figure]}, mm"] = row[figure]
            cells[f"off by, µm{' ' * FIGURES.index(figure)}"] = _around(error, half)
        cells["at most, % of tolerance or 6σ"] = 100 * row["worst"]
        cells |= {"Cpk": row["cpk"], "Cpk off by": row["cpk error"], "±": row["cpk error ±"]}
        rows.append(cells | {"most by": row["dominating"]})
    return pd.DataFrame(rows)


def _around(value: float, half: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{_signed(MICRO * value)} ± {_plain(MICRO * half)}" if np.isfinite(half) else _signed(MICRO * value)


def _largest(item: Item, table: pd.DataFrame, kind: str) -> float:
    """The largest possible error of one source in any quantity of a kind, % of what weighs it."""
    if item.table is None:
        return np.nan
    own = item.table[item.table.index.str.startswith(f"{kind}:")]
    sizes = [(own[f].abs() + own[f"{f}_half"].fillna(0.0)) / table["scale"].reindex(own.index) for f in FIGURES]
    return float(100 * np.nanmax([size.max() for size in sizes])) if len(own) and not own.isna().all().all() else np.nan
