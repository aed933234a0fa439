"""`mic init`: propose a first scene from meshes alone, and write it."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from mic.errors import RunError, SceneError
from mic.geometry.script_dependencies import opened_files
from mic.scene.measurement import Measurement
from mic.scene.tables import read_rows
from mic.scene.weld import Weld
from mic.system.arguments import checked
from mic.system.files import replacing
from mic.wizard.bodies import Body, part_name, read_bodies
from mic.wizard.joints import NEAR, joined
from mic.wizard.proposal import Proposal, propose
from mic.wizard.scene_text import scene_text

__all__ = ["Proposal", "write_scene"]


@checked
def write_scene(
    files: Sequence[Path],
    out: Path | None = None,
    thickness: Mapping[str | None, float] | None = None,
    welds: Path | None = None,
    points: Path | None = None,
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
        CSV files with the coordinates of welds and of measured points.

    Returns
    -------
    folder : Path
    proposal : Proposal

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
    with opened_files() as opened:
        bodies = read_bodies(files, thickness or {})
    copies = _copies([body.file for body in bodies], opened, folder)
    lists = {}
    if welds is not None:
        lists["welds.csv"] = _listed_welds(welds, bodies)
    if points is not None:
        lists["points.csv"] = _listed_points(points, bodies)
    proposal = propose(bodies, None if welds is None else _by_parts(lists["welds.csv"]))
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


def _listed_welds(file: Path, bodies: list[Body]) -> list[dict[str, Any]]:
    """Rows of the list of welds, each with the two parts that it joins; a weld of three sheets becomes two rows."""
    welds: list[dict[str, Any]] = []
    problems: list[str] = []
    names = [body.name for body in bodies]
    for count, location, row, point in _placed_rows(file, Weld, problems):
        if len(row.get("parts", ())) == 2:
            pairs = [tuple(row["parts"])]
            if not set(pairs[0]) <= set(names):
                problems.append(f"{location}, column parts: {' '.join(pairs[0])}: the parts are {', '.join(names)}")
        else:
            pairs, nearest = joined(np.array(point), bodies)
            if not pairs:
                near = " and ".join(f"{name} ({distance:.3g} mm off)" for name, distance in nearest[:2])
                problems.append(f"{location}: a weld joins two parts within {NEAR:g} mm; the nearest are {near}")
        label = str(row.get("name", f"W{count}"))
        others = {key: value for key, value in row.items() if key not in ("name", "parts", "point")}
        for letter, pair in zip("abcdefgh", pairs):
            name = label + letter * (len(pairs) > 1)
            welds.append({"name": name, "parts": " ".join(pair), **dict(zip("xyz", point)), **others})
    if problems:
        raise SceneError("\n".join(problems))
    return welds


def _by_parts(rows: list[dict[str, Any]]) -> dict[tuple[str, str], np.ndarray]:
    pairs: dict[tuple[str, str], list[list[float]]] = {}
    for row in rows:
        first, second = row["parts"].split()
        pairs.setdefault((first, second), []).append([row[axis] for axis in "xyz"])
    return {pair: np.array(points) for pair, points in pairs.items()}


def _listed_points(file: Path, bodies: list[Body]) -> list[dict[str, Any]]:
    """Rows of the list of points to measure, each with its part."""
    measurements: list[dict[str, Any]] = []
    problems: list[str] = []
    for count, location, row, point in _placed_rows(file, Measurement, problems):
        distance = {body.name: float(body.surface.project(point).distance[0]) for body in bodies}
        part = row.get("part", min(distance, key=distance.__getitem__))
        if part not in distance:
            problems.append(f"{location}, column part: there is no part {part!r}; the parts are {', '.join(distance)}")
        elif distance[part] > NEAR:
            place = ", ".join(f"{x:g}" for x in point)
            problems.append(f"{location}: ({place}) is {distance[part]:.3g} mm away from {part}")
        direction = row.get("direction", "normal")
        measurement = {
            "name": row.get("name", f"M{count}"),
            "part": part,
            **dict(zip("xyz", point)),
            "direction": direction if isinstance(direction, str) else " ".join(f"{x:g}" for x in direction),
        }
        others = {key: value for key, value in row.items() if key not in (*measurement, "point")}
        measurements.append(measurement | others)
    if problems:
        raise SceneError("\n".join(problems))
    return measurements


def _placed_rows(
    file: Path, kind: type[BaseModel], problems: list[str]
) -> Iterator[tuple[int, str, dict[str, Any], list[float]]]:
    """The count, location, cells and point of each row of a list; rows without a point are added to `problems`."""
    for count, (number, row) in enumerate(read_rows(file, kind), 1):
        location, point = f"{file}: row {number}", row.get("point")
        if point is None or any(isinstance(x, str) or not np.isfinite(x) for x in point):
            given = "nothing" if point is None else ", ".join(str(x) or "nothing" for x in point)
            problems.append(f"{location}: x, y and z must be numbers, mm; got {given}")
        else:
            yield count, location, row, [float(x) for x in point]
