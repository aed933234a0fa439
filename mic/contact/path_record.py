"""Record of the steps of a path, from which the path can be repeated or differentiated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

__all__ = ["PathRecord", "record_array"]


@dataclass(frozen=True)
class PathRecord:
    """The steps of one sample on a leg.

    Attributes
    ----------
    order : {1, 2}
        Order of the steps: backward Euler's method, or the follower's, whose first step has zero length, at 0.
    ends : (k,) array
        Ends of the steps as fractions of the leg, the last is 1.
    force : (k, d m) array
        Contact forces at the ends, N.
    """

    order: int
    ends: np.ndarray
    force: np.ndarray


def record_array(records: Iterable[PathRecord]) -> np.ndarray:
    """(n,) object array of records."""
    items = list(records)
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array
