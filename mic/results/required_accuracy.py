"""Accuracy of a run: its half-widths of 95 % intervals relative to the required ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from mic.results.path_effect import SMALLEST

__all__ = ["Uncertainty", "largest_uncertainty"]

#: Name and unit of each quantity in a sentence.
QUANTITIES = {
    "six_sigma": ("6σ", "%"),
    "mean": ("the mean", "% of its 6σ"),
    "share_outside": ("the share outside the limits", "%"),
    "cpk": ("Cpk", ""),
    "mean_slip": ("the mean slip", "%"),
    "six_sigma_slip": ("6σ of the slip", "%"),
}


class Uncertainty(NamedTuple):
    """A quantity of a run and the half-width of its 95 % interval.

    Attributes
    ----------
    ratio : float
        Half-width over the required one; infinite if the interval is unknown.
    required : float
    quantity : str
        Key of :data:`QUANTITIES`.
    name : str
        Law, and key characteristic or stage and zone, as text.
    """

    ratio: float
    required: float
    quantity: str
    name: str

    @property
    def reached(self) -> bool:
        """Whether the half-width is at most the required one."""
        return self.ratio <= 1

    def sentence(self, samples: int) -> str:
        """State the accuracy that a number of samples has reached, and the remedy if it is insufficient."""
        title, unit = QUANTITIES[self.quantity]
        half, required = (_number(value, unit) for value in (self.ratio * self.required, self.required))
        subject = f"{title} of {self.name}"
        if self.reached:
            return f"{samples} samples: every required accuracy is reached; least: {subject}, ±{half} of ±{required}"
        known = f"is known to ±{half}" if math.isfinite(self.ratio) else "has no interval"
        return f"{samples} samples: {subject} {known} (required: ±{required}); increase --samples"


def largest_uncertainty(
    measurements: pd.DataFrame, zones: pd.DataFrame | None, required: Mapping[str, float]
) -> Uncertainty:
    """The quantity that is farthest from its required accuracy.

    Parameters
    ----------
    measurements, zones : DataFrame
        Best estimates of key characteristics and of zones (:func:`mic.results.headline.headline`); those of zones are
        needed for an accuracy of ``slip`` only.
    required : dict of str to float
        Half-widths by key of :class:`mic.scene.schema.Accuracy`.

    Raises
    ------
    ValueError
        If an accuracy of ``slip`` is required and the estimates of zones are missing.
    """
    found = [*_of_characteristics(measurements, required)]
    if "slip" in required:
        if zones is None:
            raise ValueError("an accuracy of slip needs the estimates of zones")
        found += _of_slips(zones, required["slip"])
    return max(found, key=lambda item: item.ratio, default=Uncertainty(math.inf, 1.0, "six_sigma", "no sample"))


def _of_characteristics(table: pd.DataFrame, required: Mapping[str, float]) -> Iterator[Uncertainty]:
    spread = table["six_sigma"]
    for quantity in required.keys() & QUANTITIES.keys():
        half = _half_width(table, quantity) / (spread if quantity in ("six_sigma", "mean") else 1.0)
        if quantity != "share_outside":
            half = half.mask(spread == 0, 0.0)
        for law, name, value in zip(table["law"], table["measurement"], half):
            yield _uncertainty(value, required[quantity], quantity, f"{name} under {law}")


def _of_slips(table: pd.DataFrame, required: float) -> Iterator[Uncertainty]:
    """Accuracy of slip, or of tangential displacement without friction; relative to at least :data:`SMALLEST`."""
    table = table[table["mean_rms_tangential"].notna()]
    for figure in ("mean", "six_sigma"):
        slip, tangential = (f"{figure}_{motion}" for motion in ("rms_slip", "rms_tangential"))
        half = _half_width(table, slip).where(table[slip].notna(), _half_width(table, tangential))
        value = table[slip].fillna(table[tangential])
        spread = table["six_sigma_rms_slip"].where(table[slip].notna(), table["six_sigma_rms_tangential"])
        half = (half / np.maximum(value, SMALLEST)).mask(spread == 0, 0.0)
        for law, stage, zone, share in zip(table["law"], table["stage"], table["zone"], half):
            yield _uncertainty(share, required, f"{figure}_slip", f"zone {zone} in stage {stage} under {law}")


def _uncertainty(half: float, required: float, quantity: str, name: str) -> Uncertainty:
    return Uncertainty(math.inf if math.isnan(half) else half / required, required, quantity, name)


def _half_width(table: pd.DataFrame, name: str) -> pd.Series:
    return 0.5 * (table[f"{name}_high"] - table[f"{name}_low"])


def _number(value: float, unit: str) -> str:
    if not unit:
        return f"{value:.3g}"
    return f"{100 * value:.3g} {unit}" if value < 1 else f"over 100 {unit}"
