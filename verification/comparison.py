"""One assembly, two routes: the reduced model's outcome beside that of the full finite elements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from mic.contact import certify
from mic.model.assembly import Assembly, assemble
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.scene import Scene

__all__ = ["Difference", "certificates", "difference", "reduced_and_assembly", "reduced_model", "relative", "zone_slip"]


def reduced_and_assembly(scene: Scene, cache: Path) -> tuple[ReducedModel, Assembly]:
    """The reduced model of a scene and the assembly that it came from, made by the production path on this process
    alone."""
    assembly = assemble(scene, cache)
    return reduced_model(assembly, cache), assembly


def reduced_model(assembly: Assembly, cache: Path) -> ReducedModel:
    """The reduced model of an assembly, made on this process alone, with the stiffness that its scene asks for."""
    return ReducedModel.build(assembly, coefficients(assembly, cache, comm=MPI.COMM_SELF)[0])


@dataclass(frozen=True)
class Difference:
    """How far a reduced outcome is from the full one, over all stages; each relative to the full outcome's largest
    value.

    Attributes
    ----------
    force : float
        Of contact forces, within each stage.
    displacement : float
        Of gaps and slips, within each stage.
    measurement : float
        Of key characteristics.
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
    """Largest difference over the largest value of the reference; infinite where only the reference vanishes."""
    value, reference = np.asarray(value, dtype=float), np.asarray(reference, dtype=float)
    off = np.abs(value - reference).max(initial=0.0)
    if off == 0:
        return 0.0
    scale = np.abs(reference).max(initial=0.0)
    return float(off / scale) if scale > 0 else float("inf")


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
        mine = reduced.resolutions[stage]
        force.append(relative(mine.force[sample], truth.force))
        displacement.append(relative(mine.displacement[sample], truth.displacement))
        states += int((mine.state[sample] != truth.state).sum())
    return Difference(max(force), max(displacement), relative(reduced.measurements[sample], full.measurements), states)


def certificates(process, reduced: Evaluation, sample: int, full) -> dict[str, float]:
    """Residual, by stage, of the full solve's contact forces in the reduced contact problem.

    A solution of Coulomb's law need not be unique: where both routes have small residuals, both are solutions, however
    far apart. Stages must be resolved in one increment, under a law whose contacts do not yield before they slip.

    Parameters
    ----------
    process : mic.process.process.Process
        What made `reduced`.
    """
    found = {}
    for prepared in process.stages:
        name = prepared.plan.name
        if name in full.resolutions:
            mine = reduced.resolutions[name]
            contacts = process.model.contacts
            b = mine.displacement[sample].ravel() - prepared.response.S.under(mine.force[[sample]].reshape(1, -1))[0]
            found[name] = certify(
                prepared.response.S.whole(),
                b,
                contacts.friction_in(name),
                full.resolutions[name].force.ravel(),
                process.law,
                contacts.dimension,
            ).residual
    return found


def zone_slip(displacement, contacts, zones: int) -> np.ndarray:
    """RMS tangential displacement of each zone, mm, as reports print it: pairs that are stated count alike, candidates
    by their area.

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
    own = [contacts.zone == z for z in range(zones)]
    return np.stack([np.sqrt(square[..., mine] @ weight[mine] / weight[mine].sum()) for mine in own], axis=-1)
