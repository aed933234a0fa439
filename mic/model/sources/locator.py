"""A locator out of place."""

from __future__ import annotations

from mic.model.sources.source import Source

__all__ = ["LocatorPosition"]


class LocatorPosition(Source):
    """A locator moved along its direction, mm per unit amplitude."""

    def target(self, labels):
        return {("locator", labels["locator"].index(self.deviation.target)): 1.0}
