"""Surfaces of parts and fixtures of a scene: from mesh files, geometry scripts or round pads."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.errors import SceneError
from mic.geometry import grading, structured
from mic.geometry.deck import Deck
from mic.geometry.offset import moved
from mic.geometry.refinement import halved
from mic.geometry.script import arrays_surface, build, graded_sizes, mesh_arrays, named_sizes
from mic.geometry.script_dependencies import Dependencies, opened_files
from mic.geometry.surface import Surface
from mic.geometry.triangles import linked_rows, place_text
from mic.scene.part import USUAL
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = ["LoadedPart", "coarsest_size", "finer_surface", "load_fixture", "load_part"]

GENERATED = Format("generated mesh", 3, ABSENT)

#: Plausible values from a deck, mm and MPa; others have another unit.
LIKELY = {"thickness": (1e-2, 50.0), "offset": (-5.0, 5.0), "young": (1e3, 1e6), "poisson": (-0.99, 0.499)}
LARGEST_SOURCE = 10_000_000  # bytes of a Python file
LISTED_PIECES = 3  # of a part in several pieces


@dataclass(frozen=True)
class LoadedPart:
    """A part with its mesh.

    Attributes
    ----------
    part : mic.scene.part.Part
        Completed with thickness, offset and material from the mesh file where the scene gives none.
    surface, drawn : Surface
        The mid-surface, moved by the offset; and the surface as meshed.
    inputs : dict of str to str
        Hashes of the files (None for one that a script tried to open and did not find), and of the triangles of a
        generated mesh, by name.
    deck : Deck, optional
        Contents of the mesh file besides the mesh; None for a generated mesh.
    superelement : mic.compliance.superelement.Superelement, optional
        The matrix that replaces the mesh in the solution; None to read it from the files that the part states, if any.
    """

    part: Any
    surface: Surface
    drawn: Surface
    inputs: dict[str, str | None]
    deck: Deck | None = None
    superelement: Any = None


def load_part(part: Any, folder: Path, cache: Path, size: float | None = None) -> LoadedPart:
    """A part with its surface, from its mesh file or its geometry script.

    A generated mesh is cached in `cache` under the hash of the part's name, the size, and all Python files of the
    script's folder and its parent, which it may import (:mod:`mic.system.disk_cache`). It is reused only while every
    file that the script opened or declares is unchanged.

    Parameters
    ----------
    part : mic.scene.part.Part
    folder : Path
        Folder of the scene file; the part's paths are relative to it.
    cache : Path
    size : float, optional
        Element size, mm, of a part that gives none; may be a :class:`mic.geometry.grading.GradedSize`.

    Raises
    ------
    SceneError
        Naming part, key and file, if the file is missing or unusable, or the script fails; if the thickness is not
        given or the mesh file gives several; if the part consists of several pieces, or its offset cannot be applied.
    """
    path = _existing(f"part {part.name!r}", _source(part), folder / getattr(part, _source(part)))
    if part.mesh is not None:
        sets = [part.set] if isinstance(part.set, str) else part.set or ()
        surface, deck, inputs = _read(f"part {part.name!r}", folder, part.mesh, sets, part.unit, part.size)
        part = _filled(part, deck)
        _refuse_pieces(part, surface)
        return LoadedPart(part, _middle(part, surface), surface, inputs, deck)
    surface, read = _generated(part, path, cache, size or part.size)
    # Hashes of the files, and of the triangles, which depend on the version of the mesher.
    inputs = {f"triangles of {part.name}": fingerprint(np.ascontiguousarray(surface.triangles, dtype="<i8").tobytes())}
    where = os.path.dirname(part.geometry)
    inputs |= {os.path.normpath(os.path.join(where, name)): content for name, content in read.files.items()}
    _refuse_pieces(part, surface)
    return LoadedPart(part, _middle(part, surface), surface, inputs)


def finer_surface(part: Any, folder: Path, cache: Path, size: float | None = None) -> Surface:
    """Surface of a part at half the element size: from its script, or its mesh refined on the curved surface.

    Parameters and errors are those of :func:`load_part`.
    """
    if part.mesh is not None:
        surface = load_part(part, folder, cache).surface
        return Surface(*halved(surface.points, surface.triangles, surface.corner_normals))
    return _middle(part, _generated(part, folder / part.geometry, cache, size or part.size, 0.5)[0])


def coarsest_size(part: Any, folder: Path) -> float | None:
    """The largest named size of a part's geometry script, mm; None if it names none.

    Raises
    ------
    SceneError
    """
    path = folder / part.geometry
    return max(named_sizes(part.name, path).values(), default=None)


def load_fixture(fixture: Any, folder: Path) -> tuple[Surface, dict[str, str | None]]:
    """Surface of a rigid fixture and the hash of its file: its mesh, or a flat round pad with its normal outwards.

    The pad's triangles circumscribe its circle; pairing cuts them at its radius.

    Parameters
    ----------
    fixture : mic.scene.fixture.Fixture
    folder : Path
        Folder of the scene file; the fixture's mesh is relative to it.

    Raises
    ------
    SceneError
        Naming fixture, key and file, if the mesh is missing or unusable.
    """
    if fixture.mesh is not None:
        owner = f"fixture {fixture.name!r}"
        _existing(owner, "mesh", folder / fixture.mesh)
        surface, _, inputs = _read(owner, folder, fixture.mesh)
        return surface, inputs
    n = np.array(fixture.normal)
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    rim = fixture.radius / np.cos(np.pi / 36) * (np.cos(angle)[:, None] * t + np.sin(angle)[:, None] * np.cross(n, t))
    triangles = np.column_stack([np.zeros(36, int), 1 + np.arange(36), 1 + (np.arange(36) + 1) % 36])
    return Surface(np.vstack([np.zeros(3), rim]) + fixture.point, triangles), {}


def _existing(owner: str, key: str, path: Path) -> Path:
    """The path; refuses one without a file."""
    if not path.is_file():
        raise SceneError(f"{owner}: {key}: there is no file {path}; correct the name (relative to the scene)")
    return path


def _filled(part, deck):
    """The part with missing values completed from its deck.

    The modulus is in Pa in a deck in metres and in MPa in one in millimetres; a value that is implausible in that unit,
    such as 210 for GPa, is refused.
    """
    found: dict[str, Any] = {}
    for key, (low, high) in LIKELY.items():
        if getattr(part, key) is not None:
            continue
        values = [getattr(sheet, key) for sheet in deck.distinct_sheets()]
        given = [value for value in values if value is not None]
        if len(set(values)) > 1:
            listed = ", ".join("none" if value is None else f"{value:g}" for value in dict.fromkeys(values))
            raise SceneError(
                f"part {part.name!r}: {key}: {part.mesh} gives several values, {listed}; state {key} in the scene, or "
                "choose among its element sets by `set`"
            )
        value = given[0] if given else USUAL.get(key)
        if value is None:
            raise SceneError(f"part {part.name!r}: {key}: neither the scene nor {part.mesh} gives it; add {key}")
        found[key] = value
        if given and not low <= value <= high:
            raise SceneError(
                f"part {part.name!r}: {key}: {part.mesh} gives {value:g} if its unit is {part.unit!r}, which is "
                f"implausible for a sheet; correct unit, or state {key} in the scene"
            )
    return part.model_copy(update=found) if found else part


def _refuse_pieces(part, surface):
    """Refuse a part whose triangles are not connected: nothing would support the rest."""
    many, piece = linked_rows(surface.triangles)
    sizes = np.bincount(piece)
    if many == 1:
        return
    largest = np.argsort(-sizes, kind="stable")[: min(LISTED_PIECES, many)]
    middles = [surface.corners[piece == number].mean(axis=(0, 1)) for number in largest]
    listed = [f"{sizes[number]} triangles about {place_text(x)}" for number, x in zip(largest, middles)]
    raise SceneError(
        f"part {part.name!r}: {_source(part)}: the mesh consists of {many} pieces that share no points: "
        f"{'; '.join(listed)}{', …' if many > LISTED_PIECES else ''}; make each a separate part (`set` chooses among "
        "the sets of a file), or merge their points"
    )


def _source(part) -> str:
    """Key of a part's mesh."""
    return "mesh" if part.mesh is not None else "geometry"


def _middle(part, surface):
    """The surface moved to the mid-surface of the sheet."""
    try:
        return moved(surface, part.offset * part.thickness)
    except ValueError as problem:
        raise SceneError(f"part {part.name!r}: offset: {problem}") from problem


def _read(owner, folder, name, sets=(), unit="mm", size=None):
    """Surface, deck and hashes of a mesh file and of the files that it includes."""
    from mic.geometry.readers import read_mesh  # the libraries behind it are slow to import; scripts do not need them

    path = folder / name
    try:
        with opened_files() as opened:  # a mesh file may include others
            surface, deck = read_mesh(path, sets, unit, size, folder)
        read = Dependencies.of(path, [path.name], opened)
    except ValueError as problem:
        raise SceneError(f"{owner}: mesh: {problem}") from problem
    others = {other: content for other, content in read.files.items() if other != path.name and content is not None}
    return surface, deck, {name: fingerprint(path.read_bytes())} | others


def _generated(part, path, cache, size, share=1.0):
    """Surface of a script at a multiple of a size, cached, and the files that it read."""
    meshes, key = Cache(cache, "meshes", GENERATED), _key(part, path, size, share)
    found = meshes.load(key)
    if found is not None:
        read = Dependencies(found[0]["files"], found[0]["place"])
        if read.unchanged(path):
            return arrays_surface(found[1]), read
    surface, read = build(part.name, path, size, share)
    meshes.store(key, asdict(read), mesh_arrays(surface))
    return surface, read


def _key(part, path, size, share):
    """Cache key of a generated mesh: hash of the inputs that are known before the script runs."""
    sources = sorted([*path.parent.glob("*.py"), *path.parent.parent.glob("*.py")])
    ours = (Path(structured.__file__), Path(grading.__file__))
    small = [source for source in (*ours, *sources) if source.is_file() and source.stat().st_size < LARGEST_SOURCE]
    contents = [source.read_bytes().hex() for source in small]
    return fingerprint([part.name, size, graded_sizes(size), share, path.name, contents])
