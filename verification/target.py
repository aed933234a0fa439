"""Find the cheapest named setting for which the error of 6σ of a scene is below a target.

Settings are tried from the cheapest to the most expensive on samples of the scene, with the setting's element size,
path and contact candidates. The errors of path, pairs and mesh are estimated as in an error budget
(:mod:`verification.budget`). A setting meets the target if the sum of errors plus its uncertainty is below it for every
leading quantity, and fails if the error minus its uncertainty exceeds it for one. Leading quantities are key
characteristics and zone slips whose 6σ is at least a tenth of the largest of their kind. If the samples do not decide,
more are drawn: as many as would decide if the uncertainty falls with their square root (Stein's second stage), at most
:data:`MOST`, and none if even those could not decide. Errors that do not depend on the setting (the law, the nominal
stiffness) are not counted. The number of samples is that of the cheaper estimator of the scene, samples alone or few
followed ones with surrogates (:mod:`verification.sampling_cost`).
"""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from mic.errors import MicError, SceneError
from mic.results.run_folder import versions
from mic.scene import SETTINGS, Scene
from mic.scene.process import FollowedPath
from mic.statistics.draw import draw
from verification.budget import SAMPLES, Case, Item, estimate, total
from verification.comparison import reduced_and_assembly
from verification.sampling_cost import SamplingCost, leading, measure_sampling
from verification.study import Team

__all__ = ["Tried", "advice", "as_set", "choose", "share_of", "shares", "table"]

MOST = 120  # largest number of samples per setting
SOURCES = ("path", "pairs", "mesh and element")
ALL = "all"
#: Lower bound of the order of convergence of each error in its parameter: second for elements, first for pairs at the
#: edge of the pressed area; a path tolerance of 1/16 reduces the error to 1/6.
ORDERS = {"path": math.log(6) / math.log(16), "pairs": 1.0, "mesh and element": 2.0}
REFINEMENTS = {
    "path": "{:.2g} times the path tolerance",
    "pairs": "{:.2g} times the distance of candidates (`spacing_factor`)",
    "mesh and element": "{:.2g} times the element size",
}


@dataclass(frozen=True)
class Tried:
    """Result of a setting on a scene.

    Attributes
    ----------
    setting : str
    errors : DataFrame
        By source, and ``all`` for their sum: ``error`` and uncertainty ``unsure``, relative to 6σ, of the ``quantity``
        for which their sum is largest; ``least``, the largest lower bound of an error; ``largest``, the largest error.
        NaN if a source could not be estimated.
    preparation, each : float
        CPU seconds for the reduced model without cache, and per sample.
    samples : int
        Number of samples.
    sampling : SamplingCost
        Accuracy and cost of samples with surrogates.
    """

    setting: str
    errors: pd.DataFrame
    preparation: float
    each: float
    samples: int
    sampling: SamplingCost = SamplingCost()

    @property
    def most(self) -> float:
        """Largest possible total error; NaN if a source is unknown."""
        return float(self.errors[["error", "unsure"]].sum(axis=1, skipna=False)[ALL])

    def meets(self, target: float) -> bool:
        """Whether the largest possible total error is at most the target."""
        return self.most <= target

    def further(self, target: float) -> int:
        """Number of samples that would decide whether the target is met; 0 if these do, or if :data:`MOST` cannot."""
        row = self.errors.loc[ALL]
        if not np.isfinite(self.most) or self.most <= target or row["least"] > target or self.samples >= MOST:
            return 0
        if row["unsure"] * math.sqrt(self.samples / MOST) > target:
            return 0
        root = row["unsure"] / max(abs(target - row["error"]), 1e-9 * target)
        return int(min(MOST, max(2 * self.samples, math.ceil(self.samples * min(root, MOST) ** 2))))


def share_of(text: str) -> float:
    """Relative error given as text such as ``2%`` or ``0.02``.

    Raises
    ------
    ValueError
        If the text is no number, or not between 0 and 0.5.
    """
    try:
        value = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = math.nan
    if not 0 < value <= 0.5:
        raise ValueError(f"{text!r} is no relative error of 6σ: give one such as 2% or 0.02, above 0 and at most 50%")
    return value


def as_set(scene: Scene, setting: str) -> Scene:
    """The scene with element sizes (of parts with a geometry), candidates and path of a setting."""
    gives = SETTINGS[setting]
    parts = [
        part.model_copy(update={"size": gives["size"]}) if part.geometry is not None and part.accuracy is None else part
        for part in scene.parts
    ]
    contacts = dict.fromkeys(("pairs", "spacing", "points")) | {"spacing_factor": gives["spacing_factor"]}
    zones = [zone.model_copy(update=contacts) for zone in scene.zones]
    stages = [stage.model_copy(update={"path": None, "increments": None}) for stage in scene.stages]
    path = FollowedPath(tolerance=gives["tolerance"])
    return scene.model_copy(update={"parts": parts, "zones": zones, "stages": stages, "path": path, "setting": setting})


def shares(items: list[Item], six_sigma: pd.Series) -> pd.DataFrame:
    """Errors of each source and their sum relative to the leading quantities' 6σ, as in :class:`Tried`."""
    names = leading(six_sigma)
    tables = {item.source: item.table for item in items}
    if any(table is None for table in tables.values()):
        tables[ALL] = None
    else:  # unlike in an error budget, an unknown error makes the sum unknown
        unknown = [table.loc[names].isna() for table in tables.values()]
        tables[ALL] = total(items).loc[names].mask(np.logical_or.reduce(unknown))
    rows = {}
    for source, table in tables.items():
        if table is None:
            rows[source] = {"error": np.nan, "unsure": np.nan, "quantity": "", "least": np.nan, "largest": np.nan}
            continue
        own = table.loc[names, ["six_sigma", "six_sigma_half"]].abs().div(six_sigma[names], axis=0)
        worst = own.sum(axis=1, skipna=False).fillna(np.inf).idxmax()
        rows[source] = {
            "error": own.at[worst, "six_sigma"],
            "unsure": own.at[worst, "six_sigma_half"],
            "quantity": worst,
            "least": (own["six_sigma"] - own["six_sigma_half"]).max(),
            "largest": own["six_sigma"].max(),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def choose(scene: Scene, target: float, folder: Path, cache: Path, team: Team, say=print) -> list[Tried]:
    """Try settings from the cheapest to the most expensive until one meets the target.

    Parameters
    ----------
    scene : Scene
    target : float
        Largest error relative to 6σ.
    folder : Path
        Stores the estimates, so that an interrupted run can be resumed.
    cache : Path
    team : Team
    say : callable
        Called on the first rank with one line of text at a time.

    Returns
    -------
    list of Tried
        The last one meets the target, if any does.

    Raises
    ------
    SceneError
        If no quantity of the scene varies, or the first setting cannot be applied to it.
    """
    tried: list[Tried] = []
    for setting in SETTINGS:
        try:
            tried.append(attempt(as_set(scene, setting), setting, target, folder, cache, team, say))
        except MicError as problem:  # no such named size of a geometry, or candidates too close for the elements
            if not tried:
                raise
            if team.rank == 0:
                say(f"{setting}: not tried: {problem}")
            break
        if tried[-1].meets(target):
            break
    return tried


def attempt(scene, setting, target, folder, cache, team, say) -> Tried:
    start = time.process_time()
    model, assembly = reduced_and_assembly(scene, cache)
    prepared = time.process_time() - start
    law, samples = scene.report.laws[0], SAMPLES
    model.process(law).attempt(draw(scene, scene.monte_carlo.seed, 0, 1))  # compiles code before time is measured
    mark = hashlib.sha256(f"{scene.model_dump_json()} {assembly.scene.folder} {versions()}".encode()).hexdigest()[:16]
    sampling = measure_sampling(model, law, scene.monte_carlo.seed)
    while samples:
        case, start = Case(assembly, model, law, cache, samples=samples), time.process_time()
        six_sigma = 6 * case.production.std(ddof=1)
        each = (time.process_time() - start) / samples
        if not len(leading(six_sigma)):
            raise SceneError(
                f"scene {scene.name!r}: no quantity varies; add [[deviations]] with a sigma, and [[measurements]] or "
                "contact zones with friction"
            )
        items = estimate(case, folder, mark, team, SOURCES, say)
        # from the first rank, because times differ between ranks
        tried = team.from_first(Tried(setting, shares(items, six_sigma), prepared, each, samples, sampling))
        samples = tried.further(target)
        if team.rank == 0:
            more = f", not decided; {samples} samples next" if samples else ""
            say(f"{setting}: error of 6σ at most {tried.most:.2g} by {tried.samples} samples{more}")
    return tried


def advice(tried: list[Tried], target: float) -> str:
    """Recommendation as text."""
    last = tried[-1]
    seconds, _, samples = last.sampling.cheapest(target, last.each)
    cost = (
        f"{samples[0].upper()}{samples[1:]} have a sampling error of {target:.2g}; they take "
        f"{last.preparation + seconds:.0f} CPU s with this setting."
    )
    if last.meets(target):
        row = last.errors.loc[ALL]
        return (
            f'6σ to {target:.2g}: setting = "{last.setting}" is enough, without element sizes, pairs and path in the '
            f"scene. Error of path, pairs and mesh: {row['error']:.2g} ± {row['unsure']:.2g} of 6σ "
            f"({row['quantity']}). {cost}"
        )
    unknown = [
        source for source in SOURCES if not np.isfinite(last.errors.loc[source, ["error", "unsure"]].sum(skipna=False))
    ]
    if unknown:
        return f"6σ to {target:.2g}: not known, {', '.join(unknown)} could not be estimated at setting {last.setting}."
    row, part = last.errors.loc[ALL], target / len(SOURCES)
    result = (
        f"6σ to {target:.2g}: no setting is shown to be enough. With {last.setting} the error of path, pairs and mesh "
        f"is {row['error']:.2g} ± {row['unsure']:.2g} of 6σ ({row['quantity']}) by {last.samples} samples;"
    )
    error = last.errors.loc[list(SOURCES), "largest"]
    wanted = [
        REFINEMENTS[source].format((part / error[source]) ** (1 / ORDERS[source]))
        for source in SOURCES
        if error[source] > part
    ]
    if wanted:
        return f"{result} it needs about {', '.join(wanted)}. {cost}"
    more = math.ceil(last.samples * (row["unsure"] / (target - row["error"])) ** 2)
    return f"{result} about {more} samples would decide. {cost}"


def table(tried: list[Tried]) -> pd.DataFrame:
    """One row for each setting and source."""
    return pd.concat(
        [
            result.errors.rename_axis("source")
            .reset_index()
            .assign(
                setting=result.setting,
                samples=result.samples,
                **{"preparation, CPU s": result.preparation, "sample, CPU s": result.each},
            )
            for result in tried
        ],
        ignore_index=True,
    )
