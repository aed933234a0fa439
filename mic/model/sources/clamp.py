"""A clamp that closes elsewhere, or pushes harder."""

from __future__ import annotations

from mic.model.sources.source import Source

__all__ = ["ClampSetting"]


class ClampSetting(Source):
    """A clamp's position along its direction, mm per unit amplitude, or its force, N, whichever it is driven by."""

    def target(self, labels):
        return self._rows(labels)

    def push(self, labels):
        return self._rows(labels)

    def _rows(self, labels):
        target = self.deviation.target
        names = [target] if isinstance(target, str) else target
        return {("clamp", labels["clamp"].index(name)): 1.0 for name in names}
