"""Numbers of a few samples of a placed scene, as it stands or transformed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from mic.model.assembly import PlacedScene, assemble_placed
from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.results.path_error import other_solution_of
from verification.comparison import reduced_model
from verification.symmetry.numbers import numbers
from verification.symmetry.transformation import Transformation

__all__ = ["Solution", "has_several_solutions", "matched", "pairs_of", "solve"]


@dataclass(frozen=True)
class Solution:
    """Numbers of some samples, in the units of the scene as it stands.

    Attributes
    ----------
    numbers : dict of str to DataFrame
        By law, as :func:`verification.symmetry.numbers.numbers`.
    pairs : (m, 4) array
        Points of the contact pairs of the solved scene, mm, and their zones.
    """

    numbers: dict[str, pd.DataFrame]
    pairs: np.ndarray


def solve(
    placed: PlacedScene,
    deviations: np.ndarray,
    transformation: Transformation | None = None,
    pairs: np.ndarray | None = None,
    cache: Path | None = None,
) -> Solution:
    """Solve samples under all laws of the scene's report.

    Parameters
    ----------
    placed : PlacedScene
    deviations : (n, p) array
        Of the scene as it stands.
    transformation : Transformation, optional
        Solve the transformed scene, and transform its numbers back.
    pairs : (m, 4) array, optional
        Those of the scene as it stands, in whose order those of the transformed one are listed.
    cache : Path, optional
        Cache folder; default: a temporary one.

    Raises
    ------
    SceneError, ArithmeticError
        If the scene cannot be solved, or has another number of contact pairs.
    """
    change = transformation or Transformation("as it stands")
    with TemporaryDirectory() as temporary:
        folder = cache or Path(temporary)
        assembly = assemble_placed(change.apply(placed) if transformation else placed, folder)
        model = reduced_model(assembly, folder)
    found, order = pairs_of(model), np.arange(len(model.contacts))
    if pairs is not None:
        if len(pairs) != len(found):
            raise ArithmeticError(f"{len(found)} contact pairs are found, and {len(pairs)} in the scene as it stands")
        order = matched(np.column_stack([change.points(pairs[:, :3]), pairs[:, 3]]), found)
    values = change.deviations(placed.scene, deviations)
    return Solution({law: _numbers(model, law, values, change, order) for law in placed.scene.report.laws}, found)


def has_several_solutions(placed: PlacedScene, deviations: np.ndarray) -> bool:
    """Whether other contact forces than the computed ones are found, and certified, in a step under the first law."""
    with TemporaryDirectory() as temporary:
        model = reduced_model(assemble_placed(placed, Path(temporary)), Path(temporary))
    law, every, found = placed.scene.report.laws[0], np.arange(len(model.contacts)), []
    process = Process(model, law, backend=model.scene.monte_carlo.backend)

    def inspect(stage, eliminated, state, solution):
        given = eliminated.compliance[0], model.contacts.friction_in(stage), law, state, solution
        found.extend(other_solution_of(*given, sample, every) for sample in range(len(deviations)))

    for stage in process.stages:
        stage.inspect = partial(inspect, stage.plan.name)
    process.attempt(deviations)
    return any(found)


def _numbers(model: ReducedModel, law: str, values, change, order) -> pd.DataFrame:
    backend = model.scene.monte_carlo.backend
    table = numbers(model, model.process(law, backend=backend).attempt(values), order)
    return table.div([change.factor(unit) for unit in table.index.get_level_values("unit")], axis=0)


def pairs_of(model: ReducedModel) -> np.ndarray:
    """(m, 4) points of a model's contact pairs, mm, and their zones."""
    return np.column_stack([model.contacts.point, model.contacts.zone])


def matched(pairs: np.ndarray, found: np.ndarray) -> np.ndarray:
    """(m,) which of the found pairs (m, 4) each of the pairs (m, 4) is, one to one, in the same zone."""
    distance = np.linalg.norm(pairs[:, None, :3] - found[:, :3], axis=-1)
    far = 1.0 + distance.sum()
    return linear_sum_assignment(np.where(pairs[:, None, 3] == found[:, 3], distance, far))[1]
