"""Rows over retained functionals, collected while a scene is put on its meshes.

Each locator, clamp, weld, contact pair, corrective force and measurement becomes one or more *rows*: sparse
combinations of the parts' retained functionals. A joint's row reads *second body minus first*. The reduced model and
the full finite-element reference both work from these rows, so they mean the same thing on both sides. A row that no
stage uses and no report asks for is not made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.functional import Functionals
from mic.errors import SceneError
from mic.geometry.holes import find_holes
from mic.geometry.surface import Patch, Surface

__all__ = ["AXES", "KINDS", "NORMAL", "REACH", "Rows"]

#: What rows stand for; a position's reads by how much another grows as its item moves in the sheet.
KINDS = ("locator", "clamp", "weld", "contact", "between", "force", "measurement", "position")
AXES = ("n", "t1", "t2")  #: of a joint's frame
#: Rows of a weld that read along its normal, by how many it has: of means, with rotations, with moments.
NORMAL = {3: (0,), 6: (0, 4, 5), 9: (0, 3, 6)}
REACH = 5.0  # mm: farther than this from its part, a point of the scene is refused rather than projected


class _Retained:
    """Collects the functionals of one part."""

    def __init__(self):
        self.patches, self.patch, self.direction, self.rotation, self.side, self.label = [], [], [], [], [], []

    def freeze(self) -> Functionals:
        return Functionals(
            tuple(self.patches),
            np.array(self.patch, dtype=np.int64),
            np.array(self.direction, dtype=float).reshape(-1, 3),
            np.array(self.rotation, dtype=bool),
            np.array(self.side, dtype=float),
            tuple(self.label),
        )


class Rows:
    """The rows of an assembly while they are collected.

    Parameters
    ----------
    surfaces : mapping of str to Surface
        The parts' surfaces by name, in the order in which their functionals are stacked.
    """

    def __init__(self, surfaces: Mapping[str, Surface]):
        self.surfaces = dict(surfaces)
        self._retained = {name: _Retained() for name in surfaces}
        self._terms: dict[str, list] = {kind: [] for kind in KINDS}
        self.labels: dict[str, list[str]] = {kind: [] for kind in KINDS}

    def patch(self, part: str, patch: Patch) -> int:
        """Retain a patch of a part; returns its number."""
        own = self._retained[part]
        own.patches.append(patch)
        return len(own.patches) - 1

    def functional(self, part: str, patch: int, direction, label: str, rotation: bool = False, side: float = 0) -> int:
        """Retain a functional on a retained patch; returns its number in the part. Arguments as `Functionals`."""
        own = self._retained[part]
        own.patch.append(patch)
        own.direction.append(np.asarray(direction, dtype=float))
        own.rotation.append(rotation)
        own.side.append(side)
        own.label.append(label)
        return len(own.patch) - 1

    def add(self, kind: str, label: str, *terms: tuple[str, int, float]) -> None:
        """Add a row: the sum of (part, functional, coefficient)."""
        self._terms[kind].append(terms)
        self.labels[kind].append(label)

    def point(self, kind: str, key: str, item) -> None:
        """Add the row that reads one part at one point along one direction, over a disc.

        Parameters
        ----------
        kind : str
        key : str
            Where the item stands in the scene, for messages.
        item
            With ``name``, ``part``, ``point``, ``direction``, ``radius`` and ``hole``: with the latter, over the rim of
            the hole whose centre it is.

        Raises
        ------
        SceneError
            If the point lies off the part.
        """
        functional = self.functional(item.part, self.place(key, item.name, item), item.direction, f"{kind} {item.name}")
        self.add(kind, item.name, (item.part, functional, 1.0))

    def place(self, key: str, name: str, item) -> int:
        """Retain the patch where an item of this name reads its part; arguments and errors as :meth:`point`."""
        surface = self.surfaces[item.part]
        if item.hole is not None:
            return self.patch(item.part, _rim(surface, item.hole))
        self.on_part(key, name, item.point, item.part)
        return self.disc(item.part, item.point, item.radius)

    def disc(self, part: str, point, radius: float) -> int:
        """Retain the patch of a part within a radius of a point; returns its number."""
        return self.patch(part, self.surfaces[part].patch(point, radius))

    def middle(self, part: str, patch: int) -> np.ndarray:
        """(3,) the mean point of a retained patch, mm."""
        own = self._retained[part].patches[patch]
        return own.weight @ self.surfaces[part].at(own.triangle, own.barycentric)

    def on_part(self, key: str, name: str, point, part: str) -> None:
        """Raise :class:`SceneError` for an item whose point lies farther than `REACH` from a part."""
        foot = self.surfaces[part].project(point)
        distance = float(foot.distance[0])
        if distance > REACH:
            nearest = ", ".join(f"{x:.6g}" for x in foot.point[0])
            raise SceneError(
                f"{key}.point ({name}): {list(point)} lies {distance:.3g} mm off part {part!r} (at most "
                f"{REACH} mm is allowed), its nearest point is [{nearest}]; correct the coordinates or the part"
            )

    def near(self, key: str, name: str, part: str, points: np.ndarray, foot: np.ndarray) -> None:
        """Raise :class:`SceneError` for the first of several points (n, 3) that lies off its part, its foot beside."""
        away = np.linalg.norm(points - foot, axis=1)
        worst = int(np.argmax(away))
        if away[worst] > REACH:
            nearest = ", ".join(f"{x:.6g}" for x in foot[worst])
            raise SceneError(
                f"{key}.points[{worst}] ({name}): {points[worst].tolist()} lies {away[worst]:.3g} mm off part "
                f"{part!r} (at most {REACH} mm is allowed), its nearest point is [{nearest}]; correct the "
                "coordinates or the part"
            )

    def functionals(self, part: str) -> Functionals:
        """What the rows read of a part."""
        return self._retained[part].freeze()

    def matrices(self) -> dict[str, csr_matrix]:
        """The rows of every kind over the stacked functionals of all parts."""
        lengths = [len(own.patch) for own in self._retained.values()]
        start = dict(zip(self._retained, np.concatenate([[0], np.cumsum(lengths)])))
        return {kind: _matrix(terms, start, sum(lengths)) for kind, terms in self._terms.items()}


def _rim(surface: Surface, centre) -> Patch:
    """The rim of the hole that has this centre."""
    return min(find_holes(surface), key=lambda hole: float(np.linalg.norm(hole.centre - np.array(centre)))).rim


def _matrix(entries: Sequence, start, width: int) -> csr_matrix:
    triplets = [(i, start[part] + own, value) for i, terms in enumerate(entries) for part, own, value in terms]
    i, j, value = np.array(triplets).T if triplets else np.zeros((3, 0))
    return csr_matrix((value, (i.astype(int), j.astype(int))), shape=(len(entries), width))
