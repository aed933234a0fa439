"""What no rule of the scene forbids and no workshop would build: warnings, each with the usual range and a remedy.

Two tables say all of it (:mod:`mic.plausibility.rules`): what the scene file alone shows, and what needs the parts' meshes
and the contact pairs. A rule says where it looks, what is usual and why, and what to do. Usual is what production of
sheet-metal assemblies knows, with room on both sides: a scene of cars, cabins or white goods passes without a word. A
warning changes nothing that is computed; who is strict takes it for an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

from mic.errors import SceneError
from mic.geometry.load import LoadedPart, load_part
from mic.plausibility.rule import Rule, Warned
from mic.plausibility.rules import FILE, MESHES, PARTS
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format
from mic.system.memoise import kept

if TYPE_CHECKING:
    from mic.model.assembly import Assembly
    from mic.scene import Scene

__all__ = ["FILE", "MESHES", "PARTS", "Rule", "Warned", "judge", "readable", "refuse", "suspect", "verdict"]


JUDGED = Format("set of warnings", 1, ABSENT)
MOST = 64  # of them that are kept


def judge(scene: Scene, assembly: Assembly | None = None, cache: Path | None = None) -> tuple[Warned, ...]:
    """The warnings of a scene, in the order of the rules.

    Parameters
    ----------
    scene : Scene
    assembly : Assembly, optional
        The scene on its meshes; without it, what the file alone shows, of items that are not placed yet only numbers.
    cache : Path, optional
        Folder in which those of an assembly are kept.
    """
    if cache is None or assembly is None:
        return _judged(scene, assembly)
    room, told = Cache(cache, "warnings", JUDGED, MOST), assembly.scene.model_dump_json()
    return kept(room, [assembly.identity, told], {}, (Warned,), lambda: _judged(scene, assembly))[0]


def _judged(scene: Scene, assembly: Assembly | None) -> tuple[Warned, ...]:
    found = [warned for rule in FILE for warned in rule.judge(assembly.scene if assembly is not None else scene)]
    if assembly is not None:
        drawn = [_sheet(part, assembly.surfaces[part.name]) for part in assembly.parts]  # not as they are solved
        found += [warned for rule in PARTS for warned in rule.judge(drawn)]
        found += [warned for rule in MESHES for warned in rule.judge(assembly)]
    return tuple(found)


def suspect(scene: Scene, readable: Sequence[LoadedPart]) -> tuple[Warned, ...]:
    """The warnings of a scene that could not be put on its meshes: what is unusual may be why.

    Parameters
    ----------
    scene : Scene
    readable : sequence of LoadedPart
        Those of its parts that can be had, see :func:`readable`.
    """
    parts = [_sheet(one.part, one.surface) for one in readable]
    return judge(scene) + tuple(warned for rule in PARTS for warned in rule.judge(parts))


def _sheet(part, surface) -> SimpleNamespace:
    return SimpleNamespace(name=part.name, thickness=part.thickness, surface=surface)


def readable(scene: Scene, cache: Path) -> list[LoadedPart]:
    """Those parts of a scene that can be had; one whose size is to be found is none of them.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Folder of generated meshes.
    """
    found = []
    for part in scene.parts:
        try:
            if part.accuracy is None:
                found.append(load_part(part, scene.folder, cache))
        except SceneError:
            continue  # it is told already
    return found


def verdict(warnings: Sequence[Warned], errors: Sequence[str] = ()) -> str:
    """One line on whether a scene can be run."""
    count = lambda items, word: f"{len(items)} {word}{'s' * (len(items) != 1)}"
    if errors:
        return f"Not valid: {count(errors, 'error')}, {count(warnings, 'warning')}."
    return f"The scene is valid{', ' + count(warnings, 'warning') if warnings else ''}."


def refuse(warnings: Sequence[Warned]) -> None:
    """Raise :class:`~mic.errors.SceneError` if there are any warnings, with one line for each."""
    if warnings:
        raise SceneError("\n".join(str(warned) for warned in warnings))
