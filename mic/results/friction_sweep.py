"""Effect of the choice of contact law as friction grows: a few samples of a run, solved again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from mic.contact.friction import Friction
from mic.contact.law_comparison import compare_laws
from mic.contact.path_forecast import PathForecast
from mic.process.process import contact_solver
from mic.results.run_samples import RunSamples

__all__ = ["SCALES", "SAMPLES", "study_friction"]

SAMPLES = 12  # evenly spread over the valid ones with stored contact pairs
SCALES = (0.1, 0.4, 0.7, 1.0, 1.5, 2.0)  # multiples of the scene's friction
THREADS = 2


def study_friction(outcome: RunSamples) -> pd.DataFrame | None:
    """Solve samples in the first stage that resolves contact, under every law, with all friction coefficients scaled.

    The stage is solved in one step, because laws are compared here, not paths. The displacements without contact forces
    follow from the stored solution of Coulomb's law, ``b = u - S f``.

    Returns
    -------
    DataFrame or None
        As :data:`mic.results.schema.FRICTION` declares it; None unless both Coulomb's and the associated law were
        requested, the scene has friction and there are valid samples.
    """
    contacts = outcome.model.contacts
    if not outcome.has_slip or not {"coulomb", "associated"} <= set(outcome.laws) or not contacts.frictional:
        return None
    numbers = outcome.with_pairs("coulomb")
    n = len(numbers)
    if not n or not outcome.stages:
        return None
    stage = outcome.stages[0]
    chosen = numbers[np.unique(np.linspace(0, n - 1, min(n, SAMPLES)).round().astype(int))]
    coefficient = contacts.friction_in(stage).coefficient
    prepared = next(other for other in outcome.model.process("coulomb").stages if other.plan.name == stage)
    rows = contacts.dimension * len(contacts)
    response = prepared.steps[-1].response
    step = replace(prepared.plan.steps[-1], limits=())  # limited forces are part of b
    S = response.S.first(rows)
    force, displacement = (
        np.stack(
            [outcome.contact("coulomb", stage, f"{quantity}_{axis}", chosen) for axis in ("n", "t1", "t2")], axis=2
        ).reshape(len(chosen), -1)
        for quantity in ("f", "u")
    )
    b = displacement - S.under(force)  # u = S f + b
    forecast = PathForecast.empty(len(contacts), contacts.dimension)
    forecast = replace(forecast, touching=(force[:, ::3] > 0).any(axis=0))

    def solver(S, coefficient, **settings):
        friction = Friction.of(coefficient, len(contacts))
        return contact_solver(contacts, S, response.diagonal[:rows], friction, step, forecast, **settings)

    return compare_laws(S, b, [scale * coefficient for scale in SCALES], threads=THREADS, solver=solver)
