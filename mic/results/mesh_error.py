"""Table of estimated mesh errors: written by the run, read by the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from mic.model.mesh_accuracy import Accuracy
from mic.results.schema import ACCURACY

__all__ = ["accuracy_table", "read_accuracy", "write_accuracy"]


def accuracy_table(found: Sequence[Accuracy]) -> pd.DataFrame:
    """One row for each part and quantity, as :data:`mic.results.schema.ACCURACY` declares it."""
    rows = [
        {
            "part": part.part,
            "quantity": one.quantity,
            "set_down": one.set_down,
            "located": one.located,
            "nodes": part.mesh.nodes,
            "seconds": part.mesh.seconds,
            "memory": part.mesh.memory,
            "finer_nodes": part.finer.nodes,
            "finer_seconds": part.finer.seconds,
            "finer_memory": part.finer.memory,
        }
        for part in found
        for one in part.estimates
    ]
    return pd.DataFrame(rows) if rows else ACCURACY.empty()


def write_accuracy(folder: Path, found: Sequence[Accuracy]) -> None:
    """Write ``tables/accuracy.csv`` into a run folder."""
    ACCURACY.write(Path(folder), accuracy_table(found))


def read_accuracy(folder: Path) -> pd.DataFrame | None:
    """The table that :func:`write_accuracy` wrote; None where the run wrote none.

    Raises
    ------
    FormatError
        If the file is not what :data:`mic.results.schema.ACCURACY` declares.
    """
    return ACCURACY.read(Path(folder), "run the scene again into this folder")
