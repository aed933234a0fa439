"""Common style and SVG output of the studies' figures."""

from __future__ import annotations

import io

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt

__all__ = ["panels", "svg"]

STYLE = {
    "font.size": 10,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "svg.hashsalt": "verification",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def panels(count: int, width: float = 5.2, height: float = 3.8, stacked: bool = False):
    """A figure of `count` panels side by side, or stacked; sizes in inches of each panel."""
    rows, columns = (count, 1) if stacked else (1, count)
    size = width * columns, height * rows
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    return figure, list(axes.ravel())


def svg(figure) -> bytes:
    """SVG of a figure, reproducible to the byte; the figure is closed."""
    buffer = io.BytesIO()
    with plt.rc_context(STYLE):
        figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    return buffer.getvalue()
