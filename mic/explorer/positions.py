"""Positions of parts, contacts and measured points in the view of an assembly, with magnified displacements."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from mic.explorer.shapes import Shapes
from mic.geometry.surface import Surface
from mic.report.space_pictures import viewpoint
from mic.studies.exploration import Exploration, ExploredAssembly

__all__ = ["AssemblyPositions", "Positions"]

VISIBLE = 0.08  # largest displacement in the view at the default magnification, relative to the size of the assembly


@dataclass(frozen=True)
class Positions:
    """Positions in the view of an assembly.

    Attributes
    ----------
    parts : list of (v, 3) array
    contacts : (m, 3) array
    measured : (k, 3) array
        mm.
    """

    parts: list[np.ndarray]
    contacts: np.ndarray
    measured: np.ndarray

    @property
    def all(self) -> np.ndarray:
        """(n, 3) all of them."""
        return np.concatenate([*self.parts, self.contacts, self.measured])


class AssemblyPositions:
    """Computes the positions for evaluated assemblies.

    Parameters
    ----------
    exploration : Exploration
    shapes : Shapes

    Attributes
    ----------
    measured : list of int
        Numbers of the key characteristics that are displayed: those measured at one point.
    """

    def __init__(self, exploration: Exploration, shapes: Shapes):
        self.exploration, self.shapes = exploration, shapes
        items = exploration.scene_model.scene.measurements
        self.measured = [
            k
            for k, item in enumerate(items)
            if item.kind == "point" and item.point is not None and not isinstance(item.direction, str)
        ]
        self._items = [items[k] for k in self.measured]
        self._points = np.array([item.point for item in self._items], dtype=float).reshape(-1, 3)

    def of(self, assembly: ExploredAssembly, magnification: float) -> Positions:
        """Positions with magnified displacements; those of a failed assembly are nominal."""
        model, evaluation = self.exploration.model, assembly.evaluation
        force, motion = np.nan_to_num(evaluation.functional_force[0]), np.nan_to_num(evaluation.motion[0])
        displacements = self.shapes.displaced(model, force, motion)
        contacts = np.nan_to_num(self.exploration.contacts(assembly))
        return Positions(
            [part.points + magnification * u for part, u in zip(self.shapes.parts, displacements)],
            model.contacts.point + magnification * contacts,
            self._points + magnification * self._at_points(assembly, displacements),
        )

    def default_magnification(self, assembly: ExploredAssembly) -> float:
        """Magnification that makes the displacements visible: 1, 2 or 5 times a power of ten."""
        displaced, nominal = self.of(assembly, 1.0).all, self.of(assembly, 0.0).all
        largest = float(np.linalg.norm(displaced - nominal, axis=1).max(initial=0.0))
        size = float(np.ptp(nominal, axis=0).max()) if len(nominal) else 0.0
        if largest < 1e-9 or size == 0:
            return 1.0
        wanted = math.log10(VISIBLE * size / largest)
        digit = max(s for s in (1.0, 2.0, 5.0, 10.0) if math.log10(s) <= wanted % 1 + 1e-9)
        return max(1.0, digit * 10.0 ** (wanted // 1))

    @cached_property
    def viewpoint(self) -> np.ndarray:
        """(3,) unit vector from the assembly towards the viewer."""
        surfaces = [Surface(part.points, part.triangles) for part in self.shapes.parts]
        return viewpoint(surfaces) if surfaces else np.array([0.5, -0.7, 0.51])

    @cached_property
    def _nearest(self) -> list[tuple[int, int]]:
        """For each measured point, its part and the nearest vertex of the displayed surface."""
        names = [part.name for part in self.shapes.parts]
        trees = {part.name: cKDTree(part.points) for part in self.shapes.parts}
        return [(names.index(item.part), int(trees[item.part].query(item.point)[1])) for item in self._items]

    def _at_points(self, assembly: ExploredAssembly, displacements: list[np.ndarray]) -> np.ndarray:
        """(k, 3) displacements of the measured points; only along the measured direction if shapes are missing."""
        if displacements and all(len(part.acting) for part in self.shapes.parts):
            return np.array([displacements[p][v] for p, v in self._nearest]).reshape(-1, 3)
        y = np.nan_to_num(assembly.table["value"].to_numpy()[self.measured])
        along = np.array([item.direction for item in self._items], dtype=float).reshape(-1, 3)
        return y[:, None] * along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
