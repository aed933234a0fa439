"""Choice of element sizes, contact candidates and load path for a scene with ``setting = "auto"``.

The error of the load path and that of meshes and contact candidates are independent and add in quadrature: each may be
1/√2 of the required accuracy of 6σ. Each candidate is compared, the cheapest first, with a finer one on the same
samples: a path with one of a quarter of the smallest tolerance, meshes and contact candidates with the next finer ones.
Sampling scatter cancels in these differences, so that few samples suffice. Mean and 6σ of key characteristics and of
the zones' tangential displacement count, if their 6σ is at least a tenth of the largest of their kind, relative to that
6σ, or to the mean of a zone if that is larger. A candidate is accepted if the difference and its 95 % uncertainty
together are within that share; if the difference alone is, more samples are drawn.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.path import Followed
from mic.errors import SceneError
from mic.process.evaluation import Evaluation
from mic.process.feasible_assembly import assemble_feasible
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.results.sample_tables import zone_motion
from mic.scene import Scene
from mic.scene.settings import SETTINGS, TARGET, with_values
from mic.statistics.draw import draw
from mic.statistics.paired_differences import mean_change, six_sigma_change
from mic.system.cores import available_cores

__all__ = ["Choice", "Trial", "choose", "leading", "quantities"]

SAMPLES, MOST = 24, 96  # first and largest number of samples of a comparison
ZONE = "tangential displacement"
LEADING = 0.1  # quantities with a 6σ below this fraction of the largest of their kind are ignored
PATHS: tuple[dict[str, Any], ...] = (
    {"increments": 1},
    {"tolerance": 40 * Followed.tolerance},
    *({"tolerance": setting["tolerance"]} for setting in SETTINGS.values()),
)
JUDGE = {"tolerance": Followed.tolerance / 4}


@dataclass(frozen=True)
class Trial:
    """A candidate compared with a finer one.

    Attributes
    ----------
    name, judge : str
        The candidate and what it is compared with.
    error, half : float
        Largest relative change of a mean or 6σ, and the half-width of its 95 % interval, of the `quantity` for which
        their sum is largest.
    quantity : str
    samples : int
    seconds : float
        Processor time of a sample.
    share : float
        The largest accepted sum of error and half-width.
    """

    name: str
    judge: str
    error: float
    half: float
    quantity: str
    samples: int
    seconds: float
    share: float

    @property
    def accepted(self) -> bool:
        """Whether the error is within its share, uncertainty included."""
        return self.error + self.half <= self.share

    def sentence(self) -> str:
        """The comparison as text."""
        verdict = "accepted" if self.accepted else "not accepted"
        return (
            f"{self.name}: {self.error:.2%} ± {self.half:.2%} off {self.judge} ({self.quantity}, {self.samples} "
            f"samples, {1e3 * self.seconds:.3g} ms each); {verdict}"
        )


@dataclass(frozen=True)
class Choice:
    """The scene with chosen values in place of what it left open, and how they were found.

    Attributes
    ----------
    scene : Scene
    target : float
        Required accuracy of 6σ.
    trials : tuple of Trial
    chosen : tuple of str
        The chosen path, and the chosen meshes and candidates, each with its measured error.
    """

    scene: Scene
    target: float
    trials: tuple[Trial, ...]
    chosen: tuple[str, ...]

    def sentence(self) -> str:
        """The choice as text."""
        return f"auto: chosen for 6σ to {self.target:.3g}: {'; '.join(self.chosen) or 'the scene leaves nothing open'}"

    def record(self) -> dict[str, Any]:
        """The choice, JSON-ready."""
        trials = [vars(trial) | {"accepted": trial.accepted} for trial in self.trials]
        return {"target": self.target, "chosen": list(self.chosen), "trials": trials}


def choose(scene: Scene, cache: Path, report: Callable[[str], None] | None = None) -> Choice:
    """Choose what a scene leaves open, from a few samples.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Cache folder of meshes and influence coefficients.
    report : callable, optional
        Called with a line of text for each comparison, and for the choice.

    Raises
    ------
    SceneError
        If the scene cannot be built with the coarsest values.
    MissingProvider
    """
    found: list[Trial] = []

    def compare(own: _Samples, finer: _Samples) -> Trial:
        found.append(_compare(own, finer, target / sqrt(2.0)))
        if report is not None:
            report(f"auto: {found[-1].sentence()}")
        return found[-1]

    required, law = scene.monte_carlo.accuracy, _law(scene)
    target = (required and required.six_sigma) or TARGET
    levels = _levels(scene)
    model = _built(with_values(scene, levels[0]), cache)
    path, chosen = _path(model, law, compare) if "path" in scene.left_open else ({}, [])
    own = _Samples(_named(levels[0]), _with(model, path), law)
    level = levels[0]
    for finer in levels[1:]:
        try:
            next_one = _Samples(_named(finer), _built(with_values(scene, finer | path), cache), law)
        except SceneError as problem:
            chosen.append(f"{_named(level)}, whose error is not measured ({problem})")
            break
        trial = compare(own, next_one)
        if trial.accepted:
            chosen.append(f"{_named(level)}, {trial.error:.2%} ± {trial.half:.2%} off the next finer ones")
            break
        own, level = next_one, finer
    else:
        if len(levels) > 1:
            chosen.append(f"{_named(level)}, the finest")
    result = Choice(with_values(scene, level | path), target, tuple(found), tuple(chosen))
    if report is not None:
        report(result.sentence())
    return result


def _path(model: ReducedModel, law: str | None, compare: Callable) -> tuple[dict[str, Any], list[str]]:
    """Values of the cheapest accepted path, else of the tightest, and the choice as text."""
    if law is None or not model.contacts.frictional:
        return {}, []
    judge = _Samples(_named(JUDGE), _with(model, JUDGE), law)
    for path in PATHS:
        trial = compare(_Samples(_named(path), _with(model, path), law), judge)
        if trial.accepted:
            break
    return path, [f"{trial.name}, {trial.error:.2%} ± {trial.half:.2%} off {trial.judge}"]


def _levels(scene: Scene) -> list[dict[str, Any]]:
    """Element sizes and spacings of candidates from coarse to fine, as far as the scene leaves them open."""
    kinds = {name.partition(".")[0] for name in scene.left_open}
    keys = [key for key, kind in (("size", "parts"), ("spacing_factor", "zones")) if kind in kinds]
    levels: list[dict[str, Any]] = []
    for setting in SETTINGS.values():
        level = {key: setting[key] for key in keys}
        if level not in levels:
            levels.append(level)
    return levels


def _named(values: dict[str, Any]) -> str:
    """Values as text."""
    words = {
        "size": lambda value: f'size "{value}"',
        "spacing_factor": lambda value: f"spacing_factor {value:g}",
        "tolerance": lambda value: f"path tolerance {value:.2g}",
        "increments": lambda value: "one increment per step",
    }
    return ", ".join(words[key](value) for key, value in values.items()) or "meshes and candidates of the scene"


def _law(scene: Scene) -> str | None:
    """The first law with friction, else None."""
    return next((law for law in scene.report.laws if LAWS[law].frictional), None)


def _built(scene: Scene, cache: Path) -> ReducedModel:
    assembly = assemble_feasible(scene, cache)
    return ReducedModel.build(assembly, coefficients(assembly, cache)[0])


def _with(model: ReducedModel, path: dict[str, Any]) -> ReducedModel:
    """The model with another load path where its scene leaves it open."""
    return replace(model, scene=with_values(model.scene, path)) if path else model


class _Samples:
    """Results of the first samples of a model, computed as they are needed.

    Parameters
    ----------
    name : str
    model : ReducedModel
    law : str or None
        Default: the first of the scene's report.
    """

    def __init__(self, name: str, model: ReducedModel, law: str | None) -> None:
        self.name, self._model, self.seconds = name, model, np.nan
        self._process = model.process(law, threads=available_cores())
        self._values = pd.DataFrame()

    def first(self, count: int) -> pd.DataFrame:
        """A row for each sample, a column for each quantity, mm; NaN in failed samples."""
        start, done = time.process_time(), len(self._values)
        if count > done:
            scene = self._model.scene
            evaluation = self._process.attempt(draw(scene, scene.monte_carlo.seed, 0, count)[done:])
            new = quantities(self._model, evaluation)
            self._values = pd.concat([self._values, new], ignore_index=True)
            self.seconds = (time.process_time() - start) / (count - done)
        return self._values[:count]


def quantities(model: ReducedModel, evaluation: Evaluation) -> pd.DataFrame:
    """Key characteristics and tangential displacements of zones, columns ("kind", name), mm; NaN in failed samples."""
    scene, contacts, columns = model.scene, model.contacts, {}
    for k, item in enumerate(scene.measurements[: evaluation.measurements.shape[1]]):
        columns["measurement", item.name] = evaluation.measurements[:, k]
    if contacts.dimension == 3:
        for stage, resolution in evaluation.resolutions.items():
            for z, zone in enumerate(scene.zones):
                moved = zone_motion(resolution, contacts, contacts.zone == z, False)["rms_tangential"]
                columns[ZONE, f"{zone.name} in {stage}"] = moved
    frame = pd.DataFrame(columns, index=range(len(evaluation.failed)))
    frame[evaluation.failed] = np.nan
    return frame


def leading(six_sigma: pd.Series, kind: pd.Index) -> pd.Index:
    """Quantities whose 6σ is at least :data:`LEADING` times the largest of their kind."""
    most = six_sigma.groupby(kind).transform("max")
    return six_sigma.index[(six_sigma > 0) & (six_sigma >= LEADING * most)]


def _compare(own: _Samples, finer: _Samples, share: float) -> Trial:
    """Compare a candidate with a finer one on more and more samples, until they decide."""
    count = SAMPLES
    while True:
        trial = _trial(own, finer, count, share)
        if trial.accepted or trial.error > share or count >= MOST:
            return trial
        count *= 2


def _trial(own: _Samples, finer: _Samples, count: int, share: float) -> Trial:
    a, b = own.first(count), finer.first(count)
    valid = a.notna().all(axis=1) & b.notna().all(axis=1)
    a, b = a[valid], b[valid]
    six_sigma = 6 * b.std(ddof=1)
    worst = (0.0, 0.0, "no quantity varies") if valid.any() else (np.inf, 0.0, "all samples failed")
    for kind, name in leading(six_sigma, six_sigma.index.get_level_values(0)):
        for words, change in (("mean", mean_change), ("6σ", six_sigma_change)):
            found, scale = change(b[kind, name], a[kind, name]), six_sigma[kind, name]
            if kind == ZONE and change is mean_change:  # has an origin, unlike a key characteristic
                scale = max(scale, b[kind, name].mean())
            error, half = float(abs(found.value) / scale), float((found.high - found.low) / 2 / scale)
            if not error + half <= worst[0] + worst[1]:
                worst = (error, half, f"{words} of {kind} {name}")
    return Trial(own.name, finer.name, *worst, int(valid.sum()), own.seconds, share)
