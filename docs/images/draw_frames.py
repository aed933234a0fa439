"""Draw the how-to's pictures of measurement frames and of a seam: ``python docs/images/draw_frames.py``."""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

NOMINAL, ACTUAL, MARK = "#9aa4af", "#1f4e9c", "#b00020"
mpl.rcParams |= {"font.size": 9, "svg.hashsalt": "mic", "svg.fonttype": "path", "font.family": "DejaVu Sans"}


def frames() -> plt.Figure:
    """A sheet in section: as it stands, on three datum points, and by best fit of five points."""
    x = np.linspace(0, 100, 201)
    bent = 3.0 + 0.05 * x + 5.0 * np.sin(np.pi * x / 100) ** 2 - 4 * np.exp(-(((x - 80) / 9) ** 2))
    at, datums = np.array([10, 30, 50, 70, 90]), np.array([10, 90])
    figure, axes = plt.subplots(1, 3, figsize=(9, 2.3), sharey=True)
    panels = {"as it stands": None, "3-2-1: datum points read zero": datums, "best fit: least squares": at}
    for panel, (title, points) in zip(axes, panels.items()):
        read = at if points is None else points
        motion = np.zeros(2)
        if points is not None:
            motion = np.linalg.lstsq(np.column_stack([points**0, points]), np.interp(points, x, bent), rcond=None)[0]
        moved = bent - motion[0] - motion[1] * x
        panel.plot(x, 0 * x, color=NOMINAL, lw=2, label="nominal")
        panel.plot(x, moved, color=ACTUAL, lw=2, label="measured assembly")
        height = np.interp(read, x, moved)
        panel.vlines(read, 0, height, color=MARK, lw=1.2)
        panel.plot(read, height, "o", color=MARK, ms=4, label="points of the frame")
        panel.set_title(title, fontsize=9)
        panel.set_axis_off()
    axes[0].lines[-1].set_label("measured points")
    axes[0].legend(frameon=False, fontsize=8, loc="lower left")
    axes[1].legend(handles=[axes[1].lines[-1]], frameon=False, fontsize=8, loc="lower left")
    axes[0].set_ylim(-9, 13)
    figure.tight_layout()
    return figure


def seam() -> plt.Figure:
    """Two sheets from above, with the points of the seam, and in section, with gap and flush."""
    figure, (above, section) = plt.subplots(1, 2, figsize=(9, 2.6), width_ratios=(1.2, 1))
    y = np.linspace(0, 80, 81)
    edge, other = 40 + 0.002 * (y - 40) ** 2, 47 + 0.002 * (y - 40) ** 2
    above.fill_betweenx(y, 0, edge, color="#cfdaea")
    above.fill_betweenx(y, other, 95, color="#e3d9c6")
    for number, height in enumerate((12, 40, 68), 1):
        start = np.interp(height, y, edge)
        nearest = np.argmin(np.hypot(other - start, y - height))
        above.plot([start, other[nearest]], [height, y[nearest]], color=MARK, lw=1.2)
        above.plot(start, height, "o", color=MARK, ms=5)
        above.plot(other[nearest], y[nearest], "o", mfc="white", mec=MARK, ms=5)
        above.annotate(f"gap-{number}", (start - 2, height), ha="right", va="center")
    above.text(8, 72, "fender")
    above.text(80, 72, "door")
    above.plot([], [], "o", color=MARK, ms=5, label="points of the list")
    above.plot([], [], "o", mfc="white", mec=MARK, ms=5, label="nearest points of the door")
    above.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(0.98, 0.5))
    section.plot([0, 40], [0, 0], color=ACTUAL, lw=5, solid_capstyle="butt")
    section.plot([52, 95], [6, 6], color="#a37f3c", lw=5, solid_capstyle="butt")
    section.annotate("", (52, -7), (40, -7), arrowprops={"arrowstyle": "<->", "color": MARK})
    section.annotate("", (46, 6), (46, 0), arrowprops={"arrowstyle": "<->", "color": MARK})
    for place, height in ((40, 0), (52, 6)):
        section.plot([place, place], [height - 1, -9], color=NOMINAL, lw=0.8)
        section.plot([min(place, 46) - 2, max(place, 46) + 2], [height, height], color=NOMINAL, lw=0.8)
    section.text(46, -11, "gap", color=MARK, ha="center", va="top")
    section.text(46, 8, "flush", color=MARK, ha="center", va="bottom")
    section.set_ylim(-20, 16)
    for panel in (above, section):
        panel.set_axis_off()
    figure.tight_layout()
    return figure


if __name__ == "__main__":
    for draw in (frames, seam):
        path = Path(__file__).with_name(f"{draw.__name__}.svg")
        draw().savefig(path, metadata={"Date": None})
        print(path)
