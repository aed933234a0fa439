"""The parts of a run as few short arrays: whole numbers in 32 bits, and equal normals of a vertex once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.geometry.surface import Patch, Surface
from mic.system.memoise import pack, unpack

__all__ = ["pack_parts", "unpack_parts"]

_SHEET = ("name", "thickness", "young", "poisson", "element")
_PATCH = ("triangle", "barycentric", "weight")
_ROWS = ("patch", "direction", "rotation", "side", "label")


def pack_parts(parts: Sequence[Part]) -> tuple[Any, dict[str, np.ndarray]]:
    """Header and arrays, as :func:`mic.system.memoise.pack` returns them.

    Superelements and ranges of thickness are left out.
    """
    return pack([_packed(part) for part in parts], {})


def unpack_parts(header: Any, arrays: Mapping[str, np.ndarray]) -> tuple[Part, ...]:
    """The parts of :func:`pack_parts`.

    Raises
    ------
    Exception
        Of any type, for other content.
    """
    return tuple(_unpacked(content) for content in unpack(header, arrays, (), {}))


def _packed(part: Part) -> dict[str, Any]:
    surface, functionals, patches = part.surface, part.functionals, part.functionals.patches
    content = {name: getattr(part, name) for name in _SHEET} | {name: getattr(functionals, name) for name in _ROWS}
    content |= {name: np.concatenate([getattr(patch, name) for patch in patches]) for name in _PATCH}
    content |= {"ends": np.cumsum([len(patch.weight) for patch in patches]), "points": surface.points}
    content |= {"triangles": surface.triangles.astype(np.int32), "triangle": content["triangle"].astype(np.int32)}
    if surface.given_normals is not None:
        given, vertex = surface.given_normals.reshape(-1, 3), np.zeros_like(surface.points)
        vertex[surface.triangles.ravel()] = given
        # Compared bit by bit, since a normal may be NaN.
        other = (vertex.view(np.int64)[surface.triangles.ravel()] != given.view(np.int64)).any(axis=1)
        content |= {"vertex_normal": vertex, "corner": np.flatnonzero(other), "corner_normal": given[other]}
    return content


def _unpacked(content: Mapping[str, Any]) -> Part:
    triangles, given = content["triangles"].astype(np.int64), None
    if "vertex_normal" in content:
        corners = content["vertex_normal"][triangles.ravel()]
        corners[content["corner"]] = content["corner_normal"]
        given = corners.reshape(-1, 3, 3)
    columns = {name: content[name] for name in _PATCH} | {"triangle": content["triangle"].astype(np.int64)}
    pieces = (np.split(columns[name], content["ends"][:-1]) for name in _PATCH)
    return Part(
        **{name: content[name] for name in _SHEET},
        surface=Surface(content["points"], triangles, given),
        functionals=Functionals(tuple(map(Patch, *pieces)), **{name: content[name] for name in _ROWS}),
    )
