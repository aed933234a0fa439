"""``mic init``."""

from __future__ import annotations

import shlex

import numpy as np
from rich.console import Console

from mic import examples
from mic.commands.invocation import on_one_process
from mic.errors import SceneError
from mic.system.console import plain
from mic.wizard import write_scene

__all__ = [
    "init",
]


@on_one_process
def init(meshes, example, out, thickness, welds, points):
    """``mic init``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    if (example is None) == (not meshes):
        raise SceneError("mic init: name mesh files, or one example with --example NAME")
    if example is not None:
        if thickness or welds or points:
            raise SceneError("mic init: --thickness, --welds and --points go with mesh files, not with --example")
        folder = examples.copy(example, out)
        names = ", ".join(sorted(path.name for path in folder.iterdir()))
        print(f"{folder}: {names}\nNext:  mic check {shlex.quote(str(folder))}")
        return
    folder, proposal = write_scene(meshes or [], out, _thicknesses(thickness or []), welds, points)
    for sentence in proposal.sentences:
        console.print(f"[yellow]note:[/] {plain(sentence)}", highlight=False, soft_wrap=True)
    quoted = plain(shlex.quote(str(folder)))
    console.print(
        f"{plain(folder / 'scene.toml')}: {plain(proposal.summary())}\n"
        f"Next:  mic check {quoted}  and  mic run {quoted}",
        highlight=False,
        soft_wrap=True,
    )


def _thicknesses(given: list[str]) -> dict[str | None, float]:
    """Thickness, mm, by part; under None, of the others."""
    found: dict[str | None, float] = {}
    for text in given:
        part, equals, value = text.rpartition("=")
        try:
            thickness = float(value)
        except ValueError:
            thickness = np.nan
        if not 0 < thickness < np.inf or (equals and not part):
            raise SceneError(f"--thickness {text}: give mm, as --thickness 1.5, or --thickness PART=1.5")
        found[part or None] = thickness
    return found
