"""The parts of an assembly in mesh files: one per file, or one per element set."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mic.errors import SceneError
from mic.geometry.deck import Deck, Sheet
from mic.geometry.readers import RawMesh, read_mesh, read_raw
from mic.geometry.surface import Surface
from mic.geometry.triangles import linked_rows
from mic.scene.part_names import PartNames

__all__ = ["NO_POINTS", "Body", "part_name", "read_bodies"]

METRES = 10.0  # a smaller part, in the file's unit, is assumed to be in metres
YOUNG, POISSON = 210e3, 0.3  # steel, if a mesh file has no material
PLAUSIBLE = (1e3, 1e6)  # MPa; values outside are in other units

NO_POINTS = np.zeros((0, 3))


@dataclass(frozen=True)
class Body:
    """One part.

    Attributes
    ----------
    name : str
    file : Path
    sets : tuple of str
        Element sets of the file that form it; empty for the whole file.
    unit : str
        Unit of length of the file.
    surface : Surface
        As drawn, mm.
    deck : Deck
    thickness : float
        mm.
    thickness_from : str
        Its source: the option, or the mesh file.
    young, poisson : float
        MPa.
    material_from : str
    offset : float or None
        From the drawn surface to the mid-surface, in thicknesses along the normal, if the mesh file has it.
    other_names : tuple of str
        Names by which tables and options may call it: its file, and the element sets in it.
    """

    name: str
    file: Path
    sets: tuple[str, ...]
    unit: str
    surface: Surface
    deck: Deck
    thickness: float
    thickness_from: str
    young: float
    poisson: float
    material_from: str
    offset: float | None
    other_names: tuple[str, ...] = ()

    @cached_property
    def element(self) -> float:
        """Median length of an edge, mm."""
        return float(np.median(self.surface.edge_lengths))

    @cached_property
    def edge(self) -> np.ndarray:
        """(q, 3) points along the free edges, at most half an element apart, mm."""
        triangle, opposite = np.nonzero(self.surface.border)
        return self.surface.at(*self.surface.sample_edges(triangle, opposite, self.element / 2)[:2])


def read_bodies(
    files: Sequence[Path], thickness: Mapping[str | None, float], names: Mapping[str, str] | None = None
) -> list[Body]:
    """The parts in mesh files.

    Element sets that share nodes form one part; sets without common nodes are separate parts.

    Parameters
    ----------
    files : sequence of Path
    thickness : mapping of str or None to float
        mm, by part; the value of None applies to parts that are not named and whose mesh file has no thickness.
    names : mapping of str to str, optional
        New name of a part by any of its names.

    Raises
    ------
    FormatError, SceneError
        If a file cannot be read, a thickness is missing, no part has a name, or a part consists of separate pieces.
    """
    sources: list[tuple[str, Path, tuple[str, ...], list[str]]] = []
    for file in files:
        raw = read_raw(file)
        groups = _groups(raw)
        if len(groups) > 1:
            sources += [(part_name(sets[0]), file, sets, _sets_within(raw, sets)) for sets in groups]
        else:
            sources.append((part_name(file.stem), file, (), list(raw.element_sets)))
    others = [[file.name, file.stem, *within] for _, file, _, within in sources]
    own = _unique([name for name, *_ in sources])
    renamed = _by_part("--name", names or {}, PartNames(dict(zip(own, others))))
    own, others = [renamed.get(name, name) for name in own], [[name, *more] for name, more in zip(own, others)]
    if len(set(own)) < len(own):
        raise SceneError(f"--name: the parts would be {', '.join(own)}; give each a name of its own")
    by_name = {name: value for name, value in thickness.items() if name is not None}
    of_parts: dict[str | None, float] = {None: thickness.get(None, np.nan)}
    of_parts |= _by_part("--thickness", by_name, PartNames(dict(zip(own, others))))
    bodies = [
        _body(name, file, sets, of_parts, tuple(more)) for name, more, (_, file, sets, _) in zip(own, others, sources)
    ]
    missing = [body.name for body in bodies if np.isnan(body.thickness)]
    if missing:
        raise SceneError(
            f"the mesh files lack the thickness of {', '.join(missing)}: give it in mm, --thickness 1.5 for all, or "
            f"--thickness {missing[0]}=1.5 for one"
        )
    return bodies


def _by_part(option: str, given: Mapping[str, Any], parts: PartNames) -> dict[Any, Any]:
    """Values of an option by part."""
    found: dict[str, Any] = {}
    for name, value in given.items():
        part = parts.find(name)
        if part is None:
            raise SceneError(f"{option} {name}=…: {parts.unknown(name)}")
        found[part] = value
    return found


def _sets_within(raw: RawMesh, sets: tuple[str, ...]) -> list[str]:
    """Element sets of a file whose elements all belong to some sets."""
    own = np.concatenate([raw.element_sets[name] for name in sets])
    return [name for name, elements in raw.element_sets.items() if np.isin(elements, own).all()]


def _groups(raw: RawMesh) -> list[tuple[str, ...]]:
    """The element sets of each part of a file; sets that share nodes are together."""
    sets = [name for name in raw.parts if len(raw.element_sets.get(name, ()))]
    if len(sets) < 2:
        return []
    corners = [*raw.triangles, *raw.quadrilaterals]
    nodes = [np.unique(np.concatenate([corners[i] for i in raw.element_sets[name]])) for name in sets]
    row = np.repeat(np.arange(len(sets)), [len(numbers) for numbers in nodes])
    incidence = coo_matrix((np.ones(len(row)), (row, np.concatenate(nodes))), shape=(len(sets), len(raw.points)))
    count, label = connected_components(incidence @ incidence.T, directed=False)
    return [tuple(name for name, own in zip(sets, label) if own == group) for group in range(count)]


def _body(name: str, file: Path, sets: tuple[str, ...], thickness: Mapping, other_names: tuple[str, ...]) -> Body:
    surface, deck = read_mesh(file, sets)
    unit = "mm"
    if surface.diameter < METRES:
        unit = "m"
        surface, deck = read_mesh(file, sets, unit)
    _check_connected(name, file, surface)
    value, source = _thickness(surface, deck, thickness.get(name, np.nan))
    if np.isnan(value):
        value = thickness.get(None, np.nan)
    sheets = deck.distinct_sheets()
    sheet = sheets[0] if len(sheets) == 1 else Sheet()
    young, poisson, material = YOUNG, POISSON, "steel; the mesh file has no material"
    if sheet.young is not None and sheet.poisson is not None:
        if PLAUSIBLE[0] <= sheet.young <= PLAUSIBLE[1]:
            young, poisson = sheet.young, sheet.poisson
            material = f"from the mesh file{f' (material {sheet.material})' if sheet.material else ''}"
        else:
            material = f"steel; the mesh file has {sheet.young:.3g}, which is not in MPa"
    return Body(
        name, file, sets, unit, surface, deck, value, source, young, poisson, material, sheet.offset, other_names
    )


def _thickness(surface: Surface, deck: Deck, given: float) -> tuple[float, str]:
    """The thickness of a part, mm, and its source: as given, else that of most of the area in the mesh file, or NaN."""
    areas: dict[float, float] = {}
    for sheet in deck.distinct_sheets():
        if sheet.thickness is not None:
            same = [number for number, other in enumerate(deck.sheets) if other == sheet]
            area = float(surface.areas[np.isin(deck.sheet_of, same)].sum())
            areas[sheet.thickness] = areas.get(sheet.thickness, 0) + area
    if not np.isnan(given) or not areas:
        return given, "from the command line"
    source = "from the mesh file"
    if len(areas) > 1:
        source += f", the value of the largest area; it has {', '.join(f'{value:g}' for value in sorted(areas))}"
    return max(sorted(areas), key=areas.__getitem__), source


def _check_connected(name: str, file: Path, surface: Surface) -> None:
    count, label = linked_rows(surface.triangles)
    if count > 1:
        largest = ", ".join(str(size) for size in sorted(np.bincount(label), reverse=True)[:5])
        raise SceneError(
            f"{file}: part {name!r} consists of {count} separate pieces (of {largest} triangles): "
            "put each into an element set of its own, or join them in the mesh"
        )


def part_name(text: str) -> str:
    """A valid name for a scene."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text).strip("_")[:25] or "part"


def _unique(names: Sequence[str]) -> list[str]:
    """The names, with numbers appended to repeated ones."""
    return [name if names.count(name) == 1 else f"{name}-{names[: i + 1].count(name)}" for i, name in enumerate(names)]
