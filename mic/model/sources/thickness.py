"""A sheet that is thicker or thinner than it was drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.errors import ImpossibleSample, SceneError
from mic.model.sources.source import Source

__all__ = ["REACH", "SheetThickness"]

REACH = 6.0  # standard deviations about the mean for which the compliance is known
LEAST, MOST = 0.5, 2.0  # of the part's thickness: what a sheet within that reach may have
NARROW = 0.01  # of the thickness: so far on either side it is known in any case


class SheetThickness(Source):
    """A sheet's thickness, mm per unit amplitude, beyond that of its part.

    It changes the compliance, and so every value has contact problems of its own. The parts' faces move by half of it,
    away from the skin that stays.
    """

    changes = "compliance"

    def retain(self, rows):
        item = self.deviation
        part = next(one for one in self.scene.parts if one.name == item.part)
        at = f"{self.key} ({item.name})"
        for key in ("stiffness", "compliance"):
            if getattr(part, key) is not None:
                raise SceneError(
                    f"{at}: part: {part.name!r} has its {key} from a file, which holds for one thickness; take the "
                    f"deviation out, or the part's {key}"
                )
        if self.scene.report.fields:
            raise SceneError(
                f"{at}: fields are those of the thickness that the parts are drawn with; leave fields out of [report]"
            )
        t = part.sheet[0]
        for what, (low, high) in self._reaches.items():
            if not (LEAST * t <= t + low and t + high <= MOST * t):
                raise SceneError(
                    f"{at}: {what} from {t + low:.4g} to {t + high:.4g} mm, and part {part.name!r} is {t:g} mm thick; "
                    f"at least {LEAST:g} and at most {MOST:g} times that can be computed: correct them (all in mm), "
                    "or give truncated"
                )

    @property
    def _reaches(self) -> dict[str, tuple[float, float]]:
        """By how much the sheet is thicker at least and at most, mm, by what says so."""
        item, asked = self.deviation, self.scene.monte_carlo
        low, high = item.mean - REACH * item.sigma, item.mean + REACH * item.sigma
        if item.truncated is not None:
            low, high = max(low, item.truncated[0]), min(high, item.truncated[1])
        found = {f"mean and sigma: {REACH:g} sigma about the mean lead": (low, high)}
        if asked.values is not None:
            own = np.array(asked.values)[:, [one.name for one in self.scene.deviations].index(item.name)]
            found["the samples of the table lead"] = (float(own.min()), float(own.max()))
        return found

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest thickness that samples may have, mm."""
        (t,) = (part.sheet[0] for part in self.scene.parts if part.name == self.deviation.part)
        lows, highs = zip(*self._reaches.values())
        middle, half = 0.5 * (min(lows) + max(highs)), 0.5 * (max(highs) - min(lows))
        half = max(half, NARROW * t)
        return t + middle - half, t + middle + half

    def thickening(self):
        return {self.deviation.part: self.deviation.skin}

    def change(self, contacts, amplitude):
        part = next(one for one in self.scene.parts if one.name == self.deviation.part)
        t, young, _ = part.sheet
        if t + amplitude <= 0.0:
            raise ImpossibleSample(f"{self.key} ({self.deviation.name}): thickness would be {t + amplitude:.3g} mm")
        touching = [part.name in zone.parts for zone in self.scene.zones]
        own = contacts.watched & np.array(touching, dtype=bool)[contacts.zone]
        layer = np.where(own, contacts.layer + amplitude / (2 * young * contacts.area), contacts.layer)
        return replace(contacts, layer=layer)
