"""A part that is out of shape by so much at points of it."""

from __future__ import annotations

import numpy as np

from mic.errors import SceneError
from mic.geometry.measured_points import sheet_normals
from mic.model.sources.source import Control, Source

__all__ = ["ShapeAtPoints"]


class ShapeAtPoints(Source):
    """Deviations at points, mm per unit amplitude, along the normals of the part's mesh; see :mod:`mic.model.shape`."""

    @property
    def _group(self) -> str:
        """What the rows are called: deviations of a batch share them."""
        return self.deviation.batch or self.deviation.name

    def retain(self, rows):
        item, first = self.deviation, f"{self._group} at 0"
        if first in rows.labels["force"]:
            return
        surface = rows.surfaces[item.part]
        points = np.array(item.points)
        foot, normal = sheet_normals(surface, points)
        rows.near(self.key, item.name, item.part, points, foot)
        for i, (point, n) in enumerate(zip(foot, normal)):
            patch = rows.patch(item.part, surface.patch(point, item.radius))
            functional = rows.functional(item.part, patch, n, f"force {self._group} at {i}")
            rows.add("force", f"{self._group} at {i}", (item.part, functional, 1.0))

    def control(self, labels, rows):
        item = self.deviation
        own = labels["force"].index(f"{self._group} at 0")
        count = len(item.points)
        if item.batch is not None:
            same = [label for label in labels["force"] if label.startswith(f"{self._group} at ")]
            if len(same) != count:
                raise SceneError(
                    f"{self.key} ({item.name}): batch {item.batch!r} has {len(same)} points and this deviation "
                    f"{count}; give the deviations of one batch the same points"
                )
        noise = np.broadcast_to(np.array(item.noise), count)
        return Control(rows["force"][own : own + count], item.known, noise, item.loose)
