"""Collects the rows of an assembly over its retained functionals.

Each locator, clamp, weld, contact pair, corrective force and measurement becomes one or more *rows*: sparse
combinations of the parts' retained functionals. A joint's row reads *second body minus first*. The reduced model and
the full finite-element reference both use these rows. Rows that no stage and no report needs are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.functional import Functionals
from mic.errors import SceneError
from mic.geometry.holes import find_holes
from mic.geometry.pairing import Side
from mic.geometry.surface import Patch, Projection, Surface
from mic.scene import Scene

__all__ = ["AXES", "KINDS", "NORMAL", "REACH", "SHARE", "Joints", "Row", "Rows", "WithWelds", "on_part", "xyz"]

#: Kinds of rows. "between": points between contact pairs; "position": growth of other rows as an item moves.
KINDS = ("locator", "clamp", "weld", "contact", "between", "force", "measurement", "position")
AXES = ("n", "t1", "t2")  #: of a joint's frame
#: Rows of a weld that read along its normal, by its number of rows: means only, with rotations, with moments.
NORMAL = {3: (0,), 6: (0, 4, 5), 9: (0, 3, 6)}
REACH = 5.0  # mm: a point of the scene farther than this from its part is refused, not projected
SHARE = 0.03  # of the part's diameter, if that is more: a refusal must not depend on the unit in which a part is drawn

Row = tuple[str, int]  #: a row by its kind and its number


class Rows:
    """The rows of an assembly, collected item by item.

    Parameters
    ----------
    scene : Scene
        With all items placed.
    bodies : mapping of str to Side
        Parts, in the stacking order of their functionals, and fixtures by name.

    Attributes
    ----------
    scene, bodies
        As given.
    surfaces : dict of str to Surface
        Of the parts, by name.
    """

    def __init__(self, scene: Scene, bodies: Mapping[str, Side]):
        self.scene, self.bodies = scene, bodies
        self.surfaces = {part.name: bodies[part.name].surface for part in scene.parts}
        self._patches: dict[str, list[Patch]] = {name: [] for name in self.surfaces}
        #: Patch, direction, rotation, side and label of each functional.
        self._functionals: dict[str, list[tuple]] = {name: [] for name in self.surfaces}
        self._terms: dict[str, list] = {kind: [] for kind in KINDS}
        self.labels: dict[str, list[str]] = {kind: [] for kind in KINDS}

    def patch(self, part: str, patch: Patch) -> int:
        """Retain a patch of a part; returns its number."""
        self._patches[part].append(patch)
        return len(self._patches[part]) - 1

    def functional(self, part: str, patch: int, direction, label: str, rotation: bool = False, side: float = 0) -> int:
        """Retain a functional on a retained patch; returns its number in the part. Arguments as `Functionals`."""
        self._functionals[part].append((patch, np.asarray(direction, dtype=float), rotation, side, label))
        return len(self._functionals[part]) - 1

    def add(self, kind: str, label: str, *terms: tuple[str, int, float]) -> None:
        """Add a row: the sum of (part, functional, coefficient)."""
        self._terms[kind].append(terms)
        self.labels[kind].append(label)

    def point(self, kind: str, key: str, item) -> None:
        """Add the row that reads one part at one point along one direction, averaged over a disc.

        Parameters
        ----------
        kind : str
        key : str
            Scene key of the item, for messages.
        item
            With ``name``, ``part``, ``point``, ``direction``, ``radius`` and ``hole``; with ``hole``, the centre of a
            hole, the row is averaged over its rim.

        Raises
        ------
        SceneError
            If the point lies off the part.
        """
        functional = self.functional(
            item.part, self.item_patch(key, item.name, item), item.direction, f"{kind} {item.name}"
        )
        self.add(kind, item.name, (item.part, functional, 1.0))

    def item_patch(self, key: str, name: str, item) -> int:
        """Retain the patch over which an item reads its part; arguments and errors as :meth:`point`."""
        surface = self.surfaces[item.part]
        if item.hole is not None:
            return self.patch(item.part, _rim(surface, item.hole))
        on_part(f"{key}.point", item.part, self.surfaces[item.part], item.point, name)
        return self.disc(item.part, item.point, item.radius)

    def item_discs(self, key: str, item) -> tuple[list[int], np.ndarray]:
        """Retain a disc about each point of an item; returns their numbers, and the sheet's normals there (n, 3).

        Errors as :meth:`point`.
        """
        surface = self.surfaces[item.part]
        foot = on_part(f"{key}.points", item.part, surface, item.points, item.name)
        discs = [self.disc(item.part, point, item.radius) for point in foot.point]
        return discs, surface.smooth_normals(foot.triangle, foot.barycentric)

    def disc(self, part: str, point, radius: float) -> int:
        """Retain the patch of a part within a radius of a point; returns its number."""
        return self.patch(part, self.surfaces[part].patch(point, radius))

    def mean_point(self, part: str, patch: int) -> np.ndarray:
        """(3,) weighted mean point of a retained patch, mm."""
        disc = self._patches[part][patch]
        return disc.weight @ self.surfaces[part].at(disc.triangle, disc.barycentric)

    def functionals(self, part: str) -> Functionals:
        """The retained functionals of a part."""
        columns = zip(*self._functionals[part]) if self._functionals[part] else [()] * 5
        patch, direction, rotation, side, label = columns
        return Functionals(
            tuple(self._patches[part]),
            np.array(patch, dtype=np.int64),
            np.array(direction, dtype=float).reshape(-1, 3),
            np.array(rotation, dtype=bool),
            np.array(side, dtype=float),
            tuple(label),
        )

    def matrices(self) -> dict[str, csr_matrix]:
        """The rows of every kind over the stacked functionals of all parts."""
        lengths = [len(functionals) for functionals in self._functionals.values()]
        start = dict(zip(self._functionals, np.concatenate([[0], np.cumsum(lengths)])))
        return {kind: _matrix(terms, start, sum(lengths)) for kind, terms in self._terms.items()}


@dataclass(frozen=True)
class Joints:
    """The rows of each weld.

    Attributes
    ----------
    size : tuple of int
        Rows of each weld: the means along n, t1, t2; then rotations about these, or moments along them, first those
        over t1 and then those over t2.
    """

    size: tuple[int, ...]

    @property
    def first(self) -> np.ndarray:
        """(w,) first row of each weld."""
        return np.concatenate([[0], np.cumsum(self.size)]).astype(int)[:-1]

    def rows(self, weld: int) -> list[Row]:
        """All rows of a weld."""
        start = int(self.first[weld])
        return [("weld", row) for row in range(start, start + self.size[weld])]

    def normal(self, weld: int) -> list[int]:
        """The rows of a weld along its normal: the mean gap of its sheets, and how the gap tilts."""
        return [int(self.first[weld]) + row for row in NORMAL[self.size[weld]]]

    @property
    def normals(self) -> np.ndarray:
        """(k,) the normal rows of all welds."""
        return np.array([row for weld in range(len(self.size)) for row in self.normal(weld)], dtype=int)


class WithWelds:
    """What has the rows of welds: an assembly and its reduction."""

    weld_size: tuple[int, ...]

    @property
    def joints(self) -> Joints:
        """The rows of each weld."""
        return Joints(self.weld_size)


def on_part(key: str, part: str, surface: Surface, points, name: str = "") -> Projection:
    """Nearest points on a part's surface to one point of an item, or to several (n, 3).

    Raises
    ------
    SceneError
        If one of the points is farther than `REACH` from the part; the key and the name of the item are in the message.
    """
    foot, reach = surface.project(points), max(REACH, SHARE * surface.diameter)
    worst = int(np.argmax(foot.distance))
    if foot.distance[worst] > reach:
        at = key + ("" if np.ndim(points) == 1 else f"[{worst}]") + (f" ({name})" if name else "")
        raise SceneError(
            f"{at}: {xyz(np.atleast_2d(points)[worst])} is {foot.distance[worst]:.3g} mm away from part "
            f"{part!r} (at most {reach:.3g} mm is allowed); the nearest point on it is {xyz(foot.point[worst])}; "
            "correct the coordinates or the part"
        )
    return foot


def xyz(x: Sequence[float] | np.ndarray) -> str:
    """A point or vector as text, to 1 µm."""
    return "(" + ", ".join(f"{round(float(value), 3) + 0.0:g}" for value in x) + ")"


def _rim(surface: Surface, centre) -> Patch:
    """The rim of the hole with this centre."""
    return min(find_holes(surface), key=lambda hole: float(np.linalg.norm(hole.centre - np.array(centre)))).rim


def _matrix(entries: Sequence, start, width: int) -> csr_matrix:
    triplets = [(i, start[part] + f, value) for i, terms in enumerate(entries) for part, f, value in terms]
    i, j, value = np.array(triplets).T if triplets else np.zeros((3, 0))
    return csr_matrix((value, (i.astype(int), j.astype(int))), shape=(len(entries), width))
