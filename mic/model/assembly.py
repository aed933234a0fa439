"""The assembly: a scene put on its meshes, as rows over retained functionals.

Each locator, clamp, weld, contact pair, corrective force and measurement becomes one or more *rows*: sparse combinations
of the parts' retained functionals. The reduced model and the full finite-element reference both work from these rows, so
they mean the same thing on both sides. A row that no stage uses and no report asks for is not made.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.geometry.load import fixture_surface, part_surface
from mic.geometry.pairing import Side, find_pairs, node_pairs, pair_at
from mic.geometry.surface import Patch
from mic.scene import Scene, SceneError

__all__ = ["Assembly", "Contacts", "assemble"]

REACH = 5.0  # mm: farther than this from its part, a point of the scene is refused rather than projected


@dataclass(frozen=True)
class Contacts:
    """The contact pairs of all zones, in the scene's order.

    Attributes
    ----------
    zone : (m,) int array
        Index of the pair's zone in ``scene.zones``.
    friction : (m,) array
    gap : (m,) array
        Nominal gap between the facing surfaces, mm, positive when apart.
    area : (m,) array
        mm².
    point : (m, 3) array
        mm.
    frame : (m, 3, 3) array
        ``frame[k] = [n, t1, t2]`` in columns, n from the first body to the second.
    dimension : int
        Rows per pair: 3 (n, t1, t2), or 1 where nothing tangential is asked for.
    """

    zone: np.ndarray
    friction: np.ndarray
    gap: np.ndarray
    area: np.ndarray
    point: np.ndarray
    frame: np.ndarray
    dimension: int

    def __len__(self):
        return len(self.zone)


@dataclass(frozen=True)
class Assembly:
    """Parts with their retained functionals, and the rows that the process works with.

    Attributes
    ----------
    scene : Scene
    parts : tuple of Part
    rows : dict of str to (r, F) csr_matrix
        Rows over the stacked functionals of all parts (F in all), by what they stand for: ``"locator"``, ``"clamp"``,
        ``"weld"``, ``"contact"``, ``"force"``, ``"measurement"``. A joint's row reads *second body minus first*.
    labels : dict of str to list of str
        One name per row.
    contacts : Contacts
    weld_size : tuple of int
        Rows of each weld (six, or three without moment); the first is normal to the sheets, towards the second part.
    weld_gap : (w,) array
        Nominal gap at each weld, mm.
    """

    scene: Scene
    parts: tuple[Part, ...]
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray

    @property
    def offsets(self) -> np.ndarray:
        """First stacked functional of each part, and the total at the end."""
        return np.concatenate([[0], np.cumsum([len(part.functionals) for part in self.parts])])


class _Retained:
    """Collects the functionals of one part."""

    def __init__(self):
        self.patches, self.patch, self.direction, self.rotation, self.side, self.label = [], [], [], [], [], []

    def add_patch(self, patch: Patch) -> int:
        self.patches.append(patch)
        return len(self.patches) - 1

    def add(self, patch, direction, label, rotation=False, side=0) -> int:
        self.patch.append(patch)
        self.direction.append(np.asarray(direction, dtype=float))
        self.rotation.append(rotation)
        self.side.append(side)
        self.label.append(label)
        return len(self.patch) - 1

    def freeze(self) -> Functionals:
        return Functionals(
            tuple(self.patches),
            np.array(self.patch, dtype=np.int64),
            np.array(self.direction, dtype=float).reshape(-1, 3),
            np.array(self.rotation, dtype=bool),
            np.array(self.side, dtype=float),
            tuple(self.label),
        )


def assemble(scene: Scene, cache: Path, every_node: bool = False) -> Assembly:
    """Mesh the parts, find the contact pairs and set up all rows.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Folder for generated meshes.
    every_node : bool
        One contact pair per mesh vertex in the zones (:func:`mic.geometry.pairing.node_pairs`), not the pairs that the zones ask for.

    Raises
    ------
    SceneError
        Naming the key: a missing mesh, a point off its part, an empty zone.
    """
    surfaces = {part.name: part_surface(part, scene.folder, cache) for part in scene.parts}
    fixtures = {fixture.name: fixture_surface(fixture, scene.folder) for fixture in scene.fixtures}
    thickness = {part.name: part.thickness for part in scene.parts} | {name: 0.0 for name in fixtures}
    bodies = surfaces | fixtures
    retained = {part.name: _Retained() for part in scene.parts}
    table: dict[str, list] = {key: [] for key in ("locator", "clamp", "weld", "contact", "force", "measurement")}
    labels: dict[str, list[str]] = {key: [] for key in table}

    def row(kind, label, *terms):
        """terms: (part, functional, coefficient)"""
        table[kind].append(terms)
        labels[kind].append(label)

    def single(kind, key, item):
        """A row that reads one part at one point along one direction."""
        surface = surfaces[item.part]
        _on_part(key, item.point, item.part, surface)
        body = retained[item.part]
        patch = body.add_patch(surface.patch(item.point, item.radius))
        row(kind, item.name, (item.part, body.add(patch, item.direction, f"{kind} {item.name}"), 1.0))

    for i, locator in enumerate(scene.locators):
        single("locator", f"locators[{i}]", locator)
    for i, clamp in enumerate(scene.clamps):
        single("clamp", f"clamps[{i}]", clamp)
    weld_size, weld_gap = [], []
    for i, weld in enumerate(scene.welds):
        gap = _weld_rows(f"welds[{i}]", weld, surfaces, thickness, retained, row)
        weld_size.append(6 if weld.moment else 3)
        weld_gap.append(gap)
    contacts = _contact_rows(scene, bodies, thickness, retained, row, node_pairs if every_node else find_pairs)
    for i, deviation in enumerate(scene.deviations):
        if deviation.kind == "force":
            single("force", f"deviations[{i}]", deviation)
    for i, measurement in enumerate(scene.measurements):
        single("measurement", f"measurements[{i}]", measurement)

    parts = tuple(
        Part(
            part.name,
            surfaces[part.name],
            part.thickness,
            part.young,
            part.poisson,
            scene.element,
            retained[part.name].freeze(),
        )
        for part in scene.parts
    )
    start = dict(
        zip([part.name for part in parts], np.concatenate([[0], np.cumsum([len(p.functionals) for p in parts])]))
    )
    width = sum(len(part.functionals) for part in parts)
    rows = {}
    for kind, entries in table.items():
        triplets = [
            (i, start[name] + functional, value) for i, terms in enumerate(entries) for name, functional, value in terms
        ]
        i, j, value = np.array(triplets).T if triplets else np.zeros((3, 0))
        rows[kind] = csr_matrix((value, (i.astype(int), j.astype(int))), shape=(len(entries), width))
    return Assembly(scene, parts, rows, labels, contacts, tuple(weld_size), np.array(weld_gap))


def _on_part(key, point, name, surface):
    distance = float(surface.project(point).distance[0])
    if distance > REACH:
        raise SceneError(
            f"{key}.point: {list(point)} lies {distance:.3g} mm off part {name!r} (at most {REACH} mm is allowed); "
            "correct the coordinates or the part"
        )


def _weld_rows(key, weld, surfaces, thickness, retained, row):
    """Rows of one weld: n, t1, t2 translations at the middle of the gap, and the rotations where it carries moment.

    Both parts are read at the same material-free point, half of any nominal gap off their facing surfaces: otherwise
    turning the welded assembly as a whole would strain the weld.
    """
    for name in weld.parts:
        _on_part(key, weld.point, name, surfaces[name])
    try:
        pair = pair_at(weld.point, weld.radius, *(Side(surfaces[name], thickness[name]) for name in weld.parts))
    except ValueError as error:
        raise SceneError(f"{key}.point: {error}; correct the coordinates") from None
    functional = []
    for name, patch, side in zip(weld.parts, pair.patches, pair.sides):
        body = retained[name]
        index = body.add_patch(patch)
        middle = side * (1 + pair.gap / thickness[name])
        functional.append(
            [
                body.add(index, pair.frame[:, j], f"weld {weld.name} {axis}", rotation, 0.0 if rotation else middle)
                for rotation in ((False, True) if weld.moment else (False,))
                for j, axis in enumerate(("n", "t1", "t2"))
            ]
        )
    first, second = weld.parts
    for j, (a, b) in enumerate(zip(*functional)):
        row("weld", f"{weld.name} {('', 'r')[j // 3]}{('n', 't1', 't2')[j % 3]}", (first, a, -1.0), (second, b, 1.0))
    return pair.gap


def _contact_rows(scene, bodies, thickness, retained, row, find):
    """Rows of all contact pairs, and what is known of the pairs."""
    friction = any(law != "frictionless" for law in scene.report.laws) and any(
        zone.friction > 0 for zone in scene.zones
    )
    dimension = 3 if friction or scene.report.slip else 1
    resolved = any(stage.kind != "locate" for stage in scene.stages)
    pairs, zone_of = [], []
    for i, zone in enumerate(scene.zones if resolved else ()):
        sides = [Side(bodies[name], thickness[name]) for name in zone.parts]
        try:
            found = find(zone, *sides)
        except ValueError as error:
            raise SceneError(f"zones[{i}] ({zone.name}): {error}") from None
        for pair in found:
            number = len(pairs)
            terms = [[] for _ in range(dimension)]
            for name, patch, side, sign in zip(zone.parts, pair.patches, pair.sides, (-1.0, 1.0)):
                if name not in retained:
                    continue  # a rigid fixture does not move
                body = retained[name]
                index = body.add_patch(patch)
                for j in range(dimension):
                    reading = body.add(
                        index,
                        pair.frame[:, j],
                        f"contact {number} {('n', 't1', 't2')[j]}",
                        side=0 if zone.mid_surface else side,
                    )
                    terms[j].append((name, reading, sign))
            for j in range(dimension):
                row("contact", f"{zone.name} {number} {('n', 't1', 't2')[j]}", *terms[j])
            pairs.append(pair)
            zone_of.append(i)
    zone_of = np.array(zone_of, dtype=np.int64)
    return Contacts(
        zone_of,
        np.array([scene.zones[i].friction for i in zone_of]),
        np.array([p.gap for p in pairs]),
        np.array([p.area for p in pairs]),
        np.array([p.point for p in pairs]).reshape(-1, 3),
        np.array([p.frame for p in pairs]).reshape(-1, 3, 3),
        dimension,
    )
