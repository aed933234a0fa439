"""One table of one block as a Parquet file; units, format and identity stand in its metadata."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from mic.results.schema import DATASETS, Table
from mic.system.files import Format, Group, replacing

__all__ = ["read_identity", "read_table", "write_table"]

_AGAIN = "run the scene again into this folder"
_FORMATS = {table.name: Format(f"block of {table.name}", table.version, _AGAIN) for table in DATASETS}
_ARROW = {
    "bool": pa.bool_(),
    "int32": pa.int32(),
    "int64": pa.int64(),
    "float32": pa.float32(),
    "float64": pa.float64(),
}
_NAMES = pa.dictionary(pa.int32(), pa.string())


def write_table(path: Path, table: Table, frame: pd.DataFrame, identity: str, group: Group | None = None) -> None:
    """Write a table as Parquet, with its units, its format and the identity of its run in the metadata.

    `group` as :func:`mic.system.files.replacing` takes it.

    Raises
    ------
    FormatError
        If the frame is not what the table declares.
    """
    table.check(frame, path, "this is a fault of the program")
    own = [column for column in table.columns if column.name in frame]
    fields = [
        pa.field(
            column.name, _ARROW.get(column.dtype, _NAMES), metadata={"unit": column.unit, "meaning": column.meaning}
        )
        for column in own
    ]
    kind = _FORMATS[table.name]
    header = {"kind": kind.kind, "format": str(kind.version), "identity": identity}
    # By columns: Arrow's own way from a frame takes as long as the writing.
    content = pa.Table.from_arrays([_column(frame[one.name].array) for one in own], schema=pa.schema(fields, header))
    repeating = [column.name for column in table.columns if column.dtype != "float64"]  # numbers hardly ever are
    with replacing(path, group=group) as temporary:
        pq.write_table(content, temporary, write_page_checksum=True, use_dictionary=repeating)


def _column(values: Any) -> pa.Array:
    """Values of one column, of the declared type; names and numbers that are missing are null."""
    if isinstance(values, pd.Categorical):
        names = pa.array(values.categories, pa.string())
        return pa.DictionaryArray.from_arrays(pa.array(values.codes, pa.int32()), names, from_pandas=True)
    return pa.array(values.to_numpy(), from_pandas=True)


def read_table(path: Path, table: Table) -> tuple[pd.DataFrame, str]:
    """Read what :func:`write_table` wrote, and the identity of the run that it belongs to.

    Raises
    ------
    FileNotFoundError
    FormatError
        If the file is not what the table declares, or is cut short or altered.
    """
    kind = _FORMATS[table.name]
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            content = file.read()
        header = _header(content.schema)
        frame = content.to_pandas()
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, ValueError):
        raise kind.damaged(path) from None
    kind.check(path, header)
    table.check(frame, path, _AGAIN)
    return frame, str(header["identity"])


def read_identity(path: Path, table: Table) -> str:
    """Identity of the run that a table belongs to, from its metadata alone.

    Raises
    ------
    FileNotFoundError
    FormatError
        If the file is something else, or is cut short.
    """
    kind = _FORMATS[table.name]
    try:
        header = _header(pq.read_schema(path))
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, ValueError):
        raise kind.damaged(path) from None
    kind.check(path, header)
    return str(header["identity"])


def _header(schema: pa.Schema) -> dict[str, object]:
    """What the metadata says of kind, format and identity."""
    found = {key.decode(): value.decode() for key, value in (schema.metadata or {}).items()}
    number = found.get("format", "")
    return {
        "kind": found.get("kind"),
        "format": int(number) if number.isdigit() else None,
        "identity": found.get("identity", ""),
    }
