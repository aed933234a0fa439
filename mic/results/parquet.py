"""One table of one block as a Parquet file, with units, format and identity in its metadata."""

from __future__ import annotations

from collections.abc import Callable
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


def write_table(path: Path, table: Table, frame: pd.DataFrame, identity: str, group: Group | None = None) -> None:
    """Write a table as Parquet, with units, format and the identity of its run in the metadata.

    `group` as for :func:`mic.system.files.replacing`.

    Raises
    ------
    FormatError
        If the frame differs from the declaration.
    """
    table.check(frame, path, "this is a fault of the program")
    columns = [column for column in table.columns if column.name in frame]
    # Column by column: pa.Table.from_pandas takes as long as writing the file.
    arrays = [_arrow(frame[column.name].array) for column in columns]
    fields = [
        pa.field(column.name, array.type, metadata={"unit": column.unit, "meaning": column.meaning})
        for column, array in zip(columns, arrays)
    ]
    kind = _FORMATS[table.name]
    header = {"kind": kind.kind, "format": str(kind.version), "identity": identity}
    content = pa.Table.from_arrays(arrays, schema=pa.schema(fields, header))
    repeating = [column.name for column in table.columns if column.dtype != "float64"]  # floats rarely repeat
    with replacing(path, group=group) as temporary:
        pq.write_table(content, temporary, write_page_checksum=True, use_dictionary=repeating)


def _arrow(values: Any) -> pa.Array:
    """Values of one column as an Arrow array; missing names and numbers are null."""
    if isinstance(values, pd.Categorical):
        names = pa.array(values.categories, pa.string())
        return pa.DictionaryArray.from_arrays(pa.array(values.codes, pa.int32()), names, from_pandas=True)
    return pa.array(values.to_numpy(), from_pandas=True)


def read_table(path: Path, table: Table) -> tuple[pd.DataFrame, str]:
    """The table in a file of :func:`write_table`, and the identity of its run.

    Raises
    ------
    FileNotFoundError
    FormatError
        If the file differs from the declaration, or is truncated or altered.
    """
    identity, frame = _read(path, table, lambda file: file.read().to_pandas())
    table.check(frame, path, _AGAIN)
    return frame, identity


def read_identity(path: Path, table: Table) -> str:
    """Identity of a table's run, from the metadata alone.

    Raises
    ------
    FileNotFoundError
    FormatError
        If the file is of another kind or truncated.
    """
    return _read(path, table, lambda file: None)[0]


def _read(path: Path, table: Table, read: Callable[[pq.ParquetFile], Any]) -> tuple[str, Any]:
    """Identity in a file, and what `read` takes from it."""
    kind = _FORMATS[table.name]
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            header, content = _header(file.schema_arrow), read(file)
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, ValueError):
        raise kind.damaged(path) from None
    kind.check(path, header)
    return str(header["identity"]), content


def _header(schema: pa.Schema) -> dict[str, object]:
    """Kind, format and identity in the metadata."""
    entries = {key.decode(): value.decode() for key, value in (schema.metadata or {}).items()}
    number = entries.get("format", "")
    return {
        "kind": entries.get("kind"),
        "format": int(number) if number.isdigit() else None,
        "identity": entries.get("identity", ""),
    }
