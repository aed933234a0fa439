"""Models of an assembly with relocated items, from one computation of its influence coefficients.

The functionals of an item are retained at all of its candidate points together: every part is factorised once, and each
model selects its rows and columns of H and its rows of G. If a combination of places needs functionals that no single
place has, such as contact pairs that depend on two pads, the part is computed again with these included. The nugget of
a fused weld has elements of its own, so that its part is factorised for each of its places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mic.compliance.cache import influence_coefficients
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.functional import Functionals
from mic.compliance.thickness import Thicknesses
from mic.errors import SceneError
from mic.model.assembly import Assembly, assemble
from mic.model.rows import REACH
from mic.process.model import ReducedModel
from mic.process.plan import plan_assembly
from mic.scene import Scene
from mic.scene.optimisation import standing
from mic.studies.optimisation.design import Design, Space

__all__ = ["RelocatedModels", "on_their_parts"]

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
        self._retained: dict[Mesh, Functionals] = {}
        self._places: dict[Mesh, dict[bytes, int]] = {}
        self._coefficients: dict[Mesh, InfluenceCoefficients] = {}
        try:
            stated = self._assemble(space.scene)
        except SceneError as problem:
            raise SceneError(
                f"optimise.places: other places take the parts' meshes, and they cannot be had ({problem}); give the "
                "scene file, beside which they lie"
            ) from None
        on_their_parts(space, stated)
        for own, points in enumerate(space.points):
            for at in range(1, len(points)):
                places = tuple(at if i == own else 0 for i in range(len(space.points)))
                scene = space.with_places_of(Design(space.stated.settings, space.stated.orders, places))
                try:
                    self._retain(self._assemble(scene))
                except SceneError as problem:
                    raise SceneError(
                        f"optimise.places[{own}].points[{at - 1}] ({space.items[own]}): {problem}"
                    ) from None

    def model(self, scene: Scene) -> ReducedModel:
        """The model of a scene with relocated items."""
        assembly = self._assemble(scene)
        self._retain(assembly)
        missing = {part.name: _mesh(part) for part in assembly.parts if _mesh(part) not in self._coefficients}
        if missing:
            whole = tuple(replace(part, functionals=self._retained[_mesh(part)]) for part in assembly.parts)
            own = replace(assembly, parts=tuple(part for part in whole if part.name in missing))
            found = influence_coefficients(own, self._cache, self._progress)[0]
            self._coefficients |= {mesh: found[name] for name, mesh in missing.items()}
        selected = {part.name: self._select(part) for part in assembly.parts}
        return ReducedModel.build(assembly, selected)

    def _assemble(self, scene: Scene) -> Assembly:
        assembly = assemble(scene, self._cache, check=plan_assembly)
        plan_assembly(assembly)
        return assembly

    def _retain(self, assembly: Assembly) -> None:
        """Add the functionals of an assembly to the retained ones; a part with new ones is marked for computation."""
        for part in assembly.parts:
            mesh = _mesh(part)
            places = self._places.setdefault(mesh, {})
            own, before = part.functionals, len(places)
            fresh = []
            for i, key in enumerate(_keys(own)):
                if key not in places:
                    places[key] = len(places)
                    fresh.append(i)
            if len(places) > before:
                self._retained[mesh] = _append(self._retained.get(mesh), own, fresh)
                self._coefficients.pop(mesh, None)

    def _select(self, part) -> InfluenceCoefficients:
        """Select the coefficients of the functionals of a part."""
        whole, places = self._coefficients[_mesh(part)], self._places[_mesh(part)]
        at = np.array([places[key] for key in _keys(part.functionals)], dtype=int)
        varied = whole.thicknesses
        if varied is not None:
            varied = Thicknesses(varied.t, varied.low, varied.high, varied.H[:, at][:, :, at], varied.G[:, at])
        return replace(whole, H=whole.H[np.ix_(at, at)], G=whole.G[at], thicknesses=varied)


def _mesh(part) -> Mesh:
    """Identify the mesh of a part: elements at a nugget are divided, so that it depends on the nugget's place."""
    return part.name, part.surface.points.tobytes() + part.surface.triangles.tobytes()


def _keys(own: Functionals) -> list[bytes]:
    """Identify each functional of a part by its bytes."""
    patches = [b"".join(np.ascontiguousarray(array).tobytes() for array in vars(one).values()) for one in own.patches]
    rows = zip(own.patch, np.ascontiguousarray(own.direction), own.rotation, own.side)
    return [patches[p] + d.tobytes() + bytes([bool(r)]) + np.float64(s).tobytes() for p, d, r, s in rows]


def _append(known: Functionals | None, own: Functionals, rows: list[int]) -> Functionals:
    """Append rows of functionals to the retained ones."""
    if known is None:
        known = replace(own, patches=(), **{name: getattr(own, name)[:0] for name in ("patch", "direction")})
        known = replace(known, rotation=own.rotation[:0], side=own.side[:0], label=())
    patches = sorted({int(own.patch[i]) for i in rows})
    number = {p: len(known.patches) + i for i, p in enumerate(patches)}
    return Functionals(
        (*known.patches, *(own.patches[p] for p in patches)),
        np.concatenate([known.patch, [number[int(own.patch[i])] for i in rows]]).astype(int),
        np.concatenate([known.direction, own.direction[rows]]),
        np.concatenate([known.rotation, own.rotation[rows]]),
        np.concatenate([known.side, own.side[rows]]),
        (*known.label, *(own.label[i] for i in rows)),
    )


def on_their_parts(space: Space, assembly: Assembly) -> None:
    """Check that every candidate lies on the part, or the parts, of its item.

    Raises
    ------
    SceneError
        Names each candidate that does not, and the nearest point that does.
    """
    surfaces, lines = assembly.surfaces, []
    for i, (item, points) in enumerate(zip(space.items, space.points)):
        owner, off = standing(space.scene, item)[0], set[int]()
        for name in getattr(owner, "parts", None) or [owner.part]:
            foot = surfaces[name].project(np.array(points[1:], dtype=float))
            for j, (point, far, near) in enumerate(zip(points[1:], foot.distance, foot.point)):
                if far > REACH and j not in off:
                    lines.append(
                        f"optimise.places[{i}].points[{j}] ({item}): {_format_point(point)} is {far:.3g} mm away from "
                        f"part {name!r} (at most {REACH:g} mm is allowed); the nearest point on it is "
                        f"{_format_point(near)}"
                    )
                    off.add(j)
    if lines:
        raise SceneError("\n".join(lines))


def _format_point(point) -> str:
    return f"[{', '.join(f'{x:.6g}' for x in point)}]"
