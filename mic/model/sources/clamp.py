"""A clamp that closes elsewhere, or pushes harder."""

from __future__ import annotations

from mic.model.sources.source import Source

__all__ = ["ClampSetting"]


class ClampSetting(Source):
    """A clamp's position along its direction, mm per unit amplitude, or its force, N, whichever it is driven by."""

    def target(self, labels):
        return {self._row(labels): 1.0}

    def push(self, labels):
        return {self._row(labels): 1.0}

    def _row(self, labels):
        return "clamp", labels["clamp"].index(self.deviation.target)
