"""A locator out of place."""

from __future__ import annotations

import numpy as np

from mic.errors import SceneError
from mic.model.sources.source import Source

__all__ = ["LocatorPosition"]

SQUARE = 1e-6  # cosine below which a direction counts as perpendicular to a locator's


class LocatorPosition(Source):
    """A locator moved along its direction, mm per unit amplitude; or a pin with several locators, along its own.

    Locator i, along d_i, then moves by ``d_i · d``; if the hole is out of place in its part, in the opposite sense.
    """

    def _moved(self) -> dict[str, float]:
        """Motion of each locator along its direction per unit amplitude, mm, by name."""
        item, names = self.deviation, self.targets
        moved = dict.fromkeys(names, 1.0)
        if item.direction is not None:
            along = {one.name: np.dot(one.direction, item.direction) for one in self.scene.locators}
            moved = {name: float(along[name]) for name in names}
        if all(abs(share) < SQUARE for share in moved.values()):
            raise SceneError(
                f"{self.label}: direction: it is perpendicular to that of {' and '.join(names)}, and moves nothing; "
                "correct it, or name the locators of the pin"
            )
        return moved

    def target(self, labels):
        sign = -1.0 if self.deviation.where == "part" else 1.0
        return {("locator", labels["locator"].index(name)): sign * share for name, share in self._moved().items()}

    def retain(self, rows):
        self._moved()  # raises its errors before anything is solved
