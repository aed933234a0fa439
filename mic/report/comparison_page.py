"""The page of a comparison: scene changes, differences with intervals, distributions, maps."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.lines import Line2D

from mic.report.change_pictures import AFTER, BEFORE, change_picture
from mic.report.picture import MOST_PANELS, Picture, draw_limits, named_panels, png, svg
from mic.report.space_pictures import draw_fields
from mic.report.style import LIMIT_COLOUR, RC, number, percent, signed_micrometres
from mic.report.template import render
from mic.results.field_changes import FieldChange
from mic.statistics.estimates import density
from mic.studies.comparison import Comparison
from mic.system.files import write_text

__all__ = ["comparison_pictures", "sentences", "write_comparison"]

NAMED = 3  # characteristics in a sentence
DRAWN = 200  # points of a density


def write_comparison(path: str | PathLike[str], found: Comparison, fields: Sequence[FieldChange] = ()) -> Path:
    """Write the page of a comparison; nothing is solved.

    Parameters
    ----------
    path : path-like
    found : Comparison
    fields : sequence of FieldChange
        Changes of the fields of the two runs, if any.
    """
    page = render(
        "comparison.html",
        found=found,
        sentences=sentences(found),
        rows=[row for row in found.table.to_dict("records") if row["quantity"]],
        pictures=comparison_pictures(found, fields),
        samples=int(found.table["samples"].iloc[0]),
        significant=_significant,
        text=_text,
    )
    write_text(Path(path), page)
    return Path(path)


def comparison_pictures(found: Comparison, fields: Sequence[FieldChange] = ()) -> list[Picture]:
    """The pictures of a comparison: changes with their intervals, distributions before and after, and maps."""
    with matplotlib.style.context(["default", RC]):
        drawn = [change_picture(found.table), _densities(found), _maps(fields) if fields else None]
    return [picture for picture in drawn if picture is not None]


def sentences(found: Comparison) -> list[str]:
    """The comparison in sentences, the main result first."""
    rows = found.table.to_dict("records")
    whole, own = rows[0], [row for row in rows if row["tolerance"] == row["tolerance"]]
    good = [1 - whole[f"outside_{side}"] for side in "ab"]
    gain, low, high = (-100 * whole[f"outside_change{end}"] for end in ("", "_high", "_low"))
    after, before = percent(good[1], 1), percent(good[0], 1)
    first = f"{after} of the assemblies are within all limits after the change, {before} before"
    if gain or low > 0 or high < 0:
        first += f" (change {number(gain, 2)} percentage points; {number(low, 2)} to {number(high, 2)})"
    text = [first + "."]
    for figure, word in (("six_sigma", "6σ"), ("mean", "mean")):
        significant = [row for row in own if _significant(row, figure)]
        significant.sort(key=lambda row: -abs(row[f"{figure}_change"]) / row["tolerance"])
        each = []
        for row in significant[:NAMED]:
            change, low, high = (
                f"{signed_micrometres(row[f'{figure}_change{end}'])} µm" for end in ("", "_low", "_high")
            )
            each.append(f"{row['quantity']} by {change} ({low} to {high})")
        rest = f", and {len(significant) - NAMED} more" if len(significant) > NAMED else ""
        changes = f"Significant changes of {word}: {', '.join(each)}{rest}."
        text.append(changes if each else f"No {word} of a key characteristic changes significantly.")
    if found.left_out:
        text.append(f"{found.left_out} samples failed on one of the two sides and are excluded.")
    if found.alone:
        text.append(f"Not compared, since only one side has them: {', '.join(found.alone)}.")
    return text


def _significant(row: dict[Any, Any], figure: str) -> bool:
    """Whether the interval of a change excludes zero."""
    return bool(row[f"{figure}_change_low"] > 0 or row[f"{figure}_change_high"] < 0)


def _text(figure: str, value: float, digits: int = 3) -> str:
    """A figure as text: mean and 6σ in µm, shares in per cent."""
    if figure == "outside":
        return percent(value, 1)
    return number(value if figure == "cpk" else 1e3 * value, digits)


def _densities(found: Comparison) -> Picture:
    """Distribution of each key characteristic before and after, with the limits of the latter."""
    own = found.table[found.table["tolerance"].notna()]
    shown = own.sort_values("cpk_b", kind="stable")["quantity"].head(MOST_PANELS)
    names = [name for name in own["quantity"] if name in set(shown)]
    items = {item.name: item for item in found.b.scene.measurements}
    fig, axes = named_panels(names, 4, 1.9, "deviation (mm)")
    for ax, name in zip(axes, names):
        values = [side.values[name].dropna().to_numpy() for side in (found.a, found.b)]
        every = np.concatenate(values)
        room = 0.15 * (np.ptp(every) or 1e-3)
        x = np.linspace(every.min() - room, every.max() + room, DRAWN)
        for one, colour in zip(values, (BEFORE, AFTER)):
            y = np.nan_to_num(density(one, x))
            ax.fill_between(x, y, color=colour, alpha=0.14, lw=0)
            ax.plot(x, y, color=colour, lw=1.3)
        draw_limits(ax, items[name].bounds)
        ax.set(yticks=[], ylim=(0, None))
    lines = (BEFORE, "before"), (AFTER, "after"), (LIMIT_COLOUR, "limits, after")
    handles = [Line2D([], [], color=colour, lw=2, label=label) for colour, label in lines]
    fig.legend(handles=handles, loc="outside upper left", ncols=3)
    least = f"Shown are the {len(names)} least capable of {len(own)} after the change. " * (len(names) < len(own))
    caption = f"{least}Densities of the common samples; before: {found.a.name}, after: {found.b.name}."
    return svg(fig, "Key characteristics, before and after", caption)


def _maps(fields: Sequence[FieldChange]) -> Picture:
    """Change of the mean displacement along the normals, and of 6σ, of every part."""
    rows = {
        "mean along the normals": {change.part: change.mean_normal for change in fields},
        "6σ": {change.part: change.six_sigma for change in fields},
    }
    shown = [(f"change of {word}", "RdBu_r", values) for word, values in rows.items()]
    fig, largest = draw_fields({change.part: change.surface for change in fields}, shown, signed=True)
    texts = [f"largest change of the {word}: {number(value)} mm on {at}" for word, (value, at) in zip(rows, largest)]
    text = "; ".join(texts) + "."
    other = [change.part for change in fields if not change.same_mesh]
    if other:
        text += f" Parts with different meshes are compared at the nearest vertices: {', '.join(other)}."
    return png(fig, "Changes of the displacement", text[0].upper() + text[1:], 100)
