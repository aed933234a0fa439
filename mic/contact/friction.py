"""Friction data of each contact; a law uses the fields that it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

__all__ = ["Friction", "finite"]


@dataclass(frozen=True)
class Friction:
    """Friction of m contacts.

    Attributes
    ----------
    coefficient : (m,) array
        μ of the laws with a constant coefficient.
    pressure : (m, q, 5) array or None
        μ as a piecewise function of the normal force, see :mod:`mic.contact.laws.pressure_dependent`.  None if it is
        constant.
    compliance : (m,) array or None
        Tangential compliance ``c = 1/(k_t A)`` in series with the slider [length / force], for
        :mod:`mic.contact.laws.micro_slip`.  None for rigid contacts.
    """

    coefficient: np.ndarray
    pressure: np.ndarray | None = None
    compliance: np.ndarray | None = None

    @classmethod
    def of(cls, value, contacts: int) -> Friction:
        """Checked friction, from a number, one coefficient per contact, or another :class:`Friction`.

        Raises
        ------
        ValueError
            Naming the field that has the wrong shape, is not finite, or is negative.
        """
        if not isinstance(value, Friction):
            return cls(_checked("mu", value, contacts))
        coefficient, pressure = _checked("mu", value.coefficient, contacts), value.pressure
        compliance = None if value.compliance is None else _checked("compliance", value.compliance, contacts)
        if pressure is not None:
            pressure = np.asarray(pressure, dtype=float)
            if pressure.ndim != 3 or pressure.shape[::2] != (contacts, 5) or not pressure.shape[1]:
                raise ValueError(f"pressure must have the shape ({contacts}, pieces, 5); got {pressure.shape}")
        return replace(value, coefficient=coefficient, pressure=pressure, compliance=compliance)

    def __len__(self):
        return len(self.coefficient)

    def take(self, own: np.ndarray) -> Friction:
        """Friction of a subset of the contacts, given as a mask or as indices."""
        return self._mapped(lambda values: values[own])

    def padded(self, count: int) -> Friction:
        """Friction of the contacts, followed by `count` contacts without friction."""
        padded = self._mapped(lambda values: np.concatenate([values, np.zeros((count, *values.shape[1:]))]))
        if padded.pressure is not None:
            padded.pressure[len(self) :, 1:, 0] = np.inf  # one piece, μ = 0, at any force
        return padded

    def _mapped(self, function: Callable[[np.ndarray], np.ndarray]) -> Friction:
        """A copy in which ``function(values)`` replaces the values of each field; fields without values stay None."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: function(value) for name, value in values.items() if value is not None})


def finite(name: str, value) -> np.ndarray:
    """An argument as an array of finite numbers.

    Raises
    ------
    ValueError
        Naming the argument.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers") from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name} contains NaN or infinite entries")
    return array


def _checked(name, value, contacts):
    array = finite(name, value)
    if array.shape not in ((), (contacts,)):
        raise ValueError(f"{name} must be a number or have shape ({contacts},); got shape {array.shape}")
    if (array < 0.0).any():
        raise ValueError(f"{name} must not be negative")
    return np.broadcast_to(array, (contacts,)).copy()
