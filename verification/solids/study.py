"""The whole process of two scenes with solid elements of another code, with independent geometry and increments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from fem_reference.peers.calculix import available
from fem_reference.peers.calculix_process import Outcome, process
from mic.contact import ContactSolver
from mic.examples import folder
from mic.model.nuggets import nuggets
from mic.process.model import ReducedModel
from mic.scene import Scene, load_scene
from mic.statistics.draw import draw
from verification.comparison import reduced_and_assembly
from verification.plots import panels
from verification.solids import geometry
from verification.study import Acceptance, Finding, Study
from verification.validation import COVERAGE, Uncertainty

SEED, DRAWN, BEYOND = 9, 2, 3.0  # seed, not that of the scenes; random samples in addition to the mean; nugget radii
LEAST = 2e-3  # mm: resolution of coordinate measuring machines
#: Relative to the clamp force and to the largest slip of any stage: smaller forces and slips of a zone in a stage are
#: reported without a limit.
CARRIES = 0.1
SMALLEST = 1e-12  # N, mm


@dataclass(frozen=True)
class Case:
    """A shipped scene and its sheets.

    Attributes
    ----------
    name : str
        Name of its folder.
    size : str
        Mesh size of the reduced model.
    sheets : callable
        ``sheets(scene, fine, coarse)``, see :mod:`verification.solids.geometry`.
    meshes : tuple of (float, float)
        Largest solid element around the welds and elsewhere, mm.
    share : float
        Allowed relative error of a key characteristic, if that exceeds the resolution of measuring machines.
    largest : bool
        Whether forces and slips are relative to the stage in which they are largest; otherwise relative to their own
        value, in stages and zones with enough load.
    """

    name: str
    size: str
    sheets: Callable
    meshes: tuple[tuple[float, float], ...]
    share: float
    largest: bool

    def scene(self) -> tuple[Scene, np.ndarray]:
        """The scene and its samples: the mean and some random ones."""
        scene = load_scene(folder(self.name))
        parts = [part.model_copy(update={"size": self.size}) for part in scene.parts]
        report = scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})
        samples = np.vstack([[one.mean for one in scene.deviations], draw(scene, SEED, 0, DRAWN)])
        return scene.model_copy(update={"parts": parts, "report": report}), samples

    def solids(
        self,
        scene: Scene,
        samples: np.ndarray,
        mesh: tuple[float, float],
        increments: int = 8,
    ) -> Outcome:
        """The process with solids on a mesh; its contact problems are solved by the solver of the program."""
        solver = partial(ContactSolver, semidefinite=True)
        return process(scene, self.sheets(scene, *mesh), samples, solver, increments, BEYOND)

    def limited(self, scene: Scene, solid: Outcome, name: str) -> np.ndarray:
        """(n, stages, zones) whether the limit applies to a force or slip."""
        if self.largest:
            return np.ones(solid.force.shape, bool)
        carries = solid.force > CARRIES * sum(one.force or 0.0 for one in scene.clamps)
        return carries & (name == "force" or solid.slip > CARRIES * solid.slip.max(axis=1, keepdims=True))

    def off(self, mine: Outcome, solid: Outcome, name: str) -> np.ndarray:
        """(n, stages, zones) relative differences of forces or slips."""
        truth = getattr(solid, name)
        scale = truth.max(axis=1, keepdims=True) if self.largest else np.maximum(truth, SMALLEST)
        return abs(getattr(mine, name) - truth) / scale

    def errors(self, scene: Scene, mine: Outcome, solid: Outcome) -> dict[str, float]:
        """Largest relative differences of forces and slips, and of key characteristics over the allowed error."""
        allowed = np.maximum(self.share * abs(solid.measurements), LEAST)
        found = {one: self.off(mine, solid, one)[self.limited(scene, solid, one)].max() for one in ("force", "slip")}
        found["key-characteristic"] = (abs(mine.measurements - solid.measurements) / allowed).max()
        return {name: float(value) for name, value in found.items()}


LAP = Case("lap_joint", "fine", geometry.lap_joint, ((2.0, 5.0), (1.0, 3.5), (2 / 3, 2.5)), 0.05, True)
HAT = Case("hat_on_plate", "medium", geometry.hat_on_plate, ((2.0, 8.0), (8 / 7, 5.0), (1.0, 4.0)), 0.1, False)


def ours(scene: Scene, samples: np.ndarray, cache, alter: Callable = lambda model: model) -> Outcome:
    """Results of the reduced model in the form of :func:`fem_reference.peers.calculix_process.process`."""
    model: ReducedModel = alter(reduced_and_assembly(scene, cache)[0])
    contacts, found = model.contacts, model.evaluate(samples, "coulomb")
    away = nuggets(scene, contacts.zone, contacts.point, contacts.frame[:, :, 0], BEYOND) < 0
    zones = np.eye(len(scene.zones))[contacts.zone] * away[:, None]
    area = zones * contacts.area[:, None]
    force, slip = [], []
    for one in found.resolutions.values():
        force.append(one.force[:, :, 0] @ zones)
        square = (one.displacement[:, :, 1:] ** 2).sum(axis=2)
        slip.append(np.sqrt(square @ area / area.sum(axis=0)))
    stages = list(found.resolutions)
    return Outcome(stages, found.measurements, np.stack(force, axis=1), np.stack(slip, axis=1), len(contacts))


def run(context):
    findings = _findings(context, LAP, "")
    return findings if context.quick else [*findings, *_findings(context, HAT, "hat-")]


def _findings(context, case: Case, prefix: str) -> list[Finding]:
    scene, samples = case.scene()
    meshes = case.meshes[:2] if context.quick else case.meshes
    solids = context.team.map(lambda mesh: case.solids(scene, samples, mesh), meshes)
    mine = context.team.from_first(ours(scene, samples, context.cache))
    last = solids[-1]
    found = [case.errors(scene, mine, one) for one in solids]
    own = case.errors(scene, solids[-2], last)
    limits = {name: item.limit for name in own for item in STUDY.acceptance if item.name == prefix + name}
    figure, (axis,) = panels(1)
    for name, limit in limits.items():
        axis.plot([fine for fine, _ in meshes], [one[name] / limit for one in found], "o-", label=name)
    axis.axhline(1.0, color="k", lw=1)
    title = case.name.replace("_", " ")
    axis.set(
        xlabel="elements around the welds, mm",
        ylabel="difference over its limit",
        xscale="log",
        yscale="log",
        title=title,
    )
    axis.set_xticks([fine for fine, _ in meshes], [f"{fine:.3g}" for fine, _ in meshes])
    axis.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    axis.legend()
    note = (
        f"{title.capitalize()}. {_unlimited(case, scene, mine, last)} From the second to the finest mesh the solids "
        f"change: forces by {100 * own['force']:.2g} %, slips by {100 * own['slip']:.2g} %, key characteristics by "
        f"{own['key-characteristic']:.2g} of the allowed error."
    )
    names = [f"{fine:.3g} and {coarse:g} mm" for fine, coarse in meshes]
    table = _table(scene, [*zip(names, solids), ("production", mine)])
    # the change from the second to the finest mesh bounds the error that the finest has left
    unsure = {name: Uncertainty(reference=own[name] / COVERAGE) for name in own}
    findings = [
        Finding(f"{prefix}force", found[-1]["force"], note, figure, table, unsure["force"]),
        Finding(f"{prefix}slip", found[-1]["slip"], uncertainty=unsure["slip"]),
        Finding(
            f"{prefix}key-characteristic",
            found[-1]["key-characteristic"],
            uncertainty=unsure["key-characteristic"],
        ),
    ]
    if case is LAP:
        nearing = found[-2]["key-characteristic"] / found[-1]["key-characteristic"]
        return [*findings, Finding("nearing", nearing)]
    settled = max(own[name] / limit for name, limit in limits.items())
    return [
        *findings,
        Finding(f"{prefix}settled", settled),
    ]


def _unlimited(case: Case, scene: Scene, mine: Outcome, solid: Outcome) -> str:
    """Sentences on the values without a limit."""
    if case.largest:
        alone = (abs(mine.force - solid.force) / solid.force)[:, -1].max()
        force = mine.force[0, -1].sum()
        return f"The force that remains after the release, {force:.3g} N, differs by {100 * alone:.2g} %."
    words = []
    for j, stage in enumerate(solid.stages):
        for z, zone in enumerate(scene.zones):
            for name, unit, scale in (("force", "N", 1.0), ("slip", "µm", 1e3)):
                rest = ~case.limited(scene, solid, name)[:, j, z]
                most = abs(getattr(mine, name) - getattr(solid, name))
                of = getattr(solid, name)[rest, j, z].max(initial=0.0)
                if of > SMALLEST:
                    words.append(
                        f"{name}, {stage}, {zone.name}: {scale * most[rest, j, z].max():.2g} of {scale * of:.2g} {unit}"
                    )
    return f"Largest differences without a limit: {'; '.join(words)}."


def _table(scene: Scene, outcomes: list[tuple[str, Outcome]]) -> pd.DataFrame:
    rows = []
    for mesh, one in outcomes:
        for k, sample in enumerate(one.measurements):
            row = {"elements": mesh, "contacts": one.contacts, "sample": k}
            row |= {f"{item.name}, µm": 1e3 * value for item, value in zip(scene.measurements, sample)}
            for j, stage in enumerate(one.stages):
                for z, zone in enumerate(scene.zones):
                    row |= {f"force, {stage}, {zone.name}, N": one.force[k, j, z]}
                    row |= {f"slip, {stage}, {zone.name}, µm": 1e3 * one.slip[k, j, z]}
            rows.append(row)
    return pd.DataFrame(rows)


STUDY = Study(
    order=86,
    title="The whole process in another code",
    claim="Solids of another code, taken through the whole process, give the forces, slips and shapes of production.",
    reference=(
        "Lap joint and hat on the plate with CalculiX's C3D8I, two through each thickness, contact at every node of "
        "the faces, pads as discs, nuggets as one piece, friction in eight increments a step; three meshes each."
    ),
    acceptance=(
        Acceptance(
            "force",
            "Lap joint: sum of normal forces beyond three nugget radii, over the largest stage's.",
            0.01,
            reason="A sixth of the uncertainty of 500 samples in 6σ, 6.2 %.",
        ),
        Acceptance(
            "slip",
            "Lap joint: root mean square relative displacement of the faces, over the largest stage's.",
            0.01,
            reason="As for the force.",
        ),
        Acceptance(
            "key-characteristic",
            "Lap joint: key characteristics of each sample, over the larger of 5 % and 2 µm.",
            1.0,
            quick=2.0,
            reason=(
                "2 µm is the resolution of coordinate measuring machines; 5 % is less than the uncertainty of 500 "
                "samples."
            ),
        ),
        Acceptance(
            "nearing",
            (
                "Lap joint: factor by which the difference of key characteristics falls from the second to the "
                "finest mesh."
            ),
            1.0,
            bound="at least",
            reason="A reference that moves away under refinement has not converged.",
        ),
        Acceptance(
            "hat-force",
            (
                "Hat: sum of a zone's normal forces beyond three nugget radii, in every stage with more than a tenth "
                "of the clamp force, each sample."
            ),
            0.05,
            reason="Less than the uncertainty of 500 samples in 6σ, 6.2 %.",
            full_only=True,
        ),
        Acceptance(
            "hat-slip",
            (
                "Hat: root mean square relative displacement of a zone's faces, in those stages where it exceeds a "
                "tenth of the largest."
            ),
            0.08,
            reason="The tenth of the error budget, less a fifth for the error of the solids.",
            full_only=True,
        ),
        Acceptance(
            "hat-key-characteristic",
            "Hat: key characteristics of each sample, over the larger of 10 % and 2 µm.",
            1.0,
            reason="2 µm as above, and the tenth of the error budget.",
            full_only=True,
        ),
        Acceptance(
            "hat-settled",
            "Hat: change of the solids from the second to the finest mesh, over the three limits.",
            0.5,
            reason="A reference may move by half of the limit.",
            full_only=True,
        ),
    ),
    seconds=(191, 19),
    memory=4.0,
    run=run,
    missing=lambda: "" if available() else "ccx is not installed: apt-get install calculix-ccx",
)
