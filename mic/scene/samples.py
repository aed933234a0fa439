"""Tables of samples: a row per assembly, a column per deviation, or one with the names of measured pieces."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd

from mic.errors import SceneError
from mic.scene.checks import entry
from mic.scene.deviation import ShapeDeviation
from mic.scene.schema import DESIGNS, Scene
from mic.scene.stages import unknown
from mic.scene.table_columns import Columns
from mic.scene.table_file import TableFile, open_table
from mic.system.files import fingerprint
from mic.system.foreign_files import reading

__all__ = ["DESIGNS", "take_samples"]

FAR = 100.0  # σ: values farther off are in another unit


def take_samples(scene: Scene) -> tuple[Scene, dict[str, str | None]]:
    """The scene with the samples of its table, and the hash of this file by name.

    Parameters
    ----------
    scene : Scene
        With measured shapes and fields replaced by their modes (:mod:`mic.model.shape_modes`).

    Raises
    ------
    SceneError
        For wrong columns or cells, one line each; for a number of samples that the design or the table does not allow.
    """
    settings = scene.monte_carlo
    size = DESIGNS[settings.design]
    if settings.samples % size:
        raise SceneError(
            f"monte_carlo.samples: {settings.samples} is not a multiple of {size}, the samples that design = "
            f'"{settings.design}" makes together; give {size * max(1, round(settings.samples / size))}'
        )
    if settings.table is None and settings.values is None:
        return scene, {}
    inputs: dict[str, str | None] = {}
    if settings.table is not None:
        path = scene.folder / settings.table
        at, where = f"monte_carlo.table: {path}", str(path)
        try:
            values = _read_values(path, scene)
        except SceneError as error:
            raise SceneError("\n".join(f"monte_carlo.table: {line}" for line in str(error).splitlines())) from None
        inputs[settings.table] = fingerprint(path.read_bytes())
    else:
        at = where = "monte_carlo.values"
        if {len(row) for row in settings.values or []} != {len(scene.deviations)}:
            raise SceneError(f"{at}: each sample needs {len(scene.deviations)} values, one per deviation; correct them")
        values = np.array(settings.values)
    _check_units(at, scene, values)
    count = settings.samples if "samples" in settings.model_fields_set else len(values)
    if count > len(values):
        raise SceneError(
            f"monte_carlo.samples: {count} are requested, and {where} has {len(values)} rows; request fewer, or remove "
            "samples"
        )
    sampled = settings.model_copy(update={"samples": count, "values": values.tolist()})
    return scene.model_copy(update={"monte_carlo": sampled}), inputs


def _columns(path: Path, given, scene: Scene) -> list[str]:
    """The names of the deviations; raises SceneError if the columns are others."""
    names, errors = [item.name for item in scene.deviations], []
    for column in given:
        if column not in names:
            batches = sorted({item.batch for item in _scored(scene) if item.batch is not None})
            errors += unknown(f"{path}: row 1", str(column), [*names, *batches], "deviation")
    missing = [repr(name) for name in names if name not in given]
    if len(missing) == 1:
        errors.append(f"{path}: row 1: there is no column {missing[0]}; add it, with a value in each row")
    elif missing:
        errors.append(f"{path}: row 1: there are no columns {', '.join(missing)}; add them, with a value in each row")
    if errors:
        raise SceneError("\n".join(errors))
    return names


def _expand_pieces(path: Path, frame: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """Replace columns with names of measured pieces by the scores of these pieces in the batch's deviations."""
    for first in {item.batch: item for item in _scored(scene) if item.batch in frame.columns}.values():
        batch = first.batch
        of_batch = [item for item in scene.deviations if isinstance(item, ShapeDeviation) and item.batch == batch]
        repeated = [item.name for item in of_batch if item.name in frame.columns]
        if repeated:
            raise SceneError(
                f"{path}: row 1: there are columns {batch!r} and {repeated[0]!r}; give the piece, or its scores"
            )
        names = first.pieces or [str(i + 1) for i in range(len(first.scores or []))]
        cells = [str(cell).strip() for cell in frame[batch]]
        for row, cell in zip(frame.index, cells):
            if cell and cell not in names:
                raise SceneError(
                    f"{path}: row {row}, column {batch}: there is no measured piece {cell!r}; known: {', '.join(names)}"
                )
        frame = frame.drop(columns=batch)
        for item in of_batch:
            value = [repr(item.mean + item.sigma * score) for score in item.scores or [0.0] * len(names)]
            frame[item.name] = [value[names.index(cell)] if cell else "" for cell in cells]
    return frame


def _scored(scene: Scene) -> list[ShapeDeviation]:
    """The deviations with scores of measured pieces."""
    return [item for item in scene.deviations if isinstance(item, ShapeDeviation) and item.scores is not None]


def _read_values(path: Path, scene: Scene) -> np.ndarray:
    """(n, p) values of a table, or of a Parquet file."""
    if path.suffix == ".parquet":
        cells = _expand_pieces(path, _read_parquet(path, scene.folder), scene)
        cells = cells[_columns(path, cells.columns, scene)]
        values = cells.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    else:
        known = [*(item.name for item in scene.deviations), *{item.batch for item in _scored(scene) if item.batch}]
        table = open_table(path, Columns({name: () for name in known}), scene.folder)
        heads = list(table.header.headers)
        for name, column in table.key_of.items():
            heads[column] = name
        cells = pd.DataFrame(
            [cells for _, cells in table.rows], columns=heads, index=[n for n, _ in table.rows], dtype=object
        )
        cells = _expand_pieces(path, cells, scene)
        cells = cells[_columns(path, cells.columns, scene)]
        try:
            values = np.array([_numbers(table, str(name), column) for name, column in cells.items()]).T
        except SceneError as problem:
            raise SceneError(f"{path}: {problem}") from None
    if not len(cells):
        raise SceneError(f"{path}: there is no row below the header; add rows, or remove the table")
    for row, column in np.argwhere(~np.isfinite(values)):
        cell, name = cells.iloc[row, column], cells.columns[column]
        what = f"{cell!r} is not a finite number" if isinstance(cell, str) else f"is {cell}, not a finite number"
        raise SceneError(f"{path}: row {cells.index[row]}, column {name}: {what}; correct it, or remove the row")
    return values


def _numbers(table: TableFile, name: str, cells: pd.Series) -> list[float]:
    """The numbers of a column of the table, or of one that the program wrote."""
    return table.numbers(name) if name in table.key_of else [float(cell) if cell else np.nan for cell in cells]


def _read_parquet(path: Path, folder: Path) -> pd.DataFrame:
    with reading(path, "table of samples", folder, SceneError):
        frame = pd.read_parquet(BytesIO(path.read_bytes()))  # pyarrow's own reading would pass the gate by
        return frame.set_axis(range(1, len(frame) + 1))


def _check_units(at: str, scene: Scene, values: np.ndarray) -> None:
    """Raise SceneError for columns whose values are so many sigma off the mean that their unit must be wrong."""
    items = scene.deviations
    mean, sigma = np.array([[item.mean, item.sigma] for item in items]).reshape(-1, 2).T
    distance = np.sqrt(((values - mean) ** 2).mean(axis=0))
    errors = [
        f"{at}: column {item.name}: its values are {distance[j]:.3g} off the mean, and sigma is {item.sigma:g}; give "
        f"{entry('deviations', item.entry(j), item)} and the column in the same unit"
        for j, item in enumerate(items)
        if item.sigma > 0 and distance[j] > FAR * item.sigma
    ]
    if errors:
        raise SceneError("\n".join(errors))
