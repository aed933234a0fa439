"""Picture of error against cost of all versions."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg

from verification.plots import panels

__all__ = ["front", "picture"]

LOWEST = 1e-4  # smaller errors are drawn at the lower edge
DIRECTIONS = [(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 16, endpoint=False)]


def front(seconds, error) -> list[int]:
    """Positions of the Pareto-optimal versions in cost and error, in order of cost."""
    kept, best = [], np.inf
    for i in np.lexsort((error, seconds)):
        if error[i] < best:
            best = error[i]
            kept.append(int(i))
    return kept


def picture(panels_of: dict[str, pd.DataFrame]):
    """Figure with a panel for each scene and one for the worst of all.

    Parameters
    ----------
    panels_of : dict of str to DataFrame
        By title: columns ``knob``, ``value``, ``seconds``, ``error``, ``half``.
    """
    figure, axes = panels(len(panels_of), 9.0, 5.2, stacked=True)
    knobs = list(dict.fromkeys(knob for table in panels_of.values() for knob in table["knob"]))
    look = {knob: (f"C{i % 10}", mark) for i, (knob, mark) in enumerate(zip(knobs, "osDP^vX<>hpd"))}
    look |= {"setting": ("k", "*")}
    for axis, (title, table) in zip(axes, panels_of.items()):
        error = np.maximum(table["error"].to_numpy(), LOWEST)
        seconds = table["seconds"].to_numpy()
        for knob, own in table.groupby("knob", sort=False):
            at = table.index.get_indexer(own.index)
            half = np.nan_to_num(own["half"].to_numpy())
            low = np.minimum(half, error[at] - 0.5 * LOWEST)
            colour, mark = look[knob]
            axis.errorbar(
                seconds[at],
                error[at],
                yerr=[low, half],
                fmt=mark,
                ms=13 if knob == "setting" else 6,
                color=colour,
                elinewidth=0.6,
                alpha=0.9,
                label=knob,
                zorder=4 if knob == "setting" else 2,
            )
        kept = front(seconds, error)
        axis.plot(seconds[kept], error[kept], "k-", lw=1.2, zorder=1, label="Pareto front")
        axis.set(xscale="log", yscale="log", title=title, xlabel="CPU time of a whole answer without caches, s")
        axis.set_ylim(0.5 * LOWEST, 2 * max(1.0, error.max()))
        axis.margins(x=0.2)
        axis.set_ylabel("error of 6σ, largest (bars: 95 %)")
    handles, names = axes[0].get_legend_handles_labels()
    axes[0].legend(handles, names, loc="center left", bbox_to_anchor=(1.02, 0.5), fontsize=8)
    canvas = FigureCanvasAgg(figure)  # measures texts
    canvas.draw()
    figure.set_layout_engine("none")  # a later layout would move the axes below their labels
    for axis, table in zip(axes, panels_of.values()):
        error = np.maximum(table["error"].to_numpy(), LOWEST)
        _label(axis, canvas.get_renderer(), table["seconds"].to_numpy(), error, list(table["value"]))
    return figure


def _label(axis, renderer, x, y, words) -> None:
    """Label points; each label takes the first free place around its point, with a line to it if that is far."""
    points = axis.transData.transform(np.column_stack([x, y]))
    scale, gap = axis.figure.dpi / 72, 1.5 * axis.figure.dpi / 72
    taken = [(px - 6 * scale, py - 6 * scale, px + 6 * scale, py + 6 * scale) for px, py in points]
    frame = axis.get_window_extent(renderer)
    for (px, py), word in sorted(zip(points, words), key=lambda item: -item[0][1]):
        text = axis.text(0, 0, word, fontsize=6.5, transform=None, va="center", ha="center")
        box = text.get_window_extent(renderer)
        for radius, (dx, dy) in itertools.product(np.arange(1.0, 16.0) * 7 * scale, DIRECTIONS):
            cx, cy = px + dx * (radius + box.width / 2), py + dy * radius
            half = box.width / 2 + gap, box.height / 2 + gap / 2
            place = (cx - half[0], cy - half[1], cx + half[0], cy + half[1])
            inside = frame.x0 < place[0] and place[2] < frame.x1 and frame.y0 < place[1] and place[3] < frame.y1
            if inside and not any(_overlap(place, other) for other in taken):
                break
        taken.append(place)
        text.remove()
        (tx, ty), anchor = axis.transAxes.inverted().transform([(cx, cy)])[0], (0.5, 0.5)
        axis.annotate(
            word,
            axis.transData.inverted().transform((px, py)),
            (tx, ty),
            textcoords="axes fraction",
            fontsize=6.5,
            va="center",
            ha="center",
            arrowprops={"arrowstyle": "-", "lw": 0.4, "color": "0.6", "relpos": anchor, "shrinkA": 0, "shrinkB": 2},
        )


def _overlap(a, b) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
