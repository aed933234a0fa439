"""A shape deviation of a part that is known at points."""

from __future__ import annotations

import numpy as np

from mic.errors import SceneError
from mic.model.sources.source import KnownShape, Source

__all__ = ["ShapeAtPoints"]


class ShapeAtPoints(Source):
    """Deviations at points, mm per unit amplitude, along the normals of the part's mesh; see :mod:`mic.model.shape`."""

    @property
    def _group(self) -> str:
        """Name of the rows: deviations of a batch share them."""
        return self.deviation.batch or self.deviation.name

    def retain(self, rows):
        item = self.deviation
        if f"{self._group} at 0" in rows.labels["force"]:
            return
        for i, (patch, n) in enumerate(zip(*rows.item_discs(self.key, item))):
            functional = rows.functional(item.part, patch, n, f"force {self._group} at {i}")
            rows.add("force", f"{self._group} at {i}", (item.part, functional, 1.0))

    def known_shape(self, labels, rows):
        item = self.deviation
        first = labels["force"].index(f"{self._group} at 0")
        count = len(item.points)
        if item.batch is not None:
            same = [label for label in labels["force"] if label.startswith(f"{self._group} at ")]
            if len(same) != count:
                raise SceneError(
                    f"{self.label}: batch {item.batch!r} has {len(same)} points and this deviation {count}; give the "
                    "deviations of one batch the same points"
                )
        noise = np.broadcast_to(np.array(item.noise), count)
        return KnownShape(rows["force"][first : first + count], item.known, noise, item.loose)
