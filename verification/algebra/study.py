"""The reduced model against the full finite elements: same mesh, same pairs, same law, all stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.statistics.draw import draw
from verification.comparison import apart, certificates, difference, reduced_and_assembly, routes
from verification.plots import panels
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study

CASES = (("lap_joint", "coarse", 3), ("hat_on_plate", "coarse", 2), ("wheelhouse", "coarse", 1))  # name, mesh, samples
SMALLEST, LARGEST = CASES[0][0], CASES[-1][0]
LAWS = ("coulomb", "frictionless")
PENALTIES = (1e2, 1e3, 1e4, 1e5, 1e6)  # ε/k
FEW_PENALTIES = (1e2, 1e4, 1e6)  # of the largest mesh
QUICK_PENALTIES = (1e3, 1e5)
ONE_STEP = "one-step"
PATHS = {ONE_STEP: None, "increments": 2}  # and the increments of each step
TOLERANCE = 1e-12  # of the reduced contact solve, so that it adds nothing to what is measured
ROUGH = (2.0, 20.0)  # μ at which Coulomb's law need not have one solution
NEAR, ROUNDED = 0.1, 1e-10  # residuals between which Newton's method shows its order


def compare(model, assembly, law, sample, penalties, path=ONE_STEP) -> list[dict]:
    """One sample by both models, the full one with every penalty and then with the augmented Lagrangian (penalty None).

    The whole route solves it; the row of the augmented Lagrangian has its difference from the condensed route.

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
                "route": full.route,
                "condensed route": np.nan if penalty else apart(full, _condensed(assembly, deviations[0], law)),
                "residual of the full solve": max(certificates(process, reduced, 0, full).values())
                if path == ONE_STEP
                else np.nan,
                "Newton iterations": sum(len(solve.iterations) for solve in full.history),
                "residuals": [run for solve in full.history for run in newton_runs(solve.iterations)],
            }
        )
    return rows


def _condensed(assembly, sample, law):
    """The augmented solution by the condensed route."""
    return FullModel(assembly, comm=MPI.COMM_SELF, route="condensed").evaluate(sample, law)


def rough_routes(assembly, friction) -> float:
    """Largest relative difference of both routes for the first sample at one coefficient of friction everywhere."""
    contacts = replace(assembly.contacts, friction=np.full_like(assembly.contacts.friction, friction))
    rough = replace(assembly, scene=with_path(assembly.scene, ONE_STEP), contacts=contacts)
    sample = draw(rough.scene, rough.scene.monte_carlo.seed, 0, 1)[0]
    whole = FullModel(rough, comm=MPI.COMM_SELF).evaluate(sample)
    return apart(whole, _condensed(rough, sample, "coulomb"))


def newton_runs(iterations) -> list[np.ndarray]:
    """Residuals of three or more consecutive full Newton steps between which no contact changes its state."""
    runs: list[list[float]] = [[]]
    for iteration in iterations:
        if iteration.changed or iteration.step < 1:
            runs.append([])
        runs[-1].append(iteration.residual)
    near = ([r for r in run if ROUNDED < r < NEAR] for run in runs)
    return [np.array(run) for run in near if len(run) > 2]


def newton_orders(run: np.ndarray) -> np.ndarray:
    """Orders p of convergence from each three consecutive residuals of a run, with ``r₃/r₂ = (r₂/r₁)^p``."""
    steps = np.diff(np.log(run))
    return steps[1:] / steps[:-1]


def _convergence(penalised: pd.DataFrame, augmented: pd.DataFrame):
    """Figure of the difference against the penalty, and the fitted order of each sample."""
    names = penalised["assembly"].unique()
    figure, axes = panels(len(names), 4.2)
    orders = []
    for axis, name in zip(axes, names):
        for law, colour in zip(LAWS, ("tab:red", "tab:blue")):
            series_of, best_of = (
                table[(table["assembly"] == name) & (table["law"] == law)] for table in (penalised, augmented)
            )
            if best_of.empty:
                continue
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


def _residuals(rows):
    """Figure of each Newton residual against the one before, with lines of first and second order."""
    names = rows["assembly"].unique()
    figure, axes = panels(len(names), 3.6)
    for axis, name in zip(axes, names):
        for run in (run for runs in rows[rows["assembly"] == name]["residuals"] for run in runs):
            axis.loglog(run[:-1], run[1:], "o-", color="tab:blue", ms=3, lw=0.6, alpha=0.6)
        r = np.array([1e-5, NEAR])
        axis.loglog(r, r**2, "k--", lw=1, label="second order")
        axis.loglog(r, r, "k:", lw=1, label="first order")
        axis.set(title=name.replace("_", " "), xlabel="residual", ylabel="next residual")
        axis.legend()
    return figure


def run(context):
    quick = context.quick
    cases = [
        (name, size, sample)
        for name, size, samples in CASES
        if not (quick and name == LARGEST)
        for sample in range(1 if quick else samples)
    ]
    # the quick version solves all that there is on the smallest mesh, and once on the next
    cells = [
        (case, law, path)
        for path in PATHS
        for case in cases
        for law in LAWS
        if not quick or case[0] == SMALLEST or (law, path) == (LAWS[0], ONE_STEP)
    ]
    # Influence coefficients are computed by all ranks together, so before the work is shared out.
    built = {
        name: reduced_and_assembly(shipped(name, size), context.cache) for name, size, sample in cases if sample == 0
    }

    def cell(item):
        (name, _, sample), law, path = item
        penalties = QUICK_PENALTIES if quick else FEW_PENALTIES if name == LARGEST else PENALTIES
        model, assembly = built[name]
        freedoms = 6 * sum(len(part.surface.points) for part in assembly.parts)
        return [
            {"assembly": name, "freedoms": freedoms, "pairs": len(assembly.contacts)} | row
            for row in compare(model, assembly, law, sample, penalties if path == ONE_STEP else (), path)
        ]

    rows = pd.DataFrame([row for rows in context.team.map(cell, cells) for row in rows])
    rough = max(context.team.map(lambda friction: rough_routes(built["lap_joint"][1], friction), ROUGH))
    rows["largest"] = rows[["force", "displacement", "measurement"]].max(axis=1)
    augmented, penalised = rows[rows["ε/k"].isna()], rows[rows["ε/k"].notna()]

    figure, orders = _convergence(penalised, augmented)
    newton = [newton_orders(run) for runs in rows["residuals"] for run in runs]
    worst = augmented.loc[augmented["condensed route"].idxmax()]
    finest = penalised[penalised["ε/k"] == penalised["ε/k"].max()]
    return [
        Finding(
            "order",
            max(abs(order - 1) for order in orders),
            f"Least-squares orders from {min(orders):.4f} to {max(orders):.4f} over ε/k = "
            f"{penalised['ε/k'].min():.0e} … {penalised['ε/k'].max():.0e}, k = E t of the softer sheet.",
            figure,
            rows.drop(columns="residuals"),
        ),
        Finding(
            "newton",
            float(np.median(np.concatenate(newton))),
            f"Median of {sum(map(len, newton))} orders in {len(newton)} runs of full steps without a change of state, "
            f"residuals from {NEAR:g} to {ROUNDED:g} of the largest force.",
            _residuals(rows),
        ),
        Finding(
            "routes",
            max(worst["condensed route"], rough),
            f"{routes(rows['route'])} Largest difference from the condensed route: {worst['assembly']}, sample "
            f"{worst['sample']}, {worst['law']}, {worst['path']}: {worst['condensed route']:.1e}. Lap joint at μ = "
            f"{' and '.join(f'{friction:g}' for friction in ROUGH)}: {rough:.1e}.",
        ),
        Finding("penalty", finest["largest"].max(), f"At ε/k = {penalised['ε/k'].max():.0e}."),
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
        "Full frictional contact finite elements (fem_reference) on all unknowns, by penalty and by augmented "
        "Lagrangian: Newton's method, no influence coefficients. Lap joint, "
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
            "newton",
            "Order of convergence of the full solve's Newton method: median.",
            1.8,
            bound="at least",
            reason="Theory: 2. The secant method, or a tangent that is not consistent, would have 1.6 or 1.",
        ),
        Acceptance(
            "routes",
            "Full solve on all unknowns against the one condensed onto contact forces: largest relative difference.",
            2e-8,
            reason="Rounding, as for `augmented`. Where Coulomb's solution is not unique, they may differ.",
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
            2e-8,
            reason=(
                "Rounding: 2.2e-16 times the condition of a plate's stiffness, which grows as the square of its number "
                "of nodes, here up to 9300."
            ),
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
    seconds=(480, 27),
    memory=2.7,
    run=run,
)
