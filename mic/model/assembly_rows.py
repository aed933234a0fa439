"""Sets up the parts and all rows of a placed scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mic.compliance.matrices import read_matrix
from mic.compliance.part import Part
from mic.compliance.superelement import ELEMENT, Superelement, superelement
from mic.errors import FormatError, Problems, SceneError
from mic.geometry.deck import UNITS
from mic.geometry.load import LoadedPart, load_fixture
from mic.geometry.pairing import Side, candidate_spacing
from mic.geometry.surface import Surface
from mic.model import characteristics
from mic.model.assembly_types import AssemblyRows
from mic.model.contact_rows import contact_rows, gap_point_rows
from mic.model.position_rows import position_rows
from mic.model.refined_mesh import refined_part
from mic.model.rows import Rows
from mic.model.sources import sources, thickness_ranges
from mic.model.weld_rows import weld_gaps, weld_rows
from mic.model.zone_pairs import pressed_places, zone_pairs
from mic.scene import Scene
from mic.system.files import fingerprint

__all__ = ["assembly_rows", "matrix_files"]


def assembly_rows(
    scene: Scene,
    loaded: Sequence[LoadedPart],
    surfaces: Mapping[str, Surface],
    fixtures: Mapping[str, Surface],
    every_node: bool,
    problems: Problems,
) -> AssemblyRows:
    """Parts and rows: they depend on the scene, the surfaces and the matrices of superelements only.

    Parameters
    ----------
    scene : Scene
        With all items placed.
    loaded : sequence of LoadedPart
    surfaces, fixtures : mapping of str to Surface
        Surfaces of the parts, and of the fixtures that have meshes.
    every_node : bool
        Whether every mesh vertex in the zones becomes a candidate.
    problems : Problems
        Errors of the scene so far; items with errors are missing from the scene.

    Raises
    ------
    SceneError
        With one line for each of these problems and of those found here.
    """
    bodies = _bodies(scene, surfaces, fixtures)
    rows = Rows(scene, bodies)
    for kind, items in (("locator", scene.locators), ("clamp", scene.clamps)):
        for i, item in enumerate(items):
            with problems:
                rows.point(kind, f"{kind}s[{i}]", item)
    drawn: dict[str, np.ndarray] = {}
    for i, weld in enumerate(scene.welds):
        with problems:
            drawn[weld.name] = weld_rows(f"welds[{i}]", weld, rows)
    pressed = [pressed_places(scene, zone, bodies) for zone in scene.zones]
    pairs = zone_pairs(scene, bodies, pressed, every_node, problems)
    contacts = contact_rows(rows, pairs, every_node, problems)
    if not problems:  # points between pairs need the pairs of all zones
        between = gap_point_rows(rows, pressed, [] if every_node else pairs)
    weld_gap = weld_gaps(scene, contacts, drawn, problems)
    for source in sources(scene):
        with problems:
            source.retain(rows)
    characteristics.retain(rows, problems)
    position_gap = position_rows(rows, problems)
    matrices: dict[str, Superelement | None] = {}
    for part in loaded:
        with problems:
            matrices[part.part.name] = _superelement(scene, part)
    problems.raise_all()
    spacing = np.array([pair.spacing for zone in pairs for pair in zone])
    return AssemblyRows(
        parts=tuple(
            refined_part(part, scene, contacts.zone, contacts.point, spacing) for part in _parts(scene, rows, matrices)
        ),
        rows=rows.matrices(),
        labels=rows.labels,
        contacts=contacts,
        between=between,
        weld_size=tuple(len(gap) for gap in drawn.values()),
        weld_gap=weld_gap,
        spacing=tuple(
            candidate_spacing(zone, bodies[zone.parts[0]], bodies[zone.parts[1]], places)
            if pairs and zone.candidates
            else None
            for zone, places in zip(scene.zones, pressed)
        ),
        position_gap=position_gap,
    )


def _parts(scene: Scene, rows: Rows, matrices: Mapping[str, Superelement | None]) -> list[Part]:
    """The parts with their retained functionals, on their meshes as drawn."""
    varied = thickness_ranges(scene)
    parts = [
        Part(
            part.name,
            rows.surfaces[part.name],
            *part.sheet,
            scene.element if matrices[part.name] is None else ELEMENT,
            rows.functionals(part.name),
            matrices[part.name],
            varied.get(part.name),
        )
        for part in scene.parts
    ]
    for part in parts:
        if part.superelement is not None:
            part.superelement.readings(part)  # raises its errors before anything is solved
    return parts


def _bodies(scene: Scene, surfaces, fixtures) -> dict[str, Side]:
    """Parts and fixtures by name; a pad without a mesh is drawn from its point and radius."""
    thickness = {part.name: part.thickness for part in scene.parts}
    bodies = {name: Side(surface, thickness[name]) for name, surface in surfaces.items()}
    pads = [pad for pad in scene.fixtures if pad.mesh is None]
    discs = {pad.name: (pad.point, pad.radius) for pad in pads if pad.point and pad.radius}
    rigid = {**fixtures, **{pad.name: load_fixture(pad, scene.folder)[0] for pad in pads}}
    return bodies | {name: Side(surface, disc=discs.get(name)) for name, surface in rigid.items()}


def matrix_files(scene: Scene) -> dict[str, str | None]:
    """Hashes of the existing matrix files of superelements, and of their node tables, by name."""
    hashes: dict[str, str | None] = {}
    for part in scene.parts:
        name = part.stiffness if part.stiffness is not None else part.compliance
        if name is not None:
            path = scene.folder / name
            for file in (path, path.with_suffix(".csv")):
                if file.is_file():
                    hashes[str(Path(name).with_name(file.name))] = fingerprint(file.read_bytes())
    return hashes


def _superelement(scene: Scene, loaded: LoadedPart) -> Superelement | None:
    """The matrix that replaces a part's mesh in the solution, if the scene states one."""
    part = loaded.part
    key = "stiffness" if part.stiffness is not None else "compliance"
    name = getattr(part, key)
    if name is None or loaded.superelement is not None:
        return loaded.superelement
    if scene.report.fields or scene.report.accuracy:
        raise SceneError(
            f"part {part.name!r}: {key}: a superelement has displacements at its own nodes only; leave fields and "
            "accuracy out of [report]"
        )
    try:
        matrix = read_matrix(scene.folder / name, scene.folder)
    except FormatError as problem:
        raise SceneError(f"part {part.name!r}: {key}: {problem}") from problem
    deck = loaded.deck
    numbered = {} if deck is None else dict(zip(deck.nodes.tolist(), loaded.drawn.points[deck.node_points]))
    return superelement(part.name, matrix, key == "stiffness", UNITS[part.unit], loaded.drawn, numbered)
