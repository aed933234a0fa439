"""Effect of friction on the key characteristics, on the same samples with scaled coefficients.

The coefficients of all zones are scaled together by 0, 0.5 and 2, and those of each zone alone by 0.5 and 2. All
variants use the same samples, so that the differences are effects of friction alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.schema import FRICTION_EFFECTS
from mic.statistics.draw import draw
from mic.statistics.estimates import six_sigma
from mic.statistics.paired_differences import mean_change, six_sigma_change

__all__ = ["FACTORS", "HOLDS", "friction_effects", "friction_needed", "scaled"]

SAMPLES = 60
FACTORS = (0.0, 0.5, 2.0)  #: factors on the coefficients of friction
HOLDS = 0.1  #: change relative to 6σ below which a result holds


def friction_effects(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> pd.DataFrame:
    """Changes of the key characteristics when friction is scaled.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law with friction; default: the first in the scene's report.
    samples, seed : int
    threads : int
    progress : callable, optional
        Called with the number of evaluations after each variant.

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.FRICTION_EFFECTS` declares it. A factor 0 that leaves a part unconstrained has
        no rows.

    Raises
    ------
    ValueError
        If nothing is measured or nothing has friction.
    """
    scene, contacts = model.scene, model.contacts
    law = law or next((name for name in scene.report.laws if LAWS[name].frictional), scene.report.laws[0])
    if not scene.measurements or contacts.dimension == 1 or not contacts.frictional:
        raise ValueError(f"scene {scene.name!r} has no {'friction' if scene.measurements else 'measurements'}")
    deviations = draw(scene, seed, 0, samples)

    def measured(own: ReducedModel, drawn: np.ndarray) -> np.ndarray:
        found = own.process(law, threads=threads).attempt(drawn)
        progress(samples)
        return np.where(found.failed[:, None], np.nan, found.measurements)

    base, frames = measured(model, deviations), []
    rubbing = [z for z, zone in enumerate(scene.zones) if zone.frictional]
    every = np.arange(len(scene.zones))
    variants = [("", every, factor) for factor in FACTORS]
    variants += [(scene.zones[z].name, np.array([z]), f) for z in rubbing for f in FACTORS if len(rubbing) > 1 and f]
    for name, zones, factor in variants:
        try:
            other = measured(scaled(model, zones, factor), _scaled_deviations(scene, deviations, zones, factor))
        except SceneError:  # without friction a part is unconstrained
            if factor > 0:
                raise
            continue
        frames.append(_changes(scene, base, other).assign(law=law, zone=name, factor=factor))
    return pd.concat(frames, ignore_index=True)[FRICTION_EFFECTS.names]


def scaled(model: ReducedModel, zones: np.ndarray, factor: float) -> ReducedModel:
    """A model with the friction of some zones, given by number, multiplied by a factor."""
    contacts = model.contacts
    own = np.isin(contacts.zone, zones)
    by = np.where(own, factor, 1.0)
    pressure = contacts.pressure.copy()
    pressure[own, :, 1:4] *= factor  # α, β and γ of μ(p)
    return replace(model, contacts=replace(contacts, friction=contacts.friction * by, pressure=pressure))


def _scaled_deviations(scene, deviations: np.ndarray, zones: np.ndarray, factor: float) -> np.ndarray:
    """Deviations (n, p) with those of the zones' friction multiplied by the same factor."""
    found, names = deviations.copy(), {scene.zones[z].name for z in zones}
    for j, item in enumerate(scene.deviations):
        if item.kind == "friction" and {*([item.target] if isinstance(item.target, str) else item.target)} <= names:
            found[:, j] *= factor
    return found


def _changes(scene, base: np.ndarray, other: np.ndarray) -> pd.DataFrame:
    known = np.isfinite(base).all(axis=1) & np.isfinite(other).all(axis=1)
    rows = []
    for item, a, b in zip(scene.measurements, base[known].T, other[known].T):
        mean, spread = mean_change(a, b), six_sigma_change(a, b)
        rows.append(
            {
                "measurement": item.name,
                "samples": int(known.sum()),
                "mean_change": mean.value,
                "mean_change_low": mean.low,
                "mean_change_high": mean.high,
                "six_sigma_change": spread.value,
                "six_sigma_change_low": spread.low,
                "six_sigma_change_high": spread.high,
                "six_sigma": six_sigma(a).value,
            }
        )
    return pd.DataFrame(rows)


def friction_needed(effects: pd.DataFrame) -> pd.DataFrame:
    """Range of friction within which mean and 6σ change by less than a tenth of 6σ.

    Changes between the factors of the study are interpolated linearly in the logarithm of the factor.

    Returns
    -------
    DataFrame
        ``law``, ``zone``, ``measurement``; ``change``, the larger of the changes of mean and 6σ at half and at twice
        the friction, as a share of 6σ; ``low`` and ``high``, the factors within which the answer holds: 0.5 and 2 where
        it holds in all of that, at least.
    """
    rows = []
    for (law, zone, measurement), own in effects.groupby(["law", "zone", "measurement"], sort=False):
        share = own.set_index("factor")[["mean_change", "six_sigma_change"]].abs().max(axis=1)
        share = share / own["six_sigma"].iloc[0]
        ends = {}
        for factor in (0.5, 2.0):
            reach = min(1.0, HOLDS / share[factor]) if share[factor] > 0 else 1.0
            ends[factor] = factor**reach
        rows.append((law, zone, measurement, float(share[[0.5, 2.0]].max()), ends[0.5], ends[2.0]))
    return pd.DataFrame(rows, columns=["law", "zone", "measurement", "change", "low", "high"])
