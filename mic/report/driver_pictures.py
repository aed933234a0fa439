"""Pictures of what drives the key characteristics."""

from __future__ import annotations

import numpy as np

from mic.report.context import Context
from mic.report.picture import MOST_PANELS, Picture, panels, svg
from mic.report.style import percent
from mic.results.outcome import Outcome
from mic.results.schema import CONTRIBUTORS, LINEARITY

__all__ = ["contributor_picture"]

ALONE, TOGETHER, LINEAR = "#0b5cad", "#9cc3e8", "#c8553d"
BARS = 6  # contributors in a panel, the largest ones


def contributor_picture(outcome: Outcome, context: Context) -> Picture | None:
    """By key characteristic, first and total indices of the largest contributors, beside their linear shares."""
    table, linearity = outcome.study(CONTRIBUTORS), outcome.study(LINEARITY)
    if table is None or linearity is None:
        return None
    told = linearity[linearity["interaction"].notna()]
    told = told.sort_values("r_squared", kind="stable").head(MOST_PANELS).sort_index()  # the least linear, if many
    if not len(told):
        return None
    columns = min(4, len(told))
    fig, axes = panels(len(told), columns, (10.5 / max(columns, 2), 1.9))
    for i, (ax, row) in enumerate(zip(axes, told.to_dict("records"))):
        own = table[(table["law"] == row["law"]) & (table["measurement"] == row["measurement"])]
        own = own.dropna(subset=["total"]).sort_values("total", ascending=False, kind="stable").head(BARS)
        place = np.arange(len(own))
        low, high = (own["total"] - own["total_low"]).clip(0), (own["total_high"] - own["total"]).clip(0)
        ax.barh(place, own["total"].clip(0), color=TOGETHER, height=0.7, label="with others")
        ax.barh(place, own["first"].clip(0), color=ALONE, height=0.4, label="alone")
        ax.errorbar(own["total"].clip(0), place, xerr=[low, high], fmt="none", ecolor="#1b1f24", elinewidth=0.9)
        ax.plot(own["regression"], place, "D", ms=4, mfc="white", color=LINEAR, label="by regression")
        ax.plot(own["tangent"], place, "|", ms=9, mew=1.6, color=LINEAR, label="at the mean")
        ax.set_yticks(place, own["contributor"])
        ax.invert_yaxis()
        ax.set_xlim(0, 1.05)
        ax.set_title(row["measurement"] + ("" if row["linear"] else ": not linear"))
        if i >= len(told) - columns:
            ax.set_xlabel("share of the variance")
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside upper left", ncols=4)
    least = told.sort_values("r_squared", kind="stable").iloc[0]
    caption = (
        f"First index (dark) and total index (light, with its interval) of at most {BARS} contributors; red, what a "
        "linear analysis says."
    )
    if least["r_squared"] == least["r_squared"]:
        caption += f" {least['measurement']} is the least linear, R² {percent(least['r_squared'], 1)}."
    return svg(fig, "What drives the key characteristics", caption)
