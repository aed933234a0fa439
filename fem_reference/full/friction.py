"""Friction of the contacts in a stage: friction bound ``g(f_n)`` and tangential compliance.

The pressure is ``p = f_n/A``; μ(p) is the scene's table or power law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mic.errors import ArgumentError

__all__ = ["ContactFriction", "friction_of"]


@dataclass(frozen=True)
class ContactFriction:
    """Friction of m contacts.

    Attributes
    ----------
    coefficient : (m,) array
        μ.
    bounds : tuple of (int array, function)
        Contacts whose coefficient depends on pressure, and their ``function(f_n) -> (g, g')``.
    compliance : (m,) array
        1/(k_t A), mm/N: tangential compliance of a sticking contact; 0 if it is rigid.
    """

    coefficient: np.ndarray
    bounds: tuple[tuple[np.ndarray, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]], ...]
    compliance: np.ndarray

    @classmethod
    def constant(cls, coefficient: np.ndarray) -> ContactFriction:
        """Constant coefficients without tangential compliance."""
        return cls(coefficient, (), np.zeros(len(coefficient)))

    def __len__(self):
        return len(self.coefficient)

    def with_stops(self, count: int) -> ContactFriction:
        """The same with `count` more contacts without friction."""
        none = np.zeros(count)
        return ContactFriction(
            np.concatenate([self.coefficient, none]), self.bounds, np.concatenate([self.compliance, none])
        )

    def any(self) -> bool:
        """Whether any contact has friction."""
        return bool(self.bounds or self.coefficient.any())

    def slider(self, δ: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(m, d - 1) slider positions ``δ_t + f_t/(k_t A)``; δ_t if the contact is rigid."""
        return δ[:, 1:] + self.compliance[:, None] * force[:, 1:]

    def bound(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) largest tangential forces g(f_n), N, and g'(f_n), under normal forces ``f_n >= 0``."""
        g, slope = self.coefficient * normal, self.coefficient.copy()
        for contacts, function in self.bounds:
            g[contacts], slope[contacts] = function(normal[contacts])
        return g, slope


def friction_of(assembly, law, stage: str) -> ContactFriction:
    """Friction of an assembly's contacts under a law in a stage.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    law : mic.contact.laws.Law
    stage : str

    Raises
    ------
    ArgumentError
        For a law with a parameter that has no equation here.
    """
    contacts, zones = assembly.contacts, assembly.scene.zones
    m = len(contacts)
    if not law.frictional:
        return ContactFriction.constant(np.zeros(m))
    coefficient = contacts.friction_in(stage).coefficient
    if law.reads == "compliance":
        return ContactFriction(coefficient, (), contacts.compliance)
    if not law.reads:
        return ContactFriction.constant(coefficient)
    if law.reads != "pressure":
        raise ArgumentError(f"law: the full solve knows no friction that depends on the {law.reads} of a contact")
    bounds = []
    for i, zone in enumerate(zones):
        members = np.flatnonzero(contacts.zone == i)
        if zone.friction_table is not None:
            bounds.append((members, _tabulated_bound(zone.friction_table, contacts.bearing[members])))
        elif zone.friction_power is not None:
            bounds.append((members, _power_law_bound(zone.friction_power, contacts.bearing[members])))
    return ContactFriction(coefficient, tuple(bounds), np.zeros(m))


def _tabulated_bound(points, area):
    pressure, mu = np.array(points).T
    slopes = np.concatenate([[0.0], np.diff(mu) / np.diff(pressure), [0.0]])

    def bound(normal):
        p = normal / area
        coefficient = np.interp(p, pressure, mu)
        return coefficient * normal, coefficient + p * slopes[np.searchsorted(pressure, p)]

    return bound


def _power_law_bound(law, area):
    def bound(normal):
        with np.errstate(divide="ignore"):
            free = law.mu0 * (normal / area / law.p0) ** -law.n
        coefficient = np.clip(free, law.mu_min, law.mu_max)
        return coefficient * normal, coefficient * np.where(coefficient == free, 1.0 - law.n, 1.0)

    return bound
