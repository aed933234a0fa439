"""Effect of friction on the key characteristics, on the same samples with scaled coefficients.

The coefficients of all zones are scaled together by 0, 0.5 and 2, and those of each zone alone by 0.5 and 2. All
variants use the same samples, so that the differences are effects of friction alone.
"""

from __future__ import annotations

from contextlib import nullcontext, suppress
from dataclasses import replace

import numpy as np
import pandas as pd

from mic.errors import ArgumentError, SceneError
from mic.process.model import ReducedModel
from mic.results.schema import FRICTION_EFFECTS
from mic.scene.deviation import targets
from mic.statistics.draw import draw
from mic.statistics.estimates import six_sigma
from mic.statistics.paired_differences import mean_change, six_sigma_change
from mic.studies.samples import Progress, first_frictional, interval, key_characteristics
from mic.system.arguments import checked

__all__ = ["FACTORS", "HOLDS", "friction_effects", "friction_needed", "with_scaled_friction"]

SAMPLES = 60
FACTORS = (0.0, 0.5, 2.0)  #: factors on the coefficients of friction
HOLDS = 0.1  #: change relative to 6σ below which a result holds


@checked
def friction_effects(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> pd.DataFrame:
    """Changes of the key characteristics when friction is scaled.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law with friction; default: the first in the scene's report.
    samples, seed : int
    threads : int
    progress : callable or bool, optional
        Called with the number of evaluations after each variant; or whether a bar is shown.

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.FRICTION_EFFECTS` declares it. A factor 0 that leaves a part unconstrained has
        no rows.

    Raises
    ------
    ArgumentError
        If nothing is measured or nothing has friction.
    """
    scene, contacts = model.scene, model.contacts
    law = law or first_frictional(scene.report.laws)
    if not scene.measurements or contacts.dimension == 1 or not contacts.frictional:
        raise ArgumentError(f"scene {scene.name!r} has no {'friction' if scene.measurements else 'measurements'}")
    deviations = draw(scene, seed, 0, samples)
    evaluate = lambda variant, x: key_characteristics(variant.process(law, threads=threads), x, progress)
    base, frames = evaluate(model, deviations), []
    frictional = [z for z, zone in enumerate(scene.zones) if zone.frictional]
    variants = [("", np.arange(len(scene.zones)), factor) for factor in FACTORS]
    if len(frictional) > 1:
        variants += [(scene.zones[z].name, np.array([z]), factor) for z in frictional for factor in FACTORS if factor]
    for name, zones, factor in variants:
        with suppress(SceneError) if factor == 0 else nullcontext():  # without friction a part is unconstrained
            x = _scaled_deviations(scene, deviations, zones, factor)
            other = evaluate(with_scaled_friction(model, zones, factor), x)
            frames.append(_changes(scene, base, other).assign(law=law, zone=name, factor=factor))
    return pd.concat(frames, ignore_index=True)[FRICTION_EFFECTS.names]


def with_scaled_friction(model: ReducedModel, zones: np.ndarray, factor: float) -> ReducedModel:
    """A model with the friction of some zones, given by number, multiplied by a factor."""
    contacts = model.contacts
    selected = np.isin(contacts.zone, zones)
    friction = contacts.friction * np.where(selected, factor, 1.0)
    pressure = contacts.pressure.copy()
    pressure[selected, :, 1:4] *= factor  # α, β and γ of μ(p)
    return replace(model, contacts=replace(contacts, friction=friction, pressure=pressure))


def _scaled_deviations(scene, deviations: np.ndarray, zones: np.ndarray, factor: float) -> np.ndarray:
    """Deviations (n, p) with those of the zones' friction multiplied by the same factor."""
    x, names = deviations.copy(), {scene.zones[z].name for z in zones}
    for j, item in enumerate(scene.deviations):
        if item.kind == "friction" and {*targets(item)} <= names:
            x[:, j] *= factor
    return x


def _changes(scene, base: np.ndarray, other: np.ndarray) -> pd.DataFrame:
    """Changes of mean and 6σ by key characteristic, over the samples that are valid in both."""
    known = np.isfinite(base).all(axis=1) & np.isfinite(other).all(axis=1)
    rows = [
        {"measurement": item.name, "samples": int(known.sum()), "six_sigma": six_sigma(a).value}
        | interval("mean_change", mean_change(a, b))
        | interval("six_sigma_change", six_sigma_change(a, b))
        for item, a, b in zip(scene.measurements, base[known].T, other[known].T)
    ]
    return pd.DataFrame(rows)


def friction_needed(effects: pd.DataFrame) -> pd.DataFrame:
    """Range of friction within which mean and 6σ change by less than a tenth of 6σ.

    Changes between the factors of the study are interpolated linearly in the logarithm of the factor.

    Returns
    -------
    DataFrame
        ``law``, ``zone``, ``measurement``; ``change``, the larger of the changes of mean and 6σ at half and at twice
        the friction, relative to 6σ; ``low`` and ``high``, the factors that bound the range, 0.5 and 2 at most.
    """
    rows = []
    for keys, group in effects.groupby(["law", "zone", "measurement"], sort=False):
        change = group.set_index("factor")[["mean_change", "six_sigma_change"]].abs().max(axis=1)
        change = change / group["six_sigma"].iloc[0]
        low, high = (
            factor ** (min(1.0, HOLDS / change[factor]) if change[factor] > 0 else 1.0) for factor in (0.5, 2.0)
        )
        rows.append((*keys, float(change[[0.5, 2.0]].max()), low, high))
    return pd.DataFrame(rows, columns=["law", "zone", "measurement", "change", "low", "high"])
