"""How much friction a contact has in a stage: its bound ``g(f_n)``, and how far it yields before it slips.

Pressure is ``p = f_n/A``; μ(p) is read from the scene's keys as they stand, point by point or as a power.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["ContactFriction", "friction_of"]


@dataclass(frozen=True)
class ContactFriction:
    """Friction of m contacts.

    Attributes
    ----------
    coefficient : (m,) array
        μ.
    bounds : tuple of (int array, function)
        Contacts whose coefficient depends on the normal force instead, and ``function(f_n) -> (g, g')`` of theirs.
    compliance : (m,) array
        1/(k_t A), mm/N: a contact that sticks has this tangential compliance; 0 where it does not yield.
    """

    coefficient: np.ndarray
    bounds: tuple[tuple[np.ndarray, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]], ...]
    compliance: np.ndarray

    @classmethod
    def constant(cls, coefficient: np.ndarray) -> ContactFriction:
        """One coefficient each, and nothing else."""
        return cls(coefficient, (), np.zeros(len(coefficient)))

    def __len__(self):
        return len(self.coefficient)

    def with_stops(self, count: int) -> ContactFriction:
        """The same, with so many more contacts that have none."""
        none = np.zeros(count)
        return ContactFriction(
            np.concatenate([self.coefficient, none]), self.bounds, np.concatenate([self.compliance, none])
        )

    def any(self) -> bool:
        """Whether any contact may hold anything by friction."""
        return bool(self.bounds or self.coefficient.any())

    def slider(self, δ: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(m, d - 1) where the sliders of contacts (m, d) stand: ``δ_t + f_t/(k_t A)``, the contacts themselves where
        nothing yields."""
        return δ[:, 1:] + self.compliance[:, None] * force[:, 1:]

    def bound(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) largest tangential forces g(f_n), N, and g'(f_n), under normal forces ``f_n >= 0``."""
        g, slope = self.coefficient * normal, self.coefficient.copy()
        for own, function in self.bounds:
            g[own], slope[own] = function(normal[own])
        return g, slope


def friction_of(assembly, law, stage: str) -> ContactFriction:
    """Friction of an assembly's contacts under a law in a stage.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    law : mic.contact.laws.Law
    stage : str
    """
    contacts, zones = assembly.contacts, assembly.scene.zones
    m = len(contacts)
    if not law.frictional:
        return ContactFriction.constant(np.zeros(m))
    coefficient = contacts.friction_in(stage).coefficient
    if law.reads == "compliance":
        return ContactFriction(coefficient, (), contacts.compliance)
    if law.reads != "pressure":
        return ContactFriction.constant(coefficient)
    bounds = []
    for i, zone in enumerate(zones):
        own = np.flatnonzero(contacts.zone == i)
        if zone.friction_table is not None:
            bounds.append((own, _by_points(zone.friction_table, contacts.bearing[own])))
        elif zone.friction_power is not None:
            bounds.append((own, _by_power(zone.friction_power, contacts.bearing[own])))
    return ContactFriction(coefficient, tuple(bounds), np.zeros(m))


def _by_points(points, area):
    pressure, mu = np.array(points).T
    slopes = np.concatenate([[0.0], np.diff(mu) / np.diff(pressure), [0.0]])

    def bound(normal):
        p = normal / area
        coefficient = np.interp(p, pressure, mu)
        return coefficient * normal, coefficient + p * slopes[np.searchsorted(pressure, p)]

    return bound


def _by_power(law, area):
    def bound(normal):
        with np.errstate(divide="ignore"):
            free = law.mu0 * (normal / area / law.p0) ** -law.n
        coefficient = np.clip(free, law.mu_min, law.mu_max)
        return coefficient * normal, coefficient * np.where(coefficient == free, 1.0 - law.n, 1.0)

    return bound
