"""Measured points of a part: read from files, best fitted to the nominal surface, and converted to deviations.

The *deviation* of a sheet at a point x of its nominal surface is the distance of the measured sheet from x along the
normal n of the mesh there. For points p of a cloud it is ``(p − x)·n`` with x the nearest point of the surface. Beside
a fold x may lie on the wrong face: if the other face deviates by d, its sheet ends up to d beside the fold, and points
within d may belong to either.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from mic.errors import FormatError
from mic.geometry.deck import UNITS, Deck
from mic.geometry.readers import READERS, read_raw
from mic.geometry.surface import Surface
from mic.geometry.triangles import rotation
from mic.scene.table_columns import Columns
from mic.scene.table_file import TableFile, TableSettings, parse_table
from mic.system.foreign_files import reading

__all__ = [
    "FACING",
    "Cloud",
    "Deviations",
    "Fit",
    "deviations",
    "read_clouds",
    "refuse_unit",
    "sheet_normals",
    "spread",
    "unit_remedy",
]

TEXT = (".csv", ".txt", ".xyz", ".asc", ".tsv", ".xlsx")
AXES = ("x", "y", "z")
ACTUAL = ("actual_x", "actual_y", "actual_z")
#: Columns of a table of points; those of normals and limits are not used.
COLUMNS = Columns.of_file(
    ("name", "node", *AXES, *ACTUAL, "deviation", "serial", "i", "j", "k", "nominal", "lower", "upper", "tolerance")
)
LONG, HEAD = 1_000_000, 60_000  # bytes of a table that is read quickly, and of the rows that show its dialect
FITS = 50  # iterations of the best fit, each with new nearest points
CONVERGED = 1e-9  # of the part's size: motion below which the best fit has converged
EXCLUDED = 0.05  # largest share of excluded points
FACING = 0.85  # least cosine between the normals of one face of a fold
NEIGHBOURS = 24  # points from which the deviation of the faces of a fold is estimated
IMPLAUSIBLE = 20.0  # ratio of sizes above which the points cannot cover the part
LIKELY = 0.5  # |ln| of the ratio of sizes below which a unit is plausible


@dataclass(frozen=True)
class Cloud:
    """Measured points of one piece.

    Attributes
    ----------
    points : (n, 3) array
        Measured positions, mm; nominal positions if `deviation` is given.
    deviation : (n,) array or None
        Along the normals, mm.
    """

    points: np.ndarray
    deviation: np.ndarray | None


@dataclass(frozen=True)
class Fit:
    """The rigid motion of the best fit.

    Attributes
    ----------
    shift : float
        Displacement of the cloud's centre, mm.
    turn : float
        Rotation angle, degrees.
    left_out : int
        Number of excluded points, too far from the part.
    """

    shift: float
    turn: float
    left_out: int


@dataclass(frozen=True)
class Deviations:
    """Deviations of a piece from its nominal surface.

    Attributes
    ----------
    points, normal : (n, 3) array
        On the surface, mm, and its unit normals there.
    value : (n,) array
        Along the normals of the mesh, mm.
    fit : Fit
    sure : (n,) bool array
        Whether the point certainly lies on the face that was measured, and not on the other face of a fold.
    """

    points: np.ndarray
    normal: np.ndarray
    value: np.ndarray
    fit: Fit
    sure: np.ndarray


def read_clouds(
    path: Path, unit: str, surface: Surface, deck: Deck | None, folder: Path | None = None
) -> dict[str, Cloud]:
    """Read the points of measured pieces.

    Parameters
    ----------
    path : Path
        A table, or a mesh file, whose points are used.
    unit : str
        Unit of length in the file, one of `UNITS`, for columns that name none.
    surface : Surface
        Nominal surface, for nodal deviations.
    deck : Deck or None
        Provides the node numbers.
    folder : Path, optional
        Of the scene that names the file, see :func:`mic.system.foreign_files.reading`.

    Returns
    -------
    dict of str to Cloud
        By serial number; that of a file with one piece is empty.

    Raises
    ------
    FormatError
        Naming the file, and the line of an error.
    """
    if path.suffix.lower() in TEXT:
        with reading(path, "file of measured points", folder):
            points = _many_points(path, unit)
            if points is not None:
                return {"": Cloud(points, None)}
            return _clouds(parse_table(path, COLUMNS, TableSettings(unit=unit), AXES), surface, deck)
    if path.suffix.lower() not in READERS:
        raise FormatError(
            f"{path}: measured points cannot be read from {path.suffix or 'files without a suffix'}; save "
            f"them as {', '.join(TEXT)} with a header x, y, z, or as one of {', '.join(READERS)}"
        )
    points = UNITS[unit][0] * read_raw(path, folder=folder).points
    if not len(points):
        raise FormatError(f"{path}: the file has no points; export the measured points")
    return {"": Cloud(_finite(path, points, AXES), None)}


def _many_points(path: Path, unit: str) -> np.ndarray | None:
    """(n, 3) points of a long table of numbers alone, mm; None if it is short, or has anything else.

    The dialect is that of its first rows.
    """
    if path.suffix.lower() == ".xlsx" or path.stat().st_size < LONG:
        return None
    head = parse_table(path, COLUMNS, TableSettings(unit=unit), AXES, HEAD)
    keys = head.key_of
    axes = ACTUAL if all(axis in keys for axis in ACTUAL) else AXES
    if head.decimal_mark is None or not all(axis in keys for axis in axes) or {"deviation", "serial", "name"} & {*keys}:
        return None
    if axes == AXES and len(head.header.headers) > len(keys):
        return None  # further columns may be deviations
    import pandas as pd  # most scenes have no long table

    columns = [keys[axis] for axis in axes]
    dialect: dict = {"sep": r"\s+"} if head.separator.isspace() and head.separator != "\t" else {"sep": head.separator}
    try:
        frame = pd.read_csv(
            path,
            header=None,
            skiprows=head.rows[0][0] - 1,
            decimal=head.decimal_mark,
            float_precision="round_trip",
            **dialect,
        )
        points = frame[columns].to_numpy(dtype=float) * [head.factor(axis) for axis in axes]
    except (ValueError, KeyError):  # the cells that are no numbers are named by the thorough reader
        return None
    first = np.column_stack([_numbers(head, axis) for axis in axes])
    same = np.array_equal(points[: len(first)], first)
    return points if same and np.isfinite(points).all() else None


def _clouds(table: TableFile, surface: Surface, deck: Deck | None) -> dict[str, Cloud]:
    """The pieces of a table: one, or several by serial number, or one for each column of deviations."""
    keys = table.key_of
    axes = next((axes for axes in (ACTUAL, AXES) if all(axis in keys for axis in axes)), None)
    if not table.rows:
        raise FormatError("there are no rows below the header; export the measured points")
    if axes is None and ("node" not in keys or any(axis in keys for axis in AXES)):
        missing = ", ".join(axis for axis in AXES if axis not in keys)
        usual = "give x, y, z, or x, y, z, deviation, or node, deviation"
        raise FormatError(f"row {table.header_row}: column {missing} is missing; {usual}")
    points = _nodes(table, surface, deck) if axes is None else np.column_stack([_numbers(table, axis) for axis in axes])
    if axes == ACTUAL or "deviation" in keys or (axes == AXES and "name" not in keys):
        value = _numbers(table, "deviation") if "deviation" in keys and axes != ACTUAL else None
        serial = np.array(table.texts("serial") if "serial" in keys else [""] * len(points))
        own = {str(piece): serial == piece for piece in dict.fromkeys(serial.tolist())}
        return {piece: Cloud(points[rows], None if value is None else value[rows]) for piece, rows in own.items()}
    columns = {
        header: np.array(table.numbers(at)) for at, header in enumerate(table.header.headers) if at not in keys.values()
    }
    pieces = {header: (np.isfinite(column), column) for header, column in columns.items() if np.isfinite(column).any()}
    if not pieces and axes is None:
        raise FormatError(f"row {table.header_row}: column deviation is missing; add it, or a column for each piece")
    scale = table.factor("deviation") if "deviation" in keys else UNITS[table.settings.unit or "mm"][0]
    found = {header: Cloud(points[known], scale * column[known]) for header, (known, column) in pieces.items()}
    return found or {"": Cloud(points, None)}


def _numbers(table: TableFile, key: str) -> np.ndarray:
    """(n,) numbers of a column, one in every row."""
    numbers = np.array(table.numbers(key))
    for i in np.flatnonzero(~np.isfinite(numbers))[:1]:
        cell = f"{table.header.headers[table.key_of[key]]} is {table.texts(key)[i]!r}"
        raise FormatError(f"row {table.rows[i][0]}: {cell}; give a number in every row")
    return numbers


def _finite(path: Path, values: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """The values (n, m) of named quantities; refuses values that are not finite."""
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise FormatError(f"{path}: point {row + 1}: {names[column]} is {values[row, column]}; give finite numbers")
    return values


def _nodes(table: TableFile, surface: Surface, deck: Deck | None) -> np.ndarray:
    """(n, 3) points of numbered nodes of the part's mesh."""
    if deck is None or not len(deck.nodes):
        raise FormatError("the mesh of the part has no node numbers; give x, y, z, deviation")
    place = dict(zip(deck.nodes.tolist(), deck.node_points.tolist()))
    found = []
    for (row, _), node in zip(table.rows, _numbers(table, "node")):
        point = place.get(int(node), -1)
        if point < 0 or node != int(node):
            raise FormatError(f"row {row}: the part has no node {node:g} on its surface; remove the row")
        found.append(point)
    return surface.points[np.array(found)]


def sheet_normals(surface: Surface, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points on a surface (n, 3), and the unit normals of the curved sheet there (n, 3)."""
    foot = surface.project(points)
    return foot.point, surface.smooth_normals(foot.triangle, foot.barycentric)


def deviations(
    path: Path, cloud: Cloud, surface: Surface, skin: float, align: bool, within: float, unit: str = "mm"
) -> Deviations:
    """Deviations of a measured piece from its nominal surface.

    Parameters
    ----------
    path : Path
        File of the points, for messages.
    cloud : Cloud
    surface : Surface
        Nominal.
    skin : float
        Nominal distance of the points from the surface along its normals, mm.
    align : bool
        Whether to best fit the points first: the rigid motion that minimises the squares of ``(p − x)·n − skin``.
    within : float
        Points farther than this from the surface are excluded, mm.
    unit : str
        Unit of the file, for messages.

    Raises
    ------
    FormatError
        If more than one point in twenty is excluded: wrong part or unit.
    """
    refuse_unit(path, cloud.points, surface, unit)
    if cloud.deviation is not None:
        foot, n = sheet_normals(surface, cloud.points)
        near = np.linalg.norm(foot - cloud.points, axis=1) <= within
        _refuse_excluded(path, near, cloud.points, foot, within, surface, unit)
        fit, sure = Fit(0.0, 0.0, int((~near).sum())), np.ones(int(near.sum()), dtype=bool)
        return Deviations(foot[near], n[near], cloud.deviation[near], fit, sure)
    points, turn = cloud.points, np.eye(3)
    for _ in range(FITS if align else 0):
        foot, n = sheet_normals(surface, points)
        off = ((points - foot) * n).sum(axis=1) - skin
        middle = points.mean(axis=0)
        near = np.abs(off) <= max(within, 3 * np.median(np.abs(off)))
        rows = np.hstack([n, np.cross(points - middle, n) / surface.diameter])[near]
        motion = -np.linalg.lstsq(rows, off[near], rcond=1e-6)[0]
        turned = motion[3:] / surface.diameter
        step = rotation(turned, float(np.linalg.norm(turned)))
        points, turn = middle + motion[:3] + (points - middle) @ step.T, step @ turn
        if np.abs(motion).max() < CONVERGED * surface.diameter:
            break
    foot, n = sheet_normals(surface, points)
    off = ((points - foot) * n).sum(axis=1) - skin
    beside = np.linalg.norm(points - foot - ((points - foot) * n).sum(axis=1)[:, None] * n, axis=1)
    near = (np.abs(off) <= within) & (beside <= within)
    _refuse_excluded(path, near, points, foot, within, surface, unit)
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    moved = float(np.linalg.norm(points.mean(axis=0) - cloud.points.mean(axis=0)))
    fit = Fit(moved, float(angle), int((~near).sum()))
    return Deviations(foot[near], n[near], off[near], fit, _on_measured_face(surface, foot[near], off[near] + skin))


def _on_measured_face(surface: Surface, foot: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the nearest point (n, 3) of a measured point certainly lies on the face that was measured.

    It does if its distance to the nearest fold exceeds the deviations `off` (n,), mm, of the points around it.
    """
    triangle, opposite = surface.edges(np.arccos(FACING))
    inner = ~surface.border[triangle, opposite]
    if not inner.any():
        return np.ones(len(foot), dtype=bool)
    spacing = float(np.median(surface.edge_lengths)) / 4
    fold = surface.at(*surface.sample_edges(triangle[inner], opposite[inner], spacing)[:2])
    away = np.sqrt(np.maximum(cKDTree(fold).query(foot)[0] ** 2 - (spacing / 2) ** 2, 0.0))
    about = cKDTree(foot).query(foot, min(NEIGHBOURS, len(foot)))[1].reshape(len(foot), -1)
    return away >= np.abs(off)[about].max(axis=1)


def refuse_unit(path: Path, points: np.ndarray, surface: Surface, unit: str) -> None:
    """Refuse a cloud whose size differs from the part so much that any best fit would be meaningless."""
    remedy = unit_remedy(points, surface, unit)
    if remedy and abs(np.log(surface.diameter / _span(points))) > np.log(IMPLAUSIBLE):
        raise FormatError(f"{path}: the points cannot be those of the part: {remedy}")


def _refuse_excluded(path: Path, near, points, foot, within: float, surface: Surface, unit: str) -> None:
    """Refuse a cloud with too many excluded points."""
    if (~near).mean() <= EXCLUDED:
        return
    typical = float(np.median(np.linalg.norm(points - foot, axis=1)))
    usual = "correct the part, the unit or the datum of the points, or raise within"
    raise FormatError(
        f"{path}: {int((~near).sum())} of {len(near)} points lie more than {within:g} mm from the part (median "
        f"{typical:.3g} mm): {unit_remedy(points, surface, unit) or usual}"
    )


def _span(points: np.ndarray) -> float:
    """Diagonal of the bounding box of points, mm."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def unit_remedy(points: np.ndarray, surface: Surface, unit: str) -> str | None:
    """Remedy that names another unit, in which the points would be as large as the part; None if there is none."""
    span, size = _span(points), surface.diameter
    if span == 0.0:
        return None
    away = {name: abs(np.log(size / span * UNITS[unit][0] / UNITS[name][0])) for name in UNITS}
    likely = min(away, key=lambda name: away[name])
    if likely == unit or not away[likely] < LIKELY < away[unit]:
        return None
    return f'they span {span:.3g} mm and the part {size:.3g} mm; give unit = "{likely}"'


def spread(surface: Surface, spacing: float, box=None) -> np.ndarray:
    """(c,) vertices of a surface spread evenly: no vertex is farther than `spacing` from a chosen one.

    Farthest-point sampling, beginning with the vertex farthest from the centroid. With a `box` (2, 3) of its lower and
    upper corner only vertices within it; there may be none.
    """
    used = np.unique(surface.triangles)
    if box is not None:
        low, high = np.array(box)
        used = used[((surface.points[used] >= low) & (surface.points[used] <= high)).all(axis=1)]
    if not len(used):
        return used
    x = surface.points[used]
    chosen = [int(np.argmax(np.linalg.norm(x - surface.centroid, axis=1)))]
    away = np.linalg.norm(x - x[chosen[0]], axis=1)
    while away.max() > spacing:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(x - x[chosen[-1]], axis=1))
    return used[chosen]
