"""A corrective force that shapes a part."""

from __future__ import annotations

from mic.model.sources.source import Source

__all__ = ["CorrectiveForce"]


class CorrectiveForce(Source):
    """A force at a point, N per unit amplitude."""

    def retain(self, rows):
        rows.point("force", self.key, self.deviation)

    def load(self, labels, rows):
        return rows["force"][labels["force"].index(self.deviation.name)]
