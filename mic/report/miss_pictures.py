"""Pictures of rare misses: their probability and their most likely deviations."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic.report.driver_sentences import FAR
from mic.report.picture import MOST_PANELS, Picture, draw_intervals, named_panels, svg, wide
from mic.report.style import LIMIT_COLOUR, number, probability
from mic.statistics.estimates import LEVEL

__all__ = ["likeliest_miss_picture", "miss_picture"]

INK, FIRST = "#0b5cad", "#c8553d"
LIMITS = 8  # panels, for the most likely misses
BARS = 6  # deviations in a panel
MILLION = 1e6
NEVER = 1e-9  # smaller probabilities are drawn at the end of the axis


def miss_picture(table: pd.DataFrame) -> Picture | None:
    """Probability of a miss with its interval, and its first-order estimate, on a logarithmic scale."""
    if not len(table):
        return None
    own = table.head(MOST_PANELS)
    place = np.arange(len(own))
    value, low, high = (np.maximum(own[f"outside{end}"], NEVER) for end in ("", "_low", "_high"))
    fig, ax = wide(1.2 + 0.32 * len(own))
    draw_intervals(ax, place, MILLION * value, MILLION * low, MILLION * high, ms=5, color=INK, label="simulated")
    known = own["first_order"].notna().to_numpy()
    first = MILLION * np.maximum(own["first_order"][known], NEVER)
    ax.plot(first, place[known], "D", ms=5, mfc="white", color=FIRST, ls="", label="first order")
    ax.set_yticks(place, [name or "any limit" for name in own["measurement"]])
    ax.set(xscale="log", ylim=(len(own) - 0.5, -0.5), xlabel="outside limits, ppm")
    fig.legend(loc="outside upper left", ncols=2)
    row = own.iloc[0]
    share = probability(row["outside"], row["outside_low"], row["outside_high"])
    text = (
        f"Share outside limits, {row['measurement'] or 'any limit'}: {share}. Lines: {100 * LEVEL:.0f} % intervals. "
        f"{own['evaluations'].sum()} evaluations."
    )
    return svg(fig, "Probability of a miss", text)


def likeliest_miss_picture(points: pd.DataFrame) -> Picture | None:
    """Deviations at the most likely miss of each limit, in standard deviations."""
    near = points[points["found"].astype(bool) & (points["beta"] < FAR)]
    limits = near.drop_duplicates(["measurement", "limit"]).sort_values("beta", kind="stable").head(LIMITS)
    if not len(limits):
        return None
    rows = limits.to_dict("records")
    titles = [f"{row['measurement']}, {row['limit']}: β = {number(row['beta'])}" for row in rows]
    fig, axes = named_panels(titles, 4, 1.9, "deviation from its mean (σ)")
    for ax, one in zip(axes, rows):
        own = near[(near["measurement"] == one["measurement"]) & (near["limit"] == one["limit"])]
        own = own.sort_values("share", ascending=False, kind="stable").head(BARS)
        ax.axvline(0, color="#58626e", lw=0.8)
        ax.barh(np.arange(len(own)), own["sigmas"], color=LIMIT_COLOUR, alpha=0.75, height=0.6)
        ax.set_yticks(np.arange(len(own)), own["deviation"])
        ax.invert_yaxis()
    text = (
        f"The most likely assembly outside each limit, at a distance of β standard deviations; at most {BARS} "
        "deviations, the most important first."
    )
    return svg(fig, "Most likely misses", text)
