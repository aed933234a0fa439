"""Pictures of contributors, of sensitivities and of the effect of friction, from the tables of these studies."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic.report.picture import MOST_PANELS, Picture, draw_intervals, named_panels, svg, wide
from mic.report.style import number, percent
from mic.studies.friction import HOLDS

__all__ = ["contributor_picture", "friction_effect_picture", "sensitivity_picture"]

ALONE, TOGETHER, LINEAR = "#0b5cad", "#9cc3e8", "#c8553d"
BARS = 6  # contributors or inputs in a panel, the largest ones
FACTORS = ("#c8553d", "#8a94a0", "#0b5cad", "#2a9d8f", "#b26a00")  # by factor of friction


def contributor_picture(table: pd.DataFrame, linearity: pd.DataFrame) -> Picture | None:
    """First and total indices of the largest contributors of each key characteristic, with their linear shares."""
    least_linear = linearity[linearity["interaction"].notna()].sort_values("r_squared", kind="stable")
    if not len(least_linear):
        return None
    rows = least_linear.head(MOST_PANELS).sort_index().to_dict("records")
    titles = [row["measurement"] + ("" if row["linear"] else ": not linear") for row in rows]
    fig, axes = named_panels(titles, 4, 1.9, "share of the variance")
    for ax, row in zip(axes, rows):
        own = table[(table["law"] == row["law"]) & (table["measurement"] == row["measurement"])]
        own = own.dropna(subset=["total"]).sort_values("total", ascending=False, kind="stable").head(BARS)
        place = np.arange(len(own))
        low, high = (own["total"] - own["total_low"]).clip(0), (own["total_high"] - own["total"]).clip(0)
        ax.barh(place, own["total"].clip(0), color=TOGETHER, height=0.7, label="with interactions")
        ax.barh(place, own["first"].clip(0), color=ALONE, height=0.4, label="alone")
        ax.errorbar(own["total"].clip(0), place, xerr=[low, high], fmt="none", ecolor="#1b1f24", elinewidth=0.9)
        ax.plot(own["regression"], place, "D", ms=4, mfc="white", color=LINEAR, label="regression")
        ax.plot(own["tangent"], place, "|", ms=9, mew=1.6, color=LINEAR, label="derivatives at the mean")
        ax.set_yticks(place, own["contributor"])
        ax.invert_yaxis()
        ax.set_xlim(0, 1.05)
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    least = least_linear.iloc[0]
    caption = f"First index (dark) and total index (light, with its interval) of at most {BARS} contributors; "
    caption += "red: linear analyses."
    if least["r_squared"] == least["r_squared"]:
        caption += f" {least['measurement']} is the least linear, R² {percent(least['r_squared'], 1)}."
    return svg(fig, "Contributors to the key characteristics", caption)


def sensitivity_picture(table: pd.DataFrame) -> Picture | None:
    """Effect of a step of the most influential inputs on each key characteristic."""
    size = table.assign(size=table["effect"].abs())
    shown = list(size.groupby("measurement", sort=False)["size"].max().nlargest(MOST_PANELS).index)
    shown = [name for name in table["measurement"].unique() if name in set(shown)]
    if not shown:
        return None
    fig, axes = named_panels(shown, 4, 1.9, "change (µm)")
    for ax, name in zip(axes, shown):
        own = size[size["measurement"] == name].sort_values("size", ascending=False, kind="stable").head(BARS)
        place = np.arange(len(own))
        ax.axvline(0, color="#58626e", lw=0.8)
        ax.barh(place, 1e3 * own["effect"], color=TOGETHER, height=0.6, label="at the mean assembly")
        low, high = 1e3 * own["effect_low"], 1e3 * own["effect_high"]
        ax.hlines(place, low, high, color=ALONE, lw=2.2, label="over the samples")
        one_sided = (own["effect_above"] - own["effect_below"]).abs() > 1e-3 * own["size"]
        for side, mark in (("below", "<"), ("above", ">")):
            ends = 1e3 * own.loc[one_sided, f"effect_{side}"]
            if len(ends):
                label = f"{side} a contact change"
                ax.plot(ends, place[one_sided], mark, ms=5, mfc="white", color=LINEAR, ls="", label=label)
        ax.set_yticks(place, [f"{row['input']} ({number(row['step'], 2)})" for row in own.to_dict("records")])
        ax.invert_yaxis()
    handles = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels())}
    fig.legend(handles.values(), handles.keys(), loc="outside upper left", ncols=4)
    most = size.iloc[int(size["size"].to_numpy().argmax())]
    caption = (
        f"At most {BARS} inputs each, with their step in brackets (mm, N or 1). Largest effect: {most['input']} on "
        f"{most['measurement']}, {number(1e3 * most['effect'])} µm for {number(most['step'], 2)}."
    )
    return svg(fig, "Sensitivity to each input", caption)


def friction_effect_picture(effects: pd.DataFrame) -> Picture | None:
    """Changes of mean and 6σ of each key characteristic with scaled friction, relative to its 6σ."""
    whole = effects[(effects["zone"] == "") & (effects["six_sigma"] > 0)]
    if not len(whole):
        return None
    figures = ("mean_change", "six_sigma_change")
    size = (whole[[*figures]].abs().max(axis=1) / whole["six_sigma"]).groupby(whole["measurement"], sort=False).max()
    names = list(size.nlargest(MOST_PANELS).index)
    factors = sorted(whole["factor"].unique())
    fig, axes = wide(1.4 + 0.4 * len(names), 1, 2, sharey=True)
    for ax, (figure, word) in zip(axes, zip(figures, ("mean", "6σ"))):
        ax.axvspan(-100 * HOLDS, 100 * HOLDS, color="#e8edf2", label="insignificant")
        ax.axvline(0, color="#58626e", lw=0.8)
        for j, (factor, colour) in enumerate(zip(factors, FACTORS)):
            own = whole[whole["factor"] == factor].set_index("measurement").reindex(names)
            value, low, high = (100 * own[f"{figure}{end}"] / own["six_sigma"] for end in ("", "_low", "_high"))
            place = np.arange(len(names)) + 0.2 * (j - (len(factors) - 1) / 2)
            draw_intervals(ax, place, value, low, high, color=colour, label=f"× {factor:g}")
        ax.set_yticks(range(len(names)), names)
        ax.set_xlabel(f"change of {word} (% of 6σ)")
    axes[0].invert_yaxis()
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=len(factors) + 1)
    many = whole["measurement"].nunique()
    text = f"Shown are the {len(names)} most affected of {many}. " if many > len(names) else ""
    text += f"All friction scaled, on the same samples; grey: changes below {percent(HOLDS)} of 6σ."
    return svg(fig, "Effect of friction", text)
