"""The page of an explanation: which sources made what was measured, how surely, and what to measure next."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from mic.report.picture import MOST_PANELS, Picture, svg
from mic.report.style import RC, number, percent
from mic.report.template import rendered
from mic.statistics.estimates import LEVEL
from mic.studies.explanation import Explanation
from mic.system.files import write_text

__all__ = ["explanation_pictures", "sentences", "write_explanation"]

NAMED = 3  # sources in a sentence
UNUSUAL = 2.0  # standard deviations: a source this far off its mean is named as a cause
#: Probability below which the scene does not explain what was measured: that of 4 σ to either side, where the limits of
#: a capable process (Cpk 1.33) are. Of 16 000 assemblies that it does explain it is denied of one.
DOUBT = 6.3e-5
FEW = 100.0  # samples that count, below which the intervals are rough
ROUGH = 0.5  # of the gauge's standard deviation: from then on it is said what the search errs by
BEFORE, AFTER = "#9aa5b1", "#0b5cad"


def write_explanation(path: str | PathLike[str], found: Explanation) -> Path:
    """Write the page of an explanation; nothing is solved."""
    page = rendered(
        "explanation.html",
        found=found,
        sentences=sentences(found),
        sources=found.table.to_dict("records"),
        further=found.further.to_dict("records"),
        pictures=explanation_pictures(found),
    )
    path = Path(path)
    write_text(path, page)
    return path


def explanation_pictures(found: Explanation) -> list[Picture]:
    """The pictures of an explanation: its sources before and after, and what they give against what was measured."""
    with matplotlib.style.context(["default", RC]):
        return [_sources(found), _reached(found)]


def sentences(found: Explanation) -> list[str]:
    """What an explanation says, the shortest first."""
    rows = found.table.to_dict("records")
    unusual = [row for row in rows if abs(row["off"]) >= UNUSUAL]
    each = ", ".join(
        f"{row['source']} at {number(row['mean'])} ({number(row['low'])} to {number(row['high'])}), "
        f"{number(abs(row['off']), 2)} σ {'above' if row['off'] > 0 else 'below'} its mean"
        for row in (unusual or rows[:1])[:NAMED]
    )
    told = [f"Most probable cause: {each}." if unusual else f"Nothing is unusual here; farthest off is {each}."]
    if found.likely < DOUBT:
        told.append(
            "The scene does not explain what was measured: its assemblies are as far off in "
            f"{percent(found.likely, 2)} of all cases. Something varies that it does not know, or the gauge is worse "
            "than stated."
        )
    for a, b in found.together[:NAMED]:
        told.append(f"{a} and {b} cannot be told apart by what was measured, only one against the other.")
    if found.untold:
        told.append(f"Hardly anything is told of {', '.join(found.untold)}.")
    if len(found.further):
        best = found.further.iloc[0]
        told.append(
            f"Measuring {best['measurement']} as well would tell most ({number(best['bits'], 2)} bits): it would take "
            f"away {percent(best['told'])} of what is left of the variance of {best['source']}."
        )
    measured = found.reached["measured"].notna().to_numpy()
    error, gauge = found.posterior.error[measured], found.reached["gauge"].to_numpy()[measured]
    worst = int((error / gauge).argmax())
    if error[worst] > ROUGH * gauge[worst]:
        told.append(
            f"Between the {found.posterior.evaluations} assemblies that were evaluated {_measured(found, worst)} is "
            f"known to {number(1e3 * error[worst], 2)} µm, its gauge to {number(1e3 * gauge[worst], 2)} µm: intervals "
            "are wider for it. Contacts change their state here, or the gauge is much finer than the sources."
        )
    if found.posterior.count < FEW:
        told.append(
            f"Only {number(found.posterior.count, 2)} samples count: the intervals are rough. Contacts change their "
            "state here, or the gauge is much finer than the sources."
        )
    return told


def _measured(found: Explanation, i: int) -> str:
    """Name of the i-th characteristic that was measured."""
    return str(found.reached["measurement"][found.reached["measured"].notna()].iloc[i])


def _sources(found: Explanation) -> Picture:
    """Each source before and after the measurement, in standard deviations of the scene."""
    own = found.table.head(MOST_PANELS)
    place = np.arange(len(own))
    mean, low, high = ((own[name] - own["prior_mean"]) / own["prior_sigma"] for name in ("mean", "low", "high"))
    fig = Figure(figsize=(10.5, 1.2 + 0.28 * len(own)), layout="constrained")
    ax = fig.subplots()
    ax.hlines(place, -1.96, 1.96, color=BEFORE, lw=7, alpha=0.5, label="before it was measured")
    ax.errorbar(mean, place, xerr=[mean - low, high - mean], fmt="o", ms=5, color=AFTER, elinewidth=2, label="after")
    ax.set_yticks(place, own["source"])
    ax.invert_yaxis()
    ax.set_xlabel("deviation from its mean (standard deviations of the scene)")
    fig.legend(loc="outside upper left", ncols=2)
    return svg(fig, "Sources", f"Lines hold the source with a probability of {100 * LEVEL:.0f} %.")


def _reached(found: Explanation) -> Picture:
    """What was measured, and what the sources that were found give."""
    own = found.reached.head(MOST_PANELS)
    place = np.arange(len(own))
    fig = Figure(figsize=(10.5, 1.2 + 0.28 * len(own)), layout="constrained")
    ax = fig.subplots()
    ax.errorbar(own["mean"], place, xerr=1.96 * own["sigma"], fmt="s", ms=5, color=AFTER, elinewidth=2, label="found")
    ax.errorbar(
        own["measured"], place + 0.2, xerr=1.96 * own["gauge"], fmt="o", ms=4, color="#c8553d", label="measured"
    )
    ax.set_yticks(place, own["measurement"])
    ax.invert_yaxis()
    ax.set_xlabel("deviation (mm)")
    fig.legend(loc="outside upper left", ncols=2)
    return svg(
        fig,
        "Key characteristics",
        "What was measured, with the gauge's interval, and what the sources give; where nothing was measured, that is "
        "a forecast.",
    )
