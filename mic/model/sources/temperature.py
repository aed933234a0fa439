"""A part at another temperature than drawn."""

from __future__ import annotations

from mic.errors import SceneError
from mic.model.sources.source import Source

__all__ = ["Temperature"]


class Temperature(Source):
    """A uniform change of temperature of one part, or of all: isotropic stress-free expansion."""

    def expansion(self):
        strain = {}
        for part in self.scene.parts:
            if self.deviation.part in (None, part.name):
                if part.expansion is None:
                    raise SceneError(f"{self.label}: part {part.name!r} needs expansion, 1/K, such as 1.2e-5: add it")
                strain[part.name] = part.expansion
        return strain

    def retain(self, rows):
        self.expansion()  # raises its errors before anything is solved
        if self.scene.report.fields:
            raise SceneError(f"{self.label}: fields do not include expansion; leave fields out of [report]")
