"""Two contacts on springs, evaluated by :mod:`mic.contact`, whose statistics follow from closed forms.

Lengths in mm; a spring yields by 1 mm per N. The slider is pressed by N, pulled by p and returns to e. With the length
``l = μ N`` of a spring that slides, it ends at ``clip(max(p - l, 0), e - l, e + l)``; in one step at ``clip(0, e - l,
e + l)``. The stop is a spring whose end meets another one behind a gap g: pressed by d it moves to ``-d + max(d - g,
0)/2``.
"""

from __future__ import annotations

import numpy as np

from mic.contact import ContactSolver
from mic.contact.path import Followed, Increments

__all__ = ["MEANS", "SIGMAS", "closed_form", "contacts"]

MU = 0.5
MEANS = np.array([1.0, 1.2, 0.3, 1.0, 1.2])  # N, p, e, d, g
SIGMAS = np.array([0.15, 0.2, 0.25, 0.15, 0.1])


def contacts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) of the slider and of the stop for inputs (n, 5), on the followed path and in one step."""
    n = len(x)
    press, pull, end, depth, gap = x.T
    slider, stop = ContactSolver(np.eye(3), np.array([MU])), ContactSolver(2 * np.eye(3), np.zeros(1))
    loads, force = np.zeros((n, 3, 3)), np.zeros((n, 3))
    loads[:, :, 0], loads[:, 1, 1], loads[:, 2, 1], force[:, 0] = -press[:, None], pull, end, press
    anchor = np.zeros((n, 1, 2))
    followed = slider.follow(loads, force, anchor, Followed(least=0.01)).anchor[:, 0, 0]
    one_step = slider.follow(loads[:, [0, 2]], force, anchor, Increments(1)).anchor[:, 0, 0]
    apart = np.column_stack([gap - depth, np.zeros((n, 2))])
    moved = stop.solve(apart).force[:, 0] - depth
    return np.column_stack([followed, moved]), np.column_stack([one_step, moved])


def closed_form(x: np.ndarray) -> np.ndarray:
    """Positions (n, 2) on the followed path."""
    press, pull, end, depth, gap = x.T
    length = MU * press
    slider = np.clip(np.maximum(pull - length, 0.0), end - length, end + length)
    return np.column_stack([slider, np.maximum(depth - gap, 0.0) / 2 - depth])
