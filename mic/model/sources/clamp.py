"""A clamp with another closed position or another force."""

from __future__ import annotations

from mic.model.sources.source import Source

__all__ = ["ClampSetting"]


class ClampSetting(Source):
    """A clamp's position along its direction, mm per unit amplitude, or its force, N, depending on how it is driven."""

    def target(self, labels):
        return {("clamp", labels["clamp"].index(name)): 1.0 for name in self.targets}

    push = target
