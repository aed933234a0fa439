"""A part that is warmer than it was drawn."""

from __future__ import annotations

from mic.errors import SceneError
from mic.model.sources.source import Source

__all__ = ["Temperature"]


class Temperature(Source):
    """A uniform change of temperature of one part, or of all: it grows alike in all directions, free of stress."""

    def expansion(self):
        found = {}
        for part in self.scene.parts:
            if self.deviation.part in (None, part.name):
                if part.expansion is None:
                    raise SceneError(
                        f"{self.key} ({self.deviation.name}): part {part.name!r} needs expansion, 1/K, such as 1.2e-5: "
                        "add it"
                    )
                found[part.name] = part.expansion
        return found

    def retain(self, rows):
        self.expansion()  # what lacks is told before anything is computed
        if self.scene.report.fields:
            raise SceneError(
                f"{self.key} ({self.deviation.name}): fields hold no expansion; leave fields out of [report]"
            )
