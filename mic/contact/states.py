"""States of a contact: open, stick or slip, and their classification from a force."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

__all__ = ["LOADED", "ON_CONE", "OPEN", "SLIP", "STATES", "STICK", "ContactState", "classify"]

#: A contact is loaded above this fraction of the largest normal force of its sample.  At a tolerance of 1e-10, solvers
#: may leave forces of that relative size on open contacts.
LOADED = 1e-9
#: A loaded contact slips if its tangential force is within this fraction of the friction bound.  The tangential force
#: of a slipping contact is exact to the solver's tolerance, which is only 1e-7 for some backends.
ON_CONE = 1e-6
TINY = float(np.finfo(float).tiny)


class ContactState(IntEnum):
    """State of one contact, the integer in every array ``state``: ``resolution.state == ContactState.SLIP``."""

    OPEN = 0
    """carries no force: the parts are apart, or touch without pressing"""

    STICK = 1
    """presses, and friction holds it: the tangential force is below its bound"""

    SLIP = 2
    """presses and slides: the tangential force is at its bound, which is zero without friction"""

    @property
    def label(self) -> str:
        """The state's name in tables and pictures."""
        return self.name.lower()


#: Labels of the states; the index is the state's value.
STATES = tuple(state.label for state in ContactState)
#: The states as integers, constants in compiled code.
OPEN, STICK, SLIP = map(int, ContactState)


def classify(force: np.ndarray, bound: np.ndarray | float) -> np.ndarray:
    """State of every contact: open without load, stuck inside the friction cone, slipping on its surface.

    Parameters
    ----------
    force : (n, m, 3) or (n, m, 1) array
        Contact forces (n, t1, t2), or normal forces alone [force].
    bound : float or (n, m) array
        Largest tangential forces [force], :meth:`mic.contact.laws.Law.bound`; zero without friction, where every loaded
        contact slips.

    Returns
    -------
    (n, m) int8 array
        Values of :class:`ContactState`.
    """
    normal = force[..., 0]
    loaded = normal > LOADED * np.maximum(normal.max(axis=1, keepdims=True, initial=0.0), TINY)
    if force.shape[2] == 1:
        return np.where(loaded, SLIP, OPEN).astype(np.int8)
    slips = np.hypot(force[..., 1], force[..., 2]) >= (1.0 - ON_CONE) * bound
    return np.where(loaded, np.where(slips, SLIP, STICK), OPEN).astype(np.int8)
