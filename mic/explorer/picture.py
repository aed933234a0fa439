"""What is drawn of an assembly: where its parts, contacts and measured points are, displacements magnified."""

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

__all__ = ["Picture", "Placed"]

SHOWN = 0.08  # of the assembly's size: how large the largest displacement is drawn at first


@dataclass(frozen=True)
class Placed:
    """An assembly as it is drawn.

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


class Picture:
    """Places what is drawn.

    Parameters
    ----------
    exploration : Exploration
    shapes : Shapes

    Attributes
    ----------
    measured : list of int
        Numbers of the key characteristics that are read at one point, and are drawn.
    """

    def __init__(self, exploration: Exploration, shapes: Shapes):
        self.exploration, self.shapes = exploration, shapes
        items = exploration.own.scene.measurements
        self.measured = [
            k
            for k, one in enumerate(items)
            if one.kind == "point" and one.point is not None and not isinstance(one.direction, str)
        ]
        self._items = [items[k] for k in self.measured]

    def placed(self, answer: ExploredAssembly, magnification: float) -> Placed:
        """Everything displaced as in an answer, that many times; as nominal where it failed."""
        model, found = self.exploration.model, answer.evaluation
        force, motion = np.nan_to_num(found.functional_force[0]), np.nan_to_num(found.motion[0])
        moved = self.shapes.displaced(model, force, motion)
        contacts = np.nan_to_num(self.exploration.contacts(answer))
        return Placed(
            [part.points + magnification * u for part, u in zip(self.shapes.parts, moved)],
            model.contacts.point + magnification * contacts,
            self._points + magnification * self._at_points(answer, moved),
        )

    def usual(self, answer: ExploredAssembly) -> float:
        """A magnification at which the displacements are seen, 1, 2 or 5 times a power of ten."""
        placed, nominal = self.placed(answer, 1.0), self.placed(answer, 0.0)
        every = [(a, b) for a, b in zip([*placed.parts, placed.contacts, placed.measured],
                                        [*nominal.parts, nominal.contacts, nominal.measured]) if len(a)]  # fmt: skip
        if not every:
            return 1.0
        largest = max(float(np.linalg.norm(a - b, axis=1).max()) for a, b in every)
        size = float(np.ptp(np.concatenate([b for _, b in every]), axis=0).max())
        if largest < 1e-9 or size == 0:
            return 1.0
        wanted = math.log10(SHOWN * size / largest)
        return max(
            1.0, max(s for s in (1.0, 2.0, 5.0, 10.0) if math.log10(s) <= wanted % 1 + 1e-9) * 10.0 ** (wanted // 1)
        )

    @cached_property
    def viewpoint(self) -> np.ndarray:
        """(3,) unit vector towards where most of the parts is seen from."""
        surfaces = [Surface(part.points, part.triangles) for part in self.shapes.parts]
        return viewpoint(surfaces) if surfaces else np.array([0.5, -0.7, 0.51])

    @cached_property
    def _points(self) -> np.ndarray:
        return np.array([one.point for one in self._items], dtype=float).reshape(-1, 3)

    @cached_property
    def _nearest(self) -> list[tuple[int, int]]:
        """Of each measured point, its part and the nearest vertex of it that is drawn."""
        names = [part.name for part in self.shapes.parts]
        trees = {part.name: cKDTree(part.points) for part in self.shapes.parts}
        return [(names.index(one.part), int(trees[one.part].query(one.point)[1])) for one in self._items]

    def _at_points(self, answer: ExploredAssembly, moved: list[np.ndarray]) -> np.ndarray:
        """(k, 3) displacements of the measured points; along the direction that is measured where no more is known."""
        if moved and all(part.basis is not None for part in self.shapes.parts):
            return np.array([moved[p][v] for p, v in self._nearest]).reshape(-1, 3)
        y = np.nan_to_num(answer.table["value"].to_numpy()[self.measured])
        along = np.array([one.direction for one in self._items], dtype=float).reshape(-1, 3)
        return y[:, None] * along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
