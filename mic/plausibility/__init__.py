"""Warnings about scenes that are valid but unusual, each with the usual range, its reason and a remedy.

The rules are data (``rules.toml``); the functions that apply them are in :mod:`mic.plausibility.scene_file` and
:mod:`mic.plausibility.meshes`. The ranges cover the production of cars, cabins and household appliances. A warning
changes no result; ``mic check --strict`` treats it as an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mic.errors import SceneError
from mic.geometry.load import LoadedPart, load_part
from mic.plausibility.results import Results
from mic.plausibility.rules import FILE, MESHES, PARTS, RESULTS, SOURCES, SceneWarning, apply_rules
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format
from mic.system.memoise import memoise

if TYPE_CHECKING:
    from mic.model.assembly import Assembly
    from mic.model.one_sigma import Displacement
    from mic.scene import Scene

__all__ = [
    "Results",
    "SceneWarning",
    "find_warnings",
    "find_warnings_of_results",
    "find_warnings_of_sources",
    "find_warnings_unplaced",
    "loadable_parts",
    "raise_warnings",
    "validity",
]

CACHED_WARNINGS = Format("set of warnings", 2, ABSENT)
MAX_CACHED = 64


def find_warnings(
    scene: Scene, assembly: Assembly | None = None, cache: Path | None = None
) -> tuple[SceneWarning, ...]:
    """The warnings of a scene, in the order of the rules: impossible values first.

    Parameters
    ----------
    scene : Scene
    assembly : Assembly, optional
        The scene on its meshes; without it only the rules that need the scene file alone apply.
    cache : Path, optional
        Folder in which the warnings of an assembly are cached.
    """
    if cache is not None and assembly is not None:
        disk_cache, key = Cache(cache, "warnings", CACHED_WARNINGS, MAX_CACHED), assembly.scene.model_dump_json()
        find = lambda: find_warnings(scene, assembly)
        return memoise(disk_cache, [assembly.identity, key], {}, (SceneWarning,), find)[0]
    if assembly is None:
        return _impossible_first(apply_rules(FILE, scene))
    sheets = [(part, assembly.surfaces[part.name]) for part in assembly.parts]  # as drawn, not as meshed to be solved
    return _impossible_first(
        [*apply_rules(FILE, assembly.scene), *apply_rules(PARTS, sheets), *apply_rules(MESHES, assembly)]
    )


def _impossible_first(warnings: list[SceneWarning]) -> tuple[SceneWarning, ...]:
    return tuple(sorted(warnings, key=lambda warning: not warning.impossible))


def find_warnings_unplaced(scene: Scene, parts: Sequence[LoadedPart]) -> tuple[SceneWarning, ...]:
    """The warnings of a scene that could not be placed on its meshes: they may explain why.

    Parameters
    ----------
    scene : Scene
    parts : sequence of LoadedPart
        Those of its parts that could be loaded, see :func:`loadable_parts`.
    """
    return (*find_warnings(scene), *apply_rules(PARTS, [(loaded.part, loaded.surface) for loaded in parts]))


def find_warnings_of_results(results: Results) -> tuple[SceneWarning, ...]:
    """The warnings of results out of all proportion, in the order of the rules."""
    return tuple(apply_rules(RESULTS, results))


def find_warnings_of_sources(found: Sequence[Displacement]) -> tuple[SceneWarning, ...]:
    """The warnings of sources whose standard deviation moves a free part out of all proportion."""
    return tuple(apply_rules(SOURCES, found))


def loadable_parts(scene: Scene, cache: Path) -> list[LoadedPart]:
    """The parts of a scene that can be loaded, without those that give ``accuracy`` in place of a size.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Folder of generated meshes.
    """
    loaded = []
    for part in scene.parts:
        try:
            if part.accuracy is None:
                loaded.append(load_part(part, scene.folder, cache))
        except SceneError:
            continue  # reported by the caller already
    return loaded


def validity(warnings: Sequence[SceneWarning], errors: Sequence[str] = ()) -> str:
    """One line that says whether a scene is valid, with the numbers of errors and warnings."""
    count = lambda items, word: f"{len(items)} {word}{'s' * (len(items) != 1)}"
    if errors:
        return f"Not valid: {count(errors, 'error')}, {count(warnings, 'warning')}."
    impossible = sum(warning.impossible for warning in warnings)
    if impossible:
        values = "a value" if impossible == 1 else "values"
        return f"Implausible: {count(warnings, 'warning')}, {impossible} of {values} that no assembly has."
    return f"The scene is valid{', ' + count(warnings, 'warning') if warnings else ''}."


def raise_warnings(warnings: Sequence[SceneWarning]) -> None:
    """Raise :class:`~mic.errors.SceneError` if there are any warnings, with one line for each."""
    if warnings:
        raise SceneError("\n".join(str(warning) for warning in warnings))
