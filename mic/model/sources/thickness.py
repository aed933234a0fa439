"""A sheet that is thicker or thinner than drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.errors import ImpossibleSample, SceneError
from mic.model.sources.source import Source

__all__ = ["REACH", "SheetThickness"]

REACH = 6.0  # standard deviations about the mean for which the compliance is computed
LEAST, MOST = 0.5, 2.0  # allowed thickness within that range, relative to the part's
NARROW = 0.01  # smallest half-width of the range, relative to the thickness


class SheetThickness(Source):
    """A change of a sheet's thickness, mm per unit amplitude.

    It changes the compliance: every value needs contact problems of its own. Both faces of the part move by half of
    it, or one of them by all of it if the other skin stays.
    """

    changes = "compliance"

    def __init__(self, deviation, key, scene):
        super().__init__(deviation, key, scene)
        self.part = next(part for part in scene.parts if part.name == deviation.part)

    def retain(self, rows):
        for key in ("stiffness", "compliance"):
            if getattr(self.part, key) is not None:
                raise SceneError(
                    f"{self.label}: part: {self.part.name!r} has its {key} from a file, which holds for one thickness; "
                    f"remove the deviation, or the part's {key}"
                )
        if self.scene.report.fields:
            raise SceneError(
                f"{self.label}: fields are computed at the nominal thickness only; leave fields out of [report]"
            )
        t = self.part.sheet[0]
        for what, (low, high) in self._changes.items():
            if not (LEAST * t <= t + low and t + high <= MOST * t):
                raise SceneError(
                    f"{self.label}: {what} from {t + low:.4g} to {t + high:.4g} mm, and part {self.part.name!r} is "
                    f"{t:g} mm thick; between {LEAST:g} and {MOST:g} times that can be computed: correct the values "
                    "(all in mm), or give truncated"
                )

    @property
    def _changes(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest change of thickness, mm, by the scene values that imply them."""
        item, table = self.deviation, self.scene.monte_carlo.values
        low, high = item.mean - REACH * item.sigma, item.mean + REACH * item.sigma
        if item.truncated is not None:
            low, high = max(low, item.truncated[0]), min(high, item.truncated[1])
        changes = {f"mean and sigma: {REACH:g} sigma about the mean lead": (low, high)}
        if table is not None:
            column = np.array(table)[:, [one.name for one in self.scene.deviations].index(item.name)]
            changes["the samples of the table lead"] = (float(column.min()), float(column.max()))
        return changes

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest thickness that samples may have, mm."""
        t = self.part.sheet[0]
        lows, highs = zip(*self._changes.values())
        middle, half = 0.5 * (min(lows) + max(highs)), 0.5 * (max(highs) - min(lows))
        half = max(half, NARROW * t)
        return t + middle - half, t + middle + half

    def thickening(self):
        return {self.deviation.part: self.deviation.skin}

    def change(self, contacts, amplitude):
        t, young, _ = self.part.sheet
        if t + amplitude <= 0.0:
            raise ImpossibleSample(f"{self.label}: thickness would be {t + amplitude:.3g} mm")
        touching = [self.part.name in zone.parts for zone in self.scene.zones]
        affected = contacts.watched & np.array(touching, dtype=bool)[contacts.zone]
        layer = np.where(affected, contacts.layer + amplitude / (2 * young * contacts.area), contacts.layer)
        return replace(contacts, layer=layer)
