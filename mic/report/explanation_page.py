"""The page of an explanation: most probable sources of a measurement, and useful further measurements."""

from __future__ import annotations

from collections.abc import Collection
from os import PathLike
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mic.process.description import alignments
from mic.report.picture import MOST_PANELS, Picture, svg, wide
from mic.report.style import RC, number, percent
from mic.report.template import render
from mic.statistics.estimates import LEVEL
from mic.studies.explanation import Explanation
from mic.system.files import write_text

__all__ = ["explanation_pictures", "sentences", "write_explanation"]

NAMED = 3  # sources in a sentence
UNUSUAL = 2.0  # standard deviations: a source farther from its mean is named as a cause
#: Probability below which the scene does not explain the measurement: that of ±4 σ, the limits of a capable process
#: (Cpk 1.33). One in 16 000 explained assemblies is rejected.
DOUBT = 6.3e-5
FEW = 100.0  # effective samples: with fewer the intervals are rough
ROUGH = 0.5  # of the gauge's standard deviation: larger errors of the interpolation are reported
BEFORE, AFTER = "#9aa5b1", "#0b5cad"


def write_explanation(path: str | PathLike[str], found: Explanation) -> Path:
    """Write the page of an explanation; nothing is solved."""
    page = render(
        "explanation.html",
        found=found,
        sentences=[*sentences(found), *alignments(found.scene)],
        sources=found.table.to_dict("records"),
        further=found.further.to_dict("records"),
        pictures=explanation_pictures(found),
    )
    write_text(Path(path), page)
    return Path(path)


def explanation_pictures(found: Explanation) -> list[Picture]:
    """Sources before and after the measurement, and predicted against measured characteristics."""
    with matplotlib.style.context(["default", RC]):
        return [_sources(found), _reached(found)]


def sentences(found: Explanation) -> list[str]:
    """The explanation in sentences, the main result first."""
    rows = found.table.to_dict("records")
    unusual = [row for row in rows if abs(row["off"]) >= UNUSUAL]
    each = ", ".join(
        f"{row['source']} at {number(row['mean'])} ({number(row['low'])} to {number(row['high'])}), "
        f"{number(abs(row['off']), 2)} σ {'above' if row['off'] > 0 else 'below'} its mean"
        for row in (unusual or rows[:1])[:NAMED]
    )
    text = [f"Most probable cause: {each}." if unusual else f"No source is unusual; the most distant is {each}."]
    if found.likely < DOUBT:
        share = percent(found.likely, 3) if found.likely >= 1e-5 else "less than 0.001 %"
        text.append(
            f"The scene does not explain the measurement: {share} of its assemblies deviate "
            "as much. A source of variation is missing, or the gauge is worse than stated."
        )
    for a, b in found.together[:NAMED]:
        text.append(f"The measurement cannot separate {a} and {b}; it determines only a combination of them.")
    if found.untold:
        text.append(f"The measurement hardly determines {', '.join(found.untold)}.")
    if len(found.further):
        best = found.further.iloc[0]
        gain = f"remove {percent(best['told'])} of the remaining variance of {best['source']}"
        useful = f"{best['measurement']} ({number(best['bits'], 2)} bits)"
        text.append(f"The most useful further measurement is {useful}: it would {gain}.")
    measured = found.reached["measured"].notna().to_numpy()
    own, error = found.reached[measured], found.posterior.error[measured]
    gauge = own["gauge"].to_numpy()
    worst = int((error / gauge).argmax())
    if error[worst] > ROUGH * gauge[worst]:
        size, exact = f"{number(1e3 * error[worst], 2)} µm", f"{number(1e3 * gauge[worst], 2)} µm"
        text.append(
            f"The interpolation between {found.posterior.evaluations} evaluated assemblies has an error of {size} for "
            f"{own['measurement'].iloc[worst]}, with a gauge of {exact}, which widens the intervals: contacts change "
            "state here, or the gauge is much finer than the sources."
        )
    if found.posterior.count < FEW:
        text.append(
            f"Only {number(found.posterior.count, 2)} effective samples: the intervals are rough, since contacts "
            "change state here or the gauge is much finer than the sources."
        )
    return text


def _sources(found: Explanation) -> Picture:
    """Each source before and after the measurement, in standard deviations of the scene."""
    own = found.table.head(MOST_PANELS)
    fig, ax, place = _named_rows(own["source"], "deviation from its mean (standard deviations of the scene)")
    mean, low, high = ((own[name] - own["prior_mean"]) / own["prior_sigma"] for name in ("mean", "low", "high"))
    ax.hlines(place, -1.96, 1.96, color=BEFORE, lw=7, alpha=0.5, label="before")
    ax.errorbar(mean, place, xerr=[mean - low, high - mean], fmt="o", ms=5, color=AFTER, elinewidth=2, label="after")
    fig.legend(loc="outside upper left", ncols=2)
    return svg(fig, "Sources", f"Lines: {100 * LEVEL:.0f} % intervals.")


def _reached(found: Explanation) -> Picture:
    """Measured characteristics, and the prediction from the inferred sources."""
    own = found.reached.head(MOST_PANELS)
    fig, ax, place = _named_rows(own["measurement"], "deviation (mm)")
    inferred, measured = 1.96 * own["sigma"], 1.96 * own["gauge"]
    ax.errorbar(own["mean"], place, xerr=inferred, fmt="s", ms=5, color=AFTER, elinewidth=2, label="inferred")
    ax.errorbar(own["measured"], place + 0.2, xerr=measured, fmt="o", ms=4, color="#c8553d", label="measured")
    fig.legend(loc="outside upper left", ncols=2)
    text = "Measurements with the gauge's interval, and values from the inferred sources, which are predictions where "
    return svg(fig, "Key characteristics", text + "nothing was measured.")


def _named_rows(names: Collection[str], xlabel: str) -> tuple[Figure, Axes, np.ndarray]:
    """A figure with a row for each name, its axes, and the ordinates of the rows."""
    fig, ax = wide(1.2 + 0.28 * len(names))
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.set_xlabel(xlabel)
    return fig, ax, np.arange(len(names))
