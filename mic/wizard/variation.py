"""Variation of a proposed scene, in mm: a random field of the shape of each part, and misplaced locators.

The size of a sheet gives the tolerance t of its form: ISO 2768-2 (1989), class L, table 1, straightness and flatness.
Six standard deviations of a node of the free part, on its six locators, are at most t. The field has the same standard
deviation at all its points on the loose part; between them the sheet bends as :mod:`mic.model.stiffness_estimate` says,
and `MARGIN` covers the error of that estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mic.geometry.measured_points import spread
from mic.model.one_sigma import known_shape_fields
from mic.model.random_field import correlation, modes_of
from mic.model.rigid_motion import amplification
from mic.model.shape_modes import FEWEST, PER_EDGE, PER_LENGTH
from mic.model.stiffness_estimate import HeldSheet
from mic.wizard.bodies import Body
from mic.wizard.fixture import PAD, Support, readings

__all__ = ["Variation", "form_tolerance", "propose_variation"]

#: Largest size and form tolerance, mm: ISO 2768-2, class L.
FORM = ((10.0, 0.1), (30.0, 0.2), (100.0, 0.4), (300.0, 0.8), (1000.0, 1.2), (np.inf, 1.6))
SHARE = 0.5  # of the part's diagonal: correlation length
LARGEST = 100_000  # vertices: beyond, the estimate takes minutes
POINTS = 9  # of a field, at least, if the mesh is fine enough
MODES = 0.95  # of the variance that the modes of a field represent, its default
MARGIN = 2.0  # of the estimated displacements: on curved sheets of few elements they are up to 1.8 times too small
LOCATOR = 0.1  # mm, standard deviation of a locator
MOVED = 0.3  # mm by which one standard deviation of a locator moves any node of its part, at most


@dataclass(frozen=True)
class Variation:
    """The proposed variation of a part.

    Attributes
    ----------
    sigma, length : float
        Standard deviation and correlation length of the field of its shape, mm; sigma is 0 if its mesh has too few
        or too many elements for a field.
    moved : float
        Displacement of any node of the free part by one standard deviation of its shape, at most, mm.
    locators : list of float
        Standard deviation of each of its six locators, mm.
    """

    sigma: float
    length: float
    moved: float
    locators: list[float]


def form_tolerance(size: float) -> float:
    """Form tolerance of a sheet by its size, mm; that of 3 m for larger sheets, which the table does not have."""
    return next(tolerance for largest, tolerance in FORM if size <= largest)


def propose_variation(body: Body, six: Sequence[Support]) -> Variation:
    """The variation of a part on its six locators.

    Parameters
    ----------
    body : Body
    six : sequence of Support
    """
    surface, bound = body.surface, form_tolerance(body.surface.diameter) / 6
    arms = surface.points - np.mean([support.point for support in six], axis=0)
    moved = amplification(readings(six, 1.0), arms)
    farthest = np.linalg.norm(moved, axis=2).max(axis=0)
    locators = [_rounded_down(min(LOCATOR, MOVED / far)) for far in farthest]
    shortest = 1.01 * PER_EDGE * body.element
    length = max(SHARE * surface.diameter, shortest)
    while len(vertices := spread(surface, length / PER_LENGTH)) < POINTS and length > shortest:
        length = max(length / 1.25, shortest)
    if len(vertices) < FEWEST or len(surface.points) > LARGEST:
        return Variation(0.0, 0.0, 0.0, locators)
    length = float(f"{length:.3g}")
    spreading = _standard_deviation(body, six, spread(surface, length / PER_LENGTH), length).max()
    sigma = _rounded_down(bound / (MARGIN * spreading))
    return Variation(sigma, length, bound, locators)


def _standard_deviation(body: Body, six: Sequence[Support], vertices: np.ndarray, length: float) -> np.ndarray:
    """(v,) standard deviation of the displacement of all vertices for a field of 1 mm at some of them (c,)."""
    surface, material = body.surface, (body.thickness, body.young, body.poisson)
    points, directions = (np.array([getattr(one, key) for one in six]) for key in ("point", "direction"))
    radii = [0.0 if support.hole else PAD for support in six]
    sheet = HeldSheet(surface, *material, points, directions, radii)
    modes = modes_of(correlation(surface, vertices, length), MODES)
    fields = known_shape_fields(sheet, surface.points[vertices], modes, True, body.name)
    return np.sqrt((fields**2).sum(axis=(1, 2)))


def _rounded_down(value: float) -> float:
    """A positive number of two digits, not above the given one."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.floor(value / digit + 1e-9) * digit:.2g}")
