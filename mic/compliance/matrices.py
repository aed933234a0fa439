"""Reads reduced stiffness or compliance matrices on named nodes from files of other finite-element programs.

- Matrix Market (``.mtx``), with a node table beside it: ``lower.mtx`` and ``lower.csv``, a line ``node, x, y, z`` for
  each node. The matrix has six degrees of freedom per node in the order of the table, u_x, u_y, u_z, θ_x, θ_y, θ_z, or
  the three displacements only.
- Nastran ``OUTPUT4`` (``.op4``), text or binary, with the same node table: one matrix, or one named K… among others.
- Nastran ``DMIG`` (punch files of superelements, ``KAAX``), and Abaqus ``*MATRIX GENERATE`` output in the format of
  matrix input (``node, freedom, node, freedom, value``). Both name their nodes by number; the coordinates come
  from a node table beside the file, from its ``GRID`` cards, or from the part's own mesh file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from mic.compliance.output4 import matrices
from mic.errors import FormatError
from mic.geometry.readers import nastran
from mic.scene.table_columns import Columns
from mic.scene.table_file import parse_table
from mic.system.foreign_files import reading

__all__ = ["NodalMatrix", "read_matrix"]

NASTRAN = (".bdf", ".dat", ".dmig", ".nas", ".pch")
SYMMETRIC = 1e-6  # allowed asymmetry, relative to the largest entry


@dataclass(frozen=True)
class NodalMatrix:
    """A symmetric matrix over degrees of freedom of nodes.

    Attributes
    ----------
    node : (m,) int array
        Node number of each degree of freedom.
    component : (m,) int array
        0, 1, 2 for displacements along x, y, z, 3, 4, 5 for rotations about them.
    matrix : (m, m) csr_matrix
    places : dict of int to (3,) tuple
        Coordinates of nodes, in the unit of the file, if it or the table beside it states them.
    """

    node: np.ndarray
    component: np.ndarray
    matrix: csr_matrix
    places: dict[int, tuple[float, ...]]


def read_matrix(path: Path, folder: Path | None = None) -> NodalMatrix:
    """Read a matrix and the table of its nodes.

    `folder` is that of the scene that names the file, see :func:`mic.system.foreign_files.reading`.

    Raises
    ------
    FormatError
        Naming the file, if it is missing, of another kind, no square symmetric matrix of real numbers, or its table
        does not match it.
    """
    with reading(path, "matrix file", folder):
        table = path.with_suffix(".csv")
        places = _table(table) if table.is_file() else {}
        with open(path, "rb") as file:
            market = file.read(14) == b"%%MatrixMarket"
        suffix = path.suffix.lower()
        if market or suffix == ".op4":
            kind = "a Matrix Market" if market else "an OUTPUT4"
            if not places:
                raise FormatError(f"{kind} file needs the table of its nodes, node, x, y, z, beside it: {table.name}")
            return _by_table(_market(path) if market else _output4(path), places, table)
        if suffix == ".sim":
            raise FormatError("Abaqus' own binary matrices are not read; write matrix input or a Matrix Market file")
        return _dmig(path, places) if suffix in NASTRAN else _labelled(path, places)


def _table(path: Path) -> dict[int, tuple[float, ...]]:
    columns = ("node", "x", "y", "z")
    table = parse_table(path, Columns.of_file(columns), default=columns)
    if missing := [key for key in columns if key not in table.key_of]:
        raise FormatError(f"its node table {path.name} has no column {missing[0]}; it needs {', '.join(columns)}")
    if any(table.factor(key) != 1 for key in columns):
        raise FormatError(f"its node table {path.name} names a unit; give the unit of the mesh file, and no other")
    places: dict[int, tuple[float, ...]] = {}
    for (line, _), number, *place in zip(table.rows, *map(table.numbers, columns)):
        if not np.isfinite([number, *place]).all() or number != int(number):
            raise FormatError(f"line {line} of its node table {path.name} is not a number with x, y and z")
        if number in places:
            raise FormatError(f"line {line} of its node table {path.name} gives node {int(number)} again")
        places[int(number)] = tuple(place)
    return places


def _market(path: Path) -> csr_matrix:
    if not any(line.strip() and not line.startswith(b"%") for line in path.read_bytes().splitlines()):
        raise FormatError("it ends with its header; write it again")  # SciPy would loop forever
    from scipy.io import mmread  # slow to import, and few scenes have matrices

    return csr_matrix(mmread(path))


def _output4(path: Path) -> csr_matrix:
    by_name = matrices(path.read_bytes())
    return by_name[_only(list(by_name), "no matrix")]


def _only(names: list[str], nothing: str) -> str:
    """Name of the only matrix of a file, or of the only stiffness among several."""
    chosen = [name for name in names if name.upper().startswith("K")] or names
    if not names:
        raise FormatError(f"it holds {nothing}")
    if len(chosen) > 1:
        raise FormatError(f"it holds {', '.join(chosen)}, and one stiffness is wanted; leave the others out")
    return chosen[0]


def _by_table(matrix: csr_matrix, places: dict[int, tuple[float, ...]], table: Path) -> NodalMatrix:
    """A matrix in the order of the node table."""
    n, m = len(places), matrix.shape[0]
    per_node = {6 * n: 6, 3 * n: 3}.get(m)
    if per_node is None or matrix.shape != (m, m):
        raise FormatError(
            f"it has {matrix.shape[0]} × {matrix.shape[1]} entries, and the {n} nodes of {table.name} have {6 * n} "
            f"degrees of freedom, or {3 * n} displacements"
        )
    node = np.repeat(np.fromiter(places, dtype=np.int64), per_node)
    return NodalMatrix(node, np.tile(np.arange(per_node), n), _symmetric(matrix), places)


def _dmig(path: Path, places: dict[int, tuple[float, ...]]) -> NodalMatrix:
    by_name: dict[str, dict[tuple[tuple[int, int], tuple[int, int]], float]] = {}
    forms: dict[str, str] = {}
    for where, card in nastran.cards(list(nastran.lines(path))):
        try:
            if card[0] == "GRID":
                if card[2] not in ("", "0"):
                    raise FormatError(f"grid points in coordinate system {card[2]}; give a node table beside it")
                places.setdefault(int(card[1]), tuple(_real(text) for text in card[3:6]))
            elif card[0] == "DMIG" and card[2] == "0":
                forms[card[1]] = card[3]
                if card[4] not in ("", "1", "2"):
                    raise FormatError(f"{card[1]} is complex; a stiffness is real")
            elif card[0] == "DMIG":
                column, entries = (int(card[2]), int(card[3])), by_name.setdefault(card[1], {})
                for first in range(5, len(card) - 2, 4):
                    if card[first]:
                        entries[(int(card[first]), int(card[first + 1])), column] = _real(card[first + 2])
        except FormatError as problem:
            raise FormatError(f"{where}: {problem}") from None
        except (ValueError, IndexError):
            raise FormatError(f"{where}: a field of this {card[0]} is no number, or is missing") from None
    name = _only(list(by_name), "no DMIG cards; it is no punched superelement")
    if forms.get(name, "6") not in ("1", "6"):
        raise FormatError(f"{name} is rectangular; a stiffness is square")
    return _of_entries(by_name[name], places)


def _labelled(path: Path, places: dict[int, tuple[float, ...]]) -> NodalMatrix:
    entries: dict[tuple[tuple[int, int], tuple[int, int]], float] = {}
    for line, text in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if not text.strip() or text.lstrip().startswith("*"):
            continue
        fields = text.replace(",", " ").split()
        try:
            row, column, value = (int(fields[0]), int(fields[1])), (int(fields[2]), int(fields[3])), _real(fields[4])
        except (ValueError, IndexError):
            raise FormatError(
                f"line {line}: this is no entry of a matrix (node, degree of freedom, node, degree of freedom, value); "
                "write it with Abaqus by *MATRIX OUTPUT, FORMAT=MATRIX INPUT"
            ) from None
        entries[row, column] = value
    if not entries:
        raise FormatError("it holds no entries of a matrix")
    return _of_entries(entries, places)


def _of_entries(entries, places) -> NodalMatrix:
    """A matrix from entries by degree of freedom (node, component from 1); one triangle is sufficient."""
    freedoms = sorted({freedom for pair in entries for freedom in pair})
    wrong = next((freedom for freedom in freedoms if not 1 <= freedom[1] <= 6), None)
    if wrong is not None:
        raise FormatError(f"node {wrong[0]} has a degree of freedom {wrong[1]}; allowed are 1 to 6")
    number = {freedom: i for i, freedom in enumerate(freedoms)}
    whole = dict(entries)
    for (row, column), value in entries.items():
        whole.setdefault((column, row), value)
    rows, columns = ([number[pair[end]] for pair in whole] for end in (0, 1))
    m = len(freedoms)
    matrix = coo_matrix((list(whole.values()), (rows, columns)), shape=(m, m)).tocsr()
    table = np.array(freedoms)
    return NodalMatrix(table[:, 0], table[:, 1] - 1, _symmetric(matrix), places)


def _symmetric(matrix: csr_matrix) -> csr_matrix:
    if np.iscomplexobj(matrix.data) or not np.isfinite(matrix.data).all():
        raise FormatError("it holds entries that are no finite real numbers")
    largest = abs(matrix).max() if matrix.nnz else 0.0
    if not largest > 0:
        raise FormatError("all its entries are zero")
    if abs(matrix - matrix.T).max() > SYMMETRIC * largest:
        raise FormatError("it is not symmetric, as every stiffness and compliance must be; write it again")
    return csr_matrix(0.5 * (matrix + matrix.T))


def _real(text: str) -> float:
    return float(nastran.REAL.sub(r"\1e\2", text.upper().replace("D", "E")) if "E" not in text.upper() else text)
