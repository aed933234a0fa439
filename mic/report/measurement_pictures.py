"""Pictures of the key characteristics: their distributions against their limits."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D

from mic.report.context import SHOWN, Context
from mic.report.picture import MOST_PANELS, Picture, draw_limits, named_panels, svg
from mic.report.style import LAWS, LIMIT_COLOUR, number, percent
from mic.results.outcome import Outcome

__all__ = ["measurement_picture"]


def measurement_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Histogram of each key characteristic with its limits; the least capable ones if there are many."""
    table = outcome.measurement_headlines
    if not len(table):
        return None
    order = list(table["measurement"].unique())
    shown = order
    if len(order) > MOST_PANELS:
        worst = table.groupby("measurement")["cpk"].min().sort_values(na_position="last").index[:MOST_PANELS]
        shown = [name for name in order if name in set(worst)]
    fig, axes = named_panels(shown, 4, 1.9, "deviation (mm)", "samples")
    characteristics = {item.name: item for item in outcome.model.scene.measurements}
    for ax, name in zip(axes, shown):
        item = characteristics[name]
        values = {law: outcome.measured(law, name, outcome.sample_numbers(law)[:SHOWN]) for law in context.laws}
        everything = np.concatenate(list(values.values())) if values else np.zeros(1)
        low, high = everything.min(), everything.max()
        edges = np.linspace(*((low, high) if high - low > 1e-12 else (low - 1e-3, high + 1e-3)), 31).tolist()
        for law, x in values.items():
            colour = LAWS[law].colour
            ax.stairs(np.histogram(x, edges)[0], edges, fill=True, fc=to_rgba(colour, 0.14), ec=colour, lw=1.2)
        draw_limits(ax, item.bounds)
        width = item.upper - item.lower
        ax.set_xlim(min(low, item.lower) - 0.04 * width, max(high, item.upper) + 0.04 * width)
    handles = [Line2D([], [], color=LAWS[law].colour, lw=2, label=law) for law in outcome.laws]
    handles.append(Line2D([], [], color=LIMIT_COLOUR, lw=1.3, label="limits"))
    fig.legend(handles=handles, loc="outside upper left", ncols=4)
    text = "" if shown == order else f"Shown are the {len(shown)} least capable of {len(order)} measurements. "
    if any(len(outcome.sample_numbers(law)) > SHOWN for law in context.laws):
        text += f"Histograms of the first {SHOWN} samples. "
    law = outcome.laws[0]
    rows = table[table["law"] == law]
    if rows["cpk"].notna().any():
        least = rows.iloc[int(rows["cpk"].argmin())]
        text += (
            f"The least capable under {law} is {least['measurement']}: Cpk {number(least['cpk'])}"
            f"{_interval(least, 'cpk', number)}, {percent(least['share_outside'], 1)} of the assemblies outside"
            f"{_interval(least, 'share_outside', lambda share: percent(share, 1))}."
        )
    return svg(fig, "Key characteristics against their limits", text)


def _interval(row, name: str, words) -> str:
    """The interval of a figure in brackets, or an empty string."""
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    return f" ({percent(row['confidence'])}: {words(low)} to {words(high)})" if low == low and high == high else ""
