"""The deviated geometry: meshes that carry the shape deviation of the parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mic.compliance.part import Part
from mic.geometry.surface import Surface
from mic.model.shape import dilation

__all__ = ["deviated_parts", "gap_change"]


def deviated_parts(assembly, fields: Mapping[str, np.ndarray]) -> list[Part]:
    """Parts on meshes that carry the shape deviation; normals and frames of contacts and welds rotate with it.

    A frame turns by the mean of the rotations of the sheets that it joins.
    Patches keep their material points. Directions prescribed by the fixture (locators, clamps, measurements) stay
    fixed in space.

    Parameters
    ----------
    assembly : mic.model.assembly_types.Assembly
    fields : mapping of str to (n_points, 6) array
        Displacements and rotations of the deviation at the vertices of each part, mm and rad.
    """
    surfaces = [_deviated(part.surface, fields[part.name]) for part in assembly.parts]
    direction = [part.functionals.direction.copy() for part in assembly.parts]
    contacts = assembly.contacts
    for kind, sizes in (("contact", [contacts.dimension] * len(contacts)), ("weld", assembly.weld_size)):
        rows, edges = assembly.rows[kind], np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        for start, stop in zip(rows.indptr[edges], rows.indptr[edges[1:]]):
            columns = rows.indices[start:stop]
            numbers = np.searchsorted(assembly.offsets, columns, side="right") - 1  # of the parts
            local, turns = columns - assembly.offsets[numbers], []
            for p in np.unique(numbers):
                part = assembly.parts[p]
                patch = part.functionals.patches[part.functionals.patch[local[numbers == p][0]]]
                turns.append(
                    _turn(*(patch.weight @ one.normals[patch.triangle] for one in (part.surface, surfaces[p])))
                )
            turn = Rotation.from_rotvec(np.mean(turns, axis=0)).as_matrix()
            for p, i in set(zip(numbers, local)):
                direction[p][i] = turn @ assembly.parts[p].functionals.direction[i]
    return [
        replace(part, surface=surface, functionals=replace(part.functionals, direction=d))
        for part, surface, d in zip(assembly.parts, surfaces, direction)
    ]


def gap_change(assembly, kind: str, parts: list[Part], read: np.ndarray) -> np.ndarray:
    """(r,) change of the distance between the two mid-surfaces along each row of a kind, nominal to deviated, mm.

    For a pair with a rigid fixture, which no row reads, it is the change of the part's distance from the fixture's
    point, d·(x − x_f).

    Parameters
    ----------
    assembly : mic.model.assembly_types.Assembly
    kind : {"contact", "weld"}
    parts : list of Part
        Result of :func:`deviated_parts`.
    read : (r,) array
        Readings of the shape deviations; returned for rows that read rotations.
    """
    rows = assembly.rows[kind]
    turns = abs(rows) @ np.concatenate([part.functionals.rotation for part in parts]) > 0

    def change(of):
        before, after = (rows @ np.concatenate([of(part) for part in version]) for version in (assembly.parts, parts))
        return after - before

    distance_change = change(dilation)
    if kind == "contact":  # rotated directions cancel in a row, except in one with a fixture
        turned = change(_direction).reshape(len(assembly.contacts), assembly.contacts.dimension, 3)
        distance_change -= np.einsum("kdi,ki->kd", turned, _fixture_points(assembly)).ravel()
    return np.where(turns, read, distance_change)


def _fixture_points(assembly) -> np.ndarray:
    """(m, 3) point of the fixture's face at each contact, mm, if one body is a fixture."""
    contacts, half = assembly.contacts, {part.name: 0.5 * part.thickness for part in assembly.parts}
    zones = [zone.parts for zone in assembly.scene.zones]
    sheet = np.array([half.get(first, half.get(second, 0.0)) for first, second in zones])[contacts.zone]
    sign = np.array([1.0 if first in half else -1.0 for first, _ in zones])[contacts.zone]
    return contacts.point + (sign * (sheet + contacts.gap))[:, None] * contacts.frame[:, :, 0]


def _deviated(surface, field):
    """A surface displaced at its vertices, its normals rotated by the rotations there: n + θ × n, to first order."""
    if not field.any():
        return surface
    normals, rotation = surface.corner_normals, field[surface.triangles, 3:]
    return Surface(surface.points + field[:, :3], surface.triangles, normals + np.cross(rotation, normals))


def _direction(part):
    """(F, 3) direction of each functional; zero for rotations."""
    return np.where(part.functionals.rotation[:, None], 0.0, part.functionals.direction)


def _turn(a, b):
    """The smallest rotation vector, rad, that turns the direction of a into that of b."""
    axis = np.cross(a, b)
    angle = np.arctan2(np.linalg.norm(axis), a @ b)
    return axis / (np.linalg.norm(a) * np.linalg.norm(b) * np.sinc(angle / np.pi))
