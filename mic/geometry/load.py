"""Surfaces of a scene's parts and fixtures: read from mesh files, built by geometry scripts, or round pads.

What a geometry script is, :mod:`mic.geometry.script` says.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mic.errors import SceneError
from mic.geometry import grading, structured
from mic.geometry.deck import Deck
from mic.geometry.grading import GradedSize
from mic.geometry.offset import moved
from mic.geometry.refinement import halved
from mic.geometry.script import build, named_sizes
from mic.geometry.script_dependencies import Dependencies, opened_files
from mic.geometry.surface import Surface
from mic.scene.part import USUAL
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = [
    "LoadedPart",
    "coarsest_size",
    "finer_surface",
    "fixture_surface",
    "load_fixture",
    "load_part",
]

GENERATED = Format("generated mesh", 3, ABSENT)

#: What a deck may tell of a part, mm and MPa; beyond lies another unit.
LIKELY = {"thickness": (1e-2, 50.0), "offset": (-5.0, 5.0), "young": (1e3, 1e6), "poisson": (-0.99, 0.499)}
PIECES = 3  # of a part in pieces that are named


@dataclass(frozen=True)
class LoadedPart:
    """A part with its mesh.

    Attributes
    ----------
    part : mic.scene.part.Part
        Thickness, offset and material filled in: as the scene has them, else as the mesh file tells.
    surface, drawn : Surface
        The middle of the sheet, moved by the offset; and as the mesh has it.
    inputs : dict of str to str
        Hashes by what they stand for: files (None for one that a script looked for in vain), and the triangles of a
        generated mesh.
    deck : Deck, optional
        What the mesh file tells beside the mesh; None of a generated mesh.
    """

    part: Any
    surface: Surface
    drawn: Surface
    inputs: dict[str, str | None]
    deck: Deck | None = None


def load_part(part: Any, folder: Path, cache: Path, size: float | None = None) -> LoadedPart:
    """A part with its surface, from its mesh file or its geometry script.

    A generated mesh is kept in `cache` under the hash of the part's name, the size, and all Python files of the
    script's folder and of the folder above, which it may import; see :mod:`mic.system.disk_cache` for what is believed of it. It is
    used again only while every file that the script read, or declares, holds what it held.

    Parameters
    ----------
    part : mic.scene.part.Part
    folder : Path
        Of the scene file; the part's paths are relative to it.
    cache : Path
    size : float, optional
        Element size, mm, of a part that gives none; may be a :class:`mic.geometry.grading.GradedSize`.

    Raises
    ------
    SceneError
        Naming part, key and file, where the file is missing, unusable, or fails; where nothing tells the thickness, or
        a mesh file tells several; where the part is in pieces, or cannot be moved by its offset.
    """
    key = "mesh" if part.mesh is not None else "geometry"
    path = folder / getattr(part, key)
    if not path.is_file():
        raise SceneError(
            f"part {part.name!r}: {key}: there is no file {path}; correct the name (it is relative to the scene file)"
        )
    if part.mesh is not None:
        sets = [part.set] if isinstance(part.set, str) else part.set or ()
        surface, deck, inputs = _read(f"part {part.name!r}", path, part.mesh, sets, part.unit, part.size)
        part = _filled(part, deck)
        _one_piece(part, surface)
        return LoadedPart(part, _middle(part, surface), surface, inputs, deck)
    surface, read = _generated(part, path, cache, size or part.size)
    # The files stand for what is computed from them, and the triangles, whole numbers, for the mesher that computes it.
    inputs = {f"triangles of {part.name}": fingerprint(np.ascontiguousarray(surface.triangles, dtype="<i8").tobytes())}
    where = os.path.dirname(part.geometry)
    inputs |= {os.path.normpath(os.path.join(where, name)): kept for name, kept in read.files.items()}
    _one_piece(part, surface)
    return LoadedPart(part, _middle(part, surface), surface, inputs)


def finer_surface(part: Any, folder: Path, cache: Path, size: float | None = None) -> Surface:
    """Surface of a part at half the element size: built anew by its geometry, else its mesh divided on its curvature.

    Parameters and errors are those of :func:`load_part`.
    """
    if part.mesh is not None:
        surface = load_part(part, folder, cache).surface
        return Surface(*halved(surface.points, surface.triangles, surface.corner_normals))
    return _middle(part, _generated(part, folder / part.geometry, cache, size or part.size, 0.5)[0])


def coarsest_size(part: Any, folder: Path) -> float | None:
    """The largest of the sizes that a part's geometry script names, mm; None where it names none.

    Raises
    ------
    SceneError
    """
    path = folder / part.geometry
    return max(named_sizes(part.name, path).values(), default=None)


def fixture_surface(fixture: Any, folder: Path) -> Surface:
    """Surface of a rigid fixture, see :func:`load_fixture`."""
    return load_fixture(fixture, folder)[0]


def load_fixture(fixture: Any, folder: Path) -> tuple[Surface, dict[str, str | None]]:
    """Surface of a rigid fixture: its mesh, or a flat round pad with its normal outwards; and the content of its file.

    The pad's triangles reach around its circle; pairing cuts them at its radius.

    Parameters
    ----------
    fixture : mic.scene.fixture.Fixture
    folder : Path
        Of the scene file; the fixture's mesh is relative to it.

    Raises
    ------
    SceneError
        Naming fixture, key and file, where the mesh is missing or unusable.
    """
    if fixture.mesh is not None:
        path = folder / fixture.mesh
        if not path.is_file():
            raise SceneError(f"fixture {fixture.name!r}: mesh: there is no file {path}; correct the name")
        surface, _, inputs = _read(f"fixture {fixture.name!r}", path, fixture.mesh)
        return surface, inputs
    n = np.array(fixture.normal)
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    rim = fixture.radius / np.cos(np.pi / 36) * (np.cos(angle)[:, None] * t + np.sin(angle)[:, None] * np.cross(n, t))
    triangles = np.column_stack([np.zeros(36, int), 1 + np.arange(36), 1 + (np.arange(36) + 1) % 36])
    return Surface(np.vstack([np.zeros(3), rim]) + fixture.point, triangles), {}


def _filled(part, deck):
    """The part with what it leaves open filled in by what its deck tells.

    Of a deck in metres the modulus is in Pa, in millimetres in MPa; one that is no stiffness of a sheet in that unit,
    such as 210 for GPa, is refused rather than guessed at.
    """
    found: dict[str, Any] = {}
    for key, (low, high) in LIKELY.items():
        if getattr(part, key) is not None:
            continue
        values = [getattr(sheet, key) for sheet in deck.told()]
        told = [value for value in values if value is not None]
        if len(set(values)) > 1:
            listed = ", ".join("nothing" if value is None else f"{value:g}" for value in dict.fromkeys(values))
            raise SceneError(
                f"part {part.name!r}: {key}: {part.mesh} tells several, {listed}, and a part has one; give {key}, or "
                "choose among its element sets by `set`"
            )
        value = told[0] if told else USUAL.get(key)
        if value is None:
            raise SceneError(f"part {part.name!r}: {key}: neither the scene nor {part.mesh} tells it; add {key}")
        found[key] = value
        if told and not low <= value <= high:
            raise SceneError(
                f"part {part.name!r}: {key}: {part.mesh} tells {value:g} if its unit is {part.unit!r}, which no sheet "
                f"has; correct unit, or give {key}"
            )
    return part.model_copy(update=found) if found else part


def _one_piece(part, surface):
    """Refuse a part that does not hang together: nothing would hold the rest."""
    n = len(surface.points)
    start = surface.triangles.ravel()
    graph = coo_matrix((np.ones(len(start)), (start, np.roll(surface.triangles, -1, axis=1).ravel())), shape=(n, n))
    count, piece = connected_components(graph, directed=False)
    piece = piece[surface.triangles[:, 0]]
    sizes = np.bincount(piece, minlength=count)
    many = np.count_nonzero(sizes)
    if many == 1:
        return
    largest = np.argsort(-sizes, kind="stable")[: min(PIECES, many)]
    told = []
    for one in largest:
        place = ", ".join(f"{x:.1f}" for x in surface.corners[piece == one].mean(axis=(0, 1)))
        told.append(f"{sizes[one]} triangles about ({place})")
    raise SceneError(
        f"part {part.name!r}: {'mesh' if part.mesh is not None else 'geometry'}: it is in {many} pieces that share no "
        f"point: {'; '.join(told)}{', …' if many > PIECES else ''}; make each a part of its own (`set` chooses among "
        "the sets of a file), or join their points"
    )


def _middle(part, surface):
    """The surface moved to the middle of the sheet."""
    try:
        return moved(surface, part.offset * part.thickness)
    except ValueError as problem:
        raise SceneError(f"part {part.name!r}: offset: {problem}") from problem


def _read(owner, path, name, sets=(), unit="mm", size=None):
    from mic.geometry.readers import read_mesh  # the libraries behind it are slow to import; scripts do not need them

    try:
        with opened_files() as heard:  # a mesh file may include others
            surface, deck = read_mesh(path, sets, unit, size)
        read = Dependencies.of(path, [path.name], heard)
    except ValueError as problem:
        raise SceneError(f"{owner}: mesh: {problem}") from problem
    others = {other: content for other, content in read.files.items() if other != path.name and content is not None}
    return surface, deck, {name: fingerprint(path.read_bytes())} | others


def _generated(part, path, cache, size, share=1.0):
    """Surface that a script makes at a share of a size, from the cache where it fits; and what it read."""
    meshes, key = Cache(cache, "meshes", GENERATED), _key(part, path, size, share)
    found = meshes.find(key)
    read = Dependencies(found[0]["files"], found[0]["place"]) if found is not None else None
    if found is not None and read is not None and read.unchanged(path):
        return _surface_of(found[1]), read
    surface, read = build(part.name, path, size, share)
    meshes.keep(key, read.header(), _arrays(surface))
    return surface, read


def _key(part, path, size, share):
    """Name of a generated mesh in the cache: hash of what it depends on and is known before the script has run."""
    sources = sorted([*path.parent.glob("*.py"), *path.parent.parent.glob("*.py")])
    ours = (Path(structured.__file__), Path(grading.__file__))
    contents = [source.read_bytes().hex() for source in (*ours, *sources) if source.is_file()]
    graded = [size.places.tolist(), size.sizes.tolist()] if isinstance(size, GradedSize) else None
    return fingerprint([part.name, size, graded, share, path.name, contents])


def _arrays(surface):
    """A surface as the cache keeps it."""
    arrays = {"points": surface.points, "triangles": surface.triangles}
    return arrays if surface.given_normals is None else arrays | {"normals": surface.given_normals}


def _surface_of(arrays):
    return Surface(arrays["points"], arrays["triangles"], arrays.get("normals"))
