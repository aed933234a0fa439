"""The assembly of a scene, with the check that its process is feasible."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mic.model.assembly import Assembly, assemble
from mic.process.plan import plan_assembly
from mic.scene import Scene

__all__ = ["assemble_feasible"]


def assemble_feasible(scene: Scene, cache: Path, report: Callable[[str], None] | None = None) -> Assembly:
    """The assembly of a scene whose process is feasible, which is checked before anything is factorised.

    Parameters and errors are those of :func:`mic.model.assembly.assemble`.
    """
    assembly = assemble(scene, cache, progress=report, check=plan_assembly)
    plan_assembly(assembly)
    return assembly
