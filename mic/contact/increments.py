"""Increments of a path at which backward Euler's method is applied."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

__all__ = ["Increments"]


@dataclass(frozen=True)
class Increments:
    """Steps of backward Euler's method that end at ``s_k = sin²(π k / 2 count)``.

    They are short at both ends of a leg, where contacts slide most: a clamp moves the sheets before it presses them, a
    release after its force has vanished.  Equal steps of the same accuracy would be four times as many.

    Attributes
    ----------
    count : int
    recorded : bool
        Whether the solution includes its :class:`mic.contact.path_record.PathRecord`.
    """

    count: int = 1
    recorded: bool = False

    @cached_property
    def ends(self) -> np.ndarray:
        """(count,) ends of the steps."""
        return np.sin(0.5 * np.pi * np.arange(1, self.count + 1) / self.count) ** 2
