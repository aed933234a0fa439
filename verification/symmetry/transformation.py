"""The same scene seen otherwise: scaled, rotated, mirrored, renumbered, with its items in another order.

A scene that is loaded and placed (:class:`mic.model.assembly.PlacedScene`) holds all its lengths, forces, points and
directions as numbers, whatever files they came from, and its surfaces in memory. It is therefore the level at which any
scene can be transformed. With an orthogonal matrix M, a shift c, a factor λ of lengths and a factor φ of forces,

    x → λ (M x + c),   d → M d,   a quantity of unit mm^a N^b → λ^a φ^b times itself,

and a quantity of the solution, which has a unit too, must change by the factor of its unit and by nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import BaseModel
from scipy.spatial.transform import Rotation

from mic.compliance.superelement import Superelement
from mic.geometry.surface import Surface
from mic.model.assembly import PlacedScene
from mic.process.actions import stage_moves
from mic.scene import Scene
from mic.scene.deviation import ShapeDeviation, deviation_unit

__all__ = ["DIRECTIONS", "NO_UNIT", "POINTS", "POWERS", "Transformation", "transformations"]

#: Keys of a placed scene that hold points, and directions.
POINTS = {"point", "hole", "box", "path", "points"}
DIRECTIONS = {"direction", "normal"}
#: Keys that hold a number with a unit: powers of length and of force.
POWERS = {
    **dict.fromkeys(("thickness", "size", "radius", "within", "spacing", "max_gap", "gap", "patch"), (1, 0)),
    **dict.fromkeys(("nominal_overlap", "stroke", "lower", "upper", "noise"), (1, 0)),
    **dict.fromkeys(("force", "limit", "gun"), (0, 1)),
    **dict.fromkeys(("young", "p0"), (-2, 1)),
    **dict.fromkeys(("density", "tangential_stiffness"), (-3, 1)),
    "stiffness": (-1, 1),
}
#: Keys that hold numbers without a unit, or in that of their deviation (:func:`mic.scene.deviation.deviation_unit`).
NO_UNIT = {
    *("offset", "poisson", "expansion", "accuracy", "mu0", "n", "mu_min", "mu_max", "friction", "spacing_factor"),
    *("max_angle_deg", "scores", "parameters", "matrix", "weights", "tolerance", "target_cpk", "target_outside"),
    *("values", "six_sigma", "mean", "share_outside", "cpk", "slip", "sigma", "truncated", "share"),
}
UNITS = {"mm": (1, 0), "N": (0, 1), "N mm": (1, 1)}


@dataclass(frozen=True)
class Transformation:
    """A transformation of a scene that leaves its physics unchanged.

    Attributes
    ----------
    name : str
    matrix : (3, 3) array
        Orthogonal M, a rotation or a reflection.
    shift : (3,) array
        c, mm.
    length, force : float
        Factors λ and φ.
    renumbered : bool
        Vertices and triangles of all meshes in another order, triangles from another corner.
    permuted : bool
        Parts, locators and clamps in another order, which close in the order as before.
    """

    name: str
    matrix: np.ndarray = field(default_factory=lambda: np.eye(3))
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    length: float = 1.0
    force: float = 1.0
    renumbered: bool = False
    permuted: bool = False

    def factor(self, unit: str) -> float:
        """Factor of a quantity of a unit: mm, N, N mm; 1 for others."""
        return self._scale(UNITS.get(unit, (0, 0)))

    def _scale(self, powers: tuple[int, int]) -> float:
        return self.length ** powers[0] * self.force ** powers[1]

    def deviations(self, scene: Scene, values: np.ndarray) -> np.ndarray:
        """(n, p) amplitudes of the scene's deviations, transformed."""
        return values * np.array([self.factor(deviation_unit(item, scene)) for item in scene.deviations])

    def apply(self, placed: PlacedScene) -> PlacedScene:
        """The transformed scene."""
        rng = np.random.default_rng(len(self.name))
        loaded = []
        for one in placed.loaded:
            surface, vertex = self._surface(one.surface, rng)
            body = one.superelement and self._superelement(one.superelement, vertex)
            part = self._table(one.part)
            loaded.append(replace(one, part=part, surface=surface, drawn=surface, deck=None, superelement=body))
        scene = self._scene(placed.scene)
        if self.permuted:
            scene, loaded = _permuted(scene), loaded[::-1]
        fixtures = {name: self._surface(surface, rng)[0] for name, surface in placed.fixtures.items()}
        return replace(placed, scene=scene, loaded=tuple(loaded), fixtures=fixtures)

    # -------------------------------------------------------------------------------------------------- scene

    def _scene(self, scene: Scene) -> Scene:
        changed = self._table(scene)
        deviations = []
        for item, new in zip(scene.deviations, changed.deviations):
            factor = self.factor(deviation_unit(item, scene))
            scaled: dict[str, Any] = {key: factor * getattr(item, key) for key in ("mean", "sigma")}
            if isinstance(item, ShapeDeviation):
                scaled["values"] = (self.length * item.known).tolist()  # 1 mm, if not stated
            ends = None if item.truncated is None else tuple(factor * end for end in item.truncated)
            deviations.append(new.model_copy(update=scaled | {"truncated": ends}))
        values = scene.monte_carlo.values
        given = None if values is None else self.deviations(scene, np.array(values)).tolist()
        update = {"monte_carlo": scene.monte_carlo.model_copy(update={"values": given}), "deviations": deviations}
        return changed.model_copy(update=update | {"optimise": None, "scans": []})

    def _table(self, item: Any) -> Any:
        """A table of the scene with its points, directions and quantities transformed."""
        return item.model_copy(update={key: self._value(key, getattr(item, key)) for key in type(item).model_fields})

    def _value(self, key: str, value: Any) -> Any:
        if isinstance(value, BaseModel):
            return self._table(value)
        if isinstance(value, (list, tuple)) and any(isinstance(one, BaseModel) for one in value):
            return type(value)(self._value(key, one) if isinstance(one, BaseModel) else one for one in value)
        if value is None or isinstance(value, (str, bool)):
            return value
        if key == "box":
            corners = self.points(np.array(value))
            return tuple(map(tuple, [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()]))
        if key in POINTS:
            return _nested(value, self.points)
        if key in DIRECTIONS:
            return _nested(value, lambda d: d @ self.matrix.T)
        if key == "friction_table":
            return [(self._scale((-2, 1)) * pressure, mu) for pressure, mu in value]
        return _nested(value, lambda x: x * self._scale(POWERS[key])) if key in POWERS else value

    def points(self, x: np.ndarray) -> np.ndarray:
        """Points (…, 3), transformed."""
        return self.length * (x @ self.matrix.T + self.shift)

    # -------------------------------------------------------------------------------------------------- bodies

    def _surface(self, surface: Surface, rng: np.random.Generator) -> tuple[Surface, np.ndarray]:
        """The transformed surface, and the vertex of the given one that each of its vertices was."""
        triangles, normals = surface.triangles, surface.given_normals
        points, vertex = self.points(surface.points), np.arange(len(surface.points))
        corner = np.tile(np.arange(3), (len(triangles), 1))
        if np.linalg.det(self.matrix) < 0:  # normals stay on their side of the sheet
            corner = corner[:, ::-1]
        order = np.arange(len(triangles))
        if self.renumbered:
            vertex, order = rng.permutation(vertex), rng.permutation(order)
            corner = np.take_along_axis(corner, (np.arange(3) + rng.integers(3, size=(len(corner), 1))) % 3, axis=1)
        number = np.argsort(vertex)
        triangles = np.take_along_axis(number[triangles], corner, axis=1)[order]
        if normals is not None:
            normals = np.take_along_axis(normals @ self.matrix.T, corner[:, :, None], axis=1)[order]
        return Surface(points[vertex], triangles, normals), vertex

    def _superelement(self, body: Superelement, vertex: np.ndarray) -> Superelement:
        """The transformed matrix; M maps axes to axes, for a node may lack degrees of freedom."""
        axis, sign = np.abs(self.matrix).argmax(axis=0), self.matrix.sum(axis=0)
        freedom, turn = np.full_like(body.freedom, -1), np.ones(body.matrix.shape[0])
        for kind, handed in ((0, 1.0), (3, np.linalg.det(self.matrix))):  # a rotation is an axial vector
            for component in range(3):
                rows = body.freedom[:, kind + component]
                freedom[:, kind + axis[component]] = rows
                turn[rows[rows >= 0]] = handed * sign[component] * (self.length if kind == 0 else 1.0)
        work = self.length * self.force
        matrix = body.matrix.copy()
        rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        if body.stiffness:
            matrix.data = matrix.data * work / (turn[rows] * turn[matrix.indices])
        else:
            matrix.data = matrix.data / work * (turn[rows] * turn[matrix.indices])
        points = self.points(body.points)
        return replace(body, points=points, freedom=freedom, matrix=matrix, of_vertex=body.of_vertex[vertex])


def _nested(value: Any, change: Any) -> Any:
    """Numbers, or lists and tuples of them, changed at once as an array and given back in their own form."""
    if isinstance(value, (list, tuple)) and value and isinstance(value[0], (list, tuple)):
        return type(value)(_nested(one, change) for one in value)
    changed = change(np.array(value, dtype=float)).tolist()
    return type(value)(changed) if isinstance(value, tuple) else changed


def _permuted(scene: Scene) -> Scene:
    """Parts, locators and clamps from the last to the first; what closes or opens one by one does so as before."""
    stages = []
    for stage, moves in stage_moves(scene):
        groups = [_names(scene, move) for move in moves]
        if stage.kind in ("clamp", "release") and stage.order is None and stage.path != "one-step" and groups:
            stage = stage.model_copy(update={"order": groups})
        stages.append(stage)
    reverse = {key: getattr(scene, key)[::-1] for key in ("parts", "locators", "clamps")}
    return scene.model_copy(update=reverse | {"stages": stages})


def _names(scene: Scene, move: Sequence[Any]) -> list[str]:
    """Names of the locators and clamps of a move."""
    return [scene.locators[i].name for action in move for i in action.locators] + [
        scene.clamps[i].name for action in move for i in action.clamps if i < len(scene.clamps)
    ]


def transformations(placed: PlacedScene) -> Iterator[Transformation]:
    """The transformations that a scene is judged by.

    Right angles are taken where a box is parallel to the axes, or a superelement may lack degrees of freedom.
    """
    right = any(zone.box is not None for zone in placed.scene.zones)
    right |= any(one.superelement is not None for one in placed.loaded)
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    turn, other = (axes if right else Rotation.from_rotvec(v).as_matrix() for v in ([0.4, -0.9, 1.3], [-0.7, 0.2, 0.5]))
    mirror = np.diag([1.0, -1.0, 1.0]) @ other
    size = max(one.surface.diameter for one in placed.loaded)
    yield Transformation("ten times as large", length=10.0, force=100.0)
    yield Transformation("in inches", length=1 / 25.4)
    yield Transformation("a thousand times as stiff", force=1000.0)
    yield Transformation("rotated by right angles" if right else "rotated", turn, size * np.array([0.11, -0.07, 0.03]))
    yield Transformation("mirrored", mirror)
    yield Transformation("renumbered", renumbered=True)
    yield Transformation("parts, locators and clamps in another order", permuted=True)
