"""Table of estimated mesh errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from mic.model.mesh_accuracy import Accuracy
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
            "nodes": part.mesh.nodes,
            "seconds": part.mesh.seconds,
            "memory": part.mesh.memory,
            "finer_nodes": part.finer.nodes,
            "finer_seconds": part.finer.seconds,
            "finer_memory": part.finer.memory,
        }
        for part in accuracies
        for estimate in part.estimates
    ]
    return pd.DataFrame(rows) if rows else ACCURACY.empty()


def read_accuracy(folder: Path) -> pd.DataFrame | None:
    """The table of a run folder; None if the run wrote none.

    Raises
    ------
    FormatError
        If the file differs from :data:`mic.results.schema.ACCURACY`.
    """
    return ACCURACY.read(Path(folder), "run the scene again into this folder")
