"""DataFrames of an evaluation, with the names and units of its scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mic.contact import laws
from mic.contact.states import SLIP, STATES, STICK
from mic.errors import ArgumentError
from mic.scene.deviation import deviation_unit
from mic.system.arguments import did_you_mean

if TYPE_CHECKING:
    import pandas as pd  # not needed to evaluate a model

    from mic.model.reduction import Reduction
    from mic.process.evaluation import Evaluation, Resolution

__all__ = ["TABLES", "ResultNames", "contact_columns", "frame", "states"]

#: Tables of an evaluation.
TABLES = ("samples", "deviations", "measurements", "contacts")
AXES = ("n", "t1", "t2")


@dataclass(frozen=True)
class ResultNames:
    """Names of what an evaluation computes.

    Attributes
    ----------
    deviations, measurements, zones : tuple of str
    units : tuple of str
        Of the deviations.
    zone : (m,) int array
        Zone of each contact pair.
    dimension : int
        Rows of a contact pair: 3, or 1 for its normal alone.
    frictional : bool
        Whether the law has friction.
    samples : pandas.Index, optional
        Names of the samples; default: their numbers.
    """

    deviations: tuple[str, ...]
    measurements: tuple[str, ...]
    zones: tuple[str, ...]
    units: tuple[str, ...]
    zone: np.ndarray
    dimension: int
    frictional: bool
    samples: Any = None

    @classmethod
    def of(cls, model: Reduction, law: str) -> ResultNames:
        """The names of a model's results under a contact law."""
        scene, contacts = model.scene, model.contacts
        return cls(
            deviations=tuple(model.parameters),
            measurements=tuple(item.name for item in scene.measurements),
            zones=tuple(zone.name for zone in scene.zones),
            units=tuple(deviation_unit(item, scene) for item in scene.deviations),
            zone=contacts.zone,
            dimension=contacts.dimension,
            frictional=laws.find(law).frictional,
        )


def frame(found: Evaluation, table: str) -> pd.DataFrame:
    """One of the :data:`TABLES` (:meth:`mic.process.evaluation.Evaluation.to_frame`)."""
    import pandas as pd

    if table not in TABLES:
        raise ArgumentError(f"table is {table!r}; {did_you_mean(table, TABLES)}")
    names = found.names
    index = pd.RangeIndex(len(found.failed), name="sample") if names.samples is None else names.samples
    if table == "contacts":
        number, stages = np.arange(len(index)), found.resolutions
        columns = contact_columns(names, list(stages.values()), number, list(stages))
        return pd.DataFrame(columns | {"sample": index.to_flat_index()[columns["sample"]]})
    measured = names.measurements if found.measurements.shape[1] else ()
    status = {"failed": found.failed, "built": found.built} if table == "samples" else {}
    # A name that two columns of a table would have gets a prefix in one of them.
    taken = {*measured, *status} if table == "samples" else {}
    x = {(f"deviation {name}" if name in taken else name): unit for name, unit in zip(names.deviations, names.units)}
    y = {(f"measurement {name}" if name in status else name): "mm" for name in measured}
    columns = {
        "deviations": pd.DataFrame(found.deviations, index, list(x)),
        "measurements": pd.DataFrame(np.where(found.failed[:, None], np.nan, found.measurements), index, list(y)),
    }
    result = pd.concat([*columns.values(), pd.DataFrame(status, index)], axis=1) if status else columns[table]
    result.attrs["units"] = {name: unit for name, unit in (x | y).items() if name in result.columns}
    return result


def contact_columns(
    names: ResultNames, resolutions: Sequence[Resolution], number: np.ndarray, stages: Sequence[str]
) -> dict[str, Any]:
    """Columns of contact forces, displacements (mm) and states: a row for each stage, sample and pair, in this order.

    Parameters
    ----------
    names : ResultNames
    resolutions : sequence of Resolution
        By stage.
    number : (n,) int array
        Numbers of the samples.
    stages : sequence of str
    """
    import pandas as pd

    n, m, d, count = len(number), len(names.zone), names.dimension, len(stages)

    def named(codes, words):
        return pd.Categorical.from_codes(np.asarray(codes, dtype=int), list(words))

    joined = lambda pieces, dtype: np.concatenate([np.zeros(0, dtype), *(np.asarray(piece, dtype) for piece in pieces)])
    columns = {
        "sample": np.tile(np.repeat(number, m), count),
        "stage": named(np.repeat(np.arange(count), n * m), stages),
        "zone": named(np.tile(names.zone, n * count), names.zones),
        "contact": np.tile(np.arange(m, dtype=np.int32), n * count),
    }
    for symbol, quantity in (("f", "force"), ("u", "displacement")):
        for j, axis in enumerate(AXES[:d]):
            columns[f"{symbol}_{axis}"] = joined([getattr(r, quantity)[:, :, j].ravel() for r in resolutions], float)
    columns["state"] = named(joined([r.state.ravel() for r in resolutions], np.int8), STATES)
    if d == 3:
        for name, state in (("path_stick", STICK), ("path_slip", SLIP)):
            share = joined([r.trace.share[:, :, state].ravel() for r in resolutions], np.float32)
            columns[name] = share if names.frictional else np.full_like(share, np.nan)
    return columns


def states(state: np.ndarray) -> str:
    """Number of contacts in each state, as ``3 open, 20 stick, 1 slip``."""
    count = np.bincount(state.ravel(), minlength=len(STATES))
    return ", ".join(f"{number} {name}" for number, name in zip(count.tolist(), STATES))
