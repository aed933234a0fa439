"""What it takes for a scene's 6σ to be right to a given share: which named setting, or what beyond the finest.

Settings are tried from the cheapest on, each on samples of the scene itself: it takes the setting's element size,
its path and candidates for contact, whatever it states of these, and what path, pairs and mesh leave is estimated as
for an error budget (:mod:`verification.budget`). A setting keeps a target where their sum and what is unsure of it
stay below, for every key characteristic and every zone's slip that varies by at least a tenth of the most variable of
its kind; it does not where one of these is sure to be above. Where the samples leave it open, more are taken, as many
as would decide it if what is unsure falls by their root (Stein's second stage), :data:`MOST` at most, and none where as
many would show nothing. What no setting changes (the law, the stiffness of the nominal shape) is not counted.
"""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import norm

from mic.errors import MicError, SceneError
from mic.results.run_folder import versions
from mic.scene import SETTINGS, Scene
from mic.scene.process import FollowedPath
from mic.statistics.draw import draw
from mic.statistics.estimates import LEVEL
from verification.budget import SAMPLES, Case, Item, estimate, total
from verification.comparison import reduced_and_assembly
from verification.study import Team

__all__ = ["Tried", "advice", "as_set", "choose", "enough", "leading", "share_of", "shares", "table"]

LEADING = 0.1  # of the 6σ of the most variable quantity of a kind: what varies less is not judged
MOST = 120  # samples that a setting is tried on
SOURCES = ("path", "pairs", "mesh and element")
ALL = "all"
#: By which power of its knob an error falls, at least: elements are of second order, sums over pairs of first where
#: pressure begins, and a sixteenth of a tolerance leaves a sixth of the error.
ORDERS = {"path": math.log(6) / math.log(16), "pairs": 1.0, "mesh and element": 2.0}
KNOBS = {
    "path": "a path followed to {:.2g} of its tolerance",
    "pairs": "candidates at {:.2g} of their distance (`spacing_factor`)",
    "mesh and element": "elements of {:.2g} of their size",
}


@dataclass(frozen=True)
class Tried:
    """A setting as it was found to be on a scene.

    Attributes
    ----------
    setting : str
    errors : DataFrame
        By source, and ``all`` for their sum: ``error`` and ``unsure``, shares of a 6σ, of the ``quantity`` for which
        both together are largest; ``least``, what the error of some quantity is at least; ``largest``, the largest
        error alone. NaN where a source could not be estimated.
    preparation, each : float
        CPU seconds from nothing to the reduced model, and for a sample.
    samples : int
        It was tried on.
    """

    setting: str
    errors: pd.DataFrame
    preparation: float
    each: float
    samples: int

    @property
    def most(self) -> float:
        """What the sum may be; NaN if a source is not known."""
        return float(self.errors[["error", "unsure"]].sum(axis=1, skipna=False)[ALL])

    def keeps(self, target: float) -> bool:
        """Whether all sources together stay below a target, as far as they are known."""
        return self.most <= target

    def further(self, target: float) -> int:
        """How many samples would decide whether it keeps a target; 0 where these do, or where not even :data:`MOST`
        would show it of an error of nothing."""
        row = self.errors.loc[ALL]
        if not np.isfinite(self.most) or self.most <= target or row["least"] > target or self.samples >= MOST:
            return 0
        if row["unsure"] * math.sqrt(self.samples / MOST) > target:
            return 0
        root = row["unsure"] / max(abs(target - row["error"]), 1e-9 * target)
        return int(min(MOST, max(2 * self.samples, math.ceil(self.samples * min(root, MOST) ** 2))))


def share_of(text: str) -> float:
    """The share that a word such as ``2%`` or ``0.02`` means.

    Raises
    ------
    ValueError
        If it is none, or not between 0 and a half.
    """
    try:
        value = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = math.nan
    if not 0 < value <= 0.5:
        raise ValueError(f"{text!r} is no share of a 6σ: give one such as 2% or 0.02, above 0 and at most 50%")
    return value


def as_set(scene: Scene, setting: str) -> Scene:
    """A scene as a setting has it, whatever it states of the knobs: sizes of parts with a geometry, pairs, path."""
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


def leading(six_sigma: pd.Series) -> pd.Index:
    """Quantities that vary by at least :data:`LEADING` of the most variable of their kind."""
    kind = six_sigma.index.str.partition(":").get_level_values(0)
    most = six_sigma.groupby(kind).transform("max")
    return six_sigma.index[(six_sigma > 0) & (six_sigma >= LEADING * most)]


def shares(items: list[Item], six_sigma: pd.Series) -> pd.DataFrame:
    """What each source and their sum leave of the leading quantities' 6σ, as :class:`Tried` has it."""
    names = leading(six_sigma)
    tables = {item.source: item.table for item in items}
    if any(table is None for table in tables.values()):
        tables[ALL] = None
    else:  # the sum of an error budget passes over what is not known; here nothing is known then
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
    """Try settings from the cheapest on, until one keeps the target.

    Parameters
    ----------
    scene : Scene
    target : float
        Share of a 6σ.
    folder : Path
        Keeps what was estimated, so that a second call takes up where the first was stopped.
    cache : Path
    team : Team
    say : callable
        Called on the first rank with one line of text at a time.

    Returns
    -------
    list of Tried
        The last keeps the target, if one does.

    Raises
    ------
    SceneError
        If nothing of the scene varies, or not even the first setting fits it.
    """
    found: list[Tried] = []
    for setting in SETTINGS:
        try:
            found.append(attempt(as_set(scene, setting), setting, target, folder, cache, team, say))
        except MicError as problem:  # a geometry without that named size, candidates that its elements have no room for
            if not found:
                raise
            if team.rank == 0:
                say(f"{setting}: not tried: {problem}")
            break
        if found[-1].keeps(target):
            break
    return found


def attempt(scene, setting, target, folder, cache, team, say) -> Tried:
    start = time.process_time()
    model, assembly = reduced_and_assembly(scene, cache)
    prepared = time.process_time() - start
    law, samples = scene.report.laws[0], SAMPLES
    model.process(law).attempt(draw(scene, scene.monte_carlo.seed, 0, 1))  # compiled before the clock goes on
    mark = hashlib.sha256(f"{scene.model_dump_json()} {assembly.scene.folder} {versions()}".encode()).hexdigest()[:16]
    while samples:
        case, start = Case(assembly, model, law, cache, samples=samples), time.process_time()
        six_sigma = 6 * case.production.std(ddof=1)
        each = (time.process_time() - start) / samples
        if not len(leading(six_sigma)):
            raise SceneError(
                f"scene {scene.name!r}: nothing varies that a target could be for; add [[deviations]] with a sigma, "
                "and [[measurements]] or contact zones with friction"
            )
        items = estimate(case, folder, mark, team, SOURCES, say)
        # From the first, since times differ from rank to rank.
        tried = team.from_first(Tried(setting, shares(items, six_sigma), prepared, each, samples))
        samples = tried.further(target)
        if team.rank == 0:
            more = f", not decided; {samples} samples next" if samples else ""
            say(f"{setting}: 6σ to {tried.most:.2g} by {tried.samples} samples{more}")
    return tried


def enough(target: float) -> int:
    """Number of normal samples that know a 6σ to a share: half the interval."""
    return math.ceil((norm.ppf((1 + LEVEL) / 2) / target) ** 2 / 2) + 1


def advice(found: list[Tried], target: float) -> str:
    """What to do, in sentences."""
    last, samples = found[-1], enough(target)
    seconds = last.preparation + samples * last.each
    cost = f"{samples} samples know a 6σ to {target:.2g} as well; they take {seconds:.0f} CPU s by this setting."
    if last.keeps(target):
        row = last.errors.loc[ALL]
        given = f'setting = "{last.setting}", with element sizes, pairs and path left open, is enough'
        return (
            f"6σ to {target:.2g}: {given}: path, pairs and mesh leave {row['error']:.2g} ± {row['unsure']:.2g} of it "
            f"({row['quantity']}). {cost}"
        )
    unknown = [
        source for source in SOURCES if not np.isfinite(last.errors.loc[source, ["error", "unsure"]].sum(skipna=False))
    ]
    if unknown:
        return f"6σ to {target:.2g}: not known, since {', '.join(unknown)} could not be estimated at {last.setting}."
    row, part = last.errors.loc[ALL], target / len(SOURCES)
    told = (
        f"6σ to {target:.2g}: not by a setting. By {last.setting} path, pairs and mesh leave {row['error']:.2g} ± "
        f"{row['unsure']:.2g} of it ({row['quantity']}), as {last.samples} samples tell;"
    )
    left = last.errors.loc[list(SOURCES), "largest"]
    wanted = [
        KNOBS[source].format((part / left[source]) ** (1 / ORDERS[source])) for source in SOURCES if left[source] > part
    ]
    if wanted:
        return f"{told} it would take about {', '.join(wanted)}. {cost}"
    more = math.ceil(last.samples * (row["unsure"] / (target - row["error"])) ** 2)
    return f"{told} it may keep it, but some {more} samples would have to tell. {cost}"


def table(found: list[Tried]) -> pd.DataFrame:
    """One row for each setting and source."""
    return pd.concat(
        [
            one.errors.rename_axis("source")
            .reset_index()
            .assign(
                setting=one.setting,
                samples=one.samples,
                **{"preparation, CPU s": one.preparation, "sample, CPU s": one.each},
            )
            for one in found
        ],
        ignore_index=True,
    )
