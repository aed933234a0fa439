"""Increments of a path: what a scene means by their number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

__all__ = ["Increments"]


@dataclass(frozen=True)
class Increments:
    """Steps of backward Euler's method that end at ``s_k = sin²(π k / 2 count)``.

    They are short at both ends of a leg, where contacts make most of their way: a clamp moves the sheets before it
    presses them, and a release after its force has faded.  There steps of the square of their number do; equal ones
    have to be four times as many.

    Attributes
    ----------
    count : int
    recorded : bool
        Whether the solution tells its :class:`mic.contact.path_record.Trail`.
    """

    count: int = 1
    recorded: bool = False

    @cached_property
    def ends(self) -> np.ndarray:
        """(count,) where the steps end."""
        return np.sin(0.5 * np.pi * np.arange(1, self.count + 1) / self.count) ** 2
