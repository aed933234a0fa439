"""Compare results of the reduced model with those of the full finite elements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mic.contact import certify
from mic.model.assembly import Assembly, assemble
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.scene import Scene
from verification import domain

__all__ = [
    "Difference",
    "apart",
    "certificates",
    "difference",
    "reduced_and_assembly",
    "reduced_model",
    "relative",
    "routes",
    "zone_slip",
]


def reduced_and_assembly(scene: Scene, cache: Path) -> tuple[ReducedModel, Assembly]:
    """Reduced model and assembly of a scene, built as in production on this process alone; its inputs are recorded."""
    assembly = assemble(scene, cache)
    model = reduced_model(assembly, cache)
    domain.record(assembly, model)
    return model, assembly


def reduced_model(assembly: Assembly, cache: Path) -> ReducedModel:
    """Reduced model of an assembly with the stiffness stated in its scene, built on this process alone."""
    return ReducedModel.build(assembly, coefficients(assembly, cache)[0])


@dataclass(frozen=True)
class Difference:
    """Largest differences of a reduced result from the full one, relative to the largest full value.

    Attributes
    ----------
    force : float
        Contact forces, relative within each stage.
    displacement : float
        Gaps and slips, relative within each stage.
    measurement : float
        Key characteristics.
    states : int
        Contacts whose state (open, stick, slip) differs.
    """

    force: float
    displacement: float
    measurement: float
    states: int

    @property
    def largest(self) -> float:
        """The largest of the three relative differences."""
        return max(self.force, self.displacement, self.measurement)


def relative(value, reference) -> float:
    """Largest difference over the largest value of the reference; infinite if only the reference is zero."""
    value, reference = np.asarray(value, dtype=float), np.asarray(reference, dtype=float)
    error = np.abs(value - reference).max(initial=0.0)
    if error == 0:
        return 0.0
    scale = np.abs(reference).max(initial=0.0)
    return float(error / scale) if scale > 0 else float("inf")


def difference(reduced: Evaluation, sample: int, full) -> Difference:
    """Compare one sample of an evaluation with a full solve.

    Parameters
    ----------
    reduced : mic.process.evaluation.Evaluation
    sample : int
    full : fem_reference.full.model.FullEvaluation
    """
    force, displacement, states = [], [], 0
    for stage, truth in full.resolutions.items():
        resolution = reduced.resolutions[stage]
        force.append(relative(resolution.force[sample], truth.force))
        displacement.append(relative(resolution.displacement[sample], truth.displacement))
        states += int((resolution.state[sample] != truth.state).sum())
    return Difference(max(force), max(displacement), relative(reduced.measurements[sample], full.measurements), states)


def certificates(process, reduced: Evaluation, sample: int, full) -> dict[str, float]:
    """Residual by stage of the full solve's contact forces in the reduced contact problem.

    Solutions of Coulomb's law need not be unique: if both residuals are small, both are solutions. Stages must be
    resolved in one increment under a law without tangential compliance.

    Parameters
    ----------
    process : mic.process.process.Process
        Process that computed `reduced`.
    """
    residuals = {}
    for prepared in process.stages:
        name = prepared.plan.name
        if name in full.resolutions:
            resolution = reduced.resolutions[name]
            contacts = process.model.contacts
            free = prepared.steps[-1].response.S.under(resolution.force[[sample]].reshape(1, -1))[0]
            residuals[name] = certify(
                prepared.steps[-1].response.S.whole(),
                resolution.displacement[sample].ravel() - free,
                contacts.friction_in(name),
                full.resolutions[name].force.ravel(),
                process.law,
                contacts.dimension,
            ).residual
    return residuals


def apart(full, other) -> float:
    """Largest relative difference of two full solves: forces, gaps, slips and key characteristics."""
    pairs = [(full.measurements, other.measurements)]
    for stage, resolution in other.resolutions.items():
        mine = full.resolutions[stage]
        pairs += [(mine.force, resolution.force), (mine.displacement, resolution.displacement)]
    return max(relative(*pair) for pair in pairs)


def routes(taken) -> str:
    """Sentence on the routes of full solves, from their :attr:`FullEvaluation.route`."""
    taken = list(taken)
    others = sorted({route for route in taken if route != "whole"})
    ways = "" if not others else f"; {sum(route != 'whole' for route in taken)} otherwise: {', '.join(others)}"
    return f"{len(taken)} full solves by the whole route{ways}."


def zone_slip(displacement, contacts, zones: int) -> np.ndarray:
    """RMS tangential displacement of each zone, mm; stated pairs have equal weights, candidates their area.

    Parameters
    ----------
    displacement : (..., m, 3) array
    contacts : mic.model.assembly.Contacts
    zones : int

    Returns
    -------
    (..., zones) array
    """
    square = (np.asarray(displacement)[..., 1:] ** 2).sum(-1)
    weight = np.where(contacts.watched, contacts.area, 1.0)
    members = [contacts.zone == z for z in range(zones)]
    return np.stack([np.sqrt(square[..., of] @ weight[of] / weight[of].sum()) for of in members], axis=-1)
