"""Colours of laws, states, parts and zones in all pictures, and number formats."""

from __future__ import annotations

import numpy as np

from mic.contact.laws import LAWS
from mic.contact.states import STATES
from mic.geometry.normals import Rule

__all__ = [
    "INSIDE",
    "LAWS",
    "LIMIT_COLOUR",
    "MARK_COLOURS",
    "OUTSIDE",
    "RC",
    "RULE_COLOURS",
    "RULE_WORDS",
    "STATE_COLOURS",
    "STATE_DOTS",
    "STATE_WORDS",
    "VERDICT_COLOURS",
    "change",
    "micrometres",
    "signed_micrometres",
    "number",
    "part_colour",
    "percent",
    "probability",
    "zone_colour",
]


STATE_COLOURS = dict(zip(STATES, ("#dfe4ea", "#56a37c", "#c8553d")))
STATE_DOTS = STATE_COLOURS | {"open": "#8a94a0"}  # single pairs: open ones must be visible on white
STATE_WORDS = dict(zip(STATES, ("open", "sticking", "slipping")))
LIMIT_COLOUR = "#b00020"
INSIDE, OUTSIDE = "#2f7d4f", "#c1121f"  # of limits
VERDICT_COLOURS = {"accepted": INSIDE, "open": "#b26a00", "rejected": OUTSIDE}
MARK_COLOURS = {
    "locator": "#1b1f24",
    "clamp": "#c1121f",
    "weld": "#f4d35e",
    "measurement": "#ffffff",
    "force": "#2a9d8f",
}
RULE_COLOURS = dict(zip(Rule, ("#6a8fb5", "#8fbf9a", "#dfe4ea", "#c8553d")))
RULE_WORDS = dict(zip(Rule, ("given", "estimated from the edges", "flat", "refused: angle too large")))
PART_COLOURS = ("#a3c0dc", "#e3d1ab", "#b6cfae", "#cdb5cf", "#d8b0a4", "#a9cccb")
ZONE_COLOURS = ("#b3168a", "#0a8f5b", "#e08a00", "#3b4cc0", "#7a4a1e", "#008fb3", "#8a2be2", "#6f7f00")

MICROMETRE = 1e-3  # mm
#: Matplotlib settings of every picture; all others have their defaults.
RC = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Arial"],  # the first for drawing, the second for readers of SVG
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#58626e",
    "axes.grid": True,
    "grid.color": "#e8ebef",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titley": 1.0,  # saves matplotlib's search for text above the axes, a tenth of the drawing time
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "svg.hashsalt": "mic",  # reproducible files
    "svg.fonttype": "none",  # searchable text, and smaller files
}


def part_colour(i: int) -> str:
    """Colour of the scene's i-th part."""
    return PART_COLOURS[i % len(PART_COLOURS)]


def zone_colour(i: int) -> str:
    """Colour of the scene's i-th contact zone."""
    return ZONE_COLOURS[i % len(ZONE_COLOURS)]


def percent(value: float, digits: int = 0) -> str:
    """A share in per cent; ``–`` for NaN."""
    if np.isnan(value):
        return "–"
    text = f"{100 * value:.{digits}f}"
    return (text if float(text) else text.lstrip("-")).replace("-", "−") + " %"


def probability(value: float, low: float | None = None, high: float | None = None) -> str:
    """A probability with its interval, in per cent from 1 % on, else in ppm: ``25 ppm (10 to 60)``."""
    large = value >= 0.01
    text = lambda x: percent(x, 1) if large else number(1e6 * x, 2)
    interval = "" if low is None or high is None else f" ({text(low)} to {text(high)})"
    return text(value) + ("" if large else " ppm") + interval


def change(value: float | None, share: float | None = None) -> str:
    """A change (mm) in µm and, if known, its share in per cent; ``≤ 1 µm`` for small ones, ``–`` for None and NaN."""
    if value is None or np.isnan(value):
        return "–"
    text = "≤ 1 µm" if abs(value) <= MICROMETRE else f"{'+' * (value > 0)}{number(1e3 * value, 2)} µm"
    if share is None or np.isnan(share):
        return text
    relative = percent(share, 1)
    return f"{text} ({'+' * (share > 0 and relative != '0.0 %')}{relative})"


def micrometres(value: float) -> str:
    """An error (mm) in µm; ``–`` for NaN."""
    return "–" if np.isnan(value) else "< 0.01" if value < 1e-5 else number(1e3 * value, 2)


def signed_micrometres(value: float) -> str:
    """A change (mm) in µm, with its sign; ``–`` for NaN."""
    return f"{'+' if value > 0 else ''}{number(1e3 * value, 2)}"


def number(value: float | None, digits: int = 3) -> str:
    """A number with significant digits, without exponent where possible; ``–`` for None and NaN."""
    if value is None or np.isnan(value):
        return "–"
    value = float(value)
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        exponent = int(f"{value:.{digits - 1}e}".split("e")[1])  # of the rounded value
        return f"{value:.{max(0, digits - 1 - exponent)}f}".replace("-", "−")
    return f"{value:.{digits - 1}e}".replace("-", "−")
