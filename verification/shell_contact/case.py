"""One of the twelve cases: its scene on meshes of three sizes, and its results.

The spacing of contact candidates equals the element size, so that elements and contact are refined together. The load
path has a tolerance 250 times smaller than the default of scenes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from runpy import run_path

import numpy as np

from mic.model.assembly import assemble
from mic.model.nuggets import nuggets
from mic.process.model import ReducedModel
from mic.process.plan import StagePlan, plan_assembly
from mic.scene import Scene, load_scene
from verification.comparison import reduced_and_assembly
from verification.pairs.study import BEYOND

__all__ = ["FINEST", "FOLDER", "LEVELS", "TOLERANCES", "Case", "Quantity", "cases"]

FOLDER = Path(__file__).parent / "cases"
LEVELS = ("coarse", "medium", "fine")  # each 1.5 times finer than the previous one
FINEST = "finest"  # once more finer, to check the three
#: Path tolerances: one that shows the path error, and that of the values. With the default of scenes, 2.5e-4, single
#: works have errors of a few thousandths, which change with the last digit of any input.
TOLERANCES = (1e-5, 1e-6)


@dataclass(frozen=True)
class Quantity:
    """A result of a case.

    Attributes
    ----------
    name : str
    unit : str
    value : float
    """

    name: str
    unit: str
    value: float


@dataclass(frozen=True)
class Case:
    """A case by its folder with ``scene.toml``, ``geometry.py`` and the description ``about.md``."""

    folder: Path

    @property
    def name(self) -> str:
        """The folder's."""
        return self.folder.name

    @cached_property
    def sizes(self) -> dict[str, float]:
        """Largest edge of an element by level, mm; distances of candidates are the same."""
        named = run_path(str(self.folder / "geometry.py"))["SIZES"]
        return named | {FINEST: named[LEVELS[-1]] / 1.5}

    @property
    def text(self) -> str:
        """Description of the case."""
        return (self.folder / "about.md").read_text(encoding="utf-8").strip()

    def scene(self, level: str, tolerance: float = TOLERANCES[1]) -> Scene:
        """The scene on the meshes of a level, with a path tolerance."""
        scene = load_scene(self.folder)
        parts = [part.model_copy(update={"size": self.sizes[level]}) for part in scene.parts]
        zones = [zone.model_copy(update={"spacing": self.sizes[level]}) for zone in scene.zones]
        path = scene.path.model_copy(update={"tolerance": tolerance})
        return scene.model_copy(update={"parts": parts, "zones": zones, "path": path})

    def model(self, scene: Scene, cache: Path) -> ReducedModel:
        """The reduced model of the case's scene."""
        return reduced_and_assembly(scene, cache)[0]

    def plans(self, cache: Path) -> list[StagePlan]:
        """The actions of each stage, step by step."""
        return plan_assembly(assemble(self.scene("coarse"), cache))

    def quantities(
        self,
        level: str,
        cache: Path,
        tolerance: float = TOLERANCES[1],
        alter: Callable[[ReducedModel], ReducedModel] = lambda model: model,
    ) -> list[Quantity]:
        """All results: displacements at the end; by stage and zone the sum of normal forces, the resultant of
        friction, and its work. `alter` may change the model first.

        Raises
        ------
        ValueError
            If the case could not be solved.
        """
        model = alter(self.model(self.scene(level, tolerance), cache))
        scene, contacts = model.scene, model.contacts
        found = model.evaluate(np.zeros((1, len(scene.deviations))))
        if found.failed[0] or not all(one.converged[0] for one in found.resolutions.values()):
            raise ValueError(f"{self.name}: not solved on the {level} mesh")
        beyond = nuggets(scene, contacts.zone, contacts.point, contacts.frame[:, :, 0], BEYOND) < 0
        made = [Quantity(one.name, "µm", 1e3 * value) for one, value in zip(scene.measurements, found.measurements[0])]
        for stage, one in found.resolutions.items():
            for z, zone in enumerate(scene.zones):
                own = beyond & (contacts.zone == z)
                force, frame = one.force[0, own], contacts.frame[own]
                friction = np.einsum("kij,kj->i", frame[:, :, 1:], force[:, 1:])
                where = f"{stage}, {zone.name}"
                made += [
                    Quantity(f"normal force, {where}", "N", float(force[:, 0].sum())),
                    Quantity(f"friction, {where}", "N", float(np.linalg.norm(friction))),
                    Quantity(f"work, {where}", "N mm", float(one.trace.work[0, own].sum())),
                ]
        return made


def cases() -> dict[str, Case]:
    """All twelve cases by name."""
    return {path.parent.name: Case(path.parent) for path in sorted(FOLDER.glob("*/scene.toml"))}
