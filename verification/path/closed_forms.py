"""Closed-form paths of one or two contacts; loads and positions in mm, compliance in mm/N.

Each contact has compliance 1 in all directions unless stated otherwise: a normal displacement of -1 presses it with
1 N, and the length of the spring that pulls it equals its force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.contact import ContactSolver
from mic.contact.path import Path

__all__ = ["CASES", "Case", "error"]

MU = 0.5


@dataclass(frozen=True)
class Case:
    """A path.

    Attributes
    ----------
    name : str
    compliance : (3m, 3m) array
    friction : (m,) array
    loads : (k + 1, m, 3) array
        Displacements without contact forces, linear in between.
    force : (m, 3) array
        Forces at the first load.
    anchor : (m, 2) array
        Positions of the contacts at the first load.
    end : (m, 2) array
        Positions after the last load.
    linear : bool
        Whether the path is piecewise linear.
    """

    name: str
    compliance: np.ndarray
    friction: np.ndarray
    loads: np.ndarray
    force: np.ndarray
    anchor: np.ndarray
    end: np.ndarray
    linear: bool


def error(case: Case, path: Path) -> float:
    """Distance between final position and closed form, relative to the tangential path length of the load."""
    solver = ContactSolver(case.compliance, case.friction, tol=1e-12)
    b = case.loads.reshape(1, len(case.loads), -1)
    found = solver.follow(b, case.force.reshape(1, -1), case.anchor[None], path)
    if not found.converged.all():
        return np.inf
    way = np.linalg.norm(np.diff(case.loads[:, :, 1:], axis=0), axis=-1).sum(axis=0).max()
    return float(np.linalg.norm(found.anchor[0] - case.end, axis=-1).max() / way)


def _one(name, loads, force, anchor, end, linear):
    one = [np.asarray(value, dtype=float) for value in (loads, force, anchor, end)]
    return Case(
        name, np.eye(3), np.array([MU]), one[0][:, None], one[1][None], one[2][None], one[3][None], linear=linear
    )


def _tractrix() -> Case:
    """A slider dragged around a corner by a spring of length l whose end moves straight at an angle φ to the spring.

    It follows the tractrix: ``tan(φ/2) = tan(φ₀/2) exp(−v/l)`` after a path length v.
    """
    l, start, v = MU, 1.2, 1.0
    angle = 2 * np.arctan(np.tan(start / 2) * np.exp(-v / l))
    spring = l * np.array([np.cos(start), np.sin(start)])
    loads = [[-1, *spring], [-1, v + spring[0], spring[1]]]
    end = [v + spring[0] - l * np.cos(angle), spring[1] - l * np.sin(angle)]
    return _one("round a corner (tractrix)", loads, [1, *-spring], [0, 0], end, False)


def _arc() -> Case:
    """A block pushed on an arc of radius r: the spring is tangent to it, and its end on a circle of radius √(r² + l²),
    here a polygon of 512 sides."""
    l, r = MU, 1.0
    angles = np.linspace(0, np.pi / 2, 513)
    along = np.column_stack([np.cos(angles), np.sin(angles)])
    across = np.column_stack([-np.sin(angles), np.cos(angles)])
    ends = r * along + l * across
    loads = np.column_stack([-np.ones(len(ends)), ends])
    return _one("on an arc", loads, [1, *-l * across[0]], r * along[0], r * along[-1], False)


def _closing() -> Case:
    """A contact that closes after 0.37 of the path while it moves tangentially, and sticks."""
    return _one("closing while it moves", [[0.37, 0, 0], [-0.63, 0.4, 0]], [0, 0, 0], [0, 0], [0.37 * 0.4, 0], True)


def _turning_round() -> Case:
    """A load that reverses and returns beyond its start: the slider stops at a distance l from each end."""
    return _one("turning round", [[-1, 0, 0], [-1, 1, 0], [-1, -0.7, 0]], [1, 0, 0], [0, 0], [-0.7 + MU, 0], True)


def _in_series() -> Case:
    """Two coupled sliders, of which one slips first; the load then reverses a little, and both stick."""
    along = np.array([[1, 0.5], [0.5, 1]])
    compliance = np.eye(6)
    for axis in (1, 2):
        compliance[np.ix_([axis, 3 + axis], [axis, 3 + axis])] = along
    friction, pull = np.array([0.2, 0.4]), np.array([1.0, 0.7])
    shares = np.array([0.0, 2.0, 1.9])
    loads = np.zeros((3, 2, 3))
    loads[:, :, 0], loads[:, :, 1] = -1, shares[:, None] * pull
    end = along @ -friction + shares[1] * pull  # at the peak both slide with full friction
    rest = np.zeros((2, 2))
    force = np.array([[1.0, 0, 0], [1.0, 0, 0]])
    return Case("two in series", compliance, friction, loads, force, rest, np.column_stack([end, [0, 0]]), True)


CASES = (_tractrix(), _arc(), _closing(), _turning_round(), _in_series())
