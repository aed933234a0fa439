"""Friction that is not the same from assembly to assembly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.errors import ImpossibleSample, SceneError
from mic.model.sources.source import Source

__all__ = ["ZoneFriction"]


class ZoneFriction(Source):
    """What the coefficients of zones are higher by, in every stage.

    It changes the contact law, and not what drives the assembly: every value has contact problems of its own.
    """

    changes = "friction"

    def retain(self, rows):
        names = [self.deviation.target] if isinstance(self.deviation.target, str) else self.deviation.target
        for zone in self.scene.zones:
            if zone.name in names and (zone.pressure_pieces() is not None or not zone.frictional):
                raise SceneError(
                    f"{self.key} ({self.deviation.name}): target: zone {zone.name!r} has no constant friction to add "
                    "to; give it friction"
                )

    def change(self, contacts, amplitude):
        zones = [self.deviation.target] if isinstance(self.deviation.target, str) else self.deviation.target
        own = np.isin(contacts.zone, [i for i, zone in enumerate(self.scene.zones) if zone.name in zones])
        friction = np.where(own, contacts.friction + amplitude, contacts.friction)
        if friction.min(initial=0.0) < 0:
            raise ImpossibleSample(f"{self.key} ({self.deviation.name}): friction would be {friction.min():.3g}")
        return replace(contacts, friction=friction)
