"""Estimated mesh errors: of each part's influence coefficients, and of each key characteristic.

The first samples of a run are evaluated again with the influence coefficients of meshes of half the element size, with
contact pairs at the same points. With y on the given meshes and x on the finer ones, and the factor f to the limit of
ever finer meshes (:func:`mic.model.mesh_accuracy.extrapolation`), the expected changes are

    mean: f [x̄ − ȳ + β (μ − ȳ)],        6σ: f (s_x/s_y − 1) · 6σ,

with mean μ and 6σ of the run, and the slope β of a regression of x − y on y, which makes up for ȳ ≠ μ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mic.compliance.coefficients import InfluenceCoefficients
from mic.execution.ranks import on_first
from mic.model.assembly import Assembly
from mic.model.mesh_accuracy import Accuracy, Mesh, extrapolation, with_finer_meshes
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients, used_stiffness
from mic.results.outcome import Outcome
from mic.results.schema import ACCURACY, MESH_CHANGES
from mic.statistics.paired_differences import jackknife
from mic.system.cores import available_cores

__all__ = ["FinerModel", "accuracy_table", "mesh_changes"]

SAMPLES = 30  # first valid samples that are evaluated again


@dataclass(frozen=True)
class FinerModel:
    """The reduced model on meshes of half the element size.

    Attributes
    ----------
    model : ReducedModel
    nodes, finer_nodes : int
        Of all parts, on the given and on the finer meshes.
    factor : float
        From a change to the error of the given meshes.
    """

    model: ReducedModel
    nodes: int
    finer_nodes: int
    factor: float

    @classmethod
    def of(
        cls,
        assembly: Assembly,
        influence: Mapping[str, InfluenceCoefficients],
        cache: Path,
        report: Callable[[str], None],
        world: Any,
    ) -> FinerModel | None:
        """Mesh and reduce an assembly again; None without characteristics or meshes, and on all ranks but the first.

        Collective under MPI; with the stiffness that the given coefficients are for. Errors are those of
        :func:`mic.model.mesh_accuracy.estimate_accuracy`.
        """
        if not assembly.scene.measurements or all(part.superelement is not None for part in assembly.parts):
            return None

        def refine() -> Assembly:
            same = {"stiffness": used_stiffness(assembly.scene, influence)}
            scene = assembly.scene.model_copy(update=same)
            return replace(with_finer_meshes(assembly, cache), scene=scene)

        finer = on_first(world, refine)
        of_finer, _ = coefficients(finer, cache, report, world)
        if world is not None and world.rank > 0:
            return None
        count = lambda what, of: sum(len(getattr(part.surface, what)) for part in of.parts)
        factor = extrapolation(count("triangles", assembly), count("triangles", finer))
        nodes = count("points", assembly), count("points", finer)
        return cls(ReducedModel.build(finer, of_finer), nodes[0], nodes[1], factor)


def mesh_changes(outcome: Outcome, finer: FinerModel) -> pd.DataFrame:
    """Expected changes of means and 6σ on ever finer meshes, as :data:`mic.results.schema.MESH_CHANGES` declares them.

    Parameters
    ----------
    outcome : Outcome
        Its first :data:`SAMPLES` valid samples of each law are evaluated again.
    finer : FinerModel
    """
    model, rows = finer.model, []
    printed = {(row["law"], row["measurement"]): row for row in outcome.measurement_headlines.to_dict("records")}
    for law in outcome.laws:
        numbers = outcome.sample_numbers(law)[:SAMPLES]
        if not len(numbers):
            continue
        process = model.process(law, backend=model.scene.monte_carlo.backend, threads=available_cores())
        again = process.attempt(outcome.deviations(law, numbers))
        for k, item in enumerate(model.scene.measurements):
            x = np.where(again.failed, np.nan, again.measurements[:, k])
            y = outcome.measured(law, item.name, numbers)
            own = printed[law, item.name]
            row = {"law": law, "measurement": item.name, "nodes": finer.nodes, "finer_nodes": finer.finer_nodes}
            statistics: dict[str, tuple[Callable[[np.ndarray], float], float]] = {
                "mean": (partial(_shift, mean=own["mean"]), finer.factor),
                "six_sigma": (_widening, finer.factor * own["six_sigma"]),
            }
            for name, (statistic, scale) in statistics.items():
                change = jackknife(np.column_stack([y, x]), statistic, groups=SAMPLES)
                for end, value in (("", change.value), ("_low", change.low), ("_high", change.high)):
                    row[f"{name}_change{end}"] = scale * value
            rows.append(row | {"samples": len(numbers), "failed": int(again.failed.sum())})
    return pd.DataFrame(rows)[MESH_CHANGES.names] if rows else MESH_CHANGES.empty()


def _shift(samples: np.ndarray, mean: float) -> float:
    """Mean of the second column (n, 2) minus that of the first, where the first has the given mean."""
    y, d = samples[:, 0] - samples[:, 0].mean(), samples[:, 1] - samples[:, 0]
    slope = y @ d / (y @ y) if y.any() else 0.0
    return float(d.mean() + slope * (mean - samples[:, 0].mean()))


def _widening(samples: np.ndarray) -> float:
    """Relative excess of σ of the second column (n, 2) over that of the first; 0 if neither varies."""
    first, second = samples.std(axis=0, ddof=1)
    return float(second / first - 1) if first > 0 else 0.0 if second == 0 else float("nan")


def accuracy_table(accuracies: Sequence[Accuracy]) -> pd.DataFrame:
    """One row for each part and quantity, as :data:`mic.results.schema.ACCURACY` declares it."""
    rows = [
        {
            "part": part.part,
            "quantity": estimate.quantity,
            "set_down": estimate.set_down,
            "located": estimate.located,
        }
        | _cost(part.mesh)
        | _cost(part.finer, "finer_")
        for part in accuracies
        for estimate in part.estimates
    ]
    return pd.DataFrame(rows) if rows else ACCURACY.empty()


def _cost(mesh: Mesh, prefix: str = "") -> dict[str, float]:
    return {f"{prefix}{name}": getattr(mesh, name) for name in ("nodes", "seconds", "memory")}
