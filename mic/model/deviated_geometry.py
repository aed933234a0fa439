"""The deviated geometry: meshes that carry the deviation of the parts' shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mic.compliance.part import Part
from mic.geometry.surface import Surface

__all__ = ["deviated_parts", "opening"]


def deviated_parts(assembly, fields: Mapping[str, np.ndarray]) -> list[Part]:
    """Parts on the meshes that carry the shape deviation, normals and frames of contacts and welds turned with it.

    Patches keep their material points. What the fixture prescribes (locators, clamps, measurements) keeps its direction
    in space.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    fields : mapping of str to (n_points, 6) array
        Displacements and rotations of the deviation at the vertices of each part, mm and rad.
    """
    surfaces = [_deviated(part.surface, fields[part.name]) for part in assembly.parts]
    direction = [part.functionals.direction.copy() for part in assembly.parts]
    for kind in ("contact", "weld"):
        rows = assembly.rows[kind]
        for group in _joints(assembly, kind):
            p, first = _owner(assembly, rows.indices[rows.indptr[group.start]])
            part = assembly.parts[p]
            patch = part.functionals.patches[part.functionals.patch[first]]
            turn = _rotation(
                *(patch.weight @ surface.normals[patch.triangle] for surface in (part.surface, surfaces[p]))
            )
            for column in np.unique(rows.indices[rows.indptr[group.start] : rows.indptr[group.stop]]):
                q, i = _owner(assembly, column)
                direction[q][i] = turn @ assembly.parts[q].functionals.direction[i]
    return [
        replace(part, surface=surface, functionals=replace(part.functionals, direction=d))
        for part, surface, d in zip(assembly.parts, surfaces, direction)
    ]


def opening(assembly, kind: str, parts: list[Part], read: np.ndarray) -> np.ndarray:
    """(r,) change of the distance between the two mid-surfaces along each row of a kind, nominal to deviated, mm.

    Of a pair with a rigid fixture, which no row reads, it is that of the part from where the fixture stands,
    d·(x − x_f).

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    kind : {"contact", "weld"}
    parts : list of Part
        As :func:`deviated_parts` made them.
    read : (r,) array
        What the rows read of the deviations of shape: it is the answer of those that read rotations.
    """
    rows = assembly.rows[kind]
    turns = abs(rows) @ np.concatenate([part.functionals.rotation for part in parts]) > 0

    def change(of):
        before, after = (rows @ np.concatenate([of(part) for part in version]) for version in (assembly.parts, parts))
        return after - before

    found = change(_position)
    if kind == "contact":  # a fixture is all that a row's directions, turned, do not cancel for
        turned = change(_direction).reshape(len(assembly.contacts), -1, 3)
        found -= np.einsum("kdi,ki->kd", turned, _standing(assembly)).ravel()
    return np.where(turns, read, found)


def _standing(assembly) -> np.ndarray:
    """(m, 3) where at each contact the fixture's face stands, mm, if one body is a fixture."""
    contacts, half = assembly.contacts, {part.name: 0.5 * part.thickness for part in assembly.parts}
    zones = [zone.parts for zone in assembly.scene.zones]
    sheet = np.array([half.get(first, half.get(second, 0.0)) for first, second in zones])[contacts.zone]
    ahead = np.array([1.0 if first in half else -1.0 for first, _ in zones])[contacts.zone]
    return contacts.point + (ahead * (sheet + contacts.gap))[:, None] * contacts.frame[:, :, 0]


def _deviated(surface, field):
    """A surface displaced at its vertices, its normals turned by the rotations there: n + θ × n, to first order."""
    if not field.any():
        return surface
    normals, rotation = surface.corner_normals, field[surface.triangles, 3:]
    return Surface(surface.points + field[:, :3], surface.triangles, normals + np.cross(rotation, normals))


def _position(part):
    """(F,) where each functional's patch stands along its direction, mm; zero for rotations."""
    f = part.functionals
    patches = [f.patches[i] for i in f.patch]
    return np.array(
        [
            0.0 if rotation else d @ (patch.weight @ part.surface.at(patch.triangle, patch.barycentric))
            for patch, d, rotation in zip(patches, f.direction, f.rotation)
        ]
    )


def _direction(part):
    """(F, 3) direction along which each functional reads where its patch stands; zero for rotations."""
    return np.where(part.functionals.rotation[:, None], 0.0, part.functionals.direction)


def _joints(assembly, kind):
    """Row slices of each contact or weld."""
    sizes = assembly.weld_size if kind == "weld" else [assembly.contacts.dimension] * len(assembly.contacts)
    edges = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    return [slice(lo, hi) for lo, hi in zip(edges, edges[1:])]


def _owner(assembly, column):
    """Part and own number of a stacked functional."""
    p = int(np.searchsorted(assembly.offsets, column, side="right") - 1)
    return p, int(column - assembly.offsets[p])


def _rotation(a, b):
    """The smallest rotation that turns the direction of a into that of b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + a @ b)
