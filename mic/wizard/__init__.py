"""`mic init`: propose a first scene from meshes alone, and write it."""

from __future__ import annotations

import os
import shutil
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel, ValidationError

from mic.errors import RunError, SceneError
from mic.geometry.script_dependencies import opened_files
from mic.scene.measurement import Measurement
from mic.scene.part_names import PartNames
from mic.scene.table_file import LINE, TableSettings
from mic.scene.table_rows import WrongRows, read_rows
from mic.scene.weld import Weld
from mic.system.arguments import checked
from mic.system.files import replacing
from mic.wizard.bodies import Body, part_name, read_bodies
from mic.wizard.joints import NEAR, joined
from mic.wizard.proposal import Proposal, propose
from mic.wizard.scene_text import scene_text

__all__ = ["Proposal", "write_scene"]

#: Settings of a table that the places of its points may decide, and their values.
READINGS = {"decimal": (",", "."), "unit": ("mm", "cm", "m", "in", "ft")}


@checked
def write_scene(
    files: Sequence[Path],
    out: Path | None = None,
    thickness: Mapping[str | None, float] | None = None,
    welds: Path | None = None,
    points: Path | None = None,
    renamed: Mapping[str, str] | None = None,
    table: str | None = None,
) -> tuple[Path, Proposal]:
    """Propose a scene for the parts in mesh files, and write it, with copies of the files that it reads.

    A scene reads no files outside of its folder (:mod:`mic.system.foreign_files`).

    Parameters
    ----------
    files : sequence of Path
    out : Path, optional
        Folder of the scene; by default named after the meshes, in the working directory.
    thickness : mapping of str or None to float, optional
        mm, by part; the value of None applies to parts that are not named and whose mesh file has no thickness.
    welds, points : Path, optional
        Tables, CSV or Excel, with the coordinates of welds and of measured points.
    renamed : mapping of str to str, optional
        New name of a part by any of its names: that of its file, element set or property.
    table : str, optional
        How `welds` and `points` are to be read, in TOML with the keys of :class:`mic.scene.table_file.TableSettings`.

    Returns
    -------
    folder : Path
    proposal : Proposal
        Its sentences begin with how the columns of `welds` and `points` were read, where that is not obvious.

    Raises
    ------
    FormatError, SceneError
        If a mesh or a list cannot be read, or a thickness is missing.
    RunError
        If the folder contains a scene already, or cannot be written.
    """
    name = "+".join(dict.fromkeys(part_name(file.stem) for file in files))[:50]
    folder = Path(name) if out is None else Path(out)
    if (folder / "scene.toml").exists():
        raise RunError(f"{folder}: it contains a scene already; give another folder with --out")
    settings = _table_settings(table)
    with opened_files() as opened:
        bodies = read_bodies(files, thickness or {}, renamed)
    copies = _copies([body.file for body in bodies], opened, folder)
    lists: dict[str, list[dict[str, Any]]] = {}
    said: list[str] = []
    if welds is not None:
        lists["welds.csv"] = _listed_welds(welds, bodies, settings, said)
    if points is not None:
        lists["points.csv"] = _listed_points(points, bodies, settings, said)
    proposal = propose(bodies, None if welds is None else _by_parts(lists["welds.csv"]))
    proposal = replace(proposal, sentences=[*said, *proposal.sentences])
    places = {body.name: _place(body.file.resolve(), copies, folder) for body in bodies}
    text = scene_text(
        proposal, name, places, "welds.csv" if welds is not None else None, "points.csv" if points is not None else None
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for source, target in copies.items():
            with replacing(folder / target) as temporary:
                shutil.copyfile(source, temporary)
        for file, rows in lists.items():
            with replacing(folder / file) as temporary:
                pd.DataFrame(rows).to_csv(temporary, index=False)
        with replacing(folder / "scene.toml") as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise RunError(f"{folder}: cannot be written ({problem.strerror}); give another folder with --out") from problem
    return folder, proposal


def _copies(files: Sequence[Path], opened: Sequence[tuple[str, bool]], folder: Path) -> dict[Path, Path]:
    """Place in the scene's folder of each mesh file outside of it, and of the files that it includes."""
    copies: dict[Path, Path] = {}
    meshes = list(dict.fromkeys(file.resolve() for file in files))
    read = dict.fromkeys(Path(path).resolve() for path, writes in opened if not writes)
    included = [path for path in read if path.is_file() and path not in meshes and not _is_program(path)]
    for mesh in meshes:
        if not mesh.is_relative_to(folder.resolve()):
            own = Path(mesh.parent.name) if Path(mesh.name) in copies.values() else Path()
            copies[mesh] = own / mesh.name
            near = [path for path in included if path.is_relative_to(mesh.parent)]
            copies |= {path: own / path.relative_to(mesh.parent) for path in near}
    return copies


def _place(mesh: Path, copies: Mapping[Path, Path], folder: Path) -> str:
    """Name of a mesh file relative to the scene's folder."""
    return copies.get(mesh, Path(os.path.relpath(mesh, folder.resolve()))).as_posix()


def _is_program(path: Path) -> bool:
    """Whether a file is a part of Python or a package, which is imported when it is first needed."""
    return path.is_relative_to(Path(sys.prefix).resolve()) or path.suffix in (".py", ".pyc", ".so")


def _listed_welds(file: Path, bodies: list[Body], settings: TableSettings, said: list[str]) -> list[dict[str, Any]]:
    """Rows of the list of welds, each with the two parts that it joins; a weld of three sheets becomes two rows."""
    welds: list[dict[str, Any]] = []
    problems = WrongRows(file)
    known = PartNames({body.name: body.other_names for body in bodies})
    for number, row, point in _placed_rows(file, Weld, bodies, settings, said, problems):
        given, own = row.get("parts", []), bodies
        if wrong := [known.unknown(name) for name in given if name not in known.names]:
            problems.add(number, "parts", wrong[0])
            continue
        if len(given) == 2:
            pairs = [(given[0], given[1])]
        else:
            own = [body for body in bodies if body.name in given] if len(given) > 2 else bodies
            pairs, nearest = joined(np.array(point), own)
            if not pairs:
                near = " and ".join(f"{name} ({distance:.3g} mm off)" for name, distance in nearest[:2])
                problems.add(number, "", f"a weld joins two parts within {NEAR:g} mm; the nearest are {near}")
        label = str(row.get("name", f"W{len(welds) + 1}"))
        others = {key: value for key, value in row.items() if key not in ("name", "parts", "point")}
        for letter, pair in zip("abcdefgh", pairs):
            name = label + letter * (len(pairs) > 1)
            welds.append({"name": name, "parts": " ".join(pair), **dict(zip("xyz", point)), **others})
    problems.raise_all()
    return welds


def _by_parts(rows: list[dict[str, Any]]) -> dict[tuple[str, str], np.ndarray]:
    pairs: dict[tuple[str, str], list[list[float]]] = {}
    for row in rows:
        first, second = row["parts"].split()
        pairs.setdefault((first, second), []).append([row[axis] for axis in "xyz"])
    return {pair: np.array(points) for pair, points in pairs.items()}


def _listed_points(file: Path, bodies: list[Body], settings: TableSettings, said: list[str]) -> list[dict[str, Any]]:
    """Rows of the list of points to measure, each with its part."""
    measurements: list[dict[str, Any]] = []
    problems = WrongRows(file)
    known = PartNames({body.name: body.other_names for body in bodies})
    rows = _placed_rows(file, Measurement, bodies, settings, said, problems)
    for count, (number, row, point) in enumerate(rows, 1):
        distance = {body.name: float(body.surface.project(point).distance[0]) for body in bodies}
        part = row.get("part", min(distance, key=distance.__getitem__))
        if part not in distance:
            problems.add(number, "part", known.unknown(part))
        elif distance[part] > NEAR:
            place = ", ".join(f"{x:g}" for x in point)
            problems.add(number, "", f"({place}) is {distance[part]:.3g} mm away from {part}")
        direction = row.get("direction", "normal")
        measurement = {
            "name": row.get("name", f"M{count}"),
            "part": part,
            **dict(zip("xyz", point)),
            "direction": direction if isinstance(direction, str) else " ".join(map(repr, direction)),
        }
        others = {key: value for key, value in row.items() if key not in (*measurement, "point")}
        measurements.append(measurement | others)
    problems.raise_all()
    return measurements


def _table_settings(text: str | None) -> TableSettings:
    """The settings of tables in the text of an option."""
    try:
        return TableSettings(**tomllib.loads(text or ""))
    except (ValidationError, tomllib.TOMLDecodeError, TypeError) as problem:
        keys = ", ".join(TableSettings.model_fields)
        reason = problem.errors()[0]["msg"] if isinstance(problem, ValidationError) else problem
        raise SceneError(f"--table {text}: {reason}; give TOML with {keys}, such as 'decimal = \",\"'") from None


def _placed_rows(
    file: Path, kind: type[BaseModel], bodies: list[Body], settings: TableSettings, said: list[str], problems: WrongRows
) -> list[tuple[int, dict[str, Any], list[float]]]:
    """The number in the file, cells and point of each row of a list; rows without a point are added to `problems`."""
    parts = PartNames({body.name: body.other_names for body in bodies})
    try:
        rows, read = read_rows(file, kind, None, settings, parts)
    except SceneError as question:
        rows, read = _read_by_places(file, kind, bodies, settings, question)
    said += [f"{file.name}: {read}"] * bool(read)
    placed = []
    for number, row in rows:
        if (point := _point(row)) is None:
            given = ", ".join(str(x) or "nothing" for x in row.get("point", [""]))
            problems.add(number, "", f"x, y and z must be numbers, mm; got {given}")
        else:
            placed.append((number, row, point))
    return placed


def _point(row: dict[str, Any]) -> list[float] | None:
    """The point of a row, None if it has none."""
    point = row.get("point", ())
    good = len(point) == 3 and not any(isinstance(x, str) or not np.isfinite(x) for x in point)
    return [float(x) for x in point] if good else None


def _read_by_places(
    file: Path, kind: type[BaseModel], bodies: list[Body], settings: TableSettings, question: SceneError
) -> tuple[list[tuple[int, dict[str, Any]]], str]:
    """A list that may be read in two ways, in the only one that puts all its points onto the parts.

    Raises
    ------
    SceneError
        The question, if several ways do, or none.
    """
    parts, fitting = PartNames({body.name: body.other_names for body in bodies}), []
    key = next((key for key in READINGS if f'{key} = "' in str(question)), "")
    for value in READINGS.get(key, ()):
        try:
            rows, read = read_rows(file, kind, None, settings.model_copy(update={key: value}), parts)
        except SceneError:
            continue
        points = [_point(row) for _, row in rows]
        if None not in points:
            near = [body.surface.project(np.array(points)).distance <= NEAR for body in bodies]
            if (np.sum(near, axis=0) >= (2 if kind is Weld else 1)).all():
                fitting.append(
                    (rows, f'{read or "I read your table so"}; {key} = "{value}", as all points then lie on parts')
                )
    if len(fitting) != 1:
        raise SceneError(str(question).replace(LINE, "say which by --table")) from None
    return fitting[0]
