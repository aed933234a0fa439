"""The reduced model against the full finite elements: same mesh, same pairs, same law, all stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.statistics.draw import draw
from verification.comparison import certificates, difference, reduced_and_assembly
from verification.plots import panels
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study

CASES = (("lap_joint", "coarse", "coarse", 3), ("hat_on_plate", "coarse", 12.0, 2), ("wheelhouse", "coarse", 30.0, 1))
LAWS = ("coulomb", "frictionless")
PENALTIES = (1e2, 1e3, 1e4, 1e5, 1e6)  # ε/k
QUICK_PENALTIES = (1e3, 1e5)
PATHS = {"one-step": None, "increments": 2}  # and the increments of each step
TOLERANCE = 1e-12  # of the reduced contact solve, so that it adds nothing to what is measured


def compare(model, assembly, law, sample, penalties, path="one-step") -> list[dict]:
    """One sample by both routes, the full one with every penalty and then with the augmented Lagrangian (penalty None).

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    assembly : mic.model.assembly.Assembly
    law : str
    sample : int
    penalties : sequence of float
    path : str
        One of `PATHS`. What the full solve's forces leave in the reduced contact problem is known for one step a stage.
    """
    scene = with_path(assembly.scene, path, PATHS[path])
    model, assembly = replace(model, scene=scene), replace(assembly, scene=scene)
    deviations = draw(assembly.scene, assembly.scene.monte_carlo.seed, sample, 1)
    process = model.process(law, tol=TOLERANCE)
    reduced = process.evaluate(deviations)
    rows = []
    for penalty in (*penalties, None):
        finite_elements = FullModel(
            assembly, comm=MPI.COMM_SELF, augmented=penalty is None, **({} if penalty is None else {"penalty": penalty})
        )
        full = finite_elements.evaluate(deviations[0], law)
        off = difference(reduced, 0, full)
        rows.append(
            {
                "law": law,
                "path": path,
                "sample": sample,
                "ε/k": penalty,
                "force": off.force,
                "displacement": off.displacement,
                "measurement": off.measurement,
                "changed states": off.states,
                "residual of the full solve": max(certificates(process, reduced, 0, full).values())
                if path == "one-step"
                else np.nan,
                "Newton iterations": sum(len(solve.iterations) for solve in full.history),
            }
        )
    return rows


def _convergence(penalised: pd.DataFrame, augmented: pd.DataFrame):
    """Figure of the difference against the penalty, and the fitted order of each sample."""
    figure, axes = panels(len(CASES), 4.2)
    orders = []
    for axis, (name, *_) in zip(axes, CASES):
        for law, colour in zip(LAWS, ("tab:red", "tab:blue")):
            series_of, best_of = (
                table[(table["assembly"] == name) & (table["law"] == law)] for table in (penalised, augmented)
            )
            for sample, series in series_of.groupby("sample"):
                order = -np.polyfit(np.log(series["ε/k"]), np.log(series["largest"]), 1)[0]
                orders.append(order)
                axis.loglog(
                    series["ε/k"],
                    series["largest"],
                    "o-",
                    color=colour,
                    ms=4,
                    lw=1,
                    label=f"{law}, order {order:.3f}" if sample == 0 else None,
                )
            best = best_of["largest"].max()
            axis.axhline(best, color=colour, ls=":", lw=1, label=f"{law}, augmented {best:.0e}")
        axis.set(title=name.replace("_", " "), xlabel="penalty ε/k", ylabel="largest relative difference")
        axis.legend()
    return figure, orders


def run(context):
    cases = [
        (name, quick if context.quick else size, sample)
        for name, size, quick, samples in CASES
        for sample in range(1 if context.quick else samples)
    ]
    penalties = QUICK_PENALTIES if context.quick else PENALTIES
    # Influence coefficients are computed by all ranks together, so before the work is shared out.
    built = {
        name: reduced_and_assembly(shipped(name, size), context.cache) for name, size, sample in cases if sample == 0
    }

    def cell(item):
        (name, _, sample), law, path = item
        model, assembly = built[name]
        freedoms = 6 * sum(len(part.surface.points) for part in assembly.parts)
        return [
            {"assembly": name, "freedoms": freedoms, "pairs": len(assembly.contacts)} | row
            for row in compare(model, assembly, law, sample, penalties if path == "one-step" else (), path)
        ]

    rows = pd.DataFrame(
        [
            row
            for rows in context.team.map(cell, [(case, law, path) for path in PATHS for case in cases for law in LAWS])
            for row in rows
        ]
    )
    rows["largest"] = rows[["force", "displacement", "measurement"]].max(axis=1)
    augmented, penalised = rows[rows["ε/k"].isna()], rows[rows["ε/k"].notna()]

    figure, orders = _convergence(penalised, augmented)
    finest = penalised[penalised["ε/k"] == penalties[-1]]
    return [
        Finding(
            "order",
            max(abs(order - 1) for order in orders),
            f"Least-squares orders from {min(orders):.4f} to {max(orders):.4f} over ε/k = {penalties[0]:.0e} … "
            f"{penalties[-1]:.0e}, k = E t of the softer sheet.",
            figure,
            rows,
        ),
        Finding("penalty", finest["largest"].max(), f"At ε/k = {penalties[-1]:.0e}."),
        Finding(
            "augmented",
            augmented["largest"].max(),
            f"Forces {augmented['force'].max():.1e}, gaps and slips {augmented['displacement'].max():.1e}, "
            f"measurements {augmented['measurement'].max():.1e}.",
        ),
        Finding(
            "states",
            float(augmented["changed states"].sum()),
            f"Of {int(augmented['pairs'].sum())} contacts in each of the stages.",
        ),
        Finding(
            "certificate",
            augmented["residual of the full solve"].max(),
            "The contact forces of the full solve, put into the reduced contact problem of each stage.",
        ),
    ]


STUDY = Study(
    order=10,
    title="Algebra",
    claim=(
        "On the same mesh, with the same pairs and law, the reduced model and the full finite elements give the same "
        "solution through all stages, in one increment or many."
    ),
    reference=(
        "Full frictional contact finite elements (fem_reference), by penalty and by augmented Lagrangian. Lap joint, "
        "hat on a plate with a rigid stop, wheelhouse; Coulomb and frictionless."
    ),
    acceptance=(
        Acceptance(
            "order",
            "Order of the difference in 1/ε: largest deviation from 1.",
            0.02,
            reason=(
                "Theory: 1. At the softest penalty, ε/k = 100, the next term of the series is a hundredth of the "
                "first; the limit is twice that."
            ),
        ),
        Acceptance(
            "penalty",
            "Largest relative difference of forces, gaps, slips and measurements at the stiffest penalty.",
            1e-6,
            quick=1e-5,
            reason="Theory: the error is about k/ε, 1e-6 at the stiffest penalty (quick: 1e-5).",
        ),
        Acceptance(
            "augmented",
            "The same difference with the augmented Lagrangian, which has no penalty error.",
            1e-8,
            reason="Rounding: 1e-16 times the condition of a shell's stiffness, about 1e8.",
        ),
        Acceptance(
            "states",
            "Number of contacts with different states (open, stick, slip).",
            0,
            unit="contacts",
            reason="Theory: on the same mesh both have one solution.",
        ),
        Acceptance(
            "certificate",
            "Largest scale-free residual of the full solve's forces in the reduced problem.",
            1e-8,
            reason="Rounding, as for the forces.",
        ),
    ),
    seconds=(170, 90),
    memory=1.7,
    run=run,
)
