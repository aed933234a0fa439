"""Models of an assembly with relocated items, from one computation of its influence coefficients.

The functionals of an item are retained at all of its candidate points together: every part is factorised once, and each
model selects its rows and columns of H and its rows of G. If a combination of places needs functionals that no single
place has, such as contact pairs that depend on two pads, the part is computed again with these included. The nugget of
a fused weld has elements of its own, so that its part is factorised for each of its places.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mic.compliance.cache import influence_coefficients
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.functional import Functionals
from mic.errors import SceneError
from mic.model.assembly import Assembly
from mic.model.rows import REACH
from mic.process.feasible_assembly import assemble_feasible
from mic.process.model import ReducedModel
from mic.scene import Scene
from mic.scene.optimisation import named_items
from mic.studies.optimisation.design import Design, Space

__all__ = ["RelocatedModels", "check_places"]

Mesh = tuple[str, bytes]  #: name of a part and the bytes of its mesh


class RelocatedModels:
    """Builds models of a scene with its items at other places.

    Parameters
    ----------
    space : Space
    cache : Path
        Folder of meshes and influence coefficients.
    progress : callable
        Called with one line of text before each solve.

    Raises
    ------
    SceneError
        If a candidate lies off its part, or the meshes of the parts are not available.
    """

    def __init__(self, space: Space, cache: Path, progress: Callable[[str], None] = lambda line: None):
        self._cache, self._progress = cache, progress
        # The retained functionals by their keys, each with its row there.
        self._retained: dict[Mesh, dict[bytes, tuple[Functionals, int]]] = {}
        self._coefficients: dict[Mesh, InfluenceCoefficients] = {}
        try:
            stated = assemble_feasible(space.scene, cache)
        except SceneError as problem:
            raise SceneError(
                f"optimise.places: other places require the meshes of the parts, which cannot be read ({problem}); run "
                "the command on the scene file, next to its meshes"
            ) from None
        check_places(space, stated)
        for number, points in enumerate(space.points):
            for choice in range(1, len(points)):
                places = tuple(choice if i == number else 0 for i in range(len(space.points)))
                scene = space.with_places_of(Design(space.stated.settings, space.stated.orders, places))
                try:
                    self._retain(assemble_feasible(scene, cache))
                except SceneError as problem:
                    raise SceneError(
                        f"optimise.places[{number}].points[{choice - 1}] ({space.items[number]}): {problem}"
                    ) from None

    def model(self, scene: Scene) -> ReducedModel:
        """The model of a scene with relocated items."""
        assembly = assemble_feasible(scene, self._cache)
        self._retain(assembly)
        missing = {part.name: _mesh(part) for part in assembly.parts if _mesh(part) not in self._coefficients}
        if missing:
            parts = tuple(
                replace(part, functionals=_joined([*self._retained[_mesh(part)].values()])) for part in assembly.parts
            )
            partial = replace(assembly, parts=tuple(part for part in parts if part.name in missing))
            coefficients = influence_coefficients(partial, self._cache, self._progress)[0]
            self._coefficients |= {mesh: coefficients[name] for name, mesh in missing.items()}
        selected = {part.name: self._select(part) for part in assembly.parts}
        return ReducedModel.build(assembly, selected)

    def _retain(self, assembly: Assembly) -> None:
        """Add the functionals of an assembly to the retained ones; a part with new ones is marked for computation."""
        for part in assembly.parts:
            retained = self._retained.setdefault(_mesh(part), {})
            before = len(retained)
            for i, key in enumerate(_keys(part.functionals)):
                retained.setdefault(key, (part.functionals, i))
            if len(retained) > before:
                self._coefficients.pop(_mesh(part), None)

    def _select(self, part) -> InfluenceCoefficients:
        """Select the coefficients of the functionals of a part."""
        coefficients = self._coefficients[_mesh(part)]
        places = {key: row for row, key in enumerate(self._retained[_mesh(part)])}
        rows = np.array([places[key] for key in _keys(part.functionals)], dtype=int)
        thicknesses = coefficients.thicknesses
        if thicknesses is not None:
            thicknesses = replace(thicknesses, H=thicknesses.H[:, rows][:, :, rows], G=thicknesses.G[:, rows])
        return replace(
            coefficients, H=coefficients.H[np.ix_(rows, rows)], G=coefficients.G[rows], thicknesses=thicknesses
        )


def _mesh(part) -> Mesh:
    """Identify the mesh of a part: elements at a nugget are divided, so that it depends on the nugget's place."""
    return part.name, part.surface.points.tobytes() + part.surface.triangles.tobytes()


def _keys(functionals: Functionals) -> list[bytes]:
    """Identify each functional of a part by its bytes."""
    patches = [
        b"".join(np.ascontiguousarray(array).tobytes() for array in vars(patch).values())
        for patch in functionals.patches
    ]
    rows = zip(functionals.patch, np.ascontiguousarray(functionals.direction), functionals.rotation, functionals.side)
    return [patches[p] + d.tobytes() + bytes([bool(r)]) + np.float64(s).tobytes() for p, d, r, s in rows]


def _joined(rows: Sequence[tuple[Functionals, int]]) -> Functionals:
    """Functionals from rows of others."""
    patches = [own.patches[own.patch[i]] for own, i in rows]
    numbers = {identity: number for number, identity in enumerate(dict.fromkeys(map(id, patches)))}
    return Functionals(
        tuple({id(patch): patch for patch in patches}.values()),
        np.array([numbers[id(patch)] for patch in patches], dtype=int),
        np.array([own.direction[i] for own, i in rows]),
        np.array([own.rotation[i] for own, i in rows]),
        np.array([own.side[i] for own, i in rows]),
        tuple(own.label[i] for own, i in rows),
    )


def check_places(space: Space, assembly: Assembly) -> None:
    """Check that every candidate lies on the part, or the parts, of its item.

    Raises
    ------
    SceneError
        Names each candidate that does not, and the nearest point that does.
    """
    surfaces, lines = assembly.surfaces, []
    for i, (item, points) in enumerate(zip(space.items, space.points)):
        owner, reported = named_items(space.scene, item)[0], set[int]()
        for name in getattr(owner, "parts", None) or [owner.part]:
            foot = surfaces[name].project(np.array(points[1:], dtype=float))
            for j, (point, distance, nearest) in enumerate(zip(points[1:], foot.distance, foot.point)):
                if distance > REACH and j not in reported:
                    lines.append(
                        f"optimise.places[{i}].points[{j}] ({item}): {_format_point(point)} is {distance:.3g} mm away "
                        f"from part {name!r} (at most {REACH:g} mm is allowed); the nearest point on it is "
                        f"{_format_point(nearest)}"
                    )
                    reported.add(j)
    if lines:
        raise SceneError("\n".join(lines))


def _format_point(point) -> str:
    return f"[{', '.join(f'{x:.6g}' for x in point)}]"
