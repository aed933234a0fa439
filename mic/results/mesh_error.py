"""Table of estimated mesh errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from mic.model.mesh_accuracy import Accuracy, Mesh
from mic.results.schema import ACCURACY

__all__ = ["accuracy_table", "read_accuracy"]


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


def read_accuracy(folder: Path) -> pd.DataFrame | None:
    """The table of a run folder; None if the run wrote none.

    Raises
    ------
    FormatError
        If the file differs from :data:`mic.results.schema.ACCURACY`.
    """
    return ACCURACY.read(Path(folder), "run the scene again into this folder")
