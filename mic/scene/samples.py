"""Samples that a scene gives in a file, a row for each assembly, a column for each deviation under its name, or one for
all modes of measured pieces, which names the piece."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from mic.errors import SceneError
from mic.scene.checks import entry
from mic.scene.deviation import ShapeDeviation
from mic.scene.schema import Scene
from mic.scene.stages import known
from mic.scene.tables import DECIMAL, read_cells, read_number
from mic.system.files import fingerprint

__all__ = ["DESIGNS", "take_samples"]

FAR = 100.0  # σ: no part is that far off, but one whose unit is another
#: Designs, and how many samples each makes together, which are independent of the next.
DESIGNS = {"independent": 1, "antithetic": 2, "latin-hypercube": 50, "sobol": 64}


def take_samples(scene: Scene) -> tuple[Scene, dict[str, str | None]]:
    """The scene with the samples that its table gives, and the table's hash by name.

    Parameters
    ----------
    scene : Scene
        Its measured shapes and fields written out (:mod:`mic.model.shape_modes`): their modes are columns, too.

    Raises
    ------
    SceneError
        For a file that is no such table, a line for each column and cell at fault; for a number of samples that its
        design or its table does not have.
    """
    asked = scene.monte_carlo
    size = DESIGNS[asked.design]
    if asked.samples % size:
        raise SceneError(
            f"monte_carlo.samples: {asked.samples} is no multiple of {size}, the samples that design = "
            f'"{asked.design}" makes together; give {size * max(1, round(asked.samples / size))}'
        )
    if asked.table is None and asked.values is None:
        return scene, {}
    inputs: dict[str, str | None] = {}
    if asked.table is not None:
        path = scene.folder / asked.table
        at, where = f"monte_carlo.table: {path}", str(path)
        try:
            values = _parquet(path, scene) if path.suffix == ".parquet" else _text(path, scene)
        except SceneError as error:
            raise SceneError("\n".join(f"monte_carlo.table: {line}" for line in str(error).splitlines())) from None
        inputs[asked.table] = fingerprint(path.read_bytes())
    else:
        at = where = "monte_carlo.values"
        if {len(row) for row in asked.values or []} != {len(scene.deviations)}:
            raise SceneError(f"{at}: there are {len(scene.deviations)} deviations; give each sample as many values")
        values = np.array(asked.values)
    _judge(at, scene, values)
    count = asked.samples if "samples" in asked.model_fields_set else len(values)
    if count > len(values):
        raise SceneError(
            f"monte_carlo.samples: {count} are asked for, and {where} has {len(values)} rows; ask for fewer, or leave "
            "samples out"
        )
    taken = asked.model_copy(update={"samples": count, "values": values.tolist()})
    return scene.model_copy(update={"monte_carlo": taken}), inputs


def _columns(path: Path, given, scene: Scene) -> list[str]:
    """The names of the deviations, which the columns are; refused where they are others."""
    names, found = [item.name for item in scene.deviations], []
    for column in given:
        if column not in names:
            batches = sorted({item.batch for item in _scored(scene) if item.batch is not None})
            found += _unknown(f"{path}: row 1", str(column), [*names, *batches])
    missing = [repr(name) for name in names if name not in given]
    if len(missing) == 1:
        found.append(f"{path}: row 1: there is no column {missing[0]}; add it, with a value in each row")
    elif missing:
        found.append(f"{path}: row 1: there are no columns {', '.join(missing)}; add them, with a value in each row")
    if found:
        raise SceneError("\n".join(found))
    return names


def _spread(path: Path, frame: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """A column under the name of a batch of measured pieces names one of them in each row; in its place come those of
    the batch's deviations, with what the piece has of each."""
    for first in {item.batch: item for item in _scored(scene) if item.batch in frame.columns}.values():
        batch = first.batch
        own = [item for item in scene.deviations if isinstance(item, ShapeDeviation) and item.batch == batch]
        twice = [item.name for item in own if item.name in frame.columns]
        if twice:
            raise SceneError(
                f"{path}: row 1: there are columns {batch!r} and {twice[0]!r}; give the piece, or what it has of each"
            )
        names = first.pieces or [str(i + 1) for i in range(len(first.scores or []))]
        cells = [str(cell).strip() for cell in frame[batch]]
        for row, cell in zip(frame.index, cells):
            if cell and cell not in names:
                raise SceneError(
                    f"{path}: row {row + 2}, column {batch}: there is no measured piece {cell!r}; known: "
                    f"{', '.join(names)}"
                )
        frame = frame.drop(columns=batch)
        for item in own:
            value = [repr(item.mean + item.sigma * score) for score in item.scores or [0.0] * len(names)]
            frame[item.name] = [value[names.index(cell)] if cell else "" for cell in cells]
    return frame


def _scored(scene: Scene) -> list[ShapeDeviation]:
    """The deviations that measured pieces have scores in; of modes that are drawn no piece is told."""
    return [item for item in scene.deviations if isinstance(item, ShapeDeviation) and item.scores is not None]


def _unknown(at: str, column: str, names: list[str]) -> list[str]:
    try:
        known(at, column, names, "deviation")
    except ValueError as error:
        return str(error).splitlines()
    return []


def _text(path: Path, scene: Scene) -> np.ndarray:
    """(n, p) values of a CSV file."""
    cells, separator = read_cells(path)
    cells = _spread(path, cells, scene)
    names = _columns(path, cells.columns, scene)
    cells = cells[names].apply(lambda column: column.str.strip())
    if separator != ",":
        cells = cells.apply(lambda column: column.str.replace(DECIMAL, ".", regex=True))
    cells = cells[(cells != "").any(axis=1)]
    values = np.array([[read_number(cell) for cell in row] for row in cells.to_numpy()]).reshape(len(cells), len(names))
    for row, column in np.argwhere(~np.isfinite(values)):
        raise SceneError(
            f"{path}: row {cells.index[row] + 2}, column {names[column]}: {cells.iloc[row, column]!r} is no finite "
            "number; fill it in, or take the row out"
        )
    return _some(path, values)


def _parquet(path: Path, scene: Scene) -> np.ndarray:
    """(n, p) values of a Parquet file."""
    try:
        frame = pd.read_parquet(path)
    except FileNotFoundError:
        raise SceneError(f"there is no file {path}; correct the name (it is relative to the scene file)") from None
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: cannot be read as Parquet ({error}); write it anew, or give CSV") from None
    frame = _spread(path, frame, scene)
    names = _columns(path, frame.columns, scene)
    values = frame[names].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    for row, column in np.argwhere(~np.isfinite(values)):
        raise SceneError(f"{path}: row {row}, column {names[column]}: is no finite number; take the row out")
    return _some(path, values)


def _some(path: Path, values: np.ndarray) -> np.ndarray:
    if not len(values):
        raise SceneError(f"{path}: there is no row below the header; fill it in, or take the table out")
    return values


def _judge(at: str, scene: Scene, values: np.ndarray) -> None:
    """Refuse values that cannot be of the deviations' units: their spread is told by sigma."""
    items = scene.deviations
    mean, sigma = np.array([[item.mean, item.sigma] for item in items]).reshape(-1, 2).T
    off = np.sqrt(((values - mean) ** 2).mean(axis=0))
    found = [
        f"{at}: column {item.name}: it is off its mean by {off[j]:.3g}, and sigma is {item.sigma:g}; give "
        f"{entry('deviations', j, item)} and the column in the same unit"
        for j, item in enumerate(items)
        if item.sigma > 0 and off[j] > FAR * item.sigma
    ]
    if found:
        raise SceneError("\n".join(found))
