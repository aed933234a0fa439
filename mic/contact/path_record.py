"""Where the steps of a path ended: what it takes to go it again, or beside it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

__all__ = ["Trail", "trails"]


@dataclass(frozen=True)
class Trail:
    """The steps of one sample on a leg.

    Attributes
    ----------
    order : {1, 2}
        Of the steps: backward Euler's method, or the follower's, which begins with a step that leads nowhere, at 0.
    ends : (k,) array
        Where they ended, in shares of the leg, the last at 1.
    force : (k, d m) array
        Of the contacts there, N.
    """

    order: int
    ends: np.ndarray
    force: np.ndarray


def trails(found: Iterable[Trail]) -> np.ndarray:
    """(n,) object array of trails."""
    every = list(found)
    array = np.empty(len(every), dtype=object)
    array[:] = every
    return array
