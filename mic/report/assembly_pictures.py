"""Pictures of single assemblies: predicted from measured parts, or explored interactively."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from mic.report.picture import MOST_PANELS, Picture, draw_limits, named_panels, svg, wide
from mic.report.style import INSIDE, LIMIT_COLOUR, OUTSIDE, STATE_DOTS, STATE_WORDS, VERDICT_COLOURS, number
from mic.scene import Scene
from mic.statistics.estimates import LEVEL
from mic.studies.exploration import ExploredAssembly

__all__ = ["explored", "predicted"]

ROWS = 40  # assemblies in a panel, the first ones
HALF = 1.5  # least range of the axis, in half tolerances


def predicted(table: pd.DataFrame, scene: Scene | None = None) -> Picture | None:
    """Predicted key characteristics with their intervals, coloured by verdict.

    Parameters
    ----------
    table : DataFrame
        As :func:`mic.predict` returns it.
    scene : Scene, optional
        Its limits are drawn.
    """
    shown = table[(table["measurement"] != "") & np.isfinite(table["value"])]
    rows = list(dict.fromkeys(shown["row"]))[:ROWS]
    shown = shown[shown["row"].isin(rows)]
    names = list(shown["measurement"].unique())[:MOST_PANELS]
    if not names:
        return None
    limits = {} if scene is None else {item.name: item.bounds for item in scene.measurements}
    fig, axes = named_panels(names, 3, 0.9 + 0.16 * len(rows), "deviation (mm)", "assembly", sharey=True)
    for ax, name in zip(axes, names):
        draw_limits(ax, limits.get(name, ()))
        own = shown[shown["measurement"] == name]
        for verdict, colour in VERDICT_COLOURS.items():
            some = own[own["verdict"] == verdict]
            place = np.array([rows.index(row) for row in some["row"]], dtype=float)
            ax.hlines(place, some["low"], some["high"], color=colour, lw=2)
            ax.plot(some["value"], place, "o", ms=4, color=colour)
        ax.set_yticks(range(len(rows)), [str(row) for row in rows])
        ax.set_ylim(len(rows) - 0.5, -0.5)
    handles = [Line2D([], [], color=colour, marker="o", label=word) for word, colour in VERDICT_COLOURS.items()]
    handles += [Line2D([], [], color=LIMIT_COLOUR, lw=1.3, label="limits")] if limits else []
    fig.legend(handles=handles, loc="outside upper left", ncols=4)
    whole = table[table["measurement"] == ""]["verdict"].value_counts()
    text = f"Lines: {100 * LEVEL:.0f} % intervals. {whole.sum()} assemblies: "
    return svg(fig, "Predictions", text + ", ".join(f"{count} {word}" for word, count in whole.items()) + ".")


def explored(answer: ExploredAssembly) -> Picture:
    """One assembly: contact pairs by state, and key characteristics against their limits."""
    table, points, states = answer.table.head(MOST_PANELS), answer.points, answer.states
    fig, (space, scale) = wide(max(3.2, 1.0 + 0.3 * len(table)), 1, 2)
    if len(states):
        flat = _flat(points)
        for number_, label in enumerate(STATE_DOTS):
            own = states == number_
            name = f"{STATE_WORDS[label]}: {own.sum()}"
            space.plot(*flat[own].T, "o", ms=3 if label == "open" else 5, color=STATE_DOTS[label], label=name)
        space.set_aspect("equal", adjustable="datalim")
        space.set_title(f"contact pairs after {answer.contact_stage}")
        space.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=3)
    space.set_axis_off()
    middle, half = (table["upper"] + table["lower"]) / 2, (table["upper"] - table["lower"]) / 2
    share, place = ((table["value"] - middle) / half).to_numpy(), np.arange(len(table))
    scale.axvspan(-1, 1, color="#e8edf2")
    scale.axvline(0, color="#58626e", lw=0.8)
    scale.scatter(share, place, c=[INSIDE if one else OUTSIDE for one in table["within"]], s=40, zorder=3)
    for x, y, value in zip(share, place, table["value"]):
        if np.isfinite(x):
            scale.annotate(f"{number(value)} mm", (x, y), xytext=(0, 6), textcoords="offset points", ha="center")
    scale.set_yticks(place, table["measurement"])
    most = max(HALF, 1.15 * float(np.nanmax(np.abs(share), initial=0.0)))
    scale.set(xlim=(-most, most), ylim=(len(table) - 0.5, -0.7), title="key characteristics")
    scale.set_xlabel("distance from the middle of the limits, in half tolerances")
    text = f"{answer.said} " + ("Preliminary, with a coarse path. " if answer.preliminary else "")
    text += f"{int(table['within'].sum())} of {len(table)} key characteristics within their limits."
    return svg(fig, "One assembly", text)


def _flat(points: np.ndarray) -> np.ndarray:
    """(m, 2) coordinates of (m, 3) points: the two with the largest range."""
    return np.asarray(points[:, np.sort(np.argsort(np.ptp(points, axis=0), kind="stable")[1:])])
