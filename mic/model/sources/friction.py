"""Friction that varies from assembly to assembly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.errors import ImpossibleSample, SceneError
from mic.model.sources.source import Source

__all__ = ["ZoneFriction"]


class ZoneFriction(Source):
    """An increase of the friction coefficients of zones, in every stage.

    It changes the contact law: every value needs contact problems of its own.
    """

    changes = "friction"

    def retain(self, rows):
        for zone in self.scene.zones:
            if zone.name in self.targets and (zone.pressure_pieces() is not None or not zone.frictional):
                raise SceneError(
                    f"{self.label}: target: zone {zone.name!r} has no constant friction to add to; give it friction"
                )

    def change(self, contacts, amplitude):
        in_zones = np.isin(contacts.zone, [i for i, zone in enumerate(self.scene.zones) if zone.name in self.targets])
        friction = np.where(in_zones, contacts.friction + amplitude, contacts.friction)
        if friction.min(initial=0.0) < 0:
            raise ImpossibleSample(f"{self.label}: friction would be {friction.min():.3g}")
        return replace(contacts, friction=friction)
