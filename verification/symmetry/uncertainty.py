"""Numerical uncertainty of the numbers of any scene: how far the same samples disagree when they are solved otherwise.

The scene is scaled, rotated, mirrored, renumbered and permuted (:mod:`verification.symmetry.transformation`), followed
on a tighter path, and solved by whole finite elements. Its uncertainty is the largest disagreement, with its cause. A
mean of samples is as uncertain as the samples at most, and a 6σ six times as much.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import ContactFailure, FullModel
from mic.errors import MicError, Problems, SceneError
from mic.model.assembly import Assembly, PlacedScene, load_placed
from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.results.path_error import tighter
from mic.results.run_folder import versions
from mic.scene import Scene
from mic.system.files import replacing
from verification.study import Team
from verification.symmetry.numbers import KEYS, disagreement, full_numbers, numbers
from verification.symmetry.solution import pairs_of, solve
from verification.symmetry.transformation import Transformation, transformations

__all__ = ["Solved", "lines", "numerical_uncertainty", "sentences"]

REFUSALS = (MicError, ContactFailure, RuntimeError, ValueError, ArithmeticError)  # RuntimeError: those of PETSc, too
STANDS, TIGHTER, WHOLE = "as it stands", "on a tighter path", "by whole finite elements"
FIGURES = ["value", "uncertainty", "relative", "by", "by symmetry"]
Law = str


@dataclass(frozen=True)
class Solved:
    """Samples of a scene, and how they are solved.

    Attributes
    ----------
    scene : Scene
    stepped : Scene
        The same with one increment per step, as whole finite elements solve it.
    assembly : Assembly
        Of either.
    model : ReducedModel
    samples : (n, p) array
        Deviations.
    truth : str
        Law of the whole solve.
    cache : Path
    """

    scene: Scene
    stepped: Scene
    assembly: Assembly
    model: ReducedModel
    samples: np.ndarray
    truth: str
    cache: Path


def numerical_uncertainty(
    case: Solved, folder: Path, team: Team, say: Callable[[str], None]
) -> tuple[pd.DataFrame, list[str]]:
    """Solve the samples again in every way; results are stored in a folder, one file each, and reused.

    Returns
    -------
    table : DataFrame
        By law and :data:`verification.symmetry.numbers.KEYS`: ``value``, the largest of the samples; ``uncertainty``,
        the largest disagreement, in the same unit; ``relative`` to the largest number of its kind; ``by``, its cause;
        ``by symmetry``, without the tighter path and the whole solve; and the disagreement of each way.
    refused : list of str
        Ways that gave no result, each with the reason.
    """
    placed = _placed(case)
    ways: dict[str, Callable[[], dict[Law, pd.DataFrame]]] = {
        STANDS: lambda: solve(placed, case.samples, cache=case.cache).numbers,
        WHOLE: partial(_whole, case),
        TIGHTER: partial(_tighter, case),
    }
    for change in transformations(placed):
        ways[change.name] = partial(_transformed, placed, case, change)
    key = _key(case, placed)

    def stored(name: str) -> dict[Law, pd.DataFrame] | str:
        path = folder / f"{name.replace(' ', '-').replace(',', '')}-{key}.csv"
        if path.is_file():
            return _read(path)
        try:
            found = ways[name]()
        except REFUSALS as refusal:
            return f"{name}: {str(refusal).splitlines()[0]}"
        with replacing(path) as temporary:
            pd.concat(found, names=["law"]).to_csv(temporary)
        say(f"  solved again {name}")
        return found

    found = dict(zip(ways, team.map(stored, ways)))
    refused = [one for one in found.values() if isinstance(one, str)]
    given = found.pop(STANDS)
    if isinstance(given, str):
        return pd.DataFrame(columns=FIGURES), refused
    solutions = {name: one for name, one in found.items() if not isinstance(one, str)}
    return pd.concat({law: _largest(law, given[law], solutions) for law in given}, names=["law"]), refused


def _placed(case: Solved) -> PlacedScene:
    """The placed scene, with matrices of superelements in memory: read from files, they would not be transformed."""
    placed = load_placed(case.scene, case.cache, case.assembly.sizes, Problems())
    bodies = {part.name: part.superelement for part in case.assembly.parts}
    return replace(placed, loaded=tuple(replace(one, superelement=bodies[one.part.name]) for one in placed.loaded))


def _largest(law: Law, given: pd.DataFrame, solutions: dict[str, Any]) -> pd.DataFrame:
    """Rows of one law. The whole solve brings the numbers that it is compared with, in the same increments."""
    value = disagreement(given, given)["value"]
    differences, shares = {}, {}
    for name, by_law in solutions.items():
        if law in by_law:
            table = disagreement(by_law.get(f"{law}, reduced", given), by_law[law])
            differences[name], shares[name] = table["difference"], table["relative"]
    difference, share = (pd.DataFrame(each).reindex(given.index) for each in (differences, shares))
    columns = {
        "value": value,
        "uncertainty": difference.max(axis=1).fillna(0.0),
        "relative": share.max(axis=1).fillna(0.0),
        "by": difference.fillna(-1.0).idxmax(axis=1).where(difference.max(axis=1) > 0, ""),
        "by symmetry": difference.drop(columns=[TIGHTER, WHOLE], errors="ignore").max(axis=1).fillna(0.0),
    }
    return pd.DataFrame(columns).join(difference)


def _transformed(placed: PlacedScene, case: Solved, change: Transformation) -> dict[Law, pd.DataFrame]:
    return solve(placed, case.samples, change, pairs_of(case.model)).numbers


def _tighter(case: Solved) -> dict[Law, pd.DataFrame]:
    """Followed to a sixteenth of the tolerance, or in four times the increments, as every run tries some samples."""
    found = {}
    model = replace(case.model, scene=case.model.scene.model_copy(update=_path(case.scene)))
    for law in case.scene.report.laws:
        process = Process(model, law, backend=model.scene.monte_carlo.backend)
        for stage in process.stages:
            stage.path = tighter(stage.path)
        found[law] = numbers(model, process.attempt(case.samples))
    return found


def _path(scene: Scene) -> dict[str, Any]:
    return {"stages": scene.stages, "path": scene.path}


def _whole(case: Solved) -> dict[Law, pd.DataFrame]:
    """The first sample, on nominal meshes, with one increment per step; and the reduced model likewise."""
    if case.model.slopes is not None or case.scene.stiffness == "mean":
        raise SceneError("they have the nominal stiffness, and the scene has that of its deviated shapes")
    sample = case.samples[:1]
    model = replace(case.model, scene=case.model.scene.model_copy(update=_path(case.stepped)))
    full = FullModel(replace(case.assembly, scene=model.scene), comm=MPI.COMM_SELF).evaluate(sample[0], case.truth)
    reduced = numbers(model, model.process(case.truth).attempt(sample))
    return {case.truth: full_numbers(model, full), f"{case.truth}, reduced": reduced}


def _key(case: Solved, placed: PlacedScene) -> str:
    digest = hashlib.sha256(placed.scene.model_dump_json(exclude={"monte_carlo", "description"}).encode())
    for array in (case.samples, *case.model.compliance.H, case.model.contacts.gap, case.model.contacts.point):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(f"{case.truth} {versions()['mic-contact']}".encode())
    return digest.hexdigest()[:16]


def _read(path: Path) -> dict[Law, pd.DataFrame]:
    table = pd.read_csv(path, keep_default_na=False, dtype={"stage": str, "name": str}).set_index(["law", *KEYS])
    table = table.replace("", np.nan).astype(float)
    table.columns = table.columns.astype(int)
    return {str(law): rows.droplevel("law") for law, rows in table.groupby(level="law", sort=False)}


def lines(table: pd.DataFrame) -> pd.DataFrame:
    """The printed table: a row per number, with the pairs of a zone as one, their largest uncertainty.

    Returns
    -------
    DataFrame
        ``law, stage, number, value, uncertainty, unit, relative, by, by symmetry``.
    """
    rows = table[FIGURES].reset_index()
    of_pair = rows["quantity"].str.endswith("of a pair")
    rows.loc[of_pair, "name"] = rows.loc[of_pair, "name"].str.rsplit(" ", n=1).str[0]
    keys = ["law", "stage", "quantity", "name", "unit"]
    worst = rows.groupby(keys, sort=False)["uncertainty"].idxmax()
    value = rows.groupby(keys, sort=False)["value"].transform("max")
    rows = rows.assign(value=value).loc[worst].sort_index()
    rows["number"] = (rows["quantity"] + " " + rows["name"]).str.strip()
    return rows[["law", "stage", "number", "value", "uncertainty", "unit", *FIGURES[2:]]].reset_index(drop=True)


def sentences(table: pd.DataFrame, refused: Sequence[str], samples: int) -> list[str]:
    """The uncertainties in one sentence, then a line for each transformation without a result."""
    if not len(table):
        return ["Numerical uncertainty: not estimated.", *(f"Not solved {one}" for one in refused)]
    worst = table.loc[table.index.get_level_values("unit") != "1", "relative"].idxmax()
    _, quantity, stage, name, unit = worst
    where = f"{quantity} {name}".strip() + f" in {stage}" * bool(stage)
    return [
        f"Numerical uncertainty: largest disagreement of {samples} sample{'s' * (samples > 1)} solved again, "
        f"{table.loc[worst, 'relative']:.1g} of the largest number of its kind ({where}, "
        f"{table.loc[worst, 'uncertainty']:.2g} {unit}, {table.loc[worst, 'by']}).",
        *(f"Not solved {one}" for one in refused),
    ]
