"""Derivatives of a batch of assemblies with respect to its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mic.process.evaluation import stacked

__all__ = ["ContactSensitivity", "PathSteps", "Sensitivities"]

#: Recorded path steps: by stage and number of the step, the record (n,) of each sample.
PathSteps = Mapping[tuple, np.ndarray]


@dataclass(frozen=True)
class ContactSensitivity:
    """Contact forces and their derivatives, for m contacts at the end of a stage that solves contact.

    Attributes
    ----------
    force : (n, m, d) array
        N.
    state : (n, m) int8 array
        A :class:`mic.contact.states.ContactState` each.
    force_slope : (n, m, d, p) array
        Derivatives of the forces, N per unit of the inputs.
    slip_slope : (n, m, d - 1, p) array
        Derivatives of the tangential displacement since the stage before, mm per unit; NaN for inputs that change the
        compliance.
    """

    force: np.ndarray
    state: np.ndarray
    force_slope: np.ndarray
    slip_slope: np.ndarray


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of n assemblies with respect to p inputs.

    Attributes
    ----------
    law : str
    inputs : list of str
    sigma : (p,) array
        Standard deviations of the inputs; 0 for inputs that the scene holds fixed.
    measurements : (n, k) array
        Key characteristics along the differentiated path, mm; they differ from those of an evaluation by at most the
        error of its path.
    jacobian : (n, k, p) array
        Their derivatives, mm per unit of the inputs.
    sides : (n, k, p, 2) array
        One-sided derivatives of samples at a change of state (``reach`` at most
        :data:`mic.process.sensitivity.AT_CHANGE`): towards smaller and towards larger values of the input. NaN where no
        solution exists there, for positions in sheets, and for shapes that change the stiffness. Other samples, and
        inputs that do not lead to the change, have the derivatives themselves on both sides.
    contacts : dict of str to ContactSensitivity
        By stage.
    reach : (n,) array
        Distance to the next change of a contact's state at the end of a step, to first order, in standard deviations
        along the direction in which all inputs together change that contact most; infinite if no state changes.
    reach_along : (n, p) array
        The same along each input alone: infinite for inputs without standard deviation, NaN for thicknesses, which
        ``reach`` ignores too. Changes of the stiffness with the shape are ignored.
    where : (n,) object array of str
        The contact that changes its state there.
    failed : (n,) bool array
        Samples whose contact did not meet its tolerance, or in which nothing determines the position of a resting part;
        their derivatives are NaN.
    exact : (n,) bool array
        Whether every step of the path was solved again exactly; otherwise the derivatives have the error of the path.
    steps : mapping
        The recorded path steps, which another call can reuse.
    """

    law: str
    inputs: list[str]
    sigma: np.ndarray
    measurements: np.ndarray
    jacobian: np.ndarray
    sides: np.ndarray
    contacts: dict[str, ContactSensitivity]
    reach: np.ndarray
    reach_along: np.ndarray
    where: np.ndarray
    failed: np.ndarray
    exact: np.ndarray
    steps: PathSteps

    @classmethod
    def join(cls, pieces: Sequence[Sensitivities]) -> Sensitivities:
        """Concatenate batches of samples."""
        first = pieces[0]
        contacts = {
            stage: ContactSensitivity(**stacked([piece.contacts[stage] for piece in pieces], ContactSensitivity))
            for stage in first.contacts
        }
        steps = {key: np.concatenate([piece.steps[key] for piece in pieces]) for key in first.steps}
        arrays = stacked(pieces, cls) | {"sigma": first.sigma}
        return cls(law=first.law, inputs=first.inputs, contacts=contacts, steps=steps, **arrays)
