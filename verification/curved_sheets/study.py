"""Curved sheets under loads that bend them and need not stretch them, on meshes askew to their generators."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from verification.curved_sheets import sheets
from verification.study import Acceptance, Finding, Study
from verification.validation import Uncertainty

KINDS = {
    "flat": ("dkt-opt", "mesh"),
    "exact normals": ("dkt-opt-curved", "exact"),
    "estimated normals": ("dkt-opt-curved", "mesh"),
}
SEEDS, QUICK_SEEDS = (11, 12, 13), (11,)


def off(ratio):
    """Relative error of a case that gives the ratio of its deflection to the reference."""
    return lambda *arguments: ratio(*arguments) - 1


GRADE = "MacNeal and Harder's best grade is 2 %"
POISSON = 0.3  # of the panel


def corner_exponent() -> float:
    """λ of the displacement ``r^λ`` in a right-angled corner between a clamped and a free edge of a sheet in its plane.

    The smallest root of ``sin²(λ π/2) = (κ + 1)²/(4 κ) − λ²/κ``, ``κ = (3 − ν)/(1 + ν)``, between 0 and 1.

    References
    ----------
    Williams (1952), Stress singularities resulting from various boundary conditions in angular corners of plates in
    extension, Journal of Applied Mechanics 19, 526-528.
    """
    κ = (3 - POISSON) / (1 + POISSON)
    return float(brentq(lambda λ: np.sin(λ * np.pi / 2) ** 2 - (κ + 1) ** 2 / (4 * κ) + λ**2 / κ, 0.1, 1.0))


#: Order of a compliance on uniform meshes, by the energy of the error in such corners.
ORDER = 2 * corner_exponent()
COARSEST, SHEAR = 0.1, 0.003  # error on cells of 10 mm, and of transverse shear, which only the reference has


def panel_limit(size: float) -> float:
    """Limit of the panel's error on cells of a size, mm."""
    return round(COARSEST * (size / 10) ** ORDER + SHEAR, 4)


OF_CORNERS = (
    f"The tenth at 10 mm, falling with the order {ORDER:.2f} = 2 λ that the corners between the clamped and the free "
    "edges allow (Williams 1952), and 0.3 % of transverse shear, which only the reference has."
)
#: Reason of each limit; cases that are not listed have half of the best grade, on their authors' own meshes.
REASONS = {
    "cylinder 1.2 t": f"{GRADE}.",
    "cylinder 5 t": f"{GRADE}.",
    "cylinder 12 t": f"{GRADE}.",
    "panel 10 mm": "MacNeal and Harder's second grade, for the coarsest useful mesh.",
    "panel 5 mm": OF_CORNERS,
    "panel 2.5 mm": OF_CORNERS,
}

#: (name, what it is, error as a function of element, normals and seed, its limit or None where it is only shown)
CASES = (
    ("hemisphere", "pinched hemisphere, 16 × 16", off(sheets.hemisphere), 0.01),
    ("cylinder 1.2 t", "quarter cylinder, rise h²/8R = 1.2 t", off(partial(sheets.cylinder, rise=1.2)), 0.02),
    ("cylinder 5 t", "quarter cylinder, rise 5 t", off(partial(sheets.cylinder, rise=5.0)), 0.02),
    ("cylinder 12 t", "quarter cylinder, rise 12 t", off(partial(sheets.cylinder, rise=12.0)), 0.02),
    ("beam across", "twisted beam 24 × 4, t = 0.0032, across", off(partial(sheets.twisted_beam, direction=1)), 0.01),
    (
        "beam in plane",
        "twisted beam 24 × 4, t = 0.0032, in plane",
        off(partial(sheets.twisted_beam, direction=2)),
        0.01,
    ),
    ("panel 10 mm", "panel with a hole, 10 mm, regular", partial(sheets.panel_error, h=10.0, jitter=0.0), 0.10),
    (
        "panel 5 mm",
        "panel with a hole, 5 mm, regular",
        partial(sheets.panel_error, h=5.0, jitter=0.0),
        panel_limit(5.0),
    ),
    (
        "panel 2.5 mm",
        "panel with a hole, 2.5 mm, regular",
        partial(sheets.panel_error, h=2.5, jitter=0.0),
        panel_limit(2.5),
    ),
    ("askew 10 mm", "panel with a hole, 10 mm, jittered", partial(sheets.panel_error, h=10.0), None),
    ("askew 5 mm", "panel with a hole, 5 mm, jittered", partial(sheets.panel_error, h=5.0), None),
    (
        "askew 5 mm, other",
        "… with the other diagonals",
        partial(sheets.panel_error, h=5.0, split="other"),
        None,
    ),
    ("deck 10 mm", "… 10 mm, divided as a deck's cells are", partial(sheets.panel_error, h=10.0, split="deck"), None),
    ("deck 5 mm", "… 5 mm, divided as a deck's cells are", partial(sheets.panel_error, h=5.0, split="deck"), None),
)
#: Standard uncertainty of the reference: uniform between two published values; what elements with shear leave.
REFERENCE = {"hemisphere": Uncertainty(reference=0.0031), "panel": Uncertainty(reference=0.0008)}
JUDGED = [case for case in CASES if case[-1] is not None]


def measure(context) -> dict[tuple[str, str], float]:
    """The error of largest size over the seeds, by case and kind."""
    seeds = QUICK_SEEDS if context.quick else SEEDS
    regular = [name for name, text, *_ in CASES if text.endswith("regular")]
    runs = [(name, kind, s) for name, *_ in CASES for kind in KINDS for s in (seeds[:1] if name in regular else seeds)]
    error = {name: function for name, _, function, _ in CASES}
    found = context.team.map(lambda run: error[run[0]](*KINDS[run[1]], run[2]), runs)
    worst: dict[tuple[str, str], float] = {}
    for (name, kind, _), value in zip(runs, found):
        worst[name, kind] = max(worst.get((name, kind), 0.0), value, key=abs)
    return worst


def table(worst) -> pd.DataFrame:
    """One row for each case, errors in per cent."""
    return pd.DataFrame(
        [
            {"case": text} | {f"{kind}, %": round(100 * worst[name, kind], 2) for kind in KINDS}
            for name, text, *_ in CASES
        ]
    )


def run(context):
    worst = measure(context)
    curved = {name: max(abs(worst[name, kind]) for kind in KINDS if kind != "flat") for name, *_ in JUDGED}
    first, note = next(iter(curved)), "The worst of the seeds; errors of deflections have their sign."
    return [
        Finding(
            name,
            error,
            note if name == first else "",
            table=table(worst) if name == first else None,
            uncertainty=REFERENCE.get(name.split()[0]),
        )
        for name, error in curved.items()
    ]


STUDY = Study(
    order=44,
    title="Curved sheets",
    claim="Triangles with the normals of the sheet bend it without stretching, on any mesh.",
    reference=(
        "Closed forms, published solutions (MacNeal and Harder 1985; Belytschko, Wong and Chiang 1992), and for the "
        "panel a shell with shear by elements of degree 5. Vertices are moved at random by up to 0.2–0.3 cells, "
        "except on the panel."
    ),
    acceptance=tuple(
        Acceptance(
            name,
            f"{text[0].upper()}{text[1:]}: largest error, exact and estimated normals.",
            limit,
            reason=REASONS.get(name, f"{GRADE}: half of it."),
        )
        for name, text, _, limit in JUDGED
    ),
    seconds=(12, 9),
    run=run,
)
