"""Exact derivatives of key characteristics, contact forces and slip with respect to the inputs of an assembly.

Between contact problems the process is linear. Derivatives therefore go through the same steps as the samples: what a
stage passes on (readings, contact positions, given welds, reactions of released rows, forces of stops) is passed on
with its derivatives, as one more assembly for each input, driven by a unit of that input. Contact itself is
differentiated where it is solved (:mod:`mic.contact.tangent`), with its states known and the steps of its path fixed.

A row that moves in its sheet by δ along a tangent reads ``ℓ·y + δ a'·y`` and pushes with ``λ (ℓ + δ a')``: S, T and L,
eliminated with ℓ, change (:mod:`mic.process.moving_rows`), S by ``-T αᵀ - α Tᵀ`` with α what a load on a' moves.

:mod:`mic.process.inputs` names the inputs. A thickness changes the compliance itself, and so does a shape that the
stiffness follows: derivatives with respect to these are central differences along the same path steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mic.errors import SceneError
from mic.process.differentiated_process import DifferentiatedProcess
from mic.process.evaluation import PathSteps, Sensitivities
from mic.process.inputs import Inputs, known_inputs
from mic.system.matrix_product import one_thread

__all__ = ["AT_CHANGE", "Sensitivities", "known_inputs", "sensitivities"]

AT_CHANGE = 1e-6  #: standard deviations: closer samples count as being at a change of state
BESIDE = 1e-5  # standard deviations beyond twice the distance to the change, where one-sided derivatives are taken
BLOCK_NUMBERS = 2_000_000  # values of samples and derivatives held in memory at once
THICKNESS_STEP = 1e-4  # of a sheet's thickness: half the step of its central difference
SHAPE_STEP = 1e-2  # standard deviations of a shape that the stiffness follows: likewise


def _refuse_resting(process) -> None:
    """Raise SceneError where a part rests by contact alone."""
    steps = [(stage.plan.name, each.rest) for stage in process.stages for each in stage.steps]
    resting = [(stage, rest.name[i]) for stage, rest in steps for i in np.flatnonzero(rest.soft)]
    if resting:
        stage, part = resting[0]
        raise SceneError(
            f"stages ({stage}): part {part!r} rests by contact alone, and derivatives by positions in sheets are not "
            "available for such parts; leave these inputs out, or give the part six locators"
        )


@one_thread
def sensitivities(
    process,
    deviations: np.ndarray,
    inputs: Sequence[str] | Mapping[str, float] | None = None,
    steps: PathSteps | None = None,
) -> Sensitivities:
    """Take assemblies and their derivatives through all stages.

    Parameters
    ----------
    process : mic.process.process.Process
    deviations : (n, p) array
        As :meth:`mic.model.reduction.Reduction.deviations` returns it.
    inputs : sequence of str, or mapping of str to float, optional
        Names from :func:`known_inputs`, or these with standard deviations that replace the scene's; default: the
        scene's deviations.
    steps : mapping, optional
        Path steps to be retraced: those of samples nearby.

    Raises
    ------
    ValueError
        If an input is unknown, or none is given.
    SceneError
        If parts rest by contact alone and positions in sheets are inputs.
    """
    model = process.model
    names = list(model.parameters if inputs is None else inputs)
    differentiated = Inputs.of(model, names)
    if differentiated.places:
        _refuse_resting(process)
    known = inputs if isinstance(inputs, Mapping) else known_inputs(model)
    sigma = np.array([known[name] for name in names])
    half_steps = _inputs_by_differences(model, names)
    thicknesses = [i for i, (j, _) in half_steps.items() if model.scene.deviations[j].kind == "thickness"]
    reach_sigma = np.where(np.isin(np.arange(len(names)), thicknesses), 0.0, sigma)
    result = _in_blocks(process, deviations, names, reach_sigma, steps)
    if not half_steps:
        return result
    result = replace(
        result,
        sigma=sigma,
        **{name: getattr(result, name).copy() for name in ("jacobian", "sides", "reach_along")},
    )
    for i, (j, step) in half_steps.items():
        _fill_by_differences(process, deviations, result, i, j, step)
        if i in thicknesses:
            result.reach_along[:, i] = np.nan
        else:
            at_change = (result.reach <= AT_CHANGE) & (result.reach_along[:, i] <= BESIDE)
            result.sides[:, :, i] = np.where(at_change[:, None], np.nan, result.jacobian[:, :, i])[..., None]
    return result


def _inputs_by_differences(model, names: Sequence[str]) -> dict[int, tuple[int, float]]:
    """Inputs that change the compliance, by number: the deviation's number and half the difference step."""
    followed = [] if model.slopes is None else model.slopes.source.tolist()
    half_steps = {}
    for j, deviation in enumerate(model.scene.deviations):
        if deviation.name in names and deviation.kind == "thickness":
            thickness = next(part.sheet[0] for part in model.scene.parts if part.name == deviation.part)
            half_steps[names.index(deviation.name)] = j, THICKNESS_STEP * thickness
        elif deviation.name in names and j in followed:
            half_steps[names.index(deviation.name)] = j, SHAPE_STEP * deviation.sigma
    return half_steps


def _in_blocks(process, deviations, names, sigma, steps) -> Sensitivities:
    """Derivatives at fixed compliance, in blocks of samples."""
    model = process.model
    size = sum(rows.shape[0] for rows in model.rows.values()) * (len(names) + 1)
    block = max(1, BLOCK_NUMBERS // max(size, 1))
    pieces = []
    for run, changed_process in process.by_model(deviations):
        for first in range(run.start, run.stop, block):
            samples = slice(first, min(first + block, run.stop))
            block_steps = None if steps is None else {key: record[samples] for key, record in steps.items()}
            piece = DifferentiatedProcess(
                changed_process, deviations[samples], names, sigma, block_steps
            ).sensitivities()
            _fill_one_sided(changed_process, deviations[samples], piece)
            pieces.append(piece)
    return Sensitivities.join(pieces)


def _fill_by_differences(process, deviations: np.ndarray, result: Sensitivities, i: int, j: int, half: float) -> None:
    """Fill in the derivatives by input i, which is deviation j and changes the compliance: central differences."""
    step = np.where(np.arange(deviations.shape[1]) == j, half, 0.0)
    low, high = (
        _in_blocks(process, deviations + sign * step, result.inputs[i : i + 1], np.zeros(1), result.steps)
        for sign in (-1.0, 1.0)
    )
    result.jacobian[:, :, i] = (high.measurements - low.measurements) / (2 * half)
    result.jacobian[result.failed, :, i] = np.nan
    for stage, contacts in result.contacts.items():
        slope = high.contacts[stage].force - low.contacts[stage].force
        contacts.force_slope[..., i] = slope / (2 * half)
        contacts.slip_slope[..., i] = np.nan


def _fill_one_sided(process, deviations: np.ndarray, result: Sensitivities) -> None:
    """Fill in one-sided derivatives of samples at a change of state, along the same path steps."""
    at_change = np.flatnonzero(~result.failed & (result.reach <= AT_CHANGE))
    for i, (name, σ) in enumerate(zip(result.inputs, result.sigma)) if at_change.size else ():
        samples = at_change[result.reach_along[at_change, i] <= BESIDE]
        if not samples.size:
            continue
        distance = σ * (BESIDE + 2 * result.reach_along[samples, i])
        both, offset = np.tile(samples, 2), np.concatenate([-distance, distance])
        steps = {key: record[both] for key, record in result.steps.items()}
        shifted = DifferentiatedProcess(process, deviations[both], [name], np.array([σ]), steps, offset)
        if shifted.inputs.places:
            result.sides[samples, :, i] = np.nan
            continue
        sides = shifted.sensitivities()
        slope = np.where((sides.exact & ~sides.failed)[:, None], sides.jacobian[:, :, 0], np.nan)
        result.sides[samples, :, i] = slope.reshape(2, len(samples), -1).transpose(1, 2, 0)
