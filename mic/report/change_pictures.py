"""Pictures of changes: before and after, remedies, process orders, the search of an optimum."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.special import ndtri

from mic.report.picture import MOST_PANELS, Picture, draw_intervals, draw_limits, named_panels, svg, wide
from mic.report.style import number, percent
from mic.scene import Scene
from mic.statistics.estimates import LEVEL

__all__ = ["AFTER", "BEFORE", "change_picture", "order_picture", "remedy_picture", "search_trail"]

BEFORE, AFTER = "#58626e", "#0b5cad"
FIGURES = (("mean", "mean"), ("six_sigma", "6σ"))


def change_picture(table: pd.DataFrame) -> Picture | None:
    """Changes of mean and 6σ of each key characteristic with their intervals, in per cent of the tolerance."""
    own = table[table["tolerance"].notna()]
    if not len(own):
        return None
    size = own[["mean_change", "six_sigma_change"]].abs().max(axis=1) / own["tolerance"]
    own = own.loc[size.sort_values(ascending=False, kind="stable").index[:MOST_PANELS]]
    place = np.arange(len(own))
    fig, axes = wide(1.1 + 0.26 * len(own), 1, 2, sharey=True)
    for ax, (figure, word) in zip(axes, FIGURES):
        value, low, high = (100 * own[f"{figure}_change{end}"] / own["tolerance"] for end in ("", "_low", "_high"))
        ax.axvline(0, color="#58626e", lw=0.8)
        draw_intervals(ax, place, value, low, high, color=AFTER)
        ax.set_xlabel(f"change of {word} (% of the tolerance)")
        ax.set_yticks(place, own["quantity"])
    ax.set_ylim(len(own) - 0.5, -0.5)
    many = table["tolerance"].notna().sum()
    text = f"Shown are the {len(own)} largest of {many} changes. " if many > len(own) else ""
    text += f"Lines: {100 * LEVEL:.0f} % intervals of the paired difference; a line through 0 is not significant."
    return svg(fig, "Changes", text)


def remedy_picture(effects: pd.DataFrame, scene: Scene | None) -> Picture | None:
    """Mean ± 3σ of each key characteristic without and with each remedy, against its limits."""
    if not len(effects):
        return None
    own = effects[effects["fresh"] == effects["fresh"].max()]
    names = list(own.groupby("measurement", sort=False)["margin_before"].min().nsmallest(MOST_PANELS).index)
    limits = {} if scene is None else {item.name: item.bounds for item in scene.measurements}
    remedies = list(own["remedy"].unique())
    fig, axes = named_panels(names, 3, 0.8 + 0.28 * len(remedies), "mean ± 3σ (µm)", sharey=True)
    for ax, name in zip(axes, names):
        rows = own[own["measurement"] == name].set_index("remedy").reindex(remedies)
        first = rows.iloc[0]
        mean = 1e3 * np.array([first["mean_before"], *rows["mean"]])
        reach = 500 * np.array([first["six_sigma_before"], *rows["six_sigma"]])
        place = np.arange(len(mean))
        draw_limits(ax, limits.get(name, ()), 1e3)
        for own_rows, colour in ((slice(1, None), AFTER), (slice(1), BEFORE)):
            x, half = mean[own_rows], reach[own_rows]
            draw_intervals(ax, place[own_rows], x, x - half, x + half, color=colour)
        ax.set_yticks(place, ["scene", *remedies])
        ax.set_ylim(len(mean) - 0.5, -0.5)
    shares = [f"{name} {percent(rows['outside'].max(), 1)}" for name, rows in own.groupby("remedy", sort=False)]
    worst = own.groupby("measurement")["outside_before"].max().max()
    samples = "fresh samples" if own["fresh"].all() else "the samples of the search"
    text = f"Evaluated on {samples}; red: limits. Share outside of the worst characteristic: "
    text += f"{percent(worst, 1)} in the scene, {', '.join(shares)}."
    return svg(fig, "Effect of the remedies", text)


def order_picture(table: pd.DataFrame) -> Picture | None:
    """Largest change of mean and 6σ of any key characteristic in each process order."""
    own = table[(table["tolerance"] > 0) & (table["order"] != table["order"].iloc[0])] if len(table) else table
    if not len(own):
        return None
    orders = list(own["order"].unique())[:MOST_PANELS]
    fig, axes = wide(1.1 + 0.26 * len(orders), 1, 2, sharey=True)
    for ax, (figure, word) in zip(axes, FIGURES):
        share = 100 * own[f"{figure}_change"] / own["tolerance"]
        rows = own.loc[share.abs().groupby(own["order"], sort=False).idxmax()].set_index("order").loc[orders]
        value, error = (100 * rows[f"{figure}_{what}"] / rows["tolerance"] for what in ("change", "error"))
        half = float(ndtri(0.5 + LEVEL / 2)) * error
        ax.axvline(0, color="#58626e", lw=0.8)
        draw_intervals(ax, np.arange(len(rows)), value, value - half, value + half, color=AFTER)
        for place, (x, name) in enumerate(zip(value, rows["quantity"])):
            ax.annotate(name, (x, place), xytext=(0, 4), textcoords="offset points", ha="center", fontsize=7)
        ax.margins(x=0.12)
        ax.set_xlabel(f"largest change of {word} (% of the tolerance)")
    axes[0].set_yticks(range(len(orders)), orders)
    axes[0].set_ylim(len(orders) - 0.5, -0.7)
    text = (
        f"Changes against the stated order on the same {int(own['samples'].min())} samples, for the key characteristic "
        f"that changes most. Lines: {100 * LEVEL:.0f} % intervals."
    )
    return svg(fig, "Effect of the process order", text)


def search_trail(trail: pd.DataFrame, objective: str) -> Picture | None:
    """The objective of the best design against the number of evaluations."""
    if not len(trail):
        return None
    fig, ax = wide(2.6)
    ax.step(trail["evaluations"], trail["objective"], where="post", color=AFTER, lw=1.6, marker="o", ms=3)
    ax.set(xlabel="evaluations of an assembly", ylabel=objective)
    first, last = trail["objective"].iloc[0], trail["objective"].iloc[-1]
    text = f"Best value on the samples of the search, from {number(first)} to {number(last)}; fresh samples confirm it."
    return svg(fig, "Search for the optimum", text)
