"""Assembles a scene: meshes its parts, finds contact pairs and sets up parts and rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.compliance.superelement import Superelement
from mic.errors import Problems
from mic.geometry.load import LoadedPart, load_fixture, load_part
from mic.geometry.surface import Patch, Surface
from mic.model.assembly_rows import assembly_rows, matrix_files
from mic.model.assembly_types import Assembly, AssemblyRows, Contacts, GapPoints
from mic.model.element_sizes import chosen_sizes
from mic.model.placement import place
from mic.model.shape_modes import expand_modes
from mic.scene import Scene
from mic.scene.samples import take_samples
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint
from mic.system.matrix_product import one_thread
from mic.system.memoise import memoise

__all__ = ["Assembly", "Contacts", "GapPoints", "PlacedScene", "assemble", "assemble_placed", "load_placed"]

FORMAT = Format("set of parts and contact pairs", 1, ABSENT)
MOST = 64  # cached assemblies


@dataclass(frozen=True)
class PlacedScene:
    """A scene in memory: its surfaces, and its items placed on them.

    Attributes
    ----------
    scene : Scene
        With values from the mesh files, points and directions as vectors, modes expanded, samples as values.
    loaded : tuple of LoadedPart
    fixtures : dict of str to Surface
        Of the fixtures that have meshes.
    inputs : dict of str to str
        Hashes of the input files.
    messages : tuple of str
        About placed items, measured shapes and fields.
    """

    scene: Scene
    loaded: tuple[LoadedPart, ...]
    fixtures: Mapping[str, Surface]
    inputs: dict[str, str | None]
    messages: tuple[str, ...]


@one_thread
def assemble(
    scene: Scene,
    cache: Path,
    every_node: bool = False,
    progress: Callable[[str], None] | None = None,
    check: Callable[[Assembly], object] = lambda assembly: None,
) -> Assembly:
    """Mesh the parts, find the contact pairs and set up all rows.

    Parts that state an accuracy are solved on increasingly fine meshes until they reach it.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Folder for generated meshes.
    every_node : bool
        Place candidates at every mesh vertex in the zones (:func:`mic.geometry.pairing.node_pairs`) instead of the
        pairs that the zones state.
    progress : callable, optional
        Called with one line of text before each solve.
    check : callable, optional
        Called with the assembly on its first meshes before parts that state an accuracy are solved, so that its
        errors come first; not called if no part states one.

    Raises
    ------
    SceneError
        Naming the key: a missing mesh, a point off its part, an empty zone, an accuracy out of reach.
    MissingProvider
        If an accuracy is stated and no provider is installed.
    """
    sizes = chosen_sizes(scene, cache, partial(_assembled, scene, cache, False), check, progress)
    return _assembled(scene, cache, every_node, sizes)


def _assembled(scene: Scene, cache: Path, every_node: bool, sizes: Mapping[str, float]) -> Assembly:
    """The assembly on meshes of given sizes."""
    problems = Problems()
    return assemble_placed(load_placed(scene, cache, sizes, problems), cache, every_node, sizes, problems)


@one_thread
def load_placed(scene: Scene, cache: Path, sizes: Mapping[str, float], problems: Problems) -> PlacedScene:
    """Load the surfaces of a scene, place its items on them, expand its modes and take its samples.

    Parameters
    ----------
    scene : Scene
    cache : Path
    sizes : mapping of str to float
        Element sizes, mm, of the parts that state an accuracy, as :attr:`Assembly.sizes`.
    problems : Problems
        Collects the errors of items; afterwards the scene lacks these items.

    Raises
    ------
    SceneError
        If a mesh is missing or unusable.
    """
    loaded: list[LoadedPart] = []
    fixtures: dict[str, Surface] = {}
    inputs: dict[str, str | None] = {}
    for part in scene.parts:
        with problems:
            loaded.append(load_part(part, scene.folder, cache, sizes.get(part.name)))
            inputs |= loaded[-1].inputs
    for fixture in scene.fixtures:
        with problems:
            if fixture.mesh is not None:
                fixtures[fixture.name], hashes = load_fixture(fixture, scene.folder)
                inputs |= hashes
    problems.raise_all()  # nothing can be placed on a part without a mesh
    surfaces = {one.part.name: one.surface for one in loaded}
    decks = {one.part.name: one.deck for one in loaded}
    if any(one.part is not part for one, part in zip(loaded, scene.parts)):
        scene = scene.model_copy(update={"parts": [one.part for one in loaded]})
    scene, placed = place(scene, surfaces, decks, problems)
    expanded = expand_modes(scene, surfaces, decks, problems)
    scene = expanded.scene
    if not problems:  # the columns of a table of samples name all deviations
        with problems:
            scene, sample_files = take_samples(scene)
            inputs |= sample_files
    inputs |= expanded.inputs | matrix_files(scene)
    return PlacedScene(scene, tuple(loaded), fixtures, inputs, placed + expanded.messages)


@one_thread
def assemble_placed(
    placed: PlacedScene,
    cache: Path,
    every_node: bool = False,
    sizes: Mapping[str, float] | None = None,
    problems: Problems | None = None,
) -> Assembly:
    """The assembly of a placed scene; parts and rows come from the cache if possible.

    Parameters
    ----------
    placed : PlacedScene
    cache, every_node
        As :func:`assemble`.
    sizes : mapping of str to float, optional
        Recorded as :attr:`Assembly.sizes`.
    problems : Problems, optional
        Those of loading and placing.

    Raises
    ------
    SceneError
        With one line for each of these problems and of those of the rows.
    """
    scene, loaded, fixtures = placed.scene, placed.loaded, placed.fixtures
    problems = Problems() if problems is None else problems
    surfaces = {one.part.name: one.surface for one in loaded}
    meshes = [
        None if array is None else fingerprint(array.tobytes())
        for surface in (*surfaces.values(), *fixtures.values())
        for array in (surface.points, surface.triangles, surface.given_normals)
    ]
    # Neither its names nor its sampling change the rows of a scene.
    sampling = scene.monte_carlo.model_copy(update={"samples": 1, "seed": 0})
    bare = scene.model_copy(update={"name": "", "description": "", "monte_carlo": sampling})
    if problems:  # report those of the rows together with them
        unsampled = bare.model_copy(update={"monte_carlo": sampling.model_copy(update={"values": None})})
        assembly_rows(unsampled, loaded, surfaces, fixtures, every_node, problems)
    rows, identity = memoise(
        Cache(cache, "assemblies", FORMAT, MOST),
        [bare.model_dump_json(), every_node, placed.inputs, meshes],
        surfaces,
        (AssemblyRows, Part, Surface, Functionals, Patch, Superelement, Contacts, GapPoints),
        lambda: assembly_rows(bare, loaded, surfaces, fixtures, every_node, problems),
    )
    return Assembly(
        **vars(rows),
        scene=scene,
        inputs=placed.inputs,
        sizes=sizes or {},
        decks={one.part.name: one.deck for one in loaded if one.deck is not None},
        placed=placed.messages,
        surfaces=surfaces,
        identity=identity,
    )
