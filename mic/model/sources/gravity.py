"""The parts' own weight."""

from __future__ import annotations

import numpy as np

from mic.errors import SceneError
from mic.model.sources.source import Source

__all__ = ["Gravity"]

EARTH = 9806.65  # mm/s²
TONNES = 1e-12  # t/mm³ of a kg/m³


class Gravity(Source):
    """The weight of every part in its station, as a multiple of the earth's gravity.

    A row for each part reads ``ρ t g ∫ d·u dA``, N mm, and a load of 1 along it is the part's weight, spread over its
    mid-surface. The rows follow those of the clamps: like clamp forces, weights act permanently.
    """

    def retain(self, rows):
        direction = np.array(self.deviation.direction)
        for part in self.scene.parts:
            if part.density is None:
                raise SceneError(f"{self.label}: part {part.name!r} needs density, kg/m³, such as 7850: add it")
            surface, thickness = rows.surfaces[part.name], part.sheet[0]
            patch = rows.patch(part.name, surface.whole())
            label = f"{self.deviation.name} of {part.name}"
            functional = rows.functional(part.name, patch, direction, label)
            weight = TONNES * part.density * thickness * float(surface.areas.sum()) * EARTH
            rows.add("clamp", label, (part.name, functional, weight))

    def push(self, labels):
        return {("clamp", self.row(labels, part.name)): 1.0 for part in self.scene.parts}

    def row(self, labels, part: str) -> int:
        """Number of the clamp row for a part's weight."""
        return labels["clamp"].index(f"{self.deviation.name} of {part}")
