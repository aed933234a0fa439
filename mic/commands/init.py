"""``mic init``."""

from __future__ import annotations

import shlex

import numpy as np

from mic import examples
from mic.commands.invocation import first_rank_only
from mic.commands.output import CommandConsole
from mic.errors import SceneError
from mic.wizard import write_scene
from mic.wizard.bodies import part_name

__all__ = ["init"]


@first_rank_only
def init(meshes, example, out, thickness, name, welds, points, table):
    """``mic init``, with the values of its options (:mod:`mic.options`)."""
    console = CommandConsole()
    if example is not None and meshes:
        raise SceneError(
            f"mic init: {meshes[0]} is a mesh file beside --example {example}; for the new folder use --out"
        )
    if example is None and not meshes:
        raise SceneError("mic init: give mesh files, or an example with --example NAME")
    if example is not None:
        if thickness or name or welds or points or table:
            options = "--thickness, --name, --welds, --points and --table"
            raise SceneError(f"mic init: {options} go with mesh files, not with --example")
        folder = examples.copy(example, out)
        names = ", ".join(sorted(path.name for path in folder.iterdir()))
        print(f"{folder}: {names}\nNext:  mic check {shlex.quote(str(folder))}")
        return
    folder, proposal = write_scene(
        meshes or [], out, _thicknesses(thickness or []), welds, points, _names(name or []), table
    )
    for sentence in proposal.sentences:
        console.warn("note", sentence)
    quoted = shlex.quote(str(folder))
    console.say(f"{folder / 'scene.toml'}: {proposal.summary()}")
    if not all(mesh.resolve().is_relative_to(folder.resolve()) for mesh in meshes):
        console.say("The mesh files, and the files that they include, are copied into this folder.")
    console.say(f"Next:  mic check {quoted}  and  mic run {quoted}")


def _names(given: list[str]) -> dict[str, str]:
    """New names of parts by the present ones."""
    names: dict[str, str] = {}
    for text in given:
        part, _, name = text.rpartition("=")
        if not part or not name or part_name(name) != name:
            raise SceneError(f"--name {text}: give --name OLD=NEW, the new name of letters, digits and _ . + -")
        names[part] = name
    return names


def _thicknesses(given: list[str]) -> dict[str | None, float]:
    """Thickness by part, mm; under None that of all other parts."""
    thicknesses: dict[str | None, float] = {}
    for text in given:
        part, equals, value = text.rpartition("=")
        try:
            thickness = float(value)
        except ValueError:
            thickness = np.nan
        if not 0 < thickness < np.inf or (equals and not part):
            raise SceneError(f"--thickness {text}: give mm, as --thickness 1.5, or --thickness PART=1.5")
        thicknesses[part or None] = thickness
    return thicknesses
